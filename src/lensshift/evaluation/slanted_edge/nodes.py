"""Nodes along the edge's normal: what is smooth between them is known from them.

A pixel sees a function of its distance from the edge through four nodes (cubic interpolation). So
all pixels enter the fit as sums over pairs of nodes, once for a place of the edge, and their
number matters no longer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector
from lensshift.evaluation.slanted_edge.node_kernels import between_nodes, interpolated

# Up to the first number of units from the edge, steps of the second: a pixel as narrow as the prior
# allows, then a quarter of the distance of the splines, then half of it.
_ZONES = ((2.0, 1 / 32), (6.0, 1 / 16), (16.0, 1 / 4))
_FAR_STEP, _FARTHEST_STEP = 1 / 2, 1.0  # up to the end of the splines, and beyond
_MARGIN = 2
_KNOT_STEP = 1 / 4


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """Where pixels lie between nodes.

    Parameters
    ----------
    first : [n] the first of the four nodes around each
    shares : [n 4] of these
    """

    first: NDArray[np.intp]
    shares: NDArray[np.float64]

    def of(self, values: Vector) -> Vector:
        """Return at the pixels what is `values` [g] at the nodes."""
        out = np.empty(self.first.size)
        interpolated(self.first, self.shares, values, out)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Places along the normal, and the splines there.

    Parameters
    ----------
    place_px : [g] rising, symmetric about the edge
    integrals, values : [g j] of the splines
    """

    place_px: Vector
    integrals: Matrix
    values: Matrix

    def between(self, normal_px: Vector) -> Between:
        """Return where distances [n] lie."""
        first = np.searchsorted(self.place_px, normal_px)
        shares = np.empty((normal_px.size, 4))
        between_nodes(normal_px, self.place_px, first, shares)
        return Between(first, shares)


def splines_for(units: float, unit_px: float) -> SplineBasis:
    """Return splines that reach some units, a quarter of a unit apart near the edge."""
    return SplineBasis.covering(units * unit_px, _KNOT_STEP * unit_px, unit_px)


def nodes_for(basis: SplineBasis, unit_px: float, aperture_px: float, farthest_px: float) -> Nodes:
    """Return nodes that tell the base model and the splines.

    Parameters
    ----------
    basis : of `splines_for`
    unit_px : width of the edge, in which the steps are counted
    aperture_px : side of the largest pixel
    farthest_px : distance of the farthest pixel
    """
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
