"""What design programs call glasses, and which others are like them."""

from __future__ import annotations

import re
from functools import lru_cache

from lensshift.optics.glass import (
    C_UM,
    D_UM,
    F_UM,
    GLASSES,
    glass_data,
    holds,
    is_known,
    is_shipped,
    lines_of,
    model_glass,
    refractive_index,
)

_SAME_INDEX = 5e-4  # a usual tolerance of n_d from melt to melt


@lru_cache(maxsize=1)
def _other_names() -> dict[str, str]:
    """Return what the glasses are called that are known by more than one name."""
    lines = (line.split(" = ") for line in lines_of("glass_names.txt").splitlines())
    return {other: name for name, others in lines for other in others.split(", ")}


def glass_called(name: str) -> str | None:
    """Return the glass that design programs call `name`, or None if it is not known."""
    upper = name.upper()
    own = next((name for name in GLASSES if name.upper() == upper.replace("_", " ")), None)
    if is_known(upper) and not is_shipped(upper):  # of a catalogue that was loaded
        return upper
    for known in (_other_names().get(upper), upper, own):
        if known is not None and is_known(known):
            return known
    code = re.fullmatch(r"(\d{3})[.\-]?(\d{3})", name)
    if code:  # six digits: n_d - 1 and Abbe number
        return model_glass(1.0 + int(code[1]) / 1e3, int(code[2]) / 10.0)
    return None


def successor(name: str) -> str | None:
    """Return the lead-free glass that took the place of an older one of SCHOTT, or None."""
    upper = name.upper()
    for newer in (f"N-{upper}", re.sub(r"^([A-Z]+)N(\d)", r"N-\1\2", upper), upper.rstrip("AB")):
        for one in (newer, f"{newer}A"):
            if one not in (upper, f"{upper}A") and is_known(one):
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
    if holds(name, wavelength_nm) or not low_nm < 1e3 * F_UM < 1e3 * C_UM < high_nm:
        return name
    at_d, at_f, at_c = (refractive_index(name, 1e3 * um) for um in (D_UM, F_UM, C_UM))
    newer = successor(name)
    if (
        newer is not None
        and holds(newer, wavelength_nm)
        and abs(refractive_index(newer, 1e3 * D_UM) - at_d) < _SAME_INDEX
    ):
        return newer
    made = model_glass(at_d, (at_d - 1.0) / (at_f - at_c))
    return made if holds(made, wavelength_nm) else name
