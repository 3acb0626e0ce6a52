"""Where the pixels behind a lens look: from places on the sensor back to directions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder, polygrid2d
from numpy.typing import NDArray

from lensshift.core.arrays import Floats, Mask
from lensshift.core.errors import warn_quality
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import PixelDirections
from lensshift.optics.lens import Lens
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.spots import CENTROID_RINGS, centroids_mm, fields_for_image
from lensshift.optics.trace import SIDES, trace

_RINGS = 8  # of rays that tell where it is dark
_NEXT_TO_NONE = 0.01  # of the light through the stop
_DENSE = 33  # places along an axis where parts are dark
_STEPS_OUT = 33  # to the corners: finer than what is drawn between nodes
_WIDEST_RAD = np.radians(89.9)  # that a tangent tells
_TINY = 1e-12
_FIELD_STEP = 1e-3  # of field_tan, for central differences


def lens_directions(lens: Lens, grid: Grid) -> PixelDirections:
    """Return the direction of every pixel of a sensor centred on the axis of a lens at rest.

    Traced at no more than 17 x 17 nodes (33 x 33 where some are dark), with splines between them;
    the light from a direction has its centroid in the middle of the pixel. Pixels without light
    look where the others let expect.

    Raises
    ------
    ValueError
        If most pixels are not reached by light.

    Warns
    -----
    QualityWarning
        If some are not.
    """
    pixels = [np.arange(count, dtype=np.float64) for count in grid.shape]
    rows, cols, field = _traced(lens, grid, 0.5)
    directions = Directions(rows, cols, field)
    if np.isnan(field).any():
        look = np.stack(directions.lattice(rows, cols), axis=-1)
        light = trace(lens, look, pupil_quadrature(_RINGS)[0]).passed.mean(axis=-1)
        dark = light < _NEXT_TO_NONE
        if dark.any():
            from_mm = np.linalg.norm(places_mm(grid, rows, cols)[dark], axis=-1).min()
            warn_quality(
                f"about {100 * dark.mean():.0f} % of the sensor are dark, from {from_mm:.2g} mm "
                "from its middle on: the lens sends no light there"
            )
    down, right = directions.lattice(*pixels)
    return PixelDirections(np.stack([right, down, np.ones_like(down)], axis=-1))


class Directions:
    """Down and right over forward between places where they are traced.

    Splines of the angle along each axis: its tangent has no end where a lens is wide.

    Parameters
    ----------
    rows, cols : rising places
    field_tan : [row col 2] fields imaged there, NaN where it is dark
    """

    def __init__(self, rows: Floats, cols: Floats, field_tan: Floats) -> None:
        from scipy.interpolate import RectBivariateSpline

        angle_rad = continued(np.stack(angles_of(*np.moveaxis(field_tan, -1, 0)), -1), rows, cols)
        self._splines = [RectBivariateSpline(rows, cols, angle_rad[..., i]) for i in (0, 1)]

    @classmethod
    def of(cls, lens: Lens, grid: Grid, margin_px: float) -> Directions:
        """Trace those of a sensor and so many pixels around it; errors as in `lens_directions`."""
        return cls(*_traced(lens, grid, margin_px))

    def lattice(self, row_px: Floats, col_px: Floats) -> tuple[Floats, Floats]:
        """Return down and right over forward, [row col] each, at places [row] and [col]."""
        return tangents_of(*(spline(row_px, col_px) for spline in self._splines))

    def at(self, row_px: Floats, col_px: Floats) -> tuple[Floats, Floats]:
        """Return down and right over forward, [...] each, at places [...]."""
        return tangents_of(*(spline.ev(row_px, col_px) for spline in self._splines))


def angles_of(down: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Return the angle from forward, shared out along both axes as its tangent is."""
    size = np.hypot(down, right)
    share = np.where(size > 0, np.arctan(size) / np.maximum(size, _TINY), 1.0)
    return down * share, right * share


def tangents_of(down_rad: Floats, right_rad: Floats) -> tuple[Floats, Floats]:
    """Return what `angles_of` took, of angles that end just before the side."""
    size = np.hypot(down_rad, right_rad)
    over = np.tan(np.minimum(size, _WIDEST_RAD)) / np.maximum(size, _TINY)
    share = np.where(size > 0, over, 1.0)
    return down_rad * share, right_rad * share


def _traced(lens: Lens, grid: Grid, margin_px: float) -> tuple[Floats, Floats, Floats]:
    """Return places [row], [col] and the fields [row col 2] imaged there, NaN where it is dark."""
    rows, cols = (nodes_px(count, margin_px) for count in grid.shape)
    field = fields_for_image(lens, places_mm(grid, rows, cols), dark=True)
    if np.isnan(field).any():  # more places tell where that begins
        rows, cols = (np.linspace(each[0], each[-1], _DENSE) for each in (rows, cols))
        field = fields_for_image(lens, places_mm(grid, rows, cols), dark=True)
        down, right = Directions(rows, cols, field).lattice(rows[[0, -1]], cols[[0, -1]])
        corners = np.stack(angles_of(down, right), axis=-1).reshape(-1, 2)
        outward = np.linspace(0.0, 1.0, _STEPS_OUT)[:, None, None] * corners
        _check_end(lens, np.stack(tangents_of(outward[..., 0], outward[..., 1]), axis=-1))
    return rows, cols, field


def _check_end(lens: Lens, field_tan: Floats) -> None:
    """Refuse an image that does not end in the dark but turns back, along fields [step ray 2].

    There the image of an area has another orientation than in the middle, field_tan[0].
    """
    points, weight = pupil_quadrature(CENTROID_RINGS)
    rays = trace(lens, field_tan[..., None, :] + _FIELD_STEP * SIDES, points)
    up, down, right, left = np.moveaxis(rays.position_mm, -3, 0)
    share = np.where(rays.passed.all(axis=-2), weight, 0.0)
    by_row, by_col = (np.where(share[..., None] > 0, d, 0.0) for d in (up - down, right - left))
    area = by_row[..., 0] * by_col[..., 1] - by_row[..., 1] * by_col[..., 0]
    turned = np.sum(share * area, axis=-1)
    back = np.flatnonzero((turned * turned[0] < 0).any(axis=-1))
    if back.size:
        last_mm = np.linalg.norm(centroids_mm(lens, field_tan[back[0] - 1], dark=True), axis=-1)
        raise ValueError(
            f"expected an image that ends in the dark, but about {np.nanmin(last_mm):.2g} mm from "
            "its middle it turns back: a smaller sensor, or smaller semi-diameters, would not show "
            "that"
        )


def continued(nodes: Floats, row: Floats, col: Floats) -> Floats:
    """Return values [row col n] at nodes of a grid, where they are NaN going on from the others.

    Straight on from the nearest node that is known, by the slopes there of a polynomial: of third
    degree, as distortion is, or less where not twice as many nodes are known as it has terms. What
    comes of it lies in the dark: it keeps splines smooth beside it.

    Parameters
    ----------
    row, col : rising places of the nodes

    Raises
    ------
    ValueError
        If too few nodes are known for any slope.
    """
    known = np.asarray(np.isfinite(nodes).all(axis=-1))
    if known.all():
        return nodes
    row, col = (each / np.abs(each).max() for each in (row, col))
    degree = max((n for n in range(4) if known.sum() >= (n + 1) * (n + 2)), default=-1)
    if degree < 1:
        raise ValueError(
            f"expected light on more of the sensor: {100 * (1 - known.mean()):.0f} % of it are "
            "dark; a smaller sensor, or a lens with a larger image, would not be"
        )
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    terms = np.stack([np.multiply.outer(row**i, col**j) for i, j in powers], axis=-1)
    found = np.linalg.lstsq(terms[known], nodes[known], rcond=None)[0]
    polynomial = np.zeros((degree + 1, degree + 1, nodes.shape[-1]))
    polynomial[tuple(np.transpose(powers))] = found
    at = _nearest(known)
    on = nodes[at]
    for axis, place in enumerate(np.meshgrid(row, col, indexing="ij")):
        slope = polygrid2d(row, col, polyder(polynomial, axis=axis))
        on = on + np.moveaxis(slope, 0, -1)[at] * (place - place[at])[..., None]
    return np.asarray(on)


def from_nearest(nodes: Floats) -> Floats:
    """Return values [row col n] at evenly spaced nodes, those that are NaN as at the nearest."""
    return np.asarray(nodes[_nearest(np.asarray(np.isfinite(nodes).all(axis=-1)))])


def _nearest(known: Mask) -> tuple[NDArray[Any], ...]:
    """Return the numbers [row col] of the row and the column of the nearest node that is known."""
    from scipy.ndimage import distance_transform_edt

    return tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))


def nodes_px(count: int, margin_px: float) -> Floats:
    """Return places along an axis, from beyond its first pixel to beyond its last."""
    return np.linspace(-margin_px, count - 1 + margin_px, min(max(5, count // 4), 17))


def places_mm(grid: Grid, row_px: Floats, col_px: Floats) -> Floats:
    """Return places [row col 2] (row, col) on the sensor, from the axis."""
    axes = zip((row_px, col_px), grid.shape, grid.pitch_mm, strict=True)
    along = [(place_px - 0.5 * (count - 1)) * pitch_mm for place_px, count, pitch_mm in axes]
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
