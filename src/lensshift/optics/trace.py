"""Trace rays through a lens: many fields, decentres and builds in one call."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.optics.aim import Rays, launch
from lensshift.optics.lens import Lens

SIDES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # for differences


@dataclass(frozen=True, slots=True, eq=False)
class Build:
    """How a lens as built, or many of them, deviate from the lens as drawn.

    Leading axes `...` are free: each array has its own or none, and they broadcast against each
    other and against those of the fields.

    Parameters
    ----------
    decenter_mm : [... element 2] (row, col), added to that of the element
    tilt_rad : [... element 2] (row, col), added to that of the element; not of a mirror, in whose
        plane all behind it is drawn and would turn with it
    gap_mm : [... element], added to the gap behind the element; the last one moves the sensor
    index_factor : [... element], factor on n - 1 of its glasses
    """

    decenter_mm: Floats | None = None
    tilt_rad: Floats | None = None
    gap_mm: Floats | None = None
    index_factor: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RayBundle:
    """Rays where they meet the sensor; NaN for those that are missed or totally reflected.

    Parameters
    ----------
    position_mm : [... ray 2] (row, col) on the sensor, from the axis
    direction : [... ray 3] cosines (row, col, axial)
    path_mm : [... ray] optical path from the object, or from a plane across the incoming light
        through the centre of the entrance pupil
    status : [... ray] 0 passed, 1 missed a surface, 2 totally reflected, 3 outside a semi-diameter
        or within what is stopped about the axis
    failed_at : [... ray] number of the surface where that happened, -1 if it did not
    heights : [... ray surface] distance from the axis of the element over the semi-diameter, or
        None
    crossing_mm : [... ray surface 3] where (row, col, axial from the first vertex of the lens)
        each surface is met, NaN behind the one where the ray ends, or None
    """

    position_mm: Floats
    direction: Floats
    path_mm: Floats
    status: NDArray[np.uint8]
    failed_at: NDArray[np.int16]
    heights: Floats | None = None
    crossing_mm: Floats | None = None

    @property
    def passed(self) -> Mask:
        """[... ray] which rays reach the sensor within all semi-diameters."""
        return np.asarray(self.status == 0)

    def counts(self) -> dict[str, int]:
        """Return how many rays passed, missed a surface, were totally reflected, or vignetted."""
        names = ("passed", "missed", "reflected", "vignetted")
        numbers = np.bincount(self.status.ravel(), minlength=len(names))
        return {name: int(n) for name, n in zip(names, numbers, strict=True)}


def trace(
    lens: Lens,
    field_tan: ArrayLike,
    pupil: ArrayLike,
    *,
    build: Build | None = None,
    wavelength_nm: float | None = None,
    heights: bool = False,
    crossings: bool = False,
) -> RayBundle:
    """Trace rays from points of the object through points of the stop to the sensor.

    The object point of a field lies at -field_tan (object distance + entrance pupil position);
    its image lies on the side of +field_tan. The rays pass the stop exactly at `pupil`, whatever
    lies in front of it.

    Parameters
    ----------
    field_tan : [... 2] (row, col) tangent of the angle between chief ray and axis in object space
    pupil : [ray 2] (row, col) in units of the radius of the stop
    build : deviations of the elements; its leading axes broadcast with those of `field_tan`
    wavelength_nm : instead of the design wavelength
    heights : also return how far from the axis each surface is met
    crossings : also return where each surface is met

    Returns
    -------
    arrays with the broadcast leading axes `...`, then [ray ...]

    Raises
    ------
    ValueError
        If a shape is not as above, the shapes do not broadcast, a number is not finite, or a mirror
        is tilted by the build.
    """
    fields, points = _checked(field_tan, (2,), "field_tan"), _checked(pupil, (2,), "pupil")
    if points.ndim != 2:
        raise ValueError(f"expected pupil [ray 2], got shape {points.shape}")
    system = System(lens, build or Build(), fields, wavelength_nm)
    return system.bundle(launch(lens, system, points), heights, crossings)


class System:
    """A lens, its builds and fields as the plain arrays that the kernel takes.

    Always writable and contiguous: for other arrays Numba would compile the kernel again.
    """

    def __init__(
        self, lens: Lens, build: Build, fields: Floats, wavelength_nm: float | None
    ) -> None:
        count = len(lens.elements)
        decenter = np.array([e.decenter_mm for e in lens.elements])
        tilt = np.array([e.tilt_rad for e in lens.elements])
        gap = np.array(lens.gaps_mm)
        if build.decenter_mm is not None:
            decenter = decenter + _checked(build.decenter_mm, (count, 2), "decenter_mm")
        if build.tilt_rad is not None:
            tilt = tilt + _tilts(lens, build.tilt_rad)
        if build.gap_mm is not None:
            gap = gap + _checked(build.gap_mm, (count,), "gap_mm")
        index = self._indices(lens, build.index_factor, wavelength_nm)
        self.shape = np.broadcast_shapes(
            fields.shape[:-1], decenter.shape[:-2], tilt.shape[:-2], gap.shape[:-1],
            index.shape[:-1],
        )  # fmt: skip
        self.fields = self._flat(fields, 1)
        self.decenter = self._flat(decenter, 2)
        lengths = np.array([e.length_mm for e in lens.elements])
        ends = np.cumsum(self._flat(gap, 1) + lengths, axis=-1)
        starts = np.concatenate([np.zeros((len(ends), 1)), ends[:, :-1]], axis=-1)
        self.sensor = np.ascontiguousarray(ends[:, -1])
        self.vertices = np.concatenate([self.decenter, starts[..., None]], axis=-1)
        self.rotations = np.ascontiguousarray(rotations_of(self._flat(tilt, 2)))
        self.index = self._flat(index, 1).copy()
        self._tables(lens)
        self._lean(lens)

    def _flat(self, values: Floats, trailing: int) -> Floats:
        tail = values.shape[values.ndim - trailing :]
        return np.broadcast_to(values, (*self.shape, *tail)).reshape(-1, *tail)

    def _indices(self, lens: Lens, factor: Floats | None, wavelength_nm: float | None) -> Floats:
        """Return the index behind each surface, [... surface]."""
        count = len(lens.elements)
        scale = np.ones(count) if factor is None else _checked(factor, (count,), "index_factor")
        columns = []
        for number, indices in enumerate(lens.indices(wavelength_nm)):
            columns += [1.0 + (n - 1.0) * scale[..., number] for n in indices]
            columns.append(np.ones(scale.shape[:-1]))
        return np.stack(columns, axis=-1)

    def _tables(self, lens: Lens) -> None:
        surfaces = lens.surfaces
        counts = [len(element.surfaces) for element in lens.elements]
        self.element = np.repeat(np.arange(len(counts)), counts)
        depths = [np.cumsum([0.0, *element.thickness_mm]) for element in lens.elements]
        self.depth = np.concatenate(depths)
        self.curvature = np.array([surface.curvature_per_mm for surface in surfaces])
        self.conic = np.array([surface.conic for surface in surfaces])
        self.semi_diameter = np.array([surface.semi_diameter_mm for surface in surfaces])
        self.inner = np.array([one.inner_mm / one.semi_diameter_mm for one in surfaces])
        self.terms, self.asphere = _table([surface.asphere for surface in surfaces])
        self.radial_terms, self.radial = _table([surface.radial for surface in surfaces])
        self.mirror = np.array([surface.mirror for surface in surfaces])

    def _lean(self, lens: Lens) -> None:
        """Give surfaces that lean in their element axes of their own, behind those of elements."""
        self.frame = self.element.copy()
        leaning = [number for number, one in enumerate(lens.surfaces) if any(one.tilt_rad)]
        for number in leaning:
            of_element = self.rotations[:, self.element[number]]
            here = self.vertices[:, self.element[number]] + self.depth[number] * of_element[..., 2]
            turned = of_element @ rotations_of(np.array(lens.surfaces[number].tilt_rad))
            self.frame[number] = self.vertices.shape[1]
            self.vertices = np.concatenate([self.vertices, here[:, None]], axis=1)
            self.rotations = np.concatenate([self.rotations, turned[:, None]], axis=1)
        self.depth[leaning] = 0.0

    def follow(
        self,
        rays: Rays,
        surfaces: int,
        plane_mm: Floats,
        heights: Floats | None = None,
        crossings: Floats | None = None,
    ) -> None:
        """Trace rays in place through the first surfaces to a plane."""
        from lensshift.optics.trace_kernel import trace_kernel

        trace_kernel(
            rays.origin, rays.direction, rays.path, rays.status, rays.failed_at,
            _NO_HEIGHTS if heights is None else heights,
            _NO_CROSSINGS if crossings is None else crossings,
            self.vertices, self.rotations, self.index, plane_mm,
            self.frame, self.depth, self.curvature, self.conic, self.asphere,
            self.terms, self.radial, self.radial_terms, self.mirror, self.semi_diameter,
            self.inner, surfaces,
        )  # fmt: skip

    def bundle(self, rays: Rays, with_heights: bool, with_crossings: bool) -> RayBundle:
        """Trace rays to the sensor and give them the axes of the caller."""
        surfaces = len(self.element)
        heights = np.full((*rays.path.shape, surfaces), np.nan) if with_heights else None
        met = np.full((*rays.path.shape, surfaces, 3), np.nan) if with_crossings else None
        self.follow(rays, surfaces, self.sensor, heights, met)
        shape = (*self.shape, rays.path.shape[1])
        return RayBundle(
            position_mm=np.ascontiguousarray(rays.origin[..., :2]).reshape(*shape, 2),
            direction=rays.direction.reshape(*shape, 3),
            path_mm=rays.path.reshape(shape),
            status=rays.status.reshape(shape),
            failed_at=rays.failed_at.reshape(shape),
            heights=None if heights is None else heights.reshape(*shape, surfaces),
            crossing_mm=None if met is None else met.reshape(*shape, surfaces, 3),
        )


def _table(rows: list[tuple[float, ...]]) -> tuple[Array, Floats]:
    """Return the lengths of rows, and the rows filled up with zeros."""
    terms = np.array([len(row) for row in rows])
    table = np.zeros((len(rows), max(1, terms.max())))
    for into, row in zip(table, rows, strict=True):
        into[: len(row)] = row
    return terms, table


_NO_HEIGHTS = np.zeros((1, 1, 0))
_NO_CROSSINGS = np.zeros((1, 1, 0, 3))


def rotations_of(tilt_rad: Floats) -> Floats:
    """Return the matrices [... 3 3] from element to lens in (row, col, axial) for tilts [... 2]."""
    sin_row, sin_col = np.sin(tilt_rad[..., 0]), np.sin(tilt_rad[..., 1])
    cos_row, cos_col = np.cos(tilt_rad[..., 0]), np.cos(tilt_rad[..., 1])
    zero = np.zeros_like(sin_row)
    rows = [
        [cos_row, -sin_row * sin_col, sin_row * cos_col],
        [zero, cos_col, sin_col],
        [-sin_row, -cos_row * sin_col, cos_row * cos_col],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _tilts(lens: Lens, tilt_rad: ArrayLike) -> Floats:
    tilts = _checked(tilt_rad, (len(lens.elements), 2), "tilt_rad")
    for number, element in enumerate(lens.elements):
        if element.folds and np.any(tilts[..., number, :]):
            raise ValueError(
                f"expected no tilt of {lens.called(number)}, a mirror: all behind "
                "it is drawn unfolded in its plane, and would turn with it"
            )
    return tilts


def _checked(values: ArrayLike, tail: tuple[int, ...], name: str) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.shape[array.ndim - len(tail) :] != tail or not np.all(np.isfinite(array)):
        raise ValueError(
            f"expected finite {name} [... {' '.join(map(str, tail))}], got shape {array.shape}"
        )
    return array
