"""The one loop behind all methods that reweigh: data loss, prior and weight are values.

    F(x) = sum w rho(A x - y) + lambda P(x)

Each step replaces rho and P by the quadratics that touch them from above at x, and moves x towards
the minimum of their sum by some conjugate gradients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.types import Estimate, Status
from lensshift.forward.least_squares import mean_column_square, smooth_fit, solve_penalised
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.losses import Loss
from lensshift.reconstruction.priors import Prior

OnIteration = Callable[[int, float], None]

# Stiffness and conjugate gradients of the low pass where the methods begin: it need not be solved.
START_STIFFNESS, START_STEPS = 0.03, 30


@dataclass(frozen=True, slots=True)
class MaximumAPosteriori:
    """The weight at which the prior says what the picture shows.

        lambda = power N / (p P(x))

    is the maximum a posteriori scale of a prior of degree p, with N HR pixels.

    Parameters
    ----------
    power : what the data term costs for a pixel of pure noise, times the part of the differences
        that the data can see: 2 c sigma^2 for squares, c sigma for L1
    """

    power: float

    def __call__(self, prior: Prior, x: Array) -> float:
        """Return lambda at x."""
        return self.power * x.size / (prior.degree * max(prior.value(x), 1e-12))


@dataclass(frozen=True, slots=True)
class Reweighted:
    """Minimise a data loss and a prior by iteratively reweighted least squares.

    Parameters
    ----------
    loss, prior : rho and P
    prior_weight : lambda, or the rule that finds it anew in each step
    noise_sigma : noise of an LR pixel, which some priors want to know
    iterations, inner_iterations : reweightings, and conjugate gradients in each
    tolerance : stop when no pixel moves by more than this
    solved : stop the conjugate gradients where their residual has shrunk so much
    non_negative : whether negative values are set to 0 after each step

    Images should lie within about 0 .. 1.
    """

    loss: Loss
    prior: Prior
    prior_weight: float | MaximumAPosteriori
    noise_sigma: float = 0.0
    iterations: int = 20
    inner_iterations: int = 8
    tolerance: float = 1e-3
    solved: float = 1e-4
    non_negative: bool = False

    def __call__(
        self,
        A: LinearOperator,
        y: Array,
        weight: Array,
        x0: Array | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Estimate:
        """Return the estimate [row col] from frames and their weights [frame row col].

        Parameters
        ----------
        A : HR image [row col] to frames [frame row col]
        y, weight : [frame row col]; all is computed in the precision of `y`
        x0 : [row col] start, by default a low pass of the frames
        on_iteration : called with the number of the iteration and the objective
        """
        x = smooth_fit(A, y, weight, START_STIFFNESS, START_STEPS) if x0 is None else x0
        square = mean_column_square(A, x.real.dtype)
        prior, prior_weight = self.prior, 0.0
        residual, confidence = y - A.forward(x), weight
        objective: list[float] = []
        status, sigma = Status.MAX_ITERATIONS, 0.0
        for t in range(self.iterations):
            before = x
            belief = self.loss.believe(residual, weight, confidence)
            confidence, sigma = belief.confidence, belief.sigma
            prior = prior.renewed(x, self.noise_sigma)
            prior_weight = self._weigh(prior, x, prior_weight)
            a = prior.coefficients(x)
            a *= prior_weight
            x = solve_penalised(
                A, y, belief.weight, a, x, self.inner_iterations, residual=residual,
                directions=prior.directions, column_square=square, tolerance=self.solved,
            )  # fmt: skip
            if self.non_negative:
                x = np.maximum(x, 0.0)
            residual = y - A.forward(x)
            cost = self.loss.cost(residual, weight, belief)
            objective.append(cost + prior_weight * prior.value(x))
            if on_iteration is not None:
                on_iteration(t + 1, objective[-1])
            if not np.isfinite(objective[-1]):
                status = Status.NOT_FINITE
                break
            if np.max(np.abs(x - before)) < self.tolerance:
                status = Status.CONVERGED
                break
        return Estimate(
            image=x,
            objective=tuple(objective),
            status=status,
            confidence=np.asarray(confidence, np.float64),
            prior_weight=prior_weight,
            noise_sigma=self.noise_sigma or sigma,
        )

    def _weigh(self, prior: Prior, x: Array, before: float) -> float:
        """Return lambda; what a rule finds is averaged with the step before, or it might swing."""
        if not isinstance(self.prior_weight, MaximumAPosteriori):
            return self.prior_weight
        found = self.prior_weight(prior, x)
        return float(np.sqrt(found * before)) if before > 0.0 else found
