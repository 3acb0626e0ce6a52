"""Surfaces in a row, as lens design programs have them, made into elements and a lens."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.paraxial import entrance_pupil, paraxial

_CLOSE = 1e-9  # of an image plane to the axis, in mm and in direction cosines
_UNSET_STOP_MM = 1e-6


@dataclass(slots=True)
class Entry:
    """One surface as written; `line` is that of the file, 0 if there is none."""

    number: int
    line: int = 0
    type: str = "STANDARD"
    curvature_per_mm: float = 0.0
    conic: float = 0.0
    parameters: dict[int, float] = field(default_factory=dict)
    distance_mm: float = 0.0
    semi_diameter_mm: float = 0.0
    glass: str = ""
    is_stop: bool = False

    def where(self) -> str:
        """Return how messages name the surface."""
        return f"surface {self.number}" + (f", line {self.line}" if self.line else "")


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Where a surface is: origin and axes in (x, y, z) of the object."""

    origin: NDArray[np.float64]
    axes: NDArray[np.float64]


def lens_of_entries(
    entries: list[Entry],
    frames: list[Frame],
    aperture: tuple[str, float],
    wavelength_nm: float,
    name: str,
) -> Lens:
    """Return the lens that surfaces from object to image describe.

    Parameters
    ----------
    entries : object, surfaces, image; neighbours with glass between them make an element
    frames : where each of them is, the object at the origin, or any surface if it is infinitely
        far
    aperture : ("ENPD", diameter of the entrance pupil in mm), ("FNUM", f-number), or ("FLOA", 0)
        for a stop as wide as its surface
    wavelength_nm, name : of the lens

    Raises
    ------
    DataError
        If they describe no lens: with the surface.
    """
    if len(entries) < 4:
        raise DataError(
            f"expected an object, at least two surfaces and an image, got {len(entries)} surfaces"
        )
    groups = list(_groups(entries))
    if not groups:
        raise DataError("expected at least one element of glass")
    elements = [_element([entries[i] for i in group], frames[group[0]]) for group in groups]
    starts_mm = np.array([frames[group[0]].origin[2] for group in groups])
    ends_mm = starts_mm + [element.length_mm for element in elements]
    image = frames[-1]
    if np.abs(image.origin[:2]).max() > _CLOSE or np.abs(image.axes - np.eye(3)).max() > _CLOSE:
        raise DataError(
            "expected an image plane centred on and across the axis of the object",
            field=entries[-1].where(),
        )
    gaps_mm = np.append(starts_mm[1:], image.origin[2]) - ends_mm
    gaps_mm[np.abs(gaps_mm) < _CLOSE] = 0.0
    stops = [number for number, entry in enumerate(entries) if entry.is_stop]
    if len(stops) != 1:
        raise DataError(f"expected one surface marked STOP, got {len(stops)}")
    far = math.isinf(entries[0].distance_mm)
    lens = Lens(
        elements=tuple(elements),
        gaps_mm=tuple(map(float, gaps_mm)),
        stop=Stop(_UNSET_STOP_MM, float(frames[stops[0]].origin[2] - starts_mm[0])),
        object_mm=math.inf if far else float(starts_mm[0]),
        wavelength_nm=wavelength_nm,
        name=name,
    )
    return _with_aperture(lens, aperture, entries[stops[0]])


def _with_aperture(lens: Lens, aperture: tuple[str, float], stop: Entry) -> Lens:
    kind, value = aperture
    if kind == "FLOA":
        diameter_mm = 2.0 * stop.semi_diameter_mm
    else:
        pupil_mm = value if kind == "ENPD" else abs(paraxial(lens).focal_length_mm) / value
        diameter_mm = pupil_mm / abs(entrance_pupil(lens)[1])
    try:
        return replace(lens, stop=replace(lens.stop, diameter_mm=diameter_mm))
    except ValueError as error:
        raise DataError(str(error), field=stop.where()) from error


def _groups(entries: list[Entry]) -> Iterable[list[int]]:
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


def _element(entries: list[Entry], frame: Frame) -> Element:
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


def _surface(entry: Entry) -> Surface:
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
