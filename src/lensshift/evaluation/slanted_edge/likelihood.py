"""How well an edge, a line spread function and a noise level explain the pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lensshift.evaluation.slanted_edge import kernels, lsf_prior
from lensshift.evaluation.slanted_edge.edge_model import BaseModel, SeenBase, SplineBasis
from lensshift.evaluation.slanted_edge.gathering import Gathered
from lensshift.evaluation.slanted_edge.lsf_prior import BASE_HYPERS, HYPERS
from lensshift.evaluation.slanted_edge.result import Matrix, Vector

# No edge follows the model to all digits; below this share of the contrast, noise is not told
# from it.
MODEL_ERROR = 1e-4
_LOG_NOISE = (np.log(0.01), 3.0)  # mean and standard deviation; of the noise over the contrast
_LOG_NOISE_BOUNDS = (np.log(0.3 * MODEL_ERROR), 1.0)
# Behind a bound the posterior falls as a normal distribution: a cliff would stop the descent
# before its foot and leave no curvature to draw from.
_WALL = 0.05
IMPOSSIBLE = 1e10
_ROUNDING = 1e-14  # of sums over pixels


@dataclass(frozen=True, slots=True)
class Solution:
    """Everything about one point: X are the levels, H the heights, y the pixels.

    Splines are told in coordinates R h, in which the noise of the pixels is white and even:

        S = R K R^T + s^2,   W = R^-T H^T [X y]
    """

    value: float
    allowed: Vector
    base: SeenBase  # what the nodes see of the base model
    across: NDArray[np.float64]  # [k s g] what pixels times P_k see of columns that follow it
    variance: float  # s^2
    factor: Matrix  # [j + p + 1, j] L with L L^T = S, and below it (L^-1 W)^T
    shown: Matrix  # [p + 1, j] W^T
    apart: Matrix  # what of [X y]^T [X y] no spline follows
    levels: Vector
    levels_factor: Matrix

    @property
    def left(self) -> Vector:
        """What the levels leave of the pixels [j]."""
        return np.asarray(self.shown[-1] - self.levels @ self.shown[:-1])

    def over(self, right: NDArray[np.float64]) -> Matrix:
        """Return S^-1 times [j ...]."""
        lower = self.factor[: self.factor.shape[1]]
        return _solve(lower, _solve(lower, right), transposed=True)

    def followed(self, right: NDArray[np.float64], over: NDArray[np.float64]) -> Matrix:
        """Return R K R^T S^-1 times `right` [j ...]: what heights explain of it, seen by R.

        That is (1 - s^2 S^-1) times it; `over` is S^-1 times `right`.
        """
        return np.asarray(right - self.variance * over)


class EdgeLikelihood:
    """Restricted likelihood of the response of an edge, the prior of the LSF and the noise.

        y = X(q) b + Z c + noise,   c ~ N(0, K(q)),   noise ~ N(0, s^2)

    with flat priors for the levels b, which are integrated out with the coefficients c. Among
    the levels are turn and bends of the edge, to first order. The parameters q are the
    hyper-parameters of `lsf_prior` and the log noise. The base model allows pixels up to
    `aperture_px`; `unit_px`, 1 for an edge a pixel wide, scales the prior.
    """

    def __init__(
        self, gathered: Gathered, basis: SplineBasis, aperture_px: float, unit_px: float
    ) -> None:
        self.gathered, self.basis = gathered, basis
        self.unit_px = unit_px
        self.base = BaseModel(float(gathered.geometry[0]), aperture_px, unit_px)
        self._prior = lsf_prior.SplinePrior(basis, unit_px)
        self._bounds = np.vstack([lsf_prior.HYPER_BOUNDS, _LOG_NOISE_BOUNDS]).T
        self._mean, spread = np.vstack([lsf_prior.HYPER_PRIOR, _LOG_NOISE]).T
        self._precision = spread**-2.0
        knots, fixed = basis.size, gathered.response
        self.level_count = size = fixed + len(gathered.seen)
        self._levels_precision = np.pad(gathered.precision, (0, size - fixed))
        self._levels_centre = np.pad(gathered.centre, (0, size - fixed))
        powers, factors = zip(*gathered.seen, strict=True)
        self._powers, self._factors = np.array(powers), np.stack(factors)
        by_heights = self._prior.by_heights
        node_sums = gathered.node_sums
        self._node_sums = [np.vstack([by_heights(one[:knots]), one[knots:]]) for one in node_sums]
        # What the pixels tell of the heights H of the splines: H^T H = R^T R, R^T with a band.
        self._factor, self._band = _told(by_heights(by_heights(gathered.splines[:knots]).T))
        # What no parameter changes of the cross products.
        self._known = np.append(np.arange(fixed), size)  # fixed columns, and the pixels
        self._heights, self._gram = np.zeros((size + 1, knots)), np.zeros((size + 1, size + 1))
        self._heights[self._known] = by_heights(gathered.splines[knots:].T).T
        self._gram[np.ix_(self._known, self._known)] = gathered.products
        # The shrinkage is a square: the sign of its root says nothing.
        self.twin = np.ones(self.size)
        self.twin[1] = -1.0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return HYPERS + 1

    def coefficients(self, found: Solution) -> Vector:
        """Return the most likely coefficients at a point."""
        seen = found.followed(found.left, found.over(found.left))
        return self._prior.coefficients(self._heights_of(seen))

    def drawn(
        self, found: Sequence[Solution], counts: Sequence[int], rng: np.random.Generator
    ) -> tuple[Matrix, Matrix]:
        """Draw levels [p k] and coefficients [j k], so many at each of some points.

        By Matheron's rule; source: Hoffman and Ribak, Astrophys. J. 380 (1991) L5.
        """
        knots, levels, white, grain = self.basis.size, [], [], []
        for one, count in zip(found, counts, strict=True):
            noise = rng.standard_normal((one.levels.size, count))
            levels.append(one.levels[:, None] + _solve(one.levels_factor, noise, transposed=True))
            white.append(self._prior.white(count, rng))
            grain.append(np.sqrt(one.variance) * rng.standard_normal((knots, count)))
        shapes = np.repeat([one.allowed[BASE_HYPERS:HYPERS] for one in found], counts, axis=0)
        heights = self._prior.drawn(shapes, np.vstack(white))
        seen = np.split(self._factor.T @ heights + np.hstack(grain), np.cumsum(counts), 1)
        missing = []
        for one, level, part in zip(found, levels, seen[:-1], strict=True):
            rest = one.shown[-1][:, None] - one.shown[:-1].T @ level - part
            missing.append(one.followed(rest, one.over(rest)))
        heights += self._heights_of(np.hstack(missing))
        return np.hstack(levels), self._prior.coefficients(heights)

    def with_gradient(self, parameters: Vector) -> tuple[float, Vector]:
        """Return minus the log posterior of the parameters, up to a constant, and its gradient."""
        found = self.solved(parameters)
        if found is None:
            return IMPOSSIBLE, np.zeros(self.size)
        return found.value, self._gradient(parameters, found)

    def bounded(self, parameters: Vector | Matrix) -> Matrix:
        """Return the nearest parameters [... p] that are allowed."""
        return np.asarray(np.minimum(np.maximum(parameters, self._bounds[0]), self._bounds[1]))

    def model_of(self, parameters: Vector, levels: Vector, coefficients: Vector) -> Vector:
        """Return what every pixel should be [n]."""
        g = self.gathered
        response = self.base.response(g.nodes.place_px, parameters)
        model = g.fixed @ levels[: g.response]
        model += g.pixels.of(g.nodes.integrals @ coefficients)
        for (power, factor), level in zip(g.seen, levels[g.response :], strict=True):
            model += g.powers[:, power] * g.pixels.of(level * factor * response)
        return np.asarray(model)

    def _moments(self, parameters: Vector) -> tuple[SeenBase, NDArray[np.float64], Matrix, Matrix]:
        """Return `base` and `across` of a solution, [X y]^T [X y], and [X y]^T H."""
        g, knots, fixed = self.gathered, self.basis.size, self.gathered.response
        base = self.base.seen(g.nodes.place_px, parameters)
        seen = self._factors * base.response
        across = np.empty((len(g.node_node), *seen.shape))
        kernels.across_nodes(g.node_node, g.reach, self._powers, seen, across)
        gram, heights = self._gram.copy(), self._heights.copy()
        for k, power in enumerate(self._powers):
            own, sums = fixed + k, self._node_sums[power] @ seen[k]
            heights[own] = sums[:knots]
            gram[own, self._known] = gram[self._known, own] = sums[knots:]
            gram[own, fixed:-1] = across[power] @ seen[k]
        return base, across, gram, heights

    def solved(self, parameters: Vector) -> Solution | None:
        """Return what the pixels say at a point, None where nothing can."""
        knots, allowed = self.basis.size, self.bounded(parameters)
        variance = float(np.exp(2.0 * allowed[-1])) + MODEL_ERROR**2
        base, across, gram, heights = self._moments(allowed)
        covariance = self._prior.covariance(allowed[BASE_HYPERS:HYPERS])
        factor = np.empty((knots + len(heights), knots))
        kernels.within(self._band, covariance, variance, factor)
        shown = np.asarray(lapack.dtbtrs(self._band, heights.T, uplo="L")[0]).T
        # LAPACK counts along columns: it sees the transposed matrix.
        upper, failed = lapack.dpotrf(factor[:knots].T, lower=0, clean=0, overwrite_a=1)
        if failed:
            return None
        factor[knots:] = lapack.dtrtrs(upper, shown.T, trans=1)[0].T
        apart = gram - shown @ shown.T
        gram = apart / variance + factor[knots:] @ factor[knots:].T
        precision, centre = self._levels_precision, self._levels_centre
        levels_factor = _factor(gram[:-1, :-1] + np.diag(precision))
        if levels_factor is None:
            return None
        v = _solve(levels_factor, gram[:-1, -1] + precision * centre)
        levels = _solve(levels_factor, v, transposed=True)
        misfit = gram[-1, -1] + float(precision @ centre**2 - v @ v)
        determinant = np.sum(np.log(factor.diagonal())) + np.sum(np.log(levels_factor.diagonal()))
        value = 0.5 * misfit + float(determinant)
        value += 0.5 * (self.gathered.count - knots) * np.log(variance)
        z, beyond = allowed - self._mean, parameters - allowed
        value += 0.5 * float(z @ (self._precision * z) + beyond @ beyond / _WALL**2)
        seen = base, across, variance, factor, shown, apart
        return Solution(value, allowed, *seen, levels, levels_factor)

    def _heights_of(self, seen: NDArray[np.float64]) -> Matrix:
        """Return heights [j ...] as R sees them."""
        return _solve(self._factor, seen, transposed=True)

    def _gradient(self, parameters: Vector, found: Solution) -> Vector:
        """Return the gradient.

        With P the precision of the pixels after the levels, and r = y - X b, the value changes by

            tr((P - P y y^T P) dC) / 2,   C = H K H^T + s^2

        with the prior and the noise, and by sum over pixels (C^-1 X D - C^-1 r b^T) dX with the
        design, D the covariance of the levels.
        """
        g, knots, variance = self.gathered, self.basis.size, found.variance
        lower = found.factor[:knots]
        tops = _solve(found.levels_factor, np.eye(found.levels.size))
        covariance = tops.T @ tops
        gradient = (found.allowed - self._mean) * self._precision
        inverse = lapack.dpotri(lower.T, lower=0)[0].T  # its lower triangle
        unseen = float(np.trace(inverse))
        levels = _solve(lower, found.factor[knots:-1].T, transposed=True).T
        left = found.over(found.left)
        gradient[:BASE_HYPERS] += self._by_base(found, covariance, levels, left)
        kernels.downdated(inverse, np.vstack([tops @ levels, left]))
        by_covariance = np.empty((knots, knots))
        kernels.around(self._band, inverse, by_covariance)
        shape = slice(BASE_HYPERS, HYPERS)
        gradient[shape] += 0.5 * self._prior.gradient(found.allowed[shape], by_covariance)
        rest = np.append(-found.levels, 1.0)
        trace = (g.count - knots) / variance + unseen
        squares = found.apart[:-1, :-1] / variance**2 + levels @ levels.T
        trace -= float(np.sum(covariance * squares))
        misfit = float(rest @ found.apart @ rest) / variance**2 + float(left @ left)
        gradient[-1] += (variance - MODEL_ERROR**2) * (trace - misfit)
        gradient[parameters != found.allowed] = 0.0
        return np.asarray(gradient + (parameters - found.allowed) / _WALL**2)

    def _by_base(self, found: Solution, covariance: Matrix, levels: Matrix, left: Vector) -> Vector:
        """Return the slopes by the parameters of the base model."""
        g, fixed = self.gathered, self.gathered.response
        # Of the levels' covariance, and of the misfit, what the splines take up.
        mixed = np.column_stack([found.shown[:-1].T @ covariance, found.left])
        over = np.column_stack([levels.T @ covariance, left])
        shared = self._heights_of(found.followed(mixed, over))
        to_response = np.zeros(g.nodes.place_px.size)
        for own, (power, factor) in enumerate(g.seen, fixed):
            both = covariance[:, own] + found.levels * found.levels[own]
            splines = found.levels[own] * shared[:, -1] - shared[:, own]
            factors = np.concatenate([splines, both[:fixed], [-found.levels[own]]])
            to_node = factors @ self._node_sums[power]
            to_response += factor * (to_node + both[fixed:] @ found.across[power])
        slopes = self.base.slopes(found.base, found.allowed)
        return np.asarray(slopes @ to_response / found.variance)


def _told(squares: Matrix) -> tuple[Matrix, Matrix]:
    """Return the factor [j j] of H^T H and its diagonals [m j], the main one first.

    What is but rounding counts as nothing.
    """
    # All heights together raise a pixel by 1: the sum counts pixels, and differences are left.
    for ridge in _ROUNDING * float(squares.sum()) * 10.0 ** np.arange(6):
        lower = np.where(np.abs(squares) < ridge, 0.0, squares)
        lower.flat[:: len(lower) + 1] = np.maximum(squares.diagonal(), 0.0) + ridge
        factor = _factor(lower)
        if factor is not None:
            reach = int(np.max(np.subtract(*np.nonzero(factor))))
            diagonals = [np.pad(factor.diagonal(-m), (0, m)) for m in range(reach + 1)]
            return np.ascontiguousarray(factor), np.stack(diagonals)
    raise ValueError("expected pixels that tell the response of an edge, got none")


def _factor(matrix: Matrix) -> Matrix | None:
    """Return the lower Cholesky factor, None if the matrix is not positive definite."""
    lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
    return None if info else lower


def _solve(factor: Matrix, right: NDArray[np.float64], transposed: bool = False) -> Matrix:
    """Solve L u = right, or L^T u = right."""
    # LAPACK counts along columns: it sees the transposed matrix, and needs no copy of it.
    if factor.flags.c_contiguous:
        solution, _ = lapack.dtrtrs(factor.T, right, lower=0, trans=int(not transposed))
    else:
        solution, _ = lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))
    return np.asarray(solution if right.ndim > 1 else solution.reshape(-1))
