"""Compiled loops over small matrices.

A BLAS takes longer where a matrix is a band, or half of it is enough. All inner loops run along
rows.

The covariance of the coefficients of splines at places n_i is

    K_ij = e_i e_j [k(n_i - n_j) + m k(n_i + n_j)]

Their heights, by which they raise the response up to each knot, are sums: h_i is the sum of
areas times coefficients up to i.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array


@njit(cache=True, nogil=True, error_model="numpy")
def downdated(matrix: Array, rows: Array) -> None:
    """Take sum_q r_q r_q^T from a symmetric matrix [j j] of which the lower triangle is given."""
    for i in range(matrix.shape[0]):
        own = matrix[i]
        for q in range(rows.shape[0]):
            share, other = rows[q, i], rows[q]
            for j in range(i + 1):
                own[j] -= share * other[j]
        for j in range(i):
            matrix[j, i] = own[j]


@njit(cache=True, nogil=True, error_model="numpy")
def around(band: Array, middle: Array, out: Array) -> None:
    """Fill in L M L^T, M symmetric and L a band.

    `band` [m j] has the diagonals of L, the main one first: L_(i+m, i) at (m, i).
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


@njit(cache=True, nogil=True, error_model="numpy")
def heights_covariance(
    number: Array, weight: Array, near: Array, symmetry: float, out: Array
) -> None:
    """Fill in the covariance [j j] of the heights.

    Of knots at n [j], rising steps from the middle; `weight` is e times the area at each, `near`
    k at every lag.
    """
    for i in range(number.size):
        total = 0.0
        for j in range(i + 1):
            lag, fold = number[i] - number[j], abs(number[i] + number[j])
            total += weight[j] * (near[lag] + symmetry * near[fold])
            out[i, j] = weight[i] * total
            if i:
                out[i, j] += out[i - 1, j]
            out[j, i] = out[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def heights_slopes(
    sensitivity: Array,
    number: Array,
    weight: Array,
    near: Array,
    longer: Array,
    wider: Array,
    symmetry: float,
) -> tuple[float, float, float, float]:
    """Return how a value changes with the logs of amplitude, length and tail, and with m.

    `sensitivity` [j j], its derivative by the covariance of the heights, is destroyed; `longer` [l]
    and `wider` [j] are slopes of `near` and of the log envelope.
    """
    count = number.size
    by_amplitude = by_length = by_tail = by_symmetry = 0.0
    for i in range(count - 1, -1, -1):
        row, total = sensitivity[i], 0.0
        for j in range(count - 1, -1, -1):
            total += row[j]
            row[j] = total
        if i < count - 1:
            below = sensitivity[i + 1]
            for j in range(count):
                row[j] += below[j]
        for j in range(i + 1):
            lag, fold = abs(number[i] - number[j]), abs(number[i] + number[j])
            each = row[j] * weight[i] * weight[j] * (1.0 if i == j else 2.0)
            value = each * (near[lag] + symmetry * near[fold])
            by_amplitude += 2.0 * value
            by_length += each * (longer[lag] + symmetry * longer[fold])
            by_tail += value * (wider[i] + wider[j])
            by_symmetry += each * near[fold]
    return by_amplitude, by_length, by_tail, by_symmetry
