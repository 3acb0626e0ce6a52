"""What contrast a pixel or a lens can reach at best, and the units its frequency is told in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.optical import MtfCurve

_MM_PER_NM = 1e-6


def pixel_aperture_mtf(
    frequency_lpmm: ArrayLike,
    pitch_mm: float | tuple[float, float],
    *,
    angle_rad: float = 0.0,
    fill_factor: float = 1.0,
) -> Floats:
    """Return the MTF of a rectangular pixel along the normal of an edge.

        MTF(f) = | sinc(a p_col f cos t) sinc(a p_row f sin t) |,   a = sqrt(fill_factor)

    with sinc(x) = sin(pi x) / (pi x). It is zero first at 1 / (a p) along an axis. Super-resolution
    keeps this aperture: for a half pixel pass half the pitch.

    Parameters
    ----------
    frequency_lpmm : [...] along the normal of the edge
    pitch_mm : side of the pixel, or its sides as (row, col)
    angle_rad : of the normal from the col axis, t; 0 is a vertical edge
    fill_factor : sensitive share of the area, centred and of the pixel's own proportions

    Raises
    ------
    ValueError
        If a pitch is not positive or the fill factor not in (0, 1].

    Source: Boreman, Modulation Transfer Function in Optical and Electro-Optical Systems, 2001.
    """
    row_mm, col_mm = pitch_pair_mm(pitch_mm)
    if not 0 < fill_factor <= 1:
        raise ValueError(f"expected a fill factor above 0 and up to 1, got {fill_factor}")
    along = np.sqrt(fill_factor) * np.asarray(frequency_lpmm, dtype=np.float64)
    across_mm = col_mm * np.cos(angle_rad), row_mm * np.sin(angle_rad)
    return np.asarray(np.abs(np.sinc(across_mm[0] * along) * np.sinc(across_mm[1] * along)))


def paper_sensor_limit(frequency_lpmm: ArrayLike, pitch_mm: float) -> Floats:
    """Return the sensor limit as the source paper draws it.

        limit(f) = sinc(p f)^2

    This is the footprint of a pixel times a sampling term, a cautious curve for a whole system. A
    slanted edge on square pixels shows |sinc|: see `pixel_aperture_mtf`. For a half pixel pass half
    the pitch.

    Parameters
    ----------
    frequency_lpmm : [...]
    pitch_mm : side of the pixel

    Raises
    ------
    ValueError
        If the pitch is not positive.
    """
    _check_positive(pitch_mm, "pitch in mm")
    return np.asarray(np.sinc(pitch_mm * np.asarray(frequency_lpmm, dtype=np.float64)) ** 2)


def diffraction_mtf(frequency_lpmm: ArrayLike, wavelength_nm: float, f_number: float) -> Floats:
    """Return the MTF of a perfect lens with a round pupil in incoherent light.

        MTF(f) = (2 / pi) (acos v - v sqrt(1 - v^2)),   v = |f| / cutoff,   0 beyond the cutoff

    Parameters
    ----------
    frequency_lpmm : [...]
    wavelength_nm : of the light
    f_number : focal length / diameter of the pupil (the working one at finite distances)

    Raises
    ------
    ValueError
        If the wavelength or the f-number is not positive.

    Source: Goodman, Introduction to Fourier Optics, section 6.3.
    """
    cutoff_lpmm = diffraction_cutoff_lpmm(wavelength_nm, f_number)
    v = np.minimum(np.abs(np.asarray(frequency_lpmm, dtype=np.float64)) / cutoff_lpmm, 1.0)
    return np.asarray(2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v**2)))


def diffraction_cutoff_lpmm(wavelength_nm: float, f_number: float) -> float:
    """Return the frequency above which a perfect lens shows no contrast, 1 / (wavelength N)."""
    _check_positive(wavelength_nm, "wavelength in nm")
    _check_positive(f_number, "f-number")
    return 1.0 / (wavelength_nm * _MM_PER_NM * f_number)


def first_crossing_lpmm(curve: MtfCurve, level: float) -> float:
    """Return where a curve first falls below a level, such as MTF50 for 0.5.

    Linear between the samples. NaN if the curve never falls below the level, or starts below it.
    """
    return first_fall(curve.frequency_lpmm, curve.modulation - level)


def first_fall(frequency_lpmm: Floats, excess: Floats) -> float:
    """Return where an excess [n] at rising frequencies first falls below 0; NaN as above."""
    below = np.flatnonzero(excess < 0)
    if below.size == 0 or below[0] == 0:
        return float("nan")
    before, after = excess[below[0] - 1 : below[0] + 1]
    start, end = frequency_lpmm[below[0] - 1 : below[0] + 1]
    return float(start + (end - start) * before / (before - after))


def pitch_pair_mm(pitch_mm: float | tuple[float, float]) -> tuple[float, float]:
    """Return a pitch, one or (row, col), as a pair; `ValueError` if one is not positive."""
    pair = (pitch_mm, pitch_mm) if isinstance(pitch_mm, int | float) else tuple(pitch_mm)
    if len(pair) != 2:
        raise ValueError(f"expected a pitch in mm or a pair (row, col), got {pitch_mm}")
    for pitch in pair:
        _check_positive(pitch, "pitch in mm")
    return float(pair[0]), float(pair[1])


def lpmm_to_cycles_per_mrad(frequency_lpmm: ArrayLike, focal_length_mm: float) -> Floats:
    """Convert line pairs per mm on the sensor to cycles per mrad in the scene, f F / 1000."""
    _check_positive(focal_length_mm, "focal length in mm")
    return np.asarray(np.asarray(frequency_lpmm, dtype=np.float64) * focal_length_mm / 1000.0)


def _check_positive(value: float, name: str) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"expected a positive {name}, got {value}")
