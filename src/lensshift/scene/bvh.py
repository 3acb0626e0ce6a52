"""Where rays meet many triangles: a tree of boxes, each around the triangles below it.

Nodes are stored depth first: the left child of a node is the next node, `right` holds the other.
Triangles are stored in the order of the leaves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.scene.kernels import NEAREST_M, Vector, local_ray

Array = NDArray[Any]

_IN_A_LEAF = 4
_DEEPEST = 64  # halves 2^64 triangles
_EDGE = 1e-12  # of an edge: rays through the edge of two triangles meet at least one of them


class Tree(NamedTuple):
    """Triangles in the order of the leaves, and the boxes around them.

    Parameters
    ----------
    corner, edge_1, edge_2 : [triangle 3] a corner, and the edges from it to the others
    low, high : [node 3] corners of the boxes
    first, held : [node] the triangles of a leaf; it holds 0 where a node has children
    right, axis : [node] the right child, and the axis along which the children lie
    """

    corner: Array
    edge_1: Array
    edge_2: Array
    low: Array
    high: Array
    first: Array
    held: Array
    right: Array
    axis: Array


def build_tree(corners: Array) -> Tree:
    """Return the tree of triangles given by their [triangle corner 3]."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    order, *nodes = _split(low, high)
    corner, second, third = (np.ascontiguousarray(corners[order, i]) for i in range(3))
    return Tree(corner, second - corner, third - corner, *nodes)


@njit(cache=True, nogil=True, error_model="numpy")
def _split(low: Array, high: Array) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """Halve the triangles again and again along the axis on which their middles spread most."""
    triangles = low.shape[0]
    middle = 0.5 * (low + high)
    order = np.arange(triangles)
    node_low, node_high = np.empty((2 * triangles, 3)), np.empty((2 * triangles, 3))
    first, held = np.zeros(2 * triangles, np.int64), np.zeros(2 * triangles, np.int64)
    right, across = np.zeros(2 * triangles, np.int64), np.zeros(2 * triangles, np.int64)
    waiting = np.empty((_DEEPEST, 3), np.int64)  # begin, end, node whose right child it is or -1
    waiting[0] = 0, triangles, -1
    height, nodes = 1, 0
    while height:
        height -= 1
        begin, end, parent = waiting[height]
        node, nodes = nodes, nodes + 1
        if parent >= 0:
            right[parent] = node
        here = order[begin:end]
        spread = -1.0
        for i in range(3):
            node_low[node, i], node_high[node, i] = low[here, i].min(), high[here, i].max()
            width = middle[here, i].max() - middle[here, i].min()
            if width > spread:
                spread, across[node] = width, i
        if end - begin <= _IN_A_LEAF:
            first[node], held[node] = begin, end - begin
            continue
        order[begin:end] = here[np.argsort(middle[here, across[node]])]
        half = (begin + end) // 2
        waiting[height] = half, end, node
        waiting[height + 1] = begin, half, -1
        height += 2
    return (
        order, node_low[:nodes], node_high[:nodes], first[:nodes], held[:nodes], right[:nodes],
        across[:nodes],
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _misses_box(o: Vector, inverse: Vector, low: Array, high: Array, n: int, limit: float) -> bool:
    """Tell whether a ray passes by the box of node n, or meets it beyond `limit`.

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
    return enter > leave


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_triangle(o: Vector, d: Vector, corner: Array, edge_1: Array, edge_2: Array) -> float:
    """Return the distance to a triangle, NaN if the line misses it or it has no area.

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
    corner: Array, edge_1: Array, edge_2: Array,
    low: Array, high: Array, first: Array, held: Array, right: Array, axis: Array,
) -> None:  # fmt: skip
    """Meet the triangles of a tree, the nearer child of each node first; see `Tree`."""
    waiting = np.empty(_DEEPEST, np.int64)
    for r in range(direction.shape[0]):
        o, d = local_ray(origin, direction, r, centre, rotation)
        inverse = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
        waiting[0], height = 0, 1
        while height:
            height -= 1
            n = waiting[height]
            if _misses_box(o, inverse, low, high, n, distance_m[r]):
                continue
            for k in range(first[n], first[n] + held[n]):
                t = _meet_triangle(o, d, corner[k], edge_1[k], edge_2[k])
                if NEAREST_M < t < distance_m[r]:
                    distance_m[r], shape[r], part[r] = t, index, k
            if held[n] == 0:
                left_is_nearer = d[axis[n]] >= 0.0
                waiting[height] = right[n] if left_is_nearer else n + 1
                waiting[height + 1] = n + 1 if left_is_nearer else right[n]
                height += 2
