"""Compiled kernels: take weighted taps of the HR image for every LR pixel, and their adjoints.

All kernels overwrite `out` and work in single and double precision; complex arrays come as two real
ones, which compiles half as much. `start` and `weight` [..., T] are as `Blur.taps` gives
them: tap t of a pixel lies on HR index start + t, inside the image.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.arrays import Array

Starts = NDArray[np.int64]

# Only the contraction of a * b + c is allowed to differ from strict arithmetic.
_FAST = {"contract"}


def regular_runs(start: Starts, weight: Array) -> NDArray[np.int64]:
    """Return [frame 3] begin, end and stride of the run of equal taps around the middle pixel.

    Parameters
    ----------
    start, weight : [frame pixel] and [frame pixel T]
    """
    count = start.shape[1]
    middle = count // 2
    if count == 1:
        return np.tile([middle, middle, 1], (len(start), 1))
    step = np.diff(start, axis=1)
    stride = step[:, middle - 1 : middle]
    same = (step == stride) & (stride > 0)
    same &= (weight[:, 1:] == weight[:, :-1]).all(axis=2)
    # The pixels beyond the first place before, and behind, the middle where the taps change.
    before = np.cumprod(same[:, :middle][:, ::-1], axis=1).sum(axis=1)
    behind = np.cumprod(same[:, middle:], axis=1).sum(axis=1)
    found = np.stack([middle - before, middle + 1 + behind, stride[:, 0]], axis=1)
    return np.asarray(np.where(stride > 0, found, [middle, middle, 1]), np.int64)


@njit(cache=True, nogil=True, fastmath=_FAST)
def split_line(line: Array, stride: int, count: int, planes: Array) -> None:
    """Put every stride-th sample into a plane of its own, so that the column pass is contiguous.

    Two is spelt out because a loop vectorises only if its stride is a constant, and the copy is a
    loop because numba takes seconds to compile the assignment of a slice.
    """
    for phase in range(min(stride, count)):
        source, plane = line[phase:], planes[phase]
        if stride == 2:
            for j in range((count - phase + 1) // 2):
                plane[j] = source[2 * j]
        else:
            for j in range((count - phase + stride - 1) // stride):
                plane[j] = source[stride * j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def merge_line(planes: Array, stride: int, count: int, line: Array) -> None:
    """Undo `split_line`: add the planes to every stride-th sample of the line."""
    for phase in range(min(stride, count)):
        target, plane = line[phase:], planes[phase]
        if stride == 2:
            for j in range((count - phase + 1) // 2):
                target[2 * j] += plane[j]
        else:
            for j in range((count - phase + stride - 1) // stride):
                target[stride * j] += plane[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def sample_frame(
    x: Array, row_start: Starts, row_weight: Array, start: Starts, weight: Array, run: Starts,
    out: Array,
) -> None:  # fmt: skip
    """Take the taps of one frame: row taps into a line, then column taps from the line."""
    width = x.shape[1]
    count, taps = weight.shape
    begin, end, stride = run[0], run[1], run[2]
    line, planes = np.empty(width, x.dtype), np.empty((stride, width // stride + 1), x.dtype)
    for u in range(row_start.size):
        top = row_start[u]
        source, factor = x[top], row_weight[u, 0]
        for j in range(width):
            line[j] = factor * source[j]
        for s in range(1, row_weight.shape[1]):
            source, factor = x[top + s], row_weight[u, s]
            for j in range(width):
                line[j] += factor * source[j]
        target = out[u]
        for v in range(count):
            target[v] = 0
        if end > begin:
            split_line(line[start[begin] :], stride, (end - begin - 1) * stride + taps, planes)
            inner = target[begin:end]
            for t in range(taps):
                part, factor = planes[t % stride, t // stride :], weight[begin, t]
                for j in range(end - begin):
                    inner[j] += factor * part[j]
        for first, last in ((0, begin), (end, count)):
            for v in range(first, last):
                for t in range(taps):
                    target[v] += weight[v, t] * line[start[v] + t]


@njit(cache=True, nogil=True, fastmath=_FAST)
def spread_frame(
    y: Array, row_start: Starts, row_weight: Array, start: Starts, weight: Array, run: Starts,
    out: Array,
) -> None:  # fmt: skip
    """Add one frame, spread over its taps, to the HR image; the adjoint of `sample_frame`.

    Of rows of the image that are not there, as beside a band of it, nothing is written.
    """
    width = out.shape[1]
    count, taps = weight.shape
    begin, end, stride = run[0], run[1], run[2]
    line, planes = np.empty(width, out.dtype), np.empty((stride, width // stride + 1), out.dtype)
    for u in range(row_start.size):
        source = y[u]
        for j in range(width):
            line[j] = 0
        if end > begin:
            planes[:] = 0
            inner = source[begin:end]
            for t in range(taps):
                part, factor = planes[t % stride, t // stride :], weight[begin, t]
                for j in range(end - begin):
                    part[j] += factor * inner[j]
            merge_line(planes, stride, (end - begin - 1) * stride + taps, line[start[begin] :])
        for first, last in ((0, begin), (end, count)):
            for v in range(first, last):
                for t in range(taps):
                    line[start[v] + t] += weight[v, t] * source[v]
        top = row_start[u]
        for s in range(max(0, -top), min(row_weight.shape[1], len(out) - top)):
            target, factor = out[top + s], row_weight[u, s]
            for j in range(width):
                target[j] += factor * line[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def forward_separable(
    x: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    col_run: Starts,
    out: Array,
) -> None:
    """Sample the HR image, y[k,u,v] = sum_st row_weight[k,u,s] col_weight[k,v,t] x[..+s, ..+t].

    Parameters
    ----------
    x : [row col] HR image
    row_start, row_weight : [frame row] and [frame row S], the weights of the precision of x
    col_start, col_weight, col_run : [frame col], [frame col T], and as from `regular_runs`
    out : [frame row col], overwritten
    """
    for k in range(out.shape[0]):
        sample_frame(
            x, row_start[k], row_weight[k], col_start[k], col_weight[k], col_run[k], out[k]
        )


@njit(cache=True, nogil=True, fastmath=_FAST)
def adjoint_separable(
    y: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    col_run: Starts,
    out: Array,
) -> None:
    """Spread LR pixels over the HR image; the exact adjoint of `forward_separable`.

    Parameters
    ----------
    y : [frame row col]
    row_start, row_weight, col_start, col_weight, col_run : as in `forward_separable`
    out : [row col] HR image, overwritten
    """
    out[:] = 0
    for k in range(y.shape[0]):
        spread_frame(
            y[k], row_start[k], row_weight[k], col_start[k], col_weight[k], col_run[k], out
        )


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
    row_taps, col_taps = np.uintp(row_weight.shape[3]), np.uintp(col_weight.shape[3])
    for k in range(frames):
        for u in range(rows):
            for v in range(cols):
                # Unsigned, so that no index is tested for counting from the end.
                top, left = np.uintp(row_start[k, u, v]), np.uintp(col_start[k, u, v])
                row, col = row_weight[k, u, v], col_weight[k, u, v]
                out[k, u, v] = 0
                for s in range(row_taps):
                    part = col[0] * x[top + s, left]
                    for t in range(np.uintp(1), col_taps):
                        part += col[t] * x[top + s, left + t]
                    out[k, u, v] += row[s] * part


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
    row_taps, col_taps = np.uintp(row_weight.shape[3]), np.uintp(col_weight.shape[3])
    out[:] = 0
    for k in range(frames):
        for u in range(rows):
            for v in range(cols):
                top, left = np.uintp(row_start[k, u, v]), np.uintp(col_start[k, u, v])
                row, col = row_weight[k, u, v], col_weight[k, u, v]
                for s in range(row_taps):
                    part = row[s] * y[k, u, v]
                    for t in range(col_taps):
                        out[top + s, left + t] += col[t] * part
