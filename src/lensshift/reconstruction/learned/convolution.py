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
    rows, tiles = (len(x) - 2) // TILE, x.shape[2] - 1
    step = min(rows, max(1, STRIP // tiles))
    margin = 0 if last else 1
    out = np.empty((rows * TILE + 2 * margin, TILE, tiles + margin, outputs), np.float32)
    flat, lines_of_x = out.reshape(len(out), -1), x.reshape(len(x), -1)
    least: Any = np.float32(-np.inf if last else 0.0)

    def convolve(first: int, end: int) -> None:
        strip = np.empty((POINTS**2, step * tiles, channels), np.float32)
        product = np.empty((POINTS**2, step * tiles, outputs), np.float32)
        lines = np.empty((POINTS**2, tiles * max(channels, outputs)), np.float32)
        for top in range(first * step, min(end * step, rows), step):
            count = min(step, rows - top)
            _take(lines_of_x, channels, top, count, lines, strip.reshape(POINTS**2, -1))
            part = slice(None), slice(count * tiles)
            np.matmul(strip[part], weight, out=product[part])
            _put(product.reshape(POINTS**2, -1), outputs, top, count, margin, least, lines, flat)

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


@njit(cache=True, nogil=True, fastmath={"contract"})
def _points(a: Single, b: Single, c: Single, d: Single, e: Single, f: Single,
            p: Single, q: Single, r: Single, u: Single, v: Single, w: Single) -> None:  # fmt: skip
    """Write the six combinations p .. w of six neighbours a .. f."""
    four, two = np.float32(4), np.float32(2)  # with other numbers it would be double precision
    for n in range(len(p)):
        even, odd = e[n] - four * c[n], d[n] - four * b[n]
        near, far = e[n] - c[n], two * (d[n] - b[n])
        p[n] = four * (a[n] - c[n]) + near
        q[n] = even + odd
        r[n] = even - odd
        u[n] = near + far
        v[n] = near - far
        w[n] = four * (b[n] - d[n]) + (f[n] - d[n])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _outputs(p: Single, q: Single, r: Single, u: Single, v: Single, w: Single, least: np.float32,
             a: Single, b: Single, c: Single, d: Single) -> None:  # fmt: skip
    """Write the four outputs a .. d of six products p .. w, none below `least`."""
    four, two = np.float32(4), np.float32(2)
    for n in range(len(p)):
        near, odd = q[n] + r[n], q[n] - r[n]
        far, double = u[n] + v[n], two * (u[n] - v[n])
        a[n] = max(p[n] + near + far, least)
        b[n] = max(odd + double, least)
        c[n] = max(near + four * far, least)
        d[n] = max(odd + four * double + w[n], least)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _take(x: Single, channels: int, top: int, count: int, lines: Single, strip: Single) -> None:
    """Write the combinations of tiles: along the columns into six lines a row, then along rows."""
    plane = x.shape[1] // 4
    width = plane - channels
    for row in range(4 * count + 2):
        y, line = x[4 * top + row], row % 6 * 6  # a tile shares two rows with the one before
        right, last = channels, plane + channels
        _points(
            y[:width], y[plane : plane + width], y[2 * plane : 2 * plane + width],
            y[3 * plane : 3 * plane + width], y[right : right + width], y[last : last + width],
            lines[line, :width], lines[line + 1, :width], lines[line + 2, :width],
            lines[line + 3, :width], lines[line + 4, :width], lines[line + 5, :width],
        )  # fmt: skip
        first = row - 5
        if first % 4 != 0 or first < 0:
            continue
        s, e = first // 4 * width, (first // 4 + 1) * width
        one, two, three = first % 6 * 6, (first + 1) % 6 * 6, (first + 2) % 6 * 6
        four, five, six = (first + 3) % 6 * 6, (first + 4) % 6 * 6, (first + 5) % 6 * 6
        for k in range(6):
            _points(
                lines[one + k, :width], lines[two + k, :width], lines[three + k, :width],
                lines[four + k, :width], lines[five + k, :width], lines[six + k, :width],
                strip[k, s:e], strip[6 + k, s:e], strip[12 + k, s:e],
                strip[18 + k, s:e], strip[24 + k, s:e], strip[30 + k, s:e],
            )  # fmt: skip


@njit(cache=True, nogil=True, fastmath={"contract"})
def _put(product: Single, outputs: int, top: int, count: int, margin: int, least: np.float32,
         lines: Single, out: Single) -> None:  # fmt: skip
    """Write the outputs of tiles: along the rows into four lines a column, then along columns."""
    plane = out.shape[1] // 4
    width, low = plane - margin * outputs, np.float32(-np.inf)
    # A margin of one moves every column on by a phase, the fourth into the next tile.
    one, two, three = margin * plane, (1 + margin) * plane, (2 + margin) * plane
    four = outputs if margin == 1 else 3 * plane
    for tile in range(count):
        s, e = tile * width, (tile + 1) * width
        for k in range(6):
            _outputs(
                product[k, s:e], product[6 + k, s:e], product[12 + k, s:e],
                product[18 + k, s:e], product[24 + k, s:e], product[30 + k, s:e], low,
                lines[k, :width], lines[6 + k, :width], lines[12 + k, :width],
                lines[18 + k, :width],
            )  # fmt: skip
        for row in range(4):
            to, k = out[margin + 4 * (top + tile) + row], 6 * row
            _outputs(
                lines[k, :width], lines[k + 1, :width], lines[k + 2, :width],
                lines[k + 3, :width], lines[k + 4, :width], lines[k + 5, :width], least,
                to[one : one + width], to[two : two + width], to[three : three + width],
                to[four : four + width],
            )  # fmt: skip
