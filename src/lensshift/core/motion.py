"""How the image moves: planned shifts, the stage that makes them, shifts over the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import frozen


@dataclass(frozen=True, slots=True, eq=False)
class ShiftField:
    """Image offset of every pixel of every frame, for optics whose shift varies over the sensor.

    Parameters
    ----------
    offset_px : [frame row col 2] (row, col), with the sign of `Burst.offset_px`
    """

    offset_px: NDArray[np.float64]

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset_px, dtype=np.float64)
        if offset.ndim != 4 or offset.shape[-1] != 2:
            raise ValueError(f"expected offset_px [frame row col 2], got shape {offset.shape}")
        if not np.all(np.isfinite(offset)):
            raise ValueError("expected finite offsets in the shift field")
        object.__setattr__(self, "offset_px", frozen(offset))


@dataclass(frozen=True, slots=True, eq=False)
class ShiftPlan:
    """Where the image content should be in each frame.

    Parameters
    ----------
    target_px : [frame 2] (row, col), with the sign of `Burst.offset_px`
    reference : number of the frame that the others are compared with, or None for the rest
        position of the lens
    name : of the pattern
    """

    target_px: NDArray[np.float64]
    reference: int | None = None
    name: str = ""

    def __post_init__(self) -> None:
        target = np.asarray(self.target_px, dtype=np.float64)
        if target.ndim != 2 or target.shape[1] != 2 or not np.all(np.isfinite(target)):
            raise ValueError(f"expected finite target_px [frame 2], got shape {target.shape}")
        if self.reference is not None and not 0 <= self.reference < len(target):
            raise ValueError(f"expected a reference from 0 to {len(target) - 1}")
        object.__setattr__(self, "target_px", frozen(target))


@dataclass(frozen=True, slots=True, eq=False)
class StageMap:
    """How far the image moves when the stage moves.

        offset_px = px_per_mm (stage_mm - rest)

    Parameters
    ----------
    px_per_mm : [2 2] image (row, col) over stage axes: scale, rotation, cross-talk
    field_px_per_mm : [row col 2 2] the same for every pixel where the shift varies over the
        sensor, or None
    sigma_px : standard deviation of an offset that it predicts
    """

    px_per_mm: NDArray[np.float64]
    field_px_per_mm: NDArray[np.float64] | None = None
    sigma_px: float = 0.0

    def __post_init__(self) -> None:
        if self.px_per_mm.shape != (2, 2) or not np.all(np.isfinite(self.px_per_mm)):
            raise ValueError(f"expected a finite px_per_mm [2 2], got {self.px_per_mm.shape}")
        if self.field_px_per_mm is not None and self.field_px_per_mm.shape[2:] != (2, 2):
            raise ValueError(
                f"expected field_px_per_mm [row col 2 2], got {self.field_px_per_mm.shape}"
            )
        object.__setattr__(self, "px_per_mm", frozen(self.px_per_mm))
        if self.field_px_per_mm is not None:
            object.__setattr__(self, "field_px_per_mm", frozen(self.field_px_per_mm))
