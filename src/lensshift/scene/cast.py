"""What rays meet in a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.scene.shapes import Rays, Scene, Shape

Array = NDArray[Any]

_RAYS_AT_ONCE = 65_536  # some 15 MB of work besides the result


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What each ray meets first; arrays with the leading axes `...` of the directions.

    Parameters
    ----------
    distance_m : [...] radial, from the origin of the ray; infinite where nothing is met
    reflectance : [...] of the surface, 0 where nothing is met
    cos_incidence : [...] of the angle between the normal and the way back, 0 to 1; 0 where
        nothing is met
    hit : [...] whether anything is met
    point_m : [... 3] (x, y, z) in the world, NaN where nothing is met
    normal : [... 3] of length 1, on the side that the ray comes from, NaN where nothing is met
    """

    distance_m: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    cos_incidence: NDArray[np.float64]
    hit: NDArray[np.bool_]
    point_m: NDArray[np.float64]
    normal: NDArray[np.float64]


def cast(scene: Scene, direction: ArrayLike, *, origin_m: ArrayLike = (0.0, 0.0, 0.0)) -> Hits:
    """Find what rays meet first, and how it scatters their light back.

        point = origin + distance direction / |direction|
        cos_incidence = - normal . direction / |direction|

    Parameters
    ----------
    direction : [... 3] (x, y, z), of any length but 0
    origin_m : (x, y, z), or [... 3] that broadcasts against `direction`

    Raises
    ------
    ValueError
        If a shape is not as above, a number is not finite, a direction has no length, or a
        texture returns anything but shares from 0 to 1.
    """
    vectors, origins = _vectors(direction, "direction"), _vectors(origin_m, "origin_m")
    try:
        shape = np.broadcast_shapes(vectors.shape, origins.shape)
    except ValueError as error:
        raise ValueError(
            f"expected origin_m that broadcasts against direction {vectors.shape}, "
            f"got {origins.shape}"
        ) from error
    vectors = np.broadcast_to(vectors, shape).reshape(-1, 3)
    origins = np.broadcast_to(origins, shape).reshape(-1, 3)
    hits = _nothing(len(vectors))
    for first in range(0, len(vectors), _RAYS_AT_ONCE):
        some = slice(first, first + _RAYS_AT_ONCE)
        _cast_some(scene, origins[some], _unit(vectors[some]), hits, first)
    return Hits(
        distance_m=hits.distance_m.reshape(shape[:-1]),
        reflectance=hits.reflectance.reshape(shape[:-1]),
        cos_incidence=hits.cos_incidence.reshape(shape[:-1]),
        hit=hits.hit.reshape(shape[:-1]),
        point_m=hits.point_m.reshape(shape),
        normal=hits.normal.reshape(shape),
    )


def _cast_some(scene: Scene, origin_m: Array, direction: Array, hits: Hits, first: int) -> None:
    """Cast some rays and write what they meet into `hits`, from ray `first` on."""
    rays = Rays.launch(origin_m, direction)
    for index, shape in enumerate(scene.shapes):
        shape.meet(rays, index)
    for index, shape in enumerate(scene.shapes):
        here = np.flatnonzero(rays.shape == index)
        if not here.size:
            continue
        towards, distance_m = direction[here], rays.distance_m[here]
        point_m = rays.origin_m[here] + distance_m[:, None] * towards
        local_m = (point_m - np.array(shape.centre_m)) @ shape.rotation
        normal, x_m, y_m = shape.surface(local_m, rays.part[here])
        normal = normal @ shape.rotation.T
        against = -np.einsum("ri,ri->r", normal, towards)
        normal = np.where(against[:, None] < 0, -normal, normal)
        seen = here + first
        hits.distance_m[seen] = distance_m
        hits.reflectance[seen] = _reflectance(shape, x_m, y_m)
        hits.cos_incidence[seen] = np.minimum(np.abs(against), 1.0)
        hits.hit[seen] = True
        hits.point_m[seen] = point_m
        hits.normal[seen] = normal


def _reflectance(shape: Shape, x_m: Array, y_m: Array) -> Array:
    share = np.asarray(shape.texture(x_m, y_m), dtype=np.float64)
    if share.shape != x_m.shape or not np.all((share >= 0) & (share <= 1)):
        name = shape.name or type(shape).__name__
        raise ValueError(
            f"expected a texture of {name} that returns one reflectance from 0 to 1 per point"
        )
    return share


def _nothing(count: int) -> Hits:
    return Hits(
        distance_m=np.full(count, np.inf),
        reflectance=np.zeros(count),
        cos_incidence=np.zeros(count),
        hit=np.zeros(count, dtype=np.bool_),
        point_m=np.full((count, 3), np.nan),
        normal=np.full((count, 3), np.nan),
    )


def _vectors(value: ArrayLike, name: str) -> Array:
    vectors = np.asarray(value, dtype=np.float64)
    if vectors.ndim < 1 or vectors.shape[-1] != 3:
        raise ValueError(f"expected {name} [... 3], got shape {vectors.shape}")
    if not np.all(np.isfinite(vectors)):
        raise ValueError(f"expected finite {name}, got infinity or NaN")
    return vectors


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not np.all(length > 0):
        raise ValueError("expected directions with a length, got one of zeros")
    return np.asarray(vectors / length)
