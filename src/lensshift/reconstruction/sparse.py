"""What the phasor channel takes of the classical methods, and its warning."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Estimate
from lensshift.reconstruction.classical import Tikhonov, Tv
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.outliers import frame_confidence
from lensshift.reconstruction.problem import Problem

# Beyond these a picture is not shown without a warning.
REJECTED_LIMIT, BELIEVED_LIMIT = 0.2, 0.6


def tikhonov(problem: Problem, request: Request) -> Estimate:
    """Return the estimate of `Tikhonov` with the options of the request."""
    return Tikhonov(request.prior_weight, **request.options)(problem, request)


def total_variation(problem: Problem, request: Request) -> Estimate:
    """Return the estimate of `Tv` with the options of the request."""
    return Tv(request.prior_weight, **request.options)(problem, request)


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
