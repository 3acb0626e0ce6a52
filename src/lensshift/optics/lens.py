"""The lens as data: surfaces make elements, elements and gaps make a lens."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.optics.glass import REFERENCE_TEMPERATURE_C, glass_data, refractive_index

WAVELENGTH_NM = 850.0  # near infrared of time-of-flight cameras: 9 of 11 in prescriptions
_ABSOLUTE_ZERO_C = -273.15
_CLOSE_MM = 1e-9  # of the stop to a vertex: rounding
_CHECKED_HEIGHTS = np.linspace(0.0, 1.0, 33)  # of the smaller semi-diameter


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface of revolution, refracting or reflecting.

        z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + A4 r^4 + A6 r^6 + ... + B1 r + B2 r^2 + ...

    with c = 1 / radius. Behind a mirror everything is drawn unfolded, as its image in the plane
    through the vertex, so that light always travels to larger z.

    Parameters
    ----------
    radius_mm : positive if the centre of curvature lies behind the vertex, infinite for a plane
    conic : k; 0 is a sphere, -1 a paraboloid
    asphere : A4, A6, A8, ... in mm^-3, mm^-5, mm^-7, ...
    semi_diameter_mm : light farther from the axis of the element is stopped
    radial : B1, B2, B3, ... in mm^0, mm^-1, mm^-2, ...
    mirror : whether it reflects
    inner_mm : light nearer to the axis of the element is stopped: by a hole in a mirror, or by
        what stands in front of it; needs a semi-diameter
    tilt_rad : (row, col) by how much its axis leans in the element, about its own vertex, as
        `Element.tilt_rad`; makes a wedge. First-order data leave it out.

    Raises
    ------
    ValueError
        If a number is out of range or the surface ends before its semi-diameter.
    """

    radius_mm: float
    conic: float = 0.0
    asphere: tuple[float, ...] = ()
    semi_diameter_mm: float = math.inf
    radial: tuple[float, ...] = ()
    mirror: bool = False
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    inner_mm: float = 0.0

    def __post_init__(self) -> None:
        if self.inner_mm and not 0 < self.inner_mm < self.semi_diameter_mm < math.inf:
            raise ValueError(
                f"expected inner_mm from 0 to below the semi-diameter {self.semi_diameter_mm} mm, "
                f"which is finite, got {self.inner_mm}"
            )
        if math.isnan(self.radius_mm) or self.radius_mm == 0:
            raise ValueError(f"expected a radius other than 0 mm, got {self.radius_mm}")
        if not self.semi_diameter_mm > 0:
            raise ValueError(f"expected a positive semi-diameter, got {self.semi_diameter_mm} mm")
        numbers = (self.conic, *self.asphere, *self.radial, *self.tilt_rad)
        if not all(math.isfinite(value) for value in numbers):
            raise ValueError("expected a finite conic constant, asphere coefficients and tilt")
        if self.mirror and any(self.tilt_rad):
            raise ValueError("expected a mirror that leans with its whole element")
        bend = (1.0 + self.conic) * self.curvature_per_mm**2
        if math.isfinite(self.semi_diameter_mm) and bend * self.semi_diameter_mm**2 > 1.0:
            raise ValueError(
                f"expected a semi-diameter up to {bend**-0.5:.4f} mm for radius {self.radius_mm} "
                f"mm and conic {self.conic}, got {self.semi_diameter_mm} mm"
            )

    @property
    def curvature_per_mm(self) -> float:
        """1 / radius, 0 for a plane."""
        return 1.0 / self.radius_mm

    @property
    def vertex_curvature_per_mm(self) -> float:
        """Second derivative of the sag on the axis, for paraxial rays."""
        return self.curvature_per_mm + (2.0 * self.radial[1] if len(self.radial) > 1 else 0.0)

    def sag_mm(self, height_mm: Floats) -> Floats:
        """Return z at distances from the axis; NaN where the surface has ended."""
        c, square = self.curvature_per_mm, np.asarray(height_mm, dtype=np.float64) ** 2
        with np.errstate(invalid="ignore"):
            sag = c * square / (1.0 + np.sqrt(1.0 - (1.0 + self.conic) * c * c * square))
        for power, coefficient in enumerate(self.asphere, start=2):
            sag = sag + coefficient * square**power
        for power, coefficient in enumerate(self.radial, start=1):
            sag = sag + coefficient * square ** (0.5 * power)
        return np.asarray(sag)

    def reversed(self) -> Surface:
        """Return the surface as light from the other side meets it."""
        return replace(
            self,
            radius_mm=-self.radius_mm,
            asphere=tuple(-a for a in self.asphere),
            radial=tuple(-b for b in self.radial),
            tilt_rad=(-self.tilt_rad[0], -self.tilt_rad[1]),
        )


@dataclass(frozen=True, slots=True)
class Element:
    """Surfaces that move as one: a single lens, a cemented group, a cover glass.

    A point p of the element lies at R p + decenter, where R leans its axis by `tilt_rad`:
    R = R_x(-row) R_y(col), about the vertex of the first surface (x along columns, y along rows,
    right-handed rotations: the coordinate break (-row, col, 0) of optical design programs).

    Parameters
    ----------
    surfaces : in the order in which light meets them, at least two, or a mirror
    glass : between them, one less than surfaces
    thickness_mm : between the vertices, one less than surfaces
    name : for tables and messages
    decenter_mm : (row, col)
    tilt_rad : by how much the axis leans towards (row, col)

    Raises
    ------
    ValueError
        If the numbers do not fit together, a glass is unknown or surfaces cross.
    """

    surfaces: tuple[Surface, ...]
    glass: tuple[str, ...]
    thickness_mm: tuple[float, ...]
    name: str = ""
    decenter_mm: tuple[float, float] = (0.0, 0.0)
    tilt_rad: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        spaces = len(self.surfaces) - 1
        alone = spaces == 0 and self.surfaces[0].mirror
        if (spaces < 1 and not alone) or {len(self.glass), len(self.thickness_mm)} != {spaces}:
            raise ValueError(
                f"expected n surfaces, n - 1 glasses and n - 1 thicknesses, got "
                f"{len(self.surfaces)}, {len(self.glass)} and {len(self.thickness_mm)}"
            )
        for number, glass in enumerate(self.glass, start=1):
            try:
                glass_data(glass)
            except ValueError as error:
                raise ValueError(f"surface {number}: {error}") from error
        for number, thickness_mm in enumerate(self.thickness_mm, start=1):
            if not (math.isfinite(thickness_mm) and thickness_mm > 0):
                raise ValueError(
                    f"surface {number}: expected a positive thickness, got {thickness_mm} mm"
                )
            _check_order(self.surfaces[number - 1], self.surfaces[number], thickness_mm, number)
        if not np.all(np.isfinite([*self.decenter_mm, *self.tilt_rad])):
            raise ValueError("expected a finite decentre and tilt")

    @property
    def length_mm(self) -> float:
        """From the first vertex to the last."""
        return sum(self.thickness_mm)

    @property
    def folds(self) -> bool:
        """Whether light leaves it backwards, so that what is behind it is drawn unfolded."""
        return sum(surface.mirror for surface in self.surfaces) % 2 == 1

    def reversed(self) -> Element:
        """Return the element turned round, its last surface first."""
        return replace(
            self,
            surfaces=tuple(surface.reversed() for surface in self.surfaces[::-1]),
            glass=self.glass[::-1],
            thickness_mm=self.thickness_mm[::-1],
        )


@dataclass(frozen=True, slots=True)
class Stop:
    """The aperture that limits the light: a round hole in a plane in air.

    A plane that lies within an element is taken in the air beside its nearer vertex: beside a
    curved surface the rim of a hole lies in air where the middle would be in glass.

    Parameters
    ----------
    diameter_mm : of the hole
    position_mm : from the first vertex of the lens, negative in front of it
    rides_on : number of the element that carries it, or None if it is fixed in space
    behind : how many elements light passes before it, if not those that lie in front of it: the
        stop is a virtual one, where those elements show the hole
    """

    diameter_mm: float
    position_mm: float = 0.0
    rides_on: int | None = None
    behind: int | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.diameter_mm) and self.diameter_mm > 0):
            raise ValueError(f"expected a positive stop diameter, got {self.diameter_mm} mm")
        if not math.isfinite(self.position_mm):
            raise ValueError(f"expected a finite stop position, got {self.position_mm} mm")


@dataclass(frozen=True, slots=True)
class Lens:
    """Elements in a row, light from object to sensor.

    Parameters
    ----------
    elements : in the order in which light meets them
    gaps_mm : air behind each element; the last one reaches to the sensor, and is negative if the
        image is a virtual one
    stop : the aperture
    object_mm : from the object to the first vertex, or infinite
    wavelength_nm : of the design, used where no other is given
    temperature_c : of glass and air; radii and thicknesses are taken as they are
    name : for tables and figures

    Raises
    ------
    ValueError
        If a gap is negative, surfaces overlap, or the stop lies behind the sensor or is larger
        than a surface that all of its light meets; if there is no such temperature.
    """

    elements: tuple[Element, ...]
    gaps_mm: tuple[float, ...]
    stop: Stop
    object_mm: float = math.inf
    wavelength_nm: float = WAVELENGTH_NM
    temperature_c: float = REFERENCE_TEMPERATURE_C
    name: str = ""

    def __post_init__(self) -> None:
        if not self.elements or len(self.gaps_mm) != len(self.elements):
            raise ValueError(
                f"expected a gap behind each of at least one element, got {len(self.gaps_mm)} "
                f"gaps and {len(self.elements)} elements"
            )
        for number, gap_mm in enumerate(self.gaps_mm, start=1):
            if not math.isfinite(gap_mm) or (gap_mm < 0 and number < len(self.gaps_mm)):
                raise ValueError(
                    f"expected a gap of at least 0 mm behind element {number}, got {gap_mm:g} mm"
                )
        if not _ABSOLUTE_ZERO_C < self.temperature_c < math.inf:
            raise ValueError(
                f"expected a temperature above {_ABSOLUTE_ZERO_C} C, got {self.temperature_c} C"
            )
        if not self.object_mm > 0:
            raise ValueError(f"expected a positive object distance, got {self.object_mm} mm")
        number = 0
        for (element, behind), gap_mm in zip(pairwise(self.elements), self.gaps_mm, strict=False):
            number += len(element.surfaces)
            _check_order(element.surfaces[-1], behind.surfaces[0], gap_mm, number)
        self._check_stop()
        self.indices()  # tells of a wavelength or temperature that a glass does not know

    def _check_stop(self) -> None:
        if self.stop.rides_on is not None:
            self.check_element(self.stop.rides_on, "the stop on an element")
        if self.stop.behind:
            self.check_element(self.stop.behind - 1, "the element in front of the stop")
        if self.stop.behind is None and self.stop.position_mm < -self.object_mm:
            raise ValueError(
                f"expected a stop between object and sensor, got {self.stop.position_mm:g} mm, in "
                f"front of an object {self.object_mm:g} mm away"
            )
        widest_mm = self.widest_stop_mm()
        if self.stop.diameter_mm > widest_mm:
            raise ValueError(
                f"expected a stop no larger than the surface beside it, "
                f"{widest_mm:g} mm, got {self.stop.diameter_mm:g} mm"
            )

    def widest_stop_mm(self) -> float:
        """Return the diameter of the narrowest surface that all light through the stop meets.

        Those are the surfaces at the stop, and the first one behind a stop in front of the lens.
        Farther ones may be narrower than the stop: light can come together on its way to them.
        """
        before = self.elements_before_stop()
        starts_mm = self.positions_mm()
        beside = [] if before else [self.elements[0].surfaces[0]]
        for number, element in enumerate(self.elements):
            ends_mm = (starts_mm[number], starts_mm[number] + element.length_mm)
            vertices = zip(ends_mm, (element.surfaces[0], element.surfaces[-1]), strict=True)
            beside += [one for at, one in vertices if abs(at - self.stop.position_mm) < _CLOSE_MM]
        return 2.0 * min((one.semi_diameter_mm for one in beside), default=math.inf)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Those of all elements, in the order in which light meets them."""
        return tuple(surface for element in self.elements for surface in element.surfaces)

    def with_surfaces(self, surfaces: Iterable[Surface]) -> Lens:
        """Return the lens with other surfaces, as many as it has."""
        left = iter(surfaces)
        parts = [tuple(islice(left, len(element.surfaces))) for element in self.elements]
        pairs = zip(self.elements, parts, strict=True)
        return replace(self, elements=tuple(replace(one, surfaces=of) for one, of in pairs))

    def positions_mm(self) -> Floats:
        """Return where the first vertex of each element and the sensor lie, [element + 1]."""
        lengths = [e.length_mm + gap for e, gap in zip(self.elements, self.gaps_mm, strict=True)]
        return np.concatenate([[0.0], np.cumsum(lengths)])

    def spaces_mm(self) -> tuple[float, ...]:
        """Return the distance behind each surface along the axis, the last one to the sensor."""
        pairs = zip(self.elements, self.gaps_mm, strict=True)
        return tuple(length for one, gap in pairs for length in (*one.thickness_mm, gap))

    def indices(self, wavelength_nm: float | None = None) -> tuple[tuple[float, ...], ...]:
        """Return the refractive index of each glass of each element."""
        chosen_nm = self.wavelength_nm if wavelength_nm is None else wavelength_nm
        return tuple(
            tuple(refractive_index(g, chosen_nm, self.temperature_c) for g in element.glass)
            for element in self.elements
        )

    def elements_before_stop(self) -> int:
        """Return how many elements light passes before the stop.

        Raises
        ------
        ValueError
            If the stop lies behind the sensor.
        """
        stop_mm, starts_mm, behind = self.stop.position_mm, self.positions_mm(), self.stop.behind
        last = behind in (None, len(self.elements))
        if last and stop_mm >= starts_mm[-1] and self.gaps_mm[-1] >= 0:
            raise ValueError(
                f"expected a stop in front of the sensor at {starts_mm[-1]:g} mm, got {stop_mm} mm"
            )
        middles_mm = starts_mm[:-1] + [0.5 * element.length_mm for element in self.elements]
        return int(np.sum(stop_mm > middles_mm)) if behind is None else behind

    def with_decenter(self, element: int, decenter_mm: tuple[float, float]) -> Lens:
        """Return the lens with one element at another decentre (row, col)."""
        return self._with(element, decenter_mm=decenter_mm)

    def with_tilt(self, element: int, tilt_rad: tuple[float, float]) -> Lens:
        """Return the lens with one element at another tilt (row, col)."""
        return self._with(element, tilt_rad=tilt_rad)

    def with_sensor(self, back_focal_mm: float) -> Lens:
        """Return the lens with the sensor at another distance behind the last vertex."""
        return replace(self, gaps_mm=(*self.gaps_mm[:-1], back_focal_mm))

    def is_symmetric(self) -> bool:
        """Return whether nothing in the lens is decentred or tilted."""
        moves = [pair for one in self.elements for pair in (one.decenter_mm, one.tilt_rad)]
        return not np.any([*moves, *(surface.tilt_rad for surface in self.surfaces)])

    def called(self, element: int) -> str:
        """Return the number of an element, counted from 1, and its name if it has one."""
        name = self.elements[element].name
        return f"element {element + 1}" + (f" ({name})" if name else "")

    def check_element(self, element: int, what: str = "an element") -> None:
        """Raise a ValueError if there is no element of this number, counted from 0."""
        if not 0 <= element < len(self.elements):
            raise ValueError(f"expected {what} from 0 to {len(self.elements) - 1}, got {element}")

    def _with(self, element: int, **changes: tuple[float, float]) -> Lens:
        self.check_element(element)
        elements = list(self.elements)
        elements[element] = replace(elements[element], **changes)  # type: ignore[arg-type]
        return replace(self, elements=tuple(elements))


def cover_glass(glass: str, thickness_mm: float, semi_diameter_mm: float = math.inf) -> Element:
    """Return a plane-parallel plate, to be put in front of the sensor as the last element."""
    plane = Surface(math.inf, semi_diameter_mm=semi_diameter_mm)
    return Element((plane, plane), (glass,), (thickness_mm,), name="cover glass")


def _check_order(front: Surface, back: Surface, distance_mm: float, number: int) -> None:
    """Raise a ValueError if the back surface reaches before the front one anywhere on both."""
    largest_mm = min(front.semi_diameter_mm, back.semi_diameter_mm)
    if front.mirror or back.mirror or math.isinf(largest_mm):  # what is drawn unfolded may cross
        return
    heights_mm = largest_mm * _CHECKED_HEIGHTS
    room_mm = distance_mm + back.sag_mm(heights_mm) - front.sag_mm(heights_mm)
    if front.tilt_rad != back.tilt_rad:
        room_mm -= heights_mm * math.hypot(*np.tan(back.tilt_rad) - np.tan(front.tilt_rad))
    if room_mm.min() < -1e-9:
        worst_mm = heights_mm[room_mm.argmin()]
        raise ValueError(
            f"surface {number}: expected surface {number + 1} behind it, but they overlap by "
            f"{-room_mm.min():.4f} mm at {worst_mm:.2f} mm from the axis"
        )
