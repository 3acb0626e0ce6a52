"""The plain methods behind the common call: Problem, Request -> Estimate."""

from __future__ import annotations

import numpy as np

from lensshift.core.types import Estimate, Status
from lensshift.reconstruction import baselines
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.request import Request


def nearest(problem: Problem, request: Request) -> Estimate:
    """Take one frame and repeat its pixels."""
    k = _frame(problem, request)
    return _estimate(
        problem,
        request,
        baselines.nearest(problem.y[k], problem.weight[k], problem.offset_px[k], problem.scale),
    )


def bicubic(problem: Problem, request: Request) -> Estimate:
    """Interpolate one frame, or combine the aligned frames by mean or median."""
    return _estimate(
        problem,
        request,
        baselines.bicubic(
            problem.y, problem.weight, problem.offset_px, problem.scale,
            combine=request.options.get("combine", "first"), frame=_frame(problem, request),
        ),
    )  # fmt: skip


def deconvolution(problem: Problem, request: Request) -> Estimate:
    """Interpolate one frame and undo the blur of its pixels."""
    k = _frame(problem, request)
    return _estimate(
        problem,
        request,
        baselines.deconvolution(
            problem.y[k], problem.weight[k], problem.offset_px[k], problem.scale,
            psf_sigma_px=problem.blur_sigma_px, noise_sigma=problem.noise_sigma,
            method=request.options.get("algorithm", "wiener"),
        ),
    )  # fmt: skip


def shift_and_add(problem: Problem, request: Request) -> Estimate:
    """Drop every LR sample into the nearest HR pixel."""
    return _estimate(
        problem,
        request,
        baselines.shift_and_add(
            problem.y, problem.weight, problem.offset_px, problem.scale,
            combine=request.options.get("combine", "mean"),
        ),
    )  # fmt: skip


def drizzle(problem: Problem, request: Request) -> Estimate:
    """Rain shrunken LR pixels onto the HR grid."""
    options = {name: request.options[name] for name in ("pixfrac", "kernel")
               if name in request.options}  # fmt: skip
    return _estimate(
        problem,
        request,
        baselines.drizzle_frames(
            problem.y, problem.weight, problem.offset_px, problem.scale, **options
        ),
    )


def _frame(problem: Problem, request: Request) -> int:
    frame = request.options.get("frame", 0)
    if frame >= len(problem.y):
        raise ValueError(f"expected a frame from 0 to {len(problem.y) - 1}, got {frame}")
    if "frame" in request.options and request.options.get("combine", "first") != "first":
        raise ValueError(f"combine {request.options['combine']!r} takes all frames, got frame")
    return int(frame)


def _estimate(problem: Problem, request: Request, found: baselines.Baseline) -> Estimate:
    image = np.maximum(found.image, 0.0) if request.non_negative else found.image
    sigma, std = problem.noise_sigma, None
    if request.std and found.noise_gain is not None:
        if sigma is None:
            sigma = estimate_noise(
                problem.model.operator, problem.y, problem.weight, even=problem.even_noise
            ).sigma
        std = found.noise_gain * sigma
    return Estimate(image=image, uncertainty=std, status=Status.DIRECT, noise_sigma=sigma)
