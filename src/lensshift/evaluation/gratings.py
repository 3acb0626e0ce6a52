"""Contrast of bar gratings: a wave of known frequency and unknown direction in each group."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.optimize import minimize

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.optical import MtfCurve
from lensshift.evaluation import known_phase
from lensshift.evaluation.known_phase import HarmonicFit, Pixels
from lensshift.evaluation.limits import pitch_pair_mm

Box = tuple[int, int, int, int]  # row start, row stop, col start, col stop

_FEWEST_TO_EXTRAPOLATE = 3
_LEAST_CYCLES = 2.0  # in a region: with fewer, a wave is not told from uneven light
_MOST_OFF = 0.05  # of the frequency that is given; bars are printed better than that
_FOUND_SHARE = 0.6  # of the strongest wave: where that much is, there is the group
_FULL_SHARE = 0.9  # of the outermost lines of a region that must hold the wave
_END_CYCLES, _SIDE_PX = 0.5, 3  # left out at the ends of the bars' sequence, and of the bars
_LEAST_SHARE = 0.02  # of the spread of the picture, as an amplitude: weaker waves are edges


@dataclass(frozen=True, slots=True, eq=False)
class GratingResult:
    """Contrast of groups of bars, by rising frequency.

    Parameters
    ----------
    mtf : [n] along the normal of the bars
    contrast, contrast_std : modulation at frequency 0, by which the curve was divided
    regions : [n] of the groups: row start, row stop, col start, col stop
    angle_rad : [n] of the normal, from +col towards +row
    found_lpmm : [n] frequencies at which the waves fit best, to within 5 % of those given
    """

    mtf: MtfCurve
    contrast: float
    contrast_std: float
    regions: tuple[Box, ...]
    angle_rad: Floats
    found_lpmm: Floats


def gratings_mtf(
    image: ArrayLike,
    frequency_lpmm: Sequence[float],
    *,
    pitch_mm: float | tuple[float, float],
    regions: Sequence[Box | None] | None = None,
    profile: Literal["sine", "square"] = "square",
    levels: tuple[float, float] | None = None,
    lr_pitch_mm: float | tuple[float, float] | None = None,
    valid: ArrayLike | None = None,
) -> GratingResult:
    """Measure the contrast of groups of bars of known frequency.

        I = c0 + c1 row + c2 col + a cos p + b sin p,   p = 2 pi f (col cos t + row sin t)
        MTF = sqrt(a^2 + b^2) / c0 / contrast

    in each group, with the direction t and a few per cent of f for which it fits best. The odd
    harmonics of square bars are fitted too, up to the Nyquist frequency. `contrast` is the
    modulation at frequency 0 as in `siemens_star_mtf`.

    Parameters
    ----------
    image : [row col], finite where valid, linear in the light and positive in the mean
    frequency_lpmm : [n] of each group, cycles per pixel for a pitch of 1
    pitch_mm : pixel spacing, one or (row, col)
    regions : [n] inside each group, without the ends of its bars; found where None
    profile : how the bars were printed
    levels : values of (black, white) in large uniform areas; needed for fewer than three groups
    lr_pitch_mm : pixel spacing of the LR frames a picture was made of, of which bars may be aliases
    valid : [row col], False for pixels left out

    Raises
    ------
    ValueError
        If a frequency, a region or the levels do not fit, or a group is not found.

    Warns
    -----
    QualityWarning
        If bars are not resolved and their alias of the LR pixels stands where they were.
    """
    if profile not in ("sine", "square"):
        raise ValueError(f"expected a profile of sine or square, got {profile!r}")
    pixels = known_phase.list_pixels(image, pitch_mm, valid)
    wanted = np.asarray(frequency_lpmm, dtype=np.float64)
    places = list(regions) if regions is not None else [None] * wanted.size
    if wanted.ndim != 1 or wanted.size == 0 or len(places) != wanted.size:
        raise ValueError(
            f"expected a region or None for each frequency, got {len(places)} for {wanted.size}"
        )
    highest = 0.5 / min(pixels.pitch_mm)
    if not np.all((wanted > 0) & (wanted < highest)) or np.unique(wanted).size < wanted.size:
        raise ValueError(f"expected frequencies apart, above 0 and below {highest:.4g}")
    if levels is None and wanted.size < _FEWEST_TO_EXTRAPOLATE:
        raise ValueError(
            f"expected levels, or {_FEWEST_TO_EXTRAPOLATE} groups from which the contrast at "
            f"frequency 0 can be extrapolated, got {wanted.size}"
        )
    order = np.argsort(wanted)
    wanted, places = wanted[order], [places[k] for k in order]
    groups = [_measured(pixels, f, place, profile) for f, place in zip(wanted, places, strict=True)]
    for one, at in zip(groups, places, strict=True):
        if at is not None:
            _refuse_other_bars(pixels, one, lr_pitch_mm)
    _refuse_same_place([one for one, at in zip(groups, places, strict=True) if at is None])
    fits = [one.fit for one in groups]
    outer = max(_FEWEST_TO_EXTRAPOLATE, (len(fits) + 1) // 2)
    contrast = known_phase.contrast_at_zero(wanted[:outer], fits[:outer], levels, profile)
    angle_rad, found_lpmm = np.array([(one.angle_rad, one.frequency_lpmm) for one in groups]).T
    mtf = known_phase.mtf_curve(wanted, fits, contrast, "bar gratings")
    regions = tuple(one.region for one in groups)
    return GratingResult(mtf, *contrast, regions, angle_rad, found_lpmm)


@dataclass(frozen=True, slots=True)
class _Group:
    fit: HarmonicFit
    region: Box
    angle_rad: float
    frequency_lpmm: float


def _measured(pixels: Pixels, frequency_lpmm: float, place: Box | None, profile: str) -> _Group:
    region = _found(pixels, frequency_lpmm) if place is None else place
    top, bottom, left, right = region
    if not (0 <= top < bottom <= pixels.shape[0] and 0 <= left < right <= pixels.shape[1]):
        raise ValueError(f"expected a region within {pixels.shape}, got {region}")
    inside = pixels.within(region)
    middle = 0.5 * (top + bottom - 1), 0.5 * (left + right - 1)
    row_mm, col_mm = (one[inside] for one in pixels.place_mm(middle))
    values = pixels.values[inside]
    reach = np.ptp(row_mm), np.ptp(col_mm)
    if values.size < 16 or max(reach) * frequency_lpmm < _LEAST_CYCLES:
        raise ValueError(
            f"expected {_LEAST_CYCLES:g} cycles of {frequency_lpmm:.4g} or more in {region}"
            if place is not None
            else f"found no bars of {frequency_lpmm:.4g} along rows or columns with "
            f"{_LEAST_CYCLES:g} cycles or more between their ends; give their region"
        )
    background = np.column_stack([np.ones_like(row_mm), row_mm, col_mm])
    light = np.linalg.qr(background)[0]
    rest = values - light @ (light.T @ values)

    def phase_of(where: Floats) -> Floats:
        along_mm = row_mm * np.sin(where[0]) + col_mm * np.cos(where[0])
        return np.asarray(2.0 * np.pi * frequency_lpmm * (1.0 + where[1]) * along_mm)

    def strength(where: Floats) -> float:
        """Return minus what a wave explains beside the uneven light."""
        phase = phase_of(where)
        waves = np.column_stack([np.cos(phase), np.sin(phase)])
        waves -= light @ (light.T @ waves)
        told = waves.T @ rest
        return -float(told @ np.linalg.lstsq(waves.T @ waves, told)[0])

    step = 0.2 / (frequency_lpmm * float(np.hypot(*reach)))
    angles = np.arange(0.0, np.pi, step)
    start = angles[int(np.argmin([strength(np.array([t, 0.0])) for t in angles]))]
    best = minimize(
        strength, [start, 0.0], method="Nelder-Mead",
        bounds=[(start - 2 * step, start + 2 * step), (-_MOST_OFF, _MOST_OFF)],
        options={"initial_simplex": [[start, 0.0], [start + step / 2, 0.0], [start, 0.01]]},
    ).x  # fmt: skip
    f = frequency_lpmm * (1.0 + best[1])
    phase = phase_of(best)
    orders = known_phase.printed_orders(profile, 1.0 / (max(pixels.pitch_mm) * f))
    fit = known_phase.fit_harmonic(values, background, [order * phase for order in orders])
    if fit is None:
        raise ValueError(f"expected more pixels of the group of {frequency_lpmm:.4g} in {region}")
    return _Group(fit, region, float(best[0]), float(f))


def _refuse_other_bars(
    pixels: Pixels, group: _Group, lr_pitch_mm: float | tuple[float, float] | None
) -> None:
    """Refuse a region most of whose light waves with another frequency than was told.

    That which LR pixels make of the frequency is a finding, and warned of.
    """
    top, bottom, left, right = group.region
    inside = pixels.within(group.region)
    row, col = (pixels.row_px[inside] - top).astype(int), (pixels.col_px[inside] - left).astype(int)
    light = np.linalg.qr(np.column_stack([np.ones(row.size), row, col]))[0]
    box = np.zeros((bottom - top, right - left))
    box[row, col] = pixels.values[inside] - light @ (light.T @ pixels.values[inside])
    power = np.abs(np.fft.fft2(box)) ** 2
    near = ndimage.uniform_filter(power, 3, mode="wrap") * 9.0
    bins = [np.fft.fftfreq(n, 1.0 / n) for n in box.shape]
    # A cycle over the region is uneven light, and tells no frequency.
    near[np.hypot(bins[0][:, None], bins[1]) < _LEAST_CYCLES] = 0.0
    at = np.unravel_index(int(np.argmax(near)), box.shape)
    extent_mm = [n * pitch for n, pitch in zip(box.shape, pixels.pitch_mm, strict=True)]
    there = float(np.hypot(bins[0][at[0]] / extent_mm[0], bins[1][at[1]] / extent_mm[1]))
    slack = float(np.hypot(1.0 / extent_mm[0], 1.0 / extent_mm[1]))
    most = 2.0 * near[at] > 0.5 * power.sum()  # with its mirrored twin
    slack += _MOST_OFF * group.frequency_lpmm
    if not most or abs(there - group.frequency_lpmm) <= slack:
        return
    lr_mm = () if lr_pitch_mm is None else pitch_pair_mm(lr_pitch_mm)
    if any(abs(abs(1.0 / one - group.frequency_lpmm) - there) <= slack for one in lr_mm):
        warn_quality(
            f"bars of {group.frequency_lpmm:.4g} in {group.region} are not resolved: the lines "
            f"there, of about {there:.3g}, are what pixels of {max(lr_mm):.4g} make of them"
        )
        return
    raise ValueError(
        f"expected bars of {group.frequency_lpmm:.4g} in {group.region}, those there have "
        f"about {there:.3g}: is it the region of another group?"
    )


def _refuse_same_place(found: Sequence[_Group]) -> None:
    """Refuse groups found at one place: strong bars have some of every frequency at their ends."""
    for one, other in itertools.combinations(found, 2):
        tops, bottoms, lefts, rights = zip(one.region, other.region, strict=True)
        shared = max(min(bottoms) - max(tops), 0) * max(min(rights) - max(lefts), 0)
        areas = np.subtract(bottoms, tops) * np.subtract(rights, lefts)
        if 2 * shared > min(areas):
            raise ValueError(
                f"found bars of {one.frequency_lpmm:.4g} and of {other.frequency_lpmm:.4g} at one "
                f"place, {one.region}: are both in the image? Give their regions"
            )


def _found(pixels: Pixels, frequency_lpmm: float) -> Box:
    """Return where a wave of a frequency along rows or columns is strongest."""
    image = np.full(pixels.shape, pixels.values.mean())
    image[pixels.row_px, pixels.col_px] = pixels.values
    best, strongest, inset_px = image, -1.0, (0, 0)
    for axis in (0, 1):
        period_px = 1.0 / (frequency_lpmm * pixels.pitch_mm[axis])
        smooth = image - ndimage.gaussian_filter(image, period_px)
        place = np.arange(pixels.shape[axis])
        wave = np.exp(-2j * np.pi * place / period_px)
        turned = smooth * (wave[:, None] if axis == 0 else wave)
        near = np.abs(ndimage.gaussian_filter(turned, 0.75 * period_px, mode="constant"))
        if near.max() > strongest:
            best, strongest = near, float(near.max())
            last = int(np.ceil(_END_CYCLES * period_px))
            inset_px = (last, _SIDE_PX) if axis == 0 else (_SIDE_PX, last)
    if strongest < _LEAST_SHARE * float(np.std(image)) or np.ptp(pixels.values) == 0.0:
        raise ValueError(f"found no bars of frequency {frequency_lpmm:.4g}; give their region")
    labels, _ = ndimage.label(best >= _FOUND_SHARE * strongest)
    own = labels == labels[np.unravel_index(int(np.argmax(best)), best.shape)]
    rows, cols = ndimage.find_objects(own.astype(int))[0]
    ends = [rows.start, rows.stop, cols.start, cols.stop]
    for _ in range(sum(pixels.shape)):  # cut the emptiest side until all are full
        part = own[ends[0] : ends[1], ends[2] : ends[3]]
        if min(part.shape) < 3:
            break
        full = [part[0].mean(), part[-1].mean(), part[:, 0].mean(), part[:, -1].mean()]
        worst = int(np.argmin(full))
        if full[worst] >= _FULL_SHARE:
            break
        ends[worst] += 1 if worst % 2 == 0 else -1
    inset = [min(px, (stop - start) // 4) for px, start, stop in
             zip(inset_px, ends[::2], ends[1::2], strict=True)]  # fmt: skip
    return ends[0] + inset[0], ends[1] - inset[0], ends[2] + inset[1], ends[3] - inset[1]
