"""Where the camera looks, how the image moves, and what a lens makes of a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lensshift.camera.flat import GOLDEN
from lensshift.camera.radiometry import relative_illumination
from lensshift.camera.settings import LensOptics, PlainOptics, TofCamera
from lensshift.core.arrays import Array
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Intrinsics, Pinhole
from lensshift.core.optical import gaussian_width
from lensshift.optics.lens import Lens

_RINGS = 4  # of rays in the spots, 64 of them
_LIGHT_NODES = 17  # from the middle to the corner, where the light is traced
_FEW_RINGS = 8  # of rays that tell the light where many places are traced
_DENSE = np.linspace(0.0, 400.0, 40_001)  # pi times radii of the Airy disc


@dataclass(frozen=True, slots=True, eq=False)
class SpotBlur:
    """Where the light of a point lands around its image, over the sensor.

    Parameters
    ----------
    row_px, col_px : [node] rising places on the sensor
    landing_px : [node node ray 2] (row, col) from the image of the point; linear between the
        nodes, ray by ray
    weight : [node node ray] sums to 1 over the rays
    """

    row_px: Array
    col_px: Array
    landing_px: Array
    weight: Array

    def at(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return landing points [row col ray 2] and weights [row col ray] at [row], [col]."""
        rows, cols = (
            np.maximum(1.0 - np.abs(at[:, None] - np.arange(count)), 0.0)
            for at, count in zip(self.nodes_at(row_px, col_px), self.weight.shape, strict=False)
        )
        landing = np.einsum("rn,cm,nmki->rcki", rows, cols, self.landing_px, optimize=True)
        return landing, np.einsum("rn,cm,nmk->rck", rows, cols, self.weight, optimize=True)

    def nodes_at(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return where places [row], [col] lie between the nodes, which are evenly apart."""
        rows, cols = (
            np.clip((places - nodes[0]) / (nodes[1] - nodes[0]), 0.0, len(nodes) - 1.0)
            for nodes, places in ((self.row_px, row_px), (self.col_px, col_px))
        )
        return rows, cols


Motion = tuple[Array, float | SpotBlur]


def motions(camera: TofCamera, offset_px: Array) -> list[Motion]:
    """Return what differs in each frame of `offset_px` [frame 2] from what the camera at rest sees.

    Returns
    -------
    for each frame the offset in px [row col 2] of the pixels, or [1 1 2], at the centre of the
    sensor as asked for; and the blur: sigma in LR pixels of a Gaussian that is the same all over
    the sensor, or spots
    """
    if isinstance(camera.optics, PlainOptics):
        sigma_px = camera.optics.blur_sigma_px
        return [(offset[None, None, :], sigma_px) for offset in offset_px]
    return _lens_motions(camera.optics, camera.grid, offset_px)


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
        landing, weight = blur.at(*(np.array([0.5 * (size - 1)]) for size in shape))
        waves = np.exp(2j * np.pi * f * landing[0, 0, :, axis])
        return float(pixel * np.abs(weight[0, 0] @ waves))

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
        self._splines: tuple[Any, Any] | None = None
        # Light from (down, right) over what the f-number tells of the axis, [...] each.
        self.light: Callable[[Array, Array], Array]
        if isinstance(camera.optics, PlainOptics):
            focal_mm = camera.optics.focal_length_mm
            self.light = partial(relative_illumination, camera.optics, camera.grid)
        else:
            from lensshift.optics.directions import direction_splines
            from lensshift.optics.spots import image_per_field_mm

            focal_mm = image_per_field_mm(camera.optics.lens)
            self._splines = direction_splines(camera.optics.lens, camera.grid, margin_px)
            ends = (np.array([-margin_px, count - 1 + margin_px]) for count in camera.grid.shape)
            self.light = _traced_light(camera.optics.lens, *self.lattice(*ends))
        self.per_px = (camera.grid.pitch_mm[0] / focal_mm, camera.grid.pitch_mm[1] / focal_mm)

    def lattice(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return down and right over forward, [row col] each, at places [row] and [col]."""
        if self._splines is not None:
            down, right = (spline(row_px, col_px) for spline in self._splines)
            return down, right
        down, right = np.meshgrid(*self._straight(row_px, col_px), indexing="ij")
        return down, right

    def at(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        """Return down and right over forward, [...] each, at places [...]."""
        if self._splines is not None:
            down, right = (spline.ev(row_px, col_px) for spline in self._splines)
            return down, right
        return self._straight(row_px, col_px)

    def _straight(self, row_px: Array, col_px: Array) -> tuple[Array, Array]:
        rows, cols = self._grid.shape
        return (
            (row_px - 0.5 * (rows - 1)) * self.per_px[0],
            (col_px - 0.5 * (cols - 1)) * self.per_px[1],
        )


def _traced_light(lens: Lens, down: Array, right: Array) -> Callable[[Array, Array], Array]:
    """Return `View.light` of a lens at rest, as far as the directions of the corners of its view.

    A spline over the angle, or over both directions where the lens has no axis of symmetry; where
    vignetting sets in it is right to 0.008, or 0.015 without an axis.
    """
    from scipy.interpolate import CubicSpline, RectBivariateSpline

    from lensshift.optics.aberrations import relative_illumination as traced
    from lensshift.optics.spots import axial_light

    through = axial_light(lens)[0]  # the f-number counts what is stopped on the axis, too
    if lens.is_symmetric():
        tangent = np.linspace(0.0, np.hypot(down, right).max(), _LIGHT_NODES)
        light = through * traced(lens, tangent[:, None] * np.array([0.0, 1.0]))
        over_angle = CubicSpline(tangent, light)
        return lambda down, right: np.maximum(over_angle(np.hypot(down, right)), 0.0)
    downs, rights = (np.linspace(one.min(), one.max(), _LIGHT_NODES) for one in (down, right))
    fields = np.stack(np.meshgrid(downs, rights, indexing="ij"), axis=-1)
    light = through * traced(lens, fields, rings=_FEW_RINGS)
    over_both = RectBivariateSpline(downs, rights, light)
    return lambda down, right: np.maximum(over_both.ev(down, right), 0.0)


def _lens_motions(optics: LensOptics, grid: Grid, offset_px: Array) -> list[Motion]:
    from lensshift.optics.shift import decenter_for_shift

    if optics.element is None:
        (blur,) = _spot_blurs(optics, 0, grid, np.zeros((1, 2)))
        return [(offset[None, None, :], blur) for offset in offset_px]
    decenter_mm = decenter_for_shift(optics.lens, optics.element, offset_px, grid)
    fields_px = _offset_fields(optics.lens, optics.element, grid, decenter_mm)
    blurs = _spot_blurs(optics, optics.element, grid, decenter_mm)
    return list(zip(fields_px, blurs, strict=True))


def _offset_fields(lens: Lens, element: int, grid: Grid, decenter_mm: Array) -> Array:
    """Return the traced offset of every pixel, [frame row col 2], by splines between nodes."""
    from scipy.interpolate import RectBivariateSpline

    from lensshift.optics.directions import nodes_px
    from lensshift.optics.shift import shift_map

    rows, cols = (nodes_px(count, 1.0) for count in grid.shape)
    step_px = (float(rows[1] - rows[0]), float(cols[1] - cols[0]))
    pitch_mm = (step_px[0] * grid.pitch_mm[0], step_px[1] * grid.pitch_mm[1])
    coarse = Grid((len(rows), len(cols)), pitch_mm)
    field = shift_map(lens, element, decenter_mm, coarse).offset_px * step_px
    row, col = (np.arange(count, dtype=np.float64) for count in grid.shape)
    splines = [[RectBivariateSpline(rows, cols, one[..., i]) for i in (0, 1)] for one in field]
    return np.stack([np.stack([part(row, col) for part in pair], axis=-1) for pair in splines])


def _spot_blurs(optics: LensOptics, element: int, grid: Grid, decenter_mm: Array) -> list[SpotBlur]:
    """Return the spots of the lens in each frame."""
    from lensshift.optics.directions import nodes_px, places_mm
    from lensshift.optics.shift import moving
    from lensshift.optics.spots import fields_for_image, obstruction, spots

    rows, cols = (nodes_px(count, 0.5) for count in grid.shape)
    lens = optics.lens
    build = moving(lens, element, decenter_mm[:, None, None, :])
    near_mm = 1e-2 * min(grid.pitch_mm)  # the spots change slowly
    fields = fields_for_image(lens, places_mm(grid, rows, cols), build=build, tolerance_mm=near_mm)
    spot = spots(lens, fields, build=build, rings=_RINGS)
    landing_mm = spot.ray_mm
    if optics.diffraction:
        spread_mm = lens.wavelength_nm * 1e-6 * optics.f_number
        points = airy_points(landing_mm.shape[-2], obstruction(lens))
        landing_mm = landing_mm + points * spread_mm
        landing_mm -= np.einsum("...k,...ki->...i", spot.weight, landing_mm)[..., None, :]
    landing_px = landing_mm / np.asarray(grid.pitch_mm)
    pairs = zip(landing_px, spot.weight, strict=True)
    return [SpotBlur(rows, cols, landing, weight) for landing, weight in pairs]


def airy_points(count: int, inner: float = 0.0) -> Array:
    """Return points [point 2] of equal light of an Airy disc, in wavelength times f-number.

        light within r = 1 - J0(pi r)^2 - J1(pi r)^2
        light at r ~ [J1(pi r) - e J1(e pi r)]^2 / r^2,  behind a pupil with an obstruction e

    Their order goes evenly through radii and angles, so that each may be added to another ray.

    Source: Born, Wolf, Principles of Optics, section 8.5.
    """
    from scipy.special import j0, j1

    light = 1.0 - j0(_DENSE) ** 2 - j1(_DENSE) ** 2
    if inner:  # summed by trapezia; twice its whole is 1 - inner^2
        wave = j1(_DENSE) - inner * j1(inner * _DENSE)
        each = wave**2 / np.maximum(_DENSE, 1e-12)
        within = np.concatenate([[0.0], np.cumsum(0.5 * (each[1:] + each[:-1]))])
        light = 2.0 * within * (_DENSE[1] - _DENSE[0]) / (1.0 - inner**2)
    number = np.arange(count)
    share = (np.argsort(np.argsort(np.mod(number * GOLDEN, 1.0))) + 0.5) / count
    radius = np.interp(share, light, _DENSE) / np.pi
    angle = 2.0 * np.pi * np.mod(number * 2.0**0.5, 1.0)
    return np.asarray(radius[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1))
