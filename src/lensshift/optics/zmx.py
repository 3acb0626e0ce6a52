"""Read sequential Zemax files (.zmx): standard and even aspheric surfaces, coordinate breaks."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.optics.glass import GLASSES, glass_called
from lensshift.optics.lens import Lens
from lensshift.optics.sequential import Entry, Frame, lens_of_entries

_TYPES = ("STANDARD", "EVENASPH", "COORDBRK")
_MOST_PARAMETERS = 8  # an even asphere ends with r^16


@dataclass(slots=True)
class _File:
    """The contents of a file, as written."""

    entries: list[Entry] = field(default_factory=list)
    name: str = ""
    wavelengths_um: dict[int, float] = field(default_factory=dict)
    primary: int = 1
    aperture: tuple[str, float] = ("FLOA", 0.0)


def load_zmx(path: str | Path) -> Lens:
    """Read a lens from a sequential .zmx file.

    Neighbouring surfaces with glass between them make an element; coordinate breaks between
    elements become its decentre and tilt. Entries that say nothing about the path of the light
    (fields, coatings, solves, display) are skipped.

    Raises
    ------
    DataError
        If the file is missing, malformed, uses something else than surfaces STANDARD, EVENASPH
        and COORDBRK, an unknown glass or a mirror, or describes no lens: with file, line and
        surface.
    """
    if Path(path).exists() and not Path(path).is_file():
        raise DataError("cannot read: expected a file, not a folder, device or pipe", source=path)
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot read: {error.strerror or error}", source=path) from error
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return parse_zmx(raw.decode(encoding))
    except UnicodeDecodeError as error:
        raise DataError("expected a text file in UTF-8 or UTF-16", source=path) from error
    except DataError as error:
        raise error.in_file(path) from error


def parse_zmx(text: str) -> Lens:
    """Return the lens that the text of a .zmx file describes; see `load_zmx`."""
    content = _read(text)
    try:
        return _lens(content)
    except DataError:
        raise
    except ValueError as error:
        raise DataError(str(error)) from error


def _read(text: str) -> _File:
    content = _File()
    for number, line in enumerate(text.splitlines(), start=1):
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
    elif content.entries:
        _read_surface_line(content.entries[-1], key, values, line)
    elif key == "MODE" and values[0] != "SEQ":
        raise DataError(f"expected a sequential file, got mode {values[0]}", field=f"line {line}")
    elif key == "UNIT" and values[0] != "MM":
        raise DataError(f"expected lengths in MM, got {values[0]}", field=f"line {line}")
    elif key == "NAME":
        content.name = " ".join(values)
    elif key == "WAVM":
        content.wavelengths_um[int(values[0])] = float(values[1])
    elif key == "WAVL":
        content.wavelengths_um.update({i: float(v) for i, v in enumerate(values, start=1)})
    elif key == "PWAV":
        content.primary = int(values[0])
    elif key in ("ENPD", "FNUM"):
        if not float(values[0]) > 0:
            raise DataError(f"expected a positive {key}, got {values[0]}", field=f"line {line}")
        content.aperture = (key, float(values[0]))


def _read_surface_line(entry: Entry, key: str, values: list[str], line: int) -> None:
    if key == "TYPE":
        if values[0] not in _TYPES:
            raise DataError(
                f"line {line}: expected a surface of type {', '.join(_TYPES)}, got {values[0]}",
                field=entry.where(),
            )
        entry.type = values[0]
    elif key == "CURV":
        entry.curvature_per_mm = _finite(values[0])
    elif key == "CONI":
        entry.conic = _finite(values[0])
    elif key == "PARM":
        number = int(values[0])
        if not 0 <= number <= _MOST_PARAMETERS:
            raise DataError(
                f"line {line}: expected a parameter up to {_MOST_PARAMETERS}, got {number}",
                field=entry.where(),
            )
        entry.parameters[number] = _finite(values[1])
    elif key == "DISZ":
        entry.distance_mm = float(values[0])  # also reads INFINITY
    elif key == "DIAM":
        entry.semi_diameter_mm = float(values[0])
    elif key == "GLAS":
        entry.glass = _glass(values[0], entry, line)
    elif key == "STOP":
        entry.is_stop = True


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {word}")
    return value


def _glass(name: str, entry: Entry, line: int) -> str:
    glass = glass_called(name)
    if glass is None:
        raise DataError(
            f"line {line}: expected a glass of {', '.join(GLASSES)}, got {name}",
            field=entry.where(),
        )
    return glass


def _lens(content: _File) -> Lens:
    if not content.entries:
        raise DataError("expected surfaces (SURF), got none")
    if content.primary not in content.wavelengths_um:
        raise DataError(f"expected a wavelength number {content.primary}", field="PWAV")
    return lens_of_entries(
        content.entries,
        _frames(content.entries),
        content.aperture,
        1e3 * content.wavelengths_um[content.primary],
        content.name,
    )


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
        elif entry is not entries[0]:
            raise DataError(
                f"expected a finite distance, got {entry.distance_mm}", field=entry.where()
            )
    return frames


def _break(
    entry: Entry, origin: NDArray[np.float64], axes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Apply decentre and then tilts about x, y, z, or all in the opposite order."""
    value = [entry.parameters.get(i, 0.0) for i in range(1, 7)]
    shift = np.array([value[0], value[1], 0.0])
    about_x, about_y, about_z = (
        _rotation(axis, math.radians(value[2 + axis])) for axis in range(3)
    )
    if value[5] == 0:
        return origin + axes @ shift, axes @ about_x @ about_y @ about_z
    turned = axes @ about_z @ about_y @ about_x
    return origin + turned @ shift, turned


def _rotation(axis: int, angle_rad: float) -> NDArray[np.float64]:
    """Return the right-handed rotation about the x, y or z axis."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = math.cos(angle_rad)
    matrix[second, first], matrix[first, second] = math.sin(angle_rad), -math.sin(angle_rad)
    return matrix
