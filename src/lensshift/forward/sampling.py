"""Compiled kernels: take weighted taps of the HR image for every LR pixel, and their adjoints.

All kernels overwrite `out`, work for real and complex arrays of single and double precision, and
can be called from other compiled code. `start` and `weight` [..., T] are as `Blur.taps` gives
them: tap t of a pixel lies on HR index start + t, inside the image.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]
Starts = NDArray[np.int64]

# Only the contraction of a * b + c is allowed to differ from strict arithmetic.
_FAST = {"contract"}


@njit(cache=True, nogil=True, fastmath=_FAST)
def _regular_run(start: Starts, weight: Array) -> tuple[int, int, int]:
    """Return (begin, end, stride) of the run of equal taps at equal steps around the middle."""
    count, taps = weight.shape
    middle = count // 2
    if count < 2:
        return middle, middle, 1
    stride = start[middle] - start[middle - 1]
    begin, end = middle, middle + 1
    if stride < 1:
        return middle, middle, 1
    while begin > 0 and start[begin] - start[begin - 1] == stride:
        same = True
        for t in range(taps):
            same = same and weight[begin - 1, t] == weight[middle, t]
        if not same:
            break
        begin -= 1
    while end < count and start[end] - start[end - 1] == stride:
        same = True
        for t in range(taps):
            same = same and weight[end, t] == weight[middle, t]
        if not same:
            break
        end += 1
    return begin, end, stride


@njit(cache=True, nogil=True, fastmath=_FAST)
def _split(line: Array, stride: int, count: int, planes: Array) -> None:
    """Put every stride-th sample into a plane of its own, so that the column pass is contiguous.

    The strides are spelt out because a loop vectorises only if its stride is a constant, and
    the copy is a loop because numba takes seconds to compile the assignment of a slice.
    """
    if stride == 1:
        for j in range(count):
            planes[0, j] = line[j]
    elif stride == 2:
        for phase in range(2):
            source, plane = line[phase:], planes[phase]
            for j in range((count - phase + 1) // 2):
                plane[j] = source[2 * j]
    elif stride == 3:
        for phase in range(3):
            source, plane = line[phase:], planes[phase]
            for j in range((count - phase + 2) // 3):
                plane[j] = source[3 * j]
    else:
        for phase in range(min(stride, count)):
            source, plane = line[phase:], planes[phase]
            for j in range((count - phase + stride - 1) // stride):
                plane[j] = source[stride * j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _merge(planes: Array, stride: int, count: int, line: Array) -> None:
    """Undo `_split`: add the planes to every stride-th sample of the line."""
    if stride == 1:
        for j in range(count):
            line[j] += planes[0, j]
    elif stride == 2:
        for phase in range(2):
            target, plane = line[phase:], planes[phase]
            for j in range((count - phase + 1) // 2):
                target[2 * j] += plane[j]
    elif stride == 3:
        for phase in range(3):
            target, plane = line[phase:], planes[phase]
            for j in range((count - phase + 2) // 3):
                target[3 * j] += plane[j]
    else:
        for phase in range(min(stride, count)):
            target, plane = line[phase:], planes[phase]
            for j in range((count - phase + stride - 1) // stride):
                target[stride * j] += plane[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def forward_separable(
    x: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    out: Array,
) -> None:
    """Sample the HR image, y[k,u,v] = sum_st row_weight[k,u,s] col_weight[k,v,t] x[..+s, ..+t].

    Parameters
    ----------
    x : [row col] HR image
    row_start, row_weight : [frame row] and [frame row S], the weights of the precision of x
    col_start, col_weight : [frame col] and [frame col T]
    out : [frame row col], overwritten
    """
    frames, rows, cols = out.shape
    width = x.shape[1]
    row_taps, col_taps = row_weight.shape[2], col_weight.shape[2]
    line = np.empty(width, x.dtype)
    for k in range(frames):
        begin, end, stride = _regular_run(col_start[k], col_weight[k])
        run = end - begin
        used = (run - 1) * stride + col_taps
        planes = np.empty((stride, width // stride + 1), x.dtype)
        for u in range(rows):
            top = row_start[k, u]
            weight = row_weight[k, u, 0]
            source = x[top]
            for j in range(width):
                line[j] = weight * source[j]
            for s in range(1, row_taps):
                weight = row_weight[k, u, s]
                source = x[top + s]
                for j in range(width):
                    line[j] += weight * source[j]
            target = out[k, u]
            target[:] = 0
            if run > 0:
                _split(line[col_start[k, begin] :], stride, used, planes)
                inner = target[begin:end]
                for t in range(col_taps):
                    weight = col_weight[k, begin, t]
                    part = planes[t % stride, t // stride :]
                    for j in range(run):
                        inner[j] += weight * part[j]
            for side in range(2):
                for v in range(0 if side == 0 else end, begin if side == 0 else cols):
                    for t in range(col_taps):
                        target[v] += col_weight[k, v, t] * line[col_start[k, v] + t]


@njit(cache=True, nogil=True, fastmath=_FAST)
def adjoint_separable(
    y: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    out: Array,
) -> None:
    """Spread LR pixels over the HR image; the exact adjoint of `forward_separable`.

    Parameters
    ----------
    y : [frame row col]
    row_start, row_weight, col_start, col_weight : as in `forward_separable`
    out : [row col] HR image, overwritten
    """
    frames, rows, cols = y.shape
    width = out.shape[1]
    row_taps, col_taps = row_weight.shape[2], col_weight.shape[2]
    line = np.empty(width, out.dtype)
    out[:] = 0
    for k in range(frames):
        begin, end, stride = _regular_run(col_start[k], col_weight[k])
        run = end - begin
        used = (run - 1) * stride + col_taps
        planes = np.empty((stride, width // stride + 1), out.dtype)
        for u in range(rows):
            source = y[k, u]
            line[:] = 0
            if run > 0:
                planes[:] = 0
                inner = source[begin:end]
                for t in range(col_taps):
                    weight = col_weight[k, begin, t]
                    part = planes[t % stride, t // stride :]
                    for j in range(run):
                        part[j] += weight * inner[j]
                _merge(planes, stride, used, line[col_start[k, begin] :])
            for side in range(2):
                for v in range(0 if side == 0 else end, begin if side == 0 else cols):
                    for t in range(col_taps):
                        line[col_start[k, v] + t] += col_weight[k, v, t] * source[v]
            top = row_start[k, u]
            for s in range(row_taps):
                weight = row_weight[k, u, s]
                target = out[top + s]
                for j in range(width):
                    target[j] += weight * line[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def forward_field(
    x: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    out: Array,
) -> None:
    """Sample the HR image with taps of its own for every LR pixel.

    Parameters
    ----------
    x : [row col] HR image
    row_start, row_weight : [frame row col] and [frame row col S]
    col_start, col_weight : [frame row col] and [frame row col T]
    out : [frame row col], overwritten
    """
    frames, rows, cols = out.shape
    row_taps, col_taps = row_weight.shape[3], col_weight.shape[3]
    for k in range(frames):
        for u in range(rows):
            for v in range(cols):
                top, left = row_start[k, u, v], col_start[k, u, v]
                out[k, u, v] = 0
                for s in range(row_taps):
                    part = col_weight[k, u, v, 0] * x[top + s, left]
                    for t in range(1, col_taps):
                        part += col_weight[k, u, v, t] * x[top + s, left + t]
                    out[k, u, v] += row_weight[k, u, v, s] * part


@njit(cache=True, nogil=True, fastmath=_FAST)
def adjoint_field(
    y: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    out: Array,
) -> None:
    """Spread LR pixels over the HR image; the exact adjoint of `forward_field`.

    Parameters
    ----------
    y : [frame row col]
    row_start, row_weight, col_start, col_weight : as in `forward_field`
    out : [row col] HR image, overwritten
    """
    frames, rows, cols = y.shape
    row_taps, col_taps = row_weight.shape[3], col_weight.shape[3]
    out[:] = 0
    for k in range(frames):
        for u in range(rows):
            for v in range(cols):
                top, left = row_start[k, u, v], col_start[k, u, v]
                value = y[k, u, v]
                for s in range(row_taps):
                    part = row_weight[k, u, v, s] * value
                    for t in range(col_taps):
                        out[top + s, left + t] += col_weight[k, u, v, t] * part
