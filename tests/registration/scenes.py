"""Bursts whose shifts are known: the simulator's, and frames sampled from a closed form."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lensshift.camera import QUARTER_SQUARE_PX, Sensor, simulate_burst
from lensshift.core.grid import Grid
from lensshift.core.types import Burst
from lensshift.scene import Box, Target, boxes, demo_target

PITCH_MM = 0.155
GRID = Grid((16, 64), (PITCH_MM, PITCH_MM))
# SNR of 50 at half of full scale.
SNR_50 = Sensor(GRID, full_well_electrons=5_000.0, read_noise_electrons=7.0, bits=12)


def random_boxes(seed: int) -> Target:
    """Return boxes of any size, radiance and turn, some hidden by others."""
    rng = np.random.default_rng(seed)
    parts = [
        Box(
            (rng.uniform(-1.2, 1.2), rng.uniform(-5, 5)),
            (rng.uniform(0.4, 1.8), rng.uniform(0.5, 2.5)),
            rng.uniform(0, 1),
            rng.uniform(-0.6, 0.6),
        )
        for _ in range(9)
    ]
    return boxes(parts)


def four_boxes() -> Target:
    parts = (
        Box((-0.3, -3.0), (1.2, 1.2), 0.9, 0.1),
        Box((0.2, -1.0), (0.8, 1.4), 0.6, 0.2),
        Box((-0.1, 1.3), (1.5, 0.9), 0.4, -0.1),
        Box((0.3, 3.4), (0.9, 1.2), 0.75, 0.35),
    )
    return boxes(parts)


def checker(row_mm: NDArray[np.float64], col_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    cos, sin = np.cos(0.2), np.sin(0.2)
    along, across = (row_mm * cos + col_mm * sin) / 0.5, (col_mm * cos - row_mm * sin) / 0.5
    return np.where((np.floor(along) + np.floor(across)) % 2 > 0, 0.85, 0.15)


@cache
def scene(name: str) -> Target:
    named: dict[str, Target] = {
        "four boxes": four_boxes(),
        "checker": checker,
        "random": random_boxes(1),
    }
    return named.get(name) or demo_target((16 * PITCH_MM, 64 * PITCH_MM))


@cache
def taken(
    target: Target,
    error_px: float = 0.06,
    seed: int = 0,
    planned_px: tuple[tuple[float, float], ...] = QUARTER_SQUARE_PX,
    sensor: Sensor = SNR_50,
) -> tuple[Burst, NDArray[np.float64]]:
    """Return a burst and its true offsets against the planned offset of frame 0."""
    burst, truth = simulate_burst(
        target, sensor, np.asarray(planned_px), shift_error_px=error_px, seed=seed
    )
    return burst, truth.offset_px - truth.offset_px[0] + burst.offset_px[0]


def waves(
    offset_px: NDArray[np.float64], shape: tuple[int, int] = (21, 34), highest: float = 0.3
) -> NDArray[np.float64]:
    """Return frames [frame row col] of a sum of waves below a frequency, without noise."""
    rng = np.random.default_rng(11)
    row, col = np.meshgrid(*map(np.arange, shape), indexing="ij")
    frames = np.zeros((len(offset_px), *shape))
    for _ in range(40):
        f = rng.uniform(-highest, highest, 2)
        phase, size = rng.uniform(0, 2 * np.pi), 0.05 / (0.1 + np.hypot(*f))
        for k, (down, right) in enumerate(offset_px):
            frames[k] += size * np.cos(
                2 * np.pi * (f[0] * (row - down) + f[1] * (col - right)) + phase
            )
    return 0.5 + 0.1 * frames
