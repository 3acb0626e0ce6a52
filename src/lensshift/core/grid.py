"""Where pixels lie: the sampling grid and the half-pixel rule, written once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

UNTOLD_PITCH_MM = 1.0  # taken for a pixel of a frame where nobody says how large it is


def hr_to_lr(index_hr_px: ArrayLike, scale: int) -> NDArray[np.float64]:
    """Map HR pixel coordinates to LR pixel coordinates along one axis.

        u = (i + 1/2) / scale - 1/2

    Pixel centres are at integers; HR pixels 0 .. scale-1 tile LR pixel 0.
    """
    return (np.asarray(index_hr_px, dtype=np.float64) + 0.5) / scale - 0.5


def lr_to_hr(position_px: ArrayLike, scale: int) -> NDArray[np.float64]:
    """Map LR pixel coordinates to HR pixel coordinates along one axis (inverse of `hr_to_lr`)."""
    return (np.asarray(position_px, dtype=np.float64) + 0.5) * scale - 0.5


@dataclass(frozen=True, slots=True)
class Grid:
    """A rectangular sampling grid on the image plane.

    Parameters
    ----------
    shape : pixels as (rows, cols); a sensor of 64 x 16 pixels is (16, 64)
    pitch_mm : pixel spacing as (row, col)

    Raises
    ------
    ValueError
        If a count or a pitch is not positive.
    """

    shape: tuple[int, int]
    pitch_mm: tuple[float, float]

    def __post_init__(self) -> None:
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise ValueError(f"expected a grid of at least 1 x 1 pixels, got shape {self.shape}")
        if len(self.pitch_mm) != 2 or not all(np.isfinite(p) and p > 0 for p in self.pitch_mm):
            raise ValueError(f"expected two positive pitch_mm, got {self.pitch_mm}")

    def tells_pitch(self, scale: int = 1) -> bool:
        """Tell whether somebody told the pitch: lengths in mm mean nothing where nobody did.

        Parameters
        ----------
        scale : so many of these pixels lie side by side in one of a frame
        """
        return any(scale * pitch_mm != UNTOLD_PITCH_MM for pitch_mm in self.pitch_mm)

    def refine(self, scale: int) -> Grid:
        """Return the grid that covers the same area with `scale` times finer pixels."""
        rows, cols = self.shape
        return Grid(
            (rows * scale, cols * scale), (self.pitch_mm[0] / scale, self.pitch_mm[1] / scale)
        )
