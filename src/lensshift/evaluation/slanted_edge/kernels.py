"""Compiled loops: the response of an edge to a Gaussian and to tails, as a square pixel sees it."""

from __future__ import annotations

import math
from typing import Any

from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


_ROOT_HALF = math.sqrt(0.5)
_INVERSE_ROOT_2PI = 1.0 / math.sqrt(2.0 * math.pi)
_FAR_SIDES = 16.0  # half sides of a pixel, where an error below 1e-6 is left
_FAR = 7.0  # standard deviations; what is left of the normal distribution there is 1e-12


@njit(cache=True, nogil=True, error_model="numpy")
def edge_slopes(normal_px: Array, p: float, q: float, sigma_px: float, out: Array) -> None:
    """Fill `out` with the response of an edge, a trapezium and a Gaussian, and its slopes.

    Parameters
    ----------
    normal_px : [n]
    p, q : half the sides of the pixel as the edge's normal sees them: half widths of the trapezium
    sigma_px : of the Gaussian
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
    """Fill `out` with the responses of an edge, a trapezium and either law of a tail; their slopes.

    Parameters
    ----------
    normal_px, p, q : as in `edge_slopes`
    w : width of the Lorentzian w / (pi (x^2 + w^2)) and of the Laplacian exp(-|x| / w) / 2 w
    grows : whether p and q follow the side of the pixel (1) or are at a limit (0)
    out : [2 4 n] of Lorentzian and Laplacian: response; slopes by the log of the width, by the log
        of the pixel's side, by the distance
    """
    far_px, half_variance, area = _FAR_SIDES * max(p, q), (p * p + q * q) / 6.0, 4.0 * p * q
    wider = (grows[0] * p * p + grows[1] * q * q) / 3.0
    for i in range(normal_px.size):
        d = normal_px[i]
        if abs(d) > far_px:
            _far_slopes(d, w, half_variance, wider, out[:, :, i])
            continue
        slow = slow_width = slow_side = slow_place = 0.0
        fast = fast_width = fast_side = fast_place = 0.0
        for one, other in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            x, sign = d + one * p + other * q, one * other
            shift = sign * (one * grows[0] * p + other * grows[1] * q)
            square, angle, far = x * x + w * w, math.atan(x / w), abs(x)
            log, fall = math.log(square), math.expm1(-far / w)
            first = x * angle - 0.5 * w * log
            slow += sign * (0.5 * (x * x - w * w) * angle - 0.5 * w * x * log)
            slow_width -= sign * w * (w * angle + 0.5 * x * log)
            slow_side += shift * first
            slow_place += sign * first
            first = 0.5 * (far + w * fall)
            side = sign * math.copysign(0.5, x)
            fast += side * (0.5 * x * x - w * w * fall - w * far)
            fast_width -= side * w * (2.0 * w * fall + far * (2.0 + fall))
            fast_side += shift * first
            fast_place += sign * first
        both = grows[0] + grows[1]
        out[0, 0, i], out[0, 1, i] = 0.5 + slow / (math.pi * area), slow_width / (math.pi * area)
        out[0, 2, i] = (slow_side - both * slow) / (math.pi * area)
        out[0, 3, i] = slow_place / (math.pi * area)
        out[1, 0, i], out[1, 1, i] = 0.5 + fast / area, fast_width / area
        out[1, 2, i], out[1, 3, i] = (fast_side - both * fast) / area, fast_place / area


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
