"""The solvers with a sparse gradient behind the common call: Problem, Request -> Estimate."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Estimate
from lensshift.reconstruction.adaptive import SparseGradient
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.outliers import frame_confidence
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request
from lensshift.reconstruction.selection import cross_validate
from lensshift.reconstruction.uncertainty import propagated_std

Array = NDArray[Any]

# Beyond these a picture is not shown without a warning.
REJECTED_LIMIT, BELIEVED_LIMIT = 0.2, 0.6


def tikhonov(problem: Problem, request: Request) -> Estimate:
    """Least squares with squared differences: one linear solve at the weight that it settles on."""
    return _sparse(
        problem, request,
        SparseGradient(exponent=2.0, robust=False, adapt=False, inner_iterations=40),
    )  # fmt: skip


def total_variation(problem: Problem, request: Request) -> Estimate:
    """Least squares with total variation."""
    return _sparse(problem, request, SparseGradient(exponent=1.0, robust=False, adapt=False))


def _sparse(problem: Problem, request: Request, solver: SparseGradient) -> Estimate:
    A, y, weight = problem.model.operator, problem.y, problem.weight
    solver = replace(
        solver,
        noise_sigma=problem.noise_sigma,
        even_noise=problem.even_noise,
        blur_hr_px=problem.blur_sigma_px * problem.scale,
        non_negative=request.non_negative,
        iterations=request.options.get("iterations", solver.iterations),
    )
    chosen = request.prior_weight
    if chosen == "cross-validation":
        chosen = cross_validate(
            lambda value, w: replace(solver, prior_weight=value)(A, y, w).image,
            A, y, weight, request.seed, request.on_iteration,
        )  # fmt: skip
    solver = replace(solver, prior_weight=chosen)
    estimate = solver(A, y, weight, on_iteration=request.on_iteration)
    if not request.std:
        return estimate

    def std() -> NDArray[np.float64]:
        return propagated_std(
            lambda values: solver.replicate(A, values, estimate),
            y, estimate.noise_sigma or 0.0, weight=weight, seed=request.seed,
        )  # fmt: skip

    return replace(estimate, uncertainty=std)


def warn_of_misfit(problem: Problem, estimate: Estimate) -> Estimate:
    """Note the frames that were left out, and warn if they are many or little is believed."""
    residual = problem.y - problem.model.operator(estimate.image)
    trust = frame_confidence(residual, problem.weight)
    left_out = np.flatnonzero(trust < 0.5)
    believed = float(estimate.notes["trust"])
    if left_out.size >= REJECTED_LIMIT * trust.size or believed < BELIEVED_LIMIT:
        spread = np.array([robust_scale(r[w > 0]) if np.any(w > 0) else 0.0
                           for r, w in zip(residual, problem.weight, strict=True)])  # fmt: skip
        times = float(spread.max() / max(estimate.noise_sigma or 1.0, 1e-12))
        warnings.warn(
            f"the frames do not fit the assumed shifts: {left_out.size} of {trust.size} frames "
            f"rejected, mean trust in a pixel {believed:.2f}, worst frame off by {times:.0f} times "
            "the noise; check offset_px and whether the scene moved or turned",
            QualityWarning,
            stacklevel=4,
        )
    notes = dict(estimate.notes) | {"rejected": left_out.tolist()}
    return replace(estimate, notes=notes)
