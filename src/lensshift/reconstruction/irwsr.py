"""Iteratively reweighted super-resolution: the published idea, corrected and compiled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Estimate, Status
from lensshift.forward.model import ForwardModel
from lensshift.reconstruction import irwsr_kernels as kernels
from lensshift.reconstruction.differences import (
    Directions,
    add_weighted_laplacian,
    differences,
    half_plane,
)
from lensshift.reconstruction.irwsr_systems import System, fastest_system, start_image
from lensshift.reconstruction.options import check_settings

Array = NDArray[Any]
Single = NDArray[np.float32]
OnIteration = Callable[[int, float], None]


@dataclass(frozen=True, slots=True)
class Irwsr:
    """Reweighted minimisation with Huber confidences and weighted bilateral total variation.

        F(x) = sum w beta |A x + bias - y|^2
               + lambda sum_lm alpha^(|l| + |m|) b_lm sqrt(|S_lm x - x|^2 + mu^2)

    beta is the confidence of an LR pixel, min(1, 2 sigma / |r|), and 0 for frames whose median
    residual exceeds `bias_threshold`; b is 1 for small differences and falls as |z|^(p - 1) for
    large ones. Both are found anew in each of the `iterations`, in which the square root is
    replaced by the quadratic that touches it from above and the sum is minimised by
    `inner_iterations` conjugate gradients.

    Against the published toolbox: one objective and its true gradient, weights b that do not
    jump where |z| passes their threshold, a start at the final scale, any shifts, shift fields.

    Parameters
    ----------
    prior_weight : lambda, for frames in 0 .. 1
    window, alpha : reach of the differences in HR pixels, and their decay, in (0, 1]
    sparsity : exponent p of the prior weights, in (0, 1]; 1 is plain bilateral total variation
    iterations, inner_iterations : reweightings, and conjugate gradients in each
    bias_threshold : median residual beyond which a whole frame is left out
    tolerance : stop when no pixel moves by more than this
    smoothing : mu

    Raises
    ------
    ValueError
        If a setting is out of its range.

    Source: Koehler et al. 2016, doi 10.1109/TCI.2016.2516909; toolbox of 2017.
    """

    prior_weight: float
    window: int = 1
    alpha: float = 0.5
    sparsity: float = 0.5
    iterations: int = 10
    inner_iterations: int = 5
    bias_threshold: float = 0.02
    tolerance: float = 1e-3
    smoothing: float = 1e-2

    def __post_init__(self) -> None:
        check_settings(self)

    def __call__(
        self,
        model: ForwardModel,
        y: Array,
        weight: Array,
        x0: Array | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Estimate:
        """Return the estimate [row col] from frames and their weights [frame row col].

        Parameters
        ----------
        model : forward model of the frames
        y, weight : [frame row col], frames in 0 .. 1 and static weights, 0 for unusable pixels
        x0 : [row col] start, or None
        on_iteration : called with the number of the iteration and the objective

        Raises
        ------
        ValueError
            If the frames are complex, or an array has the wrong shape.
        """
        seen = _checked(model, y, weight)
        system = fastest_system(model)
        static = np.ascontiguousarray(weight, dtype=np.float32)
        if x0 is None:
            x = start_image(system, seen, static, model.hr_shape)
        else:
            x = np.array(x0, dtype=np.float32, order="C")
        state = _State(system, seen, static, x, half_plane(self.window), self.alpha)
        objective: list[float] = []
        status = Status.MAX_ITERATIONS
        for t in range(self.iterations):
            before = state.x.copy()
            objective.append(state.iterate(self))
            if on_iteration is not None:
                on_iteration(t + 1, objective[-1])
            if not np.isfinite(objective[-1]):
                status = Status.NOT_FINITE
                break
            if kernels.largest_change(before, state.x) < self.tolerance:
                status = Status.CONVERGED
                break
        return Estimate(
            image=state.x.astype(np.float64),
            objective=tuple(objective),
            status=status,
            confidence=np.clip(state.confidence, 0.0, 1.0).astype(np.float64),
            prior_weight=self.prior_weight,
            noise_sigma=state.sigma,
        )


class _State:
    """What goes from one reweighting to the next; x, its residual and its differences agree."""

    def __init__(
        self, system: System, y: Single, static: Single, x: Single, directions: Directions,
        alpha: float,
    ) -> None:  # fmt: skip
        self.system, self.y, self.static, self.x = system, y, static, x
        self.directions = directions
        self.share = (alpha ** np.abs(directions).sum(axis=1)).astype(np.float32)
        self.steps = np.empty((len(directions), *x.shape), np.float32)
        self.beta, self.work = np.ones_like(self.steps), np.empty_like(self.steps)
        self.confidence, self.residual = static.copy(), np.empty_like(y)
        self.flat = tuple(
            frames.reshape(len(y), -1) for frames in (self.residual, static, self.confidence)
        )  # [frame pixel], of the same memory
        self.rest = np.empty_like(x)
        self.sigma = 0.0
        self._see()

    def iterate(self, settings: Irwsr) -> float:
        """Find new weights and solve with them; return the objective that has these weights."""
        residual, static, confidence = self.flat
        self.sigma = kernels.observation_weights(
            residual, static, confidence, settings.bias_threshold
        )
        factor, mu = self.share * np.float32(settings.prior_weight), settings.smoothing**2
        kernels.prior_weights(self.steps, self.share, settings.sparsity, self.work, self.beta)
        kernels.touching_quadratic(self.steps, self.beta, factor, mu, self.work)
        self._solve(settings.inner_iterations)
        self._see()
        return float(kernels.objective(residual, confidence, self.steps, self.beta, factor, mu))

    def _solve(self, iterations: int) -> None:
        """Move x towards the minimum of sum w |y - A x|^2 + sum_d a_d |D_d x|^2, `work` being a."""
        rest, a = self.rest, self.work
        self.system.adjoint(self.residual, self.confidence, rest)
        np.negative(rest, out=rest)
        add_weighted_laplacian(self.x, a, self.directions, rest)
        np.negative(rest, out=rest)
        self.system.solve(self.x, rest, self.confidence, a, self.directions, iterations)

    def _see(self) -> None:
        """Find the residual and the differences of x."""
        self.system.residual(self.x, self.y, self.residual)
        differences(self.x, self.directions, self.steps)


def _checked(model: ForwardModel, y: Array, weight: Array) -> Single:
    """Return the frames without their bias, in single precision."""
    if y.dtype.kind == "c":
        raise ValueError("irwsr expects real frames, got complex ones; use tikhonov, tv or auto")
    expected = (model.frames, *model.lr_shape)
    if y.shape != expected or weight.shape != expected:
        raise ValueError(
            f"expected frames and weights of shape {expected}, got {y.shape} and {weight.shape}"
        )
    return np.ascontiguousarray(y - model.bias[:, None, None], dtype=np.float32)
