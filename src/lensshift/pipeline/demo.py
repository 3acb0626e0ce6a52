"""A small burst of a flat target, for examples and benchmarks."""

from __future__ import annotations

from lensshift.camera import Sensor, Truth, camera_preset, simulate_burst
from lensshift.core.grid import Grid
from lensshift.core.types import Burst
from lensshift.scene import demo_target

DEMO_GRID = camera_preset("o3m151").grid  # 16 x 64 pixels


def demo_burst(grid: Grid = DEMO_GRID, *, scale: int = 2, seed: int = 0) -> tuple[Burst, Truth]:
    """Return a simulated burst of the demo target, and what nobody knows on a bench."""
    rows_mm, cols_mm = (
        count * pitch for count, pitch in zip(grid.shape, grid.pitch_mm, strict=True)
    )
    return simulate_burst(demo_target((rows_mm, cols_mm)), Sensor(grid), scale=scale, seed=seed)
