"""Convolutions of 3 x 3 on many channels: four columns at a time, half the products.

    y = B (G w . D x),   six products for four outputs in place of twelve

along the columns; the three rows and all channels are summed by the matrix product itself. Source:
Lavin and Gray, Fast algorithms for convolutional neural networks, 2016, F(4, 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Single = NDArray[np.floating[Any]]  # float32, which NumPy's types lose on the way

COLUMNS, POINTS = 4, 6
# Numbers in the strip that one matrix product takes: fits the second-level cache of a core.
STRIP = 1 << 17
_KERNEL = np.array(
    [[1 / 4, 0, 0], [-1 / 6, -1 / 6, -1 / 6], [-1 / 6, 1 / 6, -1 / 6],
     [1 / 24, 1 / 12, 1 / 6], [1 / 24, -1 / 12, 1 / 6], [0, 0, 1]]
)  # fmt: skip


def transformed(weight: Single) -> Single:
    """Return the weights [6, 3 in, out] of a convolution [9 in, out], taps in row order."""
    taps = weight.reshape(3, 3, len(weight) // 9, -1).astype(np.float64)
    points = np.einsum("pj,ijco->pico", _KERNEL, taps)
    return np.ascontiguousarray(points.reshape(POINTS, len(weight) // 3, -1), np.float32)


def with_margin(x: Single) -> Single:
    """Return x [row col channel] with its border repeated, as wide as `convolved` wants it."""
    rows, cols, channels = x.shape
    wide = np.zeros((rows + 2, -(-cols // COLUMNS) * COLUMNS + 2, channels), np.float32)
    wide[1:-1, 1 : cols + 1] = x
    wide[1:-1, 0], wide[1:-1, cols + 1] = x[:, 0], x[:, -1]
    wide[0], wide[-1] = wide[1], wide[-2]
    return wide


def convolved(x: Single, weight: Single, cols: int, *, last: bool) -> Single:
    """Return the convolution of x, which has a margin of one pixel.

    Inner layers are cut at 0 and come with the margin (of zeros) that the next one needs.

    Parameters
    ----------
    x : [row col channel] with margin, `cols` columns inside and zeros up to a multiple of four
    weight : as from `transformed`
    """
    rows, tiles, channels = x.shape[0] - 2, (x.shape[1] - 2) // COLUMNS, x.shape[2]
    outputs, margin = weight.shape[2], 0 if last else 1
    out = np.zeros((rows + 2 * margin, tiles * COLUMNS + 2 * margin, outputs), np.float32)
    step = min(rows, max(1, STRIP // (tiles * 3 * POINTS * channels)))
    strip = np.empty((POINTS, step * tiles, 3 * channels), np.float32)
    product = np.empty((POINTS, step * tiles, outputs), np.float32)
    least: Any = np.float32(-np.inf if last else 0.0)
    for top in range(0, rows, step):
        count = min(step, rows - top)
        _take(x, top, count, strip)
        part = slice(None), slice(count * tiles)
        np.matmul(strip[part], weight, out=product[part])
        _put(product, top + margin, count, margin, least, out)
    if last:
        return out[:, :cols]
    out[:, cols + 1 :] = 0
    return out


@njit(cache=True, nogil=True, fastmath={"contract"})
def _take(x: Single, top: int, count: int, strip: Single) -> None:
    """Write the six combinations of six neighbours along a row, for the three rows of each tap."""
    channels = x.shape[2]
    tiles = (x.shape[1] - 2) // 4
    for row in range(count + 2):
        for t in range(tiles):
            a, b, c = x[top + row, 4 * t], x[top + row, 4 * t + 1], x[top + row, 4 * t + 2]
            d, e, f = x[top + row, 4 * t + 3], x[top + row, 4 * t + 4], x[top + row, 4 * t + 5]
            for tap in range(max(0, row + 1 - count), min(3, row + 1)):
                at, first, last = (row - tap) * tiles + t, tap * channels, (tap + 1) * channels
                # Lines of their own: a loop that writes to six rows of one array is not vectorised.
                p, q, r = (strip[0, at, first:last], strip[1, at, first:last],
                           strip[2, at, first:last])  # fmt: skip
                u, v, w = (strip[3, at, first:last], strip[4, at, first:last],
                           strip[5, at, first:last])  # fmt: skip
                for n in range(channels):
                    even, odd = e[n] - 4 * c[n], d[n] - 4 * b[n]
                    near, far = e[n] - c[n], 2 * (d[n] - b[n])
                    p[n] = 4 * (a[n] - c[n]) + near
                    q[n] = even + odd
                    r[n] = even - odd
                    u[n] = near + far
                    v[n] = near - far
                    w[n] = 4 * (b[n] - d[n]) + (f[n] - d[n])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _put(product: Single, top: int, count: int, left: int, least: np.float32, out: Single) -> None:
    """Write the four outputs of each six products, none below `least`."""
    outputs = out.shape[2]
    tiles = (out.shape[1] - 2 * left) // 4
    for row in range(count):
        for t in range(tiles):
            p = product[:, row * tiles + t]
            to = out[top + row, left + 4 * t : left + 4 * t + 4]
            for n in range(outputs):
                near, odd = p[1, n] + p[2, n], p[1, n] - p[2, n]
                far, double = p[3, n] + p[4, n], 2 * (p[3, n] - p[4, n])
                to[0, n] = max(p[0, n] + near + far, least)
                to[1, n] = max(odd + double, least)
                to[2, n] = max(near + 4 * far, least)
                to[3, n] = max(odd + 4 * double + p[5, n], least)
