"""The solvers with a bilateral prior behind the common call: Problem, Request -> Estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Estimate
from lensshift.reconstruction.irwsr import Irwsr
from lensshift.reconstruction.least_squares import smooth_fit
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.priors import BilateralTotalVariation
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request
from lensshift.reconstruction.robust import L1Btv
from lensshift.reconstruction.selection import cross_validate, weight_from_noise
from lensshift.reconstruction.uncertainty import propagated_std

# Part of the neighbour differences that the data can see, per prior (benchmarks/quality.py).
BTV_SHARE = 0.6


def irwsr(problem: Problem, request: Request) -> Estimate:
    """Corrected IRW-SR."""
    names = ("window", "alpha", "sparsity", "iterations", "inner_iterations")
    return _btv(problem, request, Irwsr(prior_weight=1.0, **_options(request, names)))


def l1_btv(problem: Problem, request: Request) -> Estimate:
    """Farsiu's L1 data term with bilateral total variation."""
    return _btv(
        problem, request,
        L1Btv(prior_weight=1.0, **_options(request, ("window", "alpha", "iterations"))),
    )  # fmt: skip


def irwsr_toolbox(problem: Problem, request: Request) -> Estimate:
    """The published toolbox."""
    from lensshift.reconstruction.toolbox import irwsr_toolbox as toolbox

    if request.non_negative:
        raise ValueError("the published toolbox has no non-negative option; use irwsr")
    if not isinstance(problem.model.offset_px, np.ndarray):
        raise ValueError("irwsr-toolbox takes one offset per frame, got a shift field; use irwsr")
    callback = request.on_iteration
    weight = request.prior_weight
    return toolbox(
        problem.y, problem.model.offset_px, problem.scale, problem.blur_sigma_px,
        prior_weight=None if weight == "cross-validation" else weight,
        seed=request.seed, confidence=problem.weight,
        on_iteration=None if callback is None else lambda step, image: callback(step, np.nan),
        **_options(request, ("window", "alpha", "sparsity", "iterations", "inner_iterations")),
    )  # fmt: skip


def _btv(problem: Problem, request: Request, solver: Irwsr | L1Btv) -> Estimate:
    """Run a solver with a bilateral prior at a weight that is given or chosen."""
    model, y, weight = problem.model, problem.y, problem.weight
    if y.dtype.kind == "c":
        raise ValueError("this method expects real frames; use tikhonov, tv or auto for phasors")
    chosen = request.prior_weight
    if chosen is None:
        sigma = problem.noise_sigma or estimate_noise(model.operator, y, weight).sigma
        prior = BilateralTotalVariation(solver.window, solver.alpha)
        chosen = weight_from_noise(
            lambda value, x: replace(solver, prior_weight=value)(model, y, weight, x).image,
            prior.value, smooth_fit(model.operator, y, weight, 0.03, 30), max(sigma, 1e-6),
            BTV_SHARE,
        )  # fmt: skip
    elif chosen == "cross-validation":
        chosen = cross_validate(
            lambda value, w: replace(solver, prior_weight=value)(model, y, w).image,
            model.operator, y, weight, request.seed, request.on_iteration,
        )  # fmt: skip
    solver = replace(solver, prior_weight=chosen)
    estimate = solver(model, y, weight, on_iteration=request.on_iteration)
    if request.non_negative:
        estimate = replace(estimate, image=np.maximum(estimate.image, 0.0))
    if problem.noise_sigma is not None:
        estimate = replace(estimate, noise_sigma=problem.noise_sigma)
    if not request.std:
        return estimate
    again = replace(solver, iterations=3)

    def std() -> NDArray[np.float64]:
        return propagated_std(
            lambda values: again(model, values, weight, estimate.image).image,
            y, estimate.noise_sigma or 0.0, weight=weight, seed=request.seed,
        )  # fmt: skip

    return replace(estimate, uncertainty=std)


def _options(request: Request, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: request.options[name] for name in names if name in request.options}
