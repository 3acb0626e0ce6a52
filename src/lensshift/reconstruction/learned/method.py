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
from lensshift.reconstruction.learned.solver import Solution, solve, solve_phasor
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
    found, std = solved(problem, noise, request)
    if std.ndim == 3:  # of a complex picture, that of a component
        std = np.sqrt(np.mean(std[:2] ** 2, axis=0))
    image = found.image
    if request.non_negative and image.dtype.kind == "f":
        image = np.maximum(image, 0)
    return replace(found, image=image, uncertainty=std if request.std else None, noise_sigma=sigma)


def solved(
    problem: Problem, noise: NDArray[np.float64], request: Request
) -> tuple[Estimate, NDArray[np.float64]]:
    """Solve, let the frames refute it, and solve again with what is believed of them.

    Parameters
    ----------
    noise : [frame row col] of each LR pixel, of each component if it has two

    Returns
    -------
    Estimate, std
        in units of the problem; std as in `Solution`, wider where the frames disagree

    Warns
    -----
    QualityWarning
        That names what contradicts.
    """
    noise = with_shift_errors(noise, problem)
    objective: list[float] = []

    def on_stage(number: int, misfit: float) -> None:
        objective.append(misfit)
        if request.on_iteration is not None:
            request.on_iteration(len(objective), misfit)

    def run(noise: NDArray[np.float64]) -> tuple[Solution, Misfit]:
        solver = solve_phasor if problem.y.dtype.kind == "c" else solve
        found = solver(
            problem.model, problem.y, noise, blur_px=problem.blur_sigma_px, on_stage=on_stage
        )
        A = problem.model.operator
        return found, find_misfit(A, found.image, problem.y, noise, problem.scale)

    found, misfit = run(noise)
    left, told = misfit, noise
    if misfit.contradicted and not request.shifts_doubted:
        believed = misfit.weight()
        told = np.where(
            believed > LEAST_WEIGHT, noise / np.sqrt(np.maximum(believed, LEAST_WEIGHT)), np.inf
        )
        found, left = run(told)
    estimate = Estimate(
        image=found.image,
        objective=tuple(objective),
        status=status_of(found),
        confidence=found.weight * (np.where(np.isfinite(noise), noise, 0.0) / told) ** 2,
        notes={"std_of": "error", "misfit": float(np.mean(misfit.chi_square))},
        misfit=misfit.chi_square,
    )
    wider = np.sqrt(left.significant)
    std = found.std * (wider if found.std.ndim == 2 else [wider, wider, np.ones_like(wider)])
    return _judged(estimate, misfit, problem.weight > 0, request), std


def with_shift_errors(sigma: NDArray[np.float64], problem: Problem) -> NDArray[np.float64]:
    """Return the noise of each LR pixel with what the errors of the shifts add where it is steep.

    sigma^2 + e_k^2 |grad y_k|^2,   e_k the standard deviation of the shift of frame k
    """
    error_px = np.broadcast_to(problem.shift_error_px, len(sigma))
    if not np.any(error_px) or min(problem.y.shape[1:]) < 2:
        return sigma
    slopes = np.gradient(problem.y, axis=(1, 2))
    components = 2.0 if problem.y.dtype.kind == "c" else 1.0
    steep = np.sum(np.abs(slopes) ** 2, axis=0) / components
    return np.asarray(np.sqrt(sigma**2 + error_px[:, None, None] ** 2 * steep))


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


def status_of(found: Solution) -> Status:
    """Return CONVERGED where the last stage moved the picture by less than its error bar."""
    if not np.all(np.isfinite(found.image)):
        return Status.NOT_FINITE
    return Status.CONVERGED if found.change < 1.0 else Status.MAX_ITERATIONS


def _judged(
    estimate: Estimate, misfit: Misfit, used: NDArray[np.bool_], request: Request
) -> Estimate:
    """Note the frames that were not believed, and warn of what contradicts."""
    believed = estimate.confidence if estimate.confidence is not None else used.astype(float)
    trust = np.array([c[u].mean() if u.any() else 1.0 for c, u in zip(believed, used, strict=True)])
    notes = dict(estimate.notes) | {
        "trust": float(believed[used].mean()),
        "rejected": np.flatnonzero(trust < BELIEVED_FRAME).tolist(),
    }
    status, wrong = estimate.status, misfit.explain(request.frames or range(len(used)))
    if wrong is not None and not request.shifts_doubted:
        warnings.warn(wrong, QualityWarning, stacklevel=6)
    if status is not Status.NOT_FINITE and (wrong is not None or request.shifts_doubted):
        status = Status.CONTRADICTED
    return replace(estimate, notes=notes, status=status)
