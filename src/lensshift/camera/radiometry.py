"""How many electrons a pixel collects."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensshift.camera.settings import PlainOptics, TofCamera
from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.core.units import SPEED_OF_LIGHT_MPS
from lensshift.optics.mtf import diffraction_mtf

_PLANCK_J_S = 6.626_070_15e-34  # by definition
# Of sunlight at 850 nm, in W / (m2 nm klx): about 0.9 W / (m2 nm) at 110 klx.
_SUN_PER_KLX = 0.9 / 110.0


def active_electrons_per_s(camera: TofCamera) -> float:
    """Return the electrons per second that the modulated light gives, per share / m2.

        rate = intensity * Q,    electrons of a pixel = rate * mean of rho cos / d^2
        Q = transmission / (4 F^2) * area * fill factor * efficiency * wavelength / (h c)

    A surface of reflectance rho that light meets at an angle at distance d has the irradiance
    intensity cos / d^2 and scatters rho of it as a Lambertian surface; the image of radiance L
    has the irradiance pi L transmission / (4 F^2). In both taps together.
    """
    return camera.illumination.intensity_w_per_sr * _electrons_per_exitance(camera)


def ambient_electrons_per_s(camera: TofCamera) -> float:
    """Return the electrons per second that sunlight gives a white pixel, 0 without sunlight."""
    if camera.ambient is None:
        return 0.0
    sun = camera.ambient
    irradiance = _SUN_PER_KLX * sun.illuminance_klx * sun.filter_width_nm  # W / m2
    return irradiance * _electrons_per_exitance(camera)


def relative_illumination(
    optics: PlainOptics, grid: Grid, down: ArrayLike, right: ArrayLike
) -> Floats:
    """Return the light from directions [...] over that from the axis.

        cos(field angle)^4 * overlap(s),    s = s at the corner * tan / tan at the corner
        overlap = 2 / pi (acos(s / 2) - s / 2 sqrt(1 - s^2 / 4))

    the common share of two round apertures of radius 1 whose middles are s apart, as in the MTF of
    a perfect lens. It goes with the
    direction, so it moves with the image when lens or sensor move.

    Parameters
    ----------
    grid : of the sensor, whose corners `optics.vignetting` speaks of
    down, right : over forward

    Source: Ray, Applied photographic optics, 3rd edition (2002), chapter 13.
    """
    square = np.square(down) + np.square(right)
    light = (1.0 + square) ** -2.0 if optics.natural_falloff else np.ones(square.shape)
    if optics.vignetting == 0:
        return np.asarray(light)
    from scipy.optimize import brentq

    corner = 0.5 * np.hypot(*np.multiply(grid.shape, grid.pitch_mm)) / optics.focal_length_mm
    apart = brentq(lambda s: 1.0 - optics.vignetting - float(diffraction_mtf(s, 2.0)), 0.0, 2.0)
    return np.asarray(light * diffraction_mtf(apart * np.sqrt(square) / corner, 2.0))


def _electrons_per_exitance(camera: TofCamera) -> float:
    """Return electrons per second for a scene that gives off 1 W / m2 evenly to one side."""
    pixel_m2 = 1e-6 * camera.grid.pitch_mm[0] * camera.grid.pitch_mm[1]
    photon_j = _PLANCK_J_S * SPEED_OF_LIGHT_MPS / (1e-9 * camera.illumination.wavelength_nm)
    collected = camera.optics.transmission / (4.0 * camera.optics.f_number**2)
    area_m2 = pixel_m2 * camera.pixels.fill_factor
    return collected * area_m2 * camera.pixels.quantum_efficiency / photon_j
