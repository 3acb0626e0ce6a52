"""Compiled kernels for fields that vary slowly: neighbouring pixels see neighbouring HR pixels.

The sums are those of `forward_field`. Where the first taps of the pixels of a row are as far apart
as the pixels, but for a tap or two, all pixels of the row take one tap after the other, from HR
pixels that lie beside each other in memory; the few at the border are done as in any field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from lensshift.core.arrays import Array
from lensshift.forward.blur import Starts

_FAST = {"contract"}
_MOST_SPARE = 3  # taps that a pixel may lack at either side of a row: more cost more than they save


@dataclass(frozen=True, slots=True, eq=False)
class SmoothField:
    """The taps of a field, tap by tap."""

    # [frame row 4] HR row of the first tap, HR column less the stride times the column, and how
    # many taps there are along row and col
    first: Starts
    run: Starts  # [frame row 2] columns from and to which the row is regular
    # [frame row tap col]
    row_weight: Array
    col_weight: Array


def smooth_field(
    row_start: Starts, row_weight: Array, col_start: Starts, col_weight: Array, stride: int
) -> SmoothField | None:
    """Return the taps [frame row col, T] of a field tap by tap, or None if it is not smooth."""
    cols = col_start.shape[2]
    along = col_start - stride * np.arange(cols)
    middle = slice(cols // 4, cols - cols // 4)
    left, right = along[..., middle].min(axis=-1), along[..., middle].max(axis=-1)
    regular = (along >= left[..., None]) & (along <= right[..., None])
    half = cols // 2
    behind = np.cumprod(regular[..., half:], axis=-1).sum(axis=-1)
    before = np.cumprod(regular[..., half - 1 :: -1], axis=-1).sum(axis=-1) if half else 0 * behind
    run = np.stack([half - before, half + behind], axis=-1).astype(np.int64)
    inside = (np.arange(cols) >= run[..., :1]) & (np.arange(cols) < run[..., 1:])
    top = np.where(inside, row_start, np.iinfo(np.int64).max).min(axis=-1)
    down = np.where(inside, row_start - top[..., None], 0)
    beside = np.where(inside, along - left[..., None], 0)
    if not inside.any(axis=-1).all() or max(down.max(), beside.max()) > _MOST_SPARE:
        return None
    by_tap = _by_tap(row_weight, down), _by_tap(col_weight, beside)
    used = (((weight != 0) & inside[:, :, None]).any(axis=-1) for weight in by_tap)
    counts = (one.shape[2] - np.argmax(one[..., ::-1], axis=-1) for one in used)
    return SmoothField(np.stack([top, left, *counts], axis=-1), run, *by_tap)


def _by_tap(weight: Array, later: Starts) -> Array:
    """Return weights [frame row tap col] of [frame row col T] that begin some taps later."""
    taps = weight.shape[-1] + int(later.max())
    found = np.zeros((*weight.shape[:2], taps, weight.shape[2]))
    for step in range(int(later.max()) + 1):
        here = np.where((later == step)[..., None], weight, 0.0)
        found[:, :, step : step + weight.shape[-1]] += np.moveaxis(here, -1, -2)
    return found


@njit(cache=True, nogil=True, fastmath=_FAST)
def _take_line(planes: Array, row: int, at: int, weight: Array, begin: int, out: Array) -> None:
    """Write sum_t weight[t] x[at + t], x one row of the image; two taps at once halve the loads."""
    stride, count, taps = planes.shape[0], out.size, weight.shape[0]
    one = planes[at % stride, row, at // stride + _MOST_SPARE :]
    w_one = weight[0, begin:]
    for v in range(count):
        out[v] = w_one[v] * one[v]
    for t in range(1, taps - 1, 2):
        one = planes[(at + t) % stride, row, (at + t) // stride + _MOST_SPARE :]
        two = planes[(at + t + 1) % stride, row, (at + t + 1) // stride + _MOST_SPARE :]
        w_one, w_two = weight[t, begin:], weight[t + 1, begin:]
        for v in range(count):
            out[v] += w_one[v] * one[v] + w_two[v] * two[v]
    if taps % 2 == 0:
        t = taps - 1
        one = planes[(at + t) % stride, row, (at + t) // stride + _MOST_SPARE :]
        w_one = weight[t, begin:]
        for v in range(count):
            out[v] += w_one[v] * one[v]


@njit(cache=True, nogil=True, fastmath=_FAST)
def forward_smooth(
    x: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    first: Starts,
    run: Starts,
    rows_by_tap: Array,
    cols_by_tap: Array,
    out: Array,
) -> None:
    """Sample the HR image; `forward_field`, of which the first arguments are.

    Parameters
    ----------
    first, run, rows_by_tap, cols_by_tap : as in `SmoothField`
    """
    stride = x.shape[1] // out.shape[2]
    planes = _planes_of(x, stride, _length(x.shape[1], cols_by_tap, stride))
    frames, rows, cols = out.shape
    line = np.empty(cols, x.dtype)
    for k in range(frames):
        for u in range(rows):
            begin, end = run[k, u, 0], run[k, u, 1]
            top, left, row_taps, col_taps = first[k, u]
            target, part = out[k, u, begin:end], line[begin:end]
            for v in range(cols):
                out[k, u, v] = 0
            for s in range(row_taps):
                _take_line(
                    planes,
                    top + s,
                    left + stride * begin,
                    cols_by_tap[k, u, :col_taps],
                    begin,
                    part,
                )
                factor = rows_by_tap[k, u, s, begin:end]
                for v in range(part.size):
                    target[v] += factor[v] * part[v]
            for lower, upper in ((0, begin), (end, cols)):
                for v in range(lower, upper):
                    for s in range(row_weight.shape[3]):
                        for t in range(col_weight.shape[3]):
                            out[k, u, v] += (
                                row_weight[k, u, v, s]
                                * col_weight[k, u, v, t]
                                * x[row_start[k, u, v] + s, col_start[k, u, v] + t]
                            )


@njit(cache=True, nogil=True, fastmath=_FAST)
def adjoint_smooth(
    y: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    first: Starts,
    run: Starts,
    rows_by_tap: Array,
    cols_by_tap: Array,
    out: Array,
) -> None:
    """Spread LR pixels over the HR image; the exact adjoint of `forward_smooth`."""
    height, width = out.shape
    stride = width // y.shape[2]
    planes = np.zeros((stride, height, _length(width, cols_by_tap, stride)), y.dtype)
    frames, rows, cols = y.shape
    line = np.empty(cols, y.dtype)
    out[:] = 0
    for k in range(frames):
        for u in range(rows):
            begin, end = run[k, u, 0], run[k, u, 1]
            top, left, row_taps, col_taps = first[k, u]
            source, part = y[k, u, begin:end], line[begin:end]
            for s in range(row_taps):
                factor = rows_by_tap[k, u, s, begin:end]
                for v in range(part.size):
                    part[v] = factor[v] * source[v]
                for t in range(col_taps):
                    at = left + t + stride * begin
                    target = planes[at % stride, top + s, at // stride + _MOST_SPARE :]
                    weight = cols_by_tap[k, u, t, begin:end]
                    for v in range(part.size):
                        target[v] += weight[v] * part[v]
            for lower, upper in ((0, begin), (end, cols)):
                for v in range(lower, upper):
                    for s in range(row_weight.shape[3]):
                        share = row_weight[k, u, v, s] * y[k, u, v]
                        for t in range(col_weight.shape[3]):
                            out[row_start[k, u, v] + s, col_start[k, u, v] + t] += (
                                col_weight[k, u, v, t] * share
                            )
    for i in range(np.uintp(height)):
        for phase in range(np.uintp(stride)):
            for j in range(np.uintp(cols)):
                out[i, np.uintp(stride) * j + phase] += planes[phase, i, np.uintp(_MOST_SPARE) + j]


@njit(cache=True, nogil=True)
def _length(width: int, cols_by_tap: Array, stride: int) -> int:
    """Return how long a plane is, with room for taps without weight beyond the image."""
    return int(_MOST_SPARE + (width + cols_by_tap.shape[2]) // stride + 2)


@njit(cache=True, nogil=True, fastmath=_FAST)
def _planes_of(x: Array, stride: int, length: int) -> Array:
    """Return [stride row sample], every stride-th column of the image in a plane of its own."""
    planes = np.zeros((stride, x.shape[0], length), x.dtype)
    for i in range(np.uintp(x.shape[0])):
        for phase in range(np.uintp(stride)):
            for j in range(np.uintp(x.shape[1] // stride)):
                planes[phase, i, np.uintp(_MOST_SPARE) + j] = x[i, np.uintp(stride) * j + phase]
    return planes
