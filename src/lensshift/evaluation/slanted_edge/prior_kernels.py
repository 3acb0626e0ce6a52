"""Compiled loops of the prior: the covariance of the splines' heights, and its slopes.

The covariance of the coefficients of splines at places n_i is

    K_ij = e_i e_j [k(n_i - n_j) + m k(n_i + n_j)]

Their heights, by which they raise the response up to each knot, are sums: h_i is the sum of
areas times coefficients up to i.
"""

from __future__ import annotations

from typing import Any

from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def heights_covariance(
    number: Array, weight: Array, near: Array, symmetry: float, out: Array
) -> None:
    """Fill in the covariance of the heights.

    Parameters
    ----------
    number : [j] n, rising places of the knots in steps from the middle
    weight, near : [j], [l] e times area at every knot, k at every lag
    symmetry : m
    out : [j j]
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

    Parameters
    ----------
    sensitivity : [j j] its derivative by the covariance of the heights; destroyed
    number, weight, near, symmetry : as in `heights_covariance`
    longer, wider : [l], [j] slopes of `near` and of the log envelope
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


__all__ = ["heights_covariance", "heights_slopes"]
