"""Sums over the pixels around each, in the precision of the picture, on all cores."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
from numba import njit

from lensshift.core.arrays import Array
from lensshift.core.threads import bands, core_count, on_threads

WORTH_THREADS = 2**17  # pixels: below, waking a thread takes as long as the work
# Of a Gaussian, beyond which less than 1e-4 of it lies; so does SciPy.
TRUNCATED = 4.0


def mean_around(values: Array, size_px: int, *, mirrored: bool = False) -> Array:
    """Return the mean [... row col] over an odd window; beyond the border are zeros or a mirror."""
    return _around(values, (1.0 / size_px,) * (size_px // 2 + 1), mirrored=mirrored)


def gaussian_around(values: Array, sigma_px: float) -> Array:
    """Return the mean [... row col] weighed by a Gaussian; beyond the border is a mirror."""
    return _around(values, _gaussian(sigma_px), mirrored=True)


@lru_cache(maxsize=8)
def _gaussian(sigma_px: float) -> tuple[float, ...]:
    weight = np.exp(-0.5 * (np.arange(int(TRUNCATED * sigma_px + 0.5) + 1) / sigma_px) ** 2)
    return tuple((weight / (2 * weight.sum() - 1)).tolist())


def _around(values: Array, weight: tuple[float, ...], *, mirrored: bool) -> Array:
    """Return the sum over rows and columns with a weight by how far away they are."""
    found = np.empty(values.shape, values.dtype)
    kind, rows = values.real.dtype, values.shape[-2]
    parts = found.itemsize // kind.itemsize  # of a complex number, which lie side by side
    x, out = (np.ascontiguousarray(one).view(kind).reshape(-1, rows, parts * values.shape[-1])
              for one in (values, found))  # fmt: skip
    cores = core_count() if x.size >= WORTH_THREADS else 1
    weights = np.array(weight, kind)
    on_threads([
        partial(_sum_around, x, weights, parts, mirrored, *band, out)
        for band in bands(rows, cores)
    ])  # fmt: skip
    return found


@njit(cache=True, nogil=True, fastmath={"contract"})
def _sum_around(
    x: Array, weight: Array, parts: int, mirrored: bool, first: int, end: int, out: Array
) -> None:
    """Write rows `first` to `end` of the sums over the window of each picture into out."""
    rows, size = x.shape[1:]
    reach, margin = len(weight) - 1, (len(weight) - 1) * parts
    line = np.zeros(size + 2 * margin, x.dtype)
    middle = line[margin : margin + size]
    for n in range(len(x)):
        for row in range(first, end):
            middle[:] = weight[0] * x[n, row]
            for far in range(1, reach + 1):
                factor = weight[far]
                for at in (row - far, row + far):
                    if mirrored or 0 <= at < rows:
                        source = x[n, _mirrored(at, rows)]
                        for k in range(size):
                            middle[k] += factor * source[k]
            for k in range(margin if mirrored else 0):
                at = _mirrored(k // parts - reach, size // parts)
                line[k] = middle[at * parts + k % parts]
                at = _mirrored(size // parts + k // parts, size // parts)
                line[margin + size + k] = middle[at * parts + k % parts]
            to = out[n, row]
            to[:] = weight[0] * middle
            for far in range(1, reach + 1):
                left, right = line[margin - far * parts :], line[margin + far * parts :]
                factor = weight[far]
                for k in range(size):
                    to[k] += factor * (left[k] + right[k])


@njit(cache=True, nogil=True)
def _mirrored(at: int, size: int) -> int:
    """Return where the mirror image about the border, d c b a | a b c d | d c b a, has an index."""
    at %= 2 * size
    return at if at < size else 2 * size - 1 - at
