"""Where each LR pixel looks on the HR grid, for shifts, shift fields and homographies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.grid import lr_to_hr

Positions = Floats

# Positions of a constant shift are rounded to this part of an HR pixel (1e-6), far below what any
# registration can know: all pixels of a frame then have bit for bit the same taps, and a third
# of a pixel that went through float32 still lands on the HR grid.
_QUANTUM_PER_HR_PX = 2.0**20


def frame_positions(
    lr_shape: tuple[int, int], offset_px: ArrayLike, scale: int
) -> tuple[Positions, Positions]:
    """Return the HR coordinates that the LR pixels see when every frame has one shift.

        v = scale (u - offset) + (scale - 1) / 2

    ValueError if `offset_px` is not [frame 2] or not finite.

    Parameters
    ----------
    lr_shape : (rows, cols) of a frame
    offset_px : [frame 2] (row, col); positive: the content moved down / right
    scale : HR pixels per LR pixel

    Returns
    -------
    row_hr_px, col_hr_px : [frame row] and [frame col]
    """
    offset = np.asarray(offset_px, dtype=np.float64)
    if offset.ndim != 2 or offset.shape[1] != 2:
        raise ValueError(f"expected offset_px [frame 2], got shape {offset.shape}")
    if not np.all(np.isfinite(offset)):
        raise ValueError("expected finite offset_px, got NaN or infinity")
    corner = np.round(lr_to_hr(-offset, scale) * _QUANTUM_PER_HR_PX) / _QUANTUM_PER_HR_PX
    row, col = (corner[:, axis, None] + scale * np.arange(lr_shape[axis]) for axis in (0, 1))
    return row, col


def field_positions(shift_field_px: ArrayLike, scale: int) -> tuple[Positions, Positions]:
    """Return the HR coordinates that the LR pixels see when every pixel has its own shift.

    Parameters
    ----------
    shift_field_px : [frame row col 2] (row, col) offset at each pixel of the frame
    scale : HR pixels per LR pixel

    Returns
    -------
    row_hr_px, col_hr_px : [frame row col] each
    """
    field = np.asarray(shift_field_px, dtype=np.float64)
    rows, cols = np.ogrid[: field.shape[1], : field.shape[2]]
    return lr_to_hr(rows - field[..., 0], scale), lr_to_hr(cols - field[..., 1], scale)
