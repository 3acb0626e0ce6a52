"""Compiled loops over small matrices.

A few hundred rows are too few for the threads of a BLAS, which cost more there than they save. All
inner loops run along rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def factored(matrix: Array) -> bool:
    """Turn S, and rows W below it, into the lower L with L L^T = S, and W L^-T; tell if it exists.

    Parameters
    ----------
    matrix : [j + q, j] of which the upper triangle is neither read nor changed
    """
    rows, size = matrix.shape
    scales = np.empty(size)
    for i in range(rows):
        end = min(i + 1, size)
        for start in range(0, end, 4):
            stop = min(start + 4, end)
            if stop - start == 4:  # four sums at once: numbers are read as often as they are used
                a = b = c = d = 0.0
                for m in range(start):
                    own = matrix[i, m]
                    a += own * matrix[start, m]
                    b += own * matrix[start + 1, m]
                    c += own * matrix[start + 2, m]
                    d += own * matrix[start + 3, m]
                matrix[i, start] -= a
                matrix[i, start + 1] -= b
                matrix[i, start + 2] -= c
                matrix[i, start + 3] -= d
            for k in range(start, stop):
                value = matrix[i, k]
                for m in range(start if stop - start == 4 else 0, k):
                    value -= matrix[i, m] * matrix[k, m]
                if k == i:
                    if not value > 0.0:
                        return False
                    scales[k] = 1.0 / np.sqrt(value)
                matrix[i, k] = value * scales[k]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def inverted(lower: Array, out: Array) -> None:
    """Fill in the lower triangle of (L L^T)^-1.

    Parameters
    ----------
    lower : [j j] L
    out : [j j]
    """
    size = lower.shape[0]
    inverse = np.zeros((size + 3, size))  # four rows at a time
    for i in range(size):
        row = inverse[i]
        for k in range(0, i, 4):
            a, b, c, d = lower[i, k], 0.0, 0.0, 0.0
            if k + 1 < i:
                b = lower[i, k + 1]
            if k + 2 < i:
                c = lower[i, k + 2]
            if k + 3 < i:
                d = lower[i, k + 3]
            e, f, g, h = inverse[k], inverse[k + 1], inverse[k + 2], inverse[k + 3]
            for j in range(min(k + 4, i)):
                row[j] -= a * e[j] + b * f[j] + c * g[j] + d * h[j]
        scale = 1.0 / lower[i, i]
        for j in range(i):
            row[j] *= scale
        row[i] = scale
    out[:] = 0.0
    for k in range(0, size, 4):
        e, f, g, h = inverse[k], inverse[k + 1], inverse[k + 2], inverse[k + 3]
        for i in range(min(k + 4, size)):
            own, a, b, c, d = out[i], e[i], f[i], g[i], h[i]
            for j in range(i + 1):
                own[j] += a * e[j] + b * f[j] + c * g[j] + d * h[j]


@njit(cache=True, nogil=True, error_model="numpy")
def downdated(matrix: Array, rows: Array) -> None:
    """Take sum_q r_q r_q^T from a symmetric matrix whose lower triangle is given.

    Parameters
    ----------
    matrix : [j j], whole afterwards
    rows : [q j] r
    """
    for i in range(matrix.shape[0]):
        own = matrix[i]
        for q in range(rows.shape[0]):
            share, other = rows[q, i], rows[q]
            for j in range(i + 1):
                own[j] -= share * other[j]
        for j in range(i):
            matrix[j, i] = own[j]


@njit(cache=True, nogil=True, error_model="numpy")
def band_of(lower: Array) -> Array:
    """Return [j], for each row of a lower triangle, where its first number is that is not 0."""
    first = np.empty(lower.shape[0], dtype=np.intp)
    for i in range(lower.shape[0]):
        first[i] = i
        for j in range(i):
            if lower[i, j] != 0.0:
                first[i] = j
                break
    return first


@njit(cache=True, nogil=True, error_model="numpy")
def band_solved(lower: Array, first: Array, right: Array) -> None:
    """Solve L u = r in place, in the first [j] of each row of `right`.

    Parameters
    ----------
    lower, first : L and `band_of` it
    right : [q j]
    """
    for q in range(right.shape[0]):
        row = right[q]
        for i in range(lower.shape[0]):
            total = row[i]
            for k in range(first[i], i):
                total -= lower[i, k] * row[k]
            row[i] = total / lower[i, i]


@njit(cache=True, nogil=True, error_model="numpy")
def around(lower: Array, first: Array, middle: Array, out: Array) -> None:
    """Fill in L M L^T, M symmetric and L a band.

    Parameters
    ----------
    lower, first : L and `band_of` it
    middle, out : [j j]
    """
    size = lower.shape[0]
    half = np.zeros((size, size))
    for i in range(size):
        row = half[i]
        for k in range(first[i], i + 1):
            share, other = lower[i, k], middle[k]
            for j in range(size):
                row[j] += share * other[j]
    half = half.T.copy()
    for i in range(size):
        row = out[i]
        row[:size] = 0.0
        for k in range(first[i], i + 1):
            share, other = lower[i, k], half[k]
            for j in range(size):
                row[j] += share * other[j]


@njit(cache=True, nogil=True, error_model="numpy")
def within(lower: Array, first: Array, middle: Array, out: Array) -> None:
    """Fill in L^T M L, M symmetric and L a band; see `around`."""
    size = lower.shape[0]
    half = np.zeros((size, size))
    for k in range(size):
        other = middle[k]
        for i in range(first[k], k + 1):
            share, row = lower[k, i], half[i]
            for j in range(size):
                row[j] += share * other[j]
    half = half.T.copy()
    for i in range(size):
        out[i, :size] = 0.0
    for k in range(size):
        other = half[k]
        for i in range(first[k], k + 1):
            share, row = lower[k, i], out[i]
            for j in range(i + 1):
                row[j] += share * other[j]


__all__ = ["around", "band_of", "band_solved", "downdated", "factored", "inverted", "within"]
