"""Whole turns of the phase that the camera got wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.local_means import mean_around
from lensshift.reconstruction.learned.reach import nearest
from lensshift.reconstruction.phasor.frames import PolarFrames

WINDOW_PX = 9
# Cameras compare several modulation frequencies to count the turns; where a phase is as noisy as
# this, the count is a guess. Brighter pixels keep theirs: they may be small objects.
DOUBTFUL_SNR = 30.0
# Where so many pairs of frames have the same turn at a pixel, around, the count was no guess.
# A pixel takes part if its turn is that of such a share of the 3 x 3 around, over all frames.
AGREEMENT, NEAR_PX, SHARED = 0.67, 5, 0.25


def settle_turns(frames: PolarFrames, noise_sigma: float) -> PolarFrames:
    """Return the frames with dark pixels turned as most of their surroundings are.

        phi = theta + w + 2 pi n,   |w| <= pi,   n -> the most frequent n around, over all frames

    with the direction theta of the mean phasor around, where the amplitude is below 30 sigma and
    the frames disagree: a dark surface that all of them see a turn nearer is a turn nearer.
    The phasors stay what they are; only which distance a phase stands for changes.

    Parameters
    ----------
    frames : those that are circular have no turns to get wrong
    noise_sigma : of a component of a phasor, in units of the amplitude
    """
    known = frames.amplitude > 0
    seen_rad = frames.phase_rad[known]
    if frames.scale.circular or seen_rad.size == 0 or np.ptp(seen_rad) < np.pi:
        return frames
    theta = np.angle(_around(frames.phasor.real) + 1j * _around(frames.phasor.imag))
    within = np.angle(np.exp(1j * (frames.phase_rad - theta)))
    turns = np.rint((frames.phase_rad - theta - within) / (2.0 * np.pi))
    usual, most = np.zeros(theta.shape), np.zeros(theta.shape)
    for number in np.unique(turns[known]):
        count = _around(((turns == number) & known).astype(np.float64))
        usual, most = np.where(count > most, number, usual), np.maximum(count, most)
    doubtful = known & (frames.amplitude < DOUBTFUL_SNR * noise_sigma) & ~_agreed(turns, known)
    settled = theta + within + 2.0 * np.pi * usual
    return replace(frames, phase_rad=np.where(doubtful, settled, frames.phase_rad))


def nearest_turns(
    phase_rad: Array, frames: PolarFrames, used: Mask, offset_px: Array, scale: int
) -> Floats:
    """Return the phases [row col] of a picture in the turn of the frames around.

        n = argmax sum_c cos^2((phi - phi_c) / 2) over the frames' pixels c nearby with turn n

    Each frame gives the pixel that an HR pixel lies in and the four beside it. Those of another
    surface have another phase and hardly a vote, unless theirs is the same within a turn as well.

    Parameters
    ----------
    phase_rad : [row col] within -pi .. pi
    frames : with their turns settled; circular ones have none
    used : [frame row col] pixels that may vote
    offset_px : [frame 2]
    scale : HR pixels per LR pixel
    """
    frame_rad = np.where(used, frames.phase_rad, 0.0)
    if frames.scale.circular or np.all(np.abs(frame_rad) < np.pi):
        return np.asarray(phase_rad, np.float64)
    votes: dict[int, Array] = {}
    for k, moved_px in enumerate(offset_px):
        for beside in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
            at = np.ix_(*nearest(frame_rad.shape[1:], moved_px, scale, beside))
            seen = frame_rad[k][at]
            turn = np.rint((seen - phase_rad) / (2.0 * np.pi))
            vote = np.where(used[k][at], np.cos(0.5 * (seen - phase_rad)) ** 2, 0.0)
            for number in np.unique(turn):
                of_it = votes.setdefault(int(number), np.zeros(phase_rad.shape))
                of_it += np.where(turn == number, vote, 0.0)
    numbers = np.array(list(votes))
    most = numbers[np.argmax(np.stack(list(votes.values())), axis=0)]
    return np.asarray(phase_rad + 2.0 * np.pi * most)


def _agreed(turns: Array, known: Mask) -> Mask:
    """Return where [frame row col] frames have the same turns and close pixels have this one too.

    One pixel in a few that slips by itself has nobody beside it that did.
    """
    agree = np.zeros(turns.shape[1:])
    shared = np.zeros(turns.shape, np.bool_)
    total = _around(known.astype(np.float64), 3)
    for number in np.unique(turns[known]):
        alike = (turns == number) & known
        votes = alike.sum(axis=0)
        agree += votes * (votes - 1.0)
        shared |= alike & (_around(alike.astype(np.float64), 3) >= SHARED * total)
    pairs = known.sum(axis=0) * (known.sum(axis=0) - 1.0)
    around, counted = _around(agree[None], NEAR_PX), _around(pairs[None], NEAR_PX)
    return np.asarray(shared & (around > AGREEMENT * counted))


def _around(values: Array, window_px: int = WINDOW_PX) -> Array:
    """Return [row col]: the mean over all frames and a window; beyond the border all is 0."""
    return mean_around(values.mean(axis=0), window_px, zeros=True)
