"""Where the pixels behind a lens look: from places on the sensor back to directions."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import PixelDirections
from lensshift.optics.lens import Lens
from lensshift.optics.spots import fields_for_image


def lens_directions(lens: Lens, grid: Grid) -> PixelDirections:
    """Return the direction of every pixel of a sensor centred on the axis of a lens at rest.

    Traced at no more than 17 x 17 nodes, with splines between them; the light from a direction
    has its centroid in the middle of the pixel.

    Raises
    ------
    ValueError
        If a pixel is not reached by light.
    """
    pixels = [np.arange(count, dtype=np.float64) for count in grid.shape]
    down, right = (spline(*pixels) for spline in direction_splines(lens, grid, 0.5))
    return PixelDirections(np.stack([right, down, np.ones_like(down)], axis=-1))


def direction_splines(lens: Lens, grid: Grid, margin_px: float) -> tuple[Any, Any]:
    """Return splines of down and right over forward, over (row, col) in pixels.

    Parameters
    ----------
    margin_px : how far around the sensor they are needed
    """
    from scipy.interpolate import RectBivariateSpline

    rows, cols = (nodes_px(count, margin_px) for count in grid.shape)
    field = fields_for_image(lens, places_mm(grid, rows, cols))
    down, right = (RectBivariateSpline(rows, cols, field[..., i]) for i in (0, 1))
    return down, right


def nodes_px(count: int, margin_px: float) -> Floats:
    """Return places along an axis, from beyond its first pixel to beyond its last."""
    return np.linspace(-margin_px, count - 1 + margin_px, min(max(5, count // 4), 17))


def places_mm(grid: Grid, row_px: Floats, col_px: Floats) -> Floats:
    """Return places [row col 2] (row, col) on the sensor, from the axis."""
    axes = zip((row_px, col_px), grid.shape, grid.pitch_mm, strict=True)
    along = [(place_px - 0.5 * (count - 1)) * pitch_mm for place_px, count, pitch_mm in axes]
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
