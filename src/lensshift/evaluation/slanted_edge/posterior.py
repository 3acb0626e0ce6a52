"""The most likely edge and its neighbours: optimum, then weighted draws around it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaincinv, ndtri, stdtrit
from scipy.stats import qmc

from lensshift.evaluation.slanted_edge import likelihood as likeliness
from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector
from lensshift.evaluation.slanted_edge.likelihood import EdgeLikelihood, Solution
from lensshift.evaluation.slanted_edge.lsf_prior import START, STEPS

TYPICAL_STEPS = np.append(STEPS, 0.05)
_FREEDOM = 6.0  # of the t distribution that proposes draws
_SPREAD = 1.15  # proposals a little wider than the curvature says
_LARGEST_SD = 3.0  # in steps; what the likelihood does not limit, the prior does
_CURVATURE_STEP = 0.4
_ROUNDS = 3
_GENERATIONS = 4  # of proposals, each adapted to the draws before it
_MOST_GENERATIONS = 10
_ENOUGH = 20.0  # effective draws, where more generations end
_DRAWS_EACH = 32  # a power of two
_MOST_STEPS = 80
_SETTLED = 0.05  # of the log posterior
_UPPER = 0.975  # end of a 95 % interval


@dataclass(frozen=True, slots=True)
class Posterior:
    """Weighted draws of the parameters."""

    best: Vector  # [p] the optimum
    draws: Matrix  # [k p]
    weights: Vector  # [k], sum 1
    found: list[Solution | None]  # [k] what the pixels say there

    @property
    def effective_size(self) -> float:
        """Number of equally weighted draws that are worth as much."""
        return float(1.0 / np.sum(self.weights**2))

    @property
    def widening(self) -> float:
        """What few draws ask of an interval: Student's factor over that of a normal distribution.

        t(0.975, n - 1) sqrt(1 + 1 / n) / 1.96,   n the effective size
        """
        count = max(self.effective_size, 3.0)
        told = float(stdtrit(count - 1.0, _UPPER) / ndtri(_UPPER))
        return told * float(np.sqrt(1.0 + 1.0 / count))


def drawn_around(likelihood: EdgeLikelihood, start: Vector, seed: int) -> Posterior:
    """Maximise the posterior from near the optimum, then draw around it."""
    best, directions = start, np.diag(TYPICAL_STEPS)
    for _ in range(_ROUNDS):
        value, gradient = likelihood.with_gradient(best)
        directions = _curvature_directions(likelihood, best, gradient, directions)
        if 0.5 * np.sum((gradient @ directions) ** 2) < _SETTLED:
            break
        best, value, _ = descended(likelihood, best, directions)
    proposals = [_Student(best, _SPREAD * directions, likelihood.twin)]
    parameters, log_weights = np.empty((0, best.size)), np.empty(0)
    found: list[Solution | None] = []
    weights = np.empty(0)
    for k in range(_MOST_GENERATIONS):
        if k >= _GENERATIONS and np.sum(weights**2) * _ENOUGH < 1.0:
            break
        if k:
            proposals.append(proposals[0].adapted(parameters, log_weights))
        more = proposals[-1].draws(_DRAWS_EACH, seed + k)
        found += [likelihood.solved(p) for p in more]
        parameters = np.concatenate([parameters, more])
        # Every draw counts as one of the mixture of all proposals so far.
        densities = [proposal.log_density(parameters) for proposal in proposals]
        values = np.array([likeliness.IMPOSSIBLE if one is None else one.value for one in found])
        log_weights = value - values - np.logaddexp.reduce(densities, axis=0)
        weights = _cut(log_weights)
    return Posterior(likelihood.bounded(best), likelihood.bounded(parameters), weights, found)


def _cut(log_weights: Vector) -> Vector:
    """Return weights, sum 1, of which none outweighs the others.

    Source: truncated importance sampling, Ionides, J. Comput. Graph. Stat. 17 (2008) 295.
    """
    weights = np.exp(log_weights - log_weights.max())
    weights = np.minimum(weights, weights.mean() * np.sqrt(weights.size))
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True, slots=True)
class _Student:
    """A multivariate t distribution that proposes draws, folded onto one of two twins."""

    centre: Vector  # [p]
    directions: Matrix  # [p p]
    twin: Vector  # [p] signs whose change makes no difference to the target

    def draws(self, count: int, seed: int) -> Matrix:
        """Return quasi-random draws [k p]."""
        drawn = self.centre + _student(self.centre.size, count, seed) @ self.directions.T
        return np.asarray(np.where(self.twin < 0, np.abs(drawn), drawn))

    def log_density(self, parameters: Matrix) -> Vector:
        """Return the log density of each of [k p], up to a constant of the dimension."""
        both = np.stack([parameters, parameters * self.twin]) - self.centre
        scaled = np.linalg.solve(self.directions, both.swapaxes(1, 2))
        radius = np.sum(scaled**2, axis=1)
        volume = np.linalg.slogdet(self.directions)[1]
        sides = -0.5 * (_FREEDOM + self.centre.size) * np.log1p(radius / _FREEDOM) - volume
        return np.asarray(np.logaddexp(*sides))

    def adapted(self, parameters: Matrix, log_weights: Vector) -> _Student:
        """Return the distribution with the mean and covariance of weighted draws."""
        weights = _cut(log_weights)
        effective = 1.0 / np.sum(weights**2)
        trust = effective / (effective + self.centre.size)
        centre = weights @ parameters
        deviation = np.sqrt(trust * weights)[:, None] * (parameters - centre)
        # A factor of the covariance without forming it: the directions differ by many decades.
        parts = np.vstack([deviation, np.sqrt(1.0 - trust) * self.directions.T])
        centre = trust * centre + (1.0 - trust) * self.centre
        triangle: Matrix = np.asarray(np.linalg.qr(parts, mode="r"))
        return _Student(centre, triangle.T, self.twin)


@lru_cache(maxsize=4 * _MOST_GENERATIONS)
def _student(size: int, count: int, seed: int) -> Matrix:
    """Return quasi-random draws [count size] of the standard t distribution."""
    uniform = np.clip(qmc.Sobol(size + 1, seed=seed).random(count), 1e-9, 1.0 - 1e-9)
    chi_square = 2.0 * gammaincinv(0.5 * _FREEDOM, uniform[:, -1])
    return np.asarray(ndtri(uniform[:, :-1]) / np.sqrt(chi_square / _FREEDOM)[:, None])


def descended(
    likelihood: EdgeLikelihood, start: Vector, directions: Matrix
) -> tuple[Vector, float, Matrix]:
    """Return the optimum along columns [p p] of like worth, its value, and rounder directions."""

    def along(z: Vector) -> tuple[float, Vector]:
        value, gradient = likelihood.with_gradient(start + directions @ z)
        return value, gradient @ directions

    found = minimize(
        along, np.zeros(start.size), jac=True, method="L-BFGS-B",
        options={"maxiter": _MOST_STEPS, "ftol": 1e-7, "maxcor": 30},
    )  # fmt: skip
    inverse: Matrix = found.hess_inv @ np.eye(start.size)
    rounder = directions @ np.linalg.cholesky(0.5 * (inverse + inverse.T))
    return start + directions @ found.x, float(found.fun), rounder


def _curvature_directions(
    likelihood: EdgeLikelihood, best: Vector, gradient: Vector, directions: Matrix
) -> Matrix:
    """Return [p p]: columns that are one posterior standard deviation long, uncorrelated."""
    moves = _CURVATURE_STEP * directions.T
    rows = [likelihood.with_gradient(best + move)[1] - gradient for move in moves]
    hessian = np.array(rows) @ directions / _CURVATURE_STEP
    curvature, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    deviation = 1.0 / np.sqrt(np.maximum(curvature, _LARGEST_SD**-2))
    return np.asarray(directions @ vectors * deviation)


def starting_point(log_sigma: float, noise: float) -> Vector:
    """Return a first guess of all parameters."""
    log_noise = np.log(max(noise, likeliness.MODEL_ERROR))
    return np.concatenate([[log_sigma], START[1:], [log_noise]])
