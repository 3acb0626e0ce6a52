"""Lens files in TOML, and the lenses that come with the package."""

from __future__ import annotations

import json
import math
from dataclasses import MISSING, asdict, fields
from importlib import resources
from pathlib import Path
from typing import Any, get_type_hints

from lensshift.core.atomic import write_text
from lensshift.core.errors import DataError, about, warn_quality
from lensshift.core.settings import check_keys, fit, parse_toml, read_text, settings_of
from lensshift.optics.glass import Glass, add_glasses, glass_data, is_shipped
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.sequential import element_about_stop
from lensshift.optics.zmx import load_zmx

# Lens files of other programs, which all of them can write as .zmx.
_FOREIGN = {
    ".seq": "CODE V", ".len": "CODE V or OSLO", ".osl": "OSLO", ".zar": "Zemax (archive)",
    ".zos": "Zemax (project)", ".zmf": "Zemax (catalogue)",
}  # fmt: skip
_PAIR = tuple[float, float]
_KINDS = (float, str, bool, _PAIR, tuple[float, ...])  # of fields that entries are read for alike
_PRESCRIPTIONS = resources.files("lensshift.optics") / "prescriptions"


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
        As `load_zmx`; if the stop lies in glass.
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
        lens = _lens(content, text)
    if (name := element_about_stop(lens)) is not None and lens.stop.behind is None:
        at_mm = lens.stop.position_mm
        warn_quality(f"{source or 'lens'}: the stop at {at_mm:g} mm lies in {name}: is that right?")
    return lens


def save_lens(lens: Lens, path: str | Path) -> None:
    """Write a lens as TOML, so that `load_lens` returns the same lens.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    write_text(path, format_lens(lens))


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
    if stop.behind is not None:
        lines.append(f"behind = {stop.behind}")
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
    if isinstance(value, str | bool):  # a JSON string is a TOML basic string, truths are alike
        return json.dumps(value, ensure_ascii=False)
    return repr(float(value))


def _degrees(tilt_rad: tuple[float, float]) -> tuple[float, ...] | None:
    return tuple(map(math.degrees, tilt_rad)) if any(tilt_rad) else None


def _lens(content: dict[str, Any], text: str) -> Lens:
    found = _entries_of(content, Lens, "lens", name="", stop=..., element=..., glass=[])
    for number, table in enumerate(_tables(found, "glass", "lens"), start=1):
        where = f"glass {number}{_line(text, '[[glass]]', number)}"
        glass = _entries_of(table, Glass, where, name=..., range_nm=...)
        name = fit(glass.pop("name"), str, f"{where}, name").upper()
        with about(where):
            add_glasses({name: Glass(**glass)})
    stop = _entries_of(found.pop("stop"), Stop, "stop", rides_on=None, behind=None)
    tables = _tables(found, "element", "lens")
    for key, least in (("rides_on", 1), ("behind", 0)):
        number = stop[key]
        if number is not None and not (type(number) is int and least <= number <= len(tables)):
            raise DataError(
                f"expected the number of an element from {least} to {len(tables)}, got {number!r}",
                field=key,
            )
    carrier = stop.pop("rides_on")
    elements: list[Element] = []
    gaps_mm = []
    for number, table in enumerate(tables, start=1):
        where = f"element {number}{_line(text, '[[element]]', number)}"
        entries = _entries_of(table, Element, where, glass=..., gap_mm=..., surface=...)
        gaps_mm.append(_value(entries.pop("gap_mm"), "gap_mm", float, where))
        first = sum(len(element.surfaces) for element in elements)
        elements.append(_element(entries, where, text, first))
    return Lens(
        elements=tuple(elements),
        gaps_mm=tuple(gaps_mm),
        stop=Stop(**stop, rides_on=None if carrier is None else carrier - 1),
        name=fit(found.pop("name"), str, "name"),
        **found,
    )


def _element(entries: dict[str, Any], where: str, text: str, first_surface: int) -> Element:
    surfaces = []
    for number, table in enumerate(_tables(entries, "surface", where), start=1):
        line = _line(text, "[[element.surface]]", first_surface + number)
        at = f"{where.split(',')[0]} surface {number}{line}"
        surface = _entries_of(table, Surface, at)
        with about(at):
            surfaces.append(Surface(**surface))
    named = entries.pop("glass")
    glass = named if isinstance(named, list) else [named]
    if not all(isinstance(one, str) for one in glass):
        raise DataError(f"expected names of glasses, got {named!r}", field=where)
    with about(where):
        return Element(surfaces=tuple(surfaces), glass=tuple(glass), **entries)


def _entries_of(table: Any, made: type[Any], where: str, **also: Any) -> dict[str, Any]:
    """Return the entries of a table as arguments for a class; angles in radians.

    Parameters
    ----------
    also : what other entries are if they are missing, `...` if they must be there, as some fields
    """
    kinds = dict.fromkeys(also) | {
        name.replace("_rad", "_deg"): kind
        for name, kind in get_type_hints(made).items()
        if kind in _KINDS and name != "gaps_mm" and also.get(name, ...) is ...
    }
    defaults = {one.name.replace("_rad", "_deg"): one.default for one in fields(made)} | also
    check_keys(table, {key: defaults[key] in (MISSING, ...) for key in sorted(kinds)}, where)
    found = {key: default for key, default in also.items() if key not in table}
    for key, value in table.items():
        found[key] = value if kinds[key] is None else _value(value, key, kinds[key], where)
    if "tilt_deg" in found:
        row_deg, col_deg = found.pop("tilt_deg")
        found["tilt_rad"] = math.radians(row_deg), math.radians(col_deg)
    return found


def _tables(entries: dict[str, Any], key: str, where: str) -> list[Any]:
    """Take the tables of a key out of entries."""
    tables = entries.pop(key)
    if not isinstance(tables, list):
        raise DataError(f"expected tables [[{key}]], got {tables!r}", field=where)
    return tables


def _value(value: Any, key: str, kind: Any, where: str) -> Any:
    if kind in (str, bool):
        return fit(value, kind, f"{where}, {key}")
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise DataError(f"expected a number for {key!r}, got {value!r}", field=where)
        return float(value)
    values = value if isinstance(value, list) else [value]
    if kind is _PAIR and len(values) != 2:
        raise DataError(f"expected 2 numbers for {key!r}, got {value!r}", field=where)
    return tuple(_value(one, key, float, where) for one in values)


def _line(text: str, heading: str, number: int) -> str:
    """Name the line of the n-th heading; nothing if the file writes its tables another way."""
    found = [i for i, line in enumerate(text.splitlines(), 1) if line.strip().startswith(heading)]
    return f", line {found[number - 1]}" if number <= len(found) else ""
