"""What of a lens may change when it is designed, as a vector."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.optics.lens import Element, Lens, Surface

_MOST_TERMS = 20  # of an asphere: more are no numbers
_LEAST_MM = 1e-3  # of a thickness, and of the room behind the stop


@dataclass(frozen=True, slots=True)
class Freedom:
    """What may change.

    Parameters
    ----------
    elements : numbers, from 0, of the elements that are made to order; others are stock lenses,
        which stay whole; None: all but plates
    radii, thicknesses : of those elements
    planes : keep their plane surfaces plane
    conics : of the aspheric ones among them
    aspheres : how many terms A4, A6, ... of their surfaces
    aspheric : numbers of the elements that have aspheres; None: all that are made
    gaps : the air between all elements, and the distance of the sensor; a last plate keeps its own
    stop : the place of a stop between elements

    Raises
    ------
    ValueError
        If the number of terms is out of range, or elements are aspheric in nothing or not made.
    """

    elements: tuple[int, ...] | None = None
    radii: bool = True
    thicknesses: bool = False
    planes: bool = False
    conics: bool = False
    aspheres: int = 0
    aspheric: tuple[int, ...] | None = None
    gaps: bool = True
    stop: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.aspheres <= _MOST_TERMS:
            raise ValueError(f"expected 0 to {_MOST_TERMS} terms, got {self.aspheres}")
        if self.aspheric is not None:
            if not (self.aspheres or self.conics):
                raise ValueError("expected aspheres or conics for the elements that are aspheric")
            if self.elements is not None and not set(self.aspheric) <= set(self.elements):
                made, got = ([n + 1 for n in of] for of in (self.elements, self.aspheric))
                raise ValueError(f"expected aspheric elements among those made, {made}, got {got}")


class _Slot(NamedTuple):
    """One number of a lens: of which surface, or of the space behind which, and a unit step."""

    kind: str
    place: int
    unit: float


class Variables:
    """The numbers of a lens that may change, each scaled so that a unit is a large step.

    Parameters
    ----------
    lens : to start from
    freedom : what may change
    semi_mm : [surface] height up to which each surface is used: the scale of its numbers

    Raises
    ------
    ValueError
        If there is no such element, or nothing may change.
    """

    def __init__(self, lens: Lens, freedom: Freedom, semi_mm: Floats) -> None:
        self._lens = lens
        made = freedom.elements
        if made is None:
            made = tuple(n for n, one in enumerate(lens.elements) if not is_plate(one))
        for number in made:
            lens.check_element(number)
        self.made = made
        before = sum(len(one.surfaces) for one in lens.elements[: lens.elements_before_stop()])
        self._front = before - 1  # the last vertex in front of the stop
        self._stop_mm = lens.stop.position_mm - sum(lens.spaces_mm()[: max(self._front, 0)])
        self._slots = self._found(freedom, semi_mm)
        if not self._slots:
            raise ValueError("expected something that may change, got a lens that stays as it is")

    def _found(self, freedom: Freedom, semi_mm: Floats) -> list[_Slot]:
        lens, slots, first = self._lens, [], 0
        long_mm = 0.2 * float(lens.positions_mm()[-1])
        for number, element in enumerate(lens.elements):
            last = first + len(element.surfaces) - 1
            for place in range(first, last + 1) if number in self.made else ():
                height_mm = float(semi_mm[place])
                if freedom.planes and math.isinf(lens.surfaces[place].radius_mm):
                    continue
                if freedom.radii:
                    slots.append(_Slot("curvature", place, 1.0 / height_mm))
                if freedom.aspheric is not None and number not in freedom.aspheric:
                    continue
                if freedom.conics:
                    slots.append(_Slot("conic", place, 1.0))
                for power in range(freedom.aspheres):
                    unit = 0.1 * height_mm ** -(3.0 + 2.0 * power)
                    slots.append(_Slot(f"asphere {power}", place, unit))
            if freedom.thicknesses and number in self.made:
                slots += [_Slot("thickness", place, long_mm) for place in range(first, last)]
            first = last + 1
        if freedom.gaps:
            ends = np.cumsum([len(element.surfaces) for element in lens.elements]) - 1
            kept = ends[:-1] if is_plate(lens.elements[-1]) and len(ends) > 1 else ends
            slots += [_Slot("gap", int(place), long_mm) for place in kept]
        if freedom.stop and lens.stop.behind is None and 0 <= self._front < first - 1:
            slots.append(_Slot("stop", 0, long_mm))
        return slots

    def start(self) -> Floats:
        """Return the vector of the lens that this started from."""
        values = []
        for kind, place, unit in self._slots:
            surface, space_mm = self._lens.surfaces[place], self._lens.spaces_mm()[place]
            numbers = {"curvature": surface.curvature_per_mm, "conic": surface.conic}
            numbers |= {f"asphere {power}": term for power, term in enumerate(surface.asphere)}
            numbers |= {"thickness": space_mm, "gap": space_mm, "stop": self._stop_mm}
            values.append(numbers.get(kind, 0.0) / unit)
        return np.array(values)

    def missing_mm(self, vector: Floats, glass_mm: Floats, air_mm: float, back_mm: float) -> Floats:
        """Return how far each thickness and gap is from its limits, [variable].

        Parameters
        ----------
        glass_mm : [2] least and most thickness of glass
        air_mm, back_mm : least gap between elements, and to the sensor
        """
        bounds = {"thickness": (glass_mm[0], glass_mm[1]), "gap": (air_mm, np.inf)}
        bounds |= {"stop": (0.0, np.inf), "back": (back_mm, np.inf)}
        last = len(self._lens.surfaces) - 1
        kinds = (
            "back" if (one.kind, one.place) == ("gap", last) else one.kind for one in self._slots
        )
        low, high = np.transpose([bounds.get(kind, (-np.inf, np.inf)) for kind in kinds])
        value = vector * np.array([slot.unit for slot in self._slots])
        return np.asarray(np.maximum(low - value, 0.0) + np.maximum(value - high, 0.0))

    def lens(self, vector: Floats) -> Lens:
        """Return the lens of a vector, without edges."""
        lens, front, stop_mm = self._lens, self._front, self._stop_mm
        surfaces = [replace(one, semi_diameter_mm=math.inf) for one in lens.surfaces]
        spaces_mm = list(lens.spaces_mm())
        for slot, number in zip(self._slots, vector, strict=True):
            value = float(number) * slot.unit
            if slot.kind == "stop":
                stop_mm = max(value, 0.0)
            elif slot.kind in ("gap", "thickness"):
                spaces_mm[slot.place] = max(value, 0.0 if slot.kind == "gap" else _LEAST_MM)
            else:
                surfaces[slot.place] = _changed(surfaces[slot.place], slot.kind, value)
        if lens.stop.behind is None and 0 <= front < len(surfaces) - 1:  # the stop takes its room
            spaces_mm[front] = max(spaces_mm[front], stop_mm + _LEAST_MM)
        at_mm = sum(spaces_mm[: max(front, 0)]) + stop_mm
        elements, gaps, left = [], [], iter(zip(surfaces, spaces_mm, strict=True))
        for element in lens.elements:
            of, long = zip(*islice(left, len(element.surfaces)), strict=True)
            elements.append(replace(element, surfaces=of, thickness_mm=long[:-1]))
            gaps.append(long[-1])
        stop = replace(lens.stop, position_mm=at_mm)
        return replace(lens, elements=tuple(elements), gaps_mm=tuple(gaps), stop=stop)


def is_plate(element: Element) -> bool:
    """Tell whether an element has plane surfaces only."""
    return not any(one.curvature_per_mm or one.asphere or one.radial for one in element.surfaces)


def _changed(surface: Surface, kind: str, value: float) -> Surface:
    if kind == "curvature":
        return replace(surface, radius_mm=1.0 / value if value else math.inf)
    if kind == "conic":
        return replace(surface, conic=value)
    number = int(kind.split()[1])
    terms = [*surface.asphere, *[0.0] * (number + 1 - len(surface.asphere))]
    terms[number] = value
    return replace(surface, asphere=tuple(terms))
