"""Convolutions of 3 x 3 on many channels: four by four pixels at a time, a quarter of the products.

    y = B (G w G^T . D x D^T) B^T,   36 products for 16 outputs in place of 144

D takes six neighbours to six combinations, B six products to four outputs, along columns and rows;
all channels are summed by the matrix product itself. Source: Lavin and Gray, Fast algorithms for
convolutional neural networks, 2016, F(4 x 4, 3 x 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.threads import bands, core_count, on_threads

Single = NDArray[np.floating[Any]]  # float32, which NumPy's types lose on the way

TILE, POINTS = 4, 6
# Tiles that one matrix product takes: what goes in and out stays in the second-level cache.
STRIP = 128
WORTH_THREADS = 8  # strips: below, waking a thread takes as long as the work
_KERNEL = np.array(
    [[1 / 4, 0, 0], [-1 / 6, -1 / 6, -1 / 6], [-1 / 6, 1 / 6, -1 / 6],
     [1 / 24, 1 / 12, 1 / 6], [1 / 24, -1 / 12, 1 / 6], [0, 0, 1]]
)  # fmt: skip


def transformed(weight: Single) -> Single:
    """Return the weights [36, in, out] of a convolution [9 in, out], taps in row order."""
    taps = weight.reshape(3, 3, len(weight) // 9, -1).astype(np.float64)
    points = np.einsum("pi,qj,ijco->pqco", _KERNEL, _KERNEL, taps)
    return np.ascontiguousarray(points.reshape(POINTS**2, *taps.shape[2:]), np.float32)


def with_margin(parts: Sequence[Single]) -> Single:
    """Return the channels of all parts with their border repeated, laid out for `convolved`.

    Parameters
    ----------
    parts : [row col channel], or any number of axes that stand for the channel
    """
    rows, cols = parts[0].shape[:2]
    sizes = [math.prod(part.shape[2:]) for part in parts]
    out = np.zeros((_tiles(rows) * TILE + 2, TILE, _tiles(cols) + 1, sum(sizes)), np.float32)
    for first, size, part in zip(np.cumsum([0, *sizes]), sizes, parts, strict=False):
        for phase in range(TILE):
            of_phase = part[:, (phase - 1) % TILE :: TILE]
            tile = 1 if phase == 0 else 0
            to = out[1 : rows + 1, phase, tile : tile + of_phase.shape[1], first : first + size]
            to.reshape(of_phase.shape)[...] = of_phase
    out[:, 0, 0] = out[:, 1, 0]
    out[:, (cols + 1) % TILE, (cols + 1) // TILE] = out[:, cols % TILE, cols // TILE]
    out[0], out[rows + 1] = out[1], out[rows]
    return out


def _tiles(size: int) -> int:
    return -(-size // TILE)


def convolved(x: Single, weight: Single, shape: tuple[int, int], *, last: bool) -> Single:
    """Return the convolution of x.

    Inner layers are cut at 0 and laid out for the next one, with a margin of zeros.

    Parameters
    ----------
    x : [row phase tile channel] with a margin of one pixel, `shape` inside and anything up to a
        multiple of four; column c is at phase c % 4 of tile c // 4, so that what is computed from
        neighbours is computed from long lines
    weight : as from `transformed`

    Returns
    -------
    as x, but [row col channel] without margin if it is the last layer
    """
    channels, outputs = weight.shape[1:]
    if x.shape[3] != channels:  # what is compiled would write beyond the ends of arrays
        raise ValueError(f"expected {channels} channels, got {x.shape[3]}")
    rows, tiles = (len(x) - 2) // TILE, x.shape[2] - 1
    step = min(rows, max(1, STRIP // tiles))
    margin = 0 if last else 1
    out = np.empty((rows * TILE + 2 * margin, TILE, tiles + margin, outputs), np.float32)
    flat, whole = out.reshape(-1), x.reshape(-1)
    least: Any = np.float32(-np.inf if last else 0.0)

    def convolve(first: int, end: int) -> None:
        strip = np.empty((POINTS**2, step * tiles, channels), np.float32)
        product = np.empty((POINTS**2, step * tiles, outputs), np.float32)
        line = tiles * max(channels, outputs)
        lines = np.empty(POINTS**2 * line, np.float32)
        for top in range(first * step, min(end * step, rows), step):
            count = min(step, rows - top)
            _take(
                whole, x[0].size, channels, top, count, lines, line,
                strip.reshape(-1), strip[0].size,
            )  # fmt: skip
            part = slice(None), slice(count * tiles)
            np.matmul(strip[part], weight, out=product[part])
            _put(
                product.reshape(-1), product[0].size, outputs, top, count, margin, least, lines,
                line, flat, out[0].size,
            )  # fmt: skip

    strips = -(-rows // step)
    cores = core_count() if strips >= WORTH_THREADS else 1
    on_threads([partial(convolve, *band) for band in bands(strips, cores)])
    if last:
        pixels = out.transpose(0, 2, 1, 3).reshape(rows * TILE, tiles * TILE, outputs)
        return pixels[: shape[0], : shape[1]]
    out[0] = out[shape[0] + 1 :] = 0
    for col in (0, *range(shape[1] + 1, TILE * (tiles + 1))):
        out[:, col % TILE, col // TILE] = 0
    return out


# The kernels take flat arrays and places in them: arrays cut from arrays compile for twice as long.
# Places are unsigned where they are used, else each is tested for counting from the end.


@njit(cache=True, nogil=True, fastmath={"contract"})
def _points(x: Single, at: tuple[int, ...], y: Single, first: int, apart: int, count: int) -> None:
    """Write the six combinations of six neighbours, `count` of each, to places so far apart."""
    four, two = np.float32(4), np.float32(2)  # with other numbers it would be double precision
    a, b, c = np.uintp(at[0]), np.uintp(at[1]), np.uintp(at[2])
    d, e, f = np.uintp(at[3]), np.uintp(at[4]), np.uintp(at[5])
    p, q, r = np.uintp(first), np.uintp(first + apart), np.uintp(first + 2 * apart)
    u, v = np.uintp(first + 3 * apart), np.uintp(first + 4 * apart)
    w = np.uintp(first + 5 * apart)
    for n in range(np.uintp(count)):
        even, odd = x[e + n] - four * x[c + n], x[d + n] - four * x[b + n]
        near, far = x[e + n] - x[c + n], two * (x[d + n] - x[b + n])
        y[p + n] = four * (x[a + n] - x[c + n]) + near
        y[q + n] = even + odd
        y[r + n] = even - odd
        y[u + n] = near + far
        y[v + n] = near - far
        y[w + n] = four * (x[b + n] - x[d + n]) + (x[f + n] - x[d + n])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _outputs(x: Single, first: int, apart: int, least: np.float32,
             y: Single, to: tuple[int, ...], count: int) -> None:  # fmt: skip
    """Write the four outputs of six products so far apart, none below `least`."""
    four, two = np.float32(4), np.float32(2)
    p, q, r = np.uintp(first), np.uintp(first + apart), np.uintp(first + 2 * apart)
    u, v = np.uintp(first + 3 * apart), np.uintp(first + 4 * apart)
    w = np.uintp(first + 5 * apart)
    a, b, c, d = np.uintp(to[0]), np.uintp(to[1]), np.uintp(to[2]), np.uintp(to[3])
    for n in range(np.uintp(count)):
        near, odd = x[q + n] + x[r + n], x[q + n] - x[r + n]
        far, double = x[u + n] + x[v + n], two * (x[u + n] - x[v + n])
        y[a + n] = max(x[p + n] + near + far, least)
        y[b + n] = max(odd + double, least)
        y[c + n] = max(near + four * far, least)
        y[d + n] = max(odd + four * double + x[w + n], least)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _take(x: Single, row_size: int, channels: int, top: int, count: int, lines: Single,
          line: int, strip: Single, point: int) -> None:  # fmt: skip
    """Write the combinations of tiles: along the columns into six lines a row, then along rows."""
    plane = row_size // 4
    width = plane - channels
    for row in range(4 * count + 2):
        y = row_size * (4 * top + row)
        neighbours = (
            y, y + plane, y + 2 * plane, y + 3 * plane, y + channels, y + plane + channels
        )  # fmt: skip
        # A tile shares two rows with the one before.
        _points(x, neighbours, lines, row % 6 * 6 * line, line, width)
        first = row - 5
        if first % 4 != 0 or first < 0:
            continue
        to = first // 4 * width
        one, two, three = first % 6 * 6, (first + 1) % 6 * 6, (first + 2) % 6 * 6
        four, five, six = (first + 3) % 6 * 6, (first + 4) % 6 * 6, (first + 5) % 6 * 6
        for k in range(6):
            neighbours = (
                (one + k) * line, (two + k) * line, (three + k) * line,
                (four + k) * line, (five + k) * line, (six + k) * line,
            )  # fmt: skip
            _points(lines, neighbours, strip, k * point + to, 6 * point, width)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _put(product: Single, point: int, outputs: int, top: int, count: int, margin: int,
         least: np.float32, lines: Single, line: int, out: Single,
         row_size: int) -> None:  # fmt: skip
    """Write the outputs of tiles: along the rows into four lines a column, then along columns."""
    plane, low = row_size // 4, np.float32(-np.inf)
    width = plane - margin * outputs
    for tile in range(count):
        for k in range(6):
            to = k * line, (6 + k) * line, (12 + k) * line, (18 + k) * line
            _outputs(product, k * point + tile * width, 6 * point, low, lines, to, width)
        for row in range(4):
            at = row_size * (margin + 4 * (top + tile) + row)
            # A margin of one moves every column on by a phase, the fourth into the next tile.
            one = at + margin * plane
            to = one, one + plane, one + 2 * plane, at + (outputs if margin == 1 else 3 * plane)
            _outputs(lines, 6 * row * line, line, least, out, to, width)
