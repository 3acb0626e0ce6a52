"""MTF from a Siemens star: a sine of known phase is fitted to every ring around the centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.optical import MtfCurve
from lensshift.evaluation import known_phase
from lensshift.evaluation.known_phase import HarmonicFit, Pair, Pixels, Waves

_FEWEST_CYCLES = 5  # below, the wave is one of the terms of uneven light or next to it
# Harmonics beyond the Nyquist frequency alias, in each direction elsewhere: they are told apart as
# far as the sampling frequency, but for short arcs.
_BEYOND_NYQUIST = (2.0, 1.0)
_MIN_RINGS = 3
_RIM_PX = 2.0
_SURE = 3.0  # deviations
_BLUR_PX = 3  # rings of one pixel that the edge of a disc in the middle is blurred over


@dataclass(frozen=True, slots=True, eq=False)
class SiemensResult:
    """What a Siemens star shows, ring by ring; the rings run from the outside inwards.

    Parameters
    ----------
    mtf : [n] over all directions; `std` holds the scatter of the pixels and that of `contrast`
    center_px : centre of the star as (row, col)
    contrast, contrast_std : modulation at frequency 0, by which the curve was divided; levels
        that are given count as exact
    radius_mm : [n] mean radius of the pixels of a ring
    phase_rad : [n] against the mean phase; near pi the contrast is reversed
    count : [n] pixels in the ring
    residual : [n] rms of what the fit leaves, in the units of the image
    pixels_per_cycle : [n] below 2 the ring is beyond the Nyquist frequency of the image
    sectors : one curve a sector; the middle of sector k is at k / number of a turn from +col
        towards +row. The frequencies it shows run across that direction: sector 0 along the rows.
    """

    mtf: MtfCurve
    center_px: Pair
    contrast: float
    contrast_std: float
    radius_mm: Floats
    phase_rad: Floats
    count: NDArray[np.int64]
    residual: Floats
    pixels_per_cycle: Floats
    sectors: tuple[MtfCurve, ...]


def siemens_star_mtf(
    image: ArrayLike,
    *,
    cycles: int,
    pitch_mm: float | Pair,
    center_px: Pair | None = None,
    radius_range_mm: Pair | None = None,
    profile: Literal["sine", "square"] = "sine",
    levels: Pair | None = None,
    sectors: int = 0,
    valid: ArrayLike | None = None,
) -> SiemensResult:
    """Measure the MTF from a Siemens star.

        I(r, phi) = c0 + c1 cos phi + c2 sin phi + c3 cos 2 phi + c4 sin 2 phi
                    + a cos(n phi) + b sin(n phi)
        f(r) = n / (2 pi r),   MTF = sqrt(a^2 + b^2) / c0 / contrast

    in rings one pixel wide; c1 .. c4 take up uneven light. The odd harmonics of a square star are
    fitted too, up to the sampling frequency if they are told apart. `contrast` is the modulation
    at frequency 0: from `levels` (high - low) / (high + low), times 4 / pi for a square star; else
    extrapolated from the outer half of the radii, but for rings that the rim reaches, as
    `known_phase.contrast_at_zero` says. Its error says how far off other falls are that fit.

    Parameters
    ----------
    image : [row col], finite where valid, linear in the light and positive in the mean
    cycles : bright spokes of the star, n
    pitch_mm : pixel spacing, one or (row, col)
    center_px : (row, col); found to sub-pixel if not given
    radius_range_mm : rings used; if not given, from the Nyquist frequency of the image to the
        rim of the star, where its wave has half its greatest amplitude, or to the nearest border.
        Where the wave ends at once within, as at a disc in the middle, the rings end too
    profile : how the star was printed
    levels : values of (black, white) in large uniform areas
    sectors : directions measured apart, with at least two cycles each; 0 for none
    valid : [row col], False for pixels left out

    Raises
    ------
    ValueError
        If an argument is out of range, fewer than three rings can be fitted, or the star has
        another number of cycles.

    Warns
    -----
    QualityWarning
        If rings have fewer than 2 pixels a cycle, the search for the centre does not settle, the
        phase turns from ring to ring, or the wave ends at once at some radius.

    Source: ISO 12233:2014 (s-SFR); Loebich et al., Proc. SPIE 6502 (2007) 65020N.
    """
    _check_star(cycles, profile, sectors, radius_range_mm)
    pixels = known_phase.list_pixels(image, pitch_mm, valid)
    star = _Star(pixels, cycles, profile)
    center, radii_mm = _place(star, center_px, radius_range_mm)
    row_mm, col_mm = pixels.place_mm(center)
    radius_mm, angle_rad = np.hypot(row_mm, col_mm), np.arctan2(row_mm, col_mm)
    _check_reach(star, radii_mm, float(radius_mm.max()))
    waves = star.waves(radii_mm, row_mm, col_mm)
    waves, rings_mm, fits = _printed(star, waves, radius_mm, radii_mm, cut=not radius_range_mm)
    pixels_per_cycle = star.pixels_per_cycle(rings_mm)
    if coarse := int(np.count_nonzero(pixels_per_cycle < 2)):
        count = len(pixels_per_cycle)
        warn_quality(f"{coarse} of {count} rings of the star have fewer than 2 pixels a cycle")
    frequency_lpmm = star.frequency_lpmm(rings_mm)
    inner = _beyond_rim(star, rings_mm, radii_mm, center) if not radius_range_mm else 0
    outer = max(inner + _MIN_RINGS, int(np.count_nonzero(rings_mm >= rings_mm[0] / 2)))
    used = slice(inner, outer)
    contrast = known_phase.contrast_at_zero(frequency_lpmm[used], fits[used], levels, profile)
    places = [center, *(() if center_px else _starts_px(pixels))]
    _refuse_other_star(star, places, radii_mm[1])
    known_phase.warn_if_out_of_step(fits, f"the number of {cycles} cycles")
    curves = []
    for k in range(sectors):
        part = _sector(waves, angle_rad - 2 * np.pi * k / sectors, np.pi / sectors)
        part_mm, found = star.measure(part, radius_mm)
        told = star.frequency_lpmm(part_mm), found, contrast, f"sector {k} of {sectors}"
        curves.append(known_phase.mtf_curve(*told))
    phasors = np.exp(1j * np.array([fit.phase_rad for fit in fits]))
    mean = np.array([fit.modulation for fit in fits]) @ phasors
    mtf = known_phase.mtf_curve(frequency_lpmm, fits, contrast, "Siemens star")
    return SiemensResult(
        mtf, center, *contrast, rings_mm, phase_rad=np.angle(phasors * np.conj(mean)),
        count=np.array([fit.count for fit in fits], dtype=np.int64),
        residual=np.array([fit.residual for fit in fits]), pixels_per_cycle=pixels_per_cycle,
        sectors=tuple(curves),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Star:
    pixels: Pixels
    cycles: int
    profile: Literal["sine", "square"]

    @property
    def step_mm(self) -> float:
        """Width of a ring."""
        return max(self.pixels.pitch_mm)

    def frequency_lpmm(self, radius_mm: Floats) -> Floats:
        return self.cycles / (2 * np.pi * radius_mm)

    def pixels_per_cycle(self, radius_mm: Floats) -> Floats:
        return 2 * np.pi * radius_mm / (self.cycles * self.step_mm)

    def default_range_mm(self, center_px: Pair) -> Pair:
        return self.cycles * self.step_mm / np.pi, min(self.pixels.reach_mm(center_px))

    def waves(self, radii_mm: Pair, row_mm: Floats, col_mm: Floats) -> Waves:
        radius_mm, angle_rad = np.hypot(row_mm, col_mm), np.arctan2(row_mm, col_mm)
        used = (radius_mm >= radii_mm[0]) & (radius_mm <= radii_mm[1])
        inwards = np.floor((radii_mm[1] - radius_mm) / self.step_mm).astype(np.int64)
        over = self.cycles / np.maximum(radius_mm, radii_mm[0]) ** 2
        uneven = [wave(k * angle_rad) for k in (1, 2) for wave in (np.cos, np.sin)]
        return Waves(
            ring=np.where(used, inwards, -1),
            phase_rad=self.cycles * angle_rad,
            slope=np.column_stack([col_mm * over, -row_mm * over]),
            background=np.column_stack([np.ones_like(angle_rad), *uneven]),
        )

    def measure(self, waves: Waves, radius_mm: Floats) -> tuple[Floats, list[HarmonicFit]]:
        radii_mm, fits = [], []
        for index in known_phase.ring_indices(waves.ring):
            values, background = self.pixels.values[index], waves.background[index]
            mean_mm = radius_mm[index].mean()
            for beyond in _BEYOND_NYQUIST:
                per_cycle = beyond * float(self.pixels_per_cycle(mean_mm))
                orders = known_phase.printed_orders(self.profile, per_cycle)
                phases = [k * waves.phase_rad[index] for k in orders]
                fit = known_phase.fit_harmonic(values, background, phases)
                if fit is not None:
                    radii_mm.append(mean_mm)
                    fits.append(fit)
                    break
        return np.array(radii_mm), fits


def _place(star: _Star, center_px: Pair | None, radius_range_mm: Pair | None) -> tuple[Pair, Pair]:
    """Return the centre and the range of radii, found where they are not given."""
    values = star.pixels.values
    if np.ptp(values) == 0.0:  # it has no centre either
        raise ValueError(f"expected contrast, got {values[0]:.6g} in all pixels")
    center = center_px or _find_center_px(star, radius_range_mm)
    radii_mm = radius_range_mm or star.default_range_mm(center)
    if radius_range_mm is None and radii_mm[0] < radii_mm[1]:
        rim_mm = _rim_mm(star, center, radii_mm)
        if radii_mm[0] < rim_mm < radii_mm[1]:
            radii_mm = radii_mm[0], rim_mm
            # What surrounds the star has told of its place as well.
            center = center_px or _find_center_px(star, radii_mm)
    return center, radii_mm


def _check_reach(star: _Star, radii_mm: Pair, farthest_mm: float) -> None:
    if radii_mm[0] >= radii_mm[1]:
        raise ValueError(
            f"expected an image that reaches {radii_mm[0] / star.step_mm:.4g} px from the "
            f"centre of the star, where {star.cycles} cycles have 2 pixels each, got "
            f"{radii_mm[1] / star.step_mm:.4g} px"
        )
    if radii_mm[1] > farthest_mm + star.step_mm:
        raise ValueError(
            f"expected radii within the image, which ends {farthest_mm:.4g} mm from the centre "
            f"of the star, got {radii_mm[1]:.4g} mm"
        )


def _find_center_px(star: _Star, radius_range_mm: Pair | None) -> Pair:
    """Refine the better of two starts: an odd star on an even disc turns into neither."""

    def waves_about(start_px: Pair, row_mm: Floats, col_mm: Floats) -> Waves:
        return star.waves(radius_range_mm or star.default_range_mm(start_px), row_mm, col_mm)

    def energy(start_px: Pair) -> float:
        place_mm = star.pixels.place_mm(start_px)
        _, fits = star.measure(waves_about(start_px, *place_mm), np.hypot(*place_mm))
        return sum(fit.count * fit.modulation**2 for fit in fits)

    start_px = max(_starts_px(star.pixels), key=energy)
    return known_phase.refine_center_px(star.pixels, start_px, partial(waves_about, start_px))


def _starts_px(pixels: Pixels) -> list[Pair]:
    return [known_phase.symmetry_center_px(pixels, parity) for parity in (1, -1)]


def _refuse_other_star(star: _Star, places_px: Sequence[Pair], rim_mm: float) -> None:
    """Refuse a star whose pixels wave with another number of cycles than was told.

    The phase of a star is the same at all radii: the outer half of the pixels, added up by their
    angle alone, is its wave, about the right one of some places for its centre.
    """
    pixels, powers = star.pixels, []
    count = int(2.0 * np.pi * rim_mm / min(pixels.pitch_mm))  # as many angles as pixels at the rim
    for place_px in places_px:
        row_mm, col_mm = pixels.place_mm(place_px)
        radius_mm = np.hypot(row_mm, col_mm)
        outer = (radius_mm <= rim_mm) & (radius_mm >= 0.5 * rim_mm)
        turn = np.arctan2(row_mm, col_mm)[outer] / (2.0 * np.pi) % 1.0
        values = pixels.values[outer] - pixels.values[outer].mean()
        wave = np.bincount((turn * count).astype(np.intp), values, minlength=count)
        powers.append(np.abs(np.fft.rfft(wave)[: count // 2]))
    power = np.max([one[: min(map(len, powers))] for one in powers], axis=0)
    power[:_FEWEST_CYCLES] = 0.0
    seen = int(np.argmax(power))
    if seen != star.cycles:
        raise ValueError(f"expected a star of {star.cycles} cycles, got one of {seen}")


def _rim_mm(star: _Star, center_px: Pair, radii_mm: Pair) -> float:
    """Return the outer radius of the star within a range of radii.

    Outside no wave of its spokes is seen: from the border inwards, rings are left out up to the
    first of half the greatest amplitude and two pixels more, which the blur of the rim reaches.
    Where the outermost ring shows less than one two pixels farther in, of finer lines, that blur
    reaches it from a rim at the border.
    """
    place_mm = star.pixels.place_mm(center_px)
    rings_mm, fits = star.measure(star.waves(radii_mm, *place_mm), np.hypot(*place_mm))
    waved = np.array([fit.modulation for fit in fits])
    if len(fits) <= _RIM_PX:
        return radii_mm[1]
    inner = fits[round(_RIM_PX)]
    less = inner.modulation - waved[0] > _SURE * np.hypot(inner.std, fits[0].std)
    if waved[0] >= 0.5 * waved.max() and not less:
        return radii_mm[1]
    return float(rings_mm[np.argmax(waved >= 0.5 * waved.max())]) - _RIM_PX * star.step_mm


def _beyond_rim(star: _Star, rings_mm: Floats, radii_mm: Pair, center_px: Pair) -> int:
    """Return how many rings a rim within the image reaches, which tell no contrast.

    Of a wave of frequency f a spread farther than 1 / (2 pi f) cancels; nearer, light is exchanged
    with what is beyond the rim. Twice that is left out, but never more than half the star.
    """
    if radii_mm[1] >= star.default_range_mm(center_px)[1]:
        return 0
    away_mm = radii_mm[1] + _RIM_PX * star.step_mm - rings_mm
    reached = away_mm < 2.0 * rings_mm / star.cycles
    outer = int(np.count_nonzero(rings_mm >= rings_mm[0] / 2))
    return max(min(int(np.count_nonzero(reached)), outer - _MIN_RINGS - 2), 0)


def _printed(
    star: _Star, waves: Waves, radius_mm: Floats, radii_mm: Pair, *, cut: bool
) -> tuple[Waves, Floats, list[HarmonicFit]]:
    """Return waves, radii and fits of the rings that show the star; `cut`: not of a disc in it."""
    rings_mm, fits = star.measure(waves, radius_mm)
    if len(fits) < _MIN_RINGS:
        raise ValueError(
            f"expected at least {_MIN_RINGS} rings with enough valid pixels between "
            f"{radii_mm[0]:.4g} and {radii_mm[1]:.4g} mm, got {len(fits)}"
        )
    printed = known_phase.printed_count(star.frequency_lpmm(rings_mm), fits, _BLUR_PX)
    if cut and printed < len(fits):
        rings_mm, fits = rings_mm[:printed], fits[:printed]
        waves = replace(waves, ring=np.where(radius_mm < rings_mm[-1], -1, waves.ring))
        warn_quality(
            f"the wave of the star ends within {rings_mm[-1]:.4g} mm of its centre, which is taken "
            "for a disc in the middle; give the radii if it is not",
            stacklevel=3,
        )
    return waves, rings_mm, fits


def _sector(waves: Waves, angle_rad: Floats, half_rad: float) -> Waves:
    """Keep the pixels about direction 0; over so short an arc uneven light is a slope."""
    away = np.angle(np.exp(1j * angle_rad)) / half_rad
    background = np.column_stack([np.ones_like(away), away])
    return replace(waves, ring=np.where(np.abs(away) < 1, waves.ring, -1), background=background)


def _check_star(cycles: int, profile: str, sectors: int, radii_mm: Pair | None) -> None:
    if cycles < _FEWEST_CYCLES:
        raise ValueError(f"expected a star of 5 cycles or more, got {cycles}")
    if profile not in ("sine", "square"):
        raise ValueError(f"expected the profile 'sine' or 'square', got {profile!r}")
    if sectors < 0 or sectors * 2 > cycles:
        raise ValueError(f"expected 0 to {cycles // 2} sectors for {cycles} cycles, got {sectors}")
    if radii_mm is not None and not 0 < radii_mm[0] < radii_mm[1]:
        raise ValueError(f"expected radii in mm that rise from above 0, got {radii_mm}")
