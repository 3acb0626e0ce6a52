"""All pixels as sums over nodes, for one place of the edge: enough for every shape of it.

The model is y = F b + V(q) a + Z c: `fixed` columns F (level, uneven light, and how the pixels
change as the edge turns and bends), columns V that follow the base model of the response, splines
Z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector
from lensshift.evaluation.slanted_edge.node_kernels import (
    node_products,
    node_reach,
    times_nodes,
)
from lensshift.evaluation.slanted_edge.nodes import Between, Nodes
from lensshift.evaluation.slanted_edge.samples import EdgeSamples


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a column that follows the response is: P_k(along) times a factor times the response.

    Parameters
    ----------
    power : k
    factor : [g] at the nodes
    """

    power: int
    factor: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Sums over the pixels, whitened.

    Parameters
    ----------
    geometry : of the edge, about which its moves are counted
    nodes : along its normal
    pixels : between which nodes the pixels lie
    fixed : [n f] columns F as the pixels see them: a level, turn and bends of the edge, light
    powers : [n k] Legendre polynomials along the edge
    seen : the columns V, the response itself first
    count : number of whitened pixels, those rounded alike as one
    squares, fixed_values, fixed_fixed : y^T y, F^T y [f], F^T F [f f]
    splines : [j+f+1 j] and
    node_sums : of each power [j+f+1 g]: sums of splines, fixed columns and values with both
    node_node, reach : of each pair of powers [k k g g]; between which nodes [g 2] they are not 0
    precision, centre : [f] prior of the factors of F: those of bends are normal about `centre`
    """

    geometry: Vector
    nodes: Nodes
    pixels: Between
    fixed: Matrix
    powers: Matrix
    seen: tuple[Seen, ...]
    count: float
    squares: float
    fixed_values: Vector
    fixed_fixed: Matrix
    splines: Matrix
    node_sums: list[Matrix]
    node_node: NDArray[np.float64]
    reach: NDArray[np.intp]
    precision: Vector
    centre: Vector

    @property
    def moves(self) -> slice:
        """The columns of `fixed` that turn and bend the edge."""
        return slice(1, self.geometry.size)

    @property
    def response(self) -> int:
        """Which level is the factor of the response."""
        return int(self.fixed.shape[1])


def gather(samples: EdgeSamples, nodes: Nodes, geometry: Vector, slope: Vector) -> Gathered:
    """Return the sums about one geometry.

    Parameters
    ----------
    samples, nodes : pixels, and nodes that reach as far
    geometry : of the edge
    slope : [g] the LSF at the nodes, a guess, by which the pixels change as the edge turns
    """
    normal_px = samples.normal_px(geometry)
    pixels = nodes.between(normal_px)
    powers = samples.powers(max(geometry.size - 1, samples.light))
    across = nodes.place_px / nodes.place_px[-1]
    fixed = _fixed(samples, geometry, pixels.of(slope), powers, normal_px / nodes.place_px[-1])
    seen = _seen(across, samples.light)
    powers = np.ascontiguousarray(powers[:, : 1 + max(one.power for one in seen)])
    right = np.column_stack([fixed, samples.values])
    whitener = samples.whitener
    if whitener is None:
        whitener = sparse.eye_array(samples.values.size, format="csr")
    else:
        right = np.ascontiguousarray(whitener @ right)
    kinds, size = powers.shape[1], across.size
    products = np.zeros((kinds, kinds, size, size))
    with_right = np.zeros((kinds, size, right.shape[1]))
    rows = (whitener.indptr, whitener.indices, whitener.data)
    node_products(*rows, pixels.first, pixels.shares, powers, right, products, with_right)
    reach = np.empty((size, 2), dtype=np.intp)
    node_reach(products, reach)
    node_sums, splines = [], np.empty_like(nodes.integrals)
    for row, own in zip(products, with_right, strict=True):
        times_nodes(row[0], reach, nodes.integrals, splines)
        node_sums.append(np.vstack([splines.T, own.T]))
    sums = right.T @ right
    precision, centre = np.zeros(fixed.shape[1]), np.zeros(fixed.shape[1])
    bends = slice(2, geometry.size)
    precision[bends], centre[bends] = samples.bend_spread_px**-2.0, -geometry[2:]
    return Gathered(
        geometry=geometry,
        nodes=nodes,
        pixels=pixels,
        fixed=fixed,
        powers=powers,
        seen=seen,
        count=samples.unlike * len(right),
        squares=float(sums[-1, -1]),
        fixed_values=sums[:-1, -1],
        fixed_fixed=sums[:-1, :-1],
        splines=node_sums[0] @ nodes.integrals,
        node_sums=node_sums,
        node_node=products,
        reach=reach,
        precision=precision,
        centre=centre,
    )


def _seen(across: Vector, light: int) -> tuple[Seen, ...]:
    """Return the columns that follow the response: itself, and as uneven light changes it."""
    ones = np.ones_like(across)
    seen = [Seen(0, ones)]
    if light:
        seen += [Seen(0, across), Seen(1, ones)]
    if light > 1:
        seen += [Seen(0, across**2 - 1.0 / 3.0), Seen(2, 2.0 / 3.0 * ones), Seen(1, across)]
    return tuple(seen)


def _fixed(
    samples: EdgeSamples, geometry: Vector, slope: Vector, powers: Matrix, across: Vector
) -> Matrix:
    columns = [np.ones_like(slope), slope * samples.turn_px(float(geometry[0]))]
    columns += [-slope * powers[:, k] for k in range(2, geometry.size)]
    if samples.light:
        columns += [across, powers[:, 1]]
    if samples.light > 1:
        columns += [across**2 - 1.0 / 3.0, 2.0 / 3.0 * powers[:, 2], across * powers[:, 1]]
    return np.column_stack(columns)
