"""Lens files in TOML, and the lenses that come with the package."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

from lensshift.core.errors import DataError
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
from lensshift.optics.sequential import about
from lensshift.optics.zmx import load_zmx

_LENS_KEYS = {"name", "wavelength_nm", "temperature_c", "object_mm", "stop", "element", "glass"}
_STOP_KEYS = {"diameter_mm", "position_mm", "rides_on"}
_ELEMENT_KEYS = {
    "name", "glass", "thickness_mm", "gap_mm", "decenter_mm", "tilt_deg", "surface",
}  # fmt: skip
_SURFACE_KEYS = {
    "radius_mm", "conic", "asphere", "semi_diameter_mm", "radial", "mirror", "tilt_deg",
}  # fmt: skip
_GLASS_KEYS = {"name", "formula", "constants", "thermal", "reference_c", "range_nm", "source"}


def lens_names() -> tuple[str, ...]:
    """Return the names of the lenses that come with the package."""
    folder = resources.files("lensshift.optics") / "prescriptions"
    files = (entry.name for entry in folder.iterdir())
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
        folder = resources.files("lensshift.optics") / "prescriptions"
        text = (folder / f"{path_or_name}.toml").read_text(encoding="utf-8")
        return parse_lens(text, source=f"{path_or_name}.toml")
    path = Path(path_or_name)
    if not path.is_file():
        raise DataError(f"expected a lens file or a name of {', '.join(lens_names())}", source=path)
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


def _glass(table: dict[str, Any], where: str) -> dict[str, Glass]:
    """Return a glass that the file brings with it."""
    _check_keys(table, _GLASS_KEYS, where, {"name", "formula", "constants", "range_nm"})
    low_nm, high_nm = _numbers(table["range_nm"], "range_nm", where, 2)
    with about(where):
        glass = Glass(
            formula=fit(table["formula"], str, f"{where}, formula"),
            constants=_numbers(table["constants"], "constants", where),
            thermal=_numbers(table.get("thermal", list(NO_CHANGE)), "thermal", where, 6),
            reference_c=_number(table, "reference_c", where, REFERENCE_TEMPERATURE_C),
            range_nm=(low_nm, high_nm),
            source=fit(table.get("source", ""), str, f"{where}, source"),
        )
    return {fit(table["name"], str, f"{where}, name").upper(): glass}


def _lens(content: dict[str, Any], text: str) -> Lens:
    _check_keys(content, _LENS_KEYS, "lens", {"stop", "element"})
    for number, one in enumerate(_tables(content.get("glass", []), "glass", "lens"), start=1):
        where = f"glass {number}, line {_line(text, '[[glass]]', number)}"
        add_glasses(_glass(_table(one, where), where))
    stop = _table(content["stop"], "stop")
    _check_keys(stop, _STOP_KEYS, "stop", {"diameter_mm"})
    tables = _tables(content["element"], "element", "lens")
    elements, gaps_mm = [], []
    for number, table in enumerate(tables, start=1):
        where = f"element {number}, line {_line(text, '[[element]]', number)}"
        element = _table(table, where)
        _check_keys(element, _ELEMENT_KEYS, where, {"glass", "thickness_mm", "gap_mm", "surface"})
        first = sum(len(one["surface"]) for one in tables[: number - 1])
        elements.append(_element(element, where, text, first))
        gaps_mm.append(_number(element, "gap_mm", where))
    rides_on = stop.get("rides_on")
    if rides_on is not None and (isinstance(rides_on, bool) or not isinstance(rides_on, int)):
        raise DataError(f"expected the number of an element, got {rides_on!r}", field="rides_on")
    return Lens(
        elements=tuple(elements),
        gaps_mm=tuple(gaps_mm),
        stop=Stop(
            diameter_mm=_number(stop, "diameter_mm", "stop"),
            position_mm=_number(stop, "position_mm", "stop", 0.0),
            rides_on=None if rides_on is None else rides_on - 1,
        ),
        object_mm=_number(content, "object_mm", "lens", math.inf),
        wavelength_nm=_number(content, "wavelength_nm", "lens", WAVELENGTH_NM),
        temperature_c=_number(content, "temperature_c", "lens", REFERENCE_TEMPERATURE_C),
        name=fit(content.get("name", ""), str, "name"),
    )


def _element(table: dict[str, Any], where: str, text: str, first_surface: int) -> Element:
    surfaces = []
    for number, content in enumerate(_tables(table["surface"], "surface", where), start=1):
        line = _line(text, "[[element.surface]]", first_surface + number)
        at = f"{where.split(',')[0]} surface {number}, line {line}"
        surface = _table(content, at)
        _check_keys(surface, _SURFACE_KEYS, at, {"radius_mm"})
        with about(at):
            surfaces.append(_surface(surface, at))
    row_mm, col_mm = _numbers(table.get("decenter_mm", [0.0, 0.0]), "decenter_mm", where, 2)
    glass = table["glass"] if isinstance(table["glass"], list) else [table["glass"]]
    if not all(isinstance(one, str) for one in glass):
        raise DataError(f"expected names of glasses, got {table['glass']!r}", field=where)
    with about(where):
        return Element(
            surfaces=tuple(surfaces),
            glass=tuple(glass),
            thickness_mm=_numbers(table["thickness_mm"], "thickness_mm", where),
            name=fit(table.get("name", ""), str, f"{where}, name"),
            decenter_mm=(row_mm, col_mm),
            tilt_rad=_tilt_rad(table, where),
        )


def _surface(table: dict[str, Any], where: str) -> Surface:
    return Surface(
        radius_mm=_number(table, "radius_mm", where),
        conic=_number(table, "conic", where, 0.0),
        asphere=_numbers(table.get("asphere", []), "asphere", where),
        semi_diameter_mm=_number(table, "semi_diameter_mm", where, math.inf),
        radial=_numbers(table.get("radial", []), "radial", where),
        mirror=fit(table.get("mirror", False), bool, f"{where}, mirror"),
        tilt_rad=_tilt_rad(table, where),
    )


def _tilt_rad(table: dict[str, Any], where: str) -> tuple[float, float]:
    row_deg, col_deg = _numbers(table.get("tilt_deg", [0.0, 0.0]), "tilt_deg", where, 2)
    return math.radians(row_deg), math.radians(col_deg)


def _tables(value: object, key: str, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise DataError(f"expected tables [[{key}]], got {value!r}", field=where)
    return value


def _table(value: object, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise DataError(f"expected a table, got {value!r}", field=where)
    return value


def _check_keys(table: dict[str, Any], known: set[str], where: str, needed: set[str]) -> None:
    for key in table:
        if key not in known:
            raise DataError(f"expected {', '.join(sorted(known))}, got {key!r}", field=where)
    for key in sorted(needed - set(table)):
        raise DataError(f"expected {key!r}, which is missing", field=where)


def _number(table: dict[str, Any], key: str, where: str, default: float | None = None) -> float:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(f"expected a number for {key!r}, got {value!r}", field=where)
    return float(value)


def _numbers(value: object, key: str, where: str, count: int | None = None) -> tuple[float, ...]:
    values = value if isinstance(value, list) else [value]
    if count is not None and len(values) != count:
        raise DataError(f"expected {count} numbers for {key!r}, got {value!r}", field=where)
    return tuple(_number({key: one}, key, where) for one in values)


def _line(text: str, heading: str, number: int) -> int:
    """Return the line of the n-th heading; 0 if the file writes its tables another way."""
    found = [i for i, line in enumerate(text.splitlines(), 1) if line.strip().startswith(heading)]
    return found[number - 1] if number <= len(found) else 0
