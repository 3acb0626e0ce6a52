"""Lenses that several tests use, and the same trace in another program."""

import math

import numpy as np
import pytest

from lensshift.optics.glass import refractive_index
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.paraxial import entrance_pupil
from lensshift.optics.pupil import midpoints
from lensshift.optics.trace import Build, trace

PLANE = Surface(math.inf)
WAVELENGTH_NM = 850.0


def perfect_lens(stop_mm: float = 20.0, focal_mm: float = 50.0) -> Lens:
    """Return a plano-hyperbolic lens, which images an infinitely far axial point perfectly."""
    index = refractive_index("N-BK7", WAVELENGTH_NM)
    radius_mm = -focal_mm * (index - 1.0)
    element = Element((PLANE, Surface(radius_mm, conic=-(index**2))), ("N-BK7",), (8.0,))
    return Lens((element,), (focal_mm,), Stop(stop_mm), wavelength_nm=WAVELENGTH_NM)


def batoid_trace(
    lens: Lens, build: Build, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace rays [n 3] in (row, col, axial) through one build with batoid.

    Returns the same three as a `RayBundle`; the path starts at `origin` and is NaN for rays that
    batoid gives up.
    """
    import batoid

    x, y, z = origin[:, 1], origin[:, 0], origin[:, 2]
    rays = batoid.RayVector(x, y, z, direction[:, 1], direction[:, 0], direction[:, 2])
    lens_axes = batoid.CoordSys()
    starts = lens.positions_mm()
    moves = np.zeros((len(lens.elements), 2)) if build.decenter_mm is None else build.decenter_mm
    tilts = np.zeros((len(lens.elements), 2)) if build.tilt_rad is None else build.tilt_rad
    for number, (element, indices) in enumerate(zip(lens.elements, lens.indices(), strict=True)):
        row, col = np.add(element.decenter_mm, moves[number])
        lean_row, lean_col = np.add(element.tilt_rad, tilts[number])
        turn = batoid.RotX(-lean_row) @ batoid.RotY(lean_col)
        vertex = np.array([col, row, starts[number]])
        media = [batoid.ConstMedium(n) for n in (1.0, *indices, 1.0)]
        depths = np.cumsum([0.0, *element.thickness_mm])
        for surface, depth, before, after in zip(
            element.surfaces, depths, media[:-1], media[1:], strict=True
        ):
            lean_row, lean_col = surface.tilt_rad
            lean = turn @ batoid.RotX(-lean_row) @ batoid.RotY(lean_col)
            axes = batoid.CoordSys(vertex + turn @ [0.0, 0.0, depth], lean)
            batoid_surface(surface).refract(rays, before, after, coordSys=axes)
    sensor = batoid.CoordSys().shiftGlobal([0.0, 0.0, starts[-1]])
    batoid.Plane().intersect(rays, coordSys=sensor)
    rays.toCoordSys(lens_axes)
    position = np.stack([rays.y, rays.x], axis=-1)
    cosines = np.stack([rays.vy, rays.vx, rays.vz], axis=-1)
    return position, cosines, np.where(rays.failed, np.nan, rays.t)


def batoid_surface(surface: Surface) -> object:
    """Return the surface in batoid."""
    import batoid

    if math.isinf(surface.radius_mm):
        return batoid.Plane()
    if surface.asphere:
        return batoid.Asphere(surface.radius_mm, surface.conic, list(surface.asphere))
    return batoid.Quadric(surface.radius_mm, surface.conic)


def same_rays(
    lens: Lens, optic: object, field: np.ndarray, points: np.ndarray, *, mm: float = 1e-6
) -> None:
    """Compare rays that pass the stop at the same points, and the first-order data."""
    rays_type = pytest.importorskip("optiland.rays").RealRays
    ours = trace(lens, field, points)
    first_mm = min(0.0, lens.stop.position_mm) if lens.elements_before_stop() == 0 else 0.0
    start_mm = first_mm - 5.0  # in front of everything
    if lens.elements_before_stop() == 0:
        through = np.zeros((len(points), 3))
        through[:, :2] = 0.5 * lens.stop.diameter_mm * points
        if lens.stop.rides_on is not None:
            through[:, :2] += lens.elements[lens.stop.rides_on].decenter_mm
        through[:, 2] = lens.stop.position_mm
    else:  # back along the rays in front of the lens, which this program met at its first surface
        met = trace(lens, field, points, crossings=True).crossing_mm
        assert met is not None
        through = met[:, 0]
    if math.isinf(lens.object_mm):
        direction = np.tile([*field, 1.0], (len(points), 1))
    else:
        source = [*(-field * (lens.object_mm + entrance_pupil(lens)[0])), -lens.object_mm]
        direction = through - source
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = through + direction * ((start_mm - through[:, 2]) / direction[:, 2])[:, None]
    ones = np.ones(len(points))
    rays = rays_type(
        origin[:, 1], origin[:, 0], origin[:, 2] - first_mm,
        direction[:, 1], direction[:, 0], direction[:, 2], ones, 1e-3 * lens.wavelength_nm * ones,
    )  # fmt: skip
    optic.surfaces.trace(rays, skip=1)  # type: ignore[attr-defined]
    assert ours.position_mm[:, 1] == pytest.approx(np.asarray(rays.x), abs=mm, nan_ok=True)
    assert ours.position_mm[:, 0] == pytest.approx(np.asarray(rays.y), abs=mm, nan_ok=True)
    assert ours.direction[:, 2] == pytest.approx(np.asarray(rays.N), abs=1e-8)


def pupil_grid(count: int) -> np.ndarray:
    """Return the points [ray 2] (row, col) of a square grid that lie on the unit disc."""
    along = midpoints(count)
    row, col = np.meshgrid(along, along, indexing="ij")
    inside = row**2 + col**2 <= 1.0
    return np.stack([row[inside], col[inside]], axis=-1)
