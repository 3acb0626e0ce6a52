"""Compiled loops of IRW-SR in single precision: medians, weights, conjugate gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.forward.sampling import adjoint_separable, forward_separable
from lensshift.reconstruction.differences import add_laplacian_diagonal, add_weighted_laplacian

Array = NDArray[Any]

BINS = 2048


@njit(cache=True, fastmath=True, nogil=True)
def weighted_median(values: Array, weights: Array, centre: float, fold: bool) -> float:
    """Return the weighted median of values (or of |values - centre| if `fold`).

    A histogram finds the bin that holds half of the weight; inside the bin the weight counts as
    spread evenly, which is exact to 1 / 2048 of the spread of the values.
    """
    low, high, total = np.inf, -np.inf, 0.0
    for n in range(values.size):
        v = abs(values[n] - centre) if fold else values[n]
        low, high = min(low, v), max(high, v)
        total += weights[n]
    if total <= 0.0 or high <= low:
        return low if total > 0.0 else 0.0
    # Long tails would leave most of the bins empty, so the search narrows down twice.
    for _ in range(2):
        histogram = np.zeros(BINS)
        below, unit = 0.0, BINS / (high - low)
        for n in range(values.size):
            v = abs(values[n] - centre) if fold else values[n]
            if v < low:
                below += weights[n]
            elif v <= high:
                histogram[min(int((v - low) * unit), BINS - 1)] += weights[n]
        reached = below
        for b in range(BINS):
            if reached + histogram[b] >= 0.5 * total:
                break
            reached += histogram[b]
        share = (0.5 * total - reached) / histogram[b] if histogram[b] > 0 else 0.0
        start = low + b / unit
        result = start + share / unit
        low, high = start, start + 1.0 / unit
        if high - low < 1e-4 * abs(result):
            break
    return result


@njit(cache=True, fastmath=True, nogil=True)
def observation_weights(
    residual: Array, static: Array, confidence: Array, bias_threshold: float
) -> float:
    """Update the confidence [frame pixel] of the LR pixels in place and return their noise.

        sigma = 1.4826 MAD(r),   beta = [|median r_k| < bias] min(1, 2 sigma / |r|)

    Parameters
    ----------
    residual, static : [frame pixel]; static is the weight that the caller gives
    confidence : [frame pixel] of the step before; static * beta afterwards
    """
    for k in range(len(residual)):
        bias = weighted_median(residual[k], static[k], 0.0, False)
        if abs(bias) >= bias_threshold:
            for n in range(residual.shape[1]):
                confidence[k, n] = 0.0
    flat, trust = residual.ravel(), confidence.ravel()
    centre = weighted_median(flat, trust, 0.0, False)
    sigma = max(1.4826 * weighted_median(flat, trust, centre, True), 1e-7)
    for k in range(len(residual)):
        bias = weighted_median(residual[k], static[k], 0.0, False)
        frame = 1.0 if abs(bias) < bias_threshold else 0.0
        for n in range(residual.shape[1]):
            size = max(abs(residual[k, n]), np.float32(1e-12))
            confidence[k, n] = frame * static[k, n] * min(1.0, 2.0 * sigma / size)
    return sigma


@njit(cache=True, fastmath=True, nogil=True)
def median_3x3(image: Array, out: Array) -> None:
    """Write the 3 x 3 median of an image into out, zeros outside (Paeth's network of 19)."""
    rows, cols = image.shape
    zero = np.zeros(cols + 2, image.dtype)
    up, mid, low = zero.copy(), zero.copy(), zero.copy()
    for j in range(cols):
        mid[j + 1] = image[0, j]
    for i in range(rows):
        for j in range(cols):
            low[j + 1] = image[i + 1, j] if i + 1 < rows else 0
        target = out[i]
        a0, a1, a2 = up[:cols], up[1 : cols + 1], up[2 : cols + 2]
        b0, b1, b2 = mid[:cols], mid[1 : cols + 1], mid[2 : cols + 2]
        c0, c1, c2 = low[:cols], low[1 : cols + 1], low[2 : cols + 2]
        for j in range(cols):
            # Sort each column of three; the median is the median of three of the extremes.
            p, q, r = a0[j], b0[j], c0[j]
            p, q = min(p, q), max(p, q)
            q, r = min(q, r), max(q, r)
            p, q = min(p, q), max(p, q)
            s, t, u = a1[j], b1[j], c1[j]
            s, t = min(s, t), max(s, t)
            t, u = min(t, u), max(t, u)
            s, t = min(s, t), max(s, t)
            v, w, x = a2[j], b2[j], c2[j]
            v, w = min(v, w), max(v, w)
            w, x = min(w, x), max(w, x)
            v, w = min(v, w), max(v, w)
            lowest = max(p, max(s, v))
            highest = min(r, min(u, x))
            middle = max(min(q, t), min(max(q, t), w))
            target[j] = max(min(lowest, middle), min(max(lowest, middle), highest))
        up, mid, low = mid, low, up


@njit(cache=True, fastmath=True, nogil=True)
def prior_weights(steps: Array, share: Array, exponent: float, median: Array, beta: Array) -> float:
    """Update the weights of the differences in place and return their scale.

        beta = 1 if |z| <= 2 s else p (2 s / |z|)^(1 - p),   z = median3x3(share_d D_d x)

    with s the weighted median absolute deviation of z. Source: Koehler et al. 2016.

    Parameters
    ----------
    steps : [direction row col] differences
    share : [direction] alpha^(|l| + |m|)
    median : [direction row col] work space
    beta : [direction row col] weights of the step before; the new ones afterwards
    """
    for d in range(len(steps)):
        median_3x3(steps[d], median[d])
        z = median[d].ravel()
        for n in range(z.size):
            z[n] *= share[d]
    flat, weight = median.ravel(), beta.ravel()
    centre = weighted_median(flat, weight, 0.0, False)
    scale = max(weighted_median(flat, weight, centre, True), 1e-9)
    limit = np.float32(2.0 * scale)
    power = np.float32(1.0 - exponent)
    p = np.float32(exponent)
    if exponent == 0.5:
        for n in range(flat.size):
            size = max(abs(flat[n]), np.float32(1e-12))
            weight[n] = np.float32(1.0) if size <= limit else p * np.sqrt(limit / size)
    else:
        for n in range(flat.size):
            size = max(abs(flat[n]), np.float32(1e-12))
            weight[n] = np.float32(1.0) if size <= limit else p * (limit / size) ** power
    return scale


@njit(cache=True, fastmath=True, nogil=True)
def penalty_and_coefficients(
    steps: Array, beta: Array, share: Array, prior_weight: float, mu: float, a: Array
) -> float:
    """Write the quadratic that touches the prior from above into a; return the prior's value.

    2 lambda sum_d share_d beta_d sqrt(e_d^2 + mu),   a_d = lambda share_d beta_d / sqrt(...)
    """
    total = 0.0
    for d in range(len(steps)):
        e, w, out = steps[d].ravel(), beta[d].ravel(), a[d].ravel()
        factor, floor = np.float32(prior_weight * share[d]), np.float32(mu)
        part = np.float32(0.0)
        for n in range(e.size):
            root = np.sqrt(e[n] * e[n] + floor)
            out[n] = factor * w[n] / root
            part += factor * w[n] * root
        total += 2.0 * float(part)
    return total


@njit(cache=True, fastmath=True, nogil=True)
def convolve(image: Array, kernel: Array, work: Array, out: Array) -> None:
    """Write the separable convolution with a symmetric kernel into out, zeros outside."""
    rows, cols = image.shape
    radius = len(kernel) // 2
    padded = np.zeros(cols + 2 * radius, image.dtype)
    for i in range(rows):
        line = work[i]
        centre = image[i]
        for j in range(cols):
            line[j] = kernel[radius] * centre[j]
        for t in range(1, radius + 1):
            if i - t >= 0:
                above = image[i - t]
                for j in range(cols):
                    line[j] += kernel[radius + t] * above[j]
            if i + t < rows:
                below = image[i + t]
                for j in range(cols):
                    line[j] += kernel[radius + t] * below[j]
        inner = padded[radius : radius + cols]
        for j in range(cols):
            inner[j] = line[j]
        target = out[i]
        for j in range(cols):
            target[j] = kernel[radius] * inner[j]
        for t in range(1, radius + 1):
            left, right = padded[radius - t : radius - t + cols], padded[radius + t :]
            for j in range(cols):
                target[j] += kernel[radius + t] * (left[j] + right[j])


@njit(cache=True, fastmath=True, nogil=True)
def _dot(a: Array, b: Array) -> float:
    x, y = a.ravel(), b.ravel()
    total = 0.0
    for start in range(0, x.size, 4096):
        part = np.float32(0.0)
        for n in range(start, min(start + 4096, x.size)):
            part += x[n] * y[n]
        total += float(part)
    return total


@njit(cache=True, fastmath=True, nogil=True)
def _update(x: Array, r: Array, p: Array, q: Array, inverse: Array, step: float) -> float:
    """x += step p, r -= step q; return r . (inverse r)."""
    x_, r_, p_, q_, i_ = x.ravel(), r.ravel(), p.ravel(), q.ravel(), inverse.ravel()
    s, total = np.float32(step), 0.0
    for start in range(0, x_.size, 4096):
        part = np.float32(0.0)
        for n in range(start, min(start + 4096, x_.size)):
            x_[n] += s * p_[n]
            value = r_[n] - s * q_[n]
            r_[n] = value
            part += value * value * i_[n]
        total += float(part)
    return total


@njit(cache=True, fastmath=True, nogil=True)
def _redirect(p: Array, r: Array, inverse: Array, beta: float) -> None:
    """p = inverse r + beta p."""
    p_, r_, i_ = p.ravel(), r.ravel(), inverse.ravel()
    b = np.float32(beta)
    for n in range(p_.size):
        p_[n] = i_[n] * r_[n] + b * p_[n]


@njit(cache=True, fastmath=True, nogil=True)
def _scale(image: Array, by: Array) -> None:
    """image *= by."""
    v, w = image.ravel(), by.ravel()
    for n in range(v.size):
        v[n] *= w[n]


@njit(cache=True, fastmath=True, nogil=True)
def solve_interlaced(
    x: Array, b: Array, weight: Array, kernel: Array, a: Array, directions: Array,
    seen: float, iterations: int,
) -> None:  # fmt: skip
    """Run conjugate gradients on (K W K + sum D^T a D) x = b, K the convolution, x in place.

    Parameters
    ----------
    x, b, weight : [row col]
    a : [direction row col]
    seen : sum of the squares of the kernel, for the preconditioner
    """
    inverse, work, q = np.empty_like(x), np.empty_like(x), np.empty_like(x)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            inverse[i, j] = np.float32(seen) * weight[i, j] + np.float32(1e-6)
    add_laplacian_diagonal(a, directions, inverse)
    flat = inverse.ravel()
    for n in range(flat.size):
        flat[n] = np.float32(1.0) / flat[n]
    convolve(x, kernel, work, q)
    _scale(q, weight)
    r = np.empty_like(x)
    convolve(q, kernel, work, r)
    add_weighted_laplacian(x, a, directions, r)
    p = np.zeros_like(x)
    rz = 0.0
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            r[i, j] = b[i, j] - r[i, j]
            rz += r[i, j] * r[i, j] * inverse[i, j]
    _redirect(p, r, inverse, 0.0)
    blurred = np.empty_like(x)
    for _ in range(iterations):
        if rz <= 1e-20:
            break
        convolve(p, kernel, work, blurred)
        _scale(blurred, weight)
        convolve(blurred, kernel, work, q)
        add_weighted_laplacian(p, a, directions, q)
        fresh = _update(x, r, p, q, inverse, rz / _dot(p, q))
        _redirect(p, r, inverse, fresh / rz)
        rz = fresh


@njit(cache=True, fastmath=True, nogil=True)
def solve_separable(
    x: Array, b: Array, weight: Array, row_start: Array, row_weight: Array, col_start: Array,
    col_weight: Array, inverse: Array, a: Array, directions: Array, iterations: int,
) -> None:  # fmt: skip
    """Run conjugate gradients on (A^T W A + sum D^T a D) x = b for constant shifts, x in place.

    Parameters
    ----------
    x, b, inverse : [row col]; inverse is the preconditioner
    weight : [frame row col]
    a : [direction row col]
    """
    y = np.empty_like(weight)
    r = np.empty_like(x)
    forward_separable(x, row_start, row_weight, col_start, col_weight, y)
    _scale(y, weight)
    adjoint_separable(y, row_start, row_weight, col_start, col_weight, r)
    add_weighted_laplacian(x, a, directions, r)
    p, q = np.zeros_like(x), np.empty_like(x)
    rz = 0.0
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            r[i, j] = b[i, j] - r[i, j]
            rz += r[i, j] * r[i, j] * inverse[i, j]
    _redirect(p, r, inverse, 0.0)
    for _ in range(iterations):
        if rz <= 1e-20:
            break
        forward_separable(p, row_start, row_weight, col_start, col_weight, y)
        _scale(y, weight)
        adjoint_separable(y, row_start, row_weight, col_start, col_weight, q)
        add_weighted_laplacian(p, a, directions, q)
        fresh = _update(x, r, p, q, inverse, rz / _dot(p, q))
        _redirect(p, r, inverse, fresh / rz)
        rz = fresh
