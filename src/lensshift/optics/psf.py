"""The image of a point with diffraction, and how much of its light falls into a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import Band
from lensshift.optics.otf import PupilFit, pupils
from lensshift.optics.trace import Build

_LEAST_SAMPLES, _MOST_SAMPLES = 256, 2048  # across the pupil
_MARGIN = 1.2  # copies of the image lie so much farther apart than they are wide
_PER_WAVE = 4.0  # samples of the image per wavelength / (2 sine): twice what intensity needs


@dataclass(frozen=True, slots=True, eq=False)
class PointImage:
    """The image of a point.

    Parameters
    ----------
    per_mm2 : [row col] share of the light per square millimetre; the whole plane sums to 1
    step_mm : from sample to sample; the middle one is the centroid
    """

    per_mm2: Floats
    step_mm: float

    @property
    def at_mm(self) -> Floats:
        """[sample] places along rows and along columns, from the centroid."""
        count = len(self.per_mm2)
        return np.asarray((np.arange(count) - count // 2) * self.step_mm)

    def ensquared(self, side_mm: ArrayLike) -> Floats:
        """Return the share of the light in squares about the centroid, [side]."""
        from scipy.interpolate import CubicSpline

        halves = 0.5 * np.atleast_1d(np.asarray(side_mm, dtype=np.float64))
        halves = np.minimum(halves, self.at_mm[-1])
        over = CubicSpline(self.at_mm, np.eye(len(self.per_mm2)))
        inside = np.stack([over.integrate(-half, half) for half in halves])
        return np.asarray(np.einsum("sr,rc,sc->s", inside, self.per_mm2, inside, optimize=True))


def point_spread(
    lens: Lens,
    field_tan: ArrayLike,
    side_mm: float,
    *,
    build: Build | None = None,
    band: Band | None = None,
) -> PointImage:
    """Return the image of a point in a square about its centroid.

        I(x) = |integral A(u) exp(2 pi i [W(u) + u x] / lambda) du|^2 / (lambda^2 integral A^2 du)

    with the pupil A, W of `exact_otf`, whose Fourier transform this is: the wave optics of all
    rays that arrive, without an exit pupil.

    Parameters
    ----------
    field_tan : [2] (row, col)
    side_mm : of the square
    build, band : as for `exact_otf`

    Raises
    ------
    ValueError
        If the side is not positive, or as in `exact_otf`.

    Warns
    -----
    QualityWarning
        If the spot is too wide for 2048 samples across the pupil.
    """
    if not side_mm > 0:
        raise ValueError(f"expected a positive side_mm, got {side_mm}")
    light = pupils(lens, field_tan, build=build, band=band)
    fine_mm = min(wave_mm / (2.0 * pupil.span) for _, wave_mm, pupil in light) / _PER_WAVE
    half = int(np.ceil(0.5 * side_mm / fine_mm)) + 1
    at_mm = fine_mm * np.arange(-half, half + 1, dtype=np.float64)
    parts = [share * _intensity(pupil, wave_mm, at_mm) for share, wave_mm, pupil in light]
    return PointImage(np.sum(parts, axis=0), fine_mm)


def ensquared_energy(
    lens: Lens,
    field_tan: ArrayLike,
    side_mm: ArrayLike,
    *,
    build: Build | None = None,
    band: Band | None = None,
) -> Floats:
    """Return the share of the light of a point that falls into squares about its centroid, [side].

    Parameters
    ----------
    field_tan : [2] (row, col)
    side_mm : [side]; the pitch for a pixel
    build, band : as for `exact_otf`

    Raises
    ------
    ValueError
        As in `point_spread`.
    """
    found = point_spread(lens, field_tan, float(np.max(side_mm)), build=build, band=band)
    return found.ensquared(side_mm)


def _intensity(pupil: PupilFit, wave_mm: float, at_mm: Floats) -> Floats:
    """Return the share of the light per square millimetre [row col] of one wavelength."""
    apart_mm = at_mm[-1] - at_mm[0] + 2.0 * pupil.reach_mm  # nearer copies would overlap
    wanted = int(np.ceil(_MARGIN * 2.0 * pupil.span * apart_mm / wave_mm))
    samples = int(np.clip(wanted, _LEAST_SAMPLES, _MOST_SAMPLES))
    if wanted > samples:
        warn_quality(
            f"the spot is {2.0 * pupil.reach_mm:.2g} mm wide and needs {wanted} samples across the "
            f"pupil; with {samples} light from its edge is drawn in the wrong place",
            stacklevel=4,
        )
    cosine, wave, energy = pupil.waves(samples, 2.0 * np.pi / wave_mm)
    waves = np.exp(2j * np.pi / wave_mm * np.outer(at_mm, cosine))
    image = waves @ wave @ waves.T
    step = cosine[1] - cosine[0]
    return np.asarray(np.abs(image) ** 2 * (step / wave_mm) ** 2 / energy)
