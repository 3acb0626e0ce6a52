"""Compiled loops over small matrices.

A BLAS takes longer where a matrix is a band, or half of it is enough. All inner loops run along
rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


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
def band_solved(band: Array, right: Array) -> None:
    """Solve L u = r in place, in the first [j] of each row of `right`.

    Parameters
    ----------
    band : [m j] diagonals of L, the main one first: L_(i+m, i) at (m, i)
    right : [q j]
    """
    for q in range(right.shape[0]):
        row = right[q]
        for i in range(band.shape[1]):
            total = row[i]
            for m in range(1, min(i + 1, band.shape[0])):
                total -= band[m, i - m] * row[i - m]
            row[i] = total / band[0, i]


@njit(cache=True, nogil=True, error_model="numpy")
def around(band: Array, middle: Array, out: Array) -> None:
    """Fill in L M L^T, M symmetric and L a band; see `band_solved`.

    Parameters
    ----------
    band : of L
    middle, out : [j j]
    """
    size = band.shape[1]
    half = np.empty(size)
    for i in range(size):
        half[:] = 0.0
        for m in range(min(i + 1, band.shape[0])):
            share, other = band[m, i - m], middle[i - m]
            for j in range(size):
                half[j] += share * other[j]
        out[i] = 0.0
        for m in range(band.shape[0]):
            own, other, end = out[i, m:], band[m], size - m
            for j in range(end):
                own[j] += half[j] * other[j]


@njit(cache=True, nogil=True, error_model="numpy")
def within(band: Array, middle: Array, variance: float, out: Array) -> None:
    """Fill in the lower triangle of L^T M L + s^2; see `around`."""
    size = band.shape[1]
    half = np.empty(size)
    for i in range(size):
        half[:] = 0.0
        for m in range(min(size - i, band.shape[0])):
            share, other = band[m, i], middle[i + m]
            for j in range(size):
                half[j] += share * other[j]
        out[i, :size] = 0.0
        for m in range(band.shape[0]):
            own, other, end = half[m:], band[m], min(i + 1, size - m)
            for j in range(end):
                out[i, j] += own[j] * other[j]
        out[i, i] += variance


__all__ = ["around", "band_solved", "downdated", "inverted", "within"]
