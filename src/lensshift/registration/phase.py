"""Phase correlation: where two frames lie to each other, without a first guess."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Mask, Shifts
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.registration.blocks import scatter_over_blocks
from lensshift.registration.likelihood import ShiftFit
from lensshift.registration.spectrum import Frequencies
from lensshift.registration.taper import taper_frames

# The least error that phase correlation is believed to have.
PHASE_SIGMA_PX = 0.005
# Aliases share the high frequencies with the scene; what lies below the first is mostly scene.
# Stars and fine print have nothing there, and are asked up to Nyquist.
BANDS_CYCLES_PER_PX = (0.18, 0.5)
# Frames that lie so share more than half of their power, or they are no copies of each other; and
# one shift fits clearly better than another if it leaves half as much.
_UNLIKE, _CLEARLY_BETTER = 0.5, 0.5
# Frames of one scene correlate by 0.97 and more at an SNR of 20, of different ones by 0.4 mostly.
_ALIKE, _FOREIGN = 0.8, 0.5
# Bins weaker than this part of the strongest one hold more noise than scene.
_LEAST_POWER = 1e-4
_PLANE_PASSES = 6  # of fitting the phase
# Above this the frames have structure along one direction only.
_WORST_CONDITION = 1e8
_REACH_OF_PEAK_PX = 0.5  # the fit may not leave the pixel of the peak
# Another peak of so much of the height may be the true one (scenes that repeat have 0.5 and more
# beside it, cards and textures up to 0.3), and one that is lower by less than so much noise.
_RIVAL_SHARE, _RIVAL_SIGMAS = 0.5, 4.0
_MOST_RIVALS = 12  # that are looked at


def phase_correlation(reference: Array, frame: Array) -> Shifts:
    """Return how far the content of `frame` moved against that of `reference`, (row, col).

        Y(f) = X(f) exp(-2 pi i f . d)

    The peak of the whitened cross power spectrum gives whole pixels and, on a padded transform,
    about a tenth of one; a weighted plane through the phases of the low frequencies, with the
    frames cut to what both see, gives the rest. Both steps use only frequencies that the pixels
    do not alias much. Where the frames are unlike at the shift that these tell, other peaks are
    asked, and all frequencies. No shift beyond a pixel is taken where frames that hardly moved are
    clearly more alike.

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
    low = BANDS_CYCLES_PER_PX[0]
    score = _score(reference, frame, low)
    peak_px = _at_peak(score, np.array(np.unravel_index(int(np.argmax(score)), score.shape)))
    found_px = _refined(reference, frame, peak_px, low)
    left = _misfit(reference, frame, found_px)
    if np.any(np.rint(peak_px)):
        # Spokes of a star pass for shifts by many; most bursts move by less than a pixel.
        rest_px = _refined(reference, frame, np.zeros(2), low)
        at_rest = _misfit(reference, frame, rest_px)
        if at_rest < _CLEARLY_BETTER * left:
            found_px, left = rest_px, at_rest
    if left < _UNLIKE:
        return found_px
    # Where frames share little of what they see, its peak is not the highest.
    peaks = [
        (_at_peak(score, peak), band)
        for band in BANDS_CYCLES_PER_PX
        for score in [_score(reference, frame, band)]
        for peak in _peaks(score)
    ]
    peak_px, band = min(peaks, key=lambda one: _misfit(reference, frame, one[0]))
    other_px = _refined(reference, frame, peak_px, band)
    clearly = _misfit(reference, frame, other_px) < _CLEARLY_BETTER * left
    return other_px if clearly else found_px


def _refined(reference: Array, frame: Array, shift_px: Shifts, band: float) -> Shifts:
    """Return a shift by the phases, from one that is right to a pixel."""
    whole = np.rint(shift_px).astype(np.intp)
    first, second = _overlap(reference, frame, whole)
    if min(first.shape) < 4:
        return shift_px
    return np.asarray(whole + _plane(first, second, shift_px - whole, band))


def _misfit(reference: Array, frame: Array, shift_px: Shifts) -> float:
    """Return what part of their power frames do not share, if one moved so: 0 to about 1."""
    from scipy.ndimage import shift

    whole = np.rint(shift_px).astype(np.intp)
    first, second = _overlap(reference, frame, whole)
    if min(first.shape) < 4:
        return np.inf
    moved = shift(first, shift_px - whole, order=3, mode="nearest")
    parts = [part[1:-1, 1:-1] for part in (moved, second)]
    one, two = (part - part.mean() for part in parts)
    power = float(np.sum(np.abs(one) ** 2) + np.sum(np.abs(two) ** 2))
    return float(np.sum(np.abs(one - two) ** 2)) / max(power, 1e-300)


def unlike_frames(frames: Array, phase_px: Shifts, reference: int) -> Mask:
    """Return which frames [frame] show another scene than most, or nothing.

    Where most are clearly like one of them, those that are not even half like it, moved as phase
    correlation says, at whatever gain; that they share less than half of what they see counts
    against them. Frames with more noise than scene are like none. `phase_px` [frame 2]: offsets
    against the reference.
    """
    count, shape = len(frames), frames.shape[1:]
    alike = frames / np.maximum(frames.std(axis=(1, 2), keepdims=True), 1e-300)
    for number in [reference, *np.delete(np.arange(count), reference)][: (count + 1) // 2]:
        moved_px = phase_px if number == reference else phase_shifts(frames, number)
        apart = [_misfit(alike[number], *one) for one in zip(alike, moved_px, strict=True)]
        shared = np.prod(np.maximum(1.0 - np.abs(moved_px) / shape, 0.0), axis=1)
        like = (1.0 - np.array(apart)) * np.minimum(1.0, 2.0 * shared)
        if 2 * np.count_nonzero(like > _ALIKE) > count > 2:
            return np.asarray(like < _FOREIGN)
    return np.zeros(count, np.bool_)


def phase_shifts(frames: Array, reference: int) -> Shifts:
    """Return the offsets [frame 2] of frames [frame row col] against one of them."""
    return np.stack([phase_correlation(frames[reference], frame) for frame in frames])


def phase_fit(frames: Array, valid: Mask, phase_px: Shifts, reference: int) -> ShiftFit:
    """Return phase correlation with one standard error for all, from parts of the sensor."""
    unit_px = np.ones((len(frames), 2))
    unit_px[reference] = 0.0

    # Four parts scatter twice as much as the whole.
    def estimate(part: Array, part_valid: Mask) -> tuple[Shifts, Shifts]:
        return phase_shifts(part, reference), 2.0 * PHASE_SIGMA_PX * unit_px

    factor = scatter_over_blocks(estimate, frames, valid, phase_px).factor
    covariance = np.diag((PHASE_SIGMA_PX * factor * unit_px).ravel() ** 2)
    return ShiftFit(phase_px, covariance, np.ones(len(frames)), 0.0, True)


def rival_shifts(frames: Array, offset_px: Shifts, reference: int) -> Shifts:
    """Return how far [frame 2] from its shift each frame may lie as well, or 0.

    Scenes that repeat have several peaks of the correlation, scenes of which the noise hides most
    have any. A peak counts if frames that lie there are alike, or as little as where found.

    Parameters
    ----------
    frames : [frame row col]
    offset_px : [frame 2] as found
    """
    rivals_px = np.zeros((len(frames), 2))
    for k in np.delete(np.arange(len(frames)), reference):
        pair = frames[reference], frames[k]
        found_px = offset_px[k] - offset_px[reference]
        alike = max(_UNLIKE, _misfit(*pair, found_px) / _CLEARLY_BETTER)
        score = _score(*pair, BANDS_CYCLES_PER_PX[0])
        for peak in _peaks(score):
            other_px = _at_peak(score, peak)
            away_px = np.rint(other_px - found_px)
            farther = np.hypot(*away_px) > np.hypot(*rivals_px[k])
            if farther and np.abs(away_px).max() > 1 and _misfit(*pair, other_px) < alike:
                rivals_px[k] = away_px
    return rivals_px


def _peaks(score: Array) -> NDArray[np.intp]:
    """Return where [peak 2] in the correlation the highest peaks are that may be the true one."""
    from scipy.ndimage import maximum_filter

    best = float(score.max())
    spread = MAD_TO_SIGMA * float(np.median(np.abs(score - np.median(score))))
    least = min(_RIVAL_SHARE * best, best - _RIVAL_SIGMAS * spread)
    maxima = np.argwhere((score == maximum_filter(score, 3, mode="wrap")) & (score >= least))
    return maxima[np.argsort(-score[tuple(maxima.T)])[:_MOST_RIVALS]]


def _windowed(image: Array) -> Array:
    """Return the image without its mean under a Hann window, which hides the borders."""
    window = np.outer(*(np.hanning(size + 2)[1:-1] for size in image.shape))
    return np.asarray(window * (image - np.average(image, weights=window)))


def _at_peak(score: Array, peak: NDArray[np.intp]) -> Shifts:
    """Return the shift of a peak, to a fraction of a pixel by a parabola."""
    found = np.empty(2)
    for axis, (at, count) in enumerate(zip(peak, score.shape, strict=True)):
        before, here, after = (
            np.take(score, (at + step) % count, axis=axis)[peak[1 - axis]] for step in (-1, 0, 1)
        )
        bend = before - 2.0 * here + after
        part = 0.5 * (before - after) / bend if bend < 0 else 0.0
        found[axis] = (at + part + count / 2) % count - count / 2
    return found


def _score(reference: Array, frame: Array, band: float) -> Array:
    """Return the phase correlation of a band for every shift of whole pixels, on twice the area."""
    padded = tuple(2 * size for size in reference.shape)
    cross = np.fft.fft2(_windowed(frame), padded)
    cross = cross * np.conj(np.fft.fft2(_windowed(reference), padded))
    size = np.abs(cross)
    weight = _low_pass(band, *np.meshgrid(*map(np.fft.fftfreq, padded), indexing="ij"))
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


def _plane(first: Array, second: Array, start_px: Shifts, band: float) -> Shifts:
    """Return the slope of the phase over the frequencies of a band, starting near the answer.

    The taper follows the content; a fixed one would pull the shift towards 0.
    """
    frames = np.stack([first, second])
    at = Frequencies.of(frames.shape, whole_plane=frames.dtype.kind == "c")
    frequency, low = at.own, at.weight * _low_pass(band, *at.own)
    shift_px = start_px.copy()
    for _ in range(_PLANE_PASSES):
        offset_px = np.stack([np.zeros(2), shift_px])
        spectra = taper_frames(frames, offset_px, own_mean=True).spectra
        cross = spectra[:, 1] * np.conj(spectra[:, 0])
        weight = low * np.abs(cross)
        moment = (frequency * weight) @ frequency.T
        if not np.linalg.cond(moment) < _WORST_CONDITION:
            break
        phase = np.angle(cross * np.exp(2j * np.pi * (shift_px @ frequency)))
        step_px = -np.linalg.solve(moment, frequency @ (weight * phase)) / (2 * np.pi)
        shift_px = shift_px + np.clip(step_px, -_REACH_OF_PEAK_PX, _REACH_OF_PEAK_PX)
    return shift_px


def _low_pass(band: float, row: Array, col: Array) -> Array:
    """Return a weight that keeps the frequencies (cycles/px) below a band."""
    return np.asarray(np.exp(-0.5 * (row**2 + col**2) / (0.5 * band) ** 2))
