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
def edge_slopes(normal_px: Array, p: float, q: float, sigma_px: float, out: Array) -> None:
    """Fill `out` with the response of `trapezium_edge` and its slopes.

    Parameters
    ----------
    normal_px : [n]
    p, q, sigma_px : as in `trapezium_edge`
    out : [4 n] response; slopes by log sigma, by the log of the pixel's side, by the distance
    """
    reach_px, area = p + q + _FAR * sigma_px, 4.0 * p * q
    for i in range(normal_px.size):
        d = normal_px[i]
        out[1:, i] = 0.0
        if abs(d) > reach_px:
            out[0, i] = 1.0 if d > 0.0 else 0.0
            continue
        value = by_sigma = by_side = by_place = 0.0
        for shift, sign in ((p + q, 1.0), (p - q, -1.0), (q - p, -1.0), (-p - q, 1.0)):
            t = d + shift
            u = t / sigma_px
            cumulative = 0.5 * math.erfc(-u * _ROOT_HALF)
            thin = sigma_px * math.exp(-0.5 * u * u) * _INVERSE_ROOT_2PI
            first = t * cumulative + thin
            value += sign * 0.5 * (t * first + sigma_px * sigma_px * cumulative)
            by_sigma += sign * sigma_px * sigma_px * cumulative
            by_side += sign * shift * first
            by_place += sign * first
        out[0, i], out[1, i] = value / area, by_sigma / area
        out[2, i], out[3, i] = (by_side - 2.0 * value) / area, by_place / area


@njit(cache=True, nogil=True, error_model="numpy")
def tail_slopes(
    normal_px: Array, p: float, q: float, grows: tuple[float, float], w: float, out: Array
) -> None:
    """Fill `out` with the two responses of which `trapezium_tail` is a mixture, and their slopes.

    Parameters
    ----------
    normal_px : [n]
    p, q, w : as in `trapezium_tail`
    grows : whether p and q follow the side of the pixel (1) or are at a limit (0)
    out : [2 4 n] of Lorentzian and Laplacian: response; slopes by the log of the width, by the log
        of the pixel's side, by the distance
    """
    far_px, half_variance = _FAR_SIDES * max(p, q), (p * p + q * q) / 6.0
    wider = (grows[0] * p * p + grows[1] * q * q) / 3.0
    for i in range(normal_px.size):
        d = normal_px[i]
        if abs(d) > far_px:
            _far_slopes(d, w, half_variance, wider, out[:, :, i])
            continue
        sums = np.zeros((2, 4))
        for one, other, sign in ((1, 1, 1.0), (1, -1, -1.0), (-1, 1, -1.0), (-1, -1, 1.0)):
            x = d + one * p + other * q
            shift = one * grows[0] * p + other * grows[1] * q
            square, angle, far = x * x + w * w, math.atan(x / w), abs(x)
            log, fall = math.log(square), math.expm1(-far / w)
            first = (x * angle - 0.5 * w * log) / math.pi
            fast = 0.5 * (far + w * fall)
            side = 0.5 if x > 0.0 else -0.5
            values = ((x * x - w * w) * angle - w * x * log) / (2.0 * math.pi)
            sums[0, 0] += sign * values
            sums[0, 1] -= sign * w * (w * angle + 0.5 * x * log) / math.pi
            sums[0, 2] += sign * shift * first
            sums[0, 3] += sign * first
            sums[1, 0] += sign * side * (0.5 * x * x - w * w * fall - w * far)
            sums[1, 1] -= sign * side * w * (2.0 * w * fall + far * (2.0 + fall))
            sums[1, 2] += sign * shift * fast
            sums[1, 3] += sign * fast
        for k in range(2):
            sums[k, 2] -= (grows[0] + grows[1]) * sums[k, 0]
            for m in range(4):
                out[k, m, i] = sums[k, m] / (4.0 * p * q)
            out[k, 0, i] += 0.5


@njit(cache=True, nogil=True, error_model="numpy")
def _far_slopes(d: float, w: float, half_variance: float, wider: float, out: Array) -> None:
    """Fill in [2 4] where the pixel is small against the distance; see `tail_slopes`."""
    square, fast = d * d + w * w, 0.5 * math.exp(-abs(d) / w)
    bend = w / (square * square)
    side, more = math.copysign(1.0, d), half_variance / (w * w)
    out[0, 0] = 0.5 + (math.atan(d / w) - 2.0 * half_variance * d * bend) / math.pi
    out[0, 1] = (
        d * (-w / square - 2.0 * half_variance * bend * (1.0 - 4.0 * w * w / square)) / math.pi
    )
    out[0, 2] = -2.0 * d * bend * wider / math.pi
    out[0, 3] = (w / square - 2.0 * half_variance * bend * (1.0 - 4.0 * d * d / square)) / math.pi
    out[1, 0] = 0.5 + side * (0.5 - fast * (1.0 + more))
    out[1, 1] = side * fast * (2.0 * more - abs(d) / w * (1.0 + more))
    out[1, 2] = -side * fast * wider / (w * w)
    out[1, 3] = fast / w * (1.0 + more)


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
def spline_integrals(place: Array, out: Array) -> None:
    """Fill `out` [n j] with integrals of cubic B-splines, 1 apart, up to each place [n]."""
    knots = out.shape[1]
    for i in range(place.size):
        first = min(max(int(np.floor(place[i])) - 1, 0), knots)
        last = min(first + 4, knots)
        out[i, :first] = 1.0
        for k in range(first, last):
            out[i, k] = _integral(place[i] - k)
        out[i, last:] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def spline_values(place: Array, out: Array) -> None:
    """Fill in what is not 0 of the same splines themselves."""
    knots = out.shape[1]
    for i in range(place.size):
        first = min(max(int(np.floor(place[i])) - 1, 0), knots)
        for k in range(first, min(first + 4, knots)):
            v = abs(place[i] - k)
            if v < 1.0:
                out[i, k] = 2.0 / 3.0 - v * v + 0.5 * v * v * v
            elif v < 2.0:
                out[i, k] = (2.0 - v) ** 3 / 6.0


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
