"""The most likely edge and its neighbours: optimum, then weighted draws around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaincinv, ndtri
from scipy.stats import qmc

from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector
from lensshift.evaluation.slanted_edge.likelihood import (
    HYPERS,
    MODEL_ERROR,
    Conditional,
    EdgeLikelihood,
)

# Typical sizes of a step in the hyper-parameters and the log noise, for finite differences.
_HYPER_STEPS = (0.1, 0.5, 0.2, 0.3, 1.0)
_FREEDOM = 6.0  # of the t distribution that proposes draws
_SPREAD = 1.15  # proposals a little wider than the curvature says
_LARGEST_SD = 3.0  # in steps; what the likelihood does not limit, the prior does
_CURVATURE_STEP = 0.4
_ROUNDS = 3
_SETTLED = 0.05  # of the log posterior


@dataclass(frozen=True, slots=True)
class Posterior:
    """Weighted draws of the parameters.

    Parameters
    ----------
    best : [p] the optimum
    draws : [k p]
    weights : [k], sum 1
    conditionals : distributions of levels and coefficients at the draws, None where impossible
    """

    best: Vector
    draws: Matrix
    weights: Vector
    conditionals: list[Conditional | None]

    @property
    def effective_size(self) -> float:
        """Number of equally weighted draws that are worth as much."""
        return float(1.0 / np.sum(self.weights**2))


def find_posterior(
    likelihood: EdgeLikelihood, start: Vector, steps: Vector, draws: int, seed: int
) -> Posterior:
    """Maximise the posterior from `start`, then draw around the optimum.

    Parameters
    ----------
    likelihood : the model
    start, steps : [p] first guess and typical sizes of a step
    draws : number of draws, a power of two
    seed : of the draws
    """

    best, value = _descended(likelihood, start, np.diag(steps))
    directions = _curvature_directions(likelihood, best, np.diag(steps), value)
    for _ in range(_ROUNDS):
        last = value
        best, value = _descended(likelihood, best, directions)
        if last - value < _SETTLED:
            break
        directions = _curvature_directions(likelihood, best, directions, value)
    first = _Student(best, _SPREAD * directions)
    parameters = first.draws(draws // 2, seed)
    found = [likelihood.conditional(p) for p in parameters]
    logs = value - np.array([one[0] for one in found])
    second = first.adapted(parameters, logs - first.log_density(parameters))
    more = second.draws(draws - draws // 2, seed + 1)
    found += [likelihood.conditional(p) for p in more]
    parameters = np.concatenate([parameters, more])
    logs = value - np.array([one[0] for one in found])
    mixture = np.logaddexp(first.log_density(parameters), second.log_density(parameters))
    log_weights = logs - (mixture - np.log(2.0))
    top = log_weights.max()
    weights = np.exp(log_weights - top)
    conditionals = [one[1] for one in found]
    inside = likelihood.bounded(parameters)
    return Posterior(likelihood.bounded(best), inside, weights / weights.sum(), conditionals)


@dataclass(frozen=True, slots=True)
class _Student:
    """A multivariate t distribution, from which draws are proposed."""

    centre: Vector
    directions: Matrix

    def draws(self, count: int, seed: int) -> Matrix:
        """Return quasi-random draws [k p]."""
        size = self.centre.size
        uniform = np.clip(qmc.Sobol(size + 1, seed=seed).random(count), 1e-9, 1.0 - 1e-9)
        chi_square = 2.0 * gammaincinv(0.5 * _FREEDOM, uniform[:, -1])
        samples = ndtri(uniform[:, :-1]) / np.sqrt(chi_square / _FREEDOM)[:, None]
        return np.asarray(self.centre + samples @ self.directions.T)

    def log_density(self, parameters: Matrix) -> Vector:
        """Return the log density of each of [k p], up to a constant of the dimension."""
        scaled = np.linalg.solve(self.directions, (parameters - self.centre).T)
        size = self.centre.size
        radius = np.sum(scaled**2, axis=0)
        volume = np.linalg.slogdet(self.directions)[1]
        density: Vector = -0.5 * (_FREEDOM + size) * np.log1p(radius / _FREEDOM) - volume
        return density

    def adapted(self, parameters: Matrix, log_weights: Vector) -> _Student:
        """Return the distribution with the mean and covariance of weighted draws."""
        weights = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        effective = 1.0 / np.sum(weights**2)
        trust = effective / (effective + self.centre.size)
        centre = weights @ parameters
        deviation = np.sqrt(trust * weights)[:, None] * (parameters - centre)
        # A factor of the covariance without forming it: the directions differ by many decades.
        parts = np.vstack([deviation, np.sqrt(1.0 - trust) * self.directions.T])
        centre = trust * centre + (1.0 - trust) * self.centre
        triangle: Matrix = np.asarray(np.linalg.qr(parts, mode="r"))
        return _Student(centre, triangle.T)


def _descended(
    likelihood: EdgeLikelihood, start: Vector, directions: Matrix
) -> tuple[Vector, float]:
    """Return the optimum and its value, in coordinates along the columns of `directions`."""

    def along(z: Vector) -> float:
        return likelihood.negative_log(start + directions @ z)

    found = minimize(
        along,
        np.zeros(start.size),
        method="L-BFGS-B",
        options={"maxiter": 80, "eps": 1e-4, "ftol": 1e-7},
    )
    return start + directions @ found.x, float(found.fun)


def _curvature_directions(
    likelihood: EdgeLikelihood, best: Vector, directions: Matrix, value: float
) -> Matrix:
    """Return [p p]: columns that are one posterior standard deviation long, uncorrelated."""
    size, moves = best.size, _CURVATURE_STEP * directions.T
    up = [likelihood.negative_log(best + move) for move in moves]
    down = [likelihood.negative_log(best - move) for move in moves]
    hessian = np.zeros((size, size))
    for i in range(size):
        hessian[i, i] = up[i] - 2.0 * value + down[i]
        for j in range(i):
            both = likelihood.negative_log(best + moves[i] - moves[j])
            cross = up[i] + down[j] - both - value
            hessian[i, j] = hessian[j, i] = cross
    curvature, vectors = np.linalg.eigh(hessian / _CURVATURE_STEP**2)
    deviation = 1.0 / np.sqrt(np.maximum(curvature, _LARGEST_SD**-2))
    return np.asarray(directions @ vectors * deviation)


def starting_point(
    geometry: Vector, log_sigma: float, noise: float, half_length_px: float
) -> tuple[Vector, Vector]:
    """Return a first guess of all parameters, and sizes of steps for them."""
    hyper = [log_sigma, np.log(0.05), np.log(0.6), 0.0, 2.0]
    noise = max(noise, MODEL_ERROR)
    start = np.concatenate([geometry, hyper, [np.log(noise)]])
    precision_px = min(0.5 * noise, 0.02)  # of the edge's place, roughly
    geometry_steps = [precision_px / max(half_length_px, 1.0)] + [precision_px] * (
        geometry.size - 1
    )
    steps = np.concatenate([geometry_steps, _HYPER_STEPS, [0.05]])
    if start.size != geometry.size + HYPERS + 1:
        raise ValueError(f"expected {HYPERS} hyper-parameters, got {len(hyper)}")
    return start, steps
