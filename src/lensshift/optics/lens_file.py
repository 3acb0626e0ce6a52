"""Lens files in TOML, and the lenses that come with the package."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

from lensshift.core.errors import DataError, about
from lensshift.core.settings import fit, parse_toml, read_text, settings_of
from lensshift.optics.glass import (
    NO_CHANGE,
    REFERENCE_TEMPERATURE_C,
    Glass,
    add_glasses,
    glass_data,
    is_shipped,
)
from lensshift.optics.lens import WAVELENGTH_NM, Element, Lens, Stop, Surface
from lensshift.optics.zmx import load_zmx

# Lens files of other programs, which all of them can write as .zmx.
_FOREIGN = {
    ".seq": "CODE V", ".len": "CODE V or OSLO", ".osl": "OSLO", ".zar": "Zemax (archive)",
    ".zos": "Zemax (project)", ".zmf": "Zemax (catalogue)",
}  # fmt: skip
_PRESCRIPTIONS = resources.files("lensshift.optics") / "prescriptions"
# Entry of a table -> what it is (numbers: how many, or a tuple of any), and what it is if it is
# missing; with `...` it must be there.
_Fields = Mapping[str, tuple[Any, Any]]
_LENS: _Fields = {
    "name": (object, ""), "wavelength_nm": (float, WAVELENGTH_NM),
    "temperature_c": (float, REFERENCE_TEMPERATURE_C), "object_mm": (float, math.inf),
    "stop": (object, ...), "element": (list, ...), "glass": (list, []),
}  # fmt: skip
_STOP: _Fields = {
    "diameter_mm": (float, ...), "position_mm": (float, 0.0), "rides_on": (object, None),
}  # fmt: skip
_ELEMENT: _Fields = {
    "name": (str, ""), "glass": (object, ...), "thickness_mm": (tuple, ...),
    "gap_mm": (float, ...), "decenter_mm": (2, (0.0, 0.0)), "tilt_deg": (2, (0.0, 0.0)),
    "surface": (list, ...),
}  # fmt: skip
_SURFACE: _Fields = {
    "radius_mm": (float, ...), "conic": (float, 0.0), "asphere": (tuple, ()),
    "semi_diameter_mm": (float, math.inf), "inner_mm": (float, 0.0), "radial": (tuple, ()),
    "mirror": (bool, False), "tilt_deg": (2, (0.0, 0.0)),
}  # fmt: skip
_GLASS: _Fields = {
    "name": (str, ...), "formula": (str, ...), "constants": (tuple, ...),
    "thermal": (6, NO_CHANGE), "reference_c": (float, REFERENCE_TEMPERATURE_C),
    "range_nm": (2, ...), "source": (str, ""), "lower_by": (float, 0.0),
}  # fmt: skip


def lens_names() -> tuple[str, ...]:
    """Return the names of the lenses that come with the package."""
    files = (entry.name for entry in _PRESCRIPTIONS.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml")))


def load_lens(path_or_name: str | Path) -> Lens:
    """Read a lens from a TOML or .zmx file, or one of `lens_names()`.

    Angles are in degrees in the file, (row, col) pairs as in the program, elements numbered from
    1; `inf` is a plane surface, an object at infinity, a surface without an edge.

    Raises
    ------
    DataError
        If the file is missing, is not TOML, or describes no lens: with file, element, surface
        and line.

    Warns
    -----
    QualityWarning
        As `load_zmx`.
    """
    if Path(path_or_name).suffix.lower() == ".zmx":
        return load_zmx(path_or_name)
    if str(path_or_name) in lens_names():
        text = (_PRESCRIPTIONS / f"{path_or_name}.toml").read_text(encoding="utf-8")
        return parse_lens(text, source=f"{path_or_name}.toml")
    path = Path(path_or_name)
    if not path.is_file():
        raise DataError(f"expected a lens file or a name of {', '.join(lens_names())}", source=path)
    if path.suffix.lower() in _FOREIGN:
        program = _FOREIGN[path.suffix.lower()]
        raise DataError(
            f"expected a lens in TOML or .zmx, got one of {program}: save it as .zmx there",
            source=path,
        )
    return parse_lens(read_text(path), source=path)


def parse_lens(text: str, source: str | Path = "") -> Lens:
    """Return the lens that a text in TOML describes; see `load_lens`."""
    content = parse_toml(text, source)
    with settings_of(source):
        return _lens(content, text)


def save_lens(lens: Lens, path: str | Path) -> None:
    """Write a lens as TOML, so that `load_lens` returns the same lens.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    try:
        Path(path).write_text(format_lens(lens), encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot write: {error.strerror or error}", source=path) from error


def format_lens(lens: Lens) -> str:
    """Return the TOML text of a lens."""
    stop = lens.stop
    lines = [
        *_entries(name=lens.name, wavelength_nm=lens.wavelength_nm),
        *_entries(temperature_c=lens.temperature_c, object_mm=lens.object_mm),
        "",
        "[stop]",
        *_entries(diameter_mm=stop.diameter_mm, position_mm=stop.position_mm),
    ]
    if stop.rides_on is not None:
        lines.append(f"rides_on = {stop.rides_on + 1}")
    for name in sorted({glass for element in lens.elements for glass in element.glass}):
        if not is_shipped(name):
            lines += ["", "[[glass]]", *_entries(name=name, **asdict(glass_data(name)))]
    for element, gap_mm in zip(lens.elements, lens.gaps_mm, strict=True):
        lines += ["", "[[element]]"]
        lines += _entries(name=element.name, glass=element.glass)
        lines += _entries(thickness_mm=element.thickness_mm, gap_mm=gap_mm)
        moved = element.decenter_mm if any(element.decenter_mm) else None
        lines += _entries(decenter_mm=moved, tilt_deg=_degrees(element.tilt_rad))
        for surface in element.surfaces:
            lines += ["", "[[element.surface]]"]
            lines += _entries(
                radius_mm=surface.radius_mm,
                conic=surface.conic or None,
                asphere=surface.asphere or None,
                radial=surface.radial or None,
                mirror=surface.mirror or None,
                tilt_deg=_degrees(surface.tilt_rad),
                semi_diameter_mm=surface.semi_diameter_mm,
                inner_mm=surface.inner_mm or None,
            )
    return "\n".join(lines) + "\n"


def _entries(**values: Any) -> list[str]:
    """Return the lines of a table, without those that are None."""
    return [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    # A JSON string is a TOML basic string, truths are written alike.
    return (
        json.dumps(value, ensure_ascii=False)
        if isinstance(value, str | bool)
        else repr(float(value))
    )


def _degrees(tilt_rad: tuple[float, float]) -> tuple[float, ...] | None:
    return tuple(map(math.degrees, tilt_rad)) if any(tilt_rad) else None


def _lens(content: dict[str, Any], text: str) -> Lens:
    found = _entries_of(content, _LENS, "lens")
    for number, table in enumerate(found["glass"], start=1):
        where = f"glass {number}{_line(text, '[[glass]]', number)}"
        glass = _entries_of(table, _GLASS, where)
        name = glass.pop("name").upper()
        with about(where):
            add_glasses({name: Glass(**glass)})
    stop = _entries_of(found["stop"], _STOP, "stop")
    rides_on = stop.pop("rides_on")
    count = len(found["element"])
    if rides_on is not None and not (type(rides_on) is int and 1 <= rides_on <= count):
        raise DataError(
            f"expected the number of an element from 1 to {count}, got {rides_on!r}",
            field="rides_on",
        )
    elements: list[Element] = []
    gaps_mm = []
    for number, table in enumerate(found["element"], start=1):
        where = f"element {number}{_line(text, '[[element]]', number)}"
        entries = _entries_of(table, _ELEMENT, where)
        gaps_mm.append(entries.pop("gap_mm"))
        first = sum(len(element.surfaces) for element in elements)
        elements.append(_element(entries, where, text, first))
    return Lens(
        elements=tuple(elements),
        gaps_mm=tuple(gaps_mm),
        stop=Stop(**stop, rides_on=None if rides_on is None else rides_on - 1),
        object_mm=found["object_mm"],
        wavelength_nm=found["wavelength_nm"],
        temperature_c=found["temperature_c"],
        name=fit(found["name"], str, "name"),
    )


def _element(entries: dict[str, Any], where: str, text: str, first_surface: int) -> Element:
    surfaces = []
    for number, table in enumerate(entries.pop("surface"), start=1):
        line = _line(text, "[[element.surface]]", first_surface + number)
        at = f"{where.split(',')[0]} surface {number}{line}"
        surface = _entries_of(table, _SURFACE, at)
        with about(at):
            surfaces.append(Surface(**surface))
    named = entries.pop("glass")
    glass = named if isinstance(named, list) else [named]
    if not all(isinstance(one, str) for one in glass):
        raise DataError(f"expected names of glasses, got {named!r}", field=where)
    with about(where):
        return Element(surfaces=tuple(surfaces), glass=tuple(glass), **entries)


def _entries_of(table: Any, fields: _Fields, where: str) -> dict[str, Any]:
    """Return the entries of a table, those that are missing as well; angles in radians."""
    if not isinstance(table, dict):
        raise DataError(f"expected a table, got {table!r}", field=where)
    for key in table:
        if key not in fields:
            raise DataError(f"expected {', '.join(sorted(fields))}, got {key!r}", field=where)
    found = {}
    for key, (kind, default) in fields.items():
        if key not in table and default is ...:
            raise DataError(f"expected {key!r}, which is missing", field=where)
        found[key] = _value(table[key], key, kind, where) if key in table else default
    if "tilt_deg" in found:
        row_deg, col_deg = found.pop("tilt_deg")
        found["tilt_rad"] = math.radians(row_deg), math.radians(col_deg)
    return found


def _value(value: Any, key: str, kind: Any, where: str) -> Any:
    if kind in (str, bool):
        return fit(value, kind, f"{where}, {key}")
    if kind is list and not isinstance(value, list):
        raise DataError(f"expected tables [[{key}]], got {value!r}", field=where)
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise DataError(f"expected a number for {key!r}, got {value!r}", field=where)
        return float(value)
    if kind is tuple or isinstance(kind, int):
        values = value if isinstance(value, list) else [value]
        if isinstance(kind, int) and len(values) != kind:
            raise DataError(f"expected {kind} numbers for {key!r}, got {value!r}", field=where)
        return tuple(_value(one, key, float, where) for one in values)
    return value


def _line(text: str, heading: str, number: int) -> str:
    """Name the line of the n-th heading; nothing if the file writes its tables another way."""
    found = [i for i, line in enumerate(text.splitlines(), 1) if line.strip().startswith(heading)]
    return f", line {found[number - 1]}" if number <= len(found) else ""
