"""Compiled loops: the edge response, and cross products of integrated splines.

The cross products are exact and need no [n j] matrix: the integral of spline j is 1 far behind its
knot, and the differences of neighbours are zero but for five knots around a pixel. Products of
these are summed in a narrow band and then added up.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


_ROOT_HALF = math.sqrt(0.5)
_INVERSE_ROOT_2PI = 1.0 / math.sqrt(2.0 * math.pi)
_FAR_SIDES = 16.0  # half sides of a pixel, where an error below 1e-6 is left
_FAR = 9.0  # standard deviations; what is left of the normal distribution there is below 1e-18


@njit(cache=True, nogil=True, error_model="numpy")
def trapezium_edge(normal_px: Array, p: float, q: float, sigma_px: float, out: Array) -> None:
    """Fill `out` with the response of an edge: a trapezium of half widths p, q and a Gaussian.

    Parameters
    ----------
    normal_px, out : [n]
    p, q : half the sides of the pixel as the edge's normal sees them
    sigma_px : of the Gaussian
    """
    reach_px = p + q + _FAR * sigma_px
    for i in range(normal_px.size):
        d = normal_px[i]
        if d > reach_px:
            out[i] = 1.0
        elif d < -reach_px:
            out[i] = 0.0
        else:
            total = _second_integral(d + p + q, sigma_px) - _second_integral(d + p - q, sigma_px)
            total += _second_integral(d - p - q, sigma_px) - _second_integral(d - p + q, sigma_px)
            out[i] = total / (4.0 * p * q)


@njit(cache=True, nogil=True, error_model="numpy")
def _second_integral(t: float, sigma_px: float) -> float:
    """Return the second antiderivative of the normal density at t."""
    u = t / sigma_px
    cumulative = 0.5 * math.erfc(-u * _ROOT_HALF)
    density = math.exp(-0.5 * u * u) * _INVERSE_ROOT_2PI
    return 0.5 * ((t * t + sigma_px * sigma_px) * cumulative + sigma_px * t * density)


@njit(cache=True, nogil=True, error_model="numpy")
def trapezium_tail(
    normal_px: Array, p: float, q: float, width_px: float, slow: float, out: Array
) -> None:
    """Fill `out` with the response of an edge: a trapezium of half widths p, q and a tail.

    Parameters
    ----------
    normal_px, out : [n]
    p, q : half the sides of the pixel as the edge's normal sees them
    width_px : w of the Lorentzian w / (pi (x^2 + w^2)) and of the Laplacian exp(-|x| / w) / 2 w
    slow : share of the Lorentzian, the rest being Laplacian
    """
    far_px, half_variance = _FAR_SIDES * max(p, q), (p * p + q * q) / 6.0
    for i in range(normal_px.size):
        d = normal_px[i]
        if abs(d) > far_px:  # the pixel is small there: its second moment says all
            square, fast = d * d + width_px * width_px, math.exp(-abs(d) / width_px)
            value = (
                slow
                / math.pi
                * (math.atan(d / width_px) - 2.0 * half_variance * d * width_px / (square * square))
            )
            rest = 0.5 - 0.5 * fast * (1.0 + half_variance / (width_px * width_px))
            out[i] = 0.5 + value + (1.0 - slow) * math.copysign(rest, d)
            continue
        total = _second_of_tail(d + p + q, width_px, slow)
        total -= _second_of_tail(d + p - q, width_px, slow)
        total += _second_of_tail(d - p - q, width_px, slow)
        total -= _second_of_tail(d - p + q, width_px, slow)
        out[i] = 0.5 + total / (4.0 * p * q)


@njit(cache=True, nogil=True, error_model="numpy")
def _second_of_tail(x: float, w: float, slow: float) -> float:
    """Return a second antiderivative of the tail's response minus 1/2."""
    square = x * x
    lorentzian = (square - w * w) * math.atan(x / w) - w * x * math.log(square + w * w)
    far = abs(x)
    laplacian = 0.5 * square - w * w * math.expm1(-far / w) - w * far
    if x < 0.0:
        laplacian = -laplacian
    return 0.5 * (slow * lorentzian / math.pi + (1.0 - slow) * laplacian)


@njit(cache=True, nogil=True, error_model="numpy")
def _integral(u: float) -> float:
    """Return the integral of the centred cubic B-spline (support -2 to 2) up to u."""
    if u <= -2.0:
        return 0.0
    if u >= 2.0:
        return 1.0
    v = abs(u)
    half = 0.5 - (2.0 - v) ** 4 / 24.0
    if v < 1.0:
        half = (2.0 / 3.0) * v - v**3 / 3.0 + v**4 / 8.0
    return 0.5 + half if u > 0 else 0.5 - half


@njit(cache=True, nogil=True, error_model="numpy")
def _local_range(u: float, knots: int) -> tuple[int, int]:
    """Return the first knot whose difference matters at u, and how many do."""
    first = max(int(np.floor(u)) - 2, 0)
    last = min(int(np.floor(u)) + 2, knots - 1)
    if u >= knots - 1:
        first, last = min(first, knots - 1), knots - 1
    return first, last - first + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _local_differences(u: float, first: int, count: int, knots: int, local: Array) -> None:
    for k in range(count):
        j = first + k
        local[k] = _integral(u - j)
        if j < knots - 1:
            local[k] -= _integral(u - j - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def spline_products(
    place: Array,
    columns: Array,
    values: Array,
    products: Array,
    with_columns: Array,
    with_values: Array,
) -> None:
    """Fill in products of integrated splines I_j over all pixels, for knots 1 apart.

    Summed are products of the differences f_k = I_k - I_(k+1) (the last: I_k).

    Parameters
    ----------
    place : [n] distance from the first knot, in knots
    columns, values : [n p], [n]
    products, with_columns, with_values : [j j], [j p], [j], zero before
    """
    knots, local = products.shape[0], np.empty(6)
    for i in range(place.size):
        first, count = _local_range(place[i], knots)
        _local_differences(place[i], first, count, knots, local)
        for k in range(count):
            for m in range(count):
                products[first + k, first + m] += local[k] * local[m]
            for q in range(columns.shape[1]):
                with_columns[first + k, q] += local[k] * columns[i, q]
            with_values[first + k] += local[k] * values[i]
    _add_up(products, with_columns, with_values)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_up(products: Array, with_columns: Array, with_values: Array) -> None:
    """Turn products of differences into those of integrals, sums of f_k from k = j on."""
    knots = products.shape[0]
    for k in range(knots - 1, -1, -1):
        for m in range(knots - 2, -1, -1):
            products[k, m] += products[k, m + 1]
        if k < knots - 1:
            for m in range(knots):
                products[k, m] += products[k + 1, m]
            for q in range(with_columns.shape[1]):
                with_columns[k, q] += with_columns[k + 1, q]
            with_values[k] += with_values[k + 1]
