"""How a lens images over the sensor while something moves: shift and spot as polynomials."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats, frozen
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.motion import MOST_APART_PX, SAME_PITCH, ShiftField
from lensshift.core.types import Burst

Motion = Literal["decentre", "tilt", "sensor"]
MOTIONS: tuple[Motion, ...] = get_args(Motion)

# At most, of an iteration that converges fast: the map of a lens is nearly linear.
_INVERSE_STEPS = 20
_INVERSE_PX = 1e-9  # rounding
# Beyond the fitted range by rounding, and by the error of a shift that was planned at its end.
_BEYOND = 1.02
_SAME_LIGHT_NM = 1.0  # as makers round it
# What tells lenses of one name apart, and by how much it may differ: as warmth changes it.
_MARKS = ("wavelength_nm", "working_f_number", "image_per_field_mm", "from_focus_mm")
_SAME_SCALE, _SAME_BLUR_PX = 1e-3, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class LensField:
    """Shift and spot of a lens over the sensor and over the states of what moves.

        q(u, s) = sum_ijab c_ijab T_i(u_row) T_j(u_col) T_a(s_row) T_b(s_col)

    with Chebyshev polynomials T, u the place on the sensor over half its size, and s the state
    over `reach`. Everything is 0 mm or rad, and no shift, at rest.

    Parameters
    ----------
    grid : of the sensor, centred on the axis
    shift_px : [i j a b 2] coefficients of the image offset (row, col), as `Burst.offset_px`
    spot_px2 : [i j a b 3] of the variance (row, col) and the covariance of the Gaussian that stands
        for the spot; with 2 in place of 3 no spot leans
    reach : (row, col) largest state, in mm or (tilt) rad
    motion : what the state is: decentre or tilt of an element, or the place of the sensor
    element : its number from 0, or None
    lens : its name
    shift_error_px : largest difference to the traced shift where it was not fitted
    spot_error_px : largest difference of a width (standard deviation) in the same way
    contrast_error : largest difference of the contrast behind lens and pixel, phase included, that
        a spot of these moments makes up to the pixel frequency, along the axes
        and the diagonals
    notes : text and numbers: wavelength, temperature
    skew_px3 : [i j a b 2] of the third central moment (row, col) of the spot; none: it is even
    """

    grid: Grid
    shift_px: Floats
    spot_px2: Floats
    reach: tuple[float, float]
    motion: Motion = "decentre"
    element: int | None = 0
    lens: str = ""
    shift_error_px: float = 0.0
    spot_error_px: float = 0.0
    contrast_error: float = 0.0
    notes: Mapping[str, Any] | None = None
    skew_px3: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("shift_px", "spot_px2", "skew_px3"):
            if name == "skew_px3" and self.skew_px3 is None:
                continue
            values = np.asarray(getattr(self, name), dtype=np.float64)
            parts = (2, 3) if name == "spot_px2" else (2,)
            if values.ndim != 5 or values.shape[-1] not in parts or not values.size:
                raise DataError(f"expected [i j a b 2], got shape {values.shape}", field=name)
            if not np.all(np.isfinite(values)):
                raise DataError("expected finite coefficients", field=name)
            object.__setattr__(self, name, frozen(values))
        reach = tuple(float(one) for one in self.reach)
        if len(reach) != 2 or not all(np.isfinite(one) and one > 0 for one in reach):
            raise DataError(f"expected two positive numbers, got {self.reach}", field="reach")
        if self.motion not in MOTIONS:
            raise DataError(f"expected {', '.join(MOTIONS)}, got {self.motion!r}", field="motion")
        object.__setattr__(self, "reach", reach)
        object.__setattr__(self, "notes", dict(self.notes or {}))

    @property
    def unit(self) -> str:
        """Of a state."""
        return "rad" if self.motion == "tilt" else "mm"

    @property
    def optics(self) -> dict[str, Any]:
        """What a burst says of the lens that took it, in `Burst.meta`."""
        told = {"lens": self.lens, "element": self.element, "motion": self.motion}
        return told | {key: (self.notes or {})[key] for key in _MARKS if key in (self.notes or {})}

    @property
    def middle_px2(self) -> float:
        """Variance of the spot in the middle of the sensor at rest, the mean of both axes."""
        middle = np.zeros(1)
        spot_px2 = _evaluated(self.spot_px2, [middle, middle], np.zeros((1, 2)))
        return float(spot_px2[..., :2].mean())

    def at(self, state: ArrayLike) -> ShiftField:
        """Return shift and spot of every pixel for states [frame 2] in mm or rad.

        Raises
        ------
        DataError
            If a state lies outside the range that the field was fitted for.
        """
        given = np.atleast_2d(np.asarray(state, dtype=np.float64))
        if given.ndim != 2 or given.shape[1] != 2 or not np.all(np.isfinite(given)):
            raise DataError(f"expected finite states [frame 2], got shape {given.shape}")
        scaled = given / np.asarray(self.reach)
        if np.abs(scaled).max(initial=0.0) > _BEYOND:
            raise DataError(
                f"expected states up to {_pair(self.reach)} {self.unit}, got up to "
                f"{np.abs(given).max():g}; make the lens field with a larger reach_px",
                field="state",
            )
        return self._at(scaled)

    def states(self, offset_px: ArrayLike) -> Floats:
        """Return the states [frame 2] in mm or rad that move the middle of the image as told.

        Raises
        ------
        DataError
            If a shift lies outside the range that the field was fitted for.
        """
        return np.asarray(self._states_of(offset_px) * np.asarray(self.reach))

    def of(self, burst: Burst) -> ShiftField:
        """Return shift and spot of every pixel of the frames of a burst.

        The state of a frame is the one that makes its offset in the middle of the sensor, whatever
        the pattern.

        Raises
        ------
        DataError
            If the field does not belong to the burst: another sensor, lens or moving part, shifts
            that nobody knows, that it was not fitted for, or that contradict the stage.
        """
        self.check_camera(burst)
        if burst.offset_source == "unknown" and burst.frame_count > 1:
            raise DataError(
                "nobody has said where the frames of the burst lie; `lensshift register` "
                "(lensshift.register) finds it from them",
                field="offset_px",
            )
        _check_stage(burst)
        return self._at(self._states_of(burst.offset_px))

    @property
    def px_per_unit(self) -> Floats:
        """Shift of the middle of the image over the state about rest, [2 2], px per mm or rad."""
        return np.asarray(self._middle_slope() / np.asarray(self.reach))

    def corrected(self, px_per_px: Floats) -> LensField:
        """Return the field with what a scan found: how much more each pixel shifts.

        Parameters
        ----------
        px_per_px : [row col 2 2] further shift per px of shift of the middle of the image, a
            polynomial of degree 2 along each axis
        """
        u = self._places()
        bases = [np.linalg.pinv(chebvander(at, min(2, len(at) - 1))) for at in u]
        terms = np.einsum("ir,jc,rcpq->ijpq", *bases, px_per_px)
        size = [max(*both) for both in zip(self.shift_px.shape[:2], terms.shape, strict=False)]
        coefficients = np.zeros((*size, *self.shift_px.shape[2:]))
        coefficients[tuple(slice(n) for n in self.shift_px.shape)] = self.shift_px
        rows, cols = terms.shape[:2]
        per_state = terms @ self._middle_slope()
        coefficients[:rows, :cols, 1, 0] += per_state[..., 0]
        coefficients[:rows, :cols, 0, 1] += per_state[..., 1]
        return replace(self, shift_px=coefficients)

    def _places(self) -> list[Array]:
        """Return the places of the rows and of the columns, in -1 .. 1."""
        return [(np.arange(count) - 0.5 * (count - 1)) / (0.5 * count) for count in self.grid.shape]

    def _centre_px(self, s: Floats) -> Floats:
        """Return the offset [state 2] of the middle for scaled states."""
        return _evaluated(self.shift_px, [np.zeros(1), np.zeros(1)], s)[:, 0, 0]

    def _middle_slope(self) -> Floats:
        """Return [2 2] how the middle moves with the scaled state about rest."""
        step = 1e-4
        there = self._centre_px(step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]], np.float64))
        return np.stack([there[0] - there[1], there[2] - there[3]], axis=-1) / (2.0 * step)

    def _at(self, s: Floats) -> ShiftField:
        u = self._places()
        offset_px, spot_px2 = (_evaluated(c, u, s) for c in (self.shift_px, self.spot_px2))
        skew_px3 = None if self.skew_px3 is None else _evaluated(self.skew_px3, u, s)
        spot_px2[..., :2] = np.maximum(spot_px2[..., :2], 0.0)
        return ShiftField(offset_px, self.grid.pitch_mm, spot_px2, skew_px3)

    def _states_of(self, offset_px: ArrayLike) -> Floats:
        """Return scaled states by Newton's method on the polynomial in the middle."""
        wanted = np.atleast_2d(np.asarray(offset_px, dtype=np.float64))
        if wanted.ndim != 2 or wanted.shape[1] != 2 or not np.all(np.isfinite(wanted)):
            raise DataError(f"expected finite offsets [frame 2], got shape {wanted.shape}")
        inverse = np.linalg.inv(self._middle_slope())
        s = wanted @ inverse.T
        if np.abs(s).max(initial=0.0) > _BEYOND:
            frame = int(np.argmax(np.abs(s).max(axis=1)))
            most_px = np.ceil(10.0 * np.abs(wanted).max()) / 10.0
            raise DataError(
                f"frame {frame} (from 0) is moved by {_pair(wanted[frame])} px, farther than the "
                f"lens field was fitted for; make it with --reach-px {most_px:g}",
                field="offset_px",
            )
        for _ in range(_INVERSE_STEPS):
            error_px = wanted - self._centre_px(s)
            s = s + error_px @ inverse.T
            if np.abs(error_px).max() < _INVERSE_PX:
                break
        return s

    def check_sensor(self, grid: Grid) -> None:
        """Refuse another sensor than the field's own.

        Raises
        ------
        DataError
            If number or pitch of the pixels differ: with the option that makes the right field.
        """
        if grid.shape != self.grid.shape:
            (rows, cols), (r, c) = grid.shape, self.grid.shape
            raise DataError(
                f"the lens field is of a sensor of {c}x{r} pixels, not {cols}x{rows}; make it with "
                f"--sensor {cols}x{rows}",
                field="shape",
            )
        if not np.allclose(grid.pitch_mm, self.grid.pitch_mm, rtol=SAME_PITCH):
            row_mm, col_mm = grid.pitch_mm
            raise DataError(
                f"the lens field is of pixels of {_pair(self.grid.pitch_mm)} mm, not "
                f"{_pair(grid.pitch_mm)} mm; make it with --pitch-mm {row_mm:g},{col_mm:g}",
                field="pitch_mm",
            )

    def check_camera(self, burst: Burst) -> None:
        """Refuse a burst of another sensor, or one that says that it was taken by another lens.

        Raises
        ------
        DataError
            With the option that makes the right field.
        """
        self.check_sensor(burst.grid)
        told = burst.meta.get("optics")
        for name, problem, cure in self._objections(told) if isinstance(told, Mapping) else ():
            raise DataError(f"{problem}; {cure}", field=f"meta.optics{name}")

    def _objections(self, told: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
        """Yield what of the lens is another, why, and what helps."""
        name, element = told.get("lens"), told.get("element", self.element)
        if "focal_length_mm" in told:
            plain = "the burst was taken with a plain lens that was not traced"
            yield "", plain, "a lens field is for `simulate --lens` and for real lenses"
        if isinstance(name, str) and name and self.lens and name != self.lens:
            other = f"the lens field is of {self.lens!r}, the burst was taken with {name!r}"
            yield ".lens", other, "make it from that lens"
        if element != self.element:
            mine, theirs = (0 if one is None else int(one) + 1 for one in (self.element, element))
            other = f"in the lens field {_part(mine)} moves, in the burst {_part(theirs)}"
            yield ".element", other, f"make it with --element {theirs}"
        if told.get("motion", self.motion) != self.motion:
            how = "with --tilt" if told["motion"] == "tilt" else "without --tilt"
            other = f"the lens field is of a {self.motion}, the burst of a {told['motion']}"
            yield ".motion", other, f"make it {how}"
        optics = self.optics
        mine_nm, theirs_nm = (one.get("wavelength_nm") for one in (optics, told))
        if mine_nm and theirs_nm and abs(mine_nm - theirs_nm) > _SAME_LIGHT_NM:
            other = f"the lens field is of light of {mine_nm:g} nm, the burst of {theirs_nm:g} nm"
            yield ".wavelength_nm", other, f"make it with --wavelength-nm {theirs_nm:g}"
        if not all(isinstance(one.get(key), float) for one in (optics, told) for key in _MARKS):
            return
        # A lens of the same name may have a larger image, or be as sharp elsewhere.
        scale, focus = ("image_per_field_mm", "from_focus_mm")
        most_mm = _SAME_BLUR_PX * min(self.grid.pitch_mm) * abs(optics["working_f_number"])
        for key, most, what in (
            (scale, _SAME_SCALE * abs(optics[scale]), "{:.5g} mm of image per tangent"),
            (focus, most_mm, "a sensor {:+.4g} mm from its image"),
        ):
            if abs(optics[key] - told[key]) > most:
                ours, its = (what.format(one[key]) for one in (optics, told))
                other = f"the lens field is of a lens with {ours}, the burst of one with {its}"
                yield f".{key}", other, "make it from the lens file that took the burst"


def _evaluated(coefficients: Floats, u: Sequence[Array], s: Floats) -> Floats:
    """Return [frame row col quantity] at places u (row, col) and states s [frame 2]."""
    rows, cols, first, second = coefficients.shape[:4]
    t_a, t_b = chebvander(s[:, 0], first - 1), chebvander(s[:, 1], second - 1)
    over_field = np.einsum("ijabq,fa,fb->fqij", coefficients, t_a, t_b, optimize=True)
    t_i, t_j = chebvander(u[0], rows - 1), chebvander(u[1], cols - 1)
    return np.asarray(np.moveaxis(t_i @ over_field @ t_j.T, 1, -1))


def _check_stage(burst: Burst) -> None:
    """Refuse offsets that no stage makes at the positions of the burst, as of other frames."""
    stage_mm = burst.stage_mm
    if stage_mm is None or burst.frame_count < 4 or not np.all(np.ptp(stage_mm, axis=0) > 0):
        return
    design = np.column_stack([stage_mm, np.ones(len(stage_mm))])
    found = np.linalg.lstsq(design, burst.offset_px, rcond=None)[0]
    apart_px = np.abs(burst.offset_px - design @ found).max(axis=1)
    if apart_px.max() > MOST_APART_PX:
        raise DataError(
            f"the offsets do not follow the stage positions, by {apart_px.max():.2f} px in frame "
            f"{int(np.argmax(apart_px))} (from 0): one of them is of other frames, or in another "
            "order; `lensshift register` (lensshift.register) finds the offsets from the frames",
            field="offset_px",
        )


def _pair(pair: Any) -> str:
    return f"{pair[0]:g} x {pair[1]:g}"


def _part(number: int) -> str:
    return f"element {number}" if number else "the sensor"
