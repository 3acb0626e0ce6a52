"""Whole turns of the phase that the camera got wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.reconstruction.phasor.frames import PolarFrames

Array = NDArray[Any]

WINDOW_PX = 9
# Cameras compare several modulation frequencies to count the turns; where a phase is as noisy as
# this, the count is a guess. Brighter pixels keep theirs: they may be small objects.
DOUBTFUL_SNR = 30.0


def settle_turns(frames: PolarFrames, noise_sigma: float) -> PolarFrames:
    """Return the frames with dark pixels turned as most of their surroundings are.

        phi = theta + w + 2 pi n,   |w| <= pi,   n -> the most frequent n around, over all frames

    with the direction theta of the mean phasor around, where the amplitude is below 30 sigma.
    The phasors stay what they are; only where the joint fit begins changes, and with it which
    distance a phase stands for.

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
    doubtful = known & (frames.amplitude < DOUBTFUL_SNR * noise_sigma)
    settled = theta + within + 2.0 * np.pi * usual
    return replace(frames, phase_rad=np.where(doubtful, settled, frames.phase_rad))


def _around(values: Array) -> Array:
    """Return [row col]: the mean over all frames and a window; beyond the border all is 0."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(values.mean(axis=0), WINDOW_PX, mode="constant"))
