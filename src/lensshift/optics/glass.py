"""Refractive indices of glasses, crystals and plastics, and their change with temperature."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources

import numpy as np

from lensshift.core.errors import warn_quality

REFERENCE_TEMPERATURE_C = 20.0  # of most catalogues
AIR = "air"

D_UM, F_UM, C_UM, _G_UM = 0.5875618, 0.4861327, 0.6562725, 0.4358343
_MODEL_RANGE_NM = (350.0, 2000.0)  # about the visible; beyond 1 um it is a guess
_LARGEST_ABBE = 100.0  # of a glass; more is written for an index that does not change
BY_CODE = "index and Abbe number"  # all that is known of a glass
# Fast cooling leaves an index that is lower, by nearly the same at all wavelengths: of 57 glasses
# whose makers state it 0.001 to 0.010, half of them 0.0030 to 0.0052.
_MOULDED, _USUALLY_LOWER = ("_MOLD", "(M)", "M"), 0.0044
AS_USUAL = f"moulded: index lower by {_USUALLY_LOWER}, as usual"
_SAME_INDEX, _OTHER_INDEX = 1e-5, 1e-3  # rounding; more than from melt to melt
SAID = 3  # glasses that a warning names
NO_CHANGE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

# Exponents of the wavelength in the polynomials for n^2.
_POWERS = {
    "schott": (0, 2, -2, -4, -6, -8),
    "extended": (0, 2, -2, -4, -6, -8, -10, -12),
    "extended 2": (0, 2, -2, -4, -6, -8, 4, 6),
    "extended 3": (0, 2, 4, -2, -4, -6, -8, -10, -12),
}
# n^2 of other formulas, of constants and squared wavelength.
_SQUARES: dict[str, Callable[[tuple[float, ...], float], float]] = {
    "sellmeier 2": lambda k, s: 1.0 + k[0] + k[1] * s / (s - k[2] ** 2) + k[3] / (s - k[4] ** 2),
    "sellmeier 4": lambda k, s: k[0] + k[1] * s / (s - k[2]) + k[3] * s / (s - k[4]),
    "handbook 1": lambda k, s: k[0] + k[1] / (s - k[2]) - k[3] * s,
    "handbook 2": lambda k, s: k[0] + k[1] * s / (s - k[2]) - k[3] * s,
}
CONSTANT_COUNTS = {name: len(powers) for name, powers in _POWERS.items()} | {
    "sellmeier 1": 6, "sellmeier 2": 5, "sellmeier 3": 8, "sellmeier 4": 5, "sellmeier 5": 10,
    "herzberger": 6, "conrady": 3, "handbook 1": 4, "handbook 2": 4,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Glass:
    """The constants of one glass, for indices relative to air, wavelengths in um.

    Parameters
    ----------
    formula : "sellmeier 1" to "sellmeier 5", "schott", "extended", "extended 2", "extended 3",
        "herzberger", "conrady", "handbook 1" or "handbook 2", as named in AGF catalogues
    constants : in the order of those catalogues; missing ones are 0
    thermal : (D0, D1, D2, E0, E1, lambda_TK) of Schott's formula in its usual units
    reference_c : temperature at which the constants were measured
    range_nm : wavelengths for which the constants hold
    source : where they were published
    lower_by : what its index is lower than by the formula, since it was moulded

    Raises
    ------
    ValueError
        If the formula is unknown, has fewer constants, or a number is not finite.
    """

    formula: str
    constants: tuple[float, ...]
    thermal: tuple[float, ...] = NO_CHANGE
    reference_c: float = REFERENCE_TEMPERATURE_C
    range_nm: tuple[float, float] = _MODEL_RANGE_NM
    source: str = ""
    lower_by: float = 0.0

    def __post_init__(self) -> None:
        if self.formula not in CONSTANT_COUNTS:
            raise ValueError(
                f"expected a formula of {', '.join(CONSTANT_COUNTS)}, got {self.formula!r}"
            )
        if not 1 <= len(self.constants) <= CONSTANT_COUNTS[self.formula] or len(self.thermal) != 6:
            raise ValueError(
                f"expected up to {CONSTANT_COUNTS[self.formula]} constants and 6 thermal ones, got "
                f"{len(self.constants)} and {len(self.thermal)}"
            )
        numbers = (*self.constants, *self.thermal, self.reference_c, *self.range_nm, self.lower_by)
        if not np.all(np.isfinite(numbers)) or not 0 < self.range_nm[0] < self.range_nm[1]:
            raise ValueError(f"expected finite constants and a range of wavelengths, got {numbers}")


GLASSES = ("N-BK7", "N-SF11", "L-BAL35", "fused silica")  # the first to think of
_SILICA = Glass(
    "sellmeier 1",
    (0.6961663, 0.0684043**2, 0.4079426, 0.1162414**2, 0.8974794, 9.896161**2),
    (2.06e-5, 2.51e-8, -2.47e-11, 3.12e-7, 4.22e-10, 0.160),
    range_nm=(210.0, 3710.0),
    source="Malitson, J. Opt. Soc. Am. 55 (1965) 1205; thermal: SCHOTT data sheet LITHOSIL-Q",
)

_added: dict[str, Glass] = {}


@lru_cache(maxsize=1)
def _shipped() -> dict[str, Glass]:
    from lensshift.optics.agf import parse_agf

    known = parse_agf(lines_of("glasses.agf")) | {"fused silica": _SILICA}
    for name, *numbers in map(str.split, lines_of("glass_codes.txt").splitlines()):
        index_d, abbe = map(float, numbers)
        if (solid := known.get(_unmoulded(name))) is None:
            known[name] = _model(f"model:{index_d!r}:{abbe!r}:0")
        else:
            lower_by = index_of(solid, D_UM) - index_d
            source = f"{_unmoulded(name)}, moulded"
            known[name] = replace(solid, lower_by=lower_by, source=source)
    return known


def lines_of(file: str) -> str:
    """Return the lines of a file of the package that are no comments."""
    text = (resources.files("lensshift.optics") / file).read_text(encoding="utf-8")
    return re.sub("#.*\n", "", text)


def _unmoulded(name: str) -> str:
    """Return the name of the glass that a moulded one was made from; "" for others."""
    return re.sub(r"(_MOLD|_M|\(M\)|M)?$", "", name) if name.endswith(_MOULDED) else ""


@lru_cache(maxsize=256)
def _moulded(name: str) -> Glass | None:
    """Return the known glass that was moulded, if no more of it is known than that."""
    solid = _shipped().get(_unmoulded(name))
    return solid and replace(solid, lower_by=_USUALLY_LOWER, source=AS_USUAL)


def add_glasses(glasses: dict[str, Glass], *, behind: bool = False) -> None:
    """Make glasses known by their names, in upper case.

    Those of the package keep their constants where these give the same index.

    Parameters
    ----------
    behind : whether names of `add_glasses` before keep the glass they have

    Raises
    ------
    ValueError
        If a name is one of `add_glasses` before, with other constants, and not `behind`.

    Warns
    -----
    QualityWarning
        If a name is that of another glass of the package, which it replaces, or of one before.
    """
    replaced, left = [], []
    for name, glass in glasses.items():
        known = _added.get(name)
        if known is not None:
            if known != glass and not behind:
                raise ValueError(
                    f"expected one set of constants for glass {name}, got two: give it another name"
                )
            left += [name] if _apart(glass, known) > _OTHER_INDEX else []
            continue
        shipped = _shipped().get(name)
        if shipped is None or shipped.source.startswith(BY_CODE):
            _added[name] = glass
        elif (apart := _apart(glass, shipped)) > _SAME_INDEX:
            _added[name] = glass
            replaced += [name] if apart > _OTHER_INDEX else []
    for names, told in (
        (replaced, "taken as given, which is another glass than that of this name in the package"),
        (left, "left out, as another glass of this name was loaded before"),
    ):
        if names:
            more = f" and {len(names) - SAID} more" if len(names) > SAID else ""
            warn_quality(f"{', '.join(names[:SAID])}{more}: {told}")


def _apart(one: Glass, other: Glass) -> float:
    """Return the largest difference of two indices in light for which both are known."""
    low_nm = max(one.range_nm[0], other.range_nm[0])
    high_nm = min(one.range_nm[1], other.range_nm[1])
    if low_nm > high_nm:
        return np.inf
    light_um = 1e-3 * np.linspace(low_nm, high_nm, 9)
    return max(abs(index_of(one, um) - index_of(other, um)) for um in light_um)


def glass_names() -> tuple[str, ...]:
    """Return the names that `refractive_index` knows."""
    return tuple(dict.fromkeys((AIR, *GLASSES, *_shipped(), *_added)))


def is_shipped(name: str) -> bool:
    """Tell whether a glass comes with the package or says itself what it is."""
    if name in _added:
        return False
    return name.startswith("model:") or name in _shipped() or _moulded(name) is not None


def is_known(name: str) -> bool:
    """Tell whether `glass_data` knows a glass."""
    return name in _added or is_shipped(name)


def holds(name: str, wavelength_nm: float) -> bool:
    """Tell whether the constants of a glass hold for the light."""
    low_nm, high_nm = glass_data(name).range_nm
    return low_nm <= wavelength_nm <= high_nm


def model_glass(index_d: float, abbe: float, partial: float = 0.0) -> str:
    """Return the name of a glass that is known by two or three numbers only.

    Parameters
    ----------
    index_d : n_d, at 587.6 nm
    abbe : (n_d - 1) / (n_F - n_C)
    partial : departure of (n_g - n_F) / (n_F - n_C) from the line 0.6438 - 0.001682 abbe

    Raises
    ------
    ValueError
        If the index is not above 1, or the Abbe number not positive.

    Source of the line: SCHOTT TIE-29, Refractive Index and Dispersion (2016).
    """
    name = f"model:{index_d!r}:{abbe!r}:{partial!r}"
    glass_data(name)
    return name


def glass_data(name: str) -> Glass:
    """Return the constants of a glass.

    Raises
    ------
    ValueError
        If the glass is unknown.
    """
    if name.startswith("model:"):
        return _model(name)
    found = _added.get(name) or _shipped().get(name) or _moulded(name)
    if found is None:
        from difflib import get_close_matches

        near = get_close_matches(name.upper(), glass_names(), 4, 0.5) or list(GLASSES)
        raise ValueError(
            f"expected a known glass, such as {', '.join(near)}, got {name!r}; "
            "a catalogue of its maker (.agf) can be loaded"
        )
    return found


@lru_cache(maxsize=1024)
def _model(name: str) -> Glass:
    """Return the Conrady constants that give a model glass its indices at d, F - C and g - F."""
    try:
        index_d, abbe, partial = (float(word) for word in name.split(":")[1:])
    except ValueError as error:
        raise ValueError(f"expected a glass like model:1.5168:64.17:0, got {name!r}") from error
    if not (1.0 < index_d < 5.0 and 0 < abbe < 1e6 and abs(partial) < 1.0):
        raise ValueError(f"expected an index above 1 and an Abbe number above 0, got {name!r}")
    still = abbe > _LARGEST_ABBE  # the same index in all light
    width = 0.0 if still else (index_d - 1.0) / abbe
    um = np.array([D_UM, F_UM, C_UM, _G_UM])
    terms = np.stack([np.ones(4), 1.0 / um, um**-3.5], axis=-1)
    ratio = 0.6438 - 0.001682 * abbe + partial
    system = np.stack([terms[0], terms[1] - terms[2], terms[3] - terms[1]])
    constants = np.linalg.solve(system, [index_d, width, ratio * width])
    span_nm = (100.0, 1e6) if still else _MODEL_RANGE_NM
    return Glass("conrady", tuple(map(float, constants)), range_nm=span_nm, source=BY_CODE)


def refractive_index(
    glass: str, wavelength_nm: float, temperature_c: float = REFERENCE_TEMPERATURE_C
) -> float:
    """Return the index of a glass relative to air of the same temperature, at 1013 hPa.

        n^2 = 1 + sum_i B_i lambda^2 / (lambda^2 - C_i), or another formula of `Glass`
        n(T) = (n n_air + dn) / n_air(T)
        dn = (n^2 - 1)/(2 n) [D0 t + D1 t^2 + D2 t^3 + (E0 t + E1 t^2)/(lambda^2 - lambda_TK^2)]

    with t = T - T0, n and n_air at the temperature T0 at which the glass was measured, and dn the
    change of the index relative to vacuum. Air itself has index 1; glasses whose thermal constants
    are not known keep their index.

    Parameters
    ----------
    glass : a name of `glass_names()` or of `model_glass`
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
    data = glass_data(glass)
    if not holds(glass, wavelength_nm):
        raise ValueError(
            f"expected a wavelength from {data.range_nm[0]:g} to {data.range_nm[1]:g} nm for "
            f"{glass}, got {wavelength_nm} nm"
        )
    um = wavelength_nm * 1e-3
    index = index_of(data, um)
    if data.thermal == NO_CHANGE:
        return index
    d0, d1, d2, e0, e1, resonance_um = data.thermal
    t = temperature_c - data.reference_c
    bracket = d0 * t + d1 * t**2 + d2 * t**3 + (e0 * t + e1 * t**2) / (um**2 - resonance_um**2)
    absolute = index * air_index(wavelength_nm, data.reference_c)
    absolute += (index**2 - 1.0) / (2.0 * index) * bracket
    return absolute / air_index(wavelength_nm, temperature_c)


def air_index(wavelength_nm: float, temperature_c: float) -> float:
    """Return the index of dry air at 1013 hPa relative to vacuum.

        n(15 C) - 1 = 1e-8 [6432.8 + 2949810 s/(146 s - 1) + 25540 s/(41 s - 1)],  s = lambda^2
        n(T) - 1 = (n(15 C) - 1) / (1 + 3.4785e-3 (T - 15))

    with the wavelength in um and the temperature in degrees Celsius.

    Source: Kohlrausch, Praktische Physik 1 (1968) 408, as quoted in SCHOTT TIE-19.
    """
    s = (wavelength_nm * 1e-3) ** 2
    sum_of_poles = 6432.8 + 2_949_810.0 * s / (146.0 * s - 1.0) + 25_540.0 * s / (41.0 * s - 1.0)
    return 1.0 + 1e-8 * sum_of_poles / (1.0 + 3.4785e-3 * (temperature_c - 15.0))


def index_of(data: Glass, um: float) -> float:
    """Return the index at the temperature of the constants."""
    return _of_formula(data, um) - data.lower_by


def _of_formula(data: Glass, um: float) -> float:
    """Return what the formula gives.

    Source: the formulas of AGF catalogues as the maker of that format documents them.
    """
    k = (*data.constants, *[0.0] * (CONSTANT_COUNTS[data.formula] - len(data.constants)))
    square = um * um
    if data.formula in _POWERS:
        value = sum(a * um**power for a, power in zip(k, _POWERS[data.formula], strict=True))
    elif data.formula in ("sellmeier 1", "sellmeier 3", "sellmeier 5"):
        value = 1.0 + sum(b * square / (square - c) for b, c in zip(k[::2], k[1::2], strict=True))
    elif data.formula in _SQUARES:
        value = _SQUARES[data.formula](k, square)
    elif data.formula == "conrady":
        return float(k[0] + k[1] / um + k[2] / um**3.5)
    else:
        pole = 1.0 / (square - 0.028)
        terms = (1, pole, pole**2, square, square**2, square**3)
        return float(sum(a * b for a, b in zip(k, terms, strict=True)))
    if not value > 0:
        raise ValueError(f"expected constants that give an index, got n^2 = {value:g} at {um} um")
    return float(np.sqrt(value))
