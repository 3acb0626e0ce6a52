"""Compiled loops of the prior: the covariance of the spline coefficients, and its slopes."""

from __future__ import annotations

from typing import Any

from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def process_covariance(
    number: Array, envelope: Array, near: Array, symmetry: float, jitter: float, out: Array
) -> None:
    """Fill in e_i e_j [k(n_i - n_j) + m k(n_i + n_j)], plus jitter.

    Parameters
    ----------
    number : [j] n, places of the knots in steps from the middle
    envelope, near : [j], [l] e at every knot, k at every lag
    symmetry, jitter : m, and what the diagonal gets
    out : [j j]
    """
    count = envelope.size
    for i in range(count):
        for j in range(i + 1):
            lag, fold = abs(number[i] - number[j]), abs(number[i] + number[j])
            value = near[lag] + symmetry * near[fold]
            out[i, j] = out[j, i] = value * envelope[i] * envelope[j]
        out[i, i] += jitter


@njit(cache=True, nogil=True, error_model="numpy")
def process_slopes(
    sensitivity: Array,
    number: Array,
    envelope: Array,
    near: Array,
    longer: Array,
    wider: Array,
    symmetry: float,
    out: Array,
) -> None:
    """Add up how a value changes with log amplitude, log length, log tail and logit symmetry.

    Parameters
    ----------
    sensitivity : [j j] its derivative by the covariance of `process_covariance`
    number, envelope, near, symmetry : as there
    longer, wider : [l], [j] slopes of `near` and of the log envelope
    out : [4], added to
    """
    count = envelope.size
    for i in range(count):
        for j in range(count):
            lag, fold = abs(number[i] - number[j]), abs(number[i] + number[j])
            weight = sensitivity[i, j] * envelope[i] * envelope[j]
            value = weight * (near[lag] + symmetry * near[fold])
            out[0] += 2.0 * value
            out[1] += weight * (longer[lag] + symmetry * longer[fold])
            out[2] += value * (wider[i] + wider[j])
            out[3] += symmetry * (1.0 - symmetry) * weight * near[fold]
