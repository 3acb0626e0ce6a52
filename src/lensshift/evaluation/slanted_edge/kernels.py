"""Compiled loops: the response of an edge at pixels, sums over nodes between them, small matrices.

A BLAS takes longer where a matrix is a band, or half of it is enough. All inner loops over matrices
run along rows.

The covariance of the coefficients of splines at places n_i is

    K_ij = e_i e_j [k(n_i - n_j) + m k(n_i + n_j)]

Their heights, by which they raise the response up to each knot, are sums: h_i is the sum of
areas times coefficients up to i.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lensshift.core.arrays import Array

_ROOT_HALF = math.sqrt(0.5)
_INVERSE_ROOT_2PI = 1.0 / math.sqrt(2.0 * math.pi)
_FAR_SIDES = 16.0  # half sides of a pixel, where an error below 1e-6 is left
_FAR = 7.0  # standard deviations; what is left of the normal distribution there is 1e-12


@njit(cache=True, nogil=True, error_model="numpy")
def edge_slopes(normal_px: Array, p: float, q: float, sigma_px: float, out: Array) -> None:
    """Fill `out` [4 n] with the response of an edge, a trapezium and a Gaussian, and its slopes.

    These are by log sigma, by the log of the pixel's side, by the distance. The edge's normal sees
    half sides p, q of the pixel: the half widths of the trapezium are p + q and |p - q|.
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
    """Fill `out` [2 4 n] with the responses of an edge, a trapezium and either law of a tail.

    These are the Lorentzian w / (pi (x^2 + w^2)) and the Laplacian exp(-|x| / w) / 2 w, of each the
    response and its slopes as in `edge_slopes`, by log w first. `grows` says of p and q whether
    they follow the side of the pixel (1) or are at a limit (0).
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
    bent = 2.0 * half_variance * bend
    out[0, 1] = d * (-w / square - bent * (1.0 - 4.0 * w * w / square)) / math.pi
    out[0, 2] = -2.0 * d * bend * wider / math.pi
    out[0, 3] = (w / square - bent * (1.0 - 4.0 * d * d / square)) / math.pi
    out[1, 0] = 0.5 + side * (0.5 - fast * (1.0 + more))
    out[1, 1] = side * fast * (2.0 * more - abs(d) / w * (1.0 + more))
    out[1, 2] = -side * fast * wider / (w * w)
    out[1, 3] = fast / w * (1.0 + more)


@njit(cache=True, nogil=True, error_model="numpy")
def between_nodes(place: Array, nodes: Array, first: Array, shares: Array) -> None:
    """Fill in the shares [n 4] of four nodes [g] in each place [n], by cubic interpolation.

    `first` is the node after the place before, the first of the four afterwards.
    """
    last = nodes.size - 4
    for i in range(place.size):
        k = min(max(first[i] - 2, 0), last)
        first[i] = k
        a, b, c, d = place[i] - nodes[k : k + 4]
        ab, ac, ad = b - a, c - a, d - a
        bc, bd, cd = c - b, d - b, d - c
        shares[i, 0] = b * c * d / (ab * ac * ad)
        shares[i, 1] = -a * c * d / (ab * bc * bd)
        shares[i, 2] = a * b * d / (ac * bc * cd)
        shares[i, 3] = -a * b * c / (ad * bd * cd)


@njit(cache=True, nogil=True, error_model="numpy")
def node_products(
    pointers: Array, taps: Array, weights: Array, first: Array, shares: Array, powers: Array,
    right: Array, products: Array, with_right: Array,
) -> None:  # fmt: skip
    """Add up, over whitened pixels, products of what the nodes are to each of them.

        products[k, l] = sum W_k^T A^T A W_l,   with_right[k] = sum W_k^T A^T R

    with the whitener A [m n] in compressed rows and the interpolation W_k from the nodes, times the
    factor k of a pixel in `powers` [n k]; products [k k g g] and with_right [k g q] are zero
    before.
    """
    kinds, nodes, columns = with_right.shape
    row = np.zeros((kinds, nodes))
    for r in range(right.shape[0]):
        start, stop = nodes, 0
        for t in range(pointers[r], pointers[r + 1]):
            i = taps[t]
            at = first[i]
            start, stop = min(start, at), max(stop, at + 4)
            for k in range(kinds):
                weight = weights[t] * powers[i, k]
                for s in range(4):
                    row[k, at + s] += weight * shares[i, s]
        for k in range(kinds):
            for a in range(start, stop):
                own = row[k, a]
                if own == 0.0:
                    continue
                for other in range(k):
                    for b in range(start, stop):
                        products[k, other, a, b] += own * row[other, b]
                for b in range(start, a + 1):
                    products[k, k, a, b] += own * row[k, b]
                for q in range(columns):
                    with_right[k, a, q] += own * right[r, q]
        row[:, start:stop] = 0.0
    for k in range(kinds):
        for a in range(nodes):
            for b in range(a):
                products[k, k, b, a] = products[k, k, a, b]
        for other in range(k):
            products[other, k] = products[k, other].T


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def across_nodes(products: Array, reach: Array, power: Array, seen: Array, out: Array) -> None:
    """Fill in [k s g] what pixels see of columns [s g], each of a power, times all their factors.

    out[k, m] = products[k, power_m] seen[m],   of nodes from reach[a, 0] to reach[a, 1]
    """
    for k in range(products.shape[0]):
        for a in range(seen.shape[1]):
            for m in range(seen.shape[0]):
                other, total = power[m], 0.0
                for b in range(reach[a, 0], reach[a, 1]):
                    total += products[k, other, a, b] * seen[m, b]
                out[k, m, a] = total


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
    sensitivity: Array, number: Array, weight: Array, near: Array, longer: Array, wider: Array,
    symmetry: float,
) -> tuple[float, float, float, float]:  # fmt: skip
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
