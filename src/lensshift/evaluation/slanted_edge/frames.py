"""The images of an edge, checked: one, or several whose content moved by known offsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.evaluation.slanted_edge.prepare import Pixels
from lensshift.evaluation.slanted_edge.result import Region

_FEWEST_PIXELS = 64


@dataclass(frozen=True, slots=True, eq=False)
class EdgeFrames:
    """Frames of one scene."""

    values: NDArray[np.float64]  # [frame row col], NaN where invalid
    offset_px: NDArray[np.float64]  # [frame 2] how far the content moved in each
    pitch_mm: tuple[float, float]  # (row, col)
    scale: int  # pixels per LR pixel

    @property
    def first(self) -> NDArray[np.float64]:
        """The first frame [row col]."""
        return np.asarray(self.values[0])

    def pixels(self, region: Region) -> Pixels:
        """Return the valid pixels of a region, with coordinates from its centre.

        Raises `ValueError` if there are too few.
        """
        part = self.values[(slice(None), *region.slices)]
        frame, row, col = np.nonzero(np.isfinite(part))
        if frame.size < _FEWEST_PIXELS:
            raise ValueError(
                f"expected at least {_FEWEST_PIXELS} valid pixels around an edge, got "
                f"{frame.size} in {region}"
            )
        rows, cols = part.shape[1:]
        return Pixels(
            places=np.column_stack([frame, row, col]),
            row_px=row - (rows - 1) / 2.0 - self.offset_px[frame, 0],
            col_px=col - (cols - 1) / 2.0 - self.offset_px[frame, 1],
            values=part[frame, row, col],
        )

    def normal_pitch_mm(self, slope_rad: float, vertical: bool) -> float:
        """Return the length of one pixel along the normal of an edge.

        Parameters
        ----------
        slope_rad : angle of the edge against the columns (vertical) or the rows
        vertical : which of the two
        """
        row_mm, col_mm = self.pitch_mm
        across_mm, along_mm = (col_mm, row_mm) if vertical else (row_mm, col_mm)
        return float(1.0 / np.hypot(np.cos(slope_rad) / across_mm, np.sin(slope_rad) / along_mm))

    def frequency_lpmm(self, wanted: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return the frequencies of the curve: those wanted, or 0 to 1 cycles per pixel."""
        if wanted is None:
            return np.asarray(np.arange(101) * 0.01 / min(self.pitch_mm))
        rising = wanted.ndim == 1 and wanted.size > 1 and bool(np.all(np.diff(wanted) > 0))
        if not rising or not np.all(np.isfinite(wanted)) or wanted[0] < 0:
            raise ValueError("expected frequency_lpmm [f] rising from 0 or above, and finite")
        return wanted


def take_frames(
    image: ArrayLike,
    pitch_mm: float | tuple[float, float],
    *,
    offset_px: ArrayLike | None,
    valid: ArrayLike | None,
    scale: int,
) -> EdgeFrames:
    """Check the input of a measurement.

    Raises
    ------
    ValueError
        If a shape does not fit, or the pixels are complex, or the pitch is not positive.
    """
    given = np.asarray(image)
    if given.dtype.kind not in "buif" or given.ndim not in (2, 3) or given.size == 0:
        raise ValueError(
            "expected a real image [row col] or frames [frame row col], got "
            f"{given.dtype} of shape {given.shape}"
        )
    values = given.astype(np.float64).reshape((-1, *given.shape[-2:]))
    values[~np.isfinite(values)] = np.nan
    if valid is not None:
        mask = np.asarray(valid, dtype=bool)
        if mask.shape not in (given.shape, given.shape[-2:]):
            raise ValueError(f"expected a mask of shape {given.shape}, got {mask.shape}")
        values[~np.broadcast_to(mask, values.shape)] = np.nan
    offsets = np.zeros((len(values), 2)) if offset_px is None else np.asarray(offset_px, float)
    if offset_px is None and len(values) > 1:
        raise ValueError(f"expected offset_px [frame 2] with {len(values)} frames, got none")
    if offsets.shape != (len(values), 2) or not np.all(np.isfinite(offsets)):
        raise ValueError(
            f"expected finite offset_px of shape {(len(values), 2)}, got {offsets.shape}"
        )
    pair = np.broadcast_to(np.asarray(pitch_mm, dtype=np.float64), (2,))
    if not np.all(np.isfinite(pair) & (pair > 0)):
        raise ValueError(f"expected a positive pitch_mm, got {pitch_mm}")
    if not 1 <= int(scale) <= 64:
        raise ValueError(f"expected a scale from 1 to 64, got {scale}")
    return EdgeFrames(values, offsets, (float(pair[0]), float(pair[1])), int(scale))
