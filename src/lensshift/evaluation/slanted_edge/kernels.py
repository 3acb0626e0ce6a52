"""Compiled loops: the edge response, products of integrated splines, and their derivatives.

The cross products are exact and need no [n j] matrix: the integral of spline j is 1 far behind its
knot, and the differences of neighbours are zero but for five knots around a pixel. Products of
these are summed in a narrow band and then added up. Whitening mixes a few near pixels, which
widens the band a little. `MARGIN` knots on either side take what lies beyond the splines.
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
_FAR = 9.0  # standard deviations; what is left of the normal distribution there is below 1e-18
MARGIN = 4


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
def trapezium_slopes(normal_px: Array, p: float, q: float, sigma_px: float, out: Array) -> None:
    """Fill `out` with what `trapezium_edge` gives and how it changes.

    With G the second antiderivative of the normal density: dG/dt is the first one, and
    dG/ds = s times the cumulative distribution.

    Parameters
    ----------
    normal_px : [n]
    p, q, sigma_px : as in `trapezium_edge`
    out : [5 n] the response, then its derivatives by distance, width, p and q
    """
    reach_px = p + q + _FAR * sigma_px
    share = 1.0 / (4.0 * p * q)
    for i in range(normal_px.size):
        d = normal_px[i]
        out[:, i] = 0.0
        if d > reach_px:
            out[0, i] = 1.0
        if abs(d) > reach_px:
            continue
        for corner in range(4):
            sign_p = 1.0 if corner < 2 else -1.0
            sign_q = 1.0 if corner % 2 == 0 else -1.0
            t = d + sign_p * p + sign_q * q
            u = t / sigma_px
            cumulative = 0.5 * math.erfc(-u * _ROOT_HALF)
            density = math.exp(-0.5 * u * u) * _INVERSE_ROOT_2PI
            once = t * cumulative + sigma_px * density
            twice = 0.5 * (t * once + sigma_px * sigma_px * cumulative)
            sign = sign_p * sign_q * share
            out[0, i] += sign * twice
            out[1, i] += sign * once
            out[2, i] += sign * sigma_px * cumulative
            out[3, i] += sign * sign_p * once
            out[4, i] += sign * sign_q * once
        out[3, i] -= out[0, i] / p
        out[4, i] -= out[0, i] / q


@njit(cache=True, nogil=True, error_model="numpy")
def spline_differences(place: Array, first: Array, parts: Array) -> None:
    """Fill `parts` with the differences f_k = I(u - k) - I(u - k - 1) that are not zero.

    I is the integral of the centred cubic B-spline (support -2 to 2).

    Parameters
    ----------
    place : [n] distance u from the first knot, in knots; from -2 to the number of knots + 1
    first : [n] filled with the number of the first k, counted from `MARGIN` knots before the first
    parts : [n 5]
    """
    for i in range(place.size):
        knot = math.floor(place[i])
        t = place[i] - knot
        s = 1.0 - t
        ahead, behind = t * t * t * t / 24.0, s * s * s * s / 24.0
        first[i] = int(knot) - 2 + MARGIN
        parts[i, 0] = behind
        parts[i, 1] = 0.5 - (2.0 / 3.0) * t + t * t * t / 3.0 - 3.0 * ahead - behind
        parts[i, 3] = 0.5 - (2.0 / 3.0) * s + s * s * s / 3.0 - 3.0 * behind - ahead
        parts[i, 4] = ahead
        parts[i, 2] = 1.0 - parts[i, 0] - parts[i, 1] - parts[i, 3] - ahead


@njit(cache=True, nogil=True, error_model="numpy")
def _mix(
    r: int, first: Array, parts: Array, starts: Array, pixels: Array, factors: Array, row: Array
) -> tuple[int, int]:
    """Fill `row` with the differences that whitened pixel `r` sees; return where they lie."""
    low, high = row.size, 0
    for tap in range(starts[r], starts[r + 1]):
        low, high = min(low, first[pixels[tap]]), max(high, first[pixels[tap]] + 5)
    for k in range(low, high):
        row[k] = 0.0
    for tap in range(starts[r], starts[r + 1]):
        i = pixels[tap]
        for k in range(5):
            row[first[i] + k] += factors[tap] * parts[i, k]
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def difference_products(
    first: Array,
    parts: Array,
    starts: Array,
    pixels: Array,
    factors: Array,
    columns: Array,
    products: Array,
    with_columns: Array,
) -> None:
    """Add up products of the differences over all whitened pixels.

    Parameters
    ----------
    first, parts : as `spline_differences` fills them
    starts, pixels, factors : [m + 1], [t], [t] the whitening matrix, row by row
    columns : [m p] whitened
    products, with_columns : [j j], [j p], added to; of the products the upper triangle only
    """
    row = np.empty(products.shape[0])
    for r in range(starts.size - 1):
        low, high = _mix(r, first, parts, starts, pixels, factors, row)
        for k in range(low, high):
            for m in range(k, high):
                products[k, m] += row[k] * row[m]
            for q in range(columns.shape[1]):
                with_columns[k, q] += row[k] * columns[r, q]


@njit(cache=True, nogil=True, error_model="numpy")
def pull_back(
    place: Array,
    first: Array,
    parts: Array,
    starts: Array,
    pixels: Array,
    factors: Array,
    columns: Array,
    between: Array,
    to_splines: Array,
    to_levels: Array,
    by_place: Array,
    by_level: Array,
) -> None:
    """Add up how a sum over whitened rows changes with each pixel's place and level columns.

    The sum is that of the splines times h and of the level columns times g, with

        h = f S + x U,    g = (f x) V      row by row, f differences and x columns

    Parameters
    ----------
    place, first, parts, starts, pixels, factors : as above
    columns : [m q] x
    between, to_splines : [j j], [q j] S and U
    to_levels : [j + q, p] V
    by_place, by_level : [n], [n p], added to; by place in units of the splines' height
    """
    knots, levels = between.shape[0], to_levels.shape[1]
    row, pull, level_pull = np.empty(knots), np.empty(knots), np.empty(levels)
    for r in range(starts.size - 1):
        low, high = _mix(r, first, parts, starts, pixels, factors, row)
        pull[low:high] = 0.0
        level_pull[:] = 0.0
        for k in range(low, high):
            for j in range(low, high):
                pull[j] += row[k] * between[k, j]
            for c in range(levels):
                level_pull[c] += row[k] * to_levels[k, c]
        for q in range(columns.shape[1]):
            for j in range(low, high):
                pull[j] += columns[r, q] * to_splines[q, j]
            for c in range(levels):
                level_pull[c] += columns[r, q] * to_levels[knots + q, c]
        for tap in range(starts[r], starts[r + 1]):
            i = pixels[tap]
            t = place[i] - math.floor(place[i])
            s = 1.0 - t
            k = first[i]
            slope = (s * s * s * pull[k + 1] + t * t * t * pull[k + 4]) / 6.0
            slope += (2.0 / 3.0 - t * t * (1.0 - 0.5 * t)) * pull[k + 2]
            slope += (2.0 / 3.0 - s * s * (1.0 - 0.5 * s)) * pull[k + 3]
            by_place[i] += factors[tap] * slope
            for c in range(levels):
                by_level[i, c] += factors[tap] * level_pull[c]
