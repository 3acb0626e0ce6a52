"""The linear model of a scan: robust least squares, and where all frames from one on are off."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Floats

HUBER_SIGMAS = 1.345  # keeps 95 % of the efficiency where errors are normal
_PASSES = 20  # of reweighting, at most
BUDGET_PX = 0.02  # what reconstruction allows for in any case (benchmarks/shift_budget.py)
_JUMP_CHANCE = 1e-4  # that a scan which is well is said to jump
_LEAST_AFTER = 4  # frames, and before


def robust_fit(
    design: Floats, offset_px: Floats, known_px2: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return parameters [column axis], covariance [axis column column], residual [frame axis].

    What frames share of the errors of registration leaves no residual: it counts by its
    covariance `known_px2`, and what is left beside it as errors of the stage, one by one.
    """
    weight = np.ones(len(design))
    found: Floats = np.zeros((design.shape[1], 2))
    residual: Floats = offset_px
    for _ in range(_PASSES):
        root = np.sqrt(weight)[:, None]
        found = np.linalg.pinv(root * design) @ (root * offset_px)
        residual = offset_px - design @ found
        size = np.linalg.norm(residual, axis=1)
        # Median of the length of a normal 2-vector over its standard deviation.
        scale = max(float(np.median(size)) / 1.1774, 1e-9)
        changed = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(size, 1e-12))
        if np.allclose(changed, weight, atol=1e-4):
            break
        weight = changed
    inverse = np.linalg.pinv((weight[:, None] * design).T @ design)
    solved = inverse @ (weight[:, None] * design).T
    hidden = weight[:, None] * (np.eye(len(design)) - design @ solved)
    freedom = max(weight.sum() - design.shape[1], 1.0)
    covariance = np.empty((2, *inverse.shape))
    for axis in (0, 1):
        known = known_px2[axis::2, axis::2]
        seen = float(weight @ residual[:, axis] ** 2) - float(np.sum(hidden * known))
        rest = max(seen / freedom, 0.0)
        covariance[axis] = solved @ known @ solved.T + rest * inverse
    return found, covariance, residual


def jump_in(design: Floats, offset_px: Floats) -> str:
    """Return in words after which frame all lie elsewhere than the model says, drift and all."""
    from scipy.special import fdtrc

    count = len(design)
    off = np.eye(count) - design @ np.linalg.pinv(design)
    places = np.arange(_LEAST_AFTER, count - _LEAST_AFTER + 1)
    steps = off @ (np.arange(count)[:, None] >= places)  # beside the model
    size2 = np.maximum(np.sum(steps**2, axis=0), 1e-9)[:, None]
    residual = off @ offset_px
    jump_px = steps.T @ residual / size2
    left = np.sum(residual**2, axis=0) - size2 * jump_px**2
    freedom = max(count - design.shape[1] - 1, 1)
    ratio = np.mean(size2 * jump_px**2 / np.maximum(left / freedom, 1e-18), axis=1)
    best = int(np.argmax(ratio))
    size_px, axes = np.linalg.norm(jump_px[best]), offset_px.shape[1]
    chance = len(places) * fdtrc(axes, freedom, ratio[best])
    if size_px < BUDGET_PX or chance > _JUMP_CHANCE:
        return ""
    return (
        f"the image jumped by {size_px:.3f} px after {places[best]} of {count} frames; did the "
        "stage lose steps, was bench, camera or lens touched? Scan again"
    )
