"""Spots that lean: blur along a diagonal of the HR grid, before rows and columns are blurred."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lensshift.core.arrays import Array, Floats
from lensshift.forward.operator import LinearOperator, by_parts

# A covariance that changes no contrast behind a square pixel by more than 0.004.
_LEAST_LEAN_PX2 = 1e-3
# Taps to each side: with 4 the contrast errs by 0.004 to half of the Nyquist frequency of the HR
# grid along both axes, and by 0.014 at it, behind the pixel.
_LEAST_TAPS, _REACH = 4, 3.0  # and standard deviations
_NODES = 64  # variances, linear in between, which keeps the variance
_S = (np.arange(64) + 0.5) / 64 * np.pi  # where taps are fitted, in radian per diagonal step
_PIXEL = np.sinc(0.5 * _S / np.pi) ** 2  # what a pixel of two HR pixels lets through there

Taps = tuple[NDArray[np.int64], Floats]  # HR pixels that an HR pixel is mixed of, and shares


def upright(spot_px2: Floats) -> tuple[Floats, Floats | None]:
    """Return variances [frame row col 2] without the blur along diagonals, and that blur.

    Of variances r, c and covariance v, |v| of each is along the diagonal of the sign of v, and
    (r - |v|, c - |v|) upright: all second moments are kept where |v| is no more than r and c. The
    covariance is the mean of all frames.

    Parameters
    ----------
    spot_px2 : [frame row col 3] variance (row, col) and covariance; with 2 none leans

    Returns
    -------
    upright_px2 : [frame row col 2]
    lean_px2 : [row col], or None where none is worth it
    """
    variance_px2 = spot_px2[..., :2]
    if spot_px2.shape[-1] == 2:
        return variance_px2, None
    most = np.maximum(variance_px2.min(axis=(0, 3)), 0.0)
    lean_px2 = np.clip(spot_px2[..., 2].mean(axis=0), -most, most)
    if np.abs(lean_px2).max() < _LEAST_LEAN_PX2:
        return variance_px2, None
    return variance_px2 - np.abs(lean_px2)[..., None], lean_px2


def lean_taps(lean_px2: Floats, scale: int) -> Taps:
    """Return the HR pixels [HR pixel, tap] along diagonals that each is mixed of, and the shares.

    What lies beyond the border counts as the pixel itself.

    Parameters
    ----------
    lean_px2 : [row col] covariance of the spots of LR pixels; negative: down and to the left
    scale : HR pixels per LR pixel
    """
    hr_px2 = (scale**2 * lean_px2).repeat(scale, axis=0).repeat(scale, axis=1)
    most = float(np.abs(hr_px2).max())
    count = max(_LEAST_TAPS, int(np.ceil(_REACH * most**0.5)))
    at = np.abs(hr_px2).ravel() / most * (_NODES - 1)
    node = np.minimum(at.astype(np.int64), _NODES - 2)
    part = (at - node)[:, None]
    table = np.stack([_one_side(v, count) for v in np.linspace(0.0, most, _NODES)])
    side = (1.0 - part) * table[node] + part * table[node + 1]
    share = np.concatenate([side[:, ::-1], 1.0 - 2.0 * side.sum(axis=1, keepdims=True), side], 1)
    step = np.arange(-count, count + 1)
    height, width = hr_px2.shape
    rows, cols = np.arange(height)[:, None, None], np.arange(width)[:, None]
    to_row, to_col = rows + step, cols + np.where(hr_px2 < 0, -1, 1)[..., None] * step
    inside = (to_row >= 0) & (to_row < height) & (to_col >= 0) & (to_col < width)
    index = np.where(inside, to_row * width + to_col, rows * width + cols)
    return index.reshape(len(share), -1), share


def lean_operator(taps: Taps, hr_shape: tuple[int, int]) -> LinearOperator:
    """Return the blur along diagonals, of HR images [row col]."""
    index, share = taps
    size = len(index)
    starts = np.arange(0, index.size + 1, index.shape[1])
    matrix = csr_array((share.ravel(), index.ravel(), starts), shape=(size, size))

    @lru_cache(maxsize=2)
    def of(kind: np.dtype[Any]) -> tuple[Any, Any]:
        found = matrix.astype(kind, copy=False)
        return found, found.T

    def applied(values: Array, way: int) -> Array:
        return by_parts(lambda part: (of(part.dtype)[way] @ part.ravel()).reshape(hr_shape), values)

    return LinearOperator(hr_shape, hr_shape, lambda x: applied(x, 0), lambda y: applied(y, 1))


def _one_side(variance: float, count: int) -> Floats:
    """Return taps 1 .. count of an even kernel of exactly that variance in steps, nearest to

        1 - 2 sum w_t (1 - cos t s) = exp(-variance s^2 / 2),   0 < s < pi

    by least squares behind a pixel.
    """
    t = np.arange(1, count + 1)
    basis, wanted = 2.0 * (1.0 - np.cos(np.outer(_S, t))), 1.0 - np.exp(-0.5 * variance * _S**2)
    seen = basis * _PIXEL[:, None]
    moment = 2.0 * t[:, None] ** 2.0
    system = np.block([[seen.T @ basis, moment], [moment.T, np.zeros((1, 1))]])
    return np.asarray(np.linalg.solve(system, np.append(seen.T @ wanted, variance))[:-1])
