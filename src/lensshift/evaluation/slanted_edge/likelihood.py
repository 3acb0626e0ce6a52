"""How well an edge, a line spread function and a noise level explain the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lensshift.evaluation.slanted_edge.edge_model import (
    Matrix,
    SplineBasis,
    Tail,
    Vector,
    edge_response,
    edge_response_transform,
)
from lensshift.evaluation.slanted_edge.lsf_prior import (
    BASE_HYPERS,
    HYPER_BOUNDS,
    HYPER_PRIOR,
    HYPERS,
    SplinePrior,
)
from lensshift.evaluation.slanted_edge.samples import EdgeSamples, level_columns

# No edge follows the model to all digits; below this share of the contrast, noise is not told
# from it.
MODEL_ERROR = 1e-4
_NOISE_SPREAD = 3.0  # of the log noise around 1 % of the contrast
_LOG_NOISE_BOUNDS = (np.log(0.3 * MODEL_ERROR), 1.0)
_LARGEST_ANGLE_RAD = 0.9
# Behind a bound the posterior falls as a normal distribution: a cliff would stop the descent
# before its foot and leave no curvature to draw from.
_WALL = 0.05
IMPOSSIBLE = 1e10
_DIFFERENCE = 1e-6  # of the base model's parameters, for its slopes


@dataclass(frozen=True, slots=True)
class Conditional:
    """Levels and spline coefficients, given everything else: a normal distribution."""

    levels: Vector
    coefficients: Vector
    levels_factor: Matrix
    weights: Vector
    prior_factor: Matrix
    factor: Matrix
    coupling: Matrix

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Matrix, Matrix]:
        """Draw levels [p count] and coefficients [j count]."""
        noise = rng.standard_normal((self.levels.size, count))
        deviation = _solve(self.levels_factor, noise, transposed=True)
        pull = rng.standard_normal((self.weights.size, count)) - self.coupling @ deviation
        weights = self.weights[:, None] + _solve(self.factor, pull, transposed=True)
        return self.levels[:, None] + deviation, self.prior_factor @ weights


@dataclass(frozen=True, slots=True)
class _Moments:
    """The design and its cross products: X are the levels, Z the splines, y the pixels."""

    normal_px: Vector
    response: Vector
    columns: Matrix
    xx: Matrix
    xy: Vector
    zz: Matrix
    zx: Matrix
    zy: Vector


@dataclass(frozen=True, slots=True)
class _Solution:
    """Everything about one point; `residual_square` is the misfit in units of the variance."""

    value: float
    allowed: Vector
    variance: float
    residual_square: float
    moments: _Moments
    conditional: Conditional


class EdgeLikelihood:
    """Restricted likelihood of the edge geometry, the prior of the LSF and the noise.

        y = X(q) b + Z(q) c + noise,   c ~ N(0, K(q)),   noise ~ N(0, s^2)

    with flat priors for the levels b, which are integrated out with the coefficients c. The
    parameters q are the geometry, the hyper-parameters of `lsf_prior` and the log noise.

    Parameters
    ----------
    samples : pixels of the region
    basis : splines of the LSF
    aperture_px : side of the largest pixel that the base model allows
    unit_px : width by which the prior is scaled, 1 for an edge a pixel wide
    """

    def __init__(
        self, samples: EdgeSamples, basis: SplineBasis, aperture_px: float, unit_px: float
    ) -> None:
        self.samples, self.basis, self.aperture_px = samples, basis, aperture_px
        self.unit_px = unit_px
        self.geometry_size = samples.geometry_size
        self._prior = SplinePrior(basis, unit_px)
        self._squares = float(samples.values @ samples.values)
        self._cache: dict[bytes, _Moments] = {}
        free = [np.inf] * (self.geometry_size - 1)
        top = [_LARGEST_ANGLE_RAD, *free, *HYPER_BOUNDS[:, 1], _LOG_NOISE_BOUNDS[1]]
        bottom = [
            -_LARGEST_ANGLE_RAD,
            *np.negative(free),
            *HYPER_BOUNDS[:, 0],
            _LOG_NOISE_BOUNDS[0],
        ]
        self._bounds = np.array(bottom), np.array(top)
        bends = np.full(samples.bends, samples.bend_spread_px)
        spread = np.array([np.inf, np.inf, *bends, *HYPER_PRIOR[:, 1], _NOISE_SPREAD])
        self._mean = np.array([*np.zeros(self.geometry_size), *HYPER_PRIOR[:, 0], np.log(0.01)])
        self._precision = spread**-2.0
        # The shrinkage is a square: the sign of its root says nothing.
        self.twin = np.ones(self.size)
        self.twin[self.geometry_size + 1] = -1.0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.geometry_size + HYPERS + 1

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
        return np.asarray(np.clip(parameters, *self._bounds))

    def base_response(self, normal_px: Vector, parameters: Vector) -> Vector:
        """Return the base model of the ESF, without the splines."""
        return edge_response(normal_px, float(parameters[0]), *self._base(parameters))

    def base_transform(self, frequency_cpp: Vector, parameters: Vector) -> Vector:
        """Return the Fourier transform of the LSF of the base model."""
        base = self._base(parameters)
        return edge_response_transform(frequency_cpp, float(parameters[0]), *base)

    def _base(self, parameters: Vector) -> tuple[float, float, Tail]:
        """Return sigma, the side of the pixel and the tail."""
        base = parameters[self.geometry_size : self.geometry_size + BASE_HYPERS]
        log_sigma, root, root_share, log_tail, logit = (float(one) for one in base)
        side_px = np.exp(-(root**2)) * self.aperture_px
        slow = float(1.0 / (1.0 + np.exp(-logit)))
        tail = Tail(root_share * abs(root_share), float(np.exp(log_tail)) * self.unit_px, slow)
        return float(np.exp(log_sigma)) * self.unit_px, float(side_px), tail

    def _moments(self, parameters: Vector) -> _Moments:
        key = parameters[: self.geometry_size + BASE_HYPERS].tobytes()
        found = self._cache.get(key)
        if found is None:
            if len(self._cache) > 2 * self.size:
                self._cache.clear()
            found = self._cache[key] = self._new_moments(parameters)
        return found

    def _new_moments(self, parameters: Vector) -> _Moments:
        samples, y = self.samples, self.samples.values
        normal_px = samples.normal_px(parameters[: self.geometry_size])
        response = self.base_response(normal_px, parameters)
        columns = samples.whitened(level_columns(response, samples.tilt_columns))
        near = self.basis.products(normal_px, columns, y, samples.whitener)
        return _Moments(
            normal_px=normal_px,
            response=response,
            columns=columns,
            xx=columns.T @ columns,
            xy=columns.T @ y,
            zz=near.zz,
            zx=near.zx,
            zy=near.zy,
        )

    def _solved(self, parameters: Vector) -> _Solution | None:
        g = self.geometry_size
        allowed = self.bounded(parameters)
        hyper = allowed[g : g + HYPERS]
        variance = float(np.exp(2.0 * allowed[-1])) + MODEL_ERROR**2
        m = self._moments(allowed)
        prior = _factor(self._prior.covariance(hyper[BASE_HYPERS:]))
        if prior is None:
            return None
        inner = prior.T @ m.zz @ prior / variance
        inner.flat[:: inner.shape[0] + 1] += 1.0
        factor = _factor(inner)
        if factor is None:
            return None
        projected = _solve(factor, prior.T @ np.column_stack([m.zx, m.zy]) / variance)
        coupling, along = projected[:, :-1], projected[:, -1]
        levels_factor = _factor(m.xx / variance - coupling.T @ coupling)
        if levels_factor is None:
            return None
        v = _solve(levels_factor, m.xy / variance - coupling.T @ along)
        levels = _solve(levels_factor, v, transposed=True)
        weights = _solve(factor, along - coupling @ levels, transposed=True)
        misfit = float(self._squares / variance - along @ along - v @ v)
        determinant = np.log(factor.diagonal()).sum() + np.log(levels_factor.diagonal()).sum()
        value = 0.5 * misfit + 0.5 * self.samples.count * np.log(variance) + float(determinant)
        z, beyond = allowed - self._mean, parameters - allowed
        value += 0.5 * float(z @ (self._precision * z) + beyond @ beyond / _WALL**2)
        return _Solution(
            value=value,
            allowed=allowed,
            variance=variance,
            residual_square=misfit - float(weights @ weights),
            moments=m,
            conditional=Conditional(
                levels, prior @ weights, levels_factor, weights, prior, factor, coupling
            ),
        )

    def _gradient(self, parameters: Vector, found: _Solution) -> Vector:
        """Return the gradient, by way of the design D = [Z X].

        With g the most likely (c, b), C their covariance and r the residual, the value changes by

            sum over pixels (D C - r g) dD / s^2

        with the design, and with the prior by tr(dK K^-1 (K - C - c c^T) K^-1) / 2.
        """
        g, knots = self.geometry_size, self.basis.knot_px.size
        one, variance = found.conditional, found.variance
        prior, tops = one.prior_factor, _solve(one.levels_factor, np.eye(one.levels.size))
        spread = _solve(one.factor, np.eye(knots))
        mixed = -_solve(one.factor, one.coupling @ tops.T, transposed=True)
        weight_covariance = spread.T @ spread + mixed @ mixed.T
        design = np.empty((knots + one.levels.size,) * 2)
        design[:knots, :knots] = prior @ weight_covariance @ prior.T
        design[:knots, knots:] = prior @ mixed @ tops
        design[knots:, :knots] = design[:knots, knots:].T
        design[knots:, knots:] = tops.T @ tops
        linear = np.concatenate([one.coefficients, one.levels])
        gradient = (found.allowed - self._mean) * self._precision
        gradient[: g + BASE_HYPERS] += (
            self._base_gradient(found, design + np.outer(linear, linear), linear) / variance
        )
        unexplained = np.eye(knots) - weight_covariance - np.outer(one.weights, one.weights)
        half = _solve(prior, unexplained, transposed=True)
        sensitivity = 0.5 * _solve(prior, half.T, transposed=True)
        shape = slice(g + BASE_HYPERS, g + HYPERS)
        gradient[shape] += self._prior.gradient(found.allowed[shape], sensitivity)
        explained = linear.size - np.trace(weight_covariance)
        excess = self.samples.count - explained - found.residual_square
        gradient[-1] += excess * (1.0 - MODEL_ERROR**2 / variance)
        gradient[parameters != found.allowed] = 0.0
        return np.asarray(gradient + (parameters - found.allowed) / _WALL**2)

    def _base_gradient(self, found: _Solution, quadratic: Matrix, linear: Vector) -> Vector:
        """Return the slopes by geometry and base model, from those by distance and response."""
        samples, m = self.samples, found.moments
        to_normal, to_columns = self.basis.sensitivities(
            m.normal_px, m.columns, samples.values, quadratic, linear, samples.whitener
        )
        to_response = to_columns[:, 1].copy()
        if samples.tilt_columns is not None:
            tilts = samples.tilt_columns.shape[1]
            to_response += np.sum(to_columns[:, 2 + tilts :] * samples.tilt_columns, axis=1)
        slopes = np.empty(self.geometry_size + BASE_HYPERS)
        for k in range(slopes.size):
            moved = found.allowed.copy()
            moved[k] += _DIFFERENCE
            normal_px = m.normal_px
            if k < self.geometry_size:
                normal_px = samples.normal_px(moved[: self.geometry_size])
            response = self.base_response(normal_px, moved)
            slopes[k] = (
                to_normal @ (normal_px - m.normal_px) + to_response @ (response - m.response)
            ) / _DIFFERENCE
        return slopes


def _factor(matrix: Matrix) -> Matrix | None:
    """Return the lower Cholesky factor, None if the matrix is not positive definite."""
    lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
    return None if info else lower


def _solve(factor: Matrix, right: NDArray[np.float64], transposed: bool = False) -> Matrix:
    """Solve L u = right, or L^T u = right."""
    solution, _ = lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))
    return np.asarray(solution if right.ndim > 1 else solution.reshape(-1))
