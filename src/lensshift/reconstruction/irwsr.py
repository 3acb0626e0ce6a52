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
    add_laplacian_diagonal,
    differences,
    half_plane,
)
from lensshift.reconstruction.least_squares import solve_penalised

Array = NDArray[Any]
Single = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Irwsr:
    """Reweighted minimisation with Huber confidences and weighted bilateral total variation.

        F(x) = sum w beta |A x - y|^2
               + lambda sum_lm alpha^(|l| + |m|) b_lm sqrt(|S_lm x - x|^2 + mu)

    beta is the confidence of an LR pixel, min(1, 2 sigma / |r|), and 0 for frames whose median
    residual exceeds `bias_threshold`; b is 1 for small differences and falls for large ones
    (`irwsr_kernels.prior_weights`). Both are found anew in each of the `iterations`, in which
    the square root is replaced by the quadratic that touches it from above and the sum is
    minimised by `inner_iterations` conjugate gradients. Against the published toolbox: true
    gradient, row-major throughout, starts at the final scale, any shifts, shift fields.

    Parameters
    ----------
    prior_weight : lambda, for frames in 0 .. 1
    window, alpha : P and alpha of the bilateral prior
    sparsity : exponent p of the prior weights, in (0, 1]
    smoothing : mu
    tolerance : stop when no pixel moves by more than this

    Source: Koehler et al. 2016, doi 10.1109/TCI.2016.2516909; toolbox of 2017.
    """

    prior_weight: float
    window: int = 1
    alpha: float = 0.5
    sparsity: float = 0.5
    iterations: int = 10
    inner_iterations: int = 5
    bias_threshold: float = 0.02
    smoothing: float = 1e-4
    tolerance: float = 1e-3

    def __call__(
        self,
        model: ForwardModel,
        y: Array,
        weight: Array,
        x0: Array | None = None,
        on_iteration: Callable[[int, float], None] | None = None,
    ) -> Estimate:
        """Return the estimate [row col] from frames and their weights [frame row col].

        Raises
        ------
        ValueError
            If the frames are complex.
        """
        if y.dtype.kind == "c":
            raise ValueError("irwsr expects real frames, got complex ones; use tikhonov or auto")
        system = _system(model, y, weight)
        directions = half_plane(self.window)
        share = (self.alpha ** np.abs(directions).sum(axis=1)).astype(np.float32)
        x = system.start() if x0 is None else x0.astype(np.float32)
        steps = np.empty((len(directions), *x.shape), np.float32)
        beta, a, median = np.ones_like(steps), np.empty_like(steps), np.empty_like(steps)
        confidence = system.weight.reshape(len(y), -1).copy()
        objective: list[float] = []
        status, sigma = Status.MAX_ITERATIONS, 0.0
        residual = system.residual(x)
        for t in range(self.iterations):
            sigma = kernels.observation_weights(
                residual.reshape(len(y), -1), system.weight.reshape(len(y), -1), confidence,
                self.bias_threshold,
            )  # fmt: skip
            differences(x, directions, steps)
            kernels.prior_weights(steps, share, self.sparsity, median, beta)
            kernels.penalty_and_coefficients(
                steps, beta, share, self.prior_weight, self.smoothing, a
            )
            before = x.copy()
            trust = confidence.reshape(y.shape)
            system.solve(x, trust, a, directions, self.inner_iterations)
            residual = system.residual(x)
            objective.append(self._objective(residual, trust, x, beta, share, directions, steps, a))
            if on_iteration is not None:
                on_iteration(t + 1, objective[-1])
            if not np.isfinite(objective[-1]):
                status = Status.NOT_FINITE
                break
            if np.max(np.abs(x - before)) < self.tolerance:
                status = Status.CONVERGED
                break
        return Estimate(
            image=x.astype(np.float64),
            objective=tuple(objective),
            status=status,
            confidence=confidence.reshape(y.shape).astype(np.float64),
            prior_weight=self.prior_weight,
            noise_sigma=float(sigma),
        )

    def _objective(
        self, residual: Single, trust: Single, x: Single, beta: Single, share: Single,
        directions: Directions, steps: Single, work: Single,
    ) -> float:  # fmt: skip
        """Return F(x) with the weights of this iteration; steps and work are overwritten."""
        differences(x, directions, steps)
        penalty = kernels.penalty_and_coefficients(
            steps, beta, share, self.prior_weight, self.smoothing, work
        )
        flat = residual.ravel()
        return float(np.dot(flat * flat, trust.ravel()) + penalty)


def _system(model: ForwardModel, y: Array, weight: Array) -> _Interlaced | _Separable | _Field:
    """Return the fastest way to apply the forward model."""
    y32, weight32 = y.astype(np.float32), weight.astype(np.float32)
    if model.offset_px is None:
        return _Field(model, y32, weight32)
    if model.on_hr_grid and np.all(model.gain == 1):
        return _Interlaced(model, y32, weight32)
    return _Separable(model, y32, weight32)


class _Separable:
    """Constant shifts: two passes of taps per frame."""

    def __init__(self, model: ForwardModel, y: Single, weight: Single) -> None:
        self.y, self.weight = y, weight
        self.operator = model.operator
        gain = model.gain[:, None, None]
        self.taps = (
            model.rows.start, (model.rows.weight * gain).astype(np.float32),
            model.cols.start, model.cols.weight.astype(np.float32),
        )  # fmt: skip
        squares = (model.rows.weight**2).sum(axis=2), (model.cols.weight**2).sum(axis=2)
        self.seen = float(squares[0].mean() * squares[1].mean())

    def start(self) -> Single:
        """Return A^T W y / A^T W 1."""
        seen = self.operator.adjoint(self.weight)
        total = self.operator.adjoint(self.weight * self.y)
        return _filled(total, seen)

    def residual(self, x: Single) -> Single:
        return np.asarray(self.y - self.operator.forward(x))

    def solve(
        self, x: Single, trust: Single, a: Single, directions: Directions, iterations: int
    ) -> None:
        seen = self.operator.adjoint(trust)
        inverse = self.seen * seen + np.float32(1e-6)
        add_laplacian_diagonal(a, directions, inverse)
        np.reciprocal(inverse, out=inverse)
        b = self.operator.adjoint(trust * self.y)
        kernels.solve_separable(x, b, trust, *self.taps, inverse, a, directions, iterations)


class _Interlaced:
    """Shifts that put every LR pixel on an HR pixel: the burst is one small convolution.

    With K the convolution with zeros outside and n = K 1, the model is K x / n, and all frames
    together give the HR images of the weights W and of W y.
    """

    def __init__(self, model: ForwardModel, y: Single, weight: Single) -> None:
        lattice = model.interlace
        self.shape = model.hr_shape
        self.kernel = lattice.kernel.astype(np.float32)
        inside = model.inside
        self.y, self.weight = y, np.where(inside, weight, np.float32(0))
        rows = np.clip(lattice.row_index, 0, self.shape[0] - 1)
        cols = np.clip(lattice.col_index, 0, self.shape[1] - 1)
        self.at = (rows[:, :, None] * self.shape[1] + cols[:, None, :]).ravel()
        ones = np.ones(self.shape, np.float32)
        self.norm = np.empty(self.shape, np.float32)
        self.work = np.empty(self.shape, np.float32)
        kernels.convolve(ones, self.kernel, self.work, self.norm)
        self.seen = float((self.kernel**2).sum() ** 2)

    def _scattered(self, values: Single) -> Single:
        """Add the values [frame row col] of the LR pixels to their HR pixels."""
        total = np.bincount(self.at, values.ravel(), self.shape[0] * self.shape[1])
        return total.reshape(self.shape).astype(np.float32)

    def _convolved(self, image: Single) -> Single:
        out = np.empty(self.shape, np.float32)
        kernels.convolve(image, self.kernel, self.work, out)
        return out

    def start(self) -> Single:
        """Return A^T W y / A^T W 1."""
        seen = self._convolved(self._scattered(self.weight) / self.norm)
        total = self._convolved(self._scattered(self.weight * self.y) / self.norm)
        return _filled(total, seen)

    def residual(self, x: Single) -> Single:
        seen = self._convolved(x) / self.norm
        return np.asarray(self.y - seen.ravel()[self.at].reshape(self.y.shape))

    def solve(
        self, x: Single, trust: Single, a: Single, directions: Directions, iterations: int
    ) -> None:
        b = self._convolved(self._scattered(trust * self.y) / self.norm)
        weight = self._scattered(trust) / self.norm**2
        kernels.solve_interlaced(x, b, weight, self.kernel, a, directions, self.seen, iterations)


class _Field:
    """A shift for every pixel: the general operator."""

    def __init__(self, model: ForwardModel, y: Single, weight: Single) -> None:
        self.y, self.weight, self.operator = y, weight, model.operator

    def start(self) -> Single:
        """Return A^T W y / A^T W 1."""
        seen = self.operator.adjoint(self.weight)
        return _filled(self.operator.adjoint(self.weight * self.y), seen)

    def residual(self, x: Single) -> Single:
        return np.asarray(self.y - self.operator.forward(x))

    def solve(
        self, x: Single, trust: Single, a: Single, directions: Directions, iterations: int
    ) -> None:
        x[:] = solve_penalised(
            self.operator, self.y, trust, a, x, iterations, directions=directions
        )


def _filled(total: Single, seen: Single) -> Single:
    """Return total / seen, and the mean where an HR pixel is hardly seen."""
    known = seen > 1e-3 * seen.max()
    mean = total.sum() / seen.sum()
    return np.where(known, total / np.where(known, seen, 1), mean).astype(np.float32)
