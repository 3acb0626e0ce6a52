"""Refractive indices of glasses, crystals and plastics, and their change with temperature."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np

REFERENCE_TEMPERATURE_C = 20.0  # of most catalogues
AIR = "air"

D_UM, _F_UM, _C_UM, _G_UM = 0.5875618, 0.4861327, 0.6562725, 0.4358343
_SAME_INDEX = 5e-4  # a usual tolerance of n_d from melt to melt
_MODEL_RANGE_NM = (350.0, 2000.0)  # about the visible; beyond 1 um it is a guess
BY_CODE = "index and Abbe number"  # all that is known of a glass
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
        numbers = (*self.constants, *self.thermal, self.reference_c, *self.range_nm)
        if not np.all(np.isfinite(numbers)) or not 0 < self.range_nm[0] < self.range_nm[1]:
            raise ValueError(f"expected finite constants and a range of wavelengths, got {numbers}")


GLASSES = {
    "N-BK7": Glass(
        "sellmeier 1",
        (1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653),
        (1.86e-6, 1.31e-8, -1.37e-11, 4.34e-7, 6.27e-10, 0.170),
        range_nm=(300.0, 2500.0),
        source="SCHOTT data sheet N-BK7",
    ),
    "N-SF11": Glass(
        "sellmeier 1",
        (1.73759695, 0.013188707, 0.313747346, 0.0623068142, 1.89878101, 155.23629),
        (-3.56e-6, 9.20e-9, -2.10e-11, 9.65e-7, 1.44e-9, 0.294),
        range_nm=(370.0, 2500.0),
        source="SCHOTT data sheet N-SF11",
    ),
    "L-BAL35": Glass(
        "sellmeier 1",
        (1.1626263, 0.0125957437, 0.325661051, -0.0032691105, 1.35132486, 119.214596),
        (5.03e-6, 1.22e-8, -3.81e-11, 4.93e-7, 5.76e-10, 0.160),
        reference_c=25.0,
        range_nm=(300.0, 2400.0),
        source="OHARA data sheet L-BAL35",
    ),
    "fused silica": Glass(
        "sellmeier 1",
        (0.6961663, 0.0684043**2, 0.4079426, 0.1162414**2, 0.8974794, 9.896161**2),
        (2.06e-5, 2.51e-8, -2.47e-11, 3.12e-7, 4.22e-10, 0.160),
        range_nm=(210.0, 3710.0),
        source="Malitson, J. Opt. Soc. Am. 55 (1965) 1205; thermal: SCHOTT data sheet LITHOSIL-Q",
    ),
}

_OTHER_NAMES = {
    **dict.fromkeys(
        ("F_SILICA", "FUSED SILICA", "SILICA", "UVFS", "SUPRASIL", "INFRASIL", "QUARTZ", "SIO2",
         "COR7980", "C79-80", "7980", "HPFS", "FUSEDSILICA", "FS", "LITHOSIL-Q", "JGS1",
         "HERASIL", "HOMOSIL", "CORNING7980"),
        "fused silica",
    ),
    **dict.fromkeys(("BK7", "NBK7", "N-BK7HT", "BK7HT"), "N-BK7"),
    **dict.fromkeys(("ACRYLIC", "PLEXIGLASS"), "PMMA"),
    **dict.fromkeys(("POLYCARBONATE", "PC"), "POLYCARB"),
    **dict.fromkeys(("POLYSTYRENE", "STYRENE", "PS"), "POLYSTYR"),
    **dict.fromkeys(("ZEONEX", "ZEONEX_E48R", "COP"), "E48R"),
    **dict.fromkeys(("SI", "SILICON_SPECIAL"), "SILICON"),
    **dict.fromkeys(("GE", "GERMANIUM_SPECIAL", "GE_OLD"), "GERMANIUM"),
    **dict.fromkeys(("ZNS_BROAD", "ZNS_IR", "CLEARTRAN", "ZNS_CLEAR", "ZNS_VIS"), "ZNS"),
    **dict.fromkeys(("ZNSE_IR",), "ZNSE"),
    **dict.fromkeys(("AL2O3", "SAPHIRE"), "SAPPHIRE"),
    "BD2": "BD-2",
    "BD-6": "BD6",
    # Known by index and Abbe number as SCHOTT, LightPath, Osaka Gas Chemicals, Mitsubishi Gas
    # Chemical, Mitsui, Zeon and Polyplastics state them; not compared with a second source.
    "B270": "model:1.523:58.57:0",
    **dict.fromkeys(("C0550", "CO550", "CO-550"), "model:1.605:50.42:0"),
    **dict.fromkeys(("ECO550", "ECO-550"), "model:1.6055:50.28:0"),
    "OKP4": "model:1.607:27.0:0",
    "OKP4HT": "model:1.632:23.4:0",
    **dict.fromkeys(("EP5000", "EP-5000"), "model:1.636:23.9:0"),
    "APL5014CL": "model:1.5445:56.0:0",
    **dict.fromkeys(("480R", "ZEONEX_480R"), "model:1.525:56.2:0"),
    **dict.fromkeys(("K26R", "ZEONEX_K26R"), "model:1.535:55.8:0"),
    **dict.fromkeys(("TOPAS5013", "TOPAS_5013LS-01", "COC"), "model:1.533:56.2:0"),
}  # fmt: skip

_added: dict[str, Glass] = {}


@lru_cache(maxsize=1)
def _shipped() -> dict[str, Glass]:
    from lensshift.optics.agf import parse_agf

    text = (resources.files("lensshift.optics") / "glasses.agf").read_text(encoding="utf-8")
    return parse_agf(text) | GLASSES


def add_glasses(glasses: dict[str, Glass]) -> None:
    """Make more glasses known by their names, in upper case; those that are known stay.

    Raises
    ------
    ValueError
        If a name is one of `add_glasses` before, with other constants.
    """
    for name, glass in glasses.items():
        known = _added.get(name)
        if known is not None and known != glass:
            raise ValueError(f"expected one set of constants for glass {name}, got two")
        if name not in _shipped():
            _added[name] = glass


def glass_names() -> tuple[str, ...]:
    """Return the names that `refractive_index` knows."""
    return (AIR, *GLASSES, *(name for name in _shipped() if name not in GLASSES), *_added)


def is_shipped(name: str) -> bool:
    """Tell whether a glass comes with the package or says itself what it is."""
    return name.startswith("model:") or name in _shipped()


def glass_called(name: str) -> str | None:
    """Return the glass that design programs call `name`, or None if it is not known."""
    upper = name.upper()
    own = next((name for name in GLASSES if name.upper() == upper.replace("_", " ")), None)
    for known in (_OTHER_NAMES.get(upper), upper, own):
        if known is not None and (is_shipped(known) or known in _added):
            return known
    code = re.fullmatch(r"(\d{3})[.\-]?(\d{3})", name)
    if code:  # six digits: n_d - 1 and Abbe number
        return model_glass(1.0 + int(code[1]) / 1e3, int(code[2]) / 10.0)
    return None


def successor(name: str) -> str | None:
    """Return the lead-free glass that took the place of an older one of SCHOTT, or None."""
    upper = name.upper()
    for newer in (f"N-{upper}", re.sub(r"^([A-Z]+)N(\d)", r"N-\1\2", upper), upper.rstrip("MAB")):
        for one in (newer, f"{newer}A"):
            if one not in (upper, f"{upper}A") and one in _shipped():
                return one
    return None


def glass_in_light(name: str, wavelength_nm: float) -> tuple[str, str | None]:
    """Return a glass, or one that is like it where its constants end before the light, and says so.

    The successor if its n_d is within 5e-4, else the model glass of n_d and Abbe number; the glass
    itself where it is known, or nothing is known of the visible, or the light is far from it.
    """
    taken = _alike(name, wavelength_nm)
    if taken == name:
        return name, None
    low_nm, high_nm = glass_data(name).range_nm
    told = "from its index and Abbe number" if ":" in taken else f"as {taken}"
    return taken, f"{name}, known from {low_nm:g} to {high_nm:g} nm, taken {told}"


def _alike(name: str, wavelength_nm: float) -> str:
    low_nm, high_nm = glass_data(name).range_nm
    if _holds(name, wavelength_nm) or not low_nm < 1e3 * _C_UM < high_nm:
        return name
    at_d, at_f, at_c = (refractive_index(name, 1e3 * um) for um in (D_UM, _F_UM, _C_UM))
    newer = successor(name)
    if (
        newer is not None
        and _holds(newer, wavelength_nm)
        and abs(refractive_index(newer, 1e3 * D_UM) - at_d) < _SAME_INDEX
    ):
        return newer
    made = model_glass(at_d, (at_d - 1.0) / (at_f - at_c))
    return made if _holds(made, wavelength_nm) else name


def _holds(name: str, wavelength_nm: float) -> bool:
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
    found = GLASSES.get(name) or _shipped().get(name) or _added.get(name)
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
    width = (index_d - 1.0) / abbe
    um = np.array([D_UM, _F_UM, _C_UM, _G_UM])
    terms = np.stack([np.ones(4), 1.0 / um, um**-3.5], axis=-1)
    ratio = 0.6438 - 0.001682 * abbe + partial
    system = np.stack([terms[0], terms[1] - terms[2], terms[3] - terms[1]])
    constants = np.linalg.solve(system, [index_d, width, ratio * width])
    return Glass("conrady", tuple(map(float, constants)), source=BY_CODE)


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
    if not _holds(glass, wavelength_nm):
        raise ValueError(
            f"expected a wavelength from {data.range_nm[0]:g} to {data.range_nm[1]:g} nm for "
            f"{glass}, got {wavelength_nm} nm"
        )
    index = _index(data, wavelength_nm * 1e-3)
    if data.thermal == NO_CHANGE:
        return index
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


def _index(data: Glass, um: float) -> float:
    """Return the index at the temperature of the constants.

    Source: the formulas of AGF catalogues as the maker of that format documents them.
    """
    count = CONSTANT_COUNTS[data.formula]
    k = (*data.constants, *(0.0,) * (count - len(data.constants)))
    square = um * um
    if data.formula in _POWERS:
        powers = _POWERS[data.formula]
        value = sum(a * um**power for a, power in zip(k, powers, strict=True))
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


def _thermal_change(data: Glass, index: float, wavelength_nm: float, temperature_c: float) -> float:
    d0, d1, d2, e0, e1, resonance_um = data.thermal
    t = temperature_c - data.reference_c
    square = (wavelength_nm * 1e-3) ** 2
    bracket = d0 * t + d1 * t**2 + d2 * t**3 + (e0 * t + e1 * t**2) / (square - resonance_um**2)
    return (index**2 - 1.0) / (2.0 * index) * bracket
