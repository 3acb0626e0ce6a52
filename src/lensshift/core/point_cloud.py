"""Points in space, with what is known of each: from distances and where the pixels look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Array, frozen
from lensshift.core.intrinsics import Intrinsics, points_m
from lensshift.core.showing import Shown


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointCloud(Shown):
    """Points of an image, row by row; pixels without a distance have none.

    Parameters
    ----------
    point_m : [n 3] (x right, y down, z forward) from the camera
    row, col : [n] pixel that each point is from
    amplitude : [n], or None
    std_m : [n] standard deviation along the ray, or None
    flying : [n] whether the pixel mixes two surfaces, or None
    normal : [n 3] of length 1, towards the camera, NaN where there are no neighbours; or None
    """

    point_m: NDArray[np.float64]
    row: NDArray[np.intp]
    col: NDArray[np.intp]
    amplitude: NDArray[np.float64] | None = None
    std_m: NDArray[np.float64] | None = None
    flying: NDArray[np.bool_] | None = None
    normal: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        count = len(self.point_m)
        for name in self.__dataclass_fields__:
            values = getattr(self, name)
            if values is None:
                continue
            shape = (count, 3) if name in ("point_m", "normal") else (count,)
            if np.shape(values) != shape:
                raise ValueError(f"expected {name} of shape {shape}, got {np.shape(values)}")
            object.__setattr__(self, name, frozen(values))

    def __len__(self) -> int:
        return len(self.point_m)

    def to_open3d(self) -> dict[str, NDArray[np.float32]]:
        """Return name -> [n ...] float32 as `open3d.t.geometry.PointCloud` names and takes them.

            cloud = open3d.t.geometry.PointCloud()
            for name, values in points.to_open3d().items():
                cloud.point[name] = open3d.core.Tensor(values)

        Those that are not known are left out; `std` is in metres along the ray.
        """
        named = {"positions": self.point_m, "normals": self.normal}
        named |= {"amplitude": self.amplitude, "std": self.std_m}
        return {
            name: np.ascontiguousarray(values.reshape(len(self), -1), np.float32)
            for name, values in named.items()
            if values is not None
        }


def make_cloud(
    distance_m: ArrayLike,
    intrinsics: Intrinsics,
    *,
    amplitude: ArrayLike | None = None,
    std_m: ArrayLike | None = None,
    flying: ArrayLike | None = None,
    keep_flying: bool = False,
    normals: bool = False,
) -> PointCloud:
    """Return the points of an image of radial distances; those that are not above 0 have none.

    ValueError if an image has another shape, or the intrinsics are those of another one.

    Parameters
    ----------
    distance_m, amplitude, std_m, flying : [row col]
    intrinsics : of this image
    keep_flying : whether pixels that mix two surfaces are kept
    normals : whether normals are computed, from neighbouring points that are kept
    """
    distance = np.asarray(distance_m, dtype=np.float64)
    place_m = points_m(distance, intrinsics)
    images = {"amplitude": amplitude, "std_m": std_m, "flying": flying}
    known = {name: np.asarray(image) for name, image in images.items() if image is not None}
    for name, image in known.items():
        if image.shape != distance.shape:
            raise ValueError(f"expected {name} of shape {distance.shape}, got {image.shape}")
    with np.errstate(invalid="ignore"):
        kept = np.isfinite(distance) & (distance > 0)
    if "flying" in known and not keep_flying:
        kept &= ~known["flying"].astype(bool)
    row, col = np.nonzero(kept)
    if normals:
        known["normal"] = surface_normals(np.where(kept[..., None], place_m, np.nan))
    fields = {name: image[kept] for name, image in known.items()}
    return PointCloud(place_m[kept], row, col, **fields)


def surface_normals(place_m: Array) -> NDArray[np.float64]:
    """Return the unit normals [row col 3] of points [row col 3], towards the origin.

        normal = down x right, each a mean of the steps s to the two neighbours, weighted |s|^-4

    All steps within a plane give its normal exactly; a step to another surface is long and counts
    nearly nothing. NaN where there is no neighbour along an axis.
    """
    down, right = _along(place_m), _along(place_m.swapaxes(0, 1)).swapaxes(0, 1)
    normal = np.cross(right, down)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        away = np.sum(normal * place_m, axis=-1, keepdims=True) > 0
    return np.asarray(np.where(away, -normal, normal))


def _along(place_m: Array) -> Array:
    """Return the mean step between neighbours along the first axis."""
    step = np.diff(place_m, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.sum(step * step, axis=-1, keepdims=True) ** -2.0
    known = np.isfinite(weight)
    step, weight = np.where(known, step, 0.0), np.where(known, weight, 0.0)
    total, sums = np.zeros((2, *place_m.shape))
    for part in (slice(1, None), slice(None, -1)):  # the step before a point, and the one after
        total[part] += weight
        sums[part] += weight * step
    with np.errstate(invalid="ignore"):
        return np.asarray(sums / total)
