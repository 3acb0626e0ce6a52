"""The toolbox's outer loop: iteratively re-weighted minimisation from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from lensshift.core.arrays import Floats
from lensshift.core.types import Estimate, Status
from lensshift.reconstruction.toolbox.objective import (
    MajorisedProblem,
    cross_validate,
    search_weights,
    training_pixels,
)
from lensshift.reconstruction.toolbox.prior import WeightedBtv, sparse_transform
from lensshift.reconstruction.toolbox.resize import resize_axis, resize_bicubic, temporal_median
from lensshift.reconstruction.toolbox.system_matrix import stacked_system
from lensshift.reconstruction.toolbox.weights import (
    BIAS_THRESHOLD,
    observation_confidence,
    prior_weights,
)

OnIteration = Callable[[int, Floats], None]

_TOLERANCE = 1e-3
_CV_VALUES = 20


@dataclass(frozen=True, slots=True)
class StepRecord:
    """What one majorisation step found.

    Parameters
    ----------
    prior_weight : lambda
    noise_sigma, prior_sigma : scales of the residual and of the sparse transform
    objective : after the step
    """

    prior_weight: float
    noise_sigma: float
    prior_sigma: float
    objective: float


def irwsr_toolbox(
    frames: Floats,
    offset_px: Floats,
    scale: int,
    psf_sigma_px: float = 0.3,
    *,
    confidence: Floats | None = None,
    prior_weight: float | None = None,
    window: int = 1,
    alpha: float = 0.5,
    sparsity: float = 0.5,
    seed: int = 0,
    iterations: int = 10,
    inner_iterations: int = 5,
    on_iteration: OnIteration | None = None,
) -> tuple[Estimate, tuple[StepRecord, ...]]:
    """Super-resolve frames as the published IRW-SR toolbox does, defects included.

        min_x  sum beta (y - W x)^2 + lambda sum_lm alpha^(|l|+|m|) sum a_lm |S_lm x - x|

    with the confidence beta, the prior weights a and (without `prior_weight`) lambda estimated
    anew in each of `iterations` steps of `inner_iterations` conjugate gradients, at magnifications
    1, 2, .. `scale`. Thresholds are absolute: frames should range over about 0 .. 1.

    Parameters
    ----------
    frames : [frame row col]
    offset_px : [frame 2] (row, col); positive: content moved down / right
    scale, psf_sigma_px : integer upscaling factor; width of the Gaussian PSF
    confidence : [frame row col] static weight of each pixel; None: 1
    prior_weight : lambda; None: by cross-validation on a split drawn from `seed`
    window, alpha, sparsity : BTV half-width P, its decay, exponent p of the prior weights
    on_iteration : called with the number of the step (from 1) and the image so far

    Raises
    ------
    ValueError
        If `scale` exceeds the number of steps that climb to it.

    Source: toolbox, reweightedOptimizationSR.
    """
    if scale > iterations:
        raise ValueError(
            f"expected an integer scale from 1 to the {iterations} iterations, "
            f"one for each magnification on the way, got {scale}"
        )
    static = np.ones(frames.shape) if confidence is None else confidence
    rng = np.random.default_rng(seed)
    image = temporal_median(frames, offset_px)
    directions = (2 * window + 1) ** 2 - 1
    state = _State(
        image.ravel(), image.shape, static.ravel(), np.ones(directions * image.size), prior_weight,
        _CV_VALUES if prior_weight is None else 1,
        stacked_system(image.shape, 1, offset_px, psf_sigma_px),
    )  # fmt: skip
    records: list[StepRecord] = []
    status = Status.MAX_ITERATIONS
    for iteration in range(1, iterations + 1):
        if 1 < iteration <= scale:
            state.enlarge(tuple(n * iteration for n in image.shape), directions)
            state.system = stacked_system(image.shape, iteration, offset_px, psf_sigma_px)
        before = state.x
        problem, noise, prior = _reweighted(state, frames, static, window, alpha, sparsity)
        objective = state.improve(problem, iteration, inner_iterations, rng)
        records.append(StepRecord(state.prior_weight or 0.0, noise, prior, objective))
        if on_iteration is not None:
            on_iteration(iteration, state.x.reshape(state.shape).copy())
        if not np.isfinite(state.x).all():
            status = Status.NOT_FINITE
            break
        if iteration > scale and np.abs(before - state.x).max() < _TOLERANCE:
            status = Status.CONVERGED
            break
    return _estimate(state, records, status, frames.shape), tuple(records)


@dataclass(slots=True, eq=False)
class _State:
    """What the toolbox carries from one majorisation step to the next.

    Parameters
    ----------
    x, shape : the estimate as a vector, and its (rows, cols)
    confidence : one entry per LR pixel of all frames
    sparsity_weights : [direction row col] flattened
    prior_weight : lambda, None before it has been chosen
    cv_values : how many values the next cross-validation tries; 1: lambda is frozen
    system : W at the current magnification, and its transpose
    """

    x: Floats
    shape: tuple[int, ...]
    confidence: Floats
    sparsity_weights: Floats
    prior_weight: float | None
    cv_values: int
    system: tuple[sparse.csr_array, sparse.csr_array]

    def enlarge(self, shape: tuple[int, ...], directions: int) -> None:
        """Resize the estimate and the weights of the prior."""
        self.x = resize_bicubic(self.x.reshape(self.shape), shape).ravel()
        self.shape = shape
        # The toolbox stretches the stacked vector as a whole, across pixels and directions.
        self.sparsity_weights = resize_axis(self.sparsity_weights, directions * self.x.size, 0)

    def improve(
        self,
        problem: MajorisedProblem,
        iteration: int,
        inner_iterations: int,
        rng: np.random.Generator,
    ) -> float:
        """Choose lambda and improve the estimate; return the objective there."""
        start = self.x
        if self.cv_values > 1:
            weights = search_weights(self.prior_weight, iteration, self.cv_values)
            training = training_pixels(problem.y.size, rng)
            chosen, start = cross_validate(problem, start, weights, training, inner_iterations)
            problem = replace(problem, prior_weight=chosen)
            # MATLAB rounds 2.5 up to 3, Python's round would give 2.
            self.cv_values = max(int(0.5 * self.cv_values + 0.5), 1)
        self.x, objective = problem.solve(start, inner_iterations)
        self.confidence, self.prior_weight = problem.confidence, problem.prior_weight
        self.sparsity_weights = problem.prior.weights.ravel()
        return objective


def _reweighted(
    state: _State, frames: Floats, static: Floats, window: int, alpha: float, sparsity: float
) -> tuple[MajorisedProblem, float, float]:
    """Return the problem with weights from the current estimate, sigma_n and sigma_p."""
    transformed = sparse_transform(state.x.reshape(state.shape), window, alpha)
    weights, prior_sigma = prior_weights(transformed.ravel(), state.sparsity_weights, sparsity)
    prior = WeightedBtv(state.shape, window, alpha, weights.reshape(transformed.shape))
    problem = MajorisedProblem(
        frames.ravel(), *state.system, state.confidence, prior, state.prior_weight or 0.0
    )
    by_frame = (len(frames), -1)
    dynamic, noise_sigma = observation_confidence(
        problem.residual(state.x).reshape(by_frame), state.confidence.reshape(by_frame)
    )
    confidence = static.ravel() * dynamic.ravel()
    return replace(problem, confidence=confidence), noise_sigma, prior_sigma


def _estimate(
    state: _State, records: list[StepRecord], status: Status, shape: tuple[int, ...]
) -> Estimate:
    """Wrap the final state; its notes tell where the bias test has thrown every frame away."""
    notes = {} if state.confidence.any() else {
        "all_rejected": f"the toolbox rejects all {shape[0]} frames: their median residuals "
        f"exceed {BIAS_THRESHOLD}; it expects frames that range over about 0 to 1"
    }  # fmt: skip
    return Estimate(
        image=state.x.reshape(state.shape),
        objective=tuple(record.objective for record in records),
        status=status,
        confidence=state.confidence.reshape(shape),
        prior_weight=records[-1].prior_weight,
        noise_sigma=records[-1].noise_sigma,
        notes=notes,
    )
