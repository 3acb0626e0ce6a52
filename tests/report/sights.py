"""What the figures of these tests show: an edge, lines, a star, distances, builds of a lens."""

import numpy as np
from numpy.typing import NDArray

from lensshift.optics.tolerance import Sensitivity, ToleranceResult
from lensshift.optics.which import Mover

Floats = NDArray[np.float64]

# Of the star.
CYCLES, CENTER_PX, MODULATION = 24, (33.3, 37.6), 0.6
SIDES_MM = (0.02, 0.025)


def card(shape: tuple[int, int], angle_rad: float, position_px: float, *, fine: int = 8) -> Floats:
    """Return a near-vertical edge: bright where x cos t + (y - middle) sin t > position cos t."""
    rows, cols = shape
    y_px, x_px = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in shape)
    across = (x_px[None, :] - position_px) * np.cos(angle_rad)
    along = (y_px[:, None] - 0.5 * (rows - 1)) * np.sin(angle_rad)
    image = (across + along > 0).astype(float).reshape(rows, fine, cols, fine).mean(axis=(1, 3))
    return 0.2 + 0.6 * image + np.random.default_rng(0).normal(0.0, 0.005, shape)


def movers() -> list[Mover]:
    return [
        Mover(0, "front", 0.0444, 0.87, 0.0056, 0.0157, 0.953, 0.931, 0.022),
        Mover(1, "middle", 0.1267, 0.31, 0.002, 0.0026, 0.953, 0.924, 0.0291),
        Mover(3, "last", -0.232, -0.17, 0.0011, 0.08, 0.953, 0.87, 0.0824),
    ]


def built(count: int = 200) -> ToleranceResult:
    rng = np.random.default_rng(5)
    mtf = 0.95 - 0.1 * rng.random((count, 5, 9, 4))
    return ToleranceResult(
        frequency_lpmm=6.45,
        mtf=mtf,
        shift_px=0.25 + 0.001 * rng.normal(size=(count, 4, 9, 2)),
        refocus_mm=rng.normal(0.0, 0.1, count),
        nominal_mtf=np.full((5, 9, 4), 0.94),
        nominal_shift_px=np.full((4, 9, 2), 0.25),
    )


def sensitivities() -> list[Sensitivity]:
    return [
        Sensitivity("tilt", number % 3, "lens", 0.02 / (1 + number), 0.001, 0.1)
        for number in range(14)
    ]


def star_image() -> Floats:
    row, col = np.indices((69, 77))
    row_mm, col_mm = (row - CENTER_PX[0]) * SIDES_MM[0], (col - CENTER_PX[1]) * SIDES_MM[1]
    wave = 1.0 + MODULATION * np.cos(CYCLES * np.arctan2(row_mm, col_mm) + 0.4)
    return 100.0 * wave + 0.05 * col  # uneven light


def stepped() -> tuple[Floats, Floats]:
    """Return measured and true distances with 8 pixels between the two surfaces and a hole."""
    true_m = np.full((17, 41), 3.5)
    true_m[4:12, 11:27] = 3.0
    measured_m = true_m + np.random.default_rng(3).normal(0.0, 0.005, true_m.shape)
    measured_m[4:12, 11] = 3.25
    measured_m[:3, :4] = np.nan
    return measured_m, true_m
