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
from lensshift.reconstruction.priors import PRIORS, BilateralTotalVariation, Prior
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request
from lensshift.reconstruction.robust import ReweightedFit
from lensshift.reconstruction.selection import cross_validate, prior_share, weight_from_noise
from lensshift.reconstruction.uncertainty import propagated_std


def irwsr(problem: Problem, request: Request) -> Estimate:
    """Corrected IRW-SR."""
    names = ("window", "alpha", "sparsity", "iterations", "inner_iterations")
    solver = Irwsr(prior_weight=1.0, **_options(request, names))
    prior = BilateralTotalVariation(solver.window, solver.alpha)
    return _fitted(problem, request, solver, problem.model, prior)


def l1_btv(problem: Problem, request: Request) -> Estimate:
    """Farsiu's L1 data term with bilateral total variation."""
    prior = BilateralTotalVariation(**_options(request, ("window", "alpha")))
    solver = ReweightedFit(1.0, prior, "l1", **_options(request, ("iterations",)))
    return _fitted(problem, request, solver, problem.model.operator, prior)


def maximum_a_posteriori(problem: Problem, request: Request) -> Estimate:
    """A data term and a prior of the caller's choice."""
    name = request.options.get("prior", "tv")
    names = {"btv": ("window", "alpha"), "huber": ("threshold",), "tv": ()}[name]
    unknown = {"window", "alpha", "threshold"} & set(request.options) - set(names)
    if unknown:
        raise ValueError(f"prior {name} does not know {', '.join(sorted(unknown))}")
    prior = PRIORS[name](**_options(request, names))
    data_term = request.options.get("data_term", "l2")
    solver = ReweightedFit(1.0, prior, data_term, **_options(request, ("iterations",)))
    return _fitted(problem, request, solver, problem.model.operator, prior)


def irwsr_toolbox(problem: Problem, request: Request) -> Estimate:
    """The published toolbox."""
    from lensshift.reconstruction.toolbox import irwsr_toolbox as toolbox

    if request.non_negative:
        raise ValueError("the published toolbox has no non-negative option; use irwsr")
    if problem.noise_sigma is not None:
        raise ValueError("the published toolbox finds its own noise, got noise_sigma; use irwsr")
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


def _noise_power(problem: Problem, solver: Irwsr | ReweightedFit) -> float:
    """Return what `weight_from_noise` asks for, from the noise given or estimated."""
    data_term = solver.data_term if isinstance(solver, ReweightedFit) else "huber"
    sigma = problem.noise_sigma
    if sigma is None:
        noise = estimate_noise(
            problem.model.operator, problem.y, problem.weight, even=problem.even_noise
        )
        # Squares feel the outliers; the other data terms hardly do.
        sigma = noise.total if data_term == "l2" else noise.effective
    sigma = max(sigma, 1e-6)
    share = prior_share(problem.blur_sigma_px * problem.scale)
    return share * (sigma if data_term == "l1" else 2.0 * sigma**2)


def _fitted(problem: Problem, request: Request, solver: Any, system: Any, prior: Prior) -> Estimate:
    """Run a solver of these (its system is a model or an operator) at a given or chosen weight."""
    y, weight = problem.y, problem.weight
    if y.dtype.kind == "c":
        raise ValueError("this method expects real frames; use tikhonov, tv or auto for phasors")

    def at(value: float) -> Any:
        return replace(solver, prior_weight=value)

    chosen = request.prior_weight
    if chosen is None:
        power = _noise_power(problem, solver)
        chosen = weight_from_noise(
            lambda value, x: at(value)(system, y, weight, x).image,
            prior.value, smooth_fit(problem.model.operator, y, weight, 0.03, 30),
            power,
        )  # fmt: skip
    elif chosen == "cross-validation":
        chosen = cross_validate(
            lambda value, w: at(value)(system, y, w).image,
            problem.model.operator, y, weight, request.seed, request.on_iteration,
        )  # fmt: skip
    estimate: Estimate = at(chosen)(system, y, weight, on_iteration=request.on_iteration)
    if request.non_negative:
        estimate = replace(estimate, image=np.maximum(estimate.image, 0.0))
    if problem.noise_sigma is not None:
        estimate = replace(estimate, noise_sigma=problem.noise_sigma)
    if not request.std:
        return estimate
    again = replace(solver, prior_weight=chosen, iterations=3)

    def std() -> NDArray[np.float64]:
        return propagated_std(
            lambda values: again(system, values, weight, estimate.image).image,
            y, estimate.noise_sigma or 0.0, weight=weight, seed=request.seed,
        )  # fmt: skip

    return replace(estimate, uncertainty=std)


def _options(request: Request, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: request.options[name] for name in names if name in request.options}
