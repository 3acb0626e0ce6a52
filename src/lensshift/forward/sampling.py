"""Compiled kernels: take weighted taps of the HR image for every LR pixel, and their adjoints.

All kernels overwrite `out` and work in single and double precision; complex arrays come as two real
ones, which compiles half as much. `start` and `weight` [..., T] are as `Blur.taps` gives
them: tap t of a pixel lies on HR index start + t, inside the image.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit

from lensshift.core.arrays import Array
from lensshift.core.threads import bands, core_count, on_threads
from lensshift.forward.blur import Starts

WORTH_THREADS = 2**16  # pixels of frames or image: below, waking a thread takes as long as the work
# Only the contraction of a * b + c is allowed to differ from strict arithmetic.
_FAST = {"contract"}


def regular_runs(start: Starts, weight: Array, stride: int) -> Starts:
    """Return [frame 2] begin and end of the run of taps, equal and a stride apart, in the middle.

    Parameters
    ----------
    start, weight : [frame pixel] and [frame pixel T]
    """
    middle = start.shape[1] // 2
    same = np.diff(start, axis=1) == stride
    same &= (weight[:, 1:] == weight[:, :-1]).all(axis=2)
    # The pixels beyond the first place before, and behind, the middle where the taps change.
    before = np.cumprod(same[:, :middle][:, ::-1], axis=1).sum(axis=1)
    behind = np.cumprod(same[:, middle:], axis=1).sum(axis=1)
    return np.stack([middle - before, middle + 1 + behind], axis=1).astype(np.int64)


def in_bands(kernel: Any, values: Array, *taps_and_out: Array) -> None:
    """Run a separable kernel, on a large picture with a band of rows on each core.

    Every number is computed from the same numbers in the same order: pictures do not depend on the
    cores.
    """
    *taps, out = taps_and_out
    rows = out.shape[-2]
    if max(values.size, out.size) < WORTH_THREADS or core_count() < 2:
        kernel(values, *taps, 0, rows, out)
    else:
        cut = bands(rows, core_count())
        on_threads([partial(kernel, values, *taps, *band, out) for band in cut])


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def forward_separable(
    x: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    col_run: Starts,
    first: int,
    last: int,
    out: Array,
) -> None:
    """Sample the HR image, y[k,u,v] = sum_st row_weight[k,u,s] col_weight[k,v,t] x[..+s, ..+t].

    Row taps go into a line, column taps are taken from the line, its every stride-th sample in a
    part of its own, so that both passes are contiguous.

    Parameters
    ----------
    x : [row col] HR image, its columns a multiple of those of a frame
    row_start, row_weight : [frame row] and [frame row S], the weights of the precision of x
    col_start, col_weight, col_run : [frame col], [frame col T], and as from `regular_runs`
    first, last : LR rows from and to which `out` is written
    out : [frame row col], overwritten
    """
    # Unsigned, so that no index is tested for counting from the end.
    frames, count = np.uintp(out.shape[0]), np.uintp(out.shape[2])
    row_taps, col_taps = np.uintp(row_weight.shape[2]), np.uintp(col_weight.shape[2])
    width = np.uintp(x.shape[1])
    stride = width // count
    line, parts = np.empty(x.shape[1], x.dtype), np.empty(x.shape[1], x.dtype)
    for k in range(frames):
        begin = np.uintp(col_run[k, 0])
        inside = np.uintp(col_run[k, 1]) - begin
        for u in range(np.uintp(first), np.uintp(last)):
            row, factor = np.uintp(row_start[k, u]), row_weight[k, u, 0]
            for j in range(width):
                line[j] = factor * x[row, j]
            for s in range(np.uintp(1), row_taps):
                factor = row_weight[k, u, s]
                for j in range(width):
                    line[j] += factor * x[row + s, j]
            if stride == 2:  # spelt out, because a loop vectorises only if its stride is a constant
                for j in range(count):
                    parts[j], parts[count + j] = line[2 * j], line[2 * j + 1]
            else:
                for phase in range(stride):
                    for j in range(count):
                        parts[phase * count + j] = line[stride * j + phase]
            for v in range(count):
                out[k, u, v] = 0
            for t in range(col_taps):
                at, factor = np.uintp(col_start[k, begin]) + t, col_weight[k, begin, t]
                part = at % stride * count + at // stride
                for j in range(inside):
                    out[k, u, begin + j] += factor * parts[part + j]
            for n in range(count - inside):
                pixel = np.uintp(n if n < begin else n + inside)
                for t in range(col_taps):
                    out[k, u, pixel] += (
                        col_weight[k, pixel, t] * line[np.uintp(col_start[k, pixel]) + t]
                    )


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def adjoint_separable(
    y: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    col_run: Starts,
    first: int,
    last: int,
    out: Array,
) -> None:
    """Spread LR pixels over the HR image; the exact adjoint of `forward_separable`.

    Parameters
    ----------
    y : [frame row col]
    row_start, row_weight, col_start, col_weight, col_run : as in `forward_separable`
    first, last : HR rows from and to which `out` is written
    out : [row col] HR image, overwritten
    """
    frames, count, taps = np.uintp(y.shape[0]), np.uintp(y.shape[2]), np.uintp(col_weight.shape[2])
    width = np.uintp(out.shape[1])
    stride = width // count
    line, parts = np.empty(out.shape[1], y.dtype), np.empty(out.shape[1], y.dtype)
    for i in range(np.uintp(first), np.uintp(last)):
        for j in range(width):
            out[i, j] = 0
    for k in range(frames):
        begin = np.uintp(col_run[k, 0])
        inside = np.uintp(col_run[k, 1]) - begin
        for u in range(y.shape[1]):
            top = row_start[k, u]
            lower, upper = max(first, top), min(last, top + row_weight.shape[2])
            if lower >= upper:
                continue
            for j in range(width):
                parts[j] = 0
            for t in range(taps):
                at, factor = np.uintp(col_start[k, begin]) + t, col_weight[k, begin, t]
                part = at % stride * count + at // stride
                for j in range(inside):
                    parts[part + j] += factor * y[k, u, begin + j]
            if stride == 2:
                for j in range(count):
                    line[2 * j], line[2 * j + 1] = parts[j], parts[count + j]
            else:
                for phase in range(stride):
                    for j in range(count):
                        line[stride * j + phase] = parts[phase * count + j]
            for n in range(count - inside):
                v = np.uintp(n if n < begin else n + inside)
                for t in range(taps):
                    line[np.uintp(col_start[k, v]) + t] += col_weight[k, v, t] * y[k, u, v]
            for i in range(np.uintp(lower), np.uintp(upper)):
                factor = row_weight[k, u, i - np.uintp(top)]
                for j in range(width):
                    out[i, j] += factor * line[j]


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def forward_field(
    x: Array, row_start: Starts, row_weight: Array, col_start: Starts, col_weight: Array, out: Array
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


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def adjoint_field(
    y: Array, row_start: Starts, row_weight: Array, col_start: Starts, col_weight: Array, out: Array
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
