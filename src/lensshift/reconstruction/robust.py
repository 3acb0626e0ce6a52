"""Maximum a posteriori fits with a choice of data term and prior, by iterative reweighting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Estimate, Status
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.least_squares import (
    mean_column_square,
    smooth_fit,
    solve_penalised,
)
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.options import check_settings
from lensshift.reconstruction.priors import BilateralTotalVariation, Prior

Array = NDArray[Any]
DataTerm = Literal["l2", "l1", "huber"]

# Below this residual the L1 term is quadratic, so that its weights stay finite.
L1_SMOOTHING = 5e-3
HUBER_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class ReweightedFit:
    """Minimise a data term and a prior by iteratively reweighted least squares.

        F(x) = sum w rho(A x - y) + lambda P(x)

    with rho(r) = r^2 (l2), sqrt(r^2 + s^2) (l1: Farsiu's choice), or Huber's function with the
    threshold at two robust standard deviations of the residual, scaled to r^2 near 0. Every
    step solves the quadratic that touches F from above by a few conjugate gradients.

    Parameters
    ----------
    prior_weight : lambda, for frames in 0 .. 1
    prior : P
    data_term : rho
    iterations, inner_iterations : reweightings, and conjugate gradients in each
    tolerance : stop when no pixel moves by more than this

    Source: Farsiu et al. 2004 (L1 + BTV).
    """

    prior_weight: float
    prior: Prior = field(default_factory=BilateralTotalVariation)
    data_term: DataTerm = "l1"
    iterations: int = 20
    inner_iterations: int = 8
    tolerance: float = 1e-3

    def __post_init__(self) -> None:
        check_settings(self)

    def __call__(
        self,
        A: LinearOperator,
        y: Array,
        weight: Array,
        x0: Array | None = None,
        on_iteration: Callable[[int, float], None] | None = None,
    ) -> Estimate:
        """Return the estimate [row col] from frames and their weights [frame row col]."""
        x = smooth_fit(A, y, weight, 0.03, 30) if x0 is None else x0
        square = mean_column_square(A)
        objective: list[float] = []
        confidence = np.ones(y.shape)
        status = Status.MAX_ITERATIONS
        sigma = 0.0
        for t in range(self.iterations):
            before = x
            size = np.abs(y - A.forward(x))
            sigma = max(robust_scale((y - A.forward(x))[weight > 0]), 1e-6)
            curvature, confidence = self._reweighted(size, sigma)
            x = solve_penalised(
                A, y, weight * curvature, self.prior_weight * self.prior.coefficients(x), x,
                self.inner_iterations, directions=self.prior.directions, column_square=square,
            )  # fmt: skip
            size = np.abs(y - A.forward(x))
            misfit = float(np.sum(weight * self._misfit(size, sigma)))
            objective.append(misfit + self.prior_weight * self.prior.value(x))
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
            confidence=confidence * np.clip(weight, 0.0, 1.0),
            prior_weight=self.prior_weight,
            noise_sigma=sigma,
        )

    def _reweighted(self, size: Array, sigma: float) -> tuple[Array, Array]:
        """Return the factors of the touching quadratic, and the confidence in 0 .. 1."""
        if self.data_term == "l2":
            return np.ones(size.shape), np.ones(size.shape)
        if self.data_term == "l1":
            root = np.sqrt(size**2 + L1_SMOOTHING**2)
            return 0.5 / root, L1_SMOOTHING / root
        huber = np.minimum(1.0, HUBER_SIGMAS * sigma / np.maximum(size, 1e-300))
        return huber, huber

    def _misfit(self, size: Array, sigma: float) -> Array:
        if self.data_term == "l2":
            return size**2
        if self.data_term == "l1":
            return np.sqrt(size**2 + L1_SMOOTHING**2)
        limit = HUBER_SIGMAS * sigma
        return np.where(size <= limit, size**2, 2 * limit * size - limit**2)
