"""Where each pixel looks: what turns radial distances into points.

Directions are (x right, y down, z forward), as in OpenCV and in the optical frames of ROS. They are
those of the image at offset (0, 0), with the lens at rest.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats, frozen
from lensshift.core.errors import DataError, warn_quality
from lensshift.core.grid import Grid, hr_to_lr, lr_to_hr
from lensshift.core.units import doubt_about_focal_length

_STEPS = 30  # of Newton's method: distortion that needs more is none of a lens
_CONVERGED = 1e-12  # of a tangent: 1e-12 of the distance


@dataclass(frozen=True, slots=True)
class Pinhole:
    """A pinhole with the distortion of Brown and Conrady.

        u = fx x' + cx,  v = fy y' + cy                  (col, row), pixel centres at integers
        x' = x R + 2 p1 x y + p2 (r^2 + 2 x^2),  y' = y R + p1 (r^2 + 2 y^2) + 2 p2 x y
        R = 1 + k1 r^2 + k2 r^4 + k3 r^6,  r^2 = x^2 + y^2,  (x, y) = (right, down) / forward

    Parameters
    ----------
    fx_px, fy_px : focal length in pixels along columns and rows
    cx_px, cy_px : column and row of the principal point
    k1, k2, p1, p2, k3 : distortion, in the order of OpenCV

    Raises
    ------
    ValueError
        If a number is not finite, or a focal length not positive.

    Source: Brown, Photogrammetric Engineering 32 (1966), 444.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(astuple(self))) or not min(self.fx_px, self.fy_px) > 0:
            raise ValueError(f"expected finite numbers and focal lengths above 0, got {self}")

    @classmethod
    def centred(cls, grid: Grid, fx_px: float, fy_px: float | None = None) -> Pinhole:
        """Return a pinhole over the middle of a grid.

        Parameters
        ----------
        fy_px : None: from `fx_px`, for pixels of the grid's pitch behind one lens

        Warns
        -----
        QualityWarning
            If the field of view can hardly be that of a lens.
        """
        if fx_px > 0 and (doubt := doubt_about_focal_length(fx_px, grid.shape[1])):
            warn_quality(doubt)
        rows, cols = grid.shape
        if fy_px is None:
            fy_px = fx_px * grid.pitch_mm[1] / grid.pitch_mm[0]
        return cls(float(fx_px), float(fy_px), 0.5 * (cols - 1), 0.5 * (rows - 1))

    @classmethod
    def of_focal_length(cls, grid: Grid, focal_length_mm: float) -> Pinhole:
        """Return a pinhole at this distance from the middle of a grid; warns as `centred`."""
        return cls.centred(grid, focal_length_mm / grid.pitch_mm[1])

    @classmethod
    def of_field(cls, grid: Grid, width_rad: float, height_rad: float | None = None) -> Pinhole:
        """Return the pinhole whose field of view, from border to border, has these angles.

        Parameters
        ----------
        height_rad : None: what pixels of the grid's pitch give
        """
        angles = [angle for angle in (width_rad, height_rad) if angle is not None]
        if not all(0 < angle < np.pi for angle in angles):
            raise ValueError(f"expected angles above 0 and below 180 degrees, got {angles} rad")
        both = zip(grid.shape[::-1], angles, strict=False)
        return cls.centred(grid, *(0.5 * size / np.tan(0.5 * angle) for size, angle in both))

    def directions(self, shape: tuple[int, int]) -> Floats:
        """Return the unit direction [row col 3] of every pixel of an image.

        Raises
        ------
        ValueError
            If the distortion folds the image, so that a pixel looks nowhere.
        """
        u, v = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in shape[::-1]))
        wanted = np.stack([(u - self.cx_px) / self.fx_px, (v - self.cy_px) / self.fy_px])
        x, y = place = wanted.copy()
        if any((self.k1, self.k2, self.p1, self.p2, self.k3)):
            with np.errstate(all="ignore"):  # where it folds, Newton's method runs away
                converged = self._undistort(place, wanted)
            if not converged:
                raise ValueError(
                    f"expected a distortion that does not fold an image of {shape[1]} x "
                    f"{shape[0]} pixels, got {self}"
                )
        return _unit(np.stack([x, y, np.ones_like(x)], axis=-1))

    def _undistort(self, place: Floats, wanted: Floats) -> bool:
        """Change tangents [2 ...] into those that are distorted to the wanted ones."""
        x, y = place
        k1, k2, p1, p2, k3 = self.k1, self.k2, self.p1, self.p2, self.k3
        for _ in range(_STEPS):
            square = x * x + y * y
            radial = 1.0 + square * (k1 + square * (k2 + square * k3))
            slope = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))  # dR/dr / r
            off_x = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x) - wanted[0]
            off_y = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y - wanted[1]
            xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
            area = xx * yy - xy * xy  # falls to 0 where the image folds
            x -= (yy * off_x - xy * off_y) / area
            y -= (xx * off_y - xy * off_x) / area
            if np.max(np.hypot(off_x, off_y)) < _CONVERGED:
                return bool(np.all(area > 0))
        return False

    def refine(self, scale: int) -> Pinhole:
        """Return the intrinsics of the grid with `scale` times finer pixels."""
        cx_px, cy_px = lr_to_hr([self.cx_px, self.cy_px], scale).tolist()
        fx_px, fy_px = self.fx_px * scale, self.fy_px * scale
        return replace(self, fx_px=fx_px, fy_px=fy_px, cx_px=cx_px, cy_px=cy_px)

    def crop(self, rows: slice, cols: slice) -> Pinhole:
        """Return the intrinsics of a part of the image that begins at `start` of the slices."""
        first = [_start(part) for part in (rows, cols)]
        return replace(self, cx_px=self.cx_px - first[1], cy_px=self.cy_px - first[0])


@dataclass(frozen=True, slots=True, eq=False)
class PixelDirections:
    """A direction for every pixel, for lenses that no formula describes.

    Parameters
    ----------
    direction : [row col 3] (x right, y down, z forward) of any length but 0; kept with length 1

    Raises
    ------
    ValueError
        If the shape is another, or a direction is not finite or has no length.
    """

    direction: Floats

    def __post_init__(self) -> None:
        direction = np.asarray(self.direction, dtype=np.float64)
        if direction.ndim != 3 or direction.shape[2] != 3 or not direction.size:
            raise ValueError(f"expected directions [row col 3], got shape {direction.shape}")
        if not np.all(np.isfinite(direction)) or not np.all(direction.any(axis=2)):
            raise ValueError("expected finite directions with a length for every pixel")
        object.__setattr__(self, "direction", frozen(_unit(direction)))

    def directions(self, shape: tuple[int, int]) -> Floats:
        """Return the unit direction [row col 3] of every pixel of an image.

        Raises
        ------
        DataError
            As `check_fits`.
        """
        self.check_fits(shape)
        return self.direction

    def refine(self, scale: int) -> PixelDirections:
        """Return the directions of `scale` times finer pixels, by cubic splines between pixels.

        Raises
        ------
        ValueError
            If there are less than two rows or columns to interpolate between.
        """
        if scale == 1:
            return self
        from scipy.interpolate import make_interp_spline

        fine: Any = self.direction
        if min(fine.shape[:2]) < 2:
            raise ValueError(f"expected at least two rows and columns to refine, got {fine.shape}")
        for axis in (0, 1):
            count = fine.shape[axis]
            spline = make_interp_spline(np.arange(count), fine, k=min(3, count - 1), axis=axis)
            fine = spline(hr_to_lr(np.arange(count * scale), scale))
        return PixelDirections(fine)

    def crop(self, rows: slice, cols: slice) -> PixelDirections:
        """Return the directions of a part of the image."""
        return PixelDirections(self.direction[_start(rows) : rows.stop, _start(cols) : cols.stop])

    def check_fits(self, shape: tuple[int, int]) -> None:
        """Refuse another image.

        Raises
        ------
        DataError
            If the shape differs.
        """
        if self.direction.shape[:2] != tuple(shape):
            problem = f"expected directions for {shape} pixels, got {self.direction.shape[:2]}"
            raise DataError(problem, field="intrinsics")


Intrinsics = Pinhole | PixelDirections


def points_m(distance_m: ArrayLike, intrinsics: Intrinsics) -> Floats:
    """Return the points [row col 3] (x right, y down, z forward) of radial distances [row col].

        point = distance * unit direction

    Not to be mixed up with depth images, whose numbers are z.
    """
    distance = np.asarray(distance_m, dtype=np.float64)
    if distance.ndim != 2:
        raise ValueError(f"expected distances [row col], got shape {distance.shape}")
    rows, cols = distance.shape
    return np.asarray(distance[..., None] * intrinsics.directions((rows, cols)))


def _unit(direction: Floats) -> Floats:
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def _start(part: slice) -> int:
    start = 0 if part.start is None else part.start
    if start < 0 or part.step not in (None, 1) or (part.stop is not None and part.stop <= start):
        raise ValueError(
            f"expected a slice from 0 on, without a step, that is not empty, got {part}"
        )
    return int(start)
