"""What of a lens may change when it is designed, as a vector."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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


@dataclass(frozen=True, slots=True)
class _Slot:
    """One number of a lens: which, and what a unit step of the vector changes."""

    kind: str
    element: int
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
        self._before = lens.elements_before_stop()
        made = freedom.elements
        if made is None:
            made = tuple(n for n, one in enumerate(lens.elements) if not is_plate(one))
        for number in made:
            lens.check_element(number)
        self.made = made
        before_mm = 0.0  # where the last vertex in front of the stop is
        if self._before:
            front = self._before - 1
            before_mm = float(lens.positions_mm()[front] + lens.elements[front].length_mm)
        self._stop_mm = lens.stop.position_mm - before_mm
        self._slots = self._found(freedom, semi_mm)
        if not self._slots:
            raise ValueError("expected something that may change, got a lens that stays as it is")

    def _found(self, freedom: Freedom, semi_mm: Floats) -> list[_Slot]:
        lens, slots, first = self._lens, [], 0
        long_mm = float(lens.positions_mm()[-1])
        for number, element in enumerate(lens.elements):
            heights = semi_mm[first : first + len(element.surfaces)]
            first += len(element.surfaces)
            if number not in self.made:
                continue
            for place, height_mm in enumerate(heights):
                if freedom.planes and math.isinf(element.surfaces[place].radius_mm):
                    continue
                if freedom.radii:
                    slots.append(_Slot("curvature", number, place, 1.0 / height_mm))
                if freedom.aspheric is not None and number not in freedom.aspheric:
                    continue
                if freedom.conics:
                    slots.append(_Slot("conic", number, place, 1.0))
                for power in range(freedom.aspheres):
                    unit = 0.1 * height_mm ** -(3.0 + 2.0 * power)
                    slots.append(_Slot(f"asphere {power}", number, place, unit))
            if freedom.thicknesses:
                slots += [
                    _Slot("thickness", number, place, 0.2 * long_mm)
                    for place in range(len(element.thickness_mm))
                ]
        if freedom.gaps:
            kept = len(lens.gaps_mm) - (1 if is_plate(lens.elements[-1]) else 0)
            slots += [_Slot("gap", number, 0, 0.2 * long_mm) for number in range(max(kept, 1))]
        if freedom.stop and 0 < self._before < len(lens.elements):
            slots.append(_Slot("stop", 0, 0, 0.2 * long_mm))
        return slots

    def start(self) -> Floats:
        """Return the vector of the lens that this started from."""
        lens = self._lens
        values = []
        for slot in self._slots:
            element = lens.elements[slot.element]
            kind, _, power = slot.kind.partition(" ")
            if kind in ("curvature", "conic", "asphere"):
                surface = element.surfaces[slot.place]
                terms = (*surface.asphere, *[0.0] * _MOST_TERMS)
                value = {"curvature": surface.curvature_per_mm, "conic": surface.conic}.get(
                    kind, terms[int(power or 0)]
                )
            elif kind == "thickness":
                value = element.thickness_mm[slot.place]
            else:
                value = lens.gaps_mm[slot.element] if kind == "gap" else self._stop_mm
            values.append(value / slot.unit)
        return np.array(values)

    def missing_mm(self, vector: Floats, glass_mm: Floats, air_mm: float, back_mm: float) -> Floats:
        """Return how far each thickness and gap is from its limits, [variable].

        Parameters
        ----------
        glass_mm : [2] least and most thickness of glass
        air_mm, back_mm : least gap between elements, and to the sensor
        """
        low, high = np.full(len(self._slots), -np.inf), np.full(len(self._slots), np.inf)
        for number, slot in enumerate(self._slots):
            if slot.kind == "thickness":
                low[number], high[number] = glass_mm
            elif slot.kind == "gap":
                last = slot.element + 1 == len(self._lens.elements)
                low[number] = back_mm if last else air_mm
            elif slot.kind == "stop":
                low[number] = 0.0
        value = vector * np.array([slot.unit for slot in self._slots])
        return np.asarray(np.maximum(low - value, 0.0) + np.maximum(value - high, 0.0))

    def lens(self, vector: Floats) -> Lens:
        """Return the lens of a vector, without edges."""
        lens = self._lens
        surfaces = [
            [replace(one, semi_diameter_mm=math.inf) for one in element.surfaces]
            for element in lens.elements
        ]
        thickness = [list(element.thickness_mm) for element in lens.elements]
        gaps, stop_mm = list(lens.gaps_mm), self._stop_mm
        for slot, number in zip(self._slots, vector, strict=True):
            value = float(number) * slot.unit
            if slot.kind == "gap":
                gaps[slot.element] = max(value, 0.0)
            elif slot.kind == "thickness":
                thickness[slot.element][slot.place] = max(value, _LEAST_MM)
            elif slot.kind == "stop":
                stop_mm = max(value, 0.0)
            else:
                here = surfaces[slot.element]
                here[slot.place] = _changed(here[slot.place], slot.kind, value)
        elements = tuple(
            replace(element, surfaces=tuple(of), thickness_mm=tuple(long))
            for element, of, long in zip(lens.elements, surfaces, thickness, strict=True)
        )
        at_mm = stop_mm
        for number in range(self._before):
            at_mm += elements[number].length_mm + (gaps[number] if number + 1 < self._before else 0)
        if 0 < self._before < len(elements):  # the stop takes its room
            gaps[self._before - 1] = max(gaps[self._before - 1], stop_mm + _LEAST_MM)
        return replace(
            lens, elements=elements, gaps_mm=tuple(gaps), stop=replace(lens.stop, position_mm=at_mm)
        )


def is_plate(element: Element) -> bool:
    """Tell whether an element has plane surfaces only."""
    return all(surface.curvature_per_mm == 0 for surface in element.surfaces) and not any(
        surface.asphere or surface.radial for surface in element.surfaces
    )


def _changed(surface: Surface, kind: str, value: float) -> Surface:
    if kind == "curvature":
        return replace(surface, radius_mm=1.0 / value if value else math.inf)
    if kind == "conic":
        return replace(surface, conic=value)
    number = int(kind.split()[1])
    terms = [*surface.asphere, *[0.0] * (number + 1 - len(surface.asphere))]
    terms[number] = value
    return replace(surface, asphere=tuple(terms))
