"""The toolbox's outer loop: iteratively re-weighted minimisation from coarse to fine."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Estimate, Status
from lensshift.reconstruction.toolbox.data import (
    StepRecord,
    ToolboxData,
    ToolboxSettings,
    Vector,
    check_data,
)
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

OnIteration = Callable[[int, NDArray[np.float64]], None]

_TOLERANCE = 1e-3
_CV_VALUES = 20


def irwsr_toolbox(
    frames: ArrayLike,
    offset_px: ArrayLike,
    scale: int,
    psf_sigma_px: float = 0.3,
    prior_weight: float | None = None,
    window: int = 1,
    alpha: float = 0.5,
    sparsity: float = 0.5,
    seed: int = 0,
    iterations: int = 10,
    inner_iterations: int = 5,
    gain: ArrayLike | None = None,
    bias: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    on_iteration: OnIteration | None = None,
) -> Estimate:
    """Super-resolve frames as the published IRW-SR toolbox does, defects included.

        min_x  sum beta (y - gain W x - bias)^2
               + lambda sum_lm alpha^(|l|+|m|) sum a_lm |S_lm x - x|

    with the confidence beta, the prior weights a and (without `prior_weight`) lambda estimated
    anew in each of `iterations` steps of `inner_iterations` conjugate gradients, at magnifications
    1, 2, .. `scale`. Thresholds are absolute: frames should range over about 0 .. 1.

    Parameters
    ----------
    frames : [frame row col], real; NaN only where `confidence` is 0
    offset_px : [frame 2] (row, col); positive: content moved down / right
    scale, psf_sigma_px : integer upscaling factor; width of the Gaussian PSF
    prior_weight : lambda; None: by cross-validation on a split drawn from `seed`
    window, alpha, sparsity : BTV half-width P, its decay, exponent p of the prior weights
    gain, bias : [frame] or [frame row col] photometric parameters; None: 1 and 0
    confidence : [frame row col] static weight of each pixel; None: 1
    on_iteration : called with the number of the step (from 1) and the image so far

    Raises
    ------
    ValueError
        If shapes or settings make no sense, or a pixel is not finite and not excluded.

    Source: toolbox, reweightedOptimizationSR.
    """
    settings = ToolboxSettings(
        psf_sigma_px, prior_weight, window, alpha, sparsity, seed, iterations, inner_iterations
    )
    data = check_data(frames, offset_px, gain, bias, confidence)
    return run_toolbox(data, scale, settings, on_iteration)[0]


def run_toolbox(
    data: ToolboxData,
    scale: int,
    settings: ToolboxSettings,
    on_iteration: OnIteration | None = None,
) -> tuple[Estimate, tuple[StepRecord, ...]]:
    """Run the outer loop; return the estimate and the record of each step.

    Raises
    ------
    ValueError
        If `scale` is not a positive integer, or exceeds the number of steps that climb to it.
    """
    if scale != int(scale) or not 1 <= scale <= settings.iterations:
        raise ValueError(
            f"expected an integer scale from 1 to the {settings.iterations} iterations, "
            f"one for each magnification on the way, got {scale}"
        )
    rng = np.random.default_rng(settings.seed)
    state = _start(data, settings)
    records: list[StepRecord] = []
    status = Status.MAX_ITERATIONS
    for iteration in range(1, settings.iterations + 1):
        if iteration <= scale:
            state = _enter_level(state, iteration, data, settings)
        before = state.x
        state, record = _step(state, iteration, data, settings, rng)
        records.append(record)
        if on_iteration is not None:
            on_iteration(iteration, state.x.reshape(state.shape).copy())
        if not np.isfinite(state.x).all():
            status = Status.NOT_FINITE
            break
        if iteration > scale and np.abs(before - state.x).max() < _TOLERANCE:
            status = Status.CONVERGED
            break
    return _estimate(state, records, status, data), tuple(records)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """What the toolbox carries from one majorisation step to the next.

    Parameters
    ----------
    x, shape : the estimate as a vector, and its (rows, cols)
    forward, adjoint : W and its transpose at the current magnification
    confidence : one entry per LR pixel of all frames
    sparsity_weights : [direction row col] flattened
    prior_weight : lambda, None before it has been chosen
    cv_values : how many values the next cross-validation tries; 1: lambda is frozen
    """

    x: Vector
    shape: tuple[int, int]
    forward: sparse.csr_array
    adjoint: sparse.csr_array
    confidence: Vector
    sparsity_weights: Vector
    prior_weight: float | None
    cv_values: int


def _start(data: ToolboxData, settings: ToolboxSettings) -> _State:
    """Return the temporal median with uniform weights; the system follows with its level."""
    image = temporal_median(data.frames, data.usable, data.offset_px)
    empty = sparse.csr_array((0, 0))
    return _State(
        x=image.ravel(),
        shape=data.frame_shape,
        forward=empty,
        adjoint=empty,
        confidence=data.confidence.ravel(),
        sparsity_weights=np.ones(1),  # stretched to its level
        prior_weight=settings.prior_weight,
        cv_values=_CV_VALUES if settings.prior_weight is None else 1,
    )


def _enter_level(state: _State, level: int, data: ToolboxData, settings: ToolboxSettings) -> _State:
    """Go to magnification `level`: new system matrices, resized estimate and prior weights."""
    rows, cols = data.frame_shape
    shape = (rows * level, cols * level)
    forward, adjoint = stacked_system(
        data.frame_shape, level, data.offset_px, settings.psf_sigma_px
    )
    directions = (2 * settings.window + 1) ** 2 - 1
    return replace(
        state,
        x=resize_bicubic(state.x.reshape(state.shape), shape).ravel(),
        shape=shape,
        forward=forward,
        adjoint=adjoint,
        # The toolbox stretches the stacked vector as a whole, across pixels and directions.
        sparsity_weights=resize_axis(
            state.sparsity_weights, directions * shape[0] * shape[1], axis=0
        ),
    )


def _step(
    state: _State,
    iteration: int,
    data: ToolboxData,
    settings: ToolboxSettings,
    rng: np.random.Generator,
) -> tuple[_State, StepRecord]:
    """Re-weight, choose lambda, and improve the estimate."""
    problem, noise_sigma, prior_sigma = _reweighted(state, data, settings)
    start, cv_values = state.x, state.cv_values
    if cv_values > 1:
        prior_weight, start = cross_validate(
            problem,
            state.x,
            search_weights(state.prior_weight, iteration, cv_values),
            training_pixels(problem.y.size, rng),
            settings.inner_iterations,
        )
        problem = replace(problem, prior_weight=prior_weight)
        # MATLAB rounds 2.5 up to 3, Python's round would give 2.
        cv_values = max(int(0.5 * cv_values + 0.5), 1)
    x, objective = problem.solve(start, settings.inner_iterations)
    moved_on = replace(
        state,
        x=x,
        confidence=problem.confidence,
        sparsity_weights=problem.prior.weights.ravel(),
        prior_weight=problem.prior_weight,
        cv_values=cv_values,
    )
    record = StepRecord(problem.prior_weight, noise_sigma, prior_sigma, objective)
    return moved_on, record


def _reweighted(
    state: _State, data: ToolboxData, settings: ToolboxSettings
) -> tuple[MajorisedProblem, float, float]:
    """Return the problem with weights from the current estimate, sigma_n and sigma_p."""
    transformed = sparse_transform(state.x.reshape(state.shape), settings.window, settings.alpha)
    weights, prior_sigma = prior_weights(
        transformed.ravel(), state.sparsity_weights, settings.sparsity
    )
    problem = MajorisedProblem(
        y=data.frames.ravel(),
        gain=data.gain,
        bias=data.bias,
        forward=state.forward,
        adjoint=state.adjoint,
        confidence=state.confidence,
        prior=WeightedBtv(
            state.shape, settings.window, settings.alpha, weights.reshape(transformed.shape)
        ),
        prior_weight=0.0 if state.prior_weight is None else state.prior_weight,
    )
    count = len(data.frames)
    dynamic, noise_sigma = observation_confidence(
        problem.residual(state.x).reshape(count, -1),
        state.confidence.reshape(count, -1),
        data.usable.reshape(count, -1),
    )
    confidence = data.confidence.ravel() * dynamic.ravel()
    return replace(problem, confidence=confidence), noise_sigma, prior_sigma


def _estimate(
    state: _State, records: list[StepRecord], status: Status, data: ToolboxData
) -> Estimate:
    """Wrap the final state; warn where the bias test has thrown every frame away."""
    if not state.confidence.any():
        warnings.warn(
            f"the toolbox rejects all {len(data.frames)} frames: their median residuals exceed "
            f"{BIAS_THRESHOLD}; it expects frames that range over about 0 to 1",
            QualityWarning,
            stacklevel=4,
        )
    return Estimate(
        image=state.x.reshape(state.shape),
        objective=tuple(record.objective for record in records),
        status=status,
        confidence=state.confidence.reshape(data.frames.shape),
        prior_weight=records[-1].prior_weight,
        noise_sigma=records[-1].noise_sigma,
    )
