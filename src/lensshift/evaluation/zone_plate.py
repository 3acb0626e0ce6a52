"""Response to a zone plate of known chirp, and how much of it is folded by sampling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.optical import MtfCurve
from lensshift.evaluation import known_phase
from lensshift.evaluation.known_phase import HarmonicFit, Pair, Pixels, Waves
from lensshift.evaluation.limits import pitch_pair_mm

_WEDGE_RAD = np.pi / 12  # half the angle about an axis whose pixels show that axis
_MIN_RINGS = 3
_RIM_RINGS = 2  # that a rim is seen in: it crosses one, and is blurred into the next
_LOW_SHARE = 5  # one ring in so many, at least three, tells the contrast at frequency 0


@dataclass(frozen=True, slots=True, eq=False)
class ZonePlateResult:
    """Contrast by local frequency of a zone plate.

    Parameters
    ----------
    radial : over all directions, to the nearest border
    row, col : within 15 degrees of that axis, to the border along it
    folded : (row, col) contrast of the wave that the LR grid folds by 1 / lr_pitch, over the TRUE
        frequency; None without `lr_pitch_mm`
    center_px : centre of the plate as (row, col)
    contrast, contrast_std : modulation at frequency 0, by which the curves were divided; levels
        that are given count as exact
    """

    radial: MtfCurve
    row: MtfCurve
    col: MtfCurve
    folded: tuple[MtfCurve, MtfCurve] | None
    center_px: Pair
    contrast: float
    contrast_std: float


def zone_plate_response(
    image: ArrayLike,
    *,
    pitch_mm: float | Pair,
    chirp_lpmm_per_mm: float,
    center_px: Pair | None = None,
    lr_pitch_mm: float | Pair | None = None,
    levels: Pair | None = None,
    valid: ArrayLike | None = None,
) -> ZonePlateResult:
    """Measure the response to a zone plate by local frequency.

        I = c0 + c1 row + c2 col + a cos(pi k r^2) + b sin(pi k r^2),   f(r) = k r
        MTF = sqrt(a^2 + b^2) / c0 / contrast

    in rings of equal area, one cycle wide each, up to the Nyquist frequency of the image. With
    `lr_pitch_mm` the wave folded by the LR grid, of phase pi k r^2 -+ 2 pi u / lr_pitch with u the
    distance along the axis, is fitted beside the true one on either side of the centre. Rings in
    which the pixels cannot tell the two apart (at the LR Nyquist frequency) are left out.

    Parameters
    ----------
    image : [row col], finite where valid, linear in the light and positive in the mean
    pitch_mm : pixel spacing, one or (row, col)
    chirp_lpmm_per_mm : k, by how much the frequency rises per mm from the centre
    center_px : (row, col); found if not given, with a `QualityWarning` if that does not settle
    lr_pitch_mm : pixel spacing of the LR frames a super-resolved image was made of
    levels : values of (low, high) in large uniform areas give the contrast at frequency 0; else it
        is extrapolated from the lowest fifth of the rings as in `contrast_at_zero`
    valid : [row col], False for pixels left out

    Raises
    ------
    ValueError
        If an argument is out of range, or fewer than three rings can be fitted.

    Warns
    -----
    QualityWarning
        If the phase turns from ring to ring, as with a wrong chirp, or the wave ends at once: rings
        beyond that rim are left out.
    """
    if not (np.isfinite(chirp_lpmm_per_mm) and chirp_lpmm_per_mm > 0):
        raise ValueError(f"expected a positive chirp in lp/mm per mm, got {chirp_lpmm_per_mm}")
    pixels = known_phase.list_pixels(image, pitch_mm, valid)
    plate = _Plate(pixels, chirp_lpmm_per_mm)
    center = plate.found_center_px() if center_px is None else center_px
    place_mm, reach_mm = pixels.place_mm(center), pixels.reach_mm(center)
    frequency_lpmm, fits = plate.measure(plate.waves(min(reach_mm), *place_mm))
    if len(fits) < _MIN_RINGS:
        raise ValueError(f"expected {_MIN_RINGS} or more valid rings of one cycle, got {len(fits)}")
    printed = known_phase.printed_count(frequency_lpmm, fits, _RIM_RINGS)
    if printed < len(fits):
        frequency_lpmm, fits = frequency_lpmm[:printed], fits[:printed]
        rim_mm = float(frequency_lpmm[-1]) / chirp_lpmm_per_mm
        reach_mm = min(reach_mm[0], rim_mm), min(reach_mm[1], rim_mm)
        told = f"the wave ends {rim_mm:.4g} mm from the centre, taken for the rim of the plate"
        warn_quality(told)
    lowest = max(_MIN_RINGS, len(fits) // _LOW_SHARE)
    contrast = known_phase.contrast_at_zero(frequency_lpmm[:lowest], fits[:lowest], levels)
    known_phase.warn_if_out_of_step(fits, f"the chirp of {chirp_lpmm_per_mm:g}")
    radial = known_phase.mtf_curve(frequency_lpmm, fits, contrast, "zone plate")
    axes, folded = [], []
    for axis, name in enumerate(("zone plate, row", "zone plate, col")):
        waves = plate.wedge(place_mm, axis, reach_mm[axis])
        if lr_pitch_mm is None:
            axes.append(known_phase.mtf_curve(*plate.measure(waves), contrast, name))
        else:
            lr_mm = pitch_pair_mm(lr_pitch_mm)[axis]
            found_lpmm, true, alias = plate.measure_sides(waves, place_mm[axis], lr_mm)
            axes.append(known_phase.mtf_curve(found_lpmm, true, contrast, name))
            folded.append(known_phase.mtf_curve(found_lpmm, alias, contrast, f"{name}, folded"))
    both = (folded[0], folded[1]) if folded else None
    return ZonePlateResult(radial, axes[0], axes[1], both, center, *contrast)


@dataclass(frozen=True, slots=True)
class _Plate:
    pixels: Pixels
    chirp_lpmm_per_mm: float

    def found_center_px(self) -> Pair:
        start_px = known_phase.symmetry_center_px(self.pixels, parity=1)
        waves = partial(self.waves, min(self.pixels.reach_mm(start_px)))
        return known_phase.refine_center_px(self.pixels, start_px, waves)

    def waves(self, reach_mm: float, row_mm: Floats, col_mm: Floats) -> Waves:
        k, highest_lpmm = self.chirp_lpmm_per_mm, 0.5 / max(self.pixels.pitch_mm)
        cycles = k / 2 * (row_mm**2 + col_mm**2)
        ring = np.floor(cycles).astype(np.int64)
        whole = np.floor(k / 2 * min(reach_mm, highest_lpmm / k) ** 2)
        return Waves(
            ring=np.where(ring < whole, ring, -1),
            phase_rad=2 * np.pi * cycles,
            slope=2 * np.pi * k * np.column_stack([row_mm, col_mm]),
            background=np.column_stack([np.ones_like(row_mm), row_mm, col_mm]),
        )

    def wedge(self, place_mm: tuple[Floats, Floats], axis: int, reach_mm: float) -> Waves:
        """Return the waves near one axis only."""
        waves = self.waves(reach_mm, *place_mm)
        near = np.abs(place_mm[1 - axis]) <= np.abs(place_mm[axis]) * np.tan(_WEDGE_RAD)
        return replace(waves, ring=np.where(near, waves.ring, -1))

    def frequency_lpmm(self, phase_rad: Floats) -> float:
        """Return the rms frequency of a ring: contrast falls with the square of the frequency."""
        return float(np.sqrt(self.chirp_lpmm_per_mm * phase_rad.mean() / np.pi))

    def measure(self, waves: Waves) -> tuple[Floats, list[HarmonicFit]]:
        found = {}
        for index in known_phase.ring_indices(waves.ring):
            values, phase_rad = self.pixels.values[index], waves.phase_rad[index]
            fit = known_phase.fit_harmonic(values, waves.background[index], [phase_rad])
            if fit is not None:
                found[self.frequency_lpmm(phase_rad)] = fit
        return np.array([*found]), [*found.values()]

    def measure_sides(
        self, waves: Waves, along_mm: Floats, lr_pitch_mm: float
    ) -> tuple[Floats, list[HarmonicFit], list[HarmonicFit]]:
        """Fit the true and the folded wave together, each the mean of both sides."""
        found, true, folded = [], [], []
        for ring in known_phase.ring_indices(waves.ring):
            sides = []
            for side in (-1, 1):
                index = ring[side * along_mm[ring] > 0]
                values, constant = self.pixels.values[index], waves.background[index, :1]
                rad = waves.phase_rad[index]
                folded_rad = rad - side * 2 * np.pi * along_mm[index] / lr_pitch_mm
                sides.append(known_phase.fit_harmonic(values, constant, [rad, folded_rad]))
                sides.append(known_phase.fit_harmonic(values, constant, [folded_rad, rad]))
            one, folded_one, other, folded_other = sides
            if one and folded_one and other and folded_other:
                found.append(self.frequency_lpmm(waves.phase_rad[ring]))
                true.append(_mean_fit(one, other))
                folded.append(_mean_fit(folded_one, folded_other))
        return np.array(found), true, folded


def _mean_fit(one: HarmonicFit, other: HarmonicFit) -> HarmonicFit:
    modulation, std = (one.modulation + other.modulation) / 2, np.hypot(one.std, other.std) / 2
    return replace(one, modulation=modulation, std=float(std), count=one.count + other.count)
