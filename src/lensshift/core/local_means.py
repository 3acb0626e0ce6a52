"""Means around each pixel, compiled: of small pictures SciPy's calls take longer than its sums.

    y_ij = sum_st w_s w_t x_(i+s)(j+t)

Beyond the border there are zeros, or the picture goes on as its mirror image, the border twice.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.arrays import Array

TRUNCATED = 4.0  # standard deviations of a Gaussian; beyond them are 6e-5 of it


def mean_around(values: Array, side_px: int, *, zeros: bool = False) -> Array:
    """Return the mean over a square [... row col] with an odd side, of real or complex values.

    Parameters
    ----------
    zeros : what lies beyond the border; else the mirror image
    """
    return _correlated(values, ("square", side_px), zeros=zeros)


def gaussian_around(values: Array, sigma_px: float) -> Array:
    """Return the mean [... row col] with the weights of a Gaussian; mirrored at the border."""
    return _correlated(values, ("gaussian", sigma_px), zeros=False)


def _correlated(values: Array, kind: tuple[str, float], *, zeros: bool) -> Array:
    """Return the weighted means in the precision of the values; all but floats are double."""
    waves = values.dtype.kind == "c"
    fine = np.float32 if values.dtype in (np.float32, np.complex64) else np.float64
    of_parts = np.result_type(fine, np.complex64) if waves else np.dtype(fine)
    whole = np.ascontiguousarray(values, of_parts)
    step = 2 if waves else 1  # real and imaginary part lie side by side
    flat = whole.view(fine).reshape(-1, values.shape[-2], step * values.shape[-1])
    out = np.empty_like(flat)
    _separable(flat, _weights(*kind, np.dtype(fine)), step, zeros, out)
    return out.view(of_parts).reshape(values.shape)


@lru_cache(maxsize=64)
def _weights(kind: str, size: float, dtype: np.dtype[Any]) -> Array:
    if kind == "square":
        return np.full(int(size), 1 / size, dtype)
    reach = int(TRUNCATED * size + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / size) ** 2)
    return np.asarray(weight / weight.sum(), dtype)


@njit(cache=True, nogil=True)
def _mirrored(place: int, count: int) -> int:
    within = place % (2 * count)
    return min(within, 2 * count - 1 - within)


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _separable(
    x: NDArray[Any], weight: NDArray[Any], step: int, zeros: bool, out: NDArray[Any]
) -> None:
    """Write the means [picture row col], down into a line and along it; a pixel has step parts."""
    count, rows, width = x.shape
    taps, cols = len(weight), width // step
    reach = taps // 2
    edge = reach * step
    line = np.zeros(width + 2 * edge, x.dtype)
    middle = line[edge : edge + width]
    for n in range(count):
        for i in range(rows):
            middle[:] = 0
            for k in range(taps):
                row = i + k - reach
                if row < 0 or row >= rows:
                    if zeros:
                        continue
                    row = _mirrored(row, rows)
                here, factor = x[n, row], weight[k]
                for j in range(width):
                    middle[j] += factor * here[j]
            if not zeros:
                for k in range(reach):
                    first, last = _mirrored(k - reach, cols), _mirrored(cols + k, cols)
                    for part in range(step):
                        line[k * step + part] = middle[first * step + part]
                        line[edge + width + k * step + part] = middle[last * step + part]
            to = out[n, i]
            to[:] = 0
            for k in range(taps):
                here, factor = line[k * step : k * step + width], weight[k]
                for j in range(width):
                    to[j] += factor * here[j]
