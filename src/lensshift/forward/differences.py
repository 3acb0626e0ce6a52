"""Differences between neighbouring HR pixels.

A direction (row, col) and its opposite give the same differences with the other sign, so one of
each pair is kept: `half_plane`. Arrays of differences are [direction row col], the difference
from pixel (row, col) to its neighbour in that direction; where the neighbour would lie outside
the image they are zero. The compiled kernels, for what changes with every step of a solver, work
row by row through a small buffer: a loop that scatters into two rows at once does not vectorise.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.arrays import Array

Directions = NDArray[np.int64]
Part = tuple[slice, ...]

_CORNER = np.sqrt(0.5)  # 1 / |(1, 1)|


def image_slopes(image: Array) -> tuple[Array, Array]:
    """Return how an image [row col] changes by a pixel along rows and columns.

    Along an axis of one pixel, as of a line of pixels, it does not.
    """
    row, col = (
        np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image)
        for axis in (0, 1)
    )
    return row, col


@lru_cache(maxsize=16)
def half_plane(window: int) -> Directions:
    """Return one direction (row, col) of each pair within `window` HR pixels, rows downwards.

    Read-only.

    window 1 gives (0, 1), (1, 0), (1, 1), (1, -1).
    """
    if window < 1:
        raise ValueError(f"expected a window of at least 1 HR pixel, got {window}")
    steps = range(-window, window + 1)
    pairs = [(row, col) for row in steps for col in steps if (row, col) > (0, 0)]
    pairs.sort(key=lambda d: (abs(d[0]) + abs(d[1]), d[0], -d[1]))
    directions = np.array(pairs, np.int64)
    directions.flags.writeable = False  # shared
    return directions


@njit(cache=True, fastmath=True, nogil=True)
def _overlap(right: int, cols: int) -> tuple[int, int]:
    """Return the first and last + 1 column that have a neighbour `right` columns away."""
    first = min(max(0, -right), cols)
    return first, max(first, min(cols, cols - right))


def differences(x: Array, directions: Directions) -> Array:
    """Return the differences [direction row col] of an image [row col], real or complex."""
    out = np.zeros((len(directions), *x.shape), x.dtype)
    for target, (here, there) in zip(out, neighbours(x.shape, directions), strict=True):
        np.subtract(x[there], x[here], out=target[here])
    return out


def laplacian(x: Array) -> Array:
    """Return sum_d D_d^T D_d x / |d| over `half_plane(1)`: of corners the differences count less.

    Each pixel times the weight of its neighbours, less these: a solver asks thousands of times.
    """
    rows, cols = x.shape
    around = np.zeros((rows + 2, cols + 2), x.dtype)
    # A level common to all, which has none, would leave its rounding.
    np.subtract(x, x[0, 0], out=around[1:-1, 1:-1])
    beside = around[:, :-2] + around[:, 2:]
    near = beside[:-2] + beside[2:]
    near *= x.real.dtype.type(_CORNER)
    near += beside[1:-1]
    near += around[:-2, 1:-1]
    near += around[2:, 1:-1]
    out: Array = around[1:-1, 1:-1] * _weight_around(x.shape, x.real.dtype)
    out -= near
    return out


@lru_cache(maxsize=64)
def _weight_around(shape: tuple[int, int], dtype: np.dtype[Any]) -> Array:
    """Return by how much the neighbours [row col] of a pixel that lie in the image count."""
    # Along an axis each has two neighbours, the first and the last one less.
    down, across = (2.0 - np.isin(np.arange(n), 0) - np.isin(np.arange(n), n - 1) for n in shape)
    weight: Array = down[:, None] + across + _CORNER * np.outer(down, across)
    return weight.astype(dtype)


def neighbours(shape: tuple[int, ...], directions: Directions) -> tuple[tuple[Part, Part], ...]:
    """Return the pixels that have a neighbour in each direction, and those neighbours."""
    return _neighbours(shape, tuple(map(tuple, directions.tolist())))


@lru_cache(maxsize=64)  # a solver asks thousands of times: of a small image half of its time
def _neighbours(
    shape: tuple[int, ...], directions: tuple[tuple[int, ...], ...]
) -> tuple[tuple[Part, Part], ...]:
    found = []
    for direction in directions:
        here, there = (
            tuple(slice(max(0, -way * s), max(0, n - max(0, way * s)))
                  for s, n in zip(direction, shape, strict=True))
            for way in (1, -1)
        )  # fmt: skip
        found.append((here, there))
    return tuple(found)


def add_weighted_laplacian(x: Array, a: Array, directions: Directions, out: Array) -> None:
    """Add sum_d D_d^T a_d D_d x to out; a [direction row col] real, x and out [row col]."""
    if x.dtype.kind != "c":
        _add_weighted_laplacian(x, a, directions, out)
        return
    for from_part, to_part in ((x.real, out.real), (x.imag, out.imag)):
        part = np.zeros(x.shape, a.dtype)
        _add_weighted_laplacian(np.ascontiguousarray(from_part), a, directions, part)
        to_part += part


@njit(cache=True, fastmath=True, nogil=True)
def _add_weighted_laplacian(x: Array, a: Array, directions: Directions, out: Array) -> None:
    rows, cols = x.shape
    e = np.empty(cols, x.dtype)
    for i in range(rows):
        for d in range(len(directions)):
            down, right = directions[d]
            first, last = _overlap(right, cols)
            if i + down >= rows or last <= first:
                continue
            here, there = x[i, first:last], x[i + down, first + right : last + right]
            share = a[d, i, first:last]
            minus, plus = out[i, first:last], out[i + down, first + right : last + right]
            for j in range(len(here)):
                e[j] = share[j] * (there[j] - here[j])
            for j in range(len(here)):
                minus[j] -= e[j]
            for j in range(len(here)):
                plus[j] += e[j]


def add_laplacian_diagonal(a: Array, directions: Directions, out: Array) -> None:
    """Add the diagonal of sum_d D_d^T a_d D_d to out [row col]."""
    for share, (here, there) in zip(a, neighbours(out.shape, directions), strict=True):
        out[here] += share[here]
        out[there] += share[here]
