"""Data, system matrix and prior of one majorisation step, and the choice of lambda."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from lensshift.core.arrays import Floats, Mask
from lensshift.reconstruction.toolbox.prior import WeightedBtv
from lensshift.reconstruction.toolbox.scg import dot, minimise_scg

# A normal variate above this marks a validation pixel, which makes 17 % of them and not 5 %.
_TRAINING_LIMIT = 0.95
_SEARCH_DECADES = (-12.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class MajorisedProblem:
    """F(x) = sum beta r^2 + lambda R(x),   r = y - W x.

    Parameters
    ----------
    y, confidence : one entry per LR pixel of all frames, frame by frame
    forward, adjoint : W and its transpose
    prior_weight : lambda
    """

    y: Floats
    forward: sparse.csr_array
    adjoint: sparse.csr_array
    confidence: Floats
    prior: WeightedBtv
    prior_weight: float

    def residual(self, x: Floats) -> Floats:
        """Return r, one entry per LR pixel."""
        return np.asarray(self.y - self.forward @ x)

    def value(self, x: Floats) -> float:
        """Return F(x)."""
        r = self.residual(x)
        return dot(self.confidence * r, r) + self.prior_weight * self.prior.value(x)

    def gradient(self, x: Floats) -> Floats:
        """Return what the toolbox takes for the gradient of F."""
        back = self.adjoint @ (self.confidence * self.residual(x))
        return np.asarray(-2.0 * back + self.prior_weight * self.prior.gradient(x))

    def solve(self, x: Floats, iterations: int) -> tuple[Floats, float]:
        """Improve `x` by scaled conjugate gradients; return it and F there."""
        return minimise_scg(self.value, self.gradient, x, iterations)


def training_pixels(count: int, rng: np.random.Generator) -> Mask:
    """Draw which LR pixels train; they are drawn frame by frame, row by row."""
    return rng.standard_normal(count) <= _TRAINING_LIMIT


def search_weights(previous: float | None, iteration: int, count: int) -> Floats:
    """Return the values of lambda to try: first 1e-12 .. 1, later +-1/iteration decades."""
    low, high = _SEARCH_DECADES
    if previous is not None:
        low, high = np.log10(previous) - 1.0 / iteration, np.log10(previous) + 1.0 / iteration
    return np.logspace(low, high, count)


def cross_validate(
    problem: MajorisedProblem, x: Floats, weights: Floats, training: Mask, iterations: int
) -> tuple[float, Floats]:
    """Return the lambda that predicts the validation pixels best, and its training solution.

    Every solve starts at `x`. With no finite score the answer is the middle value and `x`.

    Source: selectRegularizationWeight of the toolbox.
    """
    train = replace(problem, confidence=problem.confidence * training)
    validation = problem.confidence * ~training
    best_error, best_weight, best_x = np.inf, float(np.median(weights)), x
    for weight in weights:
        candidate = replace(train, prior_weight=float(weight)).solve(x, iterations)[0]
        error = dot(validation, problem.residual(candidate) ** 2)
        if error < best_error:
            best_error, best_weight, best_x = error, float(weight), candidate
    return best_weight, best_x
