"""Where rays meet many triangles: a tree of boxes, each around the triangles below it.

The tree is full: the children of node n are 2 n + 1 and 2 n + 2, and its leaves come last and hold
equally many triangles; some triangles are in two leaves to make it so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.arrays import Array
from lensshift.scene.kernels import NEAREST_M, Vector, local_ray

_IN_A_LEAF = 4  # triangles
_DEEPEST = 64  # levels of the tree: for 2^64 triangles
_FLAT = 1e-12  # sine of the angle between the edges of a triangle without area
_EDGE = 1e-12  # of an edge: rays through the edge of two triangles meet at least one of them


class Tree(NamedTuple):
    """Triangles in the order of the leaves, and the boxes around them."""

    # [triangle 3] a corner, and the edges from it to the others
    corner: Array
    edge_1: Array
    edge_2: Array
    # [node 3] corners of the boxes
    low: Array
    high: Array


def build_tree(corners: Array) -> Tree:
    """Return the tree of triangles given by their [triangle corner 3].

    Triangles whose corners lie on a line are left out: rounding alone would say where a ray meets
    them. ValueError if no triangle has an area.
    """
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    lengths = np.linalg.norm(edge_1, axis=1) * np.linalg.norm(edge_2, axis=1)
    corners = corners[np.linalg.norm(np.cross(edge_1, edge_2), axis=1) > _FLAT * lengths]
    if not len(corners):
        raise ValueError("expected triangles with an area, got none")
    leaves = 1
    while leaves * _IN_A_LEAF < len(corners):
        leaves *= 2
    corners = corners[_in_leaves(corners.mean(axis=1), leaves)]
    by_leaf = corners.reshape(leaves, -1, 3)
    low, high = [by_leaf.min(axis=1)], [by_leaf.max(axis=1)]
    while len(low[0]) > 1:
        low.insert(0, np.minimum(low[0][::2], low[0][1::2]))
        high.insert(0, np.maximum(high[0][::2], high[0][1::2]))
    corner, second, third = (np.ascontiguousarray(corners[:, i]) for i in range(3))
    return Tree(corner, second - corner, third - corner, np.concatenate(low), np.concatenate(high))


def _in_leaves(points: Array, leaves: int) -> NDArray[np.intp]:
    """Return which points the leaves hold, one leaf after the other, equally many each.

    All nodes of a level are halved at once, each along the axis on which its points spread most.
    """
    order = np.resize(np.arange(len(points)), leaves * -(-len(points) // leaves))
    nodes = 1
    while nodes < leaves:
        groups = order.reshape(nodes, -1)
        places = points[groups]
        widest = np.ptp(places, axis=1).argmax(axis=1)
        along = np.take_along_axis(places, widest[:, None, None], axis=2)[..., 0]
        order = np.take_along_axis(groups, along.argsort(axis=1, kind="stable"), axis=1)
        nodes *= 2
    return order.ravel()


@njit(cache=True, nogil=True, error_model="numpy")
def _enters_box(o: Vector, inverse: Vector, low: Array, high: Array, n: int, limit: float) -> float:
    """Return where a ray enters the box of node n, infinite if it does not before `limit`.

    0 / 0, a ray within a face, is NaN; it fails both comparisons and so excludes nothing.
    """
    enter, leave = 0.0, limit
    for i in range(3):
        near, far = (low[n, i] - o[i]) * inverse[i], (high[n, i] - o[i]) * inverse[i]
        if near > far:
            near, far = far, near
        if near > enter:
            enter = near
        if far < leave:
            leave = far
    return enter if enter <= leave else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_triangle(o: Vector, d: Vector, corner: Array, edge_1: Array, edge_2: Array) -> float:
    """Return the distance to a triangle, NaN if the line misses it or lies in its plane.

        o + t d = corner + u edge_1 + v edge_2,   u >= 0, v >= 0, u + v <= 1

    Source: Moeller, Trumbore, J. Graphics Tools 2 (1997) 21.
    """
    ax, ay, az = edge_1[0], edge_1[1], edge_1[2]
    bx, by, bz = edge_2[0], edge_2[1], edge_2[2]
    px, py, pz = d[1] * bz - d[2] * by, d[2] * bx - d[0] * bz, d[0] * by - d[1] * bx
    volume = ax * px + ay * py + az * pz
    if volume == 0.0:
        return np.nan
    sx, sy, sz = o[0] - corner[0], o[1] - corner[1], o[2] - corner[2]
    u = (sx * px + sy * py + sz * pz) / volume
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    v = (d[0] * qx + d[1] * qy + d[2] * qz) / volume
    if u < -_EDGE or v < -_EDGE or u + v > 1.0 + _EDGE:
        return np.nan
    return float((bx * qx + by * qy + bz * qz) / volume)


@njit(cache=True, nogil=True, error_model="numpy")
def meet_mesh(
    origin: Array, direction: Array, distance_m: Array, shape: Array, part: Array,
    index: int, centre: Array, rotation: Array,
    corner: Array, edge_1: Array, edge_2: Array, low: Array, high: Array,
) -> None:  # fmt: skip
    """Meet the triangles of a tree, the nearer child of each node first; see `Tree`."""
    leaves = (low.shape[0] + 1) // 2
    in_a_leaf = corner.shape[0] // leaves
    waiting = np.empty(_DEEPEST, np.int64)
    for r in range(direction.shape[0]):
        o, d = local_ray(origin, direction, r, centre, rotation)
        inverse = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
        waiting[0], height = 0, 1
        while height:
            height -= 1
            n = waiting[height]
            leaf = n - (leaves - 1)
            if leaf >= 0:
                for k in range(leaf * in_a_leaf, (leaf + 1) * in_a_leaf):
                    t = _meet_triangle(o, d, corner[k], edge_1[k], edge_2[k])
                    if NEAREST_M < t < distance_m[r]:
                        distance_m[r], shape[r], part[r] = t, index, k
                continue
            near, far = 2 * n + 1, 2 * n + 2
            enters_near = _enters_box(o, inverse, low, high, near, distance_m[r])
            enters_far = _enters_box(o, inverse, low, high, far, distance_m[r])
            if enters_near > enters_far:
                near, far, enters_near, enters_far = far, near, enters_far, enters_near
            for child, enters in ((far, enters_far), (near, enters_near)):
                if enters < np.inf:
                    waiting[height] = child
                    height += 1
