"""How sharply the lens images: MTF of any field, azimuth, focus and build.

Two ways: exact (`lensshift.optics.otf`) and fast, from landing points of rays, here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.grid import Grid
from lensshift.optics.directions import places_mm
from lensshift.optics.lens import Lens
from lensshift.optics.pupil import pupil_arms, ring_edges
from lensshift.optics.spots import Spots, fields_for_image, obstruction, spots, with_middle
from lensshift.optics.trace import Build

AZIMUTHS_RAD = (0.0, 0.5 * np.pi)  # across columns (a vertical edge), across rows
_FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
_RINGS = 6  # of rays where nothing asks for more
_MOST_PERIODS = 0.5  # between neighbouring rays: two of them for each period
_FEWEST_RAYS = 16  # that tell the width of what is left of a pupil
_SPARE = 1.1  # rings more than the ratio says: the outermost are not evenly apart
_MOST_PLACES = 65  # along an axis of a sensor
_MOST_RAYS = 1e6  # at once, some 250 MB


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The light: wavelengths and how much of each.

    Parameters
    ----------
    wavelength_nm : [n]
    weight : [n] share of each wavelength, scaled to sum to 1

    Raises
    ------
    ValueError
        If they differ in number, a weight is negative or all are 0.
    """

    wavelength_nm: Floats
    weight: Floats

    def __post_init__(self) -> None:
        wavelength_nm = np.atleast_1d(np.asarray(self.wavelength_nm, dtype=np.float64))
        weight = np.atleast_1d(np.asarray(self.weight, dtype=np.float64))
        if wavelength_nm.ndim != 1 or wavelength_nm.shape != weight.shape:
            raise ValueError(
                f"expected a weight for each wavelength, got {weight.shape} and "
                f"{wavelength_nm.shape}"
            )
        if not (np.all(weight >= 0) and weight.sum() > 0):
            raise ValueError(f"expected weights >= 0 that are not all 0, got {weight}")
        object.__setattr__(self, "wavelength_nm", wavelength_nm)
        object.__setattr__(self, "weight", weight / weight.sum())


def light_of(band: Band | None, wavelength_nm: float) -> list[tuple[float, float]]:
    """Return the wavelengths in nm of a band with their shares, or the one of the lens alone."""
    if band is None:
        return [(wavelength_nm, 1.0)]
    return list(zip(band.wavelength_nm.tolist(), band.weight.tolist(), strict=True))


def azimuth_axes(azimuth_rad: ArrayLike) -> Floats:
    """Return the unit vectors [azimuth 2] (row, col) of azimuths, 0 along columns."""
    azimuth = np.atleast_1d(np.asarray(azimuth_rad, dtype=np.float64))
    return np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)


def led_band(centre_nm: float, fwhm_nm: float, samples: int = 5) -> Band:
    """Return the band of an LED, a Gaussian of the given full width at half maximum.

    Gauss-Hermite nodes: exact for polynomials of degree 2 samples - 1 in the wavelength.

    Raises
    ------
    ValueError
        If the width is negative or there is no sample.
    """
    if not fwhm_nm >= 0 or samples < 1:
        raise ValueError(f"expected a width >= 0 nm and samples >= 1, got {fwhm_nm}, {samples}")
    node, weight = np.polynomial.hermite_e.hermegauss(samples)
    return Band(centre_nm + node * (fwhm_nm / _FWHM_PER_SIGMA), weight)


def diffraction_mtf(frequency_lpmm: ArrayLike, cutoff_lpmm: ArrayLike) -> Floats:
    """Return the MTF of a perfect lens with a round pupil.

        MTF = 2/pi (arccos v - v sqrt(1 - v^2)),    v = frequency / cutoff, 0 for v > 1

    The cutoff of a lens that obeys the sine condition is 1 / (wavelength x working f-number); see
    `diffraction_limit` for others.
    """
    v = np.abs(np.asarray(frequency_lpmm, dtype=np.float64)) / np.asarray(cutoff_lpmm)
    v = np.minimum(v, 1.0)
    return np.asarray(2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


def fast_mtf(
    lens: Lens,
    field_tan: ArrayLike,
    frequency_lpmm: ArrayLike,
    azimuth_rad: ArrayLike = AZIMUTHS_RAD,
    **options: Any,
) -> Floats:
    """Return the MTF from the landing points of rays: the modulus of `fast_otf`, which see."""
    return np.abs(fast_otf(lens, field_tan, frequency_lpmm, azimuth_rad, **options))


def fast_otf(
    lens: Lens,
    field_tan: ArrayLike,
    frequency_lpmm: ArrayLike,
    azimuth_rad: ArrayLike = AZIMUTHS_RAD,
    *,
    build: Build | None = None,
    band: Band | None = None,
    defocus_mm: ArrayLike = 0.0,
    rings: int | None = None,
) -> NDArray[np.complex128]:
    """Return the OTF about the centroid from the landing points of rays, [... azimuth frequency].

        OTF = D(f / cutoff) sum_rays w m exp(-2 pi i f e) / sum_rays w m
        cutoff = 4 std(cosine) / sqrt(1 + o^2) / wavelength

    with o the obstruction on the axis, e the landing point and the cosine of the ray along the
    azimuth: four standard deviations are the width of a round pupil, also seen obliquely or
    vignetted. D is the MTF of a perfect lens with this obstruction and m the share of the ray's
    part of the pupil that lies in both of two pupils f / cutoff of their width apart: the rays at
    the edge, mostly the worst, drop out first, and those that an obstruction stops come in. This is
    the exact OTF with the path differences taken to first order in f, and obstructions about the
    middle of the pupil. For the Petzval lenses that come with the package it is within 0.0015 of it
    up to 13 line pairs per mm, and with 12 rings within 0.02 up to 50; weights without m would be
    0.025 off at 13.

    Parameters
    ----------
    field_tan, build : as for `trace`
    frequency_lpmm : [frequency]
    azimuth_rad : [azimuth] direction in which the pattern repeats: 0 along columns, pi/2 along
        rows
    band : the light; the design wavelength alone by default
    defocus_mm : [...] sensor moved away from the lens; broadcasts with the leading axes
    rings : of the pupil quadrature; by default 6, or as many as neighbouring rays need to land
        within half a period, or 16 of them to arrive where most of the light is cut off

    Raises
    ------
    ValueError
        As in `spots`.

    Warns
    -----
    QualityWarning
        If neighbouring rays land farther apart, so that rays that are not there may change it.
    """
    frequency = np.atleast_1d(np.asarray(frequency_lpmm, dtype=np.float64))
    axes = azimuth_axes(azimuth_rad).T
    light = light_of(band, lens.wavelength_nm)
    return _otf_along(lens, field_tan, frequency, axes, build, light, defocus_mm, rings)


def otf_of_rays(
    lens: Lens, field_tan: ArrayLike, frequency_lpmm: Floats, *, build: Build | None = None
) -> NDArray[np.complex128]:
    """Return `fast_otf` at frequencies [n 2] (row, col) other than 0, [... n]."""
    light, once = light_of(None, lens.wavelength_nm), np.ones(1)
    return _otf_along(lens, field_tan, once, frequency_lpmm.T, build, light)[..., 0]


def _otf_along(
    lens: Lens,
    field_tan: ArrayLike,
    frequency: Floats,
    axes: Floats,
    build: Build | None,
    light: list[tuple[float, float]],
    defocus_mm: ArrayLike = 0.0,
    rings: int | None = None,
) -> NDArray[np.complex128]:
    parts, count = _enough_spots(lens, field_tan, build, light, axes, frequency, defocus_mm, rings)
    share = [w * part.transmission for (_, w), part in zip(light, parts, strict=True)]
    total = sum(share)
    centre = sum(
        (s / total)[..., None] * part.centroid_mm for s, part in zip(share, parts, strict=True)
    )
    otf = np.zeros((), dtype=np.complex128)
    for s, part, (nm, _) in zip(share, parts, light, strict=True):
        whole = with_middle(part, lens, field_tan, build, nm, count)
        landing = _landing_mm(whole, part.centroid_mm - centre, axes, defocus_mm)
        found = _spot_otf(part, whole, landing, axes, frequency, nm, count, obstruction(lens))
        otf = otf + (s / total)[..., None, None] * found
    return otf


def _enough_spots(
    lens: Lens,
    field_tan: ArrayLike,
    build: Build | None,
    light: list[tuple[float, float]],
    axes: Floats,
    frequency_lpmm: Floats,
    defocus_mm: ArrayLike,
    rings: int | None,
) -> tuple[list[Spots], int]:
    """Return the spots of each wavelength and their rings: those told, or as many as it takes."""
    highest_lpmm = float(np.abs(frequency_lpmm).max())

    def traced(count: int) -> tuple[list[Spots], float, float]:
        parts = [
            spots(lens, field_tan, build=build, wavelength_nm=nm, rings=count) for nm, _ in light
        ]
        periods = highest_lpmm * max(_farthest_mm(one, axes, defocus_mm, count) for one in parts)
        fewest = min(int((one.weight > 0).sum(axis=-1).min()) for one in parts)
        return parts, periods, max(periods / _MOST_PERIODS, (_FEWEST_RAYS / fewest) ** 0.5)

    count = rings or _RINGS
    parts, periods, missing = traced(count)
    affordable = int(np.sqrt(_MOST_RAYS / (4 * parts[0].transmission.size)))
    while missing > 1 and rings is None and count < affordable:
        count = min(max(int(np.ceil(_SPARE * count * missing)), count + 1), affordable)
        parts, periods, missing = traced(count)
    if periods > _MOST_PERIODS:
        warn_quality(
            f"the rays of {count} rings land up to {periods:.2g} periods apart, more than the "
            f"{_MOST_PERIODS:g} that tell the contrast at {highest_lpmm:g} LP/mm; `exact_otf` "
            "does, or more rings",
            stacklevel=4,
        )
    return parts, count


def _landing_mm(
    spot: Spots, from_centre_mm: ArrayLike, axes: Floats, defocus_mm: ArrayLike
) -> Floats:
    """Return where rays land along each azimuth from a point, [... azimuth ray]."""
    moved = spot.ray_mm + np.asarray(from_centre_mm)[..., None, :]
    away = np.asarray(defocus_mm, dtype=np.float64)
    if np.any(away):
        axial = np.where(spot.weight > 0, spot.direction[..., 2], 1.0)
        moved = moved + away[..., None, None] * spot.direction[..., :2] / axial[..., None]
    # Contiguous and writable, so that Numba compiles the kernel once.
    return np.ascontiguousarray(np.moveaxis(moved @ axes, -1, -2))


def _farthest_mm(spot: Spots, axes: Floats, defocus_mm: ArrayLike, rings: int) -> float:
    """Return how far apart rays land that are neighbours in the pupil, along any azimuth."""
    landing = _landing_mm(spot, np.zeros(2), axes, defocus_mm)
    by_ring = landing.reshape(*landing.shape[:-1], rings, -1)
    there = np.broadcast_to((spot.weight > 0)[..., None, :], landing.shape).reshape(by_ring.shape)
    outward = np.abs(np.diff(by_ring, axis=-2)) * (there[..., 1:, :] & there[..., :-1, :])
    round_by = np.abs(by_ring - np.roll(by_ring, 1, axis=-1)) * (there & np.roll(there, 1, axis=-1))
    return float(max(outward.max(initial=0.0), round_by.max(initial=0.0)))


def _spot_otf(
    spot: Spots,
    whole: Spots,
    landing: Floats,
    axes: Floats,
    frequency_lpmm: Floats,
    wavelength_nm: float,
    rings: int,
    inner: float,
) -> NDArray[np.complex128]:
    """Return the OTF of one wavelength about the point from which rays land, as `fast_otf`.

    Parameters
    ----------
    spot, whole : the light, and with what `with_middle` adds
    """
    from lensshift.optics.otf_kernel import spot_otf

    cosine = np.moveaxis(spot.direction[..., :2] @ axes, -1, -2)
    weight = spot.weight[..., None, :]
    mean = (weight * cosine).sum(axis=-1, keepdims=True)
    width = 4.0 * np.sqrt((weight * (cosine - mean) ** 2).sum(axis=-1) / (1.0 + inner**2))
    size = np.linalg.norm(axes, axis=0)  # 1, or a frequency: then that of all is 1
    shear_mm = wavelength_nm * 1e-6 * size**2 / width
    otf = np.empty((*landing.shape[:-1], len(frequency_lpmm)), dtype=np.complex128)
    count, rays = len(axes.T), landing.shape[-1]
    spot_otf(
        landing.reshape(-1, count, rays),
        np.broadcast_to(whole.weight, (*landing.shape[:-2], rays)).copy().reshape(-1, rays),
        np.abs((axes / size).T @ pupil_arms(rings).T), ring_edges(rings, inner), inner,
        np.broadcast_to(shear_mm, landing.shape[:-1]).copy().reshape(-1, count),
        frequency_lpmm, otf.reshape(-1, count, len(frequency_lpmm)),
    )  # fmt: skip
    return otf


def sensor_mtf(
    lens: Lens,
    grid: Grid,
    frequency_lpmm: ArrayLike,
    azimuth_rad: ArrayLike = AZIMUTHS_RAD,
    *,
    build: Build | None = None,
    band: Band | None = None,
    rings: int | None = None,
) -> Floats:
    """Return the fast MTF at every pixel of a sensor, [row col azimuth frequency].

    Traced at up to 65 places along each axis, linear between them: within 0.006 for `wide_940` and
    320 x 240 pixels, 0.02 where light is cut off in between.

    Parameters
    ----------
    grid : of the sensor, centred on the axis
    frequency_lpmm, azimuth_rad, build, band, rings : as for `fast_mtf`
    """
    near_mm = 1e-2 * min(grid.pitch_mm)  # the MTF changes slowly
    rows, cols = (np.linspace(0.0, n - 1.0, min(n, _MOST_PLACES)) for n in grid.shape)
    fields = fields_for_image(lens, places_mm(grid, rows, cols), tolerance_mm=near_mm)
    found = [  # row by row: many places at once leave few rays to each
        fast_mtf(lens, row, frequency_lpmm, azimuth_rad, build=build, band=band, rings=rings)
        for row in fields
    ]
    down, across = (
        np.stack([np.interp(np.arange(n), at, one) for one in np.eye(len(at))], axis=-1)
        for n, at in zip(grid.shape, (rows, cols), strict=True)
    )
    return np.asarray(np.einsum("rn,cm,nm...->rc...", down, across, np.stack(found), optimize=True))


def pixel_centres_mm(grid: Grid) -> Floats:
    """Return the pixel centres [row col 2] (row, col) of a sensor that is centred on the axis."""
    return places_mm(grid, *(np.arange(count, dtype=np.float64) for count in grid.shape))
