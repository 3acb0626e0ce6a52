"""Compiled conjugate gradients of IRW-SR in single precision, one call for all inner steps.

Both solvers are handed the negative gradient r of half the majorised objective, which they
overwrite, and move x in place. The preconditioner is the inverse of about the diagonal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.forward.sampling import (
    adjoint_field,
    adjoint_separable,
    forward_field,
    forward_separable,
)
from lensshift.reconstruction.differences import add_laplacian_diagonal, add_weighted_laplacian

Array = NDArray[Any]

# Keeps the preconditioner finite where no LR pixel looks.
_LEAST = np.float32(1e-6)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def convolve(image: Array, kernel: Array, out: Array) -> None:
    """Write the separable convolution with a symmetric kernel into out, zeros outside."""
    rows, cols = image.shape
    radius = len(kernel) // 2
    padded = np.zeros(cols + 2 * radius, image.dtype)
    line = padded[radius : radius + cols]
    zero = np.zeros(cols, image.dtype)
    for i in range(rows):
        source, factor = image[i], kernel[radius]
        for j in range(cols):
            line[j] = factor * source[j]
        for t in range(1, radius + 1):
            above = image[i - t] if i >= t else zero
            below = image[i + t] if i + t < rows else zero
            factor = kernel[radius + t]
            for j in range(cols):
                line[j] += factor * (above[j] + below[j])
        target, factor = out[i], kernel[radius]
        for j in range(cols):
            target[j] = factor * line[j]
        for t in range(1, radius + 1):
            left, right = padded[radius - t :], padded[radius + t :]
            factor = kernel[radius + t]
            for j in range(cols):
                target[j] += factor * (left[j] + right[j])


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def interlaced_residual(
    x: Array, kernel: Array, norm: Array, row_index: Array, col_index: Array, y: Array,
    blurred: Array, out: Array,
) -> None:  # fmt: skip
    """Write y - norm (K x) at the HR pixels of the LR pixels into out [frame row col]."""
    convolve(x, kernel, blurred)
    for k in range(out.shape[0]):
        columns = col_index[k]
        for u in range(out.shape[1]):
            source, scale = blurred[row_index[k, u]], norm[row_index[k, u]]
            seen, target = y[k, u], out[k, u]
            for v in range(target.size):
                j = np.uintp(columns[v])
                target[v] = seen[v] - source[j] * scale[j]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def interlaced_adjoint(
    values: Array, weight: Array, kernel: Array, norm: Array, row_index: Array, col_index: Array,
    image: Array, out: Array,
) -> None:  # fmt: skip
    """Write K norm (weight values, added up in the HR pixels of the LR pixels) into out."""
    scatter(values, weight, row_index, col_index, image)
    multiply(image, norm)
    convolve(image, kernel, out)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def scatter(values: Array, weight: Array, row_index: Array, col_index: Array, out: Array) -> None:
    """Add weight values [frame row col] up in the HR pixels of the LR pixels, out [row col]."""
    out[:] = 0
    for k in range(values.shape[0]):
        columns = col_index[k]
        for u in range(values.shape[1]):
            source, share, target = values[k, u], weight[k, u], out[row_index[k, u]]
            for v in range(source.size):
                target[np.uintp(columns[v])] += share[v] * source[v]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def multiply(image: Array, by: Array) -> None:
    """Multiply an image [row col] in place."""
    for i in range(len(image)):
        line, factor = image[i], by[i]
        for j in range(line.size):
            line[j] *= factor[j]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        p, q, part = a[i], b[i], np.float32(0.0)
        for j in range(p.size):
            part += p[j] * q[j]
        total += float(part)
    return total


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _advance(x: Array, r: Array, p: Array, q: Array, inverse: Array, step: float) -> float:
    """Take x += step p, r -= step q; return r . (inverse r)."""
    s, total = np.float32(step), 0.0
    for i in range(len(x)):
        xs, rs, ps, qs, scale = x[i], r[i], p[i], q[i], inverse[i]
        part = np.float32(0.0)
        for j in range(xs.size):
            xs[j] += s * ps[j]
            rest = rs[j] - s * qs[j]
            rs[j] = rest
            part += rest * rest * scale[j]
        total += float(part)
    return total


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _turn(p: Array, r: Array, inverse: Array, share: float) -> None:
    """Set p = inverse r + share p."""
    s = np.float32(share)
    for i in range(len(p)):
        ps, rs, scale = p[i], r[i], inverse[i]
        for j in range(ps.size):
            ps[j] = scale[j] * rs[j] + s * ps[j]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _precondition(
    seen: Array, column_square: float, a: Array, directions: Array, inverse: Array
) -> None:
    """Write 1 / (column_square seen + diagonal of sum D^T a D) into inverse [row col]."""
    square = np.float32(column_square)
    for i in range(len(seen)):
        line, source = inverse[i], seen[i]
        for j in range(line.size):
            line[j] = square * source[j] + _LEAST
    add_laplacian_diagonal(a, directions, inverse)
    for i in range(len(seen)):
        line = inverse[i]
        for j in range(line.size):
            line[j] = np.float32(1.0) / line[j]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def solve_interlaced(
    x: Array, r: Array, ones: Array, weight: Array, kernel: Array, norm: Array,
    row_index: Array, col_index: Array, column_square: float, a: Array,
    directions: Array, iterations: int, work: Array,
) -> None:  # fmt: skip
    """Run conjugate gradients on (K S K + sum D^T a D) dx = r, K the convolution; x += dx.

    S is the diagonal of the squared norm at the HR pixels that LR pixels see, times their weight.

    Parameters
    ----------
    x, r, norm : [row col]
    ones, weight : [frame row col]
    a : [direction row col]
    work : [5 row col] work space, allocated once because fresh memory is slow at first
    """
    inverse, p, q, blurred, seen = work[0], work[1], work[2], work[3], work[4]
    scatter(ones, weight, row_index, col_index, seen)
    multiply(seen, norm)
    multiply(seen, norm)
    _precondition(seen, column_square, a, directions, inverse)
    p[:] = 0
    _turn(p, r, inverse, 0.0)
    rz = _dot(p, r)
    for _ in range(iterations):
        if not rz > 1e-20:
            break
        convolve(p, kernel, blurred)
        multiply(blurred, seen)
        convolve(blurred, kernel, q)
        add_weighted_laplacian(p, a, directions, q)
        fresh = _advance(x, r, p, q, inverse, rz / _dot(p, q))
        _turn(p, r, inverse, fresh / rz)
        rz = fresh


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def solve_sampled(
    x: Array, r: Array, weight: Array, row_start: Array, row_weight: Array, col_start: Array,
    col_weight: Array, seen: Array, column_square: float, a: Array, directions: Array,
    iterations: int, work: Array, y: Array,
) -> None:  # fmt: skip
    """Run conjugate gradients on (A^T W A + sum D^T a D) dx = r, A by its taps; x += dx.

    Parameters
    ----------
    x, r, seen : [row col]; seen is A^T w
    weight : [frame row col]
    row_start .. col_weight : taps of one shift per frame, or of a shift field
    a : [direction row col]
    work, y : [3 row col] and [frame row col] work space
    """
    inverse, p, q = work[0], work[1], work[2]
    _precondition(seen, column_square, a, directions, inverse)
    p[:] = 0
    _turn(p, r, inverse, 0.0)
    rz = _dot(p, r)
    for _ in range(iterations):
        if not rz > 1e-20:
            break
        if row_start.ndim == 3:
            forward_field(p, row_start, row_weight, col_start, col_weight, y)
        else:
            forward_separable(p, row_start, row_weight, col_start, col_weight, y)
        for k in range(len(y)):
            multiply(y[k], weight[k])
        if row_start.ndim == 3:
            adjoint_field(y, row_start, row_weight, col_start, col_weight, q)
        else:
            adjoint_separable(y, row_start, row_weight, col_start, col_weight, q)
        add_weighted_laplacian(p, a, directions, q)
        fresh = _advance(x, r, p, q, inverse, rz / _dot(p, q))
        _turn(p, r, inverse, fresh / rz)
        rz = fresh
