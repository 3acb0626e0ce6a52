"""Compiled kernels for differences between neighbouring HR pixels.

A direction (row, col) and its opposite give the same differences with the other sign, so one of
each pair is kept: `half_plane`. Arrays of differences are [direction row col], the difference
from pixel (row, col) to its neighbour in that direction; where the neighbour would lie outside
the image they are zero. The kernels work row by row through a small buffer, because a loop that
scatters into two rows at once does not vectorise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]
Directions = NDArray[np.int64]


def half_plane(window: int) -> Directions:
    """Return one direction (row, col) of each pair within `window` HR pixels, rows downwards.

    window 1 gives (0, 1), (1, 0), (1, 1), (1, -1).
    """
    if window < 1:
        raise ValueError(f"expected a window of at least 1 HR pixel, got {window}")
    steps = range(-window, window + 1)
    pairs = [(row, col) for row in steps for col in steps if (row, col) > (0, 0)]
    return np.array(sorted(pairs, key=lambda d: (abs(d[0]) + abs(d[1]), d[0], -d[1])), np.int64)


@njit(cache=True, fastmath=True, nogil=True)  # type: ignore[untyped-decorator]
def differences(x: Array, directions: Directions, out: Array) -> None:
    """Write the differences of an image [row col] into out [direction row col]."""
    rows, cols = x.shape
    for d in range(len(directions)):
        down, right = directions[d]
        first, last = max(0, -right), min(cols, cols - right)
        for i in range(rows):
            for j in range(cols):
                out[d, i, j] = 0
            if i + down < rows:
                for j in range(first, last):
                    out[d, i, j] = x[i + down, j + right] - x[i, j]


@njit(cache=True, fastmath=True, nogil=True)  # type: ignore[untyped-decorator]
def add_differences_adjoint(e: Array, directions: Directions, out: Array) -> None:
    """Add the adjoint of `differences`, [direction row col] to [row col], to out."""
    rows, cols = out.shape
    for d in range(len(directions)):
        down, right = directions[d]
        first, last = max(0, -right), min(cols, cols - right)
        for i in range(rows - down):
            for j in range(first, last):
                out[i, j] -= e[d, i, j]
            for j in range(first, last):
                out[i + down, j + right] += e[d, i, j]


@njit(cache=True, fastmath=True, nogil=True)  # type: ignore[untyped-decorator]
def add_weighted_laplacian(x: Array, a: Array, directions: Directions, out: Array) -> None:
    """Add sum_d D_d^T a_d D_d x to out; a [direction row col] real, x and out [row col]."""
    rows, cols = x.shape
    e = np.empty(cols, x.dtype)
    for i in range(rows):
        for d in range(len(directions)):
            down, right = directions[d]
            if i + down >= rows:
                continue
            first, last = max(0, -right), min(cols, cols - right)
            for j in range(first, last):
                e[j] = a[d, i, j] * (x[i + down, j + right] - x[i, j])
            for j in range(first, last):
                out[i, j] -= e[j]
            for j in range(first, last):
                out[i + down, j + right] += e[j]


@njit(cache=True, fastmath=True, nogil=True)  # type: ignore[untyped-decorator]
def add_laplacian_diagonal(a: Array, directions: Directions, out: Array) -> None:
    """Add the diagonal of sum_d D_d^T a_d D_d to out [row col]."""
    rows, cols = out.shape
    for i in range(rows):
        for d in range(len(directions)):
            down, right = directions[d]
            if i + down >= rows:
                continue
            first, last = max(0, -right), min(cols, cols - right)
            for j in range(first, last):
                out[i, j] += a[d, i, j]
            for j in range(first, last):
                out[i + down, j + right] += a[d, i, j]
