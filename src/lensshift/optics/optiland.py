"""Lenses to and from Optiland, an optional companion: drawings, analyses, other file formats."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.errors import DataError, of_extra
from lensshift.optics.glass import GLASSES, refractive_index
from lensshift.optics.glass_called import glass_called
from lensshift.optics.lens import Lens, Surface
from lensshift.optics.sequential import Entry, Frame, lens_of_entries
from lensshift.optics.trace import rotations_of

_APERTURES = {"EPD": "ENPD", "imageFNO": "FNUM", "float_by_stop_size": "FLOA"}
_SHAPES = {"Plane": "STANDARD", "StandardGeometry": "STANDARD", "EvenAsphere": "EVENASPH"}
_SAME_INDEX = 1e-6  # catalogues have six digits


def to_optiland(lens: Lens) -> Any:
    """Return an `optiland.optic.Optic` of a lens.

    The stop is a plane of its own; the glasses carry the dispersion of this package at the
    temperature of the lens; the only field is the axis.

    Raises
    ------
    ImportError
        If Optiland is not installed.
    """
    optic = _need("optiland.optic").Optic(lens.name)
    planes = list(_planes(lens))
    places_mm = [z_mm for z_mm, _ in planes] + [float(lens.positions_mm()[-1])]
    far = math.isinf(lens.object_mm)
    optic.surfaces.add(index=0, thickness=math.inf if far else lens.object_mm + places_mm[0])
    for number, (z_mm, options) in enumerate(planes, start=1):
        optic.surfaces.add(index=number, thickness=places_mm[number] - z_mm, **options)
    optic.surfaces.add(index=len(planes) + 1)
    optic.set_aperture("float_by_stop_size", lens.stop.diameter_mm)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.wavelengths.add(1e-3 * lens.wavelength_nm, is_primary=True)
    return optic


def from_optiland(optic: Any) -> Lens:
    """Return the lens that an `optiland.optic.Optic` describes.

    Neighbouring surfaces with glass between them make an element, which may be decentred and
    tilted as a whole. Fields, coatings, pickups and solves are left out.

    Raises
    ------
    ImportError
        If Optiland is not installed.
    DataError
        If the optic has other surfaces than planes, conics and even aspheres, mirrors, an unknown
        glass, or describes no lens: with the surface.
    """
    _need("optiland.optic")
    wavelength_um = float(optic.primary_wavelength)
    entries, frames = [], []
    for number, surface in enumerate(optic.surfaces):
        entries.append(_entry(number, surface, wavelength_um))
        origin, axes = surface.geometry.cs.get_effective_transform()
        frames.append(Frame(np.asarray(origin, dtype=float).ravel(), np.asarray(axes, dtype=float)))
    kind = _APERTURES.get(getattr(optic.aperture, "ap_type", ""))
    if kind is None:
        raise DataError(f"expected an aperture of {', '.join(_APERTURES)}, got {optic.aperture!r}")
    size = float(optic.aperture.value)
    frames = _from_object(entries, frames)
    if kind == "FLOA":
        for entry in entries:
            entry.semi_diameter_mm = 0.5 * size if entry.is_stop else entry.semi_diameter_mm
    return lens_of_entries(
        entries, frames, (kind, size), 1e3 * wavelength_um, getattr(optic, "name", None) or ""
    )


def _planes(lens: Lens) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield place and options of the surfaces and the stop as light meets them."""
    before = lens.elements_before_stop()
    places = zip(lens.elements, lens.positions_mm(), strict=False)
    for number, (element, start_mm) in enumerate(places):
        if number == before:
            yield _stop(lens)
        turned = rotations_of(np.array(element.tilt_rad))
        depths_mm = np.cumsum([0.0, *element.thickness_mm])
        materials = [_glass_class()(glass, lens.temperature_c) for glass in element.glass]
        behind = zip(depths_mm, element.surfaces, (*materials, "air"), strict=True)
        for depth_mm, surface, material in behind:
            vertex_mm = np.array([*element.decenter_mm, start_mm]) + depth_mm * turned[:, 2]
            y, x, z = (turned @ rotations_of(np.array(surface.tilt_rad)))[:, 2]
            told = {"rx": -math.asin(y), "ry": math.atan2(x, z), "comment": element.name}
            told["material"] = material
            yield float(vertex_mm[2]), _options(surface, vertex_mm) | told
    if before == len(lens.elements):
        yield _stop(lens)


def _stop(lens: Lens) -> tuple[float, dict[str, Any]]:
    aside_mm = np.zeros(2)
    if lens.stop.rides_on is not None:
        aside_mm = np.array(lens.elements[lens.stop.rides_on].decenter_mm)
    plane = Surface(math.inf, semi_diameter_mm=0.5 * lens.stop.diameter_mm)
    told = {"material": "air", "is_stop": True, "comment": "stop"}
    return lens.stop.position_mm, _options(plane, aside_mm) | told


def _options(surface: Surface, vertex_mm: Floats) -> dict[str, Any]:
    """Return the shape of a surface, and how far (row, col) it lies aside, as Optiland says it."""
    options: dict[str, Any] = {"radius": surface.radius_mm, "conic": surface.conic}
    options |= {"dy": float(vertex_mm[0]), "dx": float(vertex_mm[1])}
    if surface.asphere:
        options |= {
            "surface_type": "even_asphere",
            "coefficients": [(*surface.radial, 0.0, 0.0)[1], *surface.asphere],
            "tol": 1e-13,
        }
    if math.isfinite(surface.semi_diameter_mm):
        hole = _need("optiland.physical_apertures").RadialAperture
        options["aperture"] = hole(surface.semi_diameter_mm, surface.inner_mm)
    return options


def _entry(number: int, surface: Any, wavelength_um: float) -> Entry:
    entry = Entry(number)
    shape = type(surface.geometry).__name__
    if shape not in _SHAPES:
        raise entry.wrong(f"expected a surface of {', '.join(_SHAPES)}, got {shape}")
    if getattr(surface.interaction_model, "is_reflective", False):
        raise entry.wrong("expected lenses, got a mirror")
    entry.type = _SHAPES[shape]
    radius_mm = float(np.asarray(surface.geometry.radius).item())
    entry.curvature_per_mm = 0.0 if math.isinf(radius_mm) else 1.0 / radius_mm
    entry.conic = float(np.asarray(getattr(surface.geometry, "k", 0.0)).item())
    terms = getattr(surface.geometry, "coefficients", ())
    square, *higher = (*map(float, terms), 0.0)
    entry.radial = (0.0, square) if square else ()
    entry.asphere = tuple(higher[:-1]) if any(higher) else ()
    entry.semi_diameter_mm = float(getattr(surface.aperture, "r_max", 0.0))
    entry.inner_mm = float(getattr(surface.aperture, "r_min", 0.0))
    entry.is_stop = bool(surface.is_stop)
    entry.glass = _glass(surface.material_post, wavelength_um, entry)
    return entry


def _glass(material: Any, wavelength_um: float, entry: Entry) -> str:
    """Return the glass of a material by its name or by its index, "" for air."""
    if material is None:
        return ""
    index = float(np.asarray(material.n(wavelength_um)).ravel()[0])
    if abs(index - 1.0) < _SAME_INDEX:
        return ""
    name = str(getattr(material, "name", ""))
    if (glass := glass_called(name)) is not None:
        return glass
    for known in GLASSES:
        if abs(refractive_index(known, 1e3 * wavelength_um) - index) < _SAME_INDEX:
            return known
    raise entry.wrong(
        f"expected a glass of {', '.join(GLASSES)}, got {name or 'one'} of index {index:.6f}"
    )


def _from_object(entries: list[Entry], frames: list[Frame]) -> list[Frame]:
    """Return the frames with a near object at the origin, and write the distances in glass."""
    far = not math.isfinite(frames[0].origin[2])
    entries[0].distance_mm = math.inf if far else 0.0
    from_mm = np.zeros(3) if far else frames[0].origin
    placed = [Frame(frame.origin - from_mm, frame.axes) for frame in frames]
    if far:
        placed[0] = placed[1]  # an infinite place cannot be turned
    for entry, (here, behind) in zip(entries, pairwise(placed), strict=False):
        if entry.glass:
            entry.distance_mm = float((behind.origin - here.origin) @ here.axes[:, 2])
    return placed


@lru_cache(maxsize=1)
def _glass_class() -> Any:
    """Return the class of glasses with the dispersion of this package."""
    base = _need("optiland.materials").BaseMaterial

    class LensshiftGlass(base):  # type: ignore[misc, valid-type]
        """A glass of `lensshift.optics.glass` at one temperature."""

        def __init__(self, name: str, temperature_c: float) -> None:
            super().__init__()
            self.name = name
            self.temperature_c = temperature_c

        @property
        def display_name(self) -> str:
            """The name for drawings and tables."""
            return self.name

        def _calculate_n(self, wavelength: Any, **_: Any) -> Any:
            um = np.asarray(wavelength, dtype=np.float64)
            values, places = np.unique(um, return_inverse=True)
            index = [refractive_index(self.name, 1e3 * v, self.temperature_c) for v in values]
            return np.asarray(index)[places].reshape(um.shape)

        def _calculate_k(self, wavelength: Any, **_: Any) -> Any:
            return np.zeros_like(np.asarray(wavelength, dtype=np.float64))

        def to_dict(self) -> dict[str, Any]:
            """Return what `from_dict` makes the same glass of."""
            data: dict[str, Any] = super().to_dict()
            return data | {"name": self.name, "temperature_c": self.temperature_c}

        @classmethod
        def from_dict(cls, data: dict[str, Any]) -> LensshiftGlass:
            """Return the glass that `to_dict` wrote."""
            return cls(data["name"], data["temperature_c"])

    return LensshiftGlass


def _need(name: str) -> Any:
    """Return a module of Optiland."""
    needed = "expected Optiland, which is not installed: pip install lensshift[optiland]"
    return of_extra(name, needed)
