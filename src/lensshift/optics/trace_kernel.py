"""The inner loop of the ray trace: one ray after the other, surface after surface."""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array

# What can happen to a ray.
PASSED, MISSED, REFLECTED, VIGNETTED = 0, 1, 2, 3

_NEWTON_STEPS = 20  # it squares its error, or is lost
_CLOSE_MM = 1e-10  # the last step squares it
_Vector = tuple[float, float, float]


@njit(cache=True, nogil=True, error_model="numpy")
def _slope(
    square: float, curvature: float, conic: float, asphere: Array, s: int, terms: int,
    radial: Array, radial_terms: int,
) -> tuple[float, float]:  # fmt: skip
    """Return sag and d sag / d r^2 at the squared height r^2; NaN where the surface has ended."""
    root = np.sqrt(1.0 - (1.0 + conic) * curvature * curvature * square)
    sag = curvature * square / (1.0 + root)
    slope = 0.5 * curvature / root
    power = square
    for i in range(terms):
        slope += (i + 2) * asphere[s, i] * power
        power *= square
        sag += asphere[s, i] * power
    if radial_terms:
        height = np.sqrt(square)
        power = 1.0 / height if height > 0.0 else 0.0  # the tip of a cone has no slope
        for i in range(radial_terms):
            slope += 0.5 * (i + 1) * radial[s, i] * power
            power = 1.0 if i == 0 else power * height
            sag += radial[s, i] * power * height
    return sag, slope


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_conic(p: _Vector, d: _Vector, curvature: float, conic: float) -> float:
    """Return the distance along a ray from the vertex plane to a conic, NaN if it misses."""
    b = d[2] - curvature * (p[0] * d[0] + p[1] * d[1])
    square = curvature * (p[0] * p[0] + p[1] * p[1])
    inside = b * b - curvature * (1.0 + conic * d[2] * d[2]) * square
    return float(square / (b + np.sqrt(inside)))


@njit(cache=True, nogil=True, error_model="numpy")
def _meet(
    p: _Vector, d: _Vector, curvature: float, conic: float, asphere: Array, s: int, terms: int,
    radial: Array, radial_terms: int,
) -> float:  # fmt: skip
    """Return the distance along a ray from the vertex plane to a surface, NaN if it misses."""
    t = _meet_conic(p, d, curvature, conic)
    if terms == 0 and radial_terms == 0:
        return t
    if np.isnan(t):
        t = 0.0
    for _ in range(_NEWTON_STEPS):
        row, col = p[0] + t * d[0], p[1] + t * d[1]
        sag, slope = _slope(
            row * row + col * col, curvature, conic, asphere, s, terms, radial, radial_terms
        )
        step = (t * d[2] - sag) / (d[2] - 2.0 * slope * (row * d[0] + col * d[1]))
        t -= step
        if abs(step) < _CLOSE_MM:
            return t
        if np.isnan(step):
            return np.nan
    return np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _refract(d: _Vector, row: float, col: float, slope: float, ratio: float) -> _Vector:
    """Bend the direction by Snell's law in vector form; NaN if it is totally reflected."""
    n_row, n_col = -2.0 * slope * row, -2.0 * slope * col
    scale = 1.0 / np.sqrt(n_row * n_row + n_col * n_col + 1.0)
    cosine = (n_row * d[0] + n_col * d[1] + d[2]) * scale
    along = np.sqrt(1.0 - ratio * ratio * (1.0 - cosine * cosine)) - ratio * cosine
    along *= scale
    return ratio * d[0] + along * n_row, ratio * d[1] + along * n_col, ratio * d[2] + along


@njit(cache=True, nogil=True, error_model="numpy")
def _reflect(d: _Vector, row: float, col: float, slope: float) -> _Vector:
    """Reflect the direction, seen in the plane through the vertex so that it still goes on."""
    n_row, n_col = -2.0 * slope * row, -2.0 * slope * col
    twice = 2.0 * (n_row * d[0] + n_col * d[1] + d[2]) / (n_row * n_row + n_col * n_col + 1.0)
    return d[0] - twice * n_row, d[1] - twice * n_col, twice - d[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _vector(values: Array) -> _Vector:
    return values[0], values[1], values[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _into(m: Array, b: int, e: int, v: _Vector) -> _Vector:
    """Return a vector of the lens in the axes of an element."""
    return (
        m[b, e, 0, 0] * v[0] + m[b, e, 1, 0] * v[1] + m[b, e, 2, 0] * v[2],
        m[b, e, 0, 1] * v[0] + m[b, e, 1, 1] * v[1] + m[b, e, 2, 1] * v[2],
        m[b, e, 0, 2] * v[0] + m[b, e, 1, 2] * v[1] + m[b, e, 2, 2] * v[2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _out_of(m: Array, b: int, e: int, v: _Vector) -> _Vector:
    """Return a vector of an element in the axes of the lens."""
    return (
        m[b, e, 0, 0] * v[0] + m[b, e, 0, 1] * v[1] + m[b, e, 0, 2] * v[2],
        m[b, e, 1, 0] * v[0] + m[b, e, 1, 1] * v[1] + m[b, e, 1, 2] * v[2],
        m[b, e, 2, 0] * v[0] + m[b, e, 2, 1] * v[1] + m[b, e, 2, 2] * v[2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(
    m: Array, vertices: Array, b: int, e: int, p: _Vector, d: _Vector
) -> tuple[_Vector, _Vector]:
    """Return point and direction in the axes of an element."""
    v = _vector(vertices[b, e])
    return _into(m, b, e, (p[0] - v[0], p[1] - v[1], p[2] - v[2])), _into(m, b, e, d)


@njit(cache=True, nogil=True, error_model="numpy")
def _leave(
    m: Array, vertices: Array, b: int, e: int, p: _Vector, d: _Vector
) -> tuple[_Vector, _Vector]:
    """Return point and direction in the axes of the lens."""
    p, v = _out_of(m, b, e, p), _vector(vertices[b, e])
    return (p[0] + v[0], p[1] + v[1], p[2] + v[2]), _out_of(m, b, e, d)


@njit(cache=True, nogil=True, error_model="numpy")
def _along(p: _Vector, d: _Vector, t: float) -> _Vector:
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


# Inlined, or the trace takes 1.25 times as long.
@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _cross(
    p: _Vector, d: _Vector, s: int, depth: Array, curvature: Array, conic: Array, asphere: Array,
    terms: Array, radial: Array, radial_terms: Array,
) -> tuple[_Vector, float, float]:  # fmt: skip
    """Return where a ray meets a surface, how far that is, and the slope there, NaN if nowhere."""
    shape = curvature[s], conic[s], asphere, s, terms[s], radial, radial_terms[s]
    t = (depth[s] - p[2]) / d[2]
    t += _meet(_along(p, d, t), d, *shape)
    p = _along(p, d, t)
    return p, t, _slope(p[0] * p[0] + p[1] * p[1], *shape)[1]


@njit(cache=True, nogil=True, error_model="numpy")
def trace_kernel(
    origin: Array, direction: Array, path: Array, status: Array, failed_at: Array,
    heights: Array, crossings: Array, vertices: Array, rotations: Array, index: Array,
    plane: Array, element: Array, depth: Array, curvature: Array, conic: Array,
    asphere: Array, terms: Array, radial: Array, radial_terms: Array, mirror: Array,
    semi_diameter: Array, inner: Array, surfaces: int,
) -> None:  # fmt: skip
    """Trace rays in place through the first `surfaces` surfaces to a plane across the axis.

    Lengths in mm, vectors as (row, col, axial).

    Parameters
    ----------
    origin, direction : [batch ray 3], of length 1
    path : [batch ray] optical path so far
    status, failed_at : [batch ray] what happened, and at which surface
    heights : [batch ray surface] distance from the axis over semi-diameter, or [1 1 0]
    crossings : [batch ray surface 3] where each surface is met, or [1 1 0 3]
    vertices : [batch frame 3] the origin of each frame, the first vertex of an element
    rotations : [batch frame 3 3] from the frame to the lens
    index : [batch surface] refractive index behind each surface
    plane : [batch] axial position of the last plane
    element, depth : [surface] its frame, and how far its vertex lies behind the origin: those of
        an element share one, a surface that leans in its element has its own
    inner : [surface] what is stopped about the axis, over the semi-diameter
    curvature, conic, asphere, terms, semi_diameter : [surface], asphere [surface term] of which
        `terms` are used, and as many of powers of r as `radial_terms`
    mirror : [surface] whether it reflects; behind it everything is seen in its vertex plane
    """
    for b in range(origin.shape[0]):
        for r in range(origin.shape[1]):
            before, length = 1.0, path[b, r]
            p, d = _vector(origin[b, r]), _vector(direction[b, r])
            for s in range(surfaces):
                e = element[s]
                if s == 0 or element[s - 1] != e:
                    p, d = _enter(rotations, vertices, b, e, p, d)
                p, t, slope = _cross(
                    p, d, s, depth, curvature, conic, asphere, terms, radial, radial_terms
                )
                length += before * t
                if np.isnan(slope):
                    status[b, r], failed_at[b, r] = MISSED, s
                    break
                height = np.sqrt(p[0] * p[0] + p[1] * p[1]) / semi_diameter[s]
                if heights.shape[2]:
                    heights[b, r, s] = height
                if crossings.shape[2]:
                    met = _leave(rotations, vertices, b, e, p, d)[0]
                    for i in range(3):
                        crossings[b, r, s, i] = met[i]
                if (height > 1.0 or height < inner[s]) and status[b, r] == PASSED:
                    status[b, r], failed_at[b, r] = VIGNETTED, s
                if mirror[s]:
                    d = _reflect(d, p[0], p[1], slope)
                    p = (p[0], p[1], 2.0 * depth[s] - p[2])
                else:
                    d = _refract(d, p[0], p[1], slope, before / index[b, s])
                if np.isnan(d[2]):
                    status[b, r], failed_at[b, r] = REFLECTED, s
                    break
                before = index[b, s]
                if s == surfaces - 1 or element[s + 1] != e:
                    p, d = _leave(rotations, vertices, b, e, p, d)
            t = (plane[b] - p[2]) / d[2]
            if status[b, r] == MISSED or status[b, r] == REFLECTED:
                t = np.nan
            for i in range(3):
                origin[b, r, i] = p[i] + t * d[i]
                direction[b, r, i] = d[i] + 0.0 * t
            path[b, r] = length + before * t
