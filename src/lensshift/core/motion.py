"""How the image moves: planned shifts, the stage that makes them, shifts over the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import frozen
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid

# Shifts of other frames, or that the stage did not make: shifts wrong by 0.1 px cost 2 to 4 dB
# (docs/lens.md), two places of the finest pattern are 0.25 px apart, and play is far less.
MOST_APART_PX = 0.1
SAME_PITCH = 1e-3  # relative: 1 px over a sensor of 1000


@dataclass(frozen=True, slots=True, eq=False)
class ShiftField:
    """Image offset of every pixel of every frame, for optics whose shift varies over the sensor.

    Parameters
    ----------
    offset_px : [frame row col 2] (row, col), with the sign of `Burst.offset_px`
    pitch_mm : (row, col) of the pixels it was made for, or None
    spot_px2 : [frame row col 3] variance (row, col) and covariance of the spot that the lens makes
        of a point, beyond what the response holds that `reconstruct` is told; None if it does not
        vary. With 2 in place of 3 no spot leans
    skew_px3 : [frame row col 2] third central moment (row, col) of that spot, as of coma; None
        for spots that are even, or that do not vary
    """

    offset_px: NDArray[np.float64]
    pitch_mm: tuple[float, float] | None = None
    spot_px2: NDArray[np.float64] | None = None
    skew_px3: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset_px, dtype=np.float64)
        if offset.ndim != 4 or offset.shape[-1] != 2:
            raise ValueError(f"expected offset_px [frame row col 2], got shape {offset.shape}")
        if not np.all(np.isfinite(offset)):
            raise ValueError("expected finite offsets in the shift field")
        object.__setattr__(self, "offset_px", frozen(offset))
        if self.spot_px2 is None:
            object.__setattr__(self, "skew_px3", None)
        for name, parts in (("spot_px2", (2, 3)), ("skew_px3", (2,))):
            if getattr(self, name) is None:
                continue
            spot = np.asarray(getattr(self, name), dtype=np.float64)
            shaped = spot.shape in [(*offset.shape[:3], count) for count in parts]
            if not shaped or not np.all(np.isfinite(spot)):
                raise ValueError(f"expected finite {name} {offset.shape}, got {spot.shape}")
            object.__setattr__(self, name, frozen(spot))

    def select(self, frames: Sequence[int]) -> ShiftField:
        """Return the field of some of the frames."""
        index = list(frames)
        spot, skew = (None if of is None else of[index] for of in (self.spot_px2, self.skew_px3))
        return ShiftField(self.offset_px[index], self.pitch_mm, spot, skew)

    def check_belongs(self, offset_px: NDArray[np.float64], grid: Grid) -> None:
        """Refuse the offsets [frame 2] and the grid of another burst.

        The offsets are compared in the middle of the sensor; what is common to all frames only
        moves the picture.

        Raises
        ------
        DataError
            If shape, number of frames, pitch or offsets differ.
        """
        expected, got = (len(offset_px), *grid.shape, 2), self.offset_px.shape
        if got != expected:
            raise DataError(f"expected a shift field of {expected}, got {got}", field="offset_px")
        if self.pitch_mm is not None and not np.allclose(
            self.pitch_mm, grid.pitch_mm, rtol=SAME_PITCH
        ):
            raise DataError(
                f"expected a shift field for pixels of {grid.pitch_mm} mm, got {self.pitch_mm}",
                field="pitch_mm",
            )
        rows, cols = (slice((size - 1) // 2, size // 2 + 1) for size in grid.shape)
        apart = self.offset_px[:, rows, cols].mean(axis=(1, 2)) - offset_px
        apart_px = np.abs(apart - np.median(apart, axis=0)).max(axis=1)
        wrong = np.flatnonzero(apart_px > MOST_APART_PX)
        if wrong.size:
            raise DataError(
                f"expected a shift field with the offsets of the burst, got {apart_px.max():.2f} "
                f"px more in {wrong.size} of {got[0]} frames, frame {wrong[0]} first (from 0)",
                field="offset_px",
            )


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
            told = self.px_per_mm.tolist()
            raise ValueError(f"expected a px_per_mm of 2 x 2 finite numbers, got {told!r:.80}")
        if self.field_px_per_mm is not None and self.field_px_per_mm.shape[2:] != (2, 2):
            raise ValueError(
                f"expected field_px_per_mm [row col 2 2], got {self.field_px_per_mm.shape}"
            )
        if not 0.0 <= self.sigma_px < np.inf:
            raise ValueError(f"expected a sigma_px of at least 0, got {self.sigma_px}")
        object.__setattr__(self, "px_per_mm", frozen(self.px_per_mm))
        if self.field_px_per_mm is not None:
            object.__setattr__(self, "field_px_per_mm", frozen(self.field_px_per_mm))
