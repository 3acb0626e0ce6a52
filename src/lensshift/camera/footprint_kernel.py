"""The inner loops of the camera: means over the squares of pixels, from cells."""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array


@njit(cache=True, nogil=True, error_model="numpy")
def _slide(
    cells: Array, i: int, whole: int, part: float, run: Array, out: Array, at: int, step: int
) -> None:
    """Write the sums over `whole` + `part` cells from one node on, or from two, and go on.

    The first node begins with cell i, the second so far within it that cell i + whole is its last.

    Parameters
    ----------
    cells : [cell n], dark beyond
    run : [n] sum over the cells between these two, changed to that of the next i
    out : [node n], of which `step` are written from `at` on
    """
    most = len(cells) - 1
    first, last, following = min(max(i, 0), most), min(max(i + whole, 0), most), min(i + 1, most)
    has_first, has_last = 1.0 * (i == first), 1.0 * (i + whole == last)
    has_following = 1.0 * (i + 1 == max(following, 0))
    for n in range(run.size):
        start, end = has_first * cells[first, n], has_last * cells[last, n]
        out[at, n] = run[n] + start + part * end
        if step > 1:
            out[at + 1, n] = run[n] + part * start + end
        run[n] += end - has_following * cells[following, n]


@njit(cache=True, nogil=True, error_model="numpy")
def squares(cells: Array, side: float, step: int, out: Array) -> None:
    """Write sums over squares that begin at nodes, between which the sum is bilinear.

    Along each axis the nodes are where a square begins or ends with a cell: from 1 + the whole
    cells of a side before the first cell to the end of the last.

    Parameters
    ----------
    cells : [row col channel]
    side : of the squares, in cells
    step : nodes to a cell: 1 if the side is whole, else 2
    out : [row col channel] of the nodes
    """
    rows, cols, channels = cells.shape
    whole = int(side)
    part = side - whole
    flat = cells.reshape(rows, cols * channels)
    run, strip = np.zeros(cols * channels), np.empty((step, cols * channels))
    for i in range(rows + whole + 2):
        _slide(flat, i - whole - 1, whole, part, run, strip, 0, step)
        for k in range(step):
            across, line = np.zeros(channels), strip[k].reshape(cols, channels)
            for j in range(cols + whole + 2):
                _slide(line, j - whole - 1, whole, part, across, out[step * i + k], step * j, step)


@njit(cache=True, nogil=True, error_model="numpy")
def _node(place: float, part: float, step: int) -> tuple[int, float]:
    """Return the node at or before a place in cells from the first, and how far the next is."""
    index = int(place)
    rest = place - index
    if step == 1:
        return index, rest
    if rest < 1.0 - part:
        return 2 * index, rest / (1.0 - part)
    return 2 * index + 1, (rest - (1.0 - part)) / part


@njit(cache=True, nogil=True, error_model="numpy")
def _offset_at(offset: Array, row: float, col: float, axis: int) -> float:
    """Return the offset between pixels [row col 2], beyond the outermost that of these."""
    rows, cols = offset.shape[:2]
    row, col = min(max(row, 0.0), rows - 1.0), min(max(col, 0.0), cols - 1.0)
    i, j = max(min(int(row), rows - 2), 0), max(min(int(col), cols - 2), 0)
    below, right = min(i + 1, rows - 1), min(j + 1, cols - 1)
    down, across = row - i, col - j
    upper = (1.0 - across) * offset[i, j, axis] + across * offset[i, right, axis]
    lower = (1.0 - across) * offset[below, j, axis] + across * offset[below, right, axis]
    return float((1.0 - down) * upper + down * lower)


@njit(cache=True, nogil=True, error_model="numpy")
def lattice_means(
    sums: Array, side: float, step: int, begin: Array, apart: float, offset: Array, first: Array,
    out: Array,
) -> None:  # fmt: skip
    """Write the means over squares around the points of a lattice.

    All places in cells from the first node.

    Parameters
    ----------
    sums, side, step : as of `squares`
    begin : (row, col) of the square of the first pixel, without offset
    apart : from one pixel to the next
    offset : [row col 2] of the pixels, or [1 1 2]
    first : (row, col) of the first point of `out`, in points from the first pixel; `first[1]` is a
        whole number of pixels
    out : [row phase col channel]: of each pixel along a row the points between it and the next
    """
    rows, phases, cols, channels = out.shape
    part, height, width = side - int(side), len(sums) // step - 1, sums.shape[1] // step - 1
    scale, pixel = 1.0 / (side * side), 1.0 / phases
    for i in range(rows):
        at_row = (first[0] + i) * pixel
        for j in range(cols * phases):
            at_col = (first[1] + j) * pixel
            row = begin[0] + apart * at_row - _offset_at(offset, at_row, at_col, 0)
            col = begin[1] + apart * at_col - _offset_at(offset, at_row, at_col, 1)
            if not (0.0 <= row < height and 0.0 <= col < width):
                out[i, j % phases, j // phases] = 0.0
                continue  # all of it beyond the cells
            (r, down), (c, right) = _node(row, part, step), _node(col, part, step)
            for n in range(channels):
                upper = (1.0 - right) * sums[r, c, n] + right * sums[r, c + 1, n]
                lower = (1.0 - right) * sums[r + 1, c, n] + right * sums[r + 1, c + 1, n]
                mean = (1.0 - down) * upper + down * lower
                out[i, j % phases, j // phases, n] = scale * mean


@njit(cache=True, nogil=True, error_model="numpy")
def _near(at: Array, node: int) -> tuple[int, int]:
    """Return from which to before which of rising places in nodes are near a node."""
    first, last = np.searchsorted(at, node - 1.0, side="right"), np.searchsorted(at, node + 1.0)
    return int(first), int(last)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_line(line: Array, light: float, out: Array) -> None:
    """Add the values of a line times its light, on its own, so that all indices are from 0 on."""
    for j in range(line.size):
        out[j] += light * line[j]


@njit(cache=True, nogil=True, error_model="numpy")
def add_images(
    means: Array, first: Array, at_row: Array, at_col: Array, start: Array, place: Array,
    weight: Array, out: Array,
) -> None:  # fmt: skip
    """Add what pixels see through images of points that change between nodes.

    Parameters
    ----------
    means, first : `out` and `first` of `lattice_means`
    at_row, at_col : [row], [col] of the pixels, rising, in nodes
    start : [2 node node] first point of the image at each node, and that behind its last
    place : [point 2] (row, col) points of the lattice from the image
    weight : [point]
    out : [row col channel]
    """
    rows, phases, cols, channels = means.shape
    lines = means.reshape(rows, phases, cols * channels)
    down, across = -place[:, 0] - first[0], -place[:, 1] - first[1]
    phase, ahead = across % phases, across // phases
    seen = np.empty(len(at_col) * channels)
    for row_node in range(start.shape[1]):
        top, bottom = _near(at_row, row_node)
        for col_node in range(start.shape[2]):
            left, right = _near(at_col, col_node)
            points = start[0, row_node, col_node], start[1, row_node, col_node]
            for i in range(top, bottom):
                seen[left * channels : right * channels] = 0.0
                for k in range(points[0], points[1]):
                    row = i * phases + down[k]
                    if 0 <= row < rows:
                        begin, end = max(left, -ahead[k]), min(right, cols - ahead[k])
                        if begin < end:
                            skip = ahead[k] * channels
                            _add_line(
                                lines[
                                    row, phase[k], begin * channels + skip : end * channels + skip
                                ],
                                weight[k],
                                seen[begin * channels : end * channels],
                            )
                share = 1.0 - abs(at_row[i] - row_node)
                for j in range(left, right):
                    part = share * (1.0 - abs(at_col[j] - col_node))
                    for n in range(channels):
                        out[i, j, n] += part * seen[j * channels + n]
