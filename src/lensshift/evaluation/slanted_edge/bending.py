"""How an edge bends: polynomial terms that a free line spread function cannot explain away."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from lensshift.core.arrays import Mask
from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector
from lensshift.evaluation.slanted_edge.gathering import Nodes, distance_px

_STEPS = 6
_SETTLED_PX = 1e-3
_WORTH = 12.0  # fall of the information criterion that makes terms worth having
_LEAST_BEND_PX = 0.03  # rms; what is less does no harm
_RIDGE = 1e-3  # keeps the free ESF from explaining noise
_SLIGHT_RIDGE = 1e-6  # where a free ESF must leave no trace of the true one
_MOST_PIXELS = 4_000


def bend_edge(
    across_px: Vector, along_px: Vector, values: Vector, line: Vector, basis: SplineBasis,
    half_length_px: float, most: int,
) -> Vector:  # fmt: skip
    """Return the geometry of the edge with as many bending terms as the pixels ask for.

    The ESF is free (a spline), so that its shape is not mistaken for a bend. Terms are added, two
    at a try, while the Bayesian information criterion falls, from the angle and position `line`.
    `basis` is wide enough for the bend; the edge runs along the second axis.
    """
    straight_px = distance_px(across_px, along_px, line, half_length_px)
    near = np.flatnonzero(np.abs(straight_px) < basis.reach_px)
    near = near[:: max(1, -(-near.size // _MOST_PIXELS))]
    if near.size < 2 * basis.size:
        return line
    pixels = _Near(across_px[near], along_px[near], values[near], basis, half_length_px)
    geometry, best = pixels.descended(line)
    terms = 0
    while terms < most and (terms or pixels.promise_bends(geometry, most)):
        more = range(1, min(2, most - terms) + 1)
        starts = (np.append(geometry, np.zeros(n)) for n in more)
        found, criterion = min(map(pixels.descended, starts), key=lambda one: one[1])
        if criterion > best - _WORTH:
            break
        geometry, best, terms = found, criterion, found.size - 2
    return geometry if rms_bend_px(geometry) > _LEAST_BEND_PX else line


def rms_bend_px(geometry: Vector) -> float:
    """Return the root mean square distance of an edge from its straight line."""
    orders = np.arange(2, geometry.size)
    return float(np.sqrt(np.sum(geometry[2:] ** 2 / (2 * orders + 1))))


class _Near(NamedTuple):
    """The pixels near an edge, and what a free ESF is made of."""

    x: Vector
    y: Vector
    z: Vector
    basis: SplineBasis
    half_length_px: float

    def promise_bends(self, line: Vector, most: int) -> bool:
        """Tell whether bends explain, to first order, more than their number costs."""
        z, (splines, _, slope) = self.z, self._free(line)
        bent = np.append(line[:2], np.zeros(most))
        columns = np.column_stack([splines, self._moves(bent, slope)])
        products, right, straight = columns.T @ columns, columns.T @ z, splines.shape[1] + 1
        rests = []
        for used in range(straight, straight + most + 1):
            factors = _ridge_solved(products[:used, :used], right[:used], _RIDGE)
            rests.append(max(float(np.sum((z - columns[:, :used] @ factors) ** 2)), 1e-300))
        gains = z.size * np.log(rests[0] / np.array(rests)) - np.arange(most + 1) * np.log(z.size)
        return bool(np.max(gains) > _WORTH)

    def descended(self, start: Vector) -> tuple[Vector, float]:
        """Return geometry and information criterion after Gauss-Newton steps, the ESF free."""
        geometry, rest = start.copy(), np.inf
        for _ in range(_STEPS):
            splines, rest, slope = self._free(geometry)
            both = np.column_stack([splines, self._moves(geometry, slope)])
            step = _ridge_fit(both, self.z)[0][splines.shape[1] :]
            geometry += np.insert(step, 1, 0.0)
            in_px = np.append(self.half_length_px, np.ones(step.size - 1))
            if np.max(np.abs(step * in_px)) < _SETTLED_PX:
                break
        count = self.z.size
        rest = max(rest / count, np.finfo(float).tiny)
        return geometry, count * float(np.log(rest)) + (geometry.size - 2) * np.log(count)

    def _free(self, geometry: Vector) -> tuple[Matrix, float, Vector]:
        """Return columns of a free ESF, what it leaves of the pixels, and its slope."""
        normal_px = distance_px(self.x, self.y, geometry, self.half_length_px)
        splines = np.column_stack([np.ones_like(self.z), self.basis.integrals(normal_px)])
        factors, rest = _ridge_fit(splines, self.z)
        return splines, rest, self.basis.values(normal_px) @ factors[1:]

    def _moves(self, geometry: Vector, slope: Vector) -> Matrix:
        """Return [n k]: how pixels change with angle and bends; the place is the ESF's."""
        turn = self.y * np.cos(geometry[0]) - self.x * np.sin(geometry[0])
        highest = max(geometry.size - 1, 1)
        bends = legendre.legvander(self.y / self.half_length_px, highest)[:, 2:]
        moves = np.column_stack([turn, -bends[:, : geometry.size - 2]])
        return np.asarray(moves * slope[:, None])


class FreeResponse:
    """ESF and LSF at every pixel when nothing but those used (a mask [n]) says what they are."""

    def __init__(
        self, normal_px: Vector, basis: SplineBasis, nodes: Nodes, used: Mask | None = None
    ) -> None:
        self._used = slice(None) if used is None else used
        rows, self._sums = basis.rising(normal_px[self._used])
        self._over_pixels = rows.T
        self._products = self._sums.T @ ((rows.T @ rows) @ self._sums)
        self._nodes, self._pixels = nodes, nodes.between(normal_px)

    def of(self, values: Vector) -> tuple[Vector, Vector]:
        """Return ESF and LSF [n] of pixels [n]."""
        right = self._sums.T @ (self._over_pixels @ values[self._used])
        level, *splines = _ridge_solved(self._products, right, _SLIGHT_RIDGE)
        esf = self._pixels.of(self._nodes.integrals @ splines + level)
        return esf, self._pixels.of(self._nodes.values @ splines)


def _ridge_fit(columns: Matrix, values: Vector) -> tuple[Vector, float]:
    factors = _ridge_solved(columns.T @ columns, columns.T @ values, _RIDGE)
    rest = values - columns @ factors
    return factors, float(rest @ rest)


def _ridge_solved(products: Matrix, right: Vector, ridge: float) -> Vector:
    scale = np.sqrt(np.maximum(products.diagonal(), np.finfo(float).tiny))
    scaled = products / np.outer(scale, scale) + ridge * np.eye(scale.size)
    return np.asarray(np.linalg.solve(scaled, right / scale) / scale)
