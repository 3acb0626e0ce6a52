"""Shifts made better through the forward model: picture and shifts together."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst
from lensshift.forward.blur import Blur
from lensshift.forward.differences import differences
from lensshift.forward.least_squares import NEIGHBOURS, smooth_fit, solve_penalised
from lensshift.forward.model import forward_model
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.problem import Problem, make_blur, make_problem

Array = NDArray[Any]
Shifts = NDArray[np.float64]

CONVERGED_PX = 1e-3
MAX_STEP_PX = 0.1
# How far shifts may be off if the burst does not say.
UNKNOWN_SIGMA_PX = 0.1
_STEP_PX = 1e-3
_START_STIFFNESS = 0.03
# Of the maximum-a-posteriori scale of a Laplace prior; edges smaller than this are rounded.
_PRIOR_SHARE, _LEAST_EDGE = 1.4, 0.01
_SOLVE_ITERATIONS = 40
# No scene is as total variation has it: real errors are so much larger than the curvature says
# (boxes, charts and stars at SNR 50, `benchmarks/registration.py`).
_OVERCONFIDENCE = 3.5


def refine_shifts(
    burst: Burst,
    scale: int = 2,
    psf_sigma_px: float | None = None,
    *,
    fill_factor: float | None = None,
    noise_sigma: float | None = None,
    max_rounds: int = 12,
) -> Burst:
    """Return the burst with offsets that fit the frames better through the forward model.

        minimise over x and d   |y - A(d) x|^2 / sigma^2 + prior(x) + sum ((d - d0) / s)^2

    Gauss-Newton on the shifts with the picture eliminated (variable projection, after Kaufman):
    a change of a shift counts only as far as no other picture explains it. The prior of the
    picture is total variation with the weight that its own size and the noise set; that of the
    shifts is `offset_sigma_px`. The mean of the shifts stays, as only their differences show.

    Parameters
    ----------
    burst : with offsets right to about 0.3 px; see `lensshift.register` for worse ones
    scale, psf_sigma_px, fill_factor, noise_sigma : as in `reconstruct`
    max_rounds : of picture and shifts

    Raises
    ------
    ValueError
        If the burst has a single frame, or as in `reconstruct`.

    Warns
    -----
    QualityWarning
        If the shifts still move by more than 0.01 px at the end.

    Source: Kaufman, BIT 15 (1975) 49.
    """
    if burst.frame_count < 2:
        raise ValueError(f"expected at least 2 frames, got {burst.frame_count}")
    blur = make_blur(psf_sigma_px, fill_factor)
    given_px = burst.offset_px
    told_px = burst.offset_sigma_px
    if told_px is None or not np.any(told_px > 0):
        told_px = np.full(given_px.shape, UNKNOWN_SIGMA_PX)
    trust = 1.0 / np.maximum(told_px.ravel(), 1e-4) ** 2
    offset_px = given_px.copy()
    image: Array | None = None
    sigma = 0.0
    largest_px = np.inf
    information = np.diag(trust)
    for _ in range(max_rounds):
        moved = replace(burst, offset_px=offset_px)
        problem = make_problem(
            moved, burst.amplitude, scale, blur=blur, shift_field=None, noise_sigma=noise_sigma,
            take_level=True,
        )  # fmt: skip
        sigma = _noise(problem)
        image, prior = _picture(problem, image, sigma)
        score, information = _normal(problem, image, prior, blur, sigma)
        information = information + np.diag(trust)
        score -= trust * (offset_px - given_px).ravel()
        step_px = np.linalg.solve(information, score).reshape(-1, 2)
        step_px -= step_px.mean(axis=0)
        largest_px = float(np.abs(step_px).max())
        offset_px = offset_px + step_px * min(1.0, MAX_STEP_PX / max(largest_px, 1e-300))
        if largest_px < CONVERGED_PX:
            break
    if largest_px > 10 * CONVERGED_PX:
        warnings.warn(
            f"the shifts still move by {largest_px:.3f} px after {max_rounds} rounds; "
            "raise max_rounds, or correct psf_sigma_px",
            QualityWarning,
            stacklevel=2,
        )
    return replace(
        burst,
        offset_px=offset_px,
        offset_sigma_px=_sigma_px(information, burst.frame_count),
        offset_source="registered",
    )


def _noise(problem: Problem) -> float:
    if problem.noise_sigma is not None:
        return problem.noise_sigma
    noise = estimate_noise(problem.model.operator, problem.y, problem.weight)
    return max(noise.effective, 1e-6)


def _picture(problem: Problem, start: Array | None, sigma: float) -> tuple[Array, Array]:
    """Return the picture that fits these shifts, and the coefficients of its quadratic prior."""
    A, y, weight = problem.model.operator, problem.y, problem.weight
    image = smooth_fit(A, y, weight, _START_STIFFNESS) if start is None else start
    prior = np.empty(0)
    for _ in range(4 if start is None else 2):
        size = np.abs(differences(image, NEIGHBOURS))
        total = float(size.sum())
        level = _PRIOR_SHARE * 2.0 * sigma**2 * size.size / max(total, 1e-12)
        prior = 0.5 * level / np.maximum(size, _LEAST_EDGE)
        image = solve_penalised(A, y, weight, prior, image, _SOLVE_ITERATIONS)
    return image, prior


def _normal(
    problem: Problem, image: Array, prior: Array, blur: Blur, sigma: float
) -> tuple[Array, NDArray[np.float64]]:
    """Return gradient and curvature of the log likelihood by the shifts, picture eliminated."""
    A, weight = problem.model.operator, problem.weight
    slopes = _slopes(problem, image, blur)
    rest = weight * (problem.y - A.forward(image))
    count = len(problem.y)
    score = np.array([np.vdot(slopes[i, k], rest[k]).real for k in range(count) for i in (0, 1)])
    seen = np.empty((2 * count, *problem.y.shape), problem.y.dtype)
    blank = np.zeros_like(image)
    for column in range(2 * count):
        k, axis = divmod(column, 2)
        only = np.zeros_like(problem.y)
        only[k] = slopes[axis, k]
        # What of this change another picture would explain.
        explained = solve_penalised(A, only, weight, prior, blank, _SOLVE_ITERATIONS)
        seen[column] = only - A.forward(explained)
    curvature = np.empty((2 * count, 2 * count))
    for column in range(2 * count):
        k, axis = divmod(column, 2)
        moved = weight[k] * np.conj(slopes[axis, k])
        curvature[column] = np.tensordot(seen[:, k], moved, axes=((1, 2), (0, 1))).real
    curvature = 0.5 * (curvature + curvature.T)
    return score / sigma**2, curvature / sigma**2


def _slopes(problem: Problem, image: Array, blur: Blur) -> Array:
    """Return how each frame changes per pixel of its shift, [axis frame row col]."""
    slopes = []
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = _STEP_PX
        ahead, behind = (
            forward_model(
                problem.model.lr_shape, problem.scale, problem.offset_px + sign * step, blur=blur
            ).operator.forward(image)
            for sign in (1.0, -1.0)
        )
        slopes.append((ahead - behind) / (2.0 * _STEP_PX))
    return np.stack(slopes)


def _sigma_px(information: NDArray[np.float64], count: int) -> Shifts:
    """Return the standard errors [frame 2] of shifts about their mean."""
    about = np.eye(2 * count) - np.kron(np.full((count, count), 1.0 / count), np.eye(2))
    covariance = about @ np.linalg.inv(information) @ about
    return _OVERCONFIDENCE * np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 2)
