"""Targets of known phase: fit a wave in each ring of pixels, find the centre, scale to 1.

Siemens stars and zone plates are measured with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.optical import MtfCurve
from lensshift.evaluation.limits import pitch_pair_mm

Pair = tuple[float, float]
Pitch = float | Pair  # one or (row, col)

_MAX_CONDITION = 10.0  # of the columns of one fit, each of norm 1; full rings have about 1.5
_MAX_CENTER_STEPS = 30
_CENTER_TOLERANCE_PX = 1e-4
# Of the fall that is seen: how much a cusp, as of diffraction, and a disc may make up. Above 1 what
# is left rises, as behind sharpening.
_SHAPES = np.linspace(0.0, 1.5, 31)
# The highest frequency seen, over the cut-off; beyond, a disc out of focus looks alike.
_CUTOFFS = np.linspace(0.0, 0.8, 28)[1:]
_DISC_ZERO_RAD = 3.8317  # of J1: a disc out of focus shows nothing there
_MIN_MODULATION = 1e-3  # of the lowest frequencies; below, the image does not hold the target
_SURE = 4.0  # deviations: noise of two quadratures exceeds them once in 3000
_ENDED = 0.2  # of the modulation that blur would have left
_LEAST_ENDING, _LEAST_BEYOND = 0.05, 3  # of the greatest modulation; rings that show nothing
_MOST_TURN_RAD = 0.1  # from ring to ring


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """The valid pixels of an image as lists: values [n], places row_px and col_px [n]."""

    values: Floats
    row_px: NDArray[np.intp]
    col_px: NDArray[np.intp]
    shape: tuple[int, int]
    pitch_mm: Pair

    def place_mm(self, center_px: Pair) -> tuple[Floats, Floats]:
        """Return row and col [n] of the pixels, counted from a centre."""
        row_mm = (self.row_px - center_px[0]) * self.pitch_mm[0]
        col_mm = (self.col_px - center_px[1]) * self.pitch_mm[1]
        return np.asarray(row_mm), np.asarray(col_mm)

    def within(self, box: tuple[int, int, int, int]) -> NDArray[np.bool_]:
        """Return which pixels lie in row start, row stop, col start, col stop [n]."""
        top, bottom, left, right = box
        rows = (self.row_px >= top) & (self.row_px < bottom)
        return np.asarray(rows & (self.col_px >= left) & (self.col_px < right))

    def reach_mm(self, center_px: Pair) -> Pair:
        """Return how far the image reaches on both sides of a centre, along (row, col)."""
        row_px, col_px = (min(c, n - 1 - c) for c, n in zip(center_px, self.shape, strict=True))
        if not min(row_px, col_px) >= 0:
            raise ValueError(f"expected a centre inside the image {self.shape}, got {center_px}")
        return row_px * self.pitch_mm[0], col_px * self.pitch_mm[1]


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """What a target should look like at n pixels, up to amplitude and phase of each ring."""

    ring: NDArray[np.int64]  # [n] from 0, -1 for pixels not used
    phase_rad: Floats  # [n] of the wave
    slope: Floats  # [n 2] change of the phase towards (row, col), in rad per mm
    background: Floats  # [n m] columns of the uneven light; the first is 1


@dataclass(frozen=True, slots=True)
class HarmonicFit:
    """Modulation (amplitude / mean) and phase of a wave in some pixels; see `fit_harmonic`."""

    modulation: float
    std: float
    phase_rad: float
    count: int
    residual: float


_SQUARE_FUNDAMENTAL = 4.0 / np.pi  # first harmonic of a square wave of amplitude 1


def printed_orders(profile: str, pixels_per_cycle: float) -> range:
    """Return the harmonics of a wave: of a "square" one those below the Nyquist frequency."""
    top = int(pixels_per_cycle / 2) if profile == "square" else 1
    return range(1, max(top, 1) + 1, 2)


# The waves at places row_mm [n], col_mm [n] from the centre.
Pattern = Callable[[Floats, Floats], Waves]


def list_pixels(image: ArrayLike, pitch_mm: Pitch, valid: ArrayLike | None) -> Pixels:
    """Return the valid pixels of a real image [row col]; `ValueError` if it is not one."""
    values = np.asarray(image)
    if values.dtype.kind not in "buif" or values.ndim != 2:
        raise ValueError(f"expected a real image [row col], got {values.dtype} {values.shape}")
    used = np.ones(values.shape, dtype=bool) if valid is None else np.asarray(valid, dtype=bool)
    if used.shape != values.shape:
        raise ValueError(f"expected valid of shape {values.shape}, got {used.shape}")
    row_px, col_px = np.nonzero(used)
    chosen = values[row_px, col_px].astype(np.float64)
    good = int(np.count_nonzero(np.isfinite(chosen)))
    if good == 0 or good < chosen.size:
        raise ValueError(f"expected finite valid pixels, got {good} of {chosen.size}")
    return Pixels(chosen, row_px, col_px, values.shape, pitch_pair_mm(pitch_mm))


def ring_indices(ring: NDArray[np.int64]) -> Iterator[NDArray[np.intp]]:
    """Yield the places of the pixels of each ring, by rising number; -1 is left out."""
    order = np.argsort(ring, kind="stable")
    order = order[np.searchsorted(ring[order], 0) :]
    if order.size:
        yield from np.split(order, np.flatnonzero(np.diff(ring[order])) + 1)


def fit_harmonic(
    values: Floats, background: Floats, phases_rad: Sequence[Floats]
) -> HarmonicFit | None:
    """Fit background and waves by least squares; return the first wave, None if ill-conditioned.

        value = sum_j c_j background_j + sum_k a_k cos(phase_k) + b_k sin(phase_k)
        modulation = sqrt(a_0^2 + b_0^2) / mean background

    The standard deviation is propagated from the scatter about the fit. None also where there are
    fewer than two pixels for each unknown.
    """
    waves = [wave(phase) for phase in phases_rad for wave in (np.cos, np.sin)]
    design = np.column_stack([*waves, background])
    count, unknowns = design.shape
    norm = np.linalg.norm(design, axis=0)
    if count < 2 * unknowns or not np.all(norm > 0):
        return None
    u, singular, vt = np.linalg.svd(design / norm, full_matrices=False)
    if singular[0] > _MAX_CONDITION * singular[-1]:
        return None
    root = vt.T / singular / norm[:, None]  # root root^T = (design^T design)^-1
    coefficients = root @ (u.T @ values)
    left = values - design @ coefficients
    mean_columns = background.mean(axis=0)
    level = float(mean_columns @ coefficients[len(waves) :])
    if level <= 0:
        raise ValueError(f"expected an image with a positive mean, got {level:.3g} in one ring")
    amplitude = float(np.hypot(coefficients[0], coefficients[1]))
    phase_rad = float(np.arctan2(coefficients[1], coefficients[0]))
    modulation = amplitude / level
    change = np.zeros(unknowns)  # of the modulation with the coefficients
    change[:2] = np.cos(phase_rad) / level, np.sin(phase_rad) / level
    change[len(waves) :] = -modulation / level * mean_columns
    variance = np.sum((change @ root) ** 2) * (left @ left)
    std, residual = float(np.sqrt(variance / (count - unknowns))), float(np.sqrt(np.mean(left**2)))
    return HarmonicFit(modulation, std, phase_rad, count, residual)


def contrast_at_zero(
    frequency_lpmm: Floats,
    fits: Sequence[HarmonicFit],
    levels: Pair | None,
    profile: str = "sine",
) -> Pair:
    """Return the modulation at frequency 0 and its standard deviation.

    From the levels (low, high): (high - low) / (high + low), taken as exact; times 4 / pi for a
    square wave. Else extrapolated by

        log m = log contrast - a f - b f^2 + log |2 J1(z) / z|,   z = 2 pi f R

    f as halos fall, f^2 as a Gaussian and a pixel, J1 as a disc out of focus of radius R; or, for
    a f, with the fall of a perfect lens to a cut-off. A Gaussian alone is taken unless others fit
    better by two deviations; then the mean of each a or cut-off and R that is possible, as it fits.
    The error holds how far off they are, but nothing of what changes before the lowest frequency,
    as behind sharpening or a wide halo.
    """
    if levels is not None:
        low, high = levels
        if not 0 <= low < high < np.inf:
            raise ValueError(f"expected levels (low, high) with 0 <= low < high, got {levels}")
        factor = _SQUARE_FUNDAMENTAL if profile == "square" else 1.0
        return factor * (high - low) / (high + low), 0.0
    modulation = np.array([fit.modulation for fit in fits])
    std = np.array([fit.std for fit in fits])
    if np.min(modulation) < _MIN_MODULATION or np.median(modulation - _SURE * std) < 0.0:
        raise ValueError(
            f"expected contrast at low frequencies, got {np.min(modulation):.2g} with a scatter of "
            f"{np.median(std):.2g}: does the image show this pattern?"
        )
    place, weight = frequency_lpmm / frequency_lpmm[-1], modulation / std
    design = np.column_stack([weight, weight * place**2])
    solving = np.linalg.pinv(design)
    bend = float((solving @ (weight * np.log(modulation)))[1])
    known = _falls(place, bend, float(np.linalg.norm(solving[1])))
    told = weight * (np.log(modulation) - known)
    logs, bends = solving @ told.T
    misfits = np.sum((told.T - design @ (logs, bends)) ** 2, axis=0)
    # A cusp beside a Gaussian that rises is no lens, only two terms that cancel.
    possible = (bends * np.sign(bend) >= 0.0) | (np.arange(logs.size) < _SHAPES.size)
    logs, misfits = logs[possible], misfits[possible]
    # How far the modulations are off beyond their own scatter is not known (Student's t).
    freedom, scale = len(fits) - 2, max(1.0, misfits.min() / (len(fits) - 2))
    likely = ((1.0 + misfits) / (1.0 + misfits.min())) ** (-0.5 * (freedom + 1))
    # The simplest, a Gaussian alone, as long as nothing fits better by two deviations.
    plain = misfits[0] - misfits.min() <= 4.0 * scale
    middle = float(logs[0] if plain else np.average(logs, weights=likely))
    apart = float(np.average((logs - middle) ** 2, weights=likely))
    contrast, noise = float(np.exp(middle)), float(np.linalg.norm(solving[0]))
    return contrast, contrast * float(np.sqrt(scale * noise**2 + apart))


def _falls(place: Floats, bend: float, bend_std: float) -> Floats:
    """Return what cusps or cut-offs, and discs [k] add to log m [k n], those of discs alone first.

    By `place`, the frequency over the highest, where log m bends by bend place^2 in all.
    """
    most = abs(bend) + 2.0 * bend_std
    cusps = np.copysign(most, bend) * _SHAPES
    discs_rad = np.minimum(np.sqrt(8.0 * most * _SHAPES), 0.97 * _DISC_ZERO_RAD)
    z = np.maximum(np.multiply.outer(discs_rad, place), 1e-6)
    discs = np.log(2.0 * special.j1(z) / z)
    first = np.multiply.outer(cusps, place)
    if bend < 0.0:
        u = np.multiply.outer(_CUTOFFS, place)
        perfect = 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u * u))
        first = np.concatenate([first, np.log(perfect)])
    return np.asarray((first[:, None, :] + discs).reshape(-1, place.size))


def printed_count(frequency_lpmm: Floats, fits: Sequence[HarmonicFit], apart: int) -> int:
    """Return how many of the fits, by rising frequency, lie on the print of the wave.

    Where the print ends (at a disc in the middle of a star, at the rim of a plate) the wave is gone
    within a few pixels and stays away. Blur lets it fade, log m about straight over f^2 (Gaussian)
    or m over f (diffraction, to its cut-off): within `apart` fits from the last that counts it must
    fall to a fifth of either, or to noise.
    """
    modulation = np.array([fit.modulation for fit in fits])
    std = np.array([fit.std for fit in fits])
    for last in range(apart, len(fits) - apart - _LEAST_BEYOND + 1):
        before, after = last - apart, last + apart
        if min(modulation[before], modulation[last]) <= 0.0:
            continue
        ratio = min(float(modulation[last] / modulation[before]), 1.0)
        run, run_squared = (
            (f[after] - f[last]) / (f[last] - f[before])
            for f in (frequency_lpmm, frequency_lpmm**2)
        )
        left = modulation[last] * min(ratio**run_squared, 1.0 - run * (1.0 / ratio - 1.0))
        noise = _SURE * std[after:]
        surely = left > max(_LEAST_ENDING * modulation.max(), 2.5 * float(noise.max()))
        if surely and np.all(modulation[after:] < np.maximum(_ENDED * left, noise)):
            return last + 1
    return len(fits)


def warn_if_out_of_step(fits: Sequence[HarmonicFit], wrong: str) -> None:
    """Warn if the phase turns from ring to ring, which no blur does: the fitted wave is another."""
    seen = [fit for fit in fits if fit.modulation > _SURE * fit.std]
    if len(seen) < 2:
        return
    phasors = np.exp(1j * np.array([fit.phase_rad for fit in seen]))
    turn_rad = float(np.median(np.abs(np.angle(phasors[1:] * np.conj(phasors[:-1])))))
    noise_rad = float(np.median([fit.std / fit.modulation for fit in seen]))
    if turn_rad > max(_MOST_TURN_RAD, _SURE * noise_rad):
        warn_quality(
            f"the wave turns by {turn_rad:.2g} rad from ring to ring: is {wrong} right?",
            stacklevel=3,
        )


def mtf_curve(
    frequency_lpmm: Floats, fits: Sequence[HarmonicFit], contrast: Pair, label: str
) -> MtfCurve:
    """Divide modulations by the contrast (value, std); both scatter into the standard deviation."""
    modulation = np.array([fit.modulation for fit in fits]) / contrast[0]
    std = np.hypot([fit.std for fit in fits], modulation * contrast[1]) / contrast[0]
    return MtfCurve(frequency_lpmm, modulation, std, label)


def symmetry_center_px(pixels: Pixels, parity: int) -> Pair:
    """Return the point, to half a pixel, that half a turn about maps an image best on itself.

    The convolution of the image with itself peaks at twice the centre; parity -1 looks for the
    point where the image turns into its negative.
    """
    rows, cols = pixels.shape
    image = np.zeros((rows, cols))
    image[pixels.row_px, pixels.col_px] = pixels.values - pixels.values.mean()
    size = (2 * rows, 2 * cols)
    folded = parity * np.fft.irfft2(np.fft.rfft2(image, size) ** 2, size)
    row, col = np.unravel_index(int(np.argmax(folded)), size)
    return float(row) / 2, float(col) / 2


def refine_center_px(pixels: Pixels, start_px: Pair, pattern: Pattern) -> Pair:
    """Return the centre for which the pattern, its rings free, leaves least; warn if in doubt."""
    center_px = start_px
    for _ in range(_MAX_CENTER_STEPS):
        waves = pattern(*pixels.place_mm(center_px))
        step_px = np.clip(_center_step_mm(pixels.values, waves) / pixels.pitch_mm, -1, 1)
        center_px = (center_px[0] + float(step_px[0]), center_px[1] + float(step_px[1]))
        if np.max(np.abs(step_px)) < _CENTER_TOLERANCE_PX:
            return center_px
    warn_quality(
        f"the centre still moves by {np.max(np.abs(step_px)):.2g} px a step: is the pattern as "
        "told? Else give center_px",
        stacklevel=4,
    )
    return center_px


def _center_step_mm(values: Floats, waves: Waves) -> Floats:
    normal, gain = np.zeros((2, 2)), np.zeros(2)
    for index in ring_indices(waves.ring):
        cos, sin = np.cos(waves.phase_rad[index]), np.sin(waves.phase_rad[index])
        design = np.column_stack([cos, sin, waves.background[index]])
        if len(index) < 2 * design.shape[1]:
            continue
        a, b, *_ = coefficients = np.linalg.lstsq(design, values[index], rcond=None)[0]
        left = values[index] - design @ coefficients
        # The pattern moves with the centre: phase(x - centre). What the free coefficients of the
        # ring can take up is projected out.
        change = (a * sin - b * cos)[:, None] * waves.slope[index]
        change -= design @ np.linalg.lstsq(design, change, rcond=None)[0]
        normal += change.T @ change
        gain += change.T @ left
    return np.asarray(np.linalg.lstsq(normal, gain, rcond=None)[0])
