"""How well an edge, a line spread function and a noise level explain the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lensshift.evaluation.slanted_edge.base_model import BaseModel
from lensshift.evaluation.slanted_edge.edge_model import (
    Matrix,
    SplineBasis,
    Vector,
)
from lensshift.evaluation.slanted_edge.gathering import Gathered
from lensshift.evaluation.slanted_edge.lsf_prior import (
    BASE_HYPERS,
    HYPER_BOUNDS,
    HYPER_PRIOR,
    HYPERS,
    Factor,
    SplinePrior,
)

# No edge follows the model to all digits; below this share of the contrast, noise is not told
# from it.
MODEL_ERROR = 1e-4
_NOISE_SPREAD = 3.0  # of the log noise around 1 % of the contrast
_LOG_NOISE_BOUNDS = (np.log(0.3 * MODEL_ERROR), 1.0)
# Behind a bound the posterior falls as a normal distribution: a cliff would stop the descent
# before its foot and leave no curvature to draw from.
_WALL = 0.05
IMPOSSIBLE = 1e10
# Of the log posterior: what the directions of the splines that are left out may change.
_LEFT_OUT = 1e-3


@dataclass(frozen=True, slots=True)
class Conditional:
    """Levels and spline coefficients, given everything else: a normal distribution.

    The levels are factors of the columns of `Gathered`, first the fixed ones.
    """

    levels: Vector
    coefficients: Vector
    levels_factor: Matrix
    weights: Vector
    prior_factor: Factor
    factor: Matrix
    coupling: Matrix

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Matrix, Matrix]:
        """Draw levels [p count] and coefficients [j count]."""
        noise = rng.standard_normal((self.levels.size, count))
        deviation = _solve(self.levels_factor, noise, transposed=True)
        pull = rng.standard_normal((self.weights.size, count)) - self.coupling @ deviation
        weights = self.weights[:, None] + _solve(self.factor, pull, transposed=True)
        return self.levels[:, None] + deviation, self.prior_factor.times(weights)


@dataclass(frozen=True, slots=True)
class _Moments:
    """The design and its cross products: X are the levels, Z the splines, y the pixels.

    `z` is Z^T [Z X y], `seen` are the columns that follow the response, at the nodes, and
    `across[k][m]` what the pixels of column k see of column m.
    """

    seen: list[Vector]
    across: list[list[Vector]]
    xx: Matrix
    xy: Vector
    z: Matrix


@dataclass(frozen=True, slots=True)
class _Solution:
    """Everything about one point; `residual_square` is the misfit in units of the variance."""

    value: float
    allowed: Vector
    variance: float
    residual_square: float
    moments: _Moments
    over_splines: Matrix
    conditional: Conditional


class EdgeLikelihood:
    """Restricted likelihood of the response of an edge, the prior of the LSF and the noise.

        y = X(q) b + Z c + noise,   c ~ N(0, K(q)),   noise ~ N(0, s^2)

    with flat priors for the levels b, which are integrated out with the coefficients c. Among
    the levels are turn and bends of the edge, to first order. The parameters q are the
    hyper-parameters of `lsf_prior` and the log noise.

    Parameters
    ----------
    gathered : the pixels
    basis : splines of the LSF
    aperture_px : side of the largest pixel that the base model allows
    unit_px : width by which the prior is scaled, 1 for an edge a pixel wide
    """

    def __init__(
        self, gathered: Gathered, basis: SplineBasis, aperture_px: float, unit_px: float
    ) -> None:
        self.gathered, self.basis = gathered, basis
        self.unit_px = unit_px
        self.base = BaseModel(float(gathered.geometry[0]), aperture_px, unit_px)
        self._prior = SplinePrior(basis, unit_px)
        self._bounds = (
            np.append(HYPER_BOUNDS[:, 0], _LOG_NOISE_BOUNDS[0]),
            np.append(HYPER_BOUNDS[:, 1], _LOG_NOISE_BOUNDS[1]),
        )
        self._mean = np.append(HYPER_PRIOR[:, 0], np.log(0.01))
        self._precision = np.append(HYPER_PRIOR[:, 1], _NOISE_SPREAD) ** -2.0
        self._information = self._told()
        knots, fixed = basis.size, gathered.response
        size = fixed + len(gathered.seen)
        self._levels_precision, self._levels_centre = np.zeros(size), np.zeros(size)
        self._levels_precision[:fixed] = gathered.precision
        self._levels_centre[:fixed] = gathered.centre
        # What no parameter changes of the cross products: Z^T [Z X y], X^T X, X^T y.
        self._z = np.zeros((knots, knots + size + 1), order="F")
        self._z[:, : knots + fixed] = gathered.splines[:-1].T
        self._z[:, -1] = gathered.splines[-1]
        self._xx, self._xy = np.zeros((size, size)), np.zeros(size)
        self._xx[:fixed, :fixed], self._xy[:fixed] = gathered.fixed_fixed, gathered.fixed_values
        # The shrinkage is a square: the sign of its root says nothing.
        self.twin = np.ones(self.size)
        self.twin[1] = -1.0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return HYPERS + 1

    def negative_log(self, parameters: Vector) -> float:
        """Return minus the log posterior of the parameters, up to a constant."""
        found = self._solved(parameters)
        return IMPOSSIBLE if found is None else found.value

    def conditional(self, parameters: Vector) -> tuple[float, Conditional | None]:
        """Return the same, and the distribution of levels and coefficients."""
        found = self._solved(parameters)
        return (IMPOSSIBLE, None) if found is None else (found.value, found.conditional)

    def with_gradient(self, parameters: Vector) -> tuple[float, Vector]:
        """Return `negative_log` and its gradient [p]."""
        found = self._solved(parameters)
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
        for one, level in zip(g.seen, levels[g.response :], strict=True):
            model += g.powers[:, one.power] * g.pixels.of(level * one.factor * response)
        return np.asarray(model)

    def _told(self) -> Vector:
        """Return [j] what the pixels tell of each coefficient, in units of the inverse variance."""
        g = self.gathered
        knots, fixed = self.basis.size, g.fixed.shape[1]
        shared = g.splines[knots : knots + fixed]
        known = np.linalg.lstsq(g.fixed_fixed, shared)[0]
        told = g.splines[:knots].diagonal() - np.sum(shared * known, axis=0)
        return np.asarray(np.maximum(told, 0.0))

    def _moments(self, parameters: Vector) -> _Moments:
        g, knots, fixed = self.gathered, self.basis.size, self.gathered.response
        response = self.base.response(g.nodes.place_px, parameters)
        seen = [one.factor * response for one in g.seen]
        across = [
            [
                g.node_node[one.power][other.power] @ own
                for other, own in zip(g.seen, seen, strict=True)
            ]
            for one in g.seen
        ]
        xx, xy = self._xx.copy(), self._xy.copy()
        z = self._z.copy(order="F")
        for k, one in enumerate(g.seen):
            sums = g.node_sums[one.power] @ seen[k]
            z[:, knots + fixed + k], xy[fixed + k] = sums[:knots], sums[-1]
            xx[fixed + k, :fixed] = xx[:fixed, fixed + k] = sums[knots:-1]
            for m, other in enumerate(across[k]):
                xx[fixed + k, fixed + m] = seen[k] @ other
        return _Moments(seen, across, xx, xy, z)

    def _solved(self, parameters: Vector) -> _Solution | None:
        g, knots = self.gathered, self.basis.size
        allowed = self.bounded(parameters)
        variance = float(np.exp(2.0 * allowed[-1])) + MODEL_ERROR**2
        m = self._moments(allowed)
        prior = self._prior.factor(
            allowed[BASE_HYPERS:HYPERS], self._information, _LEFT_OUT * variance
        )
        over = prior.over(m.z)
        inner = prior.over(over[:, :knots].T) / variance
        inner.flat[:: len(inner) + 1] += 1.0
        factor = _factor(inner)
        if factor is None:
            return None
        projected = _solve(factor, over[:, knots:] / variance)
        coupling, along = projected[:, :-1], projected[:, -1]
        precision, centre = self._levels_precision, self._levels_centre
        inverse = m.xx / variance - coupling.T @ coupling
        inverse.flat[:: len(inverse) + 1] += precision
        levels_factor = _factor(inverse)
        if levels_factor is None:
            return None
        pull = m.xy / variance + precision * centre - coupling.T @ along
        v = _solve(levels_factor, pull)
        levels = _solve(levels_factor, v, transposed=True)
        weights = _solve(factor, along - coupling @ levels, transposed=True)
        misfit = g.squares / variance + float(precision @ centre**2 - along @ along - v @ v)
        determinant = np.sum(np.log(factor.diagonal())) + np.sum(np.log(levels_factor.diagonal()))
        value = 0.5 * misfit + 0.5 * g.count * np.log(variance) + float(determinant)
        z, beyond = allowed - self._mean, parameters - allowed
        value += 0.5 * float(z @ (self._precision * z) + beyond @ beyond / _WALL**2)
        strain = float(weights @ weights + precision @ (levels - centre) ** 2)
        return _Solution(
            value=value,
            allowed=allowed,
            variance=variance,
            residual_square=misfit - strain,
            moments=m,
            over_splines=over[:, :knots],
            conditional=Conditional(
                *(levels, prior.times(weights), levels_factor, weights, prior, factor, coupling)
            ),
        )

    def _gradient(self, parameters: Vector, found: _Solution) -> Vector:
        """Return the gradient.

        With g the most likely (c, b), C their covariance and r the residual, the value changes by

            sum over pixels (D C - r g^T) dD / s^2,   D = [Z X]

        with the design, and with the prior by tr(dK (Z^T P Z - q q^T)) / 2, q = Z^T P y.
        """
        g, knots, variance = self.gathered, self.basis.size, found.variance
        one, m = found.conditional, found.moments
        tops = _solve(one.levels_factor, np.eye(one.levels.size))
        covariance = tops.T @ tops
        gradient = (found.allowed - self._mean) * self._precision
        gradient[:BASE_HYPERS] += self._by_base(found, covariance) / variance
        through = _solve(one.factor, found.over_splines) / variance
        zx = m.z[:, knots:-1]
        levels = zx / variance - through.T @ one.coupling
        known = through.T @ through + levels @ covariance @ levels.T
        zz = g.splines[:knots]
        left = (g.splines[-1] - zz @ one.coefficients - zx @ one.levels) / variance
        evens = len(one.prior_factor.even)
        halves = [
            0.5 * (zz[own, own] / variance - known[own, own] - np.outer(left[own], left[own]))
            for own in (slice(evens), slice(evens, knots))
        ]
        gradient[BASE_HYPERS:HYPERS] += self._prior.gradient(
            found.allowed[BASE_HYPERS:HYPERS], *halves
        )
        # Of as many numbers as are explained, the variance is not seen.
        spread = _solve(one.factor, np.eye(one.weights.size))
        mixed = _solve(one.factor, one.coupling @ tops.T, transposed=True)
        told = one.weights.size + one.levels.size - float(np.sum(spread**2) + np.sum(mixed**2))
        told -= float(g.precision @ covariance.diagonal()[: g.precision.size])
        excess = g.count - told - found.residual_square
        gradient[-1] += excess * (1.0 - MODEL_ERROR**2 / variance)
        gradient[parameters != found.allowed] = 0.0
        return np.asarray(gradient + (parameters - found.allowed) / _WALL**2)

    def _by_base(self, found: _Solution, covariance: Matrix) -> Vector:
        """Return the slopes by the parameters of the base model, times the variance."""
        g, one, m = self.gathered, found.conditional, found.moments
        fixed = g.response
        shared = -one.prior_factor.times(
            _solve(one.factor, one.coupling @ covariance, transposed=True)
        )
        to_response = np.zeros(g.nodes.place_px.size)
        for k, column in enumerate(g.seen):
            own = fixed + k
            splines = shared[:, own] + one.coefficients * one.levels[own]
            levels = covariance[:, own] + one.levels * one.levels[own]
            factors = np.concatenate([splines, levels[:fixed], [-one.levels[own]]])
            to_node = factors @ g.node_sums[column.power]
            for level, across in zip(levels[fixed:], m.across[k], strict=True):
                to_node += level * across
            to_response += column.factor * to_node
        return np.asarray(self.base.slopes(g.nodes.place_px, found.allowed) @ to_response)


def _factor(matrix: Matrix) -> Matrix | None:
    """Return the lower Cholesky factor, None if the matrix is not positive definite."""
    lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
    return None if info else lower


def _solve(factor: Matrix, right: NDArray[np.float64], transposed: bool = False) -> Matrix:
    """Solve L u = right, or L^T u = right."""
    if not len(factor):
        return right
    solution, _ = lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))
    return np.asarray(solution if right.ndim > 1 else solution.reshape(-1))
