"""Surfaces in a row, as lens design programs have them, made into elements and a lens."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.errors import DataError, about
from lensshift.optics.glass import REFERENCE_TEMPERATURE_C
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.paraxial import entrance_pupil, paraxial
from lensshift.optics.trace import rotations_of

_CLOSE = 1e-9  # of an image plane to the axis, in mm and in direction cosines
_UNSET_STOP_MM = 1e-6  # smaller than any surface
_ROUNDING = 1e-9  # of numbers in files
_HEIGHTS = 257  # where edges cross is found to 1/256 of them
_LEAST_SHARE = 0.5  # of the semi-diameter that must be left where edges cross


@dataclass(slots=True)
class Entry:
    """One surface as written; `line` is that of the file, 0 if there is none."""

    number: int
    line: int = 0
    type: str = "STANDARD"
    line_of_type: int = 0
    curvature_per_mm: float = 0.0
    conic: float = 0.0
    parameters: dict[int, float] = field(default_factory=dict)
    distance_mm: float = 0.0
    semi_diameter_mm: float = 0.0
    automatic: bool = False  # the program computed the semi-diameter
    glass: str = ""
    is_stop: bool = False
    mirror: bool = False
    clear_mm: float = math.inf
    inner_mm: float = 0.0
    comment: str = ""
    extra: dict[int, float] = field(default_factory=dict)
    asphere: tuple[float, ...] = ()
    radial: tuple[float, ...] = ()

    def where(self) -> str:
        """Return how messages name the surface."""
        return f"surface {self.number}" + (f", line {self.line}" if self.line else "")

    def wrong(self, problem: str) -> DataError:
        """Return the error that says what is wrong with the surface."""
        return DataError(problem, field=self.where())


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Where a surface is: origin and axes in (x, y, z) of the object."""

    origin: Floats
    axes: Floats


def lens_of_entries(
    entries: list[Entry],
    frames: list[Frame],
    aperture: tuple[str, float],
    wavelength_nm: float,
    name: str,
    *,
    temperature_c: float = REFERENCE_TEMPERATURE_C,
    notes: list[str] | None = None,
) -> Lens:
    """Return the lens that surfaces from object to image describe.

    Parameters
    ----------
    entries : object, surfaces, image; neighbours with glass between them make an element
    frames : where each of them is, the object at the origin, or any surface if it is infinitely
        far
    aperture : ("ENPD", diameter of the entrance pupil in mm), ("FNUM", f-number), ("WORKING",
        f-number at the image), ("OBNA", numerical aperture at the object), or ("FLOA", 0) for a
        stop as wide as its surface
    wavelength_nm, temperature_c, name : of the lens
    notes : takes what had to be changed

    Raises
    ------
    DataError
        If they describe no lens: with the surface.
    """
    notes = [] if notes is None else notes
    if len(entries) < 3:
        raise DataError(
            f"expected an object, at least one surface and an image, got {len(entries)} surfaces"
        )
    frames = _unfolded(entries, frames)
    groups = list(_groups(entries))
    if not groups:
        raise DataError("expected at least one element of glass or a curved mirror")
    elements = [
        _element([entries[i] for i in group], [frames[i] for i in group], notes) for group in groups
    ]
    starts_mm = np.array([frames[group[0]].origin[2] for group in groups])
    _check_image(frames[-1], entries[-1], elements, notes)
    ends_mm = starts_mm + [element.length_mm for element in elements]
    gaps_mm = np.append(starts_mm[1:], frames[-1].origin[2]) - ends_mm
    gaps_mm[np.abs(gaps_mm) < _CLOSE] = 0.0
    _clear_edges(elements, gaps_mm, [entries[group[-1]] for group in groups], notes)
    stops = [number for number, entry in enumerate(entries) if entry.is_stop]
    if len(stops) != 1:
        raise DataError(f"expected one surface marked STOP, got {len(stops)}")
    far = math.isinf(entries[0].distance_mm)
    lens = Lens(
        elements=tuple(elements),
        gaps_mm=tuple(map(float, gaps_mm)),
        stop=_stop(frames[stops[0]], stops[0], groups, elements, starts_mm),
        object_mm=math.inf if far else float(starts_mm[0]),
        wavelength_nm=wavelength_nm,
        temperature_c=temperature_c,
        name=name,
    )
    return _placed(_with_aperture(lens, aperture, entries[stops[0]], notes), notes)


def _check_image(image: Frame, entry: Entry, elements: list[Element], notes: list[str]) -> None:
    """Refuse an image that the axis does not meet in its middle; say what else is left out."""
    aside_mm = float(np.linalg.norm(image.origin[:2]))
    away = np.abs(np.abs(image.axes[:, 2]) - [0.0, 0.0, 1.0])
    centred = not any(any((*one.decenter_mm, *one.tilt_rad)) for one in elements)
    if away.max() > _CLOSE or (aside_mm > _CLOSE and not centred):
        turned_deg = math.degrees(math.acos(min(1.0, abs(float(image.axes[2, 2])))))
        raise entry.wrong(
            "expected an image plane centred on and across the axis of the object, got one "
            f"{aside_mm:.4g} mm aside and {turned_deg:.4g} degrees turned: light that leaves the "
            "axis, as by a part of a mirror beside its own axis, is not traced"
        )
    if aside_mm > _CLOSE:  # fields beside the axis of a centred lens
        notes.append(f"the image lies {aside_mm:.4g} mm aside: taken on the axis of the lens")


def _clear_edges(
    elements: list[Element], gaps_mm: Floats, last: list[Entry], notes: list[str]
) -> None:
    """Clip neighbours whose edges cross; refuse those that cross on the axis."""
    for number, gap_mm in enumerate(gaps_mm[:-1]):
        if gap_mm < 0:
            raise last[number].wrong(
                f"expected the next element behind it, got {gap_mm:g} mm of air"
            )
        front, back = elements[number : number + 2]
        near, far = trimmed(front.surfaces[-1], back.surfaces[0], float(gap_mm), None, notes)
        elements[number] = replace(front, surfaces=(*front.surfaces[:-1], near))
        elements[number + 1] = replace(back, surfaces=(far, *back.surfaces[1:]))


def _unfolded(entries: list[Entry], frames: list[Frame]) -> list[Frame]:
    """Return the frames as seen in the mirrors in front of them: light goes towards larger z."""
    turn, shift_mm = np.eye(3), np.zeros(3)
    unfolded = []
    for entry, frame in zip(entries, frames, strict=True):
        seen = Frame(turn @ frame.origin + shift_mm, turn @ frame.axes)
        unfolded.append(seen)
        if entry.mirror:
            normal = seen.axes[:, 2]
            across = np.eye(3) - 2.0 * np.outer(normal, normal)
            turn = across @ turn
            shift_mm = across @ (shift_mm - seen.origin) + seen.origin
    return unfolded


def _stop(
    frame: Frame,
    number: int,
    groups: list[list[int]],
    elements: list[Element],
    starts_mm: Floats,
) -> Stop:
    """Return where the stop is, behind which elements, and which decentred one carries it."""
    at_mm = float(frame.origin[2] - starts_mm[0])
    carrier = next((i for i, group in enumerate(groups) if number in group), None)
    behind = sum(group[-1] < number for group in groups) if carrier is None else None
    if np.abs(frame.origin[:2]).max() < _CLOSE:
        return Stop(_UNSET_STOP_MM, at_mm, behind=behind)
    if carrier is None:  # a plane of its own, beside an element that is moved as far
        aside_mm = frame.origin[1::-1]
        carrier = next(
            (i for i, group in enumerate(groups)
             if number in (group[0] - 1, group[-1] + 1)
             and np.abs(elements[i].decenter_mm - aside_mm).max() < _CLOSE), None,
        )  # fmt: skip
    if carrier is None:
        raise DataError("expected a stop on the axis, or on an element", field=f"surface {number}")
    return Stop(_UNSET_STOP_MM, at_mm, carrier, behind)


def _with_aperture(lens: Lens, aperture: tuple[str, float], stop: Entry, notes: list[str]) -> Lens:
    kind, value = aperture
    widest_mm = min(lens.widest_stop_mm(), 2.0 * stop.clear_mm)
    if kind == "FLOA":
        diameter_mm = min(2.0 * stop.semi_diameter_mm or math.inf, widest_mm)
        if math.isinf(diameter_mm):  # nowhere told: what every surface lets through
            diameter_mm = 2.0 * min(surface.semi_diameter_mm for surface in lens.surfaces)
    else:
        position_mm, scale = entrance_pupil(lens)
        pupil_mm = value
        if kind == "FNUM":
            pupil_mm = abs(paraxial(lens).focal_length_mm) / value
        elif kind == "WORKING":  # 1 / (2 F) is the slope at the image, and goes with the stop
            unit = paraxial(replace(lens, stop=replace(lens.stop, diameter_mm=_UNSET_STOP_MM)))
            pupil_mm = unit.entrance_pupil_diameter_mm * unit.working_f_number / value
        elif kind == "OBNA":
            pupil_mm = (
                2.0 * math.tan(math.asin(min(value, 1.0))) * abs(lens.object_mm + position_mm)
            )
        diameter_mm = pupil_mm / abs(scale)
        if diameter_mm > widest_mm * (1.0 + 2.0 * _ROUNDING):
            notes.append(
                f"stop of {diameter_mm:.4g} mm clipped to what is clear at it, {widest_mm:.4g} mm"
            )
        diameter_mm = min(diameter_mm, widest_mm)
    with about(stop.where()):
        return replace(lens, stop=replace(lens.stop, diameter_mm=diameter_mm))


def _placed(lens: Lens, notes: list[str]) -> Lens:
    """Return the lens with a stop that is told by its place alone, where that tells it."""
    name, stop = element_about_stop(lens), lens.stop
    middles_mm = lens.positions_mm()[:-1] + [0.5 * one.length_mm for one in lens.elements]
    if stop.behind is None and name is not None:
        notes.append(f"the stop lies in {name}: taken in the air beside it")
    if name is not None or stop.behind != np.sum(stop.position_mm > middles_mm):
        return lens
    return replace(lens, stop=replace(stop, behind=None))


def element_about_stop(lens: Lens) -> str | None:
    """Return the name of the element in which the rim of the stop lies, not beside its surfaces."""
    at_mm, radius_mm = lens.stop.position_mm, np.array(0.5 * lens.stop.diameter_mm)
    for number, start_mm in enumerate(lens.positions_mm()[:-1]):
        element = lens.elements[number]
        end_mm = start_mm + element.length_mm
        first, last = (element.surfaces[place].sag_mm(radius_mm) for place in (0, -1))
        front_mm, back_mm = max(start_mm, start_mm + first), min(end_mm, end_mm + last)
        if front_mm + _CLOSE < at_mm < back_mm - _CLOSE:
            return lens.called(number)
    return None


def _groups(entries: list[Entry]) -> Iterable[list[int]]:
    """Yield the numbers of the surfaces of each element."""
    group: list[int] = []
    for number, entry in enumerate(entries[:-1]):
        if group and entry.type == "COORDBRK":
            continue  # in glass: the surface behind it leans
        if number == 0:
            if entry.glass:
                raise entry.wrong("expected an object in air")
            continue
        if entry.mirror and group:  # behind it light is in the same glass again
            entry.glass = entries[group[-1]].glass
        plane = not (entry.curvature_per_mm or entry.asphere or entry.radial)
        if group and entry.mirror and plane:
            continue  # in glass: a prism, whose path is unfolded
        if entry.glass or group or (entry.mirror and not plane):
            group.append(number)
        if group and not entry.glass:
            yield group
            group = []
    if group:
        within = entries[group[-1]].glass
        raise entries[-1].wrong(
            f"expected air in front of the image, got {within}: is the file cut off? An image in "
            "glass or a liquid is not traced"
        )


def _element(entries: list[Entry], frames: list[Frame], notes: list[str]) -> Element:
    axis, ahead, thickness_mm = _axis(entries, frames)
    x, y, z = axis
    tilt_rad = (math.atan2(y, z), math.asin(max(-1.0, min(1.0, x))))
    leans_rad = [
        _lean_rad(frame, one, axis, tilt_rad) for frame, one in zip(frames, ahead, strict=True)
    ]
    shapes = [_surface(entry, notes) for entry in entries]
    surfaces = [
        replace(shape if one > 0 else shape.reversed(), tilt_rad=lean_rad)
        for shape, one, lean_rad in zip(shapes, ahead, leans_rad, strict=True)
    ]
    for number, length_mm in enumerate(thickness_mm):
        surfaces[number : number + 2] = trimmed(
            surfaces[number], surfaces[number + 1], length_mm, entries[number].number, notes
        )
    first, last = entries[0].number, entries[-1].number
    name = f"surface {first}" if first == last else f"surfaces {first}-{last}"
    with about(entries[0].where()):
        return Element(
            surfaces=tuple(surfaces),
            glass=tuple(entry.glass for entry in entries[:-1]),
            thickness_mm=tuple(thickness_mm),
            name=entries[0].comment or name,
            decenter_mm=(float(frames[0].origin[1]), float(frames[0].origin[0])),
            tilt_rad=tilt_rad,
        )


def _axis(entries: list[Entry], frames: list[Frame]) -> tuple[Floats, list[float], list[float]]:
    """Return the axis (x, y, z) of an element, the senses of its surfaces, and their distances.

    The axis of its surfaces if they share one, else the line through their vertices. Those that
    light meets from behind, as unfolded mirrors show them, have the sense -1.
    """
    axis = math.copysign(1.0, frames[0].axes[2, 2]) * frames[0].axes[:, 2]
    ahead = [math.copysign(1.0, frame.axes[:, 2] @ axis) for frame in frames]
    from_first = np.array([frame.origin - frames[0].origin for frame in frames])
    normals = np.array([one * frame.axes[:, 2] for frame, one in zip(frames, ahead, strict=True)])
    aside_mm = np.abs(from_first - np.outer(from_first @ axis, axis)).max()
    mirrors = any(entry.mirror for entry in entries)
    if not mirrors and max(np.abs(normals - axis).max(), aside_mm) >= _CLOSE:
        axis = from_first[-1] / np.linalg.norm(from_first[-1])
        if np.abs(from_first - np.outer(from_first @ axis, axis)).max() > _CLOSE:
            raise entries[0].wrong("expected the vertices of an element on one line")
    apart_mm = np.diff(from_first @ axis)
    return axis, ahead, [
        math.copysign(written.distance_mm, length)  # to the last digit, where it is the same
        if abs(abs(written.distance_mm) - abs(length)) < _CLOSE else float(length)
        for written, length in zip(entries[:-1], apart_mm, strict=True)
    ]  # fmt: skip


def _lean_rad(
    frame: Frame, ahead: float, axis: Floats, tilt_rad: tuple[float, float]
) -> tuple[float, float]:
    """Return by how much a surface leans in its element."""
    of_surface = ahead * frame.axes[:, 2]
    if np.abs(of_surface - axis).max() < _CLOSE or of_surface @ axis < 0:  # the same, or mirrored
        return 0.0, 0.0
    row, col, axial = rotations_of(np.array(tilt_rad)).T @ of_surface[[1, 0, 2]]
    return math.atan2(row, axial), math.asin(max(-1.0, min(1.0, col)))


def _surface(entry: Entry, notes: list[str]) -> Surface:
    semi_mm = min(entry.semi_diameter_mm or math.inf, entry.clear_mm)
    bend = math.sqrt(max(0.0, 1.0 + entry.conic)) * abs(entry.curvature_per_mm)
    if math.isfinite(semi_mm) and bend * semi_mm > 1.0 - _ROUNDING:
        if bend * semi_mm > 1.0 + _ROUNDING:
            notes.append(f"surface {entry.number}: clipped to {1.0 / bend:.4g} mm, where it ends")
        semi_mm = (1.0 - _ROUNDING) / bend
    with about(entry.where()):
        return Surface(
            radius_mm=1.0 / entry.curvature_per_mm if entry.curvature_per_mm else math.inf,
            conic=entry.conic,
            asphere=entry.asphere,
            semi_diameter_mm=semi_mm,
            inner_mm=entry.inner_mm,
            radial=entry.radial,
            mirror=entry.mirror,
        )


def trimmed(
    front: Surface, back: Surface, length_mm: float, number: int | None, notes: list[str]
) -> tuple[Surface, Surface]:
    """Return two surfaces as far as the height where they meet, if that is near their edge."""
    edge_mm = min(front.semi_diameter_mm, back.semi_diameter_mm)
    if front.mirror or back.mirror or math.isinf(edge_mm) or not length_mm >= 0:
        return front, back
    heights_mm = np.linspace(0.0, edge_mm, _HEIGHTS)
    room_mm = length_mm + back.sag_mm(heights_mm) - front.sag_mm(heights_mm)
    crossed = ~(room_mm >= 0)
    if not crossed.any():
        return front, back
    meets_mm = float(heights_mm[max(0, int(crossed.argmax()) - 1)])
    if meets_mm < _LEAST_SHARE * edge_mm:
        return front, back  # no lens: its own check tells
    where = "air" if number is None else f"surface {number}"
    notes.append(f"{where}: edges cross, clipped to {meets_mm:.4g} mm")
    return (
        replace(front, semi_diameter_mm=min(front.semi_diameter_mm, meets_mm)),
        replace(back, semi_diameter_mm=min(back.semi_diameter_mm, meets_mm)),
    )
