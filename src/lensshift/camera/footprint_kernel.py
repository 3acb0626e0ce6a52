"""The inner loops of the camera: means over the squares of pixels, from cells."""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array


@njit(cache=True, nogil=True, error_model="numpy")
def _add_corner(sums: Array, row: float, col: float, share: float, out: Array) -> None:
    """Add `share` times the sum over everything above and left of a place.

    Between the corners of cells the sum is bilinear: cells are even.
    """
    i, j = int(row), int(col)
    down, right = row - i, col - j
    for n in range(out.size):
        out[n] += share * (
            (1.0 - down) * ((1.0 - right) * sums[i, j, n] + right * sums[i, j + 1, n])
            + down * ((1.0 - right) * sums[i + 1, j, n] + right * sums[i + 1, j + 1, n])
        )


@njit(cache=True, nogil=True, error_model="numpy")
def square_means(sums: Array, centre: Array, half: float, out: Array) -> None:
    """Write the mean over the square of each pixel.

    All places in cells from the corner of the first cell.

    Parameters
    ----------
    sums : [cell row + 1, cell col + 1, channel] over all cells above and left
    centre : [row col 2] of the squares
    half : half of their side
    out : [row col channel]
    """
    share = 0.25 / (half * half)
    for i, j in np.ndindex(out.shape[:2]):
        out[i, j, :] = 0.0
        row, col = centre[i, j]
        _add_corner(sums, row + half, col + half, share, out[i, j])
        _add_corner(sums, row - half, col + half, -share, out[i, j])
        _add_corner(sums, row + half, col - half, -share, out[i, j])
        _add_corner(sums, row - half, col - half, share, out[i, j])


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
def _spots_along(at: float, landing: Array, weight: Array, near: Array, light: Array) -> None:
    """Write landing points [node ray 2] and weights [node ray] along a row between nodes."""
    before = min(int(at), len(weight) - 2)
    share = at - before
    for node, ray in np.ndindex(light.shape):
        first, last = weight[before, node, ray], weight[before + 1, node, ray]
        light[node, ray] = (1.0 - share) * first + share * last
        for axis in range(2):
            first, last = landing[before, node, ray, axis], landing[before + 1, node, ray, axis]
            near[node, ray, axis] = (1.0 - share) * first + share * last


@njit(cache=True, nogil=True, error_model="numpy")
def add_spots(
    sums: Array, side: float, step: int, begin: Array, offset: Array,
    at_row: Array, at_col: Array, landing: Array, weight: Array, out: Array,
) -> None:  # fmt: skip
    """Add the means over the footprints of pixels: squares that light from around reaches.

    All places in cells from the first node.

    Parameters
    ----------
    sums, side, step : as of `squares`
    begin : [row + col] of the squares along each axis, without offset
    offset : [row col 2], or [1 1 2]
    at_row, at_col : [row], [col] of the pixels, in nodes of the spots
    landing, weight : [node node ray 2], [node node ray] of light that belongs elsewhere
    out : [row col channel]
    """
    rows, cols, channels = out.shape
    rays, wide = weight.shape[2], weight.shape[1]
    part, height, width = side - int(side), len(sums) // step - 1, sums.shape[1] // step - 1
    near, light = np.empty((wide, rays, 2)), np.empty((wide, rays))
    mean = np.empty(channels)
    for i in range(rows):
        _spots_along(at_row[i], landing, weight, near, light)
        for j in range(cols):
            node = min(int(at_col[j]), wide - 2)
            share = at_col[j] - node
            moved = offset[min(i, len(offset) - 1), min(j, offset.shape[1] - 1)]
            top, left = begin[i] - moved[0], begin[rows + j] - moved[1]
            mean[:] = 0.0
            for k in range(rays):
                row = top - ((1.0 - share) * near[node, k, 0] + share * near[node + 1, k, 0])
                col = left - ((1.0 - share) * near[node, k, 1] + share * near[node + 1, k, 1])
                if not (0.0 <= row < height and 0.0 <= col < width):
                    continue  # all of it beyond the cells
                (r, down), (c, right) = _node(row, part, step), _node(col, part, step)
                all_of = (1.0 - share) * light[node, k] + share * light[node + 1, k]
                below, above = all_of * down, all_of * (1.0 - down)
                for n in range(channels):
                    upper = (1.0 - right) * sums[r, c, n] + right * sums[r, c + 1, n]
                    lower = (1.0 - right) * sums[r + 1, c, n] + right * sums[r + 1, c + 1, n]
                    mean[n] += above * upper + below * lower
            for n in range(channels):
                out[i, j, n] += mean[n] / (side * side)
