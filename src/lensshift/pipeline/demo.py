"""A small burst of a flat target, for examples and benchmarks."""

from __future__ import annotations

from lensshift.camera import Sensor, Truth, simulate_burst
from lensshift.core.grid import Grid
from lensshift.core.types import Burst
from lensshift.scene import demo_target

# A ToF sensor of 64 x 16 pixels, as (rows, cols).
DEMO_GRID = Grid((16, 64), (0.155, 0.155))


def demo_burst(grid: Grid = DEMO_GRID, *, scale: int = 2, seed: int = 0) -> tuple[Burst, Truth]:
    """Return a simulated burst of the demo target, and what nobody knows on a bench."""
    rows_mm, cols_mm = (
        count * pitch for count, pitch in zip(grid.shape, grid.pitch_mm, strict=True)
    )
    return simulate_burst(demo_target((rows_mm, cols_mm)), Sensor(grid), scale=scale, seed=seed)
