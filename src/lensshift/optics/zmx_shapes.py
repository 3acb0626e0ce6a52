"""The shapes of surfaces in sequential Zemax files (.zmx)."""

from __future__ import annotations

import re

from lensshift.core.errors import about
from lensshift.optics.forbes import forbes_terms
from lensshift.optics.sequential import Entry

_KNOWN = ("STANDARD", "EVENASPH", "ODDASPHE", "XASPHERE", "XODDASPH", "QED_TYPE", "COORDBRK")
_REASONS = {  # by what the names of types begin with or contain
    "GRIN|GRADI": "in which the index varies",
    "BINARY|GRAT|HOLO|PHA|ZONE": "which diffracts light",
    "FRESNEL": "whose grooves scatter light",
    "PARAX|ABCD": "an ideal lens, which has no surfaces to trace",
    "USER|DLL": "whose shape is in a program of its own",
    "NONSEQ": "in which light takes no fixed order of surfaces",
    "BIREF|JONES": "which treats polarisations differently",
    "TORO|CYL|BICON|TILTS|IRREG|POLY|ZERN|CHEB|GRID|OFFAX|SLIDE|PERIOD|NURB|FREEF":
        "which is no surface of revolution",
}  # fmt: skip
_GRATING = "DGRATING"  # of order 0, or without lines: light only refracts
_LIKE_ASPHERE = ("BINARY_1", "BINARY_2")  # even aspheres, where their phase is 0
_TERMS_PER_POWER = {"XASPHERE": 2, "XODDASPH": 1}  # steps of the powers of r / unit
_MOST_TERMS = 240  # of extra data
MOST_PARAMETERS = 8  # an even asphere ends with r^16, an odd one with r^8


def is_traced(kind: str) -> bool:
    """Tell whether surfaces of a type can be traced, some of them only without a phase."""
    return kind in (*_KNOWN, *_LIKE_ASPHERE, _GRATING)


def shape(entry: Entry, mm: float) -> None:
    """Turn the parameters of a surface into the terms of its sag, or refuse it.

    Raises
    ------
    DataError
        If it cannot be traced: with file, line and why.
    """
    value = entry.parameters
    phase = [term for number, term in entry.extra.items() if number > 2]  # after count and radius
    if entry.type in _LIKE_ASPHERE and not (any(phase) and value.get(0, 1.0)):
        entry.type = "EVENASPH"
    if entry.type == _GRATING and value.get(1, 1.0) * value.get(2, 1.0) == 0:
        entry.type = "STANDARD"
    if entry.type == "COORDBRK":
        value.update({axis: mm * value.get(axis, 0.0) for axis in (1, 2)})
    elif entry.type == "EVENASPH":
        entry.radial = _trimmed([0.0, value.get(1, 0.0) / mm])
        terms = [value.get(i, 0.0) * mm ** (1 - 2 * i) for i in range(2, MOST_PARAMETERS + 1)]
        entry.asphere = _trimmed(terms)
    elif entry.type == "ODDASPHE":
        terms = [value.get(i, 0.0) * mm ** (1 - i) for i in range(1, MOST_PARAMETERS + 1)]
        entry.radial = _trimmed(terms)
    elif entry.type in _TERMS_PER_POWER:
        step = _TERMS_PER_POWER[entry.type]
        terms, unit_mm = _series(entry, mm, 1)
        terms = [term / unit_mm ** (step * i) for i, term in enumerate(terms, start=1)]
        entry.radial = _trimmed([0.0, *terms[:1]] if step == 2 else terms)
        entry.asphere = _trimmed(terms[1:]) if step == 2 else ()
    elif entry.type == "QED_TYPE":
        terms, unit_mm = _series(entry, mm, 2)
        base = (entry.curvature_per_mm, entry.conic)
        edge_mm = min(entry.semi_diameter_mm or unit_mm, entry.clear_mm)
        with about(entry.where()):
            found = forbes_terms(entry.extra.get(1, 0.0) != 0, terms, unit_mm, base, edge_mm)
        entry.radial, entry.asphere = _trimmed([0.0, *found[:1]]), found[1:]
    elif entry.type != "STANDARD":
        told = (why for names, why in _REASONS.items() if re.search(names, entry.type))
        reason = next(told, "whose shape is not known here")
        raise entry.wrong(
            f"line {entry.line_of_type}: expected a surface of type {', '.join(_KNOWN)}, got "
            f"{entry.type}, {reason}"
        )


def _series(entry: Entry, mm: float, at: int) -> tuple[list[float], float]:
    """Return the terms whose number is written at a place of the extra data, and their radius."""
    count, unit_mm = int(entry.extra.get(at, 0.0)), mm * entry.extra.get(at + 1, 1.0)
    if not (0 <= count <= _MOST_TERMS and unit_mm > 0):
        raise entry.wrong("expected terms and a radius above 0")
    return [mm * entry.extra.get(at + 1 + i, 0.0) for i in range(1, count + 1)], unit_mm


def _trimmed(terms: list[float]) -> tuple[float, ...]:
    """Return the terms without zeros at the end."""
    last = max((number for number, term in enumerate(terms, start=1) if term), default=0)
    return tuple(terms[:last])
