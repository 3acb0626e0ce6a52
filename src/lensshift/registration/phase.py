"""Phase correlation: where two frames lie to each other, without a first guess."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.registration.blocks import scatter_over_blocks
from lensshift.registration.likelihood import ShiftFit
from lensshift.registration.spectrum import Frequencies
from lensshift.registration.taper import taper_frames

Shifts = NDArray[np.float64]

# The least error that phase correlation is believed to have.
PHASE_SIGMA_PX = 0.005
# Aliases share the high frequencies with the scene; what lies below this is mostly scene.
LOW_PASS_CYCLES_PER_PX = 0.18
# Bins weaker than this part of the strongest one hold more noise than scene.
_LEAST_POWER = 1e-4
_PLANE_PASSES = 6  # of fitting the phase
# Above this the frames have structure along one direction only.
_WORST_CONDITION = 1e8
_REACH_OF_PEAK_PX = 0.5  # the fit may not leave the pixel of the peak
# Another peak of so much of the height may be the true one (scenes that repeat have 0.5 and more
# beside it, cards and textures up to 0.3), and one that is lower by less than so much noise.
_RIVAL_SHARE, _RIVAL_SIGMAS = 0.5, 4.0


def phase_correlation(reference: Array, frame: Array) -> Shifts:
    """Return how far the content of `frame` moved against that of `reference`, (row, col).

        Y(f) = X(f) exp(-2 pi i f . d)

    The peak of the whitened cross power spectrum gives whole pixels and, on a padded transform,
    about a tenth of one; a weighted plane through the phases of the low frequencies, with the
    frames cut to what both see, gives the rest. Both steps use only frequencies that the pixels
    do not alias much.

    Parameters
    ----------
    reference, frame : [row col], real or complex, finite

    Raises
    ------
    ValueError
        If the shapes differ, or a frame is smaller than 4 x 4 pixels.

    Source: Kuglin and Hines (1975); plane fit of Stone et al., IEEE TGRS 39 (2001) 2235.
    """
    if reference.ndim != 2 or reference.shape != frame.shape or min(reference.shape) < 4:
        raise ValueError(
            f"expected two frames of one shape, 4 x 4 or more, got {reference.shape} and "
            f"{frame.shape}"
        )
    shift_px = _peak(reference, frame)
    whole = np.rint(shift_px).astype(np.intp)
    first, second = _overlap(reference, frame, whole)
    if min(first.shape) < 4:
        return shift_px
    return whole + _plane(first, second, shift_px - whole)


def phase_shifts(frames: Array, reference: int) -> Shifts:
    """Return the offsets [frame 2] of frames [frame row col] against one of them."""
    return np.stack([phase_correlation(frames[reference], frame) for frame in frames])


def phase_fit(
    frames: Array, valid: NDArray[np.bool_], phase_px: Shifts, reference: int
) -> ShiftFit:
    """Return phase correlation with one standard error for all, from parts of the sensor."""
    count = len(frames)
    unit_px = np.ones((count, 2))
    unit_px[reference] = 0.0

    # Four parts scatter twice as much as the whole.
    def estimate(part: Array, part_valid: NDArray[np.bool_]) -> tuple[Shifts, Shifts]:
        return phase_shifts(part, reference), 2.0 * PHASE_SIGMA_PX * unit_px

    factor = scatter_over_blocks(estimate, frames, valid, phase_px).factor
    sigma_px = PHASE_SIGMA_PX * factor * unit_px
    covariance = np.diag(sigma_px.ravel() ** 2)
    return ShiftFit(phase_px, covariance, np.ones(count), 0.0, True)


def rival_shifts(frames: Array, reference: int) -> Shifts:
    """Return how far [frame 2] from its peak another one lies that may be the true one, or 0.

    Scenes that repeat have several peaks, scenes of which the noise hides most have any.
    """
    from scipy.ndimage import maximum_filter

    rivals_px = np.zeros((len(frames), 2))
    for k, frame in enumerate(frames):
        score = _score(frames[reference], frame)
        peak = np.unravel_index(int(np.argmax(score)), score.shape)
        spread = MAD_TO_SIGMA * float(np.median(np.abs(score - np.median(score))))
        best = float(score[peak])
        least = min(_RIVAL_SHARE * best, best - _RIVAL_SIGMAS * spread)
        maxima = np.argwhere((score == maximum_filter(score, 3, mode="wrap")) & (score >= least))
        size = np.array(score.shape)
        away_px = (maxima - np.array(peak) + size // 2) % size - size // 2
        if len(away_px) > 1 and k != reference:
            # The one that is nearly as good, the farthest of them.
            rivals_px[k] = away_px[np.argmax(np.hypot(*away_px.T))]
    return rivals_px


def _windowed(image: Array) -> Array:
    """Return the image without its mean under a Hann window, which hides the borders."""
    rows, cols = (np.hanning(size + 2)[1:-1] for size in image.shape)
    window = rows[:, None] * cols
    mean = np.sum(window * image) / np.sum(window)
    tapered: Array = window * (image - mean)
    return tapered


def _peak(reference: Array, frame: Array) -> Shifts:
    """Return the peak of the phase correlation, to a fraction of a pixel by a parabola."""
    score = _score(reference, frame)
    peak = np.unravel_index(int(np.argmax(score)), score.shape)
    found = np.empty(2)
    for axis, (at, count) in enumerate(zip(peak, score.shape, strict=True)):
        before, here, after = (
            np.take(score, (at + step) % count, axis=axis)[peak[1 - axis]] for step in (-1, 0, 1)
        )
        bend = before - 2.0 * here + after
        part = 0.5 * (before - after) / bend if bend < 0 else 0.0
        found[axis] = (at + part + count / 2) % count - count / 2
    return found


def _score(reference: Array, frame: Array) -> Array:
    """Return the phase correlation for every shift of whole pixels, on twice the area."""
    padded = tuple(2 * size for size in reference.shape)
    cross = np.fft.fft2(_windowed(frame), padded)
    cross = cross * np.conj(np.fft.fft2(_windowed(reference), padded))
    size = np.abs(cross)
    weight = _low_pass(*np.meshgrid(*map(np.fft.fftfreq, padded), indexing="ij"))
    # Half whitened: wholly whitened, the noise of empty bins counts as much as the scene.
    whitened = weight * cross / np.sqrt(np.maximum(size, _LEAST_POWER * size.max() + 1e-300))
    return np.asarray(np.real(np.fft.ifft2(whitened)))


def _overlap(reference: Array, frame: Array, whole: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the parts of both frames that see the same pixels of the scene."""
    first = second = ()  # type: tuple[slice, ...]
    for step, size in zip(whole, reference.shape, strict=True):
        first += (slice(max(0, -step), size - max(0, step)),)
        second += (slice(max(0, step), size - max(0, -step)),)
    return reference[first], frame[second]


def _plane(first: Array, second: Array, start_px: Shifts) -> Shifts:
    """Return the slope of the phase over the low frequencies, starting near the answer.

    The taper follows the content; a fixed one would pull the shift towards 0.
    """
    frames = np.stack([first, second])
    at = Frequencies.of(frames.shape, whole_plane=frames.dtype.kind == "c")
    # The bin in the middle of the aliases is the frequency itself.
    middle = at.down.shape[1] // 2
    frequency = np.stack([at.down[:, middle], at.right[:, middle]])
    low = at.weight * _low_pass(*frequency)
    shift_px = start_px.copy()
    for _ in range(_PLANE_PASSES):
        offset_px = np.stack([np.zeros(2), shift_px])
        spectra = taper_frames(
            frames, np.ones(frames.shape, np.bool_), offset_px, own_mean=True
        ).spectra
        cross = spectra[:, 1] * np.conj(spectra[:, 0])
        weight = low * np.abs(cross)
        moment = (frequency * weight) @ frequency.T
        if not np.linalg.cond(moment) < _WORST_CONDITION:
            break
        phase = np.angle(cross * np.exp(2j * np.pi * (shift_px @ frequency)))
        step_px = -np.linalg.solve(moment, frequency @ (weight * phase)) / (2 * np.pi)
        shift_px = shift_px + np.clip(step_px, -_REACH_OF_PEAK_PX, _REACH_OF_PEAK_PX)
    return shift_px


def _low_pass(row: Array, col: Array) -> Array:
    """Return a weight that keeps the low frequencies (cycles/px)."""
    width = 0.5 * LOW_PASS_CYCLES_PER_PX
    return np.asarray(np.exp(-0.5 * (row**2 + col**2) / width**2))
