"""Compiled weighted medians, and the median of 3 x 3 pixels, for reweighting."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.arrays import Array

# Of more values than this, evenly spread ones are taken: the median of so many Gaussian values is
# good to 1.253 / sqrt(2^13) = 1.4 % of their standard deviation.
ENOUGH = 1 << 13
# Single precision is exhausted after so many.
HALVINGS = 24


def weighted_median(values: Array, weights: Array) -> float:
    """Return below what lies half of the weight, in single precision; 0 if there is no weight."""
    return float(_median(_some(values), _some(weights)))


def weighted_mad(values: Array, weights: Array) -> float:
    """Return the weighted median of |v - m|, m the weighted median; 0 if there is no weight."""
    values, weights = _some(values), _some(weights)
    return float(_median(np.abs(values - np.float32(_median(values, weights))), weights))


def _some(values: Array) -> NDArray[np.float32]:
    return np.array(values.ravel()[:: max(1, values.size // ENOUGH) | 1], np.float32)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _median(values: Array, weights: Array) -> float:
    """Halve the range of the values again and again."""
    low, high = values[0], values[0]
    for n in range(values.size):
        low, high = min(low, values[n]), max(high, values[n])
    half = np.float32(0.5) * weights.sum()
    if not half > 0:
        return 0.0
    for _ in range(HALVINGS):
        middle = np.float32(0.5) * (low + high)
        below = np.float32(0.0)
        for n in range(values.size):
            below += weights[n] if values[n] <= middle else np.float32(0.0)
        if below < half:
            low = middle
        else:
            high = middle
    return float(high)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def median_3x3(image: Array, factor: float, out: Array) -> None:
    """Write factor times the 3 x 3 median of an image into out, zeros outside.

    Each column of three is sorted; the median of the nine is the median of the greatest of the
    low ones, the median of the middle ones and the least of the high ones. No branches, so that
    the loops vectorise. Source: Paeth, in Graphics Gems, 1990.
    """
    rows, cols = image.shape
    low, middle, high = (
        np.zeros(cols + 2, image.dtype), np.zeros(cols + 2, image.dtype),
        np.zeros(cols + 2, image.dtype),
    )  # fmt: skip
    zero = np.zeros(cols, image.dtype)
    for i in range(rows):
        above = image[i - 1] if i > 0 else zero
        here = image[i]
        below = image[i + 1] if i + 1 < rows else zero
        lows, middles, highs = low[1 : cols + 1], middle[1 : cols + 1], high[1 : cols + 1]
        for j in range(cols):
            p, q, r = above[j], here[j], below[j]
            less, more = min(p, q), max(p, q)
            lows[j] = min(less, r)
            highs[j] = max(more, r)
            middles[j] = max(less, min(more, r))
        target = out[i]
        low_left, low_right = low[:cols], low[2:]
        mid_left, mid_right = middle[:cols], middle[2:]
        high_left, high_right = high[:cols], high[2:]
        for j in range(cols):
            a = max(low_left[j], max(lows[j], low_right[j]))
            c = min(high_left[j], min(highs[j], high_right[j]))
            less, more = min(mid_left[j], middles[j]), max(mid_left[j], middles[j])
            b = max(less, min(more, mid_right[j]))
            less, more = min(a, b), max(a, b)
            target[j] = factor * max(less, min(more, c))
