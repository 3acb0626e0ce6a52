"""The toolbox's image formation: warp, blur and decimation in one sparse matrix."""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse

from lensshift.core.arrays import Floats


def system_matrix(
    shape: tuple[int, ...], scale: int, offset_px: Floats, psf_sigma_px: float
) -> sparse.csr_array:
    """Return W [LR pixel, HR pixel] of one frame, y = W x.

        W[u, n] = exp(-|v - n|^2 / (2 s^2 sigma^2)) / row sum,   v = s (u - offset) + (s - 1) / 2

    for the HR pixels n that `axis_taps` finds on each axis. A row whose taps all lie outside the
    image stays zero.

    Parameters
    ----------
    shape : (rows, cols) of the LR frame
    offset_px : (row, col) of this frame
    psf_sigma_px : standard deviation of the Gaussian PSF

    Source: composeSystemMatrix of the toolbox.
    """
    row, col = (
        axis_taps(size, scale, offset, psf_sigma_px)
        for size, offset in zip(shape, offset_px, strict=True)
    )
    # A pure translation separates: exp(-dy^2 - dx^2) is a product, and so are its row sums.
    total = np.outer(row.sum(axis=1), col.sum(axis=1)).ravel()
    weights = sparse.kron(row, col, format="csr")
    return sparse.csr_array(sparse.diags_array(1.0 / (total + np.finfo(np.float64).eps)) @ weights)


def axis_taps(size: int, scale: int, offset_px: float, psf_sigma_px: float) -> sparse.csr_array:
    """Return the unnormalised Gaussian taps [LR index, HR index] along one axis.

    The window is the integers -R .. R added to v and only then rounded, half away from zero,
    with R = floor(3 s sigma). At a half-integer v the window therefore leans to one side, and at
    v = -1/2 it skips HR pixel 0. Taps outside the image are dropped.
    """
    position_hr_px = (np.arange(size) - offset_px) * scale + 0.5 * (scale - 1)
    radius = math.floor(3 * scale * psf_sigma_px)
    moved = position_hr_px[:, None] + np.arange(-radius, radius + 1)
    tap = np.trunc(np.clip(moved + np.where(moved > 0, 0.5, -0.5), -1, size * scale)).astype(
        np.intp
    )
    inside = (tap >= 0) & (tap < size * scale)
    lr_index, tap = np.nonzero(inside)[0], tap[inside]
    squared_hr_px = (position_hr_px[lr_index] - tap) ** 2
    weight = np.exp(-squared_hr_px / (2.0 * (scale * psf_sigma_px) ** 2))
    return sparse.csr_array((weight, (lr_index, tap)), shape=(size, size * scale))


def stacked_system(
    shape: tuple[int, ...], scale: int, offset_px: Floats, psf_sigma_px: float
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return W of all frames, one below the other, and its transpose, both by rows."""
    frames = [system_matrix(shape, scale, offset, psf_sigma_px) for offset in offset_px]
    forward = sparse.csr_array(sparse.vstack(frames, format="csr"))
    return forward, sparse.csr_array(forward.T.tocsr())
