"""Compiled loops of the prior: a factor of the splines' covariance, and its slopes.

Even and odd functions of the place do not mix. Of either kind the covariance is

    e_i e_j [k(n_i - n_j) + s k(n_i + n_j)],   s = 1 (even), -1 (odd)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def process_factor(
    number: Array,
    envelope: Array,
    near: Array,
    sign: float,
    information: Array,
    tolerance: float,
    out: Array,
) -> int:
    """Fill in rows of a factor L^T of the covariance, and return how many tell it.

    Parameters
    ----------
    number : [j] n, places of the knots in steps from the middle
    envelope, near : [j], [l] e at every knot, k at every lag
    sign : s
    information, tolerance : [j] of the variances that the rows leave, times this, the sum ends
        below the tolerance
    out : [j j]

    Source: Cholesky factorisation with pivots, Harbrecht, Peters and Schneider, Appl. Numer.
    Math. 62 (2012) 428.
    """
    count = number.size
    rest = np.empty(count)
    for i in range(count):
        rest[i] = envelope[i] ** 2 * (near[0] + sign * near[2 * number[i]])
    for rank in range(count):
        best, largest, total = 0, -1.0, 0.0
        for i in range(count):
            weighted = rest[i] * information[i]
            total += weighted
            if weighted > largest:
                best, largest = i, weighted
        if total <= tolerance or rest[best] <= 1e-12 * envelope[best] ** 2:
            return rank
        row = out[rank]
        for i in range(count):
            lag, fold = abs(number[i] - number[best]), number[i] + number[best]
            row[i] = envelope[i] * envelope[best] * (near[lag] + sign * near[fold])
        for k in range(rank):
            share = out[k, best]
            for i in range(count):
                row[i] -= share * out[k, i]
        scale = 1.0 / np.sqrt(rest[best])
        for i in range(count):
            row[i] *= scale
            rest[i] = max(rest[i] - row[i] * row[i], 0.0)
        rest[best] = 0.0
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def process_slopes(
    sensitivity: Array,
    number: Array,
    envelope: Array,
    near: Array,
    longer: Array,
    wider: Array,
    sign: float,
) -> tuple[float, float, float]:
    """Return how a value changes with the logs of factor, length and tail of the covariance.

    Parameters
    ----------
    sensitivity : [j j] its derivative by the covariance
    number, envelope, near, sign : as in `process_factor`
    longer, wider : [l], [j] slopes of `near` and of the log envelope
    """
    by_factor = by_length = by_tail = 0.0
    for i in range(number.size):
        for j in range(number.size):
            lag, fold = abs(number[i] - number[j]), number[i] + number[j]
            weight = sensitivity[i, j] * envelope[i] * envelope[j]
            value = weight * (near[lag] + sign * near[fold])
            by_factor += value
            by_length += weight * (longer[lag] + sign * longer[fold])
            by_tail += value * (wider[i] + wider[j])
    return by_factor, by_length, by_tail
