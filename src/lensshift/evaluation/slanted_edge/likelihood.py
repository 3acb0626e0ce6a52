"""How well an edge, a line spread function and a noise level explain the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lensshift.evaluation.slanted_edge.design import EdgeDesign
from lensshift.evaluation.slanted_edge.edge_model import (
    Matrix,
    SplineBasis,
    Vector,
    edge_response,
    edge_response_transform,
)
from lensshift.evaluation.slanted_edge.prior import SplinePrior, cholesky
from lensshift.evaluation.slanted_edge.samples import EdgeSamples

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
_LOG_NOISE, _NOISE_SPREAD = np.log(0.01), 3.0  # of the contrast
_LOG_NOISE_BOUNDS = (-12.0, 1.0)
# No edge follows the model to all digits; below this share of the contrast, noise is not told
# from it.
MODEL_ERROR = 1e-4
HYPERS = 5  # log sigma, log amplitude, log length, log tail, logit symmetry; the noise follows
IMPOSSIBLE = 1e10


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

    def covariance(self) -> Matrix:
        """Return the covariance [p + j, p + j] of levels and whitened coefficients."""
        count = self.weights.size
        inverse = _solve(self.factor, np.eye(count))
        levels_inverse = _solve(self.levels_factor, np.eye(self.levels.size))
        levels = levels_inverse.T @ levels_inverse
        shared = inverse.T @ self.coupling
        between = -shared @ levels
        own = inverse.T @ inverse - between @ shared.T
        return np.block([[levels, between.T], [between, own]])

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Matrix, Matrix]:
        """Draw levels [p count] and coefficients [j count]."""
        noise = rng.standard_normal((self.levels.size, count))
        deviation = _solve(self.levels_factor, noise, transposed=True)
        pull = rng.standard_normal((self.weights.size, count)) - self.coupling @ deviation
        weights = self.weights[:, None] + _solve(self.factor, pull, transposed=True)
        return self.levels[:, None] + deviation, self.prior_factor @ weights


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """The likelihood at one point, with what its gradient needs."""

    value: float
    design: EdgeDesign
    conditional: Conditional
    misfit: float
    variance: float


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
        self._prior = SplinePrior(basis, unit_px)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.geometry_size + HYPERS + 1

    def conditional(self, parameters: Vector) -> tuple[float, Conditional | None]:
        """Return minus the log posterior, up to a constant, and what it leaves to the factors.

        Out of bounds, the value is `IMPOSSIBLE` and there is no distribution.
        """
        found = self._solved(parameters)
        return (IMPOSSIBLE, None) if found is None else (found.value, found.conditional)

    def with_gradient(self, parameters: Vector) -> tuple[float, Vector | None]:
        """Return minus the log posterior and its derivatives [p], None where it is impossible.

        Source: the derivatives of a restricted likelihood, Harville, J. Am. Stat. Assoc. 72
        (1977) 320.
        """
        found = self._solved(parameters)
        if found is None:
            return IMPOSSIBLE, None
        return found.value, self._gradient(parameters, found)

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

    def _solved(self, parameters: Vector) -> _Solved | None:
        g, log_noise = self.geometry_size, float(parameters[-1])
        hyper = parameters[g:-1]
        if not self._possible(parameters):
            return None
        prior = self._prior.factor(hyper[1:])
        if prior is None:
            return None
        variance = np.exp(2.0 * log_noise) + MODEL_ERROR**2
        design = EdgeDesign(
            self.samples, self.basis, parameters[:g], self.sigma_px(parameters), self.aperture_px
        )
        m = design.products()
        inner = prior.T @ m.zz @ prior / variance
        inner.flat[:: inner.shape[0] + 1] += 1.0
        factor = cholesky(inner)
        if factor is None:
            return None
        projected = _solve(factor, prior.T @ np.column_stack([m.zx, m.zy]) / variance)
        coupling, along = projected[:, :-1], projected[:, -1]
        levels_factor = cholesky(m.xx / variance - coupling.T @ coupling)
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
        value += 0.5 * ((log_noise - _LOG_NOISE) / _NOISE_SPREAD) ** 2
        levels = _solve(levels_factor, v, transposed=True)
        weights = _solve(factor, along - coupling @ levels, transposed=True)
        factors = Conditional(
            levels, prior @ weights, levels_factor, weights, prior, factor, coupling
        )
        return _Solved(float(value), design, factors, float(misfit), float(variance))

    def _possible(self, parameters: Vector) -> bool:
        hyper, log_noise = parameters[self.geometry_size : -1], parameters[-1]
        within = (hyper > _BOUNDS[:, 0]) & (hyper < _BOUNDS[:, 1])
        low, high = _LOG_NOISE_BOUNDS
        return bool(
            np.all(np.isfinite(parameters))
            and np.all(within)
            and low < log_noise < high
            and abs(parameters[0]) <= 0.9
        )

    def _gradient(self, parameters: Vector, found: _Solved) -> Vector:
        """Return the derivatives of the value.

        With D = [X Z], H = D^T D / v + (0, K^-1), C its inverse, b the factors, r = y - D b:

            by the design       sum of dD . (D C - r b^T) / v
            by the prior        (K^-1 - K^-1 (C + b b^T) K^-1) . dK / 2
            by the variance     (n - r^T r / v - trace(C D^T D) / v) / 2 v
        """
        g, c, variance = self.geometry_size, found.conditional, found.variance
        geometry, hyper, log_noise = parameters[:g], parameters[g:-1], parameters[-1]
        knots = c.weights.size
        spread = c.covariance()
        covariance = spread.copy()
        covariance[-knots:] = c.prior_factor @ covariance[-knots:]
        covariance[:, -knots:] = covariance[:, -knots:] @ c.prior_factor.T
        design = found.design.gradient(np.concatenate([c.levels, c.coefficients]), covariance)
        unexplained = np.eye(knots) - spread[-knots:, -knots:] - np.outer(c.weights, c.weights)
        half = _solve(c.prior_factor, unexplained, transposed=True)
        pull = 0.5 * _solve(c.prior_factor, half.T, transposed=True)
        known = spread.shape[0] - np.trace(spread[-knots:, -knots:])
        rest = found.misfit - c.weights @ c.weights
        by_variance = 0.5 * (self.samples.count - rest - known) / variance
        gradient = np.zeros(self.size)
        gradient[: g + 1] = design / variance
        gradient[:g] += self.samples.geometry_pull(geometry)
        gradient[g + 1 : -1] = self._prior.slopes(hyper[1:], pull)
        gradient[g:-1] += (hyper - _PRIOR[:, 0]) / _PRIOR[:, 1] ** 2
        gradient[-1] = 2.0 * np.exp(2.0 * log_noise) * by_variance
        gradient[-1] += (log_noise - _LOG_NOISE) / _NOISE_SPREAD**2
        return gradient


def _solve(factor: Matrix, right: NDArray[np.float64], transposed: bool = False) -> Matrix:
    """Solve L u = right, or L^T u = right."""
    solution, _ = lapack.dtrtrs(factor, right, lower=1, trans=int(transposed))
    return np.asarray(solution if right.ndim > 1 else solution.reshape(-1))
