"""Read sequential Zemax files (.zmx)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.errors import DataError, about, naming, warn_quality
from lensshift.optics.agf import decode
from lensshift.optics.glass import (
    AS_USUAL,
    BY_CODE,
    D_UM,
    REFERENCE_TEMPERATURE_C,
    glass_data,
    model_glass,
)
from lensshift.optics.glass_called import glass_called, glass_in_light, successor
from lensshift.optics.lens import Lens
from lensshift.optics.sequential import Entry, Frame, lens_of_entries
from lensshift.optics.zmx_shapes import MOST_PARAMETERS, is_traced, shape

_LENGTHS_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "METER": 1000.0, "M": 1000.0}
_FAR_MM = 1e9  # programs write such a distance for infinity
_TELECENTRIC, _AFOCAL = "that the object space is telecentric", "that the image is afocal"
_LEFT_OUT = {"TELE": {0: _TELECENTRIC}, "AFOC": {0: _AFOCAL}, "FTYP": {1: _TELECENTRIC, 6: _AFOCAL}}
_DEFAULT_GLASS = (1.5, 40.0)  # index and Abbe number that are written where none are known


@dataclass(slots=True)
class _File:
    """The contents of a file, as written, lengths in mm."""

    entries: list[Entry] = field(default_factory=list)
    name: str = ""
    mm: float = 1.0
    wavelengths_um: dict[int, float] = field(default_factory=dict)
    primary: int = 1
    aperture: tuple[str, float] | None = None
    catalogues: tuple[str, ...] = ()
    temperature_c: float = REFERENCE_TEMPERATURE_C
    notes: list[str] = field(default_factory=list)
    fields: set[float] = field(default_factory=set)
    turned: DataError | None = None  # about a surface that is turned by its properties


def load_zmx(path: str | Path) -> Lens:
    """Read a lens from a sequential .zmx file.

    Neighbouring surfaces with glass between them make an element, a curved mirror another;
    behind a mirror the path is unfolded, plane mirrors in air only fold it. Coordinate breaks
    between elements become decentre and tilt. Lengths may be mm, cm, m or inches. Glasses are
    those of the package, of `load_glass_catalogue`, model glasses and six-digit codes. Entries
    that say nothing about the path of the light (fields, coatings, solves, display, other
    configurations) are skipped.

    Raises
    ------
    DataError
        If the file is missing or malformed, describes no lens, or has a surface, a glass or a
        place of the image that cannot be traced, with the reason: with file, line and surface.

    Warns
    -----
    QualityWarning
        If something was taken otherwise than it is written: a stop or a surface that is clipped, a
        glass known by its index and Abbe number only, an aperture that is not round.
    """
    text = decode(path)
    with naming(path):
        return parse_zmx(text)


def parse_zmx(text: str) -> Lens:
    """Return the lens that the text of a .zmx file describes; see `load_zmx`."""
    content = _read(text)
    with about(""):
        lens = _lens(content)
    if content.notes:
        warn_quality("; ".join(dict.fromkeys(content.notes)), stacklevel=3)
    return lens


def _read(text: str) -> _File:
    content = _File()
    for number, line in enumerate(re.split("\r\n|[\r\n\0\x1a]", text), start=1):
        words = line.split()
        if not words:
            continue
        try:
            _read_line(content, words, number)
        except (ValueError, IndexError) as error:
            if isinstance(error, DataError):
                raise
            where = content.entries[-1].where() if content.entries else "header"
            raise DataError(
                f"line {number}: expected values after {words[0]}, got {line.strip()!r}",
                field=where,
            ) from error
    return content


def _read_line(content: _File, words: list[str], line: int) -> None:
    key, values = words[0], words[1:]
    if key == "SURF":
        content.entries.append(Entry(int(values[0]), line))
    elif key == "MNUM" and int(values[0]) > 1:
        content.notes.append(f"one of {values[0]} configurations, that in which it was saved")
    elif content.entries:
        _read_surface_line(content, content.entries[-1], key, values, line)
    elif key == "MODE" and values[0] != "SEQ":
        raise DataError(f"expected a sequential file, got mode {values[0]}", field=f"line {line}")
    elif key == "UNIT":
        if values[0].upper() not in _LENGTHS_MM:
            raise DataError(
                f"expected lengths in {', '.join(_LENGTHS_MM)}, got {values[0]}",
                field=f"line {line}",
            )
        content.mm = _LENGTHS_MM[values[0].upper()]
    elif key == "NAME":
        content.name = " ".join(values)
    elif key == "WAVM":
        content.wavelengths_um[int(values[0])] = float(values[1])
    elif key in ("WAVL", "WAVN"):
        content.wavelengths_um.update({i: float(v) for i, v in enumerate(values, start=1)})
    elif key == "GCAT":
        content.catalogues = tuple(map(str.upper, values))
    elif key in ("XFLN", "YFLN"):
        content.fields.update(map(float, values))
    elif key == "PWAV":
        content.primary = int(values[0])
    elif key == "ENVD":
        _read_surroundings(content, values)
    elif key == "FLOA" or (key == "ENPD" and float(values[0]) == 0):  # the latter: none is set
        content.aperture = ("FLOA", 0.0)
    elif key in _LEFT_OUT:
        left_out = (what for at, what in _LEFT_OUT[key].items() if values[at : at + 1] == ["1"])
        content.notes += [f"{what} is left out" for what in left_out]
    elif key == "GFAC" and any(map(float, values[1:2] if values[0] == "1" else values[:1])):
        content.notes.append("light that is brighter in the middle of the pupil is taken as even")
    elif key in ("VDXN", "VDYN", "VCXN", "VCYN") and any(map(float, values)):
        content.notes.append("vignetting factors are left out: semi-diameters stop the light")
    elif key in ("ENPD", "FNUM", "OBNA"):
        value = float(values[0])
        if not value > 0:
            raise DataError(f"expected a positive {key}, got {values[0]}", field=f"line {line}")
        other = values[1:2] == ["1"]  # than what the key says first
        if key == "OBNA" and other:  # half the angle of the cone, in degrees
            value = math.sin(math.radians(min(value, 90.0)))
        length = content.mm if key == "ENPD" else 1.0
        content.aperture = ("WORKING" if key == "FNUM" and other else key, length * value)


def _read_surroundings(content: _File, values: list[str]) -> None:
    """Take temperature and pressure as the program does: only where it is told to use them."""
    temperature_c, pressure = _finite(values[0]), _finite(values[1]) if values[1:] else 1.0
    if values[2:3] != ["0"]:
        content.temperature_c = temperature_c
        if pressure != 1.0:
            content.notes.append(f"indices are for air of {pressure:g} atm: taken for 1 atm")
    elif temperature_c != REFERENCE_TEMPERATURE_C:
        content.notes.append(f"indices are not adjusted to {temperature_c:g} C: taken for 20 C")


def _read_surface_line(
    content: _File, entry: Entry, key: str, values: list[str], line: int
) -> None:
    mm = content.mm
    if key == "TYPE":
        entry.type = values[0]
        entry.line_of_type = line
    elif key == "CURV":
        entry.curvature_per_mm = _finite(values[0]) / mm
    elif key == "CONI":
        entry.conic = _finite(values[0])
    elif key in ("PARM", "XDAT"):
        number = int(values[0])
        known = 0 <= number <= MOST_PARAMETERS or not is_traced(entry.type)
        if key == "PARM" and not known and float(values[1]):
            raise entry.wrong(
                f"line {line}: expected a parameter up to {MOST_PARAMETERS}, got {number}"
            )
        table = entry.parameters if key == "PARM" else entry.extra
        table[number] = _finite(values[1])
    elif key == "DISZ":
        entry.distance_mm = mm * float(values[0])  # also reads INFINITY
    elif key == "DIAM":
        entry.semi_diameter_mm = mm * _finite(values[0])
        entry.automatic = values[1:2] == ["0"]
    elif key in ("CLAP", "FLAP") and len(values) > 1 and float(values[1]) > 0:
        entry.clear_mm = mm * _finite(values[1])
        entry.inner_mm = max(entry.inner_mm, mm * _finite(values[0]))
    elif key == "OBSC" and len(values) > 1 and float(values[0]) == 0:
        entry.inner_mm = max(entry.inner_mm, mm * _finite(values[1]))
    elif key == "OBDC" and any(map(float, values[:2])):
        content.notes.append(f"surface {entry.number}: its aperture lies aside, and is left out")
        entry.clear_mm, entry.inner_mm = math.inf, 0.0
    elif key in ("SQAP", "ELAP", "OBSC", "SQOB", "ELOB", "SPID", "UDAP"):
        content.notes.append(f"surface {entry.number}: aperture {key} is left out")
    elif key == "SCBD" and any(map(float, values[3:])):
        content.turned = content.turned or entry.wrong(
            f"line {line}: expected a coordinate break, got a tilt or decentre as a property of "
            "the surface"
        )
    elif key == "COMM":
        entry.comment = " ".join(values)
    elif key == "GLAS":
        if values[0].upper() == "MIRROR":
            entry.mirror = True
        elif is_traced(entry.type):  # others are refused for what they are
            entry.glass, note = _glass(values, entry, line, content.catalogues)
            content.notes += [f"surface {entry.number}: glass {values[0]} {note}"] if note else []
    elif key == "STOP":
        entry.is_stop = True


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {word}")
    return value


def _glass(
    values: list[str], entry: Entry, line: int, catalogues: tuple[str, ...]
) -> tuple[str, str]:
    """Return the glass of a line and what has to be said about it; no glass for air."""
    name = values[0]
    numbers = [float(word) for word in values[3:6]]
    index, abbe, partial = (*numbers, 0.0, 0.0, 0.0)[:3]
    if name.upper() in ("AIR", "VACUUM"):
        return "", ""
    if name.upper() == "___BLANK":
        if not math.isfinite(index) or not index > 0:
            raise ValueError(f"expected an index, got {index}")
        return ("" if index == 1.0 else model_glass(index, abbe or 1e5, partial)), ""
    known = glass_called(name)
    if "CDGM" in catalogues[: (*catalogues, "SCHOTT").index("SCHOTT")]:
        known = glass_called(f"{name}_CDGM") or known  # a name that SCHOTT has for another glass
    if known is not None:
        source = glass_data(known).source
        if source.startswith(BY_CODE) and not known.startswith("model:"):
            return known, "is known by index and Abbe number only"
        return known, f"is {AS_USUAL}" if source == AS_USUAL else ""
    newer = successor(name)
    if newer is not None:
        return newer, f"taken as {newer}, which replaced it"
    if 1.2 < index < 4.5 and 5.0 < abbe < 150.0 and (index, abbe) != _DEFAULT_GLASS:
        note = f"taken from its index {index:g} and Abbe number {abbe:g}"
        return model_glass(index, abbe), note
    raise entry.wrong(
        f"line {line}: expected a known glass, got {name}: load the catalogue of its maker, "
        "`lensshift lens convert LENS.zmx LENS.toml --glass-catalogue MAKER.agf`"
    )


def _lens(content: _File) -> Lens:
    if not content.entries:
        raise DataError("expected surfaces (SURF), got none")
    if not content.wavelengths_um:
        content.wavelengths_um, content.primary = {1: D_UM}, 1
        content.notes.append("no wavelength is given: taken as 587.6 nm")
    if content.primary not in content.wavelengths_um:
        raise DataError(f"expected a wavelength number {content.primary}", field="PWAV")
    wavelength_nm = 1e3 * content.wavelengths_um[content.primary]
    seen = content.entries[0]
    if seen.distance_mm >= _FAR_MM:
        seen.distance_mm = math.inf
    far = math.isinf(seen.distance_mm)
    if content.aperture is None or (content.aperture[0] == "OBNA" and far):
        what = "no aperture" if content.aperture is None else "a cone from infinitely far"
        content.notes.append(f"{what} is given: the stop is taken as wide as its surface")
        content.aperture = None
    for entry in content.entries[1:-1]:
        shape(entry, content.mm)
        if entry.glass:
            entry.glass, note = glass_in_light(entry.glass, wavelength_nm)
            content.notes += [f"surface {entry.number}: {note}"] if note else []
    _carry_obstructions(content)
    _leave_out_automatic(content)
    image = content.entries[-1]
    shaped = image.type not in ("STANDARD", "COORDBRK") and any(image.parameters.values())
    if image.curvature_per_mm or shaped:
        how = "curved" if image.curvature_per_mm else f"of type {image.type}"
        content.notes.append(f"the image surface is {how}: taken as the plane at its vertex")
    if seen.curvature_per_mm and not far:
        content.notes.append("the object is curved: taken as the plane at its vertex")
    if image.distance_mm:
        content.notes.append(f"surface {image.number}, the last, has more behind it: a part?")
    lens = lens_of_entries(
        content.entries,
        _frames(content.entries),
        content.aperture or ("FLOA", 0.0),
        wavelength_nm,
        content.name,
        temperature_c=content.temperature_c,
        notes=content.notes,
    )
    if content.turned:  # of no account where the lens is refused for what it is
        raise content.turned
    return lens


def _carry_obstructions(content: _File) -> None:
    """Take what hides the middle of a beam in air at the surface that the light meets next.

    That is exact for light from infinitely far along the axis; elsewhere it is left out.
    """
    hidden: Entry | None = None
    far = math.isinf(content.entries[0].distance_mm)
    for before, entry in pairwise(content.entries[:-1]):
        optical = entry.glass or (entry.mirror and entry.curvature_per_mm)
        if hidden is not None and optical:
            entry.inner_mm = max(entry.inner_mm, hidden.inner_mm)
            note = f"its obstruction is taken at surface {entry.number}"
            content.notes.append(f"surface {hidden.number}: {note}")
            hidden = None
        elif entry.inner_mm and not optical and not before.glass:
            if far:
                hidden = entry if hidden is None or hidden.inner_mm < entry.inner_mm else hidden
            else:
                content.notes.append(f"surface {entry.number}: its obstruction is left out")
        far = far and not optical


def _leave_out_automatic(content: _File) -> None:
    """Leave out what the program computed as wide enough for light along the axis alone."""
    told = (content.aperture or ("FLOA", 0.0))[0] == "FLOA"  # the stop is as wide as its surface
    note = (
        "semi-diameters that hold for the axis only, as the file has no other field, are left out"
    )
    for entry in content.entries[1:-1] if content.fields == {0.0} else ():
        kept = (entry.is_stop and told) or entry.inner_mm or entry.type == "COORDBRK"
        if entry.automatic and not kept:
            content.notes.append(note)  # said once in the end
            entry.semi_diameter_mm = 0.0


def _frames(entries: list[Entry]) -> list[Frame]:
    """Return where each surface is, by following distances and coordinate breaks."""
    origin, axes = np.zeros(3), np.eye(3)
    frames = []
    for entry in entries:
        if entry.type == "COORDBRK":
            origin, axes = _break(entry, origin, axes)
        frames.append(Frame(origin, axes))
        if math.isfinite(entry.distance_mm):
            origin = origin + axes[:, 2] * entry.distance_mm
        elif entry is not entries[0] and entry is not entries[-1]:
            raise entry.wrong(f"expected a finite distance, got {entry.distance_mm}")
    return frames


def _break(entry: Entry, origin: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Apply decentre and then tilts about x, y, z, or all in the opposite order."""
    from scipy.spatial.transform import Rotation

    x_mm, y_mm, *tilts_deg, order = (entry.parameters.get(i, 0.0) for i in range(1, 7))
    shift = np.array([x_mm, y_mm, 0.0])
    if order == 0:
        turn = Rotation.from_euler("XYZ", tilts_deg, degrees=True).as_matrix()
        return origin + axes @ shift, axes @ turn
    turned = axes @ Rotation.from_euler("ZYX", tilts_deg[::-1], degrees=True).as_matrix()
    return origin + turned @ shift, turned
