"""How well an edge, a line spread function and a noise level explain the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lensshift.evaluation.slanted_edge.edge_model import (
    Matrix,
    SplineBasis,
    SplineProducts,
    Vector,
    edge_response,
    edge_response_transform,
)
from lensshift.evaluation.slanted_edge.samples import EdgeSamples, level_columns

# What is known before a pixel is seen, as normal distributions; lengths in units of `unit_px`.
# The Gaussian of the optics may be anything from far below a pixel to well above it. The
# correction is a few per cent of the LSF, about as fine as a pixel, and mostly symmetric.
_LOG_SIGMA = (np.log(0.4), 1.0)
_LOG_AMPLITUDE = (np.log(0.05), 1.5)
_LOG_LENGTH = (np.log(0.6), 0.35)
_LOG_TAIL = (np.log(1.0), 0.6)
_LOGIT_SYMMETRY = (2.0, 2.0)
_PRIOR = np.array([_LOG_SIGMA, _LOG_AMPLITUDE, _LOG_LENGTH, _LOG_TAIL, _LOGIT_SYMMETRY])
_BOUNDS = np.array([(-2.5, 2.0), (-9.0, 0.5), (-1.4, 1.1), (-1.4, 2.0), (-8.0, 8.0)])
# No edge follows the model to all digits; below this share of the contrast, noise is not told
# from it.
MODEL_ERROR = 1e-4
_NOISE_SPREAD = 3.0  # of the log noise around 1 % of the contrast
_LOG_NOISE_BOUNDS = (np.log(0.3 * MODEL_ERROR), 1.0)
_LARGEST_ANGLE_RAD = 0.9
# Behind a bound the posterior falls as a normal distribution: a cliff would stop the descent
# before its foot and leave no curvature to draw from.
_WALL = 0.05
HYPERS = 5  # log sigma, log amplitude, log length, log tail, logit symmetry; the noise follows
IMPOSSIBLE = 1e10
_JITTER = 1e-10
_RELATIVE_JITTER = 1e-8


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
    """Cross products of the design; X are the levels, Z the splines, y the pixels."""

    xx: Matrix
    xy: Vector
    zz: Matrix
    zx: Matrix
    zy: Vector


class EdgeLikelihood:
    """Restricted likelihood of the edge geometry, the prior of the LSF and the noise.

        y = X(q) b + Z(q) c + noise,   c ~ N(0, K(q)),   noise ~ N(0, s^2)

    with flat priors for the levels b, which are integrated out with the coefficients c.

    Parameters
    ----------
    samples : pixels of the region
    basis : splines of the LSF
    aperture_px : side of the pixel that the base model assumes
    unit_px : width by which the prior is scaled, 1 for an edge a pixel wide
    """

    def __init__(
        self, samples: EdgeSamples, basis: SplineBasis, aperture_px: float, unit_px: float
    ) -> None:
        self.samples, self.basis, self.aperture_px = samples, basis, aperture_px
        self.unit_px = unit_px
        self.geometry_size = samples.geometry_size
        knots = np.arange(basis.knot_px.size)
        self._apart = np.abs(np.subtract.outer(knots, knots))
        self._cache: dict[bytes, _Moments] = {}
        free = [np.inf] * (self.geometry_size - 1)
        top = [_LARGEST_ANGLE_RAD, *free, *_BOUNDS[:, 1], _LOG_NOISE_BOUNDS[1]]
        bottom = [-_LARGEST_ANGLE_RAD, *np.negative(free), *_BOUNDS[:, 0], _LOG_NOISE_BOUNDS[0]]
        self._bounds = np.array(bottom), np.array(top)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.geometry_size + HYPERS + 1

    def negative_log(self, parameters: Vector) -> float:
        """Return minus the log posterior of the parameters, up to a constant."""
        found = self._evaluate(parameters)
        return IMPOSSIBLE if found is None else found[0]

    def conditional(self, parameters: Vector) -> tuple[float, Conditional | None]:
        """Return the same, and the distribution of levels and coefficients."""
        found = self._evaluate(parameters, whole=True)
        return (IMPOSSIBLE, None) if found is None else found

    def bounded(self, parameters: Vector | Matrix) -> Matrix:
        """Return the nearest parameters [... p] that are allowed."""
        return np.asarray(np.clip(parameters, *self._bounds))

    def sigma_px(self, parameters: Vector) -> float:
        """Return the width of the Gaussian of the base model."""
        return float(np.exp(parameters[self.geometry_size])) * self.unit_px

    def base_response(self, normal_px: Vector, parameters: Vector) -> Vector:
        """Return the base model of the ESF, without the splines."""
        angle_rad, sigma_px = float(parameters[0]), self.sigma_px(parameters)
        return edge_response(normal_px, angle_rad, sigma_px, self.aperture_px)

    def base_transform(self, frequency_cpp: Vector, parameters: Vector) -> Vector:
        """Return the Fourier transform of the LSF of the base model."""
        angle_rad, sigma_px = float(parameters[0]), self.sigma_px(parameters)
        return edge_response_transform(frequency_cpp, angle_rad, sigma_px, self.aperture_px)

    def _moments(self, parameters: Vector) -> _Moments:
        key = parameters[: self.geometry_size + 1].tobytes()
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
        if samples.whitener is None:
            near = self.basis.products(normal_px, columns, y)
        else:
            splines = samples.whitened(self.basis.integrals(normal_px))
            near = SplineProducts(splines.T @ splines, splines.T @ columns, splines.T @ y)
        far, step = samples.far, self.basis.step_px
        return _Moments(
            xx=columns.T @ columns + far.level_products,
            xy=columns.T @ y + far.level_values,
            zz=near.zz + step**2 * far.right_square,
            zx=near.zx + step * far.right_levels,
            zy=near.zy + step * far.right_values,
        )

    def _prior_factor(self, hyper: Vector) -> Matrix | None:
        """Return the Cholesky factor of the prior covariance of the coefficients."""
        amplitude = np.exp(hyper[1]) / self.unit_px
        length, tail = np.exp(hyper[2:4]) * self.unit_px
        mirrored = 1.0 / (1.0 + np.exp(-hyper[4]))
        envelope = 1.0 / (1.0 + (self.basis.knot_px / tail) ** 2)
        lags_px = self.basis.step_px * np.arange(self.basis.knot_px.size)
        near = np.exp(-0.5 * (lags_px / length) ** 2)[self._apart]
        covariance = near + mirrored * near[:, ::-1]
        covariance *= (amplitude * envelope)[:, None] * (amplitude * envelope)
        covariance.flat[:: covariance.shape[0] + 1] += (
            _JITTER / self.unit_px**2 + _RELATIVE_JITTER * amplitude**2
        )
        return _factor(covariance)

    def _evaluate(
        self, parameters: Vector, whole: bool = False
    ) -> tuple[float, Conditional | None] | None:
        g = self.geometry_size
        allowed = self.bounded(parameters)
        beyond = (parameters - allowed) / _WALL
        parameters = allowed
        hyper, log_noise = parameters[g : g + HYPERS], parameters[-1]
        variance = np.exp(2.0 * log_noise) + MODEL_ERROR**2
        m = self._moments(parameters)
        prior = self._prior_factor(hyper)
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
        misfit = self.samples.squares / variance - along @ along - v @ v
        determinant = np.log(factor.diagonal()).sum() + np.log(levels_factor.diagonal()).sum()
        z = (hyper - _PRIOR[:, 0]) / _PRIOR[:, 1]
        value = (
            0.5 * misfit + 0.5 * self.samples.count * np.log(variance) + determinant + 0.5 * z @ z
        )
        value += self.samples.geometry_penalty(parameters[:g])
        value += 0.5 * ((log_noise - np.log(0.01)) / _NOISE_SPREAD) ** 2 + 0.5 * beyond @ beyond
        if not whole:
            return float(value), None
        levels = _solve(levels_factor, v, transposed=True)
        weights = _solve(factor, along - coupling @ levels, transposed=True)
        return float(value), Conditional(
            levels, prior @ weights, levels_factor, weights, prior, factor, coupling
        )


def _factor(matrix: Matrix) -> Matrix | None:
    """Return the lower Cholesky factor, None if the matrix is not positive definite."""
    lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
    return None if info else lower


def _solve(factor: Matrix, right: NDArray[np.float64], transposed: bool = False) -> Matrix:
    """Solve L u = right, or L^T u = right."""
    solution, _ = lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))
    return np.asarray(solution if right.ndim > 1 else solution.reshape(-1))
