"""What a drawing of the lens shows: sections of surfaces, rays, the grid of image points."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.optics.lens import Lens
from lensshift.optics.paraxial import entrance_pupil
from lensshift.optics.shift import moving
from lensshift.optics.spots import image_per_field_mm, spots
from lensshift.optics.trace import Build, RayBundle, trace

_AXES = {"row": 0, "col": 1}
_SURFACE_POINTS = 33  # a curve that looks smooth
_ROOM = 1.1  # of a surface without an edge, over the highest ray
_EDGE_DEG = 6.5  # half the field of the paper's camera


@dataclass(frozen=True, slots=True, eq=False)
class Polyline:
    """A line in the section through the axis of the lens.

    Parameters
    ----------
    z_mm : [point] along the axis, 0 at the first vertex, light travels towards larger z
    height_mm : [point] from the axis, along rows or columns
    """

    z_mm: Floats
    height_mm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class DrawnRay:
    """A ray from in front of the lens to the sensor, or to the surface where it ends.

    Parameters
    ----------
    field : number of its field, in the order given
    line : its corners, one at each surface
    arrived : whether it reached the sensor
    """

    field: int
    line: Polyline
    arrived: bool


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """A section through a lens, to scale.

    Parameters
    ----------
    surfaces : [element][surface]
    outlines : closed line around each element
    rays : fans over the stop, field by field
    stop : the two edges of the stop, from the hole outwards
    sensor : across the images of the fields
    names : of the elements
    virtual_stop : whether the stop is where elements in front of it show it (`Stop.behind`)
    """

    surfaces: tuple[tuple[Polyline, ...], ...]
    outlines: tuple[Polyline, ...]
    rays: tuple[DrawnRay, ...]
    stop: tuple[Polyline, Polyline]
    sensor: Polyline
    names: tuple[str, ...]
    virtual_stop: bool = False


def layout(
    lens: Lens,
    element: int | None = None,
    decenter_mm: tuple[float, float] = (0.0, 0.0),
    *,
    field_tan: ArrayLike | None = None,
    axis: str = "col",
    rays: int = 5,
    lead_mm: float = 10.0,
) -> Layout:
    """Return the section through a lens as lines, from in front of it to the sensor.

    Parameters
    ----------
    element, decenter_mm : which element to draw moved, and by how much (row, col)
    field_tan : [field] along `axis`; by default the axis and 6.5 degrees
    axis : "col" (the long side of the sensor) or "row": the section to draw; what lies outside
        it is projected
    rays : in each fan
    lead_mm : how far in front of lens and stop the rays begin

    Raises
    ------
    ValueError
        If the axis or the element is unknown, a number is not finite, or there is no ray.
    """
    if axis not in _AXES:
        raise ValueError(f"expected axis 'row' or 'col', got {axis!r}")
    if rays < 1 or not lead_mm > 0:
        raise ValueError(f"expected at least 1 ray and lead_mm > 0, got {rays} and {lead_mm}")
    along = _AXES[axis]
    if element is not None:
        lens.check_element(element)
        row_mm, col_mm = np.add(lens.elements[element].decenter_mm, decenter_mm)
        lens = lens.with_decenter(element, (float(row_mm), float(col_mm)))
    default = [0.0, math.tan(math.radians(_EDGE_DEG))]
    tangents = np.atleast_1d(default if field_tan is None else np.asarray(field_tan, dtype=float))
    fields = np.zeros((len(tangents), 2))
    fields[:, along] = tangents
    pupil = np.zeros((rays, 2))
    pupil[:, along] = np.linspace(-1.0, 1.0, rays) if rays > 1 else 0.0
    bundle = trace(lens, fields, pupil, crossings=True)
    crossing_mm = np.empty(0) if bundle.crossing_mm is None else bundle.crossing_mm
    surfaces = _surfaces(lens, crossing_mm, along)
    image_mm = bundle.position_mm[..., along][bundle.passed]
    edge_mm = _ROOM * float(np.abs(image_mm).max(initial=1.0))
    return Layout(
        surfaces=surfaces,
        outlines=tuple(_outline(lines) for lines in surfaces),
        rays=tuple(_rays(lens, bundle, crossing_mm, fields, along, lead_mm)),
        stop=_stop(lens, along, surfaces),
        sensor=Polyline(np.full(2, lens.positions_mm()[-1]), np.array([-edge_mm, edge_mm])),
        names=tuple(one.name for one in lens.elements),
        virtual_stop=lens.stop.behind is not None,
    )


def _surfaces(lens: Lens, crossing_mm: Floats, along: int) -> tuple[tuple[Polyline, ...], ...]:
    drawn, number = [], 0
    for one, start_mm in zip(lens.elements, lens.positions_mm(), strict=False):
        depths_mm = np.cumsum([0.0, *one.thickness_mm])
        lines = []
        for surface, depth_mm in zip(one.surfaces, depths_mm, strict=True):
            edge_mm = surface.semi_diameter_mm
            if math.isinf(edge_mm):
                met_mm = crossing_mm[..., number, along] - one.decenter_mm[along]
                edge_mm = _ROOM * float(np.nanmax(np.abs(met_mm), initial=1e-3))
            height_mm = np.linspace(-edge_mm, edge_mm, _SURFACE_POINTS)
            sag_mm = surface.sag_mm(height_mm)
            sag_mm, height_mm = _turned(sag_mm, height_mm, surface.tilt_rad[along])
            z_mm, height_mm = _turned(depth_mm + sag_mm, height_mm, one.tilt_rad[along])
            lines.append(Polyline(start_mm + z_mm, one.decenter_mm[along] + height_mm))
            number += 1
        drawn.append(tuple(lines))
    return tuple(drawn)


def _turned(z_mm: Floats, height_mm: Floats, lean_rad: float) -> tuple[Floats, Floats]:
    """Return the points of a line whose axis leans."""
    cos, sin = math.cos(lean_rad), math.sin(lean_rad)
    return cos * z_mm - sin * height_mm, cos * height_mm + sin * z_mm


def _outline(lines: tuple[Polyline, ...]) -> Polyline:
    """Return front, edge, back and edge of an element as a closed line."""
    points = [np.stack([line.z_mm, line.height_mm]) for line in lines]
    upper, lower = [one[:, -1:] for one in points[1:-1]], [one[:, :1] for one in points[-2:0:-1]]
    front, back = points[0], points[-1][:, ::-1]
    return Polyline(*np.concatenate([front, *upper, back, *lower, front[:, :1]], axis=1))


def _rays(
    lens: Lens, bundle: RayBundle, crossing_mm: Floats, fields: Floats, along: int, lead_mm: float
) -> Iterator[DrawnRay]:
    start_mm = min(0.0, lens.stop.position_mm) - lead_mm
    sensor_mm = float(lens.positions_mm()[-1])
    for number, ray in np.ndindex(bundle.status.shape):
        failed_at = int(bundle.failed_at[number, ray])
        met_mm = crossing_mm[number, ray, : failed_at + 1 if failed_at >= 0 else None]
        met_mm = met_mm[np.isfinite(met_mm[:, 2])]  # a surface that is missed is not met
        if not len(met_mm):
            continue
        first_mm, first_z_mm = met_mm[0, along], met_mm[0, 2]
        slope = fields[number, along]  # in front of the lens
        if math.isfinite(lens.object_mm):
            source_mm = -slope * (lens.object_mm + entrance_pupil(lens)[0])
            slope = (first_mm - source_mm) / (first_z_mm + lens.object_mm)
        z_mm = [start_mm, *met_mm[:, 2]]
        height_mm = [first_mm + slope * (start_mm - first_z_mm), *met_mm[:, along]]
        if failed_at < 0:
            z_mm.append(sensor_mm)
            height_mm.append(bundle.position_mm[number, ray, along])
        yield DrawnRay(number, Polyline(np.array(z_mm), np.array(height_mm)), failed_at < 0)


def _stop(
    lens: Lens, along: int, surfaces: tuple[tuple[Polyline, ...], ...]
) -> tuple[Polyline, Polyline]:
    stop = lens.stop
    middle_mm = 0.0 if stop.rides_on is None else lens.elements[stop.rides_on].decenter_mm[along]
    hole_mm = 0.5 * stop.diameter_mm
    highest_mm = max(np.abs(line.height_mm).max() for lines in surfaces for line in lines)
    outer_mm = max(_ROOM * hole_mm, _ROOM * float(highest_mm))
    z_mm = np.full(2, stop.position_mm)
    return (
        Polyline(z_mm, np.array([middle_mm - hole_mm, -outer_mm])),
        Polyline(z_mm, np.array([middle_mm + hole_mm, outer_mm])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DistortionGrid:
    """Where a square grid of object points is imaged.

    Parameters
    ----------
    paraxial_mm : [row col 2] (row, col) by the paraxial lens: evenly spread over the sensor
    real_mm : [row col 2] (row, col) centroids of the traced spots
    error_px : [row col 2] (row, col) real minus paraxial, in pixels
    """

    paraxial_mm: Floats
    real_mm: Floats
    error_px: Floats


def distortion_grid(
    lens: Lens,
    grid: Grid,
    points: tuple[int, int] = (5, 17),
    *,
    element: int | None = None,
    decenter_mm: tuple[float, float] = (0.0, 0.0),
    rings: int = 4,
) -> DistortionGrid:
    """Return real against paraxial image points over a sensor.

    Parameters
    ----------
    grid : of the sensor, centred on the axis; the points reach from edge to edge
    points : rows and columns of points
    element, decenter_mm : which element to move, and by how much (row, col)
    rings : of the pupil quadrature

    Raises
    ------
    ValueError
        If there are fewer than 2 x 2 points, or as in `spots`.
    """
    if len(points) != 2 or min(points) < 2:
        raise ValueError(f"expected at least 2 x 2 points, got {points}")
    half_mm = 0.5 * np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    along = [np.linspace(-half, half, n) for half, n in zip(half_mm, points, strict=True)]
    paraxial_mm = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
    fields = (paraxial_mm / image_per_field_mm(lens)).reshape(-1, 2)
    build = Build() if element is None else moving(lens, element, np.asarray(decenter_mm))
    real_mm = spots(lens, fields, build=build, rings=rings).centroid_mm.reshape(paraxial_mm.shape)
    error_px = (real_mm - paraxial_mm) / np.asarray(grid.pitch_mm)
    return DistortionGrid(paraxial_mm, real_mm, error_px)
