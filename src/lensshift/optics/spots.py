"""Where the light of an object point lands: spots, image points, distortion, wavefront."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import WorstWarning, warn_quality
from lensshift.optics.lens import Lens
from lensshift.optics.paraxial import matrices_around_stop, paraxial
from lensshift.optics.pupil import midpoints, pupil_quadrature
from lensshift.optics.trace import Build, RayBundle, trace

CENTROID_RINGS = 2  # of the pupil: the centroid is smooth
_FEWEST_RAYS = 2  # of 16: where one alone arrives it is nearly dark, and shows no spot
_FIELD_STEPS = 30  # a wide lens with distortion needs more than a few
_LITTLE = 0.5  # of the light
_TELLING = 0.01  # share of a step that must show in the image to learn from it
_AXIAL_RAYS = 2000  # rings of the pupil, by which an obstruction is known
_SETTLING_STEPS = 10  # after which the same rays count: one at an edge would come and go


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """The spot of each object point.

    Parameters
    ----------
    centroid_mm : [... 2] (row, col) on the sensor
    rms_radius_mm : [...] root mean square distance from the centroid
    transmission : [...] share of the light through the stop that reaches the sensor
    ray_mm : [... ray 2] landing points relative to the centroid
    direction : [... ray 3] cosines (row, col, axial) at the sensor
    weight : [... ray] sums to 1 over the rays, 0 for those that are lost
    """

    centroid_mm: Floats
    rms_radius_mm: Floats
    transmission: Floats
    ray_mm: Floats
    direction: Floats
    weight: Floats


def spots(
    lens: Lens,
    field_tan: ArrayLike,
    *,
    build: Build | None = None,
    wavelength_nm: float | None = None,
    rings: int = 6,
) -> Spots:
    """Trace the spot of each object point.

    Parameters
    ----------
    field_tan, build, wavelength_nm : as for `trace`
    rings : of the pupil quadrature

    Raises
    ------
    ValueError
        If no ray of an object point arrives: with the surface where most of them are lost.
    """
    points, weight = pupil_quadrature(rings, inner=obstruction(lens))
    rays = trace(lens, field_tan, points, build=build, wavelength_nm=wavelength_nm)
    return spots_of_rays(lens, field_tan, rays, weight)


def centroids_mm(
    lens: Lens, field_tan: ArrayLike, build: Build | None = None, *, dark: bool = False
) -> Floats:
    """Return the centroids [... 2] of spots, by the few rays that tell them.

    Parameters
    ----------
    field_tan, build : as for `trace`; with `dark` some fields may be NaN
    dark : whether centroids of fields without light are NaN, in place of an error

    Raises
    ------
    ValueError
        As in `spots`, where dark fields are none of the answer.
    """
    if not dark:
        return spots(lens, field_tan, build=build, rings=CENTROID_RINGS).centroid_mm
    points, weight = pupil_quadrature(CENTROID_RINGS, inner=obstruction(lens))
    fields = np.asarray(field_tan, dtype=np.float64)
    rays = trace(lens, np.nan_to_num(fields), points, build=build)
    share, transmission = _shares(rays, weight)
    landing_mm = np.where(share[..., None] > 0, rays.position_mm, 0.0)
    lit = (transmission > 0) & np.isfinite(fields).all(axis=-1)
    return np.where(lit[..., None], np.einsum("...r,...rc->...c", share, landing_mm), np.nan)


def axial_light(lens: Lens) -> tuple[float, float]:
    """Return the share of the light through the stop that arrives on the axis, and the obstruction.

    The obstruction is the radius of what is stopped about the axis over that of the pupil.
    """
    radius = np.sqrt(midpoints(2 * _AXIAL_RAYS)[_AXIAL_RAYS:])
    passed = trace(lens, np.zeros(2), radius[:, None] * np.array([0.0, 1.0])).passed
    if not passed.any():
        return 0.0, 0.0
    stopped = int(passed.argmax())
    return float(passed.mean()), float(np.sqrt(stopped / _AXIAL_RAYS))


@lru_cache(maxsize=32)
def obstruction(lens: Lens) -> float:
    """Return the obstruction of `axial_light`, 0 without a trace where no surface has any."""
    return axial_light(lens)[1] if any(one.inner_mm for one in lens.surfaces) else 0.0


def with_middle(
    spot: Spots,
    lens: Lens,
    field_tan: ArrayLike,
    build: Build | None,
    wavelength_nm: float,
    rings: int,
) -> Spots:
    """Return the spot with what would pass the dark middle: sheared pupils overlap there too."""
    inner = obstruction(lens)
    if not inner:
        return spot
    clear = lens.with_surfaces(replace(one, inner_mm=0.0) for one in lens.surfaces)
    points, weight = pupil_quadrature(rings, inner=inner)
    rays = trace(clear, field_tan, points, build=build, wavelength_nm=wavelength_nm)
    dark = (np.linalg.norm(points, axis=-1) < inner) & rays.passed
    from_centre = rays.position_mm - spot.centroid_mm[..., None, :]
    return replace(
        spot,
        ray_mm=np.where(dark[..., None], from_centre, spot.ray_mm),
        direction=np.where(dark[..., None], rays.direction, spot.direction),
        weight=np.where(dark, weight / spot.transmission[..., None], spot.weight),
    )


def spots_of_rays(lens: Lens, field_tan: ArrayLike, rays: RayBundle, weight: Floats) -> Spots:
    """Return the spots of traced rays [... ray] that carry weights [ray]; see `spots`."""
    passed = rays.passed
    share, transmission = _arriving(lens, rays, weight)
    if transmission.min() < _LITTLE:
        _warn_of_loss(lens, field_tan, rays, transmission)
    position = np.where(passed[..., None], rays.position_mm, 0.0)
    centroid = np.einsum("...r,...rc->...c", share, position)
    relative = np.where(passed[..., None], position - centroid[..., None, :], 0.0)
    radius = np.sqrt(np.einsum("...r,...rc,...rc->...", share, relative, relative))
    direction = np.where(passed[..., None], rays.direction, 0.0)
    return Spots(centroid, radius, transmission, relative, direction, share)


def _arriving(lens: Lens, rays: RayBundle, weight: Floats) -> tuple[Floats, Floats]:
    """Return what `_shares` does, of fields that all have light."""
    share, transmission = _shares(rays, weight)
    if not np.all(transmission > 0):
        raise ValueError(_why_dark(lens, rays))
    return share, transmission


def _shares(rays: RayBundle, weight: Floats) -> tuple[Floats, Floats]:
    """Return weights [... ray] of the rays that arrive, of sum 1, and how much of all they are.

    All are 0 where no ray arrives.
    """
    alive = np.where(rays.passed, weight, 0.0)
    transmission = alive.sum(axis=-1)
    return alive / np.where(transmission > 0, transmission, 1.0)[..., None], transmission


def _warn_of_loss(lens: Lens, field_tan: ArrayLike, rays: RayBundle, transmission: Floats) -> None:
    """Tell which field loses most of its light, how much, and where."""
    worst = np.unravel_index(int(transmission.argmin()), transmission.shape)
    row_deg, col_deg = np.degrees(
        np.arctan(np.broadcast_to(np.asarray(field_tan), (*transmission.shape, 2))[worst])
    )
    failed_at = rays.failed_at[worst]
    surface = int(np.bincount(failed_at[failed_at >= 0]).argmax())
    lost = 1.0 - float(transmission[worst])
    problem = (
        f"the field at {row_deg:.3g} / {col_deg:.3g} degrees (row / column) loses "
        f"{100 * lost:.0f} % of its light, most of it at {_called(lens, surface)}"
    )
    warn_quality(WorstWarning(problem, lost), stacklevel=4)


def fields_for_image(
    lens: Lens,
    image_mm: ArrayLike,
    *,
    build: Build | None = None,
    rings: int = CENTROID_RINGS,
    tolerance_mm: float = 1e-7,
    dark: bool = False,
) -> Floats:
    """Return the fields [... 2] whose spots have their centroids at points of the sensor.

    Broyden's method from the derivative of the paraxial lens, so that distortion of any size does
    not slow it down. A step that leads where no light arrives is halved until some does. Where a
    ray is stopped by an edge on one side of the point and not on the other, its centroid is that
    with or without this ray.

    Parameters
    ----------
    image_mm : [... 2] (row, col) on the sensor
    build : deviations of the elements; leading axes broadcast with those of `image_mm`
    rings : of the pupil quadrature that makes the spots
    tolerance_mm : how close the centroids must come
    dark : whether points without light, or next to none, are NaN, in place of an error

    Raises
    ------
    ValueError
        If a point of the sensor is not reached by light within a few steps.

    Source: C. G. Broyden, Math. Comp. 19 (1965) 577.
    """
    wanted = np.asarray(image_mm, dtype=np.float64)
    inverse: Floats = np.eye(2) / image_per_field_mm(lens)
    points, weight = pupil_quadrature(rings, inner=obstruction(lens))
    step = wanted @ inverse
    base, before, share, ever_lit = np.zeros(2), wanted, np.zeros(len(weight)), np.array(False)
    for number in range(_FIELD_STEPS):
        field = base + step
        rays = trace(lens, field, points, build=build)
        settled = (number >= _SETTLING_STEPS) & (share.sum(axis=-1) > 0)
        share = np.where(settled[..., None], share, _shares(rays, weight)[0])
        landing_mm = np.where(share[..., None] > 0, rays.position_mm, 0.0)
        error = wanted - np.einsum("...r,...rc->...c", share, landing_mm)
        arrives = np.isfinite(error).all(axis=-1) & (share.sum(axis=-1) > 0)
        ever_lit = ever_lit | arrives
        found = arrives & (np.abs(error).max(axis=-1) < tolerance_mm)
        if np.all(found):
            break
        if number:
            inverse = np.where(
                arrives[..., None, None], _updated(inverse, step, before - error), inverse
            )
        onwards = np.einsum("...ij,...j->...i", inverse, error)
        lit = arrives[..., None]
        base, before = np.where(lit, field, base), np.where(lit, error, before)
        step = np.where(found[..., None], 0.0, np.where(lit, onwards, 0.5 * step))
    else:
        if not dark:
            if not np.all(ever_lit):
                raise ValueError(_why_dark(lens, rays))
            raise ValueError(_why_unsettled(wanted, np.where(lit, error, before)))
    nearer = np.asarray(field + np.einsum("...ij,...j->...i", inverse, error))
    lit = found & (rays.passed.sum(axis=-1) >= _FEWEST_RAYS) if dark else found
    return np.where(lit[..., None], nearer, np.nan)


def _why_unsettled(wanted_mm: Floats, error_mm: Floats) -> str:
    """Say which point of the sensor no field could be found for, and what may be the matter."""
    off_mm = np.abs(error_mm).max(axis=-1)
    worst = np.unravel_index(int(off_mm.argmax()), off_mm.shape)
    row_mm, col_mm = np.broadcast_to(wanted_mm, (*off_mm.shape, 2))[worst]
    return (
        f"expected light at every point of the sensor, but for the one {row_mm:.4g} / {col_mm:.4g} "
        f"mm (row / column) from its middle the best of {_FIELD_STEPS} fields comes to "
        f"{off_mm[worst]:.2g} mm: edges of lenses that cut its light off, or an image that turns "
        "back there, end the picture; a smaller sensor, or larger semi-diameters, would not"
    )


def _updated(inverse: Floats, step: Floats, change: Floats) -> Floats:
    """Return inverse slopes [... 2 2] that explain by which step the image changed so."""
    along = np.einsum("...i,...ij->...j", step, inverse)
    size = np.einsum("...i,...i->...", along, change)
    told = size > _TELLING * np.einsum("...i,...i->...", step, step)  # else it hardly moved
    missing = step - np.einsum("...ij,...j->...i", inverse, change)
    scale = np.where(told, 1.0 / np.where(told, size, 1.0), 0.0)
    return np.asarray(inverse + np.einsum("...,...i,...j->...ij", scale, missing, along))


def image_per_field_mm(lens: Lens) -> float:
    """Return how far the paraxial chief ray moves on the sensor per unit of `field_tan`.

    With the matrices F to the stop and B behind it, and the gap g to the sensor:

        image / field = (B_01 + g B_11) / F_00
    """
    front, behind = matrices_around_stop(lens)
    return float((behind[0, 1] + lens.gaps_mm[-1] * behind[1, 1]) / front[0, 0])


def marks_of(lens: Lens) -> dict[str, float]:
    """Return what bursts and lens fields hold of a lens, to tell it from others of its name."""
    data = paraxial(lens)
    return {
        "wavelength_nm": lens.wavelength_nm,
        "working_f_number": data.working_f_number,
        "image_per_field_mm": image_per_field_mm(lens),
        "from_focus_mm": lens.gaps_mm[-1] - data.image_mm,
    }


def distortion(lens: Lens, field_tan: ArrayLike, *, rings: int = 4) -> Floats:
    """Return the relative distortion of each field, [...].

        distortion = |centroid| / |paraxial image on the sensor| - 1

    Parameters
    ----------
    field_tan : [... 2] (row, col), not on the axis

    Raises
    ------
    ValueError
        If a field is on the axis, or as in `spots`.
    """
    field = np.asarray(field_tan, dtype=np.float64)
    ideal = np.linalg.norm(field, axis=-1) * abs(image_per_field_mm(lens))
    if not np.all(ideal > 0):
        raise ValueError("expected fields away from the axis, where distortion is not defined")
    real = np.linalg.norm(spots(lens, field, rings=rings).centroid_mm, axis=-1)
    return np.asarray(real / ideal - 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Wavefront:
    """The wavefront of one object point.

    Parameters
    ----------
    pupil : [ray 2] (row, col) on the unit disc
    error_waves : [ray] path minus that of the ideal wave towards the centroid, mean 0
    rms_waves : root mean square over the stop
    centroid_mm : (row, col), the centre of the ideal wave
    """

    pupil: Floats
    error_waves: Floats
    rms_waves: float
    centroid_mm: Floats


def wavefront(
    lens: Lens,
    field_tan: ArrayLike,
    *,
    build: Build | None = None,
    wavelength_nm: float | None = None,
    rings: int = 8,
) -> Wavefront:
    """Return the wavefront error about the centroid of the spot.

        W = path + (centroid - position) . direction

    the path of the plane wave that the ray belongs to, at the centroid. No exit pupil is needed,
    so decentred elements change nothing.

    Parameters
    ----------
    field_tan : [2] (row, col)
    build, wavelength_nm : as for `trace`, without leading axes

    Raises
    ------
    ValueError
        If several fields are given, or as in `spots`.
    """
    points, weight = pupil_quadrature(rings)
    rays = trace(lens, field_tan, points, build=build, wavelength_nm=wavelength_nm)
    if rays.path_mm.ndim != 1:
        raise ValueError(f"expected one field and one build, got {rays.path_mm.shape[:-1]}")
    spot = spots_of_rays(lens, field_tan, rays, weight)
    path = rays.path_mm - np.einsum("rc,rc->r", spot.ray_mm, spot.direction[:, :2])
    path = np.where(rays.passed, path, 0.0)
    waves = (path - spot.weight @ path) / ((wavelength_nm or lens.wavelength_nm) * 1e-6)
    rms = float(np.sqrt(spot.weight @ waves**2))
    return Wavefront(points[rays.passed], waves[rays.passed], rms, spot.centroid_mm)


def _why_dark(lens: Lens, rays: RayBundle) -> str:
    """Say at which surface the rays of the darkest field are lost, and how."""
    dark = ~rays.passed.any(axis=-1)
    status, failed_at = rays.status[dark].ravel(), rays.failed_at[dark].ravel()
    surface = int(np.bincount(failed_at).argmax())
    kind = int(np.bincount(status[failed_at == surface]).argmax())
    how = ("", "miss it", "are totally reflected", "lie outside its semi-diameter")[kind]
    return (
        f"expected light on the sensor, but no ray of {int(dark.sum())} of {dark.size} fields "
        f"arrives: at {_called(lens, surface)} most {how}"
    )


def _called(lens: Lens, surface: int) -> str:
    """Return the number of a surface, counted from 0 in the lens, and where it is."""
    number, name = [
        (n, one.name or f"element {of}")
        for of, one in enumerate(lens.elements, start=1)
        for n, _ in enumerate(one.surfaces, start=1)
    ][surface]
    return f"surface {surface + 1} (surface {number} of {name})"
