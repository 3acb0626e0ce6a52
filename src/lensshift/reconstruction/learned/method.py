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
from lensshift.reconstruction.learned.solver import solve
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request

Array = NDArray[Any]

# A frame of which less is believed counts as left out; from so many of them on it is said aloud,
# and so it is where less is believed of all.
BELIEVED_FRAME, REJECTED_LIMIT, BELIEVED_LIMIT = 0.5, 0.2, 0.6
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
    noise = with_shift_errors(noise, problem)
    parts = [problem.y.real, problem.y.imag] if problem.y.dtype.kind == "c" else [problem.y]
    objective: list[float] = []

    def on_stage(number: int, misfit: float) -> None:
        objective.append(misfit)
        if request.on_iteration is not None:
            request.on_iteration(len(objective), misfit)

    found = [
        solve(problem.model, y, noise, blur_px=problem.blur_sigma_px, on_stage=on_stage)
        for y in parts
    ]
    image = found[0].image if len(found) == 1 else found[0].image + 1j * found[1].image
    if request.non_negative:
        image = np.maximum(image, 0) if image.dtype.kind == "f" else image
    estimate = Estimate(
        image=image,
        uncertainty=np.sqrt(np.mean([s.std**2 for s in found], axis=0)) if request.std else None,
        objective=tuple(objective),
        status=status_of(image, max(s.change for s in found)),
        confidence=np.min([s.weight for s in found], axis=0).astype(np.float64),
        noise_sigma=sigma,
        notes={"std_of": "error"},
    )
    return judged(estimate, used)


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


def status_of(image: Array, change: float) -> Status:
    """Return CONVERGED where the last stage moved the picture by less than its error bar."""
    if not np.all(np.isfinite(image)):
        return Status.NOT_FINITE
    return Status.CONVERGED if change < 1.0 else Status.MAX_ITERATIONS


def judged(estimate: Estimate, used: NDArray[np.bool_]) -> Estimate:
    """Note the frames that were not believed, and warn if they are many."""
    believed = estimate.confidence if estimate.confidence is not None else used.astype(float)
    trust = np.array([c[u].mean() if u.any() else 1.0 for c, u in zip(believed, used, strict=True)])
    left_out = np.flatnonzero(trust < BELIEVED_FRAME)
    total = float(believed[used].mean())
    if left_out.size >= REJECTED_LIMIT * trust.size or total < BELIEVED_LIMIT:
        warnings.warn(
            f"the frames do not fit the assumed shifts: {left_out.size} of {trust.size} frames "
            f"rejected, mean trust in a pixel {total:.2f}; check offset_px and whether the scene "
            "moved or turned",
            QualityWarning,
            stacklevel=4,
        )
    notes = dict(estimate.notes) | {"trust": total, "rejected": left_out.tolist()}
    return replace(estimate, notes=notes)
