"""The lens field: what a trace knows of shift and spot, as polynomials of low degree."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from lensshift.core.arrays import Floats
from lensshift.core.errors import QualityWarning, warn_quality
from lensshift.core.grid import Grid
from lensshift.core.lens_field import MOTIONS, LensField, Motion
from lensshift.optics.directions import continued
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import otf_of_rays
from lensshift.optics.paraxial import paraxial
from lensshift.optics.shift import NEAR, central_slope, moving, probe_mm
from lensshift.optics.spots import centroids_mm, fields_for_image, marks_of, spots
from lensshift.optics.trace import Build

Waves = NDArray[np.complex128]
Sample = Callable[[Floats, Floats], NDArray[Any]]

_PROBE_RAD = 2e-3  # where it is linear
_MARGIN = 1.02  # of the states, for what is not linear
# Degrees over the sensor and over the states, tried in this order until the fit is good enough.
_DEGREES = ((6, 4), (8, 5), (11, 6))
_SPOT_DEGREES = ((5, 2), (8, 3))
_CONVERGES = 0.3  # of the error that the degree before left: what is no polynomial leaves more
_SHIFT_PX = 1e-7  # what a shift may be off by: a tenth of what is promised
_REACH_PX = 1.0  # all patterns reach less than half of it
_DOUBTFUL_PX = 1e-3  # far below what costs anything (docs/lens.md)
_WIDEST_PX = 10.0  # of a spot: nothing is left of what pixels could see
_DOUBTFUL_WIDTH_PX = 0.03  # beside the 0.29 px of a pixel a change of 0.5 %
_SPOT_PX2 = 1e-4  # and a variance: a width of 0.3 px by 2e-4 px
_CHECKED = (5, 4)  # places and states along an axis where a fit is checked
_MOST_TRACES = len(_DEGREES) + len(_SPOT_DEGREES) + 4  # those of each degree, and those checked
# Cycles per pixel at which the spot is compared with a Gaussian.
_CPP = np.arange(1, 8) / 8.0
# Directions: rows, columns, both diagonals.
_ALONG = np.array([[1.0, 0.0], [0.0, 1.0], [0.5**0.5, 0.5**0.5], [0.5**0.5, -(0.5**0.5)]])
# Behind a square pixel [direction frequency].
_PIXEL = np.sinc(_ALONG[:, :1] * _CPP) * np.sinc(_ALONG[:, 1:] * _CPP)
_NO_CONTRAST = 1e-3  # its logarithm would weigh nothing
_SPOT_STEPS, _SPOT_STILL = 30, 1e-6  # far below what a fit may be off by
_SPOT_STRIDE = 0.1  # px^2 and px^3: a step farther may leave where the OTF is nearly linear in them
_LEAST_GAIN_PX = 1e-6  # of a probe: an element that moves the image by less does not move it


def lens_field(
    lens: Lens,
    grid: Grid,
    element: int | None = 0,
    *,
    motion: Motion | None = None,
    reach_px: float | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> LensField:
    """Return shift and spot of a lens over a sensor for all positions of what moves.

    The offset of a pixel is that of the object point whose image is there after the move, against
    where its image is at rest. The spot of light and diffraction is described by the variances and
    the covariance of the Gaussian that lets as much contrast through along rows, columns and
    diagonals, and by the third moments that turn the phase as coma does, each frequency up to that
    of the pixels weighted with the square of the contrast behind lens and pixel.

    Parameters
    ----------
    grid : of the sensor, centred on the axis
    element : number of the element that moves, counted from 0; None: the sensor moves
    motion : "decentre" (the default) or "tilt" of the element
    reach_px : largest shift along each axis that the field is to hold for; by default one pixel,
        or half of one where the lens cuts off light beyond it or blurs it away
    on_progress : is told how many traces of at most how many are done

    Raises
    ------
    ValueError
        If there is no such element, moving it does not move the image, no light arrives, or the
        lens is out of focus by more than any picture could tell.

    Warns
    -----
    QualityWarning
        If the fit of the shifts is no better than 0.001 px, as where the lens cuts off light, or
        that of the widths of the spot no better than 0.03 px.
    """
    check_focus(lens, grid)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*of its light", QualityWarning)  # once, in our words
        if reach_px is None:
            found = _reaching(lens, grid, element, motion, on_progress)
        else:
            found, _ = _fitted(_mover(lens, grid, element, motion, reach_px), on_progress)
    for what, error_px, most_px in (
        ("shifts", found.shift_error_px, _DOUBTFUL_PX),
        ("widths of the spot", found.spot_error_px, _DOUBTFUL_WIDTH_PX),
    ):
        if error_px > most_px:
            warn_quality(
                f"the {what} are fitted to {error_px:.2g} px only: does the lens cut off light or "
                "blur it away, far from rest or at the edge of the sensor? A smaller reach_px or "
                "sensor may help"
            )
    return found


def check_focus(lens: Lens, grid: Grid) -> None:
    """Refuse before the work a lens without power, or whose spot leaves no contrast to describe."""
    if told := out_of_focus(lens, grid):
        raise ValueError(f"expected a lens in focus, got {told}")


def out_of_focus(lens: Lens, grid: Grid) -> str:
    """Return in words that the spot of a lens leaves no contrast, or nothing."""
    away_mm = paraxial(lens).image_mm - lens.gaps_mm[-1]
    width_px = float(spots(lens, np.zeros(2)).rms_radius_mm) / (2**0.5 * max(grid.pitch_mm))
    told = f"a spot of {width_px:.3g} px rms in the middle of the sensor: the paraxial image of "
    return told + f"the object lies {away_mm:+.4g} mm from it" if width_px > _WIDEST_PX else ""


def _fitted(mover: _Mover, told: Callable[[int, int], None] | None) -> tuple[LensField, float]:
    """Return the field, and the error of the widths in the inner half of its states."""
    done = count(1)

    def counted(sample: Sample) -> Sample:
        def one(places: Floats, states: Floats) -> NDArray[Any]:
            found = sample(places, states)
            if told is not None:
                told(next(done), _MOST_TRACES)
            return found

        return one

    shift_px, shift_error_px = _fit(counted(mover.shifts), _DEGREES, _SHIFT_PX)
    spot, _ = _fit(counted(mover.spots), _SPOT_DEGREES, _SPOT_PX2)
    spot_error_px, near_error_px, contrast_error = _spot_errors(counted(mover.otf), spot)
    field = LensField(
        grid=mover.grid,
        shift_px=shift_px,
        spot_px2=spot[..., :3],
        skew_px3=spot[..., 3:],
        reach=mover.reach,
        motion=mover.motion,
        element=mover.element,
        lens=mover.lens.name,
        shift_error_px=shift_error_px,
        spot_error_px=spot_error_px,
        contrast_error=contrast_error,
        notes=marks_of(mover.lens) | {"temperature_c": mover.lens.temperature_c},
    )
    return field, near_error_px


def _reaching(
    lens: Lens,
    grid: Grid,
    element: int | None,
    motion: Motion | None,
    told: Callable[[int, int], None] | None,
) -> LensField:
    """Return the fit for the reach that the lens allows."""
    mover = _mover(lens, grid, element, motion, _REACH_PX)
    try:
        found, near_error_px = _fitted(mover, told)
        # Widths that are as far off near rest are no better with less reach.
        sharp = found.spot_error_px < _DOUBTFUL_WIDTH_PX or near_error_px > _DOUBTFUL_WIDTH_PX
        if found.shift_error_px < _DOUBTFUL_PX and sharp:
            return found
    except ValueError:  # no light at all so far away
        pass
    return _fitted(_mover(lens, grid, element, motion, 0.5 * _REACH_PX), told)[0]


@dataclass(frozen=True, slots=True, eq=False)
class _Mover:
    """What moves, and the quantities at places and states in -1 .. 1: NaN where it is dark."""

    lens: Lens
    grid: Grid
    element: int | None
    motion: Motion
    reach: tuple[float, float]

    def shifts(self, u: Floats, s: Floats) -> Floats:
        """Return the offset in px [place state 2] at places [place 2] and states [state 2]."""
        pitch_mm, state = np.asarray(self.grid.pitch_mm), s * np.asarray(self.reach)
        if self.element is None:
            return np.broadcast_to(-state / pitch_mm, (len(u), len(s), 2))
        fields = self._fields(u, state)
        moved_mm, resting_mm = (
            centroids_mm(self.lens, fields, build, dark=True)
            for build in (self._build(state), None)
        )
        return np.asarray((moved_mm - resting_mm) / pitch_mm)

    def otf(self, u: Floats, s: Floats) -> Waves:
        """Return the OTF about the centroid [place state direction frequency]."""
        state = s * np.asarray(self.reach)
        fields = self._fields(u, state)
        found = np.full((len(u), len(s), *_PIXEL.shape), np.nan, np.complex128)
        lpmm = (_ALONG[:, None] * _CPP[:, None] / self.grid.pitch_mm).reshape(-1, 2)
        for place, field_tan in enumerate(fields):  # each with as many rays as it needs
            lit = np.flatnonzero(np.isfinite(field_tan[:, 0]))
            if lit.size:
                build = self._build(state[lit])
                of_lit = otf_of_rays(self.lens, field_tan[lit], lpmm, build=build)
                found[place, lit] = of_lit.reshape(len(lit), *_PIXEL.shape)
        return found

    def spots(self, u: Floats, s: Floats) -> Floats:
        """Return variances, covariance (px^2), third moments (px^3) [place state 5] of spots."""
        along_px2, skew_px3 = equivalent_spot(self.otf(u, s), _PIXEL)
        lean_px2 = 0.5 * (along_px2[..., 2:3] - along_px2[..., 3:])
        return np.concatenate([along_px2[..., :2], lean_px2, skew_px3[..., :2]], axis=-1)

    def _build(self, state: Floats) -> Build | None:
        """Return the builds [state]."""
        if self.element is None:
            return None
        return moving(self.lens, self.element, state, tilt=self.motion == "tilt")

    def _fields(self, u: Floats, state: Floats) -> Floats:
        """Return the fields [place state 2] imaged at places."""
        half_mm = 0.5 * np.asarray(self.grid.shape) * np.asarray(self.grid.pitch_mm)
        places_mm = np.broadcast_to((u * half_mm)[:, None], (len(u), len(state), 2))
        if self.element is None:
            places_mm = places_mm + state
        near_mm = NEAR * min(self.grid.pitch_mm)
        return fields_for_image(
            self.lens, places_mm, build=self._build(state), tolerance_mm=near_mm, dark=True
        )


def equivalent_px2(contrast: Floats, pixel: Floats = _PIXEL[0]) -> Floats:
    """Return the variance in px^2 of the Gaussian that passes about the contrast [... frequency].

        sigma^2 = - sum w f^2 ln m / (2 pi^2 sum w f^4),   w = (m pixel(f))^2

    Least squares of ln m with the errors of m behind a pixel, along its rows unless another
    contrast of it is given, at frequencies `_CPP`.
    """
    seen = np.maximum(contrast, _NO_CONTRAST)
    weight = (seen * pixel) ** 2
    above = -np.sum(weight * _CPP**2 * np.log(seen), axis=-1)
    below = 2.0 * np.pi**2 * np.sum(weight * _CPP**4, axis=-1)
    return np.asarray(above / below)


def spot_otf(spot_px2: Floats, skew_px3: Floats) -> Waves:
    """Return the OTF [... frequency] of spots of a variance and a third central moment."""
    w = 2.0 * np.pi * _CPP
    return np.asarray(
        np.exp(-0.5 * spot_px2[..., None] * w**2 + 1j / 6 * skew_px3[..., None] * w**3)
    )


def equivalent_spot(otf: Waves, pixel: Floats = _PIXEL[0]) -> tuple[Floats, Floats]:
    """Return variance in px^2 and third moment in px^3 of the spot nearest to an OTF.

    Least squares of the OTF behind a pixel (as for `equivalent_px2`) by Gauss and Newton, whose
    steps in the two are independent: one is along the model, the other across it.
    """
    w, power = 2.0 * np.pi * _CPP, pixel**2
    spot_px2, skew_px3 = equivalent_px2(np.abs(otf), pixel), np.zeros(otf.shape[:-1])
    most, none_px2 = _SPOT_STRIDE, -2.0 * np.log(_NO_CONTRAST) / w[0] ** 2
    for _ in range(_SPOT_STEPS):
        model = spot_otf(spot_px2, skew_px3)
        off, weight = model.conj() * (otf - model), power * np.abs(model) ** 2
        less = np.sum(power * w**2 * off.real, axis=-1) / np.sum(weight * w**4, axis=-1)
        more = np.sum(power * w**3 * off.imag, axis=-1) / np.sum(weight * w**6, axis=-1)
        spot_px2 = np.clip(spot_px2 - np.clip(2.0 * less, -most, most), 0.0, none_px2)
        skew_px3 = skew_px3 + np.clip(6.0 * more, -most, most)
        if max(np.abs(less).max(), np.abs(more).max()) < _SPOT_STILL:
            break
    return spot_px2, skew_px3


def _mover(
    lens: Lens, grid: Grid, element: int | None, motion: Motion | None, reach_px: float
) -> _Mover:
    if not (np.isfinite(reach_px) and reach_px > 0):
        raise ValueError(f"expected a positive reach_px, got {reach_px}")
    kind: Motion = motion or ("sensor" if element is None else "decentre")
    if kind not in MOTIONS or (kind == "sensor") != (element is None):
        raise ValueError(f"expected decentre or tilt of an element, got {kind!r} of {element}")
    if element is not None:
        lens.check_element(element)
    probe = _PROBE_RAD if kind == "tilt" else probe_mm(lens)
    trial = _Mover(lens, grid, element, kind, (probe, probe))
    px_per_unit = central_slope(lambda ends: trial.shifts(np.zeros((1, 2)), ends)[0], 1.0) / probe
    if np.linalg.cond(px_per_unit) > 1e6 or np.abs(px_per_unit).max() * probe < _LEAST_GAIN_PX:
        raise ValueError(
            f"expected an element whose {kind} moves the image, but {lens.called(element or 0)} "
            "does not"
        )
    row, col = _MARGIN * reach_px * np.abs(np.linalg.inv(px_per_unit)).sum(axis=1)
    return _Mover(lens, grid, element, kind, (float(row), float(col)))


def _fit(sample: Sample, degrees: tuple[tuple[int, int], ...], goal: float) -> tuple[Floats, float]:
    """Return Chebyshev coefficients [i j a b quantity] and the largest error where it is checked.

    Interpolation at the Chebyshev nodes, of the least of the degrees that reaches the goal.
    """
    places, states = (_crossed(np.linspace(-1.0, 1.0, count)) for count in _CHECKED)
    traced = sample(places, states)
    best, least = np.zeros((1, 1, 1, 1, traced.shape[-1])), np.inf
    for of_field, of_state in degrees:
        n, m = of_field + 1, of_state + 1
        of_states = sample(_crossed(_nodes(n)), _crossed(_nodes(m))).reshape(n, n, m * m, -1)
        lit = [continued(one, _nodes(n), _nodes(n)) for one in np.moveaxis(of_states, 2, 0)]
        at_nodes = np.stack(lit, axis=2).reshape(n, n, m, m, -1)
        to_n, to_m = (np.linalg.inv(chebvander(_nodes(k), k - 1)) for k in (n, m))
        found = np.einsum("ip,jq,ar,bs,pqrsc->ijabc", to_n, to_n, to_m, to_m, at_nodes,
                          optimize=True)  # fmt: skip
        error = float(np.nanmax(np.abs(_values(found, places, states) - traced)))
        converges = error < _CONVERGES * least
        if error < least:
            best, least = found, error
        if least < goal or not converges:
            break
    return best, least


def _spot_errors(sample: Sample, spot: Floats) -> tuple[float, float, float]:
    """Return the largest errors of a width in px, everywhere and near rest, and of the contrast.

    The contrast is that behind lens and pixel, along the axes and the diagonals.
    """
    places, states = (_crossed(np.linspace(-1.0, 1.0, count)) for count in _CHECKED)
    otf = sample(places, states)
    fitted_px2, fitted_px3 = np.split(_values(spot, places, states), (3,), axis=-1)
    fitted_px2[..., :2] = np.maximum(fitted_px2[..., :2], 0.0)
    width_px = np.sqrt(equivalent_spot(otf, _PIXEL)[0][..., :2])
    along_px2 = fitted_px2 @ np.column_stack([_ALONG**2, 2.0 * _ALONG.prod(axis=1)]).T
    off = np.abs(spot_otf(along_px2, fitted_px3 @ (_ALONG**3).T) - otf) * _PIXEL
    wrong_px = np.nanmax(np.abs(np.sqrt(fitted_px2[..., :2]) - width_px), axis=(0, 2))
    near = np.abs(states).max(axis=-1) < 0.5
    return float(np.nanmax(wrong_px)), float(np.nanmax(wrong_px[near])), float(np.nanmax(off))


def _values(coefficients: Floats, places: Floats, states: Floats) -> Floats:
    """Return the polynomials [place state quantity] at places [place 2] and states [state 2]."""
    bases: list[Any] = [
        chebvander(points[:, axis], coefficients.shape[2 * part + axis] - 1)
        for part, points in enumerate((places, states))
        for axis in (0, 1)
    ]
    return np.asarray(np.einsum("ijabq,pi,pj,sa,sb->psq", coefficients, *bases, optimize=True))


def _nodes(count: int) -> Floats:
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _crossed(along: Floats) -> Floats:
    """Return the points [n n, 2] of a square grid."""
    return np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
