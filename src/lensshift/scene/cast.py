"""What rays meet in a scene."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.scene.shapes import Rays, Scene

_RAYS_AT_ONCE = 16_384  # some 5 MB of work besides the result
_END_M = 1e-6  # far above the rounding of points, far below the size of things


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

    distance_m: Floats
    reflectance: Floats
    cos_incidence: Floats
    hit: Mask
    point_m: Floats
    normal: Floats


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
    vectors, origins, axes = _broadcast(direction=direction, origin_m=origin_m)
    if not np.all(np.isfinite(vectors)) or not np.all(np.isfinite(origins)):
        raise ValueError("expected finite direction and origin_m, got infinity or NaN")
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not np.all(length > 0):
        raise ValueError("expected directions with a length, got one of zeros")
    count = len(vectors)
    light, cosine, hit = np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.bool_)
    point_m, normal = (np.full((count, 3), np.nan) for _ in range(2))
    hits = Hits(np.full(count, np.inf), light, cosine, hit, point_m, normal)
    for first in range(0, count, _RAYS_AT_ONCE):
        some = slice(first, first + _RAYS_AT_ONCE)
        _cast_some(scene, origins[some], vectors[some] / length[some], hits, first)
    found = {one.name: getattr(hits, one.name) for one in fields(hits)}
    return Hits(**{name: each.reshape((*axes, *each.shape[1:])) for name, each in found.items()})


def visible(scene: Scene, from_m: ArrayLike, to_m: ArrayLike) -> Mask:
    """Tell which points see each other: nothing stands between the ends of a segment.

    For shadows of a light beside the camera and for light that bounces twice. Surfaces within
    1 um of an end do not block, so that both ends may lie on surfaces.

    Parameters
    ----------
    from_m, to_m : [... 3] (x, y, z) in the world, broadcast against each other; a point that is
        not finite (`Hits.point_m` where nothing was met) sees nothing

    Raises
    ------
    ValueError
        If a shape is not as above.
    """
    starts, ends, axes = _broadcast(from_m=from_m, to_m=to_m)
    clear = np.empty(len(starts), dtype=np.bool_)
    for first in range(0, len(starts), _RAYS_AT_ONCE):
        some = slice(first, first + _RAYS_AT_ONCE)
        clear[some] = _clear(scene, starts[some], ends[some])
    return clear.reshape(axes)


def _clear(scene: Scene, start_m: Array, end_m: Array) -> Array:
    known = np.all(np.isfinite(start_m), axis=1) & np.all(np.isfinite(end_m), axis=1)
    start_m, away_m = start_m[known], end_m[known] - start_m[known]
    length_m = np.linalg.norm(away_m, axis=1)
    direction = away_m / np.maximum(length_m, _END_M)[:, None]
    rays = Rays.launch(start_m + _END_M * direction, direction, length_m - 2 * _END_M)
    for index, shape in enumerate(scene.shapes):
        shape.meet(rays, index)
    clear = np.zeros(len(known), dtype=np.bool_)
    clear[known] = rays.shape < 0
    return clear


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
        share = np.asarray(shape.texture(x_m, y_m), dtype=np.float64)
        if share.shape != x_m.shape or not np.all((share >= 0) & (share <= 1)):
            of = f"expected a texture of {shape.name or type(shape).__name__}"
            raise ValueError(f"{of} that returns one reflectance from 0 to 1 per point")
        seen = here + first
        hits.distance_m[seen] = distance_m
        hits.reflectance[seen] = share
        hits.cos_incidence[seen] = np.minimum(np.abs(against), 1.0)
        hits.hit[seen] = True
        hits.point_m[seen] = point_m
        hits.normal[seen] = normal


def _broadcast(
    **named: ArrayLike,
) -> tuple[Array, Array, tuple[int, ...]]:
    """Return two lists of vectors [ray 3] of equal length, and their common leading axes."""
    vectors = {name: np.asarray(each, dtype=np.float64) for name, each in named.items()}
    for name, vector in vectors.items():
        if vector.ndim < 1 or vector.shape[-1] != 3:
            raise ValueError(f"expected {name} [... 3], got shape {vector.shape}")
    try:
        one, other = np.broadcast_arrays(*vectors.values())
    except ValueError as error:
        shapes = " and ".join(str(one.shape) for one in vectors.values())
        problem = f"expected {' and '.join(vectors)} that broadcast, got shapes {shapes}"
        raise ValueError(problem) from error
    return one.reshape(-1, 3), other.reshape(-1, 3), one.shape[:-1]
