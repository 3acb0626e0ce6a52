"""Refractive indices of the glasses: Sellmeier dispersion and its change with temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

REFERENCE_TEMPERATURE_C = 20.0
AIR = "air"


@dataclass(frozen=True, slots=True)
class Glass:
    """The constants of one glass, for indices relative to air.

    Parameters
    ----------
    b, c_um2 : three Sellmeier terms each, at 1013 hPa, wavelength in um
    thermal : (D0, D1, D2, E0, E1, lambda_TK) of Schott's formula in its usual units
    reference_c : temperature at which the Sellmeier terms were measured
    range_nm : wavelengths for which the constants hold
    source : where they were published
    """

    b: tuple[float, float, float]
    c_um2: tuple[float, float, float]
    thermal: tuple[float, float, float, float, float, float]
    reference_c: float
    range_nm: tuple[float, float]
    source: str


GLASSES = {
    "N-BK7": Glass(
        b=(1.03961212, 0.231792344, 1.01046945),
        c_um2=(0.00600069867, 0.0200179144, 103.560653),
        thermal=(1.86e-6, 1.31e-8, -1.37e-11, 4.34e-7, 6.27e-10, 0.170),
        reference_c=20.0,
        range_nm=(300.0, 2500.0),
        source="SCHOTT data sheet N-BK7",
    ),
    "N-SF11": Glass(
        b=(1.73759695, 0.313747346, 1.89878101),
        c_um2=(0.013188707, 0.0623068142, 155.23629),
        thermal=(-3.56e-6, 9.20e-9, -2.10e-11, 9.65e-7, 1.44e-9, 0.294),
        reference_c=20.0,
        range_nm=(370.0, 2500.0),
        source="SCHOTT data sheet N-SF11",
    ),
    "L-BAL35": Glass(
        b=(1.1626263, 0.325661051, 1.35132486),
        c_um2=(0.0125957437, -0.0032691105, 119.214596),
        thermal=(5.03e-6, 1.22e-8, -3.81e-11, 4.93e-7, 5.76e-10, 0.160),
        reference_c=25.0,
        range_nm=(300.0, 2400.0),
        source="OHARA data sheet L-BAL35",
    ),
    "fused silica": Glass(
        b=(0.6961663, 0.4079426, 0.8974794),
        c_um2=(0.0684043**2, 0.1162414**2, 9.896161**2),
        thermal=(2.06e-5, 2.51e-8, -2.47e-11, 3.12e-7, 4.22e-10, 0.160),
        reference_c=20.0,
        range_nm=(210.0, 3710.0),
        source="Malitson, J. Opt. Soc. Am. 55 (1965) 1205; thermal: SCHOTT data sheet LITHOSIL-Q",
    ),
}


_OTHER_NAMES = {
    "F_SILICA": "fused silica",
    "FUSED SILICA": "fused silica",
    "SILICA": "fused silica",
    "UVFS": "fused silica",
}


def glass_names() -> tuple[str, ...]:
    """Return the names that `refractive_index` knows."""
    return (AIR, *GLASSES)


def glass_called(name: str) -> str | None:
    """Return the glass that design programs call `name`, or None if it is not known."""
    glass = _OTHER_NAMES.get(name.upper(), name.upper())
    return glass if glass in GLASSES else None


def refractive_index(
    glass: str, wavelength_nm: float, temperature_c: float = REFERENCE_TEMPERATURE_C
) -> float:
    """Return the index of a glass relative to air of the same temperature, at 1013 hPa.

        n^2 = 1 + sum_i B_i lambda^2 / (lambda^2 - C_i)
        n(T) = (n n_air + dn) / n_air(T)
        dn = (n^2 - 1)/(2 n) [D0 t + D1 t^2 + D2 t^3 + (E0 t + E1 t^2)/(lambda^2 - lambda_TK^2)]

    with t = T - T0, n and n_air at the temperature T0 at which the glass was measured, and dn the
    change of the index relative to vacuum. Air itself has index 1.

    Parameters
    ----------
    glass : a name of `glass_names()`
    wavelength_nm : in air
    temperature_c : degrees Celsius

    Raises
    ------
    ValueError
        If the glass is unknown or the wavelength is outside the range of its constants.

    Source: SCHOTT TIE-19, Temperature Coefficient of the Refractive Index (2008); TIE-29.
    """
    if glass == AIR:
        return 1.0
    if glass not in GLASSES:
        raise ValueError(f"expected a glass of {', '.join(glass_names())}, got {glass!r}")
    data = GLASSES[glass]
    if not data.range_nm[0] <= wavelength_nm <= data.range_nm[1]:
        raise ValueError(
            f"expected a wavelength from {data.range_nm[0]:g} to {data.range_nm[1]:g} nm for "
            f"{glass}, got {wavelength_nm} nm"
        )
    index = _sellmeier(data, wavelength_nm)
    absolute = index * air_index(wavelength_nm, data.reference_c)
    absolute += _thermal_change(data, index, wavelength_nm, temperature_c)
    return absolute / air_index(wavelength_nm, temperature_c)


def air_index(wavelength_nm: float, temperature_c: float) -> float:
    """Return the index of dry air at 1013 hPa relative to vacuum.

        n(15 C) - 1 = 1e-8 [6432.8 + 2949810 s/(146 s - 1) + 25540 s/(41 s - 1)],  s = lambda^2
        n(T) - 1 = (n(15 C) - 1) / (1 + 3.4785e-3 (T - 15))

    with the wavelength in um and the temperature in degrees Celsius.

    Source: Kohlrausch, Praktische Physik 1 (1968) 408, as quoted in SCHOTT TIE-19.
    """
    square = (wavelength_nm * 1e-3) ** 2
    refractivity = 1e-8 * (
        6432.8
        + 2_949_810.0 * square / (146.0 * square - 1.0)
        + 25_540.0 * square / (41.0 * square - 1.0)
    )
    return 1.0 + refractivity / (1.0 + 3.4785e-3 * (temperature_c - 15.0))


def _sellmeier(data: Glass, wavelength_nm: float) -> float:
    square = (wavelength_nm * 1e-3) ** 2
    terms = (b * square / (square - c) for b, c in zip(data.b, data.c_um2, strict=True))
    return float(np.sqrt(1.0 + sum(terms)))


def _thermal_change(data: Glass, index: float, wavelength_nm: float, temperature_c: float) -> float:
    d0, d1, d2, e0, e1, resonance_um = data.thermal
    t = temperature_c - data.reference_c
    square = (wavelength_nm * 1e-3) ** 2
    bracket = d0 * t + d1 * t**2 + d2 * t**3 + (e0 * t + e1 * t**2) / (square - resonance_um**2)
    return (index**2 - 1.0) / (2.0 * index) * bracket
