"""The inner loop of the camera: means over the footprints of pixels, from sums over cells."""

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
def footprint_means(
    sums: Array, centre: Array, half: float, landing: Array, weight: Array, out: Array
) -> None:
    """Write the mean over the footprint of each pixel: a square that light from around reaches.

    All places in cells from the corner of the first cell.

    Parameters
    ----------
    sums : [cell row + 1, cell col + 1, channel] over all cells above and left
    centre : [row col 2] of the squares
    half : half of their side
    landing, weight : [row col ray 2], [row col ray] of light that belongs elsewhere
    out : [row col channel]
    """
    for i, j in np.ndindex(out.shape[:2]):
        out[i, j, :] = 0.0
        for k in range(landing.shape[2]):
            share = weight[i, j, k] / (4.0 * half * half)
            row = centre[i, j, 0] - landing[i, j, k, 0]
            col = centre[i, j, 1] - landing[i, j, k, 1]
            _add_corner(sums, row + half, col + half, share, out[i, j])
            _add_corner(sums, row - half, col + half, -share, out[i, j])
            _add_corner(sums, row + half, col - half, -share, out[i, j])
            _add_corner(sums, row - half, col - half, share, out[i, j])
