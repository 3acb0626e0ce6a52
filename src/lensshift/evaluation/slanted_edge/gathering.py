"""All pixels as sums over nodes, for one place of the edge: enough for every shape of it.

The model is y = F b + V(q) a + Z c: `fixed` columns F (level, uneven light, and how the pixels
change as the edge turns and bends), columns V that follow the base model of the response, splines
Z. A pixel sees a function of its distance from the edge through four nodes along the normal (cubic
interpolation): all pixels enter the fit as sums over pairs of nodes, and their number matters no
longer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lensshift.evaluation.slanted_edge import kernels
from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector

# Prior standard deviation of the bending terms, as a share of the half length of the edge.
_BENDING_SHARE = 0.05
# Up to the first number of units from the edge, steps of the second: a pixel as narrow as the prior
# allows, then a quarter of the distance of the splines, then half of it.
_ZONES = ((2.0, 1 / 32), (6.0, 1 / 16), (16.0, 1 / 4))
_FAR_STEP, _FARTHEST_STEP = 1 / 2, 1.0  # up to the end of the splines, and beyond
_MARGIN = 2
_KNOT_STEP = 1 / 4


@dataclass(frozen=True, slots=True)
class EdgeSamples:
    """Pixels of one or several frames, in units of the contrast, the bright side at positive x."""

    across_px: Vector  # [n] coordinates of the pixels, from the edge's middle
    along_px: Vector
    half_length_px: float  # half the length of the edge along `along_px`
    light: int  # order of the uneven illumination: 0 even, 1 a plane, 2 a bowl
    values: Vector  # [n] the pixels
    whitener: sparse.csr_array | None  # [m n] what makes their noise white, None for nothing
    unlike: float = 1.0  # share of the pixels that tell something of their own, see `Rounding`


def distance_px(
    across_px: Vector, along_px: Vector, geometry: Vector, half_length_px: float
) -> Vector:
    """Return the signed distance from an edge of geometry t, rho, g_2, g_3, ...

        d = x cos t + y sin t - rho - sum_k g_k P_k(y / half length)

    with Legendre polynomials P_k.
    """
    normal_px: Vector = across_px * np.cos(geometry[0]) + along_px * np.sin(geometry[0])
    normal_px -= geometry[1]
    if geometry.size > 2:
        bending = np.concatenate([[0.0, 0.0], geometry[2:]])
        normal_px -= np.polynomial.legendre.legval(along_px / half_length_px, bending)
    return normal_px


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """Where pixels lie between nodes."""

    first: NDArray[np.intp]  # [n] the first of the four nodes around each
    shares: NDArray[np.float64]  # [n 4] of these

    def of(self, values: Vector) -> Vector:
        """Return at the pixels what is `values` [g] at the nodes."""
        around = values[self.first[:, None] + np.arange(4)]
        return np.asarray(np.einsum("ns,ns->n", self.shares, around))


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Places along the normal, and the splines there."""

    place_px: Vector  # [g] rising, symmetric about the edge
    integrals: Matrix  # [g j] of the splines
    values: Matrix

    def between(self, normal_px: Vector) -> Between:
        """Return where distances [n] lie."""
        first = np.searchsorted(self.place_px, normal_px)
        shares = np.empty((normal_px.size, 4))
        kernels.between_nodes(normal_px, self.place_px, first, shares)
        return Between(first, shares)


def splines_for(units: float, unit_px: float) -> SplineBasis:
    """Return splines that reach some units, a quarter of a unit apart near the edge."""
    return SplineBasis.covering(units * unit_px, _KNOT_STEP * unit_px, unit_px)


def nodes_for(basis: SplineBasis, unit_px: float, aperture_px: float, farthest_px: float) -> Nodes:
    """Return nodes, in steps of `unit_px`, for base model and splines up to the farthest pixel."""
    core = np.ceil(32.0 * _ZONES[0][0] * max(1.0, aperture_px / unit_px)) / 32.0
    near = _near(float(basis.number[-1] * _KNOT_STEP), float(core))
    end, last = near.place_px[-1], farthest_px / unit_px + _MARGIN * _FARTHEST_STEP
    count = max(int(np.ceil((last - end) / _FARTHEST_STEP)), 0)
    beyond = end + _FARTHEST_STEP * np.arange(1, count + 1)
    whole = np.tile(near.integrals[-1], (count, 1))
    none = np.zeros_like(whole)
    return Nodes(
        unit_px * np.concatenate([-beyond[::-1], near.place_px, beyond]),
        unit_px * np.vstack([none, near.integrals, whole]),
        np.vstack([none, near.values, none]),
    )


@lru_cache(maxsize=32)
def _near(units: float, core: float) -> Nodes:
    """Return the nodes as far as the splines reach, in units."""
    basis = splines_for(units, 1.0)
    parts, place = [], 0.0
    for limit, step in ((core, _ZONES[0][1]), *_ZONES[1:], (basis.reach_px, _FAR_STEP)):
        if limit > place:
            count = int(np.ceil((limit - place) / step))
            parts.append(place + step * np.arange(count))
            place += step * count
    right = np.append(np.concatenate(parts), place)
    places = np.concatenate([-right[:0:-1], right])
    return Nodes(places, basis.integrals(places), basis.values(places))


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Sums over the pixels, whitened."""

    geometry: Vector  # of the edge, about which its moves are counted
    nodes: Nodes  # along its normal
    pixels: Between  # between which nodes the pixels lie
    # [n f] columns F as the pixels see them: a level, turn and bends of the edge, light
    fixed: Matrix
    powers: Matrix  # [n k] Legendre polynomials along the edge
    # k and factor [g] of the columns V, that is P_k(along) times factor times response; this first
    seen: list[tuple[int, Vector]]
    count: float  # number of whitened pixels, those rounded alike as one
    products: Matrix  # [F y]^T [F y]
    splines: Matrix  # [j+f+1 j] sums of splines, fixed columns and values with splines
    node_sums: list[Matrix]  # of each power [j+f+1 g]: the same with nodes
    node_node: NDArray[np.float64]  # of each pair of powers [k k g g]
    reach: NDArray[np.intp]  # between which nodes [g 2] these are not 0
    precision: Vector  # [f] prior of the factors of F: those of bends
    centre: Vector  # are normal about these

    @property
    def moves(self) -> slice:
        """The columns of `fixed` that turn and bend the edge."""
        return slice(1, self.geometry.size)

    @property
    def response(self) -> int:
        """Which level is the factor of the response."""
        return int(self.fixed.shape[1])


def gather(samples: EdgeSamples, nodes: Nodes, geometry: Vector, slope: Vector) -> Gathered:
    """Return the sums about one geometry; pixels change by the LSF [g] as the edge turns."""
    places_px = samples.across_px, samples.along_px
    normal_px = distance_px(*places_px, geometry, samples.half_length_px)
    pixels = nodes.between(normal_px)
    place = samples.along_px / samples.half_length_px
    highest = max(geometry.size - 1, samples.light)
    powers: Matrix = np.asarray(np.polynomial.legendre.legvander(place, highest))
    farthest_px, slope = float(nodes.place_px[-1]), pixels.of(slope)
    turn_px = samples.along_px * np.cos(geometry[0]) - samples.across_px * np.sin(geometry[0])
    columns = [np.ones_like(slope), slope * turn_px]
    columns += [-slope * powers[:, k] for k in range(2, geometry.size)]
    uneven = _uneven(normal_px / farthest_px, samples.light)
    fixed = np.column_stack([*columns, *(powers[:, k] * factor for k, factor in uneven)])
    seen = [
        (0, np.ones(nodes.place_px.size)),
        *_uneven(nodes.place_px / farthest_px, samples.light),
    ]
    powers = np.ascontiguousarray(powers[:, : 1 + max(k for k, _ in seen)])
    right = np.column_stack([fixed, samples.values])
    whitener = samples.whitener
    if whitener is None:
        whitener = sparse.eye_array(samples.values.size, format="csr")
    else:
        right = np.ascontiguousarray(whitener @ right)
    kinds, size = powers.shape[1], nodes.place_px.size
    products = np.zeros((kinds, kinds, size, size))
    with_right = np.zeros((kinds, size, right.shape[1]))
    # One kind of index: scipy's depends on how the matrix came about, and each is compiled.
    pointers, taps = (np.asarray(one, np.intp) for one in (whitener.indptr, whitener.indices))
    rows = (pointers, taps, whitener.data)
    kernels.node_products(*rows, pixels.first, pixels.shares, powers, right, products, with_right)
    seen_with = (products[0, 0] != 0.0) | np.eye(size, dtype=np.bool_)
    reach = np.column_stack([seen_with.argmax(1), size - seen_with[:, ::-1].argmax(1)])
    node_sums = [
        np.vstack([(row[0] @ nodes.integrals).T, own.T])
        for row, own in zip(products, with_right, strict=True)
    ]
    precision, centre = np.zeros(fixed.shape[1]), np.zeros(fixed.shape[1])
    bends = slice(2, geometry.size)
    precision[bends] = (_BENDING_SHARE * samples.half_length_px) ** -2.0
    centre[bends] = -geometry[2:]
    return Gathered(
        geometry, nodes, pixels, fixed, powers, seen, count=samples.unlike * len(right),
        products=right.T @ right, splines=node_sums[0] @ nodes.integrals, node_sums=node_sums,
        node_node=products, reach=reach, precision=precision, centre=centre,
    )  # fmt: skip


def _uneven(across: Vector, light: int) -> list[tuple[int, Vector]]:
    """Return as what uneven light changes: k and factors at places across, times P_k(along)."""
    ones = np.ones_like(across)
    plane, bowl = [(0, across), (1, ones)], [(0, across**2 - 1.0 / 3.0), (2, 2.0 / 3.0 * ones)]
    return [[], plane, [*plane, *bowl, (1, across)]][light]
