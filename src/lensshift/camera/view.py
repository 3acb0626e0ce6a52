"""Where the camera looks, how the image moves, and what a lens makes of a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensshift.camera.radiometry import relative_illumination
from lensshift.camera.settings import LensOptics, PlainOptics, TofCamera
from lensshift.core.arrays import Array
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Intrinsics, Pinhole
from lensshift.core.optical import gaussian_width
from lensshift.optics.lens import Lens

if TYPE_CHECKING:
    from lensshift.optics.directions import Directions

_LIGHT_NODES = 17  # from the middle to the corner, where the light is traced
_NO_LIGHT = 1e-9  # of that on the axis: rounding
_FEW_RINGS = 8  # of rays that tell the light where many places are traced
_NEAR_PX = 1e-2  # of where a spot is: spots change slowly
_NODE_RINGS = 4  # of rays that tell how slowly
_LOST = 0.005  # of the contrast between nodes
_POINTS_PER_SIDE = 8  # of squares, at least, of the lattices on which spots are


@dataclass(frozen=True, slots=True, eq=False)
class SpotBlur:
    """Where the light of a point lands around its image, over the sensor."""

    # [node] rising places on the sensor; linear between them
    row_px: Array
    col_px: Array
    per_px: int  # points of a lattice along an LR pixel
    # [2 node node] first point of the image at each node, and that behind its last
    start: NDArray[np.int64]
    place: NDArray[np.int64]  # [point 2] (row, col) points of the lattice from the image
    weight: Array  # [point] sums to 1 over those of a node

    @property
    def reach_px(self) -> float:
        """How far along an axis any light lands."""
        return float(np.abs(self.place).max()) / self.per_px

    def nodes_at(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return where places [row], [col] lie between the nodes."""
        rows = np.interp(row_px, self.row_px, np.arange(len(self.row_px)))
        return rows, np.interp(col_px, self.col_px, np.arange(len(self.col_px)))

    def otf(self, place_px: Array, cycles_per_px: Array) -> NDArray[np.complex128]:
        """Return the OTF at a place [2] and frequencies [... 2], all (row, col)."""
        at_row, at_col = self.nodes_at(*place_px[:, None])
        down, across = (
            np.maximum(1.0 - np.abs(at - np.arange(count)), 0.0)
            for at, count in ((at_row, len(self.row_px)), (at_col, len(self.col_px)))
        )
        share = np.repeat(np.outer(down, across).ravel(), np.diff(self.start, axis=0).ravel())
        seen = share > 0.0
        turns = cycles_per_px @ self.place[seen].T / self.per_px
        return np.asarray(np.exp(-2j * np.pi * turns) @ (share * self.weight)[seen])


Motion = tuple[Array, float | SpotBlur]


def motions(camera: TofCamera, offset_px: Array, side_px: float, *, scale: int = 1) -> list[Motion]:
    """Return what differs in each frame of `offset_px` [frame 2] from what the camera at rest sees.

    ValueError if the lens is far out of focus, whose spots would take hours.

    Parameters
    ----------
    side_px : of the squares over which pixels average, in LR pixels: how finely they see spots
    scale : pixels along an LR pixel

    Returns
    -------
    for each frame the offset in px [row col 2] of the pixels, or [1 1 2], at the centre of the
    sensor as asked for; and the blur: sigma in LR pixels of a Gaussian that is the same all over
    the sensor, or spots
    """
    if isinstance(camera.optics, PlainOptics):
        sigma_px = camera.optics.blur_sigma_px
        return [(offset[None, None, :], sigma_px) for offset in offset_px]
    from lensshift.optics.field import check_focus

    optics, grid = camera.optics, camera.grid
    check_focus(optics.lens, grid)
    half = int(np.ceil(0.5 * _POINTS_PER_SIDE / (side_px * scale)))
    # Odd, so that cells, of which there are 16, do not beat with it.
    per_px = 2 * scale * (half | 1)
    if optics.element is None:
        (blur,) = _spot_blurs(optics, 0, grid, np.zeros((1, 2)), side_px, per_px)
        return [(offset[None, None, :], blur) for offset in offset_px]
    from lensshift.optics.shift import decenter_for_shift

    decenter_mm = decenter_for_shift(optics.lens, optics.element, offset_px, grid)
    fields_px = _offset_fields(optics.lens, optics.element, grid, decenter_mm)
    blurs = _spot_blurs(optics, optics.element, grid, decenter_mm, side_px, per_px)
    return list(zip(fields_px, blurs, strict=True))


def response_width_px(side_px: float, blur: float | SpotBlur, shape: tuple[int, int]) -> float:
    """Return the Gaussian width of a pixel and what blurs it, as `calibrate` finds it at an edge.

    The width is that of the MTF50 in the middle of the sensor, the mean of both axes.

    Parameters
    ----------
    side_px : of the sensitive square of a pixel
    blur : as of `motions`
    shape : of the sensor
    """
    from scipy.optimize import brentq

    def contrast(f: float, axis: int) -> float:
        pixel = np.sinc(side_px * f)
        if not isinstance(blur, SpotBlur):
            return float(pixel * np.exp(-2.0 * (np.pi * blur * f) ** 2))
        return float(pixel * np.abs(blur.otf(0.5 * (np.array(shape) - 1.0), f * np.eye(2)[axis])))

    first_zero_cpp = 1.0 / side_px
    half_cpp = [
        brentq(lambda f, axis=axis: contrast(f, axis) - 0.5, 0.0, first_zero_cpp) for axis in (0, 1)
    ]
    return float(np.mean([gaussian_width(f) for f in half_cpp]))


def intrinsics_of(camera: TofCamera) -> Intrinsics:
    """Return where the pixels of the camera at rest look, as a calibration would tell of it."""
    if isinstance(camera.optics, PlainOptics):
        return Pinhole.of_focal_length(camera.grid, camera.optics.focal_length_mm)
    from lensshift.optics.directions import lens_directions

    return lens_directions(camera.optics.lens, camera.grid)


class View:
    """Where the camera at rest looks: tangents of directions as a function of pixels.

    Parameters
    ----------
    camera : of which only grid and optics matter
    margin_px : how far around the sensor the view is needed
    """

    def __init__(self, camera: TofCamera, margin_px: float) -> None:
        self._grid, self._optics = camera.grid, camera.optics
        self._directions: Directions | None = None
        # Light from (down, right) over what the f-number tells of the axis, [...] each.
        self.light: Callable[[Array, Array], Array]
        if isinstance(camera.optics, PlainOptics):
            focal_mm = camera.optics.focal_length_mm
            self.light = partial(relative_illumination, camera.optics, camera.grid)
        else:
            from lensshift.optics.directions import Directions
            from lensshift.optics.spots import image_per_field_mm

            focal_mm = image_per_field_mm(camera.optics.lens)
            self._directions = Directions.of(camera.optics.lens, camera.grid, margin_px)
            ends = (np.array([-margin_px, count - 1 + margin_px]) for count in camera.grid.shape)
            self.light = _traced_light(camera.optics.lens, *self.lattice(*ends))
        self.per_px = (camera.grid.pitch_mm[0] / focal_mm, camera.grid.pitch_mm[1] / focal_mm)

    def lattice(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return down and right over forward, [row col] each, at places [row] and [col]."""
        if self._directions is not None:
            return self._directions.lattice(row_px, col_px)
        down, right = np.meshgrid(*self._straight(row_px, col_px), indexing="ij")
        return down, right

    def at(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return down and right over forward, [...] each, at places [...]."""
        if self._directions is not None:
            return self._directions.at(row_px, col_px)
        return self._straight(row_px, col_px)

    def _straight(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        rows, cols = self._grid.shape
        down, right = row_px - 0.5 * (rows - 1), col_px - 0.5 * (cols - 1)
        return down * self.per_px[0], right * self.per_px[1]


def _traced_light(lens: Lens, down: Array, right: Array) -> Callable[[Array, Array], Array]:
    """Return `View.light` of a lens at rest, as far as the directions of the corners of its view.

    A spline over the angle, or over both directions where the lens has no axis of symmetry; where
    vignetting sets in it is right to 0.008, or 0.015 without an axis.
    """
    from scipy.interpolate import CubicSpline, RectBivariateSpline

    from lensshift.optics.aberrations import relative_illumination as traced
    from lensshift.optics.directions import angles_of, tangents_of
    from lensshift.optics.spots import axial_light

    through = axial_light(lens)[0]  # the f-number counts what is stopped on the axis, too
    if lens.is_symmetric():
        # Evenly in the angle: tangents of wide lenses hold most nodes near their end.
        angle = np.linspace(0.0, np.arctan(np.hypot(down, right).max()), _LIGHT_NODES)
        light = through * traced(lens, np.tan(angle)[:, None] * np.array([0.0, 1.0]))
        over_angle = CubicSpline(angle, light)

        def at_angle(down: Array, right: Array) -> Array:
            wanted = np.arctan(np.hypot(down, right))
            return _lit(over_angle(wanted), np.interp(wanted, angle, light))

        return at_angle
    ends = angles_of(down, right)
    downs, rights = (np.linspace(one.min(), one.max(), _LIGHT_NODES) for one in ends)
    fields = np.stack(tangents_of(*np.meshgrid(downs, rights, indexing="ij")), axis=-1)
    light = through * traced(lens, fields, rings=_FEW_RINGS)
    smooth, straight = (RectBivariateSpline(downs, rights, light, kx=k, ky=k) for k in (3, 1))

    def at_both(down: Array, right: Array) -> Array:
        wanted = angles_of(down, right)
        return _lit(smooth.ev(*wanted), straight.ev(*wanted))

    return at_both


def _lit(smooth: Array, straight: Array) -> Array:
    """Return light by a smooth curve, none where nodes on both sides of a place have none."""
    return np.where(straight > _NO_LIGHT, np.maximum(smooth, 0.0), 0.0)


def _offset_fields(lens: Lens, element: int, grid: Grid, decenter_mm: Array) -> Array:
    """Return the traced offset of every pixel, [frame row col 2], by splines between nodes."""
    from scipy.interpolate import RectBivariateSpline

    from lensshift.optics.directions import nodes_px
    from lensshift.optics.shift import shift_map

    rows, cols = (nodes_px(count, 1.0) for count in grid.shape)
    step_px = (float(rows[1] - rows[0]), float(cols[1] - cols[0]))
    pitch_mm = (step_px[0] * grid.pitch_mm[0], step_px[1] * grid.pitch_mm[1])
    coarse = Grid((len(rows), len(cols)), pitch_mm)
    field = shift_map(lens, element, decenter_mm, coarse, dark=True).offset_px * step_px
    row, col = (np.arange(count, dtype=np.float64) for count in grid.shape)
    splines = [[RectBivariateSpline(rows, cols, one[..., i]) for i in (0, 1)] for one in field]
    return np.stack([np.stack([part(row, col) for part in pair], axis=-1) for pair in splines])


def _spot_blurs(
    optics: LensOptics, element: int, grid: Grid, decenter_mm: Array, side_px: float, per_px: int
) -> list[SpotBlur]:
    """Return the spots of the lens in each frame, as squares of a side can tell them."""
    from lensshift.optics.directions import from_nearest, places_mm
    from lensshift.optics.lattice import lattice_images
    from lensshift.optics.shift import moving
    from lensshift.optics.spots import fields_for_image

    rows, cols = _nodes_between_spots(optics.lens, grid, side_px)
    lens, pitch_mm = optics.lens, np.asarray(grid.pitch_mm)
    build = moving(lens, element, decenter_mm[:, None, None, :])
    near_mm = _NEAR_PX * min(grid.pitch_mm)
    fields = fields_for_image(
        lens, places_mm(grid, rows, cols), build=build, tolerance_mm=near_mm, dark=True
    )
    blurs = []
    for moved_mm, of_frame in zip(decenter_mm, map(from_nearest, fields), strict=True):
        images = lattice_images(
            lens, of_frame.reshape(-1, 2), pitch_mm / per_px, 1.0 / (side_px * pitch_mm),
            build=moving(lens, element, moved_mm), diffraction=optics.diffraction,
        )  # fmt: skip
        ends = np.cumsum([0] + [len(one.weight) for one in images])
        start = np.stack([ends[:-1], ends[1:]]).reshape(2, len(rows), len(cols))
        place = np.concatenate([one.place for one in images])
        weight = np.concatenate([one.weight for one in images])
        unused = 1 if np.any(place % 2) else 2  # of every so many points of the lattice
        blurs.append(SpotBlur(rows, cols, per_px // unused, start, place // unused, weight))
    return blurs


def _nodes_between_spots(lens: Lens, grid: Grid, side_px: float) -> tuple[Array, Array]:
    """Return places along rows and columns between which the light of spots may be mixed.

    Of a ray that lands d elsewhere at the next node, half way is left of a wave of f cycles

        cos(pi f d) = 1 - (pi f d)^2 / 2,    f = 1 / side at most matters

    where it would be 1. Nodes are as far apart as that allows, but no more of them than where
    directions are traced.
    """
    from lensshift.optics.directions import from_nearest, nodes_px, places_mm
    from lensshift.optics.spots import fields_for_image, spots

    dense = [nodes_px(count, 0.5) for count in grid.shape]
    near_mm = _NEAR_PX * min(grid.pitch_mm)
    fields = fields_for_image(lens, places_mm(grid, *dense), tolerance_mm=near_mm, dark=True)
    spot = spots(lens, from_nearest(fields), rings=_NODE_RINGS)
    landing_px = spot.ray_mm / np.asarray(grid.pitch_mm)
    most_px = side_px / np.pi * np.sqrt(2.0 * _LOST)
    found = []
    for axis, places in enumerate(dense):
        landing, weight = (np.moveaxis(one, axis, 0) for one in (landing_px, spot.weight))
        square = np.sum(np.diff(landing, axis=0) ** 2, axis=-1)
        both = np.minimum(weight[1:], weight[:-1])
        apart_px = np.sqrt((both * square).sum(axis=-1).max(axis=1))
        along = np.concatenate([[0.0], np.cumsum(np.maximum(apart_px, 1e-3 * most_px))])
        count = min(max(2 + int(along[-1] / most_px), 3), len(places))
        found.append(np.interp(np.linspace(0.0, along[-1], count), along, places))
    return found[0], found[1]
