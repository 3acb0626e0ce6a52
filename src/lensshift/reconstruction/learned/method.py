"""The default method behind the common call: Problem, Request -> Estimate."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Estimate, Status
from lensshift.forward.model import ForwardModel
from lensshift.reconstruction.blur_check import fitting_width_px
from lensshift.reconstruction.learned.solver import Solution, solve
from lensshift.reconstruction.misfit import Misfit, find_misfit
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request

Array = NDArray[Any]

# A frame of which less is believed counts as left out.
BELIEVED_FRAME = 0.5
# Pixels that are believed less in the second solution are left out: the solver takes the mean noise
# for its unit, which few pixels should not move.
LEAST_WEIGHT = 0.04
# Smaller than any noise of numbers in 0 .. 1 that went through a converter of 24 bits.
LEAST_SIGMA = 1e-7
# Noise is one number: so many windows along a side, of 6400 samples each with four frames (its
# estimate is good to 2 %), tell as much as the whole of a large sensor.
WINDOWS, WINDOW_PX = 3, 40


def auto(problem: Problem, request: Request) -> Estimate:
    """Exact data steps and a learned prior; the noise decides what is believed of both."""
    sigma = problem.noise_sigma
    sigma = max(noise_of(problem) if sigma is None else sigma, LEAST_SIGMA)
    used = problem.weight > 0
    noise = np.where(used, sigma / np.sqrt(np.where(used, problem.weight, 1.0)), np.inf)
    parts = [problem.y.real, problem.y.imag] if problem.y.dtype.kind == "c" else [problem.y]
    objective: list[float] = []

    def on_stage(number: int, misfit: float) -> None:
        objective.append(misfit)
        if request.on_iteration is not None:
            request.on_iteration(len(objective), misfit)

    def run(noise: Array) -> tuple[Array, list[Solution]]:
        found = [
            solve(problem.model, y, noise, blur_px=problem.blur_sigma_px, on_stage=on_stage)
            for y in parts
        ]
        return found[0].image if len(found) == 1 else found[0].image + 1j * found[1].image, found

    def compare(image: Array, noise: Array) -> Misfit:
        return find_misfit(problem.model.operator, image, problem.y, noise, problem.scale)

    image, found = run(noise)
    misfit = left = compare(image, noise)
    wrong = misfit.explain(request.frames or range(len(used)))
    width_px = None
    if request.blur_told and not request.shifts_doubted:
        width_px = fitting_width_px(problem, image, noise)
    if width_px is not None:
        wrong = (
            f"the frames are sharper than psf_sigma_px {problem.blur_sigma_px:g} lets them be: "
            f"about {width_px:.2f} LR pixels fit them (a square pixel has 0.29)"
        )
    elif misfit.curable and not request.shifts_doubted:
        believed = misfit.weight()
        noise = np.where(
            believed > LEAST_WEIGHT, noise / np.sqrt(np.maximum(believed, LEAST_WEIGHT)), np.inf
        )
        image, found = run(noise)
        left = compare(image, noise)
    if request.non_negative:
        image = np.maximum(image, 0) if image.dtype.kind == "f" else image
    std = np.sqrt(np.mean([s.std**2 for s in found], axis=0) * left.significant)
    estimate = Estimate(
        image=image,
        uncertainty=std if request.std else None,
        objective=tuple(objective),
        status=_status(image, found),
        confidence=np.min([s.weight for s in found], axis=0) * (sigma / noise) ** 2,
        noise_sigma=sigma,
        notes={"std_of": "error", "misfit": float(np.mean(misfit.chi_square))},
        misfit=misfit.chi_square,
    )
    return _judged(estimate, wrong, used, request)


def noise_of(problem: Problem) -> float:
    """Return the noise of an LR pixel; of a large sensor from windows spread over it.

    A scene can only make the estimate of a window larger, so a low one of them is taken.
    """
    rows, cols = problem.model.lr_shape
    if rows * cols <= (WINDOWS * WINDOW_PX) ** 2:
        return _estimated(problem, problem.model, problem.y, problem.weight)
    found = []
    for top in np.linspace(0, max(rows - WINDOW_PX, 0), WINDOWS).astype(int):
        for left in np.linspace(0, max(cols - WINDOW_PX, 0), WINDOWS).astype(int):
            part = (
                slice(top, min(top + WINDOW_PX, rows)),
                slice(left, min(left + WINDOW_PX, cols)),
            )
            y, weight = (v[(slice(None), *part)] for v in (problem.y, problem.weight))
            if np.mean(weight > 0) > 0.5:
                model = problem.model.crop(*part)
                found.append(_estimated(problem, model, y, weight))
    if not found:
        return _estimated(problem, problem.model, problem.y, problem.weight)
    return float(np.quantile(found, 0.25))


def _estimated(problem: Problem, model: ForwardModel, y: Array, weight: Array) -> float:
    return estimate_noise(model.operator, y, weight, even=problem.even_noise).sigma


def _status(image: Array, found: list[Solution]) -> Status:
    """Return CONVERGED where the last stage moved the picture by less than its error bar."""
    if not np.all(np.isfinite(image)):
        return Status.NOT_FINITE
    settled = all(solution.change < 1.0 for solution in found)
    return Status.CONVERGED if settled else Status.MAX_ITERATIONS


def _judged(
    estimate: Estimate, wrong: str | None, used: NDArray[np.bool_], request: Request
) -> Estimate:
    """Note the frames that were not believed, and warn of what contradicts."""
    believed = estimate.confidence if estimate.confidence is not None else used.astype(float)
    trust = np.array([c[u].mean() if u.any() else 1.0 for c, u in zip(believed, used, strict=True)])
    notes = dict(estimate.notes) | {
        "trust": float(believed[used].mean()),
        "rejected": np.flatnonzero(trust < BELIEVED_FRAME).tolist(),
    }
    status = estimate.status
    if wrong is not None and not request.shifts_doubted:
        warnings.warn(wrong, QualityWarning, stacklevel=5)
    if status is not Status.NOT_FINITE and (wrong is not None or request.shifts_doubted):
        status = Status.CONTRADICTED
    return replace(estimate, notes=notes, status=status)
