"""The default method behind the common call: Problem, Request -> Estimate."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Estimate, Status
from lensshift.forward.warp import frame_positions
from lensshift.reconstruction.learned.solver import Solution, solve
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.noise_law import NoiseLaw, constant_noise, light_of, noise_law
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request

Array = NDArray[Any]

# A frame of which less is believed counts as left out; from so many of them on it is said aloud,
# and so it is where less is believed of all.
BELIEVED_FRAME, REJECTED_LIMIT, BELIEVED_LIMIT = 0.5, 0.2, 0.6
# Training went down to noise of 2e-4 (SNR 4000); the median standard deviation of a scene is 0.15:
# of less the weights have seen nothing, and errors of the model are larger.
LEAST_SHARE = 2e-4 / 0.15
# Smaller than any noise of numbers in 0 .. 1 that went through a converter of 24 bits.
LEAST_SIGMA = 1e-7
# Fewer frames show no frequency that a scene hardly reaches.
LEAST_FRAMES = 3
# A shift field that differs from one shift a frame by less than calibrated shifts are wrong by.
MOST_BENT_PX = 0.02


def auto(problem: Problem, request: Request) -> Estimate:
    """Exact data steps and a learned prior; the noise decides what is believed of both."""
    law = noise_of(problem)
    used = problem.weight > 0
    variance = law.variance(light_of(problem.y, used) if law.b else problem.y.real)
    least = max(LEAST_SHARE * float(np.std(problem.y[used])), LEAST_SIGMA)
    variance = np.maximum(variance, least**2) / np.where(used, problem.weight, 1.0)
    noise = np.where(used, np.sqrt(variance), np.inf)
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
        status=_status(image, found),
        confidence=np.min([s.weight for s in found], axis=0).astype(np.float64),
        noise_sigma=max(law.sigma, least),
        notes={
            "std_of": "error",
            "noise_law": law.scaled(problem.intensity, problem.level).coefficients,
        },
    )
    return _judged(estimate, used)


def noise_of(problem: Problem) -> NoiseLaw:
    """Return the noise of an LR pixel in units of the problem: as told, else as the frames say."""
    told = problem.noise_sigma if problem.noise_sigma is not None else problem.told_sigma
    if told is not None:
        return constant_noise(told)
    y, weight = problem.y, problem.weight
    plain = y.dtype.kind != "c" and problem.even_noise and len(y) >= LEAST_FRAMES
    if plain and _bent_px(problem) <= MOST_BENT_PX:
        return noise_law(problem.offset_px, y, weight, problem.blur_sigma_px)
    operator = problem.model.operator
    return constant_noise(estimate_noise(operator, y, weight, even=problem.even_noise).sigma)


def _bent_px(problem: Problem) -> float:
    """Return how far a shift field lies from one shift for each frame."""
    model = problem.model
    if model.offset_px is not None:
        return 0.0
    row, col = frame_positions(model.lr_shape, problem.offset_px, model.scale)
    bent = (np.abs(model.rows.position_hr_px - row[:, :, None]).max(),
            np.abs(model.cols.position_hr_px - col[:, None, :]).max())  # fmt: skip
    return float(max(bent)) / model.scale


def _status(image: Array, found: list[Solution]) -> Status:
    """Return CONVERGED where the last stage moved the picture by less than its error bar."""
    if not np.all(np.isfinite(image)):
        return Status.NOT_FINITE
    settled = all(solution.change < 1.0 for solution in found)
    return Status.CONVERGED if settled else Status.MAX_ITERATIONS


def _judged(estimate: Estimate, used: NDArray[np.bool_]) -> Estimate:
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
