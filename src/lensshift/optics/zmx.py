"""Read sequential Zemax files (.zmx): standard and even aspheric surfaces, coordinate breaks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.optics.glass import GLASSES
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.paraxial import entrance_pupil, paraxial

_TYPES = ("STANDARD", "EVENASPH", "COORDBRK")
_GLASS_NAMES = {"F_SILICA": "fused silica", "SILICA": "fused silica", "UVFS": "fused silica"}
_CLOSE = 1e-9  # of an image plane to the axis, in mm and in direction cosines
_UNSET_STOP_MM = 1e-6
_MOST_PARAMETERS = 8  # an even asphere ends with r^16


@dataclass(slots=True)
class _Entry:
    """One surface of the file, as written."""

    number: int
    line: int
    type: str = "STANDARD"
    curvature_per_mm: float = 0.0
    conic: float = 0.0
    parameters: dict[int, float] = field(default_factory=dict)
    distance_mm: float = 0.0
    semi_diameter_mm: float = 0.0
    glass: str = ""
    is_stop: bool = False

    def where(self) -> str:
        return f"surface {self.number}, line {self.line}"


@dataclass(slots=True)
class _File:
    """The contents of a file, as written."""

    entries: list[_Entry] = field(default_factory=list)
    name: str = ""
    wavelengths_um: dict[int, float] = field(default_factory=dict)
    primary: int = 1
    aperture: tuple[str, float] = ("FLOA", 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """Where a surface is: origin and axes in (x, y, z) of the object."""

    origin: NDArray[np.float64]
    axes: NDArray[np.float64]


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
        content.entries.append(_Entry(int(values[0]), line))
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


def _read_surface_line(entry: _Entry, key: str, values: list[str], line: int) -> None:
    if key == "TYPE":
        if values[0] not in _TYPES:
            raise DataError(
                f"line {line}: expected a surface of type {', '.join(_TYPES)}, got {values[0]}",
                field=entry.where(),
            )
        entry.type = values[0]
    elif key == "CURV":
        entry.curvature_per_mm = float(values[0])
    elif key == "CONI":
        entry.conic = float(values[0])
    elif key == "PARM":
        number = int(values[0])
        if not 0 <= number <= _MOST_PARAMETERS:
            raise DataError(
                f"line {line}: expected a parameter up to {_MOST_PARAMETERS}, got {number}",
                field=entry.where(),
            )
        entry.parameters[number] = float(values[1])
    elif key == "DISZ":
        entry.distance_mm = float(values[0])  # also reads INFINITY
    elif key == "DIAM":
        entry.semi_diameter_mm = float(values[0])
    elif key == "GLAS":
        entry.glass = _glass(values[0], entry, line)
    elif key == "STOP":
        entry.is_stop = True


def _glass(name: str, entry: _Entry, line: int) -> str:
    glass = _GLASS_NAMES.get(name.upper(), name.upper())
    if glass not in GLASSES:
        raise DataError(
            f"line {line}: expected a glass of {', '.join(GLASSES)}, got {name}",
            field=entry.where(),
        )
    return glass


def _lens(content: _File) -> Lens:
    if len(content.entries) < 4:
        raise DataError(
            f"expected an object, at least two surfaces and an image, got "
            f"{len(content.entries)} surfaces"
        )
    frames = _frames(content.entries)
    groups = list(_groups(content.entries))
    if not groups:
        raise DataError("expected at least one element of glass")
    elements = [_element([content.entries[i] for i in g], frames[g[0]]) for g in groups]
    starts_mm = np.array([frames[group[0]].origin[2] for group in groups])
    ends_mm = starts_mm + [element.length_mm for element in elements]
    image = frames[-1]
    if np.abs(image.origin[:2]).max() > _CLOSE or np.abs(image.axes - np.eye(3)).max() > _CLOSE:
        raise DataError(
            "expected an image plane centred on and across the axis of the object",
            field=content.entries[-1].where(),
        )
    gaps_mm = np.append(starts_mm[1:], image.origin[2]) - ends_mm
    gaps_mm[np.abs(gaps_mm) < _CLOSE] = 0.0
    stops = [i for i, entry in enumerate(content.entries) if entry.is_stop]
    if len(stops) != 1:
        raise DataError(f"expected one surface marked STOP, got {len(stops)}")
    if content.primary not in content.wavelengths_um:
        raise DataError(f"expected a wavelength number {content.primary}", field="PWAV")
    far = math.isinf(content.entries[0].distance_mm)
    lens = Lens(
        elements=tuple(elements),
        gaps_mm=tuple(map(float, gaps_mm)),
        stop=Stop(_UNSET_STOP_MM, float(frames[stops[0]].origin[2] - starts_mm[0])),
        object_mm=math.inf if far else float(starts_mm[0]),
        wavelength_nm=1e3 * content.wavelengths_um[content.primary],
        name=content.name,
    )
    return _with_aperture(lens, content, content.entries[stops[0]])


def _with_aperture(lens: Lens, content: _File, stop: _Entry) -> Lens:
    kind, value = content.aperture
    if kind == "FLOA":
        diameter_mm = 2.0 * stop.semi_diameter_mm
    else:
        pupil_mm = value if kind == "ENPD" else abs(paraxial(lens).focal_length_mm) / value
        diameter_mm = pupil_mm / abs(entrance_pupil(lens)[1])
    try:
        return replace(lens, stop=replace(lens.stop, diameter_mm=diameter_mm))
    except ValueError as error:
        raise DataError(str(error), field=stop.where()) from error


def _frames(entries: list[_Entry]) -> list[_Frame]:
    """Return where each surface is, by following distances and coordinate breaks."""
    origin, axes = np.zeros(3), np.eye(3)
    frames = []
    for entry in entries:
        if entry.type == "COORDBRK":
            origin, axes = _break(entry, origin, axes)
        frames.append(_Frame(origin, axes))
        if math.isfinite(entry.distance_mm):
            origin = origin + axes[:, 2] * entry.distance_mm
        elif entry is not entries[0]:
            raise DataError(
                f"expected a finite distance, got {entry.distance_mm}", field=entry.where()
            )
    return frames


def _break(
    entry: _Entry, origin: NDArray[np.float64], axes: NDArray[np.float64]
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


def _groups(entries: list[_Entry]) -> Iterable[list[int]]:
    """Yield the numbers of the surfaces of each element."""
    group: list[int] = []
    for number, entry in enumerate(entries[:-1]):
        if group and entry.type == "COORDBRK":
            raise DataError("expected no coordinate break inside an element", field=entry.where())
        if entry.glass or group:
            group.append(number)
        if group and not entry.glass:
            yield group
            group = []
    if group:
        raise DataError("expected air in front of the image", field=entries[-1].where())


def _element(entries: list[_Entry], frame: _Frame) -> Element:
    x, y, z = frame.axes[:, 2]
    try:
        return Element(
            surfaces=tuple(_surface(entry) for entry in entries),
            glass=tuple(entry.glass for entry in entries[:-1]),
            thickness_mm=tuple(entry.distance_mm for entry in entries[:-1]),
            name=f"surfaces {entries[0].number}-{entries[-1].number}",
            decenter_mm=(float(frame.origin[1]), float(frame.origin[0])),
            tilt_rad=(math.atan2(y, z), math.asin(max(-1.0, min(1.0, x)))),
        )
    except DataError:
        raise
    except ValueError as error:
        raise DataError(str(error), field=entries[0].where()) from error


def _surface(entry: _Entry) -> Surface:
    asphere: tuple[float, ...] = ()
    if entry.type == "EVENASPH":
        if entry.parameters.get(1, 0.0):
            raise DataError("expected no term in r^2 in an EVENASPH", field=entry.where())
        last = max((i for i, value in entry.parameters.items() if value), default=1)
        asphere = tuple(entry.parameters.get(i, 0.0) for i in range(2, last + 1))
    try:
        return Surface(
            radius_mm=1.0 / entry.curvature_per_mm if entry.curvature_per_mm else math.inf,
            conic=entry.conic,
            asphere=asphere,
            semi_diameter_mm=entry.semi_diameter_mm or math.inf,
        )
    except ValueError as error:
        raise DataError(str(error), field=entry.where()) from error
