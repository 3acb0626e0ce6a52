"""Where rays meet simple shapes: one ray after the other, in the axes of the shape.

Every kernel keeps a hit only if it is nearer than what the ray has met so far, and then writes
the distance, the index of the shape, and which part of the shape was met.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array

Vector = tuple[float, float, float]

# A ray that starts on a surface does not meet it there: rounding is 1e-15 m at a few metres.
NEAREST_M = 1e-9


@njit(cache=True, nogil=True, error_model="numpy")
def into(rotation: Array, x: float, y: float, z: float) -> Vector:
    """Return a vector of the world in the axes of a shape, the columns of its rotation."""
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def local_ray(
    origin: Array, direction: Array, r: int, centre: Array, rotation: Array
) -> tuple[Vector, Vector]:
    """Return origin and direction of ray r in the axes of a shape."""
    start = into(
        rotation, origin[r, 0] - centre[0], origin[r, 1] - centre[1], origin[r, 2] - centre[2]
    )
    return start, into(rotation, direction[r, 0], direction[r, 1], direction[r, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def meet_rectangle(
    origin: Array, direction: Array, distance_m: Array, shape: Array, part: Array,
    index: int, centre: Array, rotation: Array, half: Array,
) -> None:  # fmt: skip
    """Meet the plane z = 0 where |x| <= half[0] and |y| <= half[1]."""
    for r in range(direction.shape[0]):
        o, d = local_ray(origin, direction, r, centre, rotation)
        t = -o[2] / d[2]  # infinite or NaN for a ray along the plane: no hit
        if (
            NEAREST_M < t < distance_m[r]
            and abs(o[0] + t * d[0]) <= half[0]
            and abs(o[1] + t * d[1]) <= half[1]
        ):
            distance_m[r], shape[r], part[r] = t, index, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _between_faces(o: Vector, d: Vector, half: Array) -> tuple[float, int, float, int]:
    """Return where a line enters and leaves a cuboid, and across which axis; enter > leave: misses.

    Source: Kay, Kajiya, SIGGRAPH 1986, 269 (slabs).
    """
    enter, enter_axis, leave, leave_axis = -np.inf, 0, np.inf, 0
    for axis in range(3):
        if d[axis] == 0.0:
            if abs(o[axis]) > half[axis]:
                return np.inf, axis, -np.inf, axis
            continue
        near, far = (-half[axis] - o[axis]) / d[axis], (half[axis] - o[axis]) / d[axis]
        if near > far:
            near, far = far, near
        if near > enter:
            enter, enter_axis = near, axis
        if far < leave:
            leave, leave_axis = far, axis
    return enter, enter_axis, leave, leave_axis


@njit(cache=True, nogil=True, error_model="numpy")
def meet_cuboid(
    origin: Array, direction: Array, distance_m: Array, shape: Array, part: Array,
    index: int, centre: Array, rotation: Array, half: Array,
) -> None:  # fmt: skip
    """Meet the faces of a cuboid, from outside or inside; the part is the axis across the face."""
    for r in range(direction.shape[0]):
        o, d = local_ray(origin, direction, r, centre, rotation)
        enter, enter_axis, leave, leave_axis = _between_faces(o, d, half)
        if enter > leave:
            continue
        t, axis = (enter, enter_axis) if enter > NEAREST_M else (leave, leave_axis)
        if NEAREST_M < t < distance_m[r]:
            distance_m[r], shape[r], part[r] = t, index, axis


@njit(cache=True, nogil=True, error_model="numpy")
def meet_sphere(
    origin: Array, direction: Array, distance_m: Array, shape: Array, part: Array,
    index: int, centre: Array, rotation: Array, radius_m: float,
) -> None:  # fmt: skip
    """Meet a sphere from outside or inside.

    The distance of the line from the centre is taken from the point next to it, not from the
    difference of two large squares.
    """
    for r in range(direction.shape[0]):
        o, d = local_ray(origin, direction, r, centre, rotation)
        to_foot = -(o[0] * d[0] + o[1] * d[1] + o[2] * d[2])
        x, y, z = o[0] + to_foot * d[0], o[1] + to_foot * d[1], o[2] + to_foot * d[2]
        square = radius_m * radius_m - (x * x + y * y + z * z)
        if square < 0.0:
            continue
        half_chord = np.sqrt(square)
        t = to_foot - half_chord
        if t <= NEAREST_M:
            t = to_foot + half_chord
        if NEAREST_M < t < distance_m[r]:
            distance_m[r], shape[r], part[r] = t, index, 0
