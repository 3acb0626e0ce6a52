"""Aberrations over the field: ray fans, focus of both sections, Petzval sum, illumination."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import Band
from lensshift.optics.otf import exact_otf
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.spots import fields_for_image, image_per_field_mm
from lensshift.optics.trace import SIDES, Build, trace

_NEAR_CHIEF = 1e-3  # of the stop radius: close enough for differences, far enough from rounding
_FAN_RAYS = 41  # a curve that looks smooth, with its chief ray
_RINGS = 16  # the edge of vignetting is known to 1 / 16^2
_STEP = 1e-3  # of the field and of the pupil, for central differences


@dataclass(frozen=True, slots=True, eq=False)
class RayFan:
    """Transverse errors of two rows of rays through the stop.

    Parameters
    ----------
    pupil : [ray] place in the stop, -1 .. 1
    tangential_mm : [... ray] error along the field of rays across the stop in that direction
    sagittal_mm : [... ray] error across the field of rays in the other direction

    Both against the chief ray, NaN for rays that do not arrive.
    """

    pupil: Floats
    tangential_mm: Floats
    sagittal_mm: Floats


def ray_fan(
    lens: Lens,
    field_tan: ArrayLike,
    *,
    build: Build | None = None,
    wavelength_nm: float | None = None,
    rays: int = _FAN_RAYS,
) -> RayFan:
    """Trace the tangential and the sagittal ray fan of each field.

    The errors are against the chief ray of the same wavelength. On the axis "tangential" is along
    columns.

    Parameters
    ----------
    field_tan : [... 2] (row, col)
    build : as for `trace`, without leading axes
    rays : of each fan, an odd number, so that the chief ray is among them

    Raises
    ------
    ValueError
        If the number of rays is even or below 3, or as in `trace`.
    """
    if rays < 3 or rays % 2 == 0:
        raise ValueError(f"expected an odd number of rays, at least 3, got {rays}")
    pupil = np.linspace(-1.0, 1.0, rays)
    at_mm, _, passed = _in_sections(lens, field_tan, pupil, build, wavelength_nm)
    errors_mm = np.where(passed, at_mm, np.nan) - at_mm[..., rays // 2, None]
    return RayFan(pupil, errors_mm[..., 0, :], errors_mm[..., 1, :])


def _in_sections(
    lens: Lens, field_tan: ArrayLike, pupil: Floats, build: Build | None, nm: float | None
) -> tuple[Floats, Floats, Floats]:
    """Return places in mm and slopes along both sections [... section ray], and which arrive."""
    fields = np.asarray(field_tan, dtype=np.float64)
    found = np.empty((3, *fields.shape[:-1], 2, len(pupil)))
    for place in np.ndindex(fields.shape[:-1]):
        for number, along in enumerate(sections(fields[place])):
            points = np.outer(pupil, along)
            rays = trace(lens, fields[place], points, build=build, wavelength_nm=nm)
            slope = (rays.direction[:, :2] / rays.direction[:, 2:]) @ along
            found[(slice(None), *place, number)] = rays.position_mm @ along, slope, rays.passed
    return found[0], found[1], found[2]


def sections(field_tan: ArrayLike) -> Floats:
    """Return unit vectors (row, col) along and across a field, [2 2]; along columns on the axis."""
    row, col = np.asarray(field_tan, dtype=np.float64)
    size = np.hypot(row, col)
    along = np.array([row, col]) / size if size > 0 else np.array([0.0, 1.0])
    return np.stack([along, [along[1], -along[0]]])


@dataclass(frozen=True, slots=True, eq=False)
class FocalSurfaces:
    """Where rays next to the chief ray meet, from the sensor, positive behind it.

    Parameters
    ----------
    tangential_mm : [...] of rays displaced along the field, measured along the axis
    sagittal_mm : [...] of rays displaced across it
    """

    tangential_mm: Floats
    sagittal_mm: Floats


def focal_surfaces(
    lens: Lens,
    field_tan: ArrayLike,
    *,
    build: Build | None = None,
    wavelength_nm: float | None = None,
) -> FocalSurfaces:
    """Return the focus of both sections over the field: field curvature and astigmatism.

        z = - (x_+ - x_-) / (m_+ - m_-)

    with landing points x and slopes m, along the section, of two rays 0.001 of the stop radius on
    either side of the chief ray. This is what Coddington's equations give.

    Parameters
    ----------
    field_tan : [... 2] (row, col)
    build, wavelength_nm : as for `ray_fan`

    Raises
    ------
    ValueError
        If a ray does not arrive, or its neighbours are parallel to it.
    """
    pair = np.array([_NEAR_CHIEF, -_NEAR_CHIEF])
    at_mm, slope, _ = _in_sections(lens, field_tan, pair, build, wavelength_nm)
    apart = slope[..., 0] - slope[..., 1]
    meet = np.all(np.abs(apart) > 1e-9 * _NEAR_CHIEF, axis=-1)
    if not np.all(meet):
        raise ValueError(f"expected rays of field {np.asarray(field_tan)[~meet][0]} to meet")
    focus_mm = (at_mm[..., 1] - at_mm[..., 0]) / apart
    return FocalSurfaces(focus_mm[..., 0], focus_mm[..., 1])


def petzval_curvature_per_mm(lens: Lens, wavelength_nm: float | None = None) -> float:
    """Return the curvature of the image surface of a lens without astigmatism.

        1 / R = - sum c (1 / n - 1 / n'),    mirrors (unfolded): - 2 c / n

    Negative for most lenses: the image of the edge lies nearer to them. In third order this
    surface is as far from the sagittal focus as that is from a third of the tangential one:
    z = (3 sagittal - tangential) / 2.

    Source: W. T. Welford, Aberrations of Optical Systems (1986), ch. 8.
    """
    total = 0.0
    for element, indices in zip(lens.elements, lens.indices(wavelength_nm), strict=True):
        before = 1.0
        for surface, after in zip(element.surfaces, (*indices, 1.0), strict=True):
            c = surface.vertex_curvature_per_mm
            total -= 2.0 * c / before if surface.mirror else c * (1.0 / before - 1.0 / after)
            before = after
    return float(total)


def relative_illumination(
    lens: Lens, field_tan: ArrayLike, *, build: Build | None = None, rings: int = _RINGS
) -> Floats:
    """Return the irradiance at the image of each field over that on the axis, [...].

        E ~ integral of the direction cosines (du dv) that a point of the sensor gets light from
          = integral over the stop |det(u_p - u_f x_f^-1 x_p)| dp

    for an object that is equally bright everywhere and in all directions; x and u are place and
    direction cosines at the sensor, their derivatives by field f and stop p central differences.
    Vignetting, distortion and aberrations of the pupils are in it; nothing is lost in the glass.

    Parameters
    ----------
    field_tan : [... 2] (row, col)
    build : as for `ray_fan`
    rings : of the pupil quadrature; the edge of vignetting is known to about 1 / rings^2

    Raises
    ------
    ValueError
        As in `trace`.
    """
    fields = np.asarray(field_tan, dtype=np.float64)
    light = [
        _irradiance(lens, field, build, rings) for field in (np.zeros(2), *fields.reshape(-1, 2))
    ]
    return np.asarray(np.array(light[1:]).reshape(fields.shape[:-1]) / light[0])


def _irradiance(lens: Lens, field_tan: Floats, build: Build | None, rings: int) -> float:
    points, weight = pupil_quadrature(rings)
    points = points * (1.0 - _STEP)  # their neighbours lie in the stop too
    moved = trace(lens, field_tan + _STEP * SIDES, points, build=build)
    shifted = (points[:, None] + _STEP * np.array([(0.0, 0.0), *SIDES])).reshape(-1, 2)
    rays = trace(lens, field_tan, shifted, build=build)
    by_stop = rays.position_mm.reshape(-1, 5, 2), rays.direction[:, :2].reshape(-1, 5, 2)
    x_p, u_p = (np.stack([q[:, 1] - q[:, 2], q[:, 3] - q[:, 4]], axis=-1) for q in by_stop)
    by_field = moved.position_mm, moved.direction[..., :2]
    x_f, u_f = (np.stack([q[0] - q[1], q[2] - q[3]], axis=-1) for q in by_field)
    passed = rays.passed.reshape(-1, 5)[:, 0] & np.all(np.isfinite(x_f), axis=(1, 2))
    passed &= np.all(np.isfinite(x_p), axis=(1, 2))
    at_place = u_p[passed] - u_f[passed] @ np.linalg.solve(x_f[passed], x_p[passed])
    return float(weight[passed] @ np.abs(np.linalg.det(at_place)))


def section_mtf(
    lens: Lens,
    field_tan: ArrayLike,
    frequency_lpmm: ArrayLike,
    *,
    build: Build | None = None,
    band: Band | None = None,
) -> Floats:
    """Return the exact MTF of both sections of one field, [section frequency].

    Tangential first: the pattern repeats along the field, its lines lie across it.

    Parameters
    ----------
    field_tan : [2] (row, col)
    frequency_lpmm : [frequency]
    build, band : as for `exact_otf`

    Raises
    ------
    ValueError
        As in `exact_otf`.
    """
    azimuth_rad = [float(np.arctan2(*along)) for along in sections(field_tan)]
    return np.abs(exact_otf(lens, field_tan, frequency_lpmm, azimuth_rad, build=build, band=band))


def sensor_fields(lens: Lens, grid: Grid, shares: ArrayLike) -> Floats:
    """Return the fields [share 2] whose images lie at shares of the half diagonal of a sensor.

    Raises
    ------
    ValueError
        As in `fields_for_image`.
    """
    half_mm = 0.5 * np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    towards = half_mm * np.sign(image_per_field_mm(lens))  # to positive fields
    return fields_for_image(lens, np.asarray(shares, dtype=np.float64)[:, None] * towards)
