"""Sparse neighbour differences with a weight that needs no tuning: the solver behind `auto`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Estimate, Status
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.differences import differences
from lensshift.reconstruction.least_squares import (
    NEIGHBOURS,
    mean_column_square,
    smooth_fit,
    solve_penalised,
)
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.options import check_settings
from lensshift.reconstruction.outliers import confidence
from lensshift.reconstruction.selection import prior_share

Array = NDArray[Any]
OnIteration = Callable[[int, float], None]

# Diagonal neighbours are farther away: their differences count 1 / length.
SHARE = (1.0 / np.sqrt((NEIGHBOURS**2).sum(axis=1))).reshape(-1, 1, 1)
# An outlier at first sight counts again once the picture comes so near to it: finest detail does,
# salt and pepper do not (photographs of 256 px, and 8 scenes with 2 and 5 % of salt and pepper).
READMITTED_SIGMAS = 10.0
# How clumped the gradient of a picture is where lone edges end and texture begins.
LONE_EDGES, TEXTURE = 0.262, 0.288
CLUMP_WINDOW_HR_PX = 17
# In a scene of lone edges the model errs at the edges, by this much of the local gradient,
# because an HR pixel cannot say where inside it the edge lies.
EDGE_ERROR_PX, CAUTIOUS_EDGE_ERROR_PX = 0.065, 0.03
EXTRA_WEIGHT_LONE_EDGES = 0.3
GROUPING = 0.6
# Around which the scale of the prior is found, and how much above its mean the weight may be.
LOCAL_WINDOW_HR_PX, MOST_LOCAL_WEIGHT = 49, 10.0
# A replicate starts from the estimate, softened this much so that its edges can move a little.
REPLICATE_STEPS, REPLICATE_SMOOTHING_SIGMAS = 3, 1.5
START_SMOOTHING, RESTART_SMOOTHING, SMOOTHING_DECAY = 0.1, 0.05, 0.75


@dataclass(frozen=True, slots=True)
class SparseGradient:
    """Robust fit with a sparse penalty on neighbour differences whose weight sets itself.

        F(x) = sum w |A x - y|^2 + lambda sum_d share_d (|D_d x|^2 + eps^2)^(p / 2)

    minimised by iterative reweighting, each step a few conjugate gradients; eps shrinks from
    step to step (graduated non-convexity). Without `prior_weight` the weight is the one that the
    maximum a posteriori estimate gives to the scale of a generalised Gaussian prior, found again
    in every step,

        lambda = 2 c sigma^2 N / (p sum_d share_d |D_d x|^p),   c = prior_share(blur_hr_px)

    where c < 1 allows for what the blur hides of the differences. With `adapt` the picture of
    the first steps is asked whether its edges stand alone or make a texture,

        clumping = mean of (E|g|)^2 / E|g|^2 in windows, weighted by |g|^2

    Lone edges get a slightly heavier prior, and data that weigh less right at the edges;
    texture gets differences that are grouped with those of their neighbours. Where the noise is
    even, lambda goes with the scale of the prior around each pixel: a small bright object before
    a large calm background has other differences than the average pixel, and would be wiped out.
    Uneven noise (distances of dark surfaces) would be taken for such an object.

    Parameters
    ----------
    exponent : p; 2 is Tikhonov, 1 total variation
    texture_exponent : p for scenes of texture, once `adapt` has found them
    prior_weight : lambda (that at differences of average size, if it is uneven), or None
    noise_sigma : noise of an LR pixel (per component if complex), or None to estimate it
    blur_hr_px : width of the pixel response in HR pixels
    shift_error_hr_px : [frame] standard deviation of the shifts in HR pixels, if uncertain;
        an LR pixel is believed less the steeper the picture is there
    robust : whether outliers and frames that do not fit lose weight
    adapt : whether to look at the kind of scene
    even_noise : whether all pixels have about the same noise
    iterations, inner_iterations : reweightings, and conjugate gradients in each
    first_steps : reweightings before the scene is judged
    tolerance : stop when no pixel moves by more than this
    non_negative : whether negative values are set to zero after each step

    Images should lie within about 0 .. 1.
    """

    exponent: float = 0.9
    texture_exponent: float = 0.6
    prior_weight: float | None = None
    noise_sigma: float | None = None
    blur_hr_px: float = 0.6
    shift_error_hr_px: Array | float = 0.0
    robust: bool = True
    adapt: bool = True
    even_noise: bool = True
    iterations: int = 16
    inner_iterations: int = 10
    first_steps: int = 6
    tolerance: float = 2e-4
    non_negative: bool = False

    def __post_init__(self) -> None:
        check_settings(self)

    def __call__(
        self,
        A: LinearOperator,
        y: Array,
        weight: Array,
        x0: Array | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Estimate:
        """Return the estimate [row col] from frames and their weights [frame row col]."""
        noise_sigma, sigma, inlier = self._noise(A, y, weight)
        state = _State(weight * inlier, lone_edges=0.0, inlier=inlier, noise_sigma=noise_sigma)
        state.x = smooth_fit(A, y, state.weight, 0.03, 30) if x0 is None else x0.copy()
        square = mean_column_square(A)
        status = Status.MAX_ITERATIONS
        for t in range(self.iterations):
            if t == self.first_steps and self.adapt:
                state.judge_scene()
            before = state.x
            coefficients = self._coefficients(state, sigma)
            if t > 0 and self.robust:
                state.weight = self._confidence(A, y, weight, sigma, state)
            state.x = solve_penalised(
                A, y, state.weight, coefficients, before, self.inner_iterations,
                column_square=square,
            )  # fmt: skip
            if self.non_negative:
                state.x = np.maximum(state.x, 0.0)
            state.note_objective(A, y)
            if on_iteration is not None:
                on_iteration(t + 1, state.objective[-1])
            if not np.isfinite(state.objective[-1]):
                status = Status.NOT_FINITE
                break
            settled = t >= self.first_steps + 3 or not self.adapt
            if settled and np.max(np.abs(state.x - before)) < self.tolerance:
                status = Status.CONVERGED
                break
        return state.estimate(status, noise_sigma, self)

    @property
    def _lone_outliers(self) -> bool:
        """Whether an outlier has to stand out among its neighbours: edges do not then."""
        return self.adapt and self.even_noise

    def _noise(self, A: LinearOperator, y: Array, weight: Array) -> tuple[float, float, Array]:
        """Return the noise, what to weigh with, and the pixels that are no outliers at first."""
        if self.noise_sigma is not None and not self.robust:
            return self.noise_sigma, self.noise_sigma, weight > 0
        noise = estimate_noise(
            A, y, weight, even=self.even_noise, lone_outliers=self._lone_outliers
        )
        if not self.robust:
            return max(noise.sigma, 1e-6), max(noise.total, 1e-6), weight > 0
        sigma = max(self.noise_sigma or noise.sigma, 1e-6)
        return sigma, max(self.noise_sigma or noise.effective, 1e-6), noise.inlier

    def _coefficients(self, state: _State, sigma: float) -> Array:
        """Return the quadratic that touches the penalty from above at x; updates lambda."""
        p = self.exponent
        if self.adapt and state.judged:
            p += (1.0 - state.lone_edges) * (self.texture_exponent - self.exponent)
        steps = np.empty((len(NEIGHBOURS), *state.x.shape), state.x.dtype)
        differences(state.x, NEIGHBOURS, steps)
        square = (steps * steps.conj()).real
        state.square = square
        state.smoothing = max(0.2 * sigma, state.smoothing * SMOOTHING_DECAY)
        eps2 = state.smoothing**2
        touched = (square + eps2) ** (p / 2)
        total = np.sum(SHARE * touched, axis=0)
        rest = SHARE.sum() * (eps2 ** (p / 2) - (0.3 * sigma) ** p)
        energy = float(total.mean()) - rest
        local: Array | float = 1.0
        if self.adapt and self.even_noise:
            local = local_weight(total - rest, energy)
        if self.prior_weight is None:
            share = prior_share(self.blur_hr_px) + EXTRA_WEIGHT_LONE_EDGES * state.lone_edges
            found = 2.0 * share * sigma**2 / (p * energy)
            state.prior_weight = float(
                found if state.prior_weight is None else np.sqrt(found * state.prior_weight)
            )
        else:
            state.prior_weight = self.prior_weight
        state.penalty = state.prior_weight * float(np.sum(local * total))
        grouping = GROUPING * (1.0 - state.lone_edges) if self.adapt and state.judged else 0.0
        if grouping > 0.0:
            square = _grouped(square, grouping)
            slope = (square + eps2) ** (p / 2 - 1.0)
        else:
            slope = touched / (square + eps2)
        a = 0.5 * state.prior_weight * p * SHARE * local * slope
        return np.asarray(a)

    def _confidence(
        self, A: LinearOperator, y: Array, weight: Array, sigma: float, state: _State
    ) -> Array:
        """Return the weight of each LR pixel: outliers, odd frames and edges count less.

        What stood out alone at first sight stays out until the picture agrees with it: where
        hardly another pixel says what belongs there, the least weight would draw the picture to it.
        """
        across, down, *diagonals = state.square
        gradient = 0.5 * (across + down + 0.5 * sum(diagonals))
        edge_error_px = EDGE_ERROR_PX * state.lone_edges if state.judged else CAUTIOUS_EDGE_ERROR_PX
        if not self.adapt:
            edge_error_px = 0.0
        error2 = edge_error_px**2 + np.reshape(self.shift_error_hr_px, (-1, 1, 1)) ** 2
        scale = np.sqrt(sigma**2 + error2 * np.maximum(A.forward(gradient), 0.0))
        residual = y - A.forward(state.x)
        trust = confidence(residual, weight, scale)
        if self._lone_outliers:
            noise = np.sqrt(scale**2 - sigma**2 + state.noise_sigma**2)
            trust *= state.inlier | (np.abs(residual) <= READMITTED_SIGMAS * noise)
        state.trust = float(np.mean(trust[weight > 0]))
        return np.asarray(weight * trust * (sigma / scale) ** 2)

    def replicate(self, A: LinearOperator, y: Array, estimate: Estimate) -> Array:
        """Answer other noise on the frames, from the estimate on, with its weights and lambda."""
        if estimate.confidence is None or estimate.noise_sigma is None:
            raise ValueError("expected an estimate that this solver made")
        state = _State(
            weight=estimate.confidence,
            lone_edges=estimate.notes.get("lone_edges", 0.0),
            judged=self.adapt,
            smoothing=REPLICATE_SMOOTHING_SIGMAS * estimate.noise_sigma,
        )
        state.x = estimate.image
        fixed = replace(self, prior_weight=estimate.prior_weight)
        steps = 1 if self.exponent == 2.0 else REPLICATE_STEPS
        for _ in range(steps):
            coefficients = fixed._coefficients(state, estimate.noise_sigma)
            state.x = solve_penalised(
                A, y, state.weight, coefficients, state.x, 3 * self.inner_iterations // steps + 2
            )
        return state.x


@dataclass(slots=True)
class _State:
    weight: Array
    lone_edges: float
    inlier: Array | bool = True
    noise_sigma: float = 0.0
    judged: bool = False
    smoothing: float = START_SMOOTHING
    prior_weight: float | None = None
    penalty: float = 0.0
    clumping: float | None = None
    trust: float = 1.0
    objective: list[float] = field(default_factory=list)
    x: Array = field(default_factory=lambda: np.zeros((1, 1)))
    square: Array = field(default_factory=lambda: np.zeros((1, 1, 1)))

    def judge_scene(self) -> None:
        """Decide from the picture so far whether its edges stand alone."""
        self.clumping = clumping(self.square)
        share = (TEXTURE - self.clumping) / (TEXTURE - LONE_EDGES)
        self.lone_edges = float(np.clip(share, 0.0, 1.0))
        self.judged = True
        self.smoothing = RESTART_SMOOTHING

    def note_objective(self, A: LinearOperator, y: Array) -> None:
        residual = y - A.forward(self.x)
        misfit = float(np.sum(self.weight * (residual * residual.conj()).real))
        self.objective.append(misfit + self.penalty)

    def estimate(self, status: Status, sigma: float, solver: SparseGradient) -> Estimate:
        notes = {
            "exponent": solver.exponent,
            "iterations": len(self.objective),
            "trust": self.trust,
        }
        if self.clumping is not None:
            notes |= {"clumping": self.clumping, "lone_edges": self.lone_edges}
        return Estimate(
            image=self.x,
            objective=tuple(self.objective),
            status=status,
            confidence=np.clip(self.weight, 0.0, 1.0),
            prior_weight=self.prior_weight,
            noise_sigma=sigma,
            notes=notes,
        )


def clumping(square: Array) -> float:
    """Return how much the gradient fills its surroundings: 0 for lone edges, 1 for even texture.

    Parameters
    ----------
    square : [direction row col] squared differences, the first two across and down
    """
    from scipy.ndimage import uniform_filter

    energy = square[0] + square[1]
    mean = uniform_filter(np.sqrt(energy), CLUMP_WINDOW_HR_PX)
    power = uniform_filter(energy, CLUMP_WINDOW_HR_PX)
    total = float(energy.sum())
    if total <= 0.0:
        return 0.0
    return float((energy * mean**2 / np.maximum(power, 1e-300)).sum() / total)


def local_weight(energy: Array, mean: float) -> Array:
    """Return mean / (energy around each pixel) [row col], not above `MOST_LOCAL_WEIGHT`."""
    from scipy.ndimage import uniform_filter

    around = uniform_filter(energy, LOCAL_WINDOW_HR_PX)
    return np.asarray(mean / np.maximum(around, mean / MOST_LOCAL_WEIGHT))


def _grouped(square: Array, share: float) -> Array:
    """Mix each squared difference with the mean of its 3 x 3 neighbours."""
    from scipy.ndimage import uniform_filter

    mixed: Array = (1.0 - share) * square + share * uniform_filter(square, size=(0, 3, 3))
    return mixed
