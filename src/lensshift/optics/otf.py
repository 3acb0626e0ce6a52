"""The exact OTF of one field: autocorrelation of the pupil in direction cosines."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebvander
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.linear_algebra import one_thread
from lensshift.core.optical import MtfCurve
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import AZIMUTHS_RAD, Band, azimuth_axes, light_of
from lensshift.optics.pupil import midpoints, pupil_quadrature
from lensshift.optics.spots import Spots, spots_of_rays
from lensshift.optics.trace import Build, RayBundle, trace

_RINGS, _ARMS = 12, 48
_DEGREE = 12  # of the polynomials in the direction cosines
_MARGIN = 1.02  # of the square that holds the pupil
_BEYOND = 1.03  # of the outermost ray, where the pupil ends at the latest
_LOST = 0.02  # of the light: more that the fit gets wrong is told
_SAMPLES = 128  # within 1e-3 of 400 (tests)
_BLOCK = 16  # rows of the pupil at once, so that they stay in the cache


def exact_mtf(
    lens: Lens,
    field_tan: ArrayLike,
    frequency_lpmm: ArrayLike,
    azimuth_rad: float = 0.0,
    *,
    build: Build | None = None,
    band: Band | None = None,
    label: str = "",
) -> MtfCurve:
    """Return the MTF of one field: the modulus of `exact_otf`."""
    frequency = np.atleast_1d(np.asarray(frequency_lpmm, dtype=np.float64))
    otf = exact_otf(lens, field_tan, frequency, azimuth_rad, build=build, band=band)
    return MtfCurve(frequency, np.abs(otf[0]), label=label)


def diffraction_limit(
    lens: Lens,
    frequency_lpmm: ArrayLike,
    field_tan: ArrayLike = (0.0, 0.0),
    azimuth_rad: float = 0.0,
    *,
    band: Band | None = None,
) -> MtfCurve:
    """Return the MTF that a field, or the axis, would have if all paths were equal.

        limit(f) = integral A(u + s/2) A(u - s/2) du / integral A(u)^2 du >= |OTF(f)|

    with the pupil A of `exact_otf`: its edge is where rays end, not where the paraxial f-number
    says, and a lens that does not obey the sine condition has more light at the edge, or less.
    Where it does, a round pupil has `diffraction_mtf`.

    Parameters
    ----------
    field_tan, frequency_lpmm, azimuth_rad, band : as for `exact_mtf`
    """
    frequency = np.atleast_1d(np.asarray(frequency_lpmm, dtype=np.float64))
    light, axes = pupils(lens, field_tan, band=band), azimuth_axes(azimuth_rad)
    limit = sum(
        share * _autocorrelate(pupil, frequency, axes, wave_mm, equal_paths=True)[0].real
        for share, wave_mm, pupil in light
    )
    return MtfCurve(frequency, np.asarray(limit), label="diffraction limit")


@one_thread()
def exact_otf(
    lens: Lens,
    field_tan: ArrayLike,
    frequency_lpmm: ArrayLike,
    azimuth_rad: ArrayLike = AZIMUTHS_RAD,
    *,
    build: Build | None = None,
    band: Band | None = None,
    samples: int = _SAMPLES,
) -> NDArray[np.complex128]:
    """Return the complex OTF of one field about the centroid of its light, [azimuth frequency].

        OTF(f) = integral A(u + s/2) A(u - s/2) exp(2 pi i [W(u + s/2) - W(u - s/2)] / lambda) du
                 / integral A(u)^2 du,    s = lambda f

    over the direction cosines u at the sensor. W is the path of the plane wave of direction u at
    the centroid. A^2 is the area of the stop per du, which conserves the energy between rays, where
    the ray passes stop and surfaces, else 0. All come from polynomials fitted to traced rays. No
    exit pupil is needed, so decentred elements change nothing.

    Parameters
    ----------
    field_tan : [2] (row, col)
    frequency_lpmm : [frequency]
    azimuth_rad : [azimuth] direction in which the pattern repeats: 0 along columns, pi/2 along
        rows
    build : as for `trace`, without leading axes
    band : the light; the design wavelength alone by default
    samples : of the pupil along each axis

    Raises
    ------
    ValueError
        If several fields are given, or as in `spots`.

    Warns
    -----
    QualityWarning
        If the fitted pupil passes 2 % of the light more or less than the rays.

    Source: Hopkins, Proc. Phys. Soc. B 70 (1957) 449.
    """
    frequency = np.atleast_1d(np.asarray(frequency_lpmm, dtype=np.float64))
    axes = azimuth_axes(azimuth_rad)
    otf = np.zeros((len(axes), len(frequency)), dtype=np.complex128)
    for share, wave_mm, pupil in pupils(lens, field_tan, build=build, band=band):
        otf += share * _autocorrelate(pupil, frequency, axes, wave_mm, samples)
    return otf


def pupils(
    lens: Lens, field_tan: ArrayLike, *, build: Build | None = None, band: Band | None = None
) -> list[tuple[float, float, PupilFit]]:
    """Return the share of the light, the wavelength in mm and the pupil of each wavelength.

    Parameters
    ----------
    field_tan : [2] (row, col)
    build, band : as for `exact_otf`

    Raises
    ------
    ValueError
        If several fields are given, or as in `spots`.
    """
    light = light_of(band, lens.wavelength_nm)
    points, weight = pupil_quadrature(_RINGS, _ARMS)
    traced = []
    for nm, _ in light:
        rays = trace(lens, field_tan, points, build=build, wavelength_nm=nm, heights=True)
        if rays.path_mm.ndim != 1:
            raise ValueError(f"expected one field and one build, got {rays.path_mm.shape[:-1]}")
        traced.append((rays, spots_of_rays(lens, field_tan, rays, weight)))
    share = np.array([w * s.transmission for (_, w), (_, s) in zip(light, traced, strict=True)])
    share = share / share.sum()
    centre = share @ np.stack([spot.centroid_mm for _, spot in traced])
    return [
        (float(part), 1e-6 * nm, _fit(lens, rays, spot, points, weight, centre))
        for part, (nm, _), (rays, spot) in zip(share, light, traced, strict=True)
    ]


def pupils_of_fields(
    lens: Lens, field_tan: Floats, *, build: Build | None = None
) -> list[PupilFit]:
    """Return the pupils of fields [field 2] at the design wavelength, traced together.

    Each about the centroid of its own light; `build` and errors as for `pupils`.
    """
    points, weight = pupil_quadrature(_RINGS, _ARMS)
    rays = trace(lens, field_tan, points, build=build, heights=True)
    spot = spots_of_rays(lens, field_tan, rays, weight)
    return [
        _fit(lens, _one_of(rays, n), _one_of(spot, n), points, weight, spot.centroid_mm[n])
        for n in range(len(field_tan))
    ]


def _one_of(several: Any, number: int) -> Any:
    """Return rays or spots of one field."""
    parts = ((one.name, getattr(several, one.name)) for one in fields(several))
    return replace(several, **{name: None if p is None else p[number] for name, p in parts})


@dataclass(frozen=True, slots=True, eq=False)
class PupilFit:
    """Polynomials over the pupil in direction cosines, about their middle.

    Parameters
    ----------
    span : scales the cosines to the unit square
    terms : [quantity i j] Chebyshev coefficients of what `overlap_sum` takes: path, derivatives of
        the two pupil coordinates, the coordinates, the squared heights at vignetting surfaces, how
        near the outermost ray is, squared
    reach_mm : distance of the outermost ray from the centroid
    light : share of the light through the stop that arrives
    unsure : by how much rays may misjudge that: half a ring of them at an obstruction
    """

    span: float
    terms: Floats
    reach_mm: float
    light: float
    unsure: float = 0.0

    def waves(self, samples: int, wave: float) -> tuple[Floats, NDArray[np.complex128], float]:
        """Return cosines [sample] along each axis, the wave [row col] there, and its energy.

        Parameters
        ----------
        samples : along each axis
        wave : 2 pi / wavelength
        """
        along = midpoints(samples)
        found, energy = self.waves_at(along, along, 2.0 / samples, wave)
        return self.span * along, found, energy

    def waves_at(
        self, row: Floats, col: Floats, step: float, wave: float
    ) -> tuple[NDArray[np.complex128], float]:
        """Return the wave [row col] at scaled cosines [row], [col] about `step` apart, and energy.

        Parameters
        ----------
        wave : as for `waves`
        """
        from lensshift.optics.otf_kernel import pupil_wave

        down, across = chebvander(row, _DEGREE), chebvander(col, _DEGREE)
        found = np.empty((len(row), len(col)), dtype=np.complex128)
        energy = 0.0
        for first in range(0, len(row), _BLOCK):
            rows = slice(first, first + _BLOCK)
            energy += pupil_wave(down[rows] @ self.terms @ across.T, step, wave, found[rows])
        return found, energy

    def overlap(self, shift: Floats, samples: int, wave: float) -> complex:
        """Return the sum over the pupil moved by `shift` one way and the other.

        Parameters
        ----------
        shift : [2] (row, col), scaled
        samples, wave : as for `waves`
        """
        from lensshift.optics.otf_kernel import overlap_sum

        sides = [
            [chebvander(midpoints(samples) + sign * s, _DEGREE) for s in shift]
            for sign in (1.0, -1.0)
        ]
        total = 0j
        for first in range(0, samples, _BLOCK):
            rows = slice(first, first + _BLOCK)
            ahead, behind = (row[rows] @ self.terms @ col.T for row, col in sides)
            total += overlap_sum(ahead, behind, 2.0 / samples, wave)
        return total


def _fit(
    lens: Lens, rays: RayBundle, spot: Spots, points: Floats, weight: Floats, centre_mm: Floats
) -> PupilFit:
    from scipy.linalg import lstsq

    traced = np.isfinite(rays.path_mm)  # vignetted rays too: their paths are smooth
    cosine = rays.direction[traced, :2]
    away_mm = centre_mm - rays.position_mm[traced]
    path = rays.path_mm[traced] + np.einsum("rc,rc->r", away_mm, cosine)
    middle = 0.5 * (cosine.max(axis=0) + cosine.min(axis=0))
    radius = _MARGIN * float(np.abs(cosine - middle).max())
    quantities = [path - path.mean(), points[traced, 0], points[traced, 1]]
    if rays.heights is not None:
        squares = rays.heights[traced] ** 2
        quantities += [square for square in squares.T if square.max() > 0.98]
        inner = [one.inner_mm / one.semi_diameter_mm for one in lens.surfaces]
        # Below 1 beyond the inner edge, with the slope that the outer one has at the pupil's edge.
        quantities += [
            1.0 - (square - share**2) / share
            for square, share in zip(squares.T, inner, strict=True)
            if share and square.min() < (1.02 * share) ** 2
        ]
    quantities.append(_nearness(cosine))
    scaled = (cosine - middle) / radius
    first, second = np.meshgrid(range(_DEGREE + 1), range(_DEGREE + 1), indexing="ij")
    used = first + second <= _DEGREE
    row, col = (chebvander(x, _DEGREE) for x in scaled.T)
    design = row[:, first[used]] * col[:, second[used]]
    root = np.sqrt(weight[traced])[:, None]
    values = np.stack(quantities, axis=-1)
    # By QR, in a third of the time.
    solved = lstsq(design * root, values * root, lapack_driver="gelsy")[0]
    terms = np.zeros((len(quantities), _DEGREE + 1, _DEGREE + 1))
    terms[:, first[used], second[used]] = solved.T
    slopes = np.zeros((4, _DEGREE + 1, _DEGREE + 1))
    slopes[0::2, :-1] = chebder(terms[1:3], axis=1)
    slopes[1::2, :, :-1] = chebder(terms[1:3], axis=2)
    reach_mm = float(np.linalg.norm(spot.ray_mm[rays.passed], axis=-1).max())
    light = float(spot.transmission)
    terms = np.concatenate([terms[:1], slopes, terms[1:]])
    hidden = any(one.inner_mm for one in lens.surfaces)
    return PupilFit(radius, terms, reach_mm, light, 0.5 * _ARMS * weight.max() * hidden)


def _nearness(cosine: Floats) -> Floats:
    """Return (v / v_bound)^2 with v^2 = u C^-1 u, C the covariance of the cosines, [ray].

    Beyond the outermost ray polynomials may lead back into the pupil, where there is no light.
    """
    away = cosine - cosine.mean(axis=0)
    square = np.einsum("ri,ij,rj->r", away, np.linalg.inv(np.cov(away.T)), away)
    return np.asarray(square / (square.max() * _BEYOND**2))


def _autocorrelate(
    pupil: PupilFit,
    frequency_lpmm: Floats,
    axes: Floats,
    wavelength_mm: float,
    samples: int = _SAMPLES,
    *,
    equal_paths: bool = False,
) -> NDArray[np.complex128]:
    """Return the OTF [azimuth frequency] along axes [azimuth 2] (row, col)."""
    wave = 0.0 if equal_paths else 2.0 * np.pi / wavelength_mm
    total = pupil.overlap(np.zeros(2), samples, wave).real
    light = total * (2.0 / samples) ** 2 / np.pi
    if abs(light - pupil.light) > _LOST + pupil.unsure:
        warn_quality(
            f"the pupil of the OTF passes {100 * light:.1f} % of the light through the stop, rays "
            f"{100 * pupil.light:.1f} %: it ends where polynomials cannot tell",
            stacklevel=3,
        )
    shears = 0.5 * wavelength_mm / pupil.span * np.multiply.outer(axes, frequency_lpmm)
    return np.array(
        [[pupil.overlap(shift, samples, wave) / total for shift in of_axis.T] for of_axis in shears]
    )
