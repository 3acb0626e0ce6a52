"""What stands before the camera: radiance as a function of the place on the image plane.

A target is a function of (row_mm, col_mm), both from the middle of the sensor, rows downwards,
as the lens images it; it returns radiance, 1 being what saturates no pixel but nearly does.
Targets are sharp: whatever blurs them is the camera's business.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.scene.textures import Edge, SiemensStar

Place = Floats
Target = Callable[[Place, Place], Floats]

BACKGROUND = 0.15  # radiance beside the targets


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of one radiance.

    Parameters
    ----------
    centre_mm, size_mm : (row, col)
    radiance : of the whole rectangle
    turn_rad : turned by this much, from the direction of rows towards that of columns
    """

    centre_mm: tuple[float, float]
    size_mm: tuple[float, float]
    radiance: float
    turn_rad: float = 0.0


def slanted_edge(slant_rad: float, dark: float = 0.2, bright: float = 0.8) -> Target:
    """Return an edge through the middle, dark on the left, `slant_rad` away from the vertical."""
    edge = Edge(slant_rad, dark, bright)
    return lambda row_mm, col_mm: edge(col_mm, row_mm)


def siemens_star(
    radius_mm: float, cycles: int = 12, dark: float = 0.1, bright: float = 0.9
) -> Target:
    """Return a star of `cycles` bright and dark sectors; a cycle at radius r is 2 pi r / cycles."""
    star = SiemensStar(radius_mm, cycles, dark, bright, binary=True)

    def radiance(row_mm: Place, col_mm: Place) -> Floats:
        inside = np.hypot(row_mm, col_mm) <= radius_mm
        return np.where(inside, star(col_mm, row_mm), BACKGROUND)

    return radiance


def line_pairs(
    period_mm: Sequence[float], size_mm: float, dark: float = 0.1, bright: float = 0.9
) -> Target:
    """Return bands of vertical lines below each other, one period each, in a square."""

    def radiance(row_mm: Place, col_mm: Place) -> Floats:
        height_mm = size_mm / len(period_mm)
        band = np.floor((row_mm + size_mm / 2) / height_mm).astype(np.intp)
        period_there_mm = np.asarray(period_mm)[np.clip(band, 0, len(period_mm) - 1)]
        lines = np.where(np.mod(col_mm / period_there_mm, 1.0) < 0.5, bright, dark)
        inside = (np.abs(row_mm) <= 0.45 * size_mm) & (np.abs(col_mm) <= 0.45 * size_mm)
        between = np.abs(row_mm + size_mm / 2 - (band + 0.5) * height_mm) > 0.42 * height_mm
        return np.where(inside & ~between, lines, BACKGROUND)

    return radiance


def boxes(parts: Sequence[Box]) -> Target:
    """Return rectangles before the background; a later one hides an earlier one."""

    def radiance(row_mm: Place, col_mm: Place) -> Floats:
        seen = np.full(np.broadcast(row_mm, col_mm).shape, BACKGROUND)
        for box in parts:
            down, right = row_mm - box.centre_mm[0], col_mm - box.centre_mm[1]
            cos, sin = np.cos(box.turn_rad), np.sin(box.turn_rad)
            along_row, along_col = down * cos + right * sin, right * cos - down * sin
            inside = (np.abs(along_row) <= box.size_mm[0] / 2) & (
                np.abs(along_col) <= box.size_mm[1] / 2
            )
            seen = np.where(inside, box.radiance, seen)
        return seen

    return radiance


def in_a_row(targets: Sequence[Target], cell_mm: float, *, downwards: bool = False) -> Target:
    """Return square cells side by side (or below each other), one target in the middle of each."""

    def radiance(row_mm: Place, col_mm: Place) -> Floats:
        row_mm, col_mm = np.broadcast_arrays(row_mm, col_mm)
        along, across = (row_mm, col_mm) if downwards else (col_mm, row_mm)
        cell = np.floor(along / cell_mm + len(targets) / 2)
        seen = np.full(row_mm.shape, BACKGROUND)
        for index, target in enumerate(targets):
            here = (cell == index) & (np.abs(across) <= cell_mm / 2)
            middle_mm = (index + 0.5 - len(targets) / 2) * cell_mm
            place = along[here] - middle_mm, across[here]
            seen[here] = target(*place) if downwards else target(*place[::-1])
        return seen

    return radiance


def demo_target(size_mm: tuple[float, float]) -> Target:
    """Return four targets that fill a sensor of `size_mm` (row, col) as well as squares can.

    A slanted edge (10 degrees), a Siemens star, line pairs, and four boxes of different size,
    radiance and orientation. On 64 x 16 pixels a cell is 16 pixels wide: the star's sectors pass
    the limit of the pixels (2 px a cycle) at a radius of 3.8 px, half of that for pixels half
    the size; the line pairs are 3.2, 2.1 and 1.4 px wide, both lines together.

    Raises
    ------
    ValueError
        If a size is not positive.
    """
    if not min(size_mm) > 0:
        raise ValueError(f"expected a sensor of positive size_mm, got {size_mm}")
    downwards = size_mm[0] > size_mm[1]
    cell = min(min(size_mm), max(size_mm) / 4)
    parts = (
        Box((-0.21 * cell, -0.23 * cell), (0.36 * cell, 0.30 * cell), 0.9),
        Box((-0.19 * cell, 0.22 * cell), (0.25 * cell, 0.28 * cell), 0.55, np.deg2rad(20)),
        Box((0.23 * cell, -0.20 * cell), (0.21 * cell, 0.41 * cell), 0.35, np.deg2rad(-7)),
        Box((0.24 * cell, 0.25 * cell), (0.16 * cell, 0.16 * cell), 0.75),
    )
    targets = (
        slanted_edge(np.deg2rad(10)),
        siemens_star(0.46 * cell),
        line_pairs((0.2 * cell, 0.13 * cell, 0.09 * cell), cell),
        boxes(parts),
    )
    return in_a_row(targets, cell, downwards=downwards)
