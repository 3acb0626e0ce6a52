"""Numbers that are on levels: how far apart these are, and what a surface shares of it.

A converter rounds light, or the real and the imaginary part of a phasor; a file rounds distances.
Noise of a third of a step makes such errors independent; of less a surface shares them, whatever
frames there are, and no picture finds them.
"""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.reconstruction.problem import some_pixels

# So many pixels are asked.
MOST_PIXELS = 2048
# A drawing without noise has fewer levels from 0 on; so many of them have to be seen.
FEWEST_LEVELS, FEWEST_SEEN = 12, 3
# Of the largest number, steps that are finer count as none; and of a step, what arithmetic is off.
FINEST, ROUNDED = 1e-6, 0.02
# Of the error of rounding, so many that the rest is 1 % of its variance.
HARMONICS = np.arange(1, 61)
# Noise over a step, squared and less 1 / 12: little is shared of more, and it bends little between.
_DITHER = np.append(np.linspace(0.0, 0.02, 41), np.linspace(0.025, 0.5, 96))


def step_of(values: Array, used: Mask) -> float:
    """Return the distance between the levels that real numbers are on, 0 if they are on none.

    0 is a level of all converters and files.
    """
    some = np.sort(some_pixels(values, used, MOST_PIXELS))
    largest = float(np.abs(some).max(initial=0.0))
    between = np.diff(some)
    between = between[between > FINEST * largest]
    if between.size < FEWEST_SEEN - 1:
        return 0.0
    step = float(between.min())
    on_levels = np.all(np.abs(some / step - np.rint(some / step)) < ROUNDED)
    return step if on_levels and largest >= FEWEST_LEVELS * step else 0.0


def shared_rounding(step: float, sigma: Array) -> Floats:
    """Return the error that all pixels of a surface share if their numbers are so far apart.

        q^2 = step^2 / (2 pi^2) sum_k exp(-4 pi^2 k^2 d) / k^2,   d = sigma^2 / step^2 - 1 / 12

    step / sqrt(12) without noise; a third of a step of it dithers nearly all away. Source: Widrow
    and Kollar, Quantization Noise (2008).

    Parameters
    ----------
    sigma : noise, that of rounding in it
    """
    if step == 0.0:
        return np.zeros_like(sigma)
    k = HARMONICS[:, None]
    square = np.sum(np.exp(-4 * np.pi**2 * k**2 * _DITHER) / k**2, axis=0) / (2 * np.pi**2)
    dither = np.maximum(sigma**2 / step**2 - 1 / 12, 0.0)
    return np.asarray(step * np.sqrt(np.interp(dither, _DITHER, square, right=0.0)))


def within_rounding(values: Array, used: Mask) -> bool:
    """Return whether numbers [... frame row col] differ between frames by half a step at most.

    Then nothing tells where they lie, or moved: what is rounded alike stays with the pixels.
    """
    step = step_of(values, used)
    return step > 0.0 and apart_rms(values, used) <= step / 2


def apart_rms(values: Array, used: Mask) -> float:
    """Return by how much numbers [... frame row col] differ from the mean of frames, rms."""
    apart = values - values.mean(axis=-3, keepdims=True)
    on = np.broadcast_to(used.all(axis=-3, keepdims=True), values.shape)
    return float(np.sqrt(np.mean(apart[on] ** 2))) if on.any() else np.inf
