"""Amplitude and phase of an HR image from phasor frames, found together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Status
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.adaptive import SHARE, local_weight
from lensshift.reconstruction.differences import (
    add_differences_adjoint,
    add_laplacian_diagonal,
    add_weighted_laplacian,
    differences,
)
from lensshift.reconstruction.least_squares import NEIGHBOURS, mean_column_square
from lensshift.reconstruction.outliers import HUBER_SIGMAS, frame_confidence
from lensshift.reconstruction.selection import prior_share

Array = NDArray[Any]
OnIteration = Callable[[int, float], None]

AMPLITUDE_EXPONENT, PHASE_EXPONENT = 0.9, 0.6
# An edge of the phase costs less where the logarithm of the amplitude has one too. How high that is
# says no more: beside a bright surface a mixed pixel is closer to the dark one, but has its phase.
EDGE_COUPLING, HIGHEST_LOG_STEP = 0.5, 1.1
# Steps of the phase by more than this let the amplitude between the surfaces go.
CANCELLING_RAD = 0.25
# Surfaces are planes: the phase is compared with its mean slope over this window.
SLOPE_WINDOW_HR_PX = 11
START_SMOOTHING, SMOOTHING_DECAY = 0.1, 0.75
PHASE_START_SMOOTHING_RAD = 0.3
FLOOR_SIGMAS = 0.2
MAX_STEP_RAD = 1.0
# The model errs at edges as if the pixels were wrongly placed by this much.
EDGE_ERROR_PX = 0.05
FEWEST_ITERATIONS = 6
REPLICATE_STEPS = 3


@dataclass(frozen=True, slots=True, eq=False)
class PolarImage:
    """A positive amplitude and a phase that is free to leave (-pi, pi].

    Parameters
    ----------
    amplitude, phase_rad : [row col]
    """

    amplitude: NDArray[np.float64]
    phase_rad: NDArray[np.float64]

    @property
    def phasor(self) -> NDArray[np.complex128]:
        """a exp(i phi), [row col]."""
        return np.asarray(self.amplitude * np.exp(1j * self.phase_rad))


@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """A weight of each LR pixel that may differ along two directions of the complex plane.

        W z = s z + t conj(z)

    Parameters
    ----------
    isotropic, directed : [frame row col] s, real, and t, complex
    """

    isotropic: Array
    directed: Array

    def __call__(self, z: Array) -> Array:
        """Return W z."""
        return np.asarray(self.isotropic * z + self.directed * z.conj())


@dataclass(slots=True)
class Progress:
    """What a run of `JointPhasor` carries from step to step.

    Parameters
    ----------
    image : the estimate
    weight : of the LR pixels, outliers and edges counted less
    smoothing, phase_smoothing_rad : eps of the two penalties
    prior_weights : lambda of amplitude and of phase, 0 until first found
    objective : after each step
    status : how it ended
    settled : whether eps and lambda stay as they are
    """

    image: PolarImage
    weight: Trust
    smoothing: float = START_SMOOTHING
    phase_smoothing_rad: float = PHASE_START_SMOOTHING_RAD
    prior_weights: tuple[float, float] = (0.0, 0.0)
    penalty: float = 0.0
    objective: list[float] = field(default_factory=list)
    status: Status = Status.MAX_ITERATIONS
    settled: bool = False


@dataclass(frozen=True, slots=True)
class JointPhasor:
    """Maximum a posteriori amplitude and phase of phasor frames.

        F(a, phi) = sum w |A (a exp(i phi)) - y|^2
                    + lambda_a   sum_d share_d (|D_d a|^2 + eps_a^2)^(p_a / 2)        (*)
                    + lambda_phi sum_d share_d (|D_d phi - s_d|^2 + kappa |D_d log a|^2
                                                + eps_phi^2)^(p_phi / 2)

    with the mean slope s_d of the surroundings; (*) where the phasor has an edge, the amplitude is
    as free as if it had one, and freer still where phases cancel; |D_d log a| counts up to 1.1.
    Reweighted Gauss-Newton: in each step the phasor is linearised in (a, a phi), the penalties are
    replaced by quadratics that touch them, and both unknowns are solved for by conjugate
    gradients. Both lambda set themselves as in `SparseGradient`, that of the amplitude around each
    pixel. The prior of the phase does not know the amplitude: where a surface is dark, its data
    count a^2 and the neighbours decide.

    Parameters
    ----------
    noise_sigma : noise of a component of an LR pixel
    blur_hr_px : width of the pixel response in HR pixels
    shift_error_hr_px : [frame] standard deviation of the shifts in HR pixels
    robust : whether pixels and frames that do not fit lose weight
    iterations, inner_iterations : Gauss-Newton steps, and conjugate gradients in each
    tolerance : stop when no phasor moves by more than this
    """

    noise_sigma: float
    blur_hr_px: float = 0.6
    shift_error_hr_px: Array | float = 0.0
    robust: bool = True
    iterations: int = 14
    inner_iterations: int = 15
    tolerance: float = 1e-3

    def __call__(
        self,
        A: LinearOperator,
        y: Array,
        weight: Array,
        start: PolarImage,
        on_iteration: OnIteration | None = None,
    ) -> Progress:
        """Return the estimate from phasor frames and their weights [frame row col].

        Parameters
        ----------
        A : HR image [row col] to frames [frame row col]
        start : amplitude and phase to begin with; the phase decides the whole turns
        """
        now = Progress(start, Trust(weight, np.zeros(1)))
        square = mean_column_square(A)
        for t in range(self.iterations):
            before = now.image.phasor
            if self.robust:
                now.weight = self._trust(A, y, weight, before)
            now.image = self._step(A, y, now, square)
            after = now.image.phasor
            now.objective.append(_misfit(A, y, now.weight, after) + now.penalty)
            if on_iteration is not None:
                on_iteration(t + 1, now.objective[-1])
            if not np.isfinite(now.objective[-1]):
                now.status = Status.NOT_FINITE
                break
            if t >= FEWEST_ITERATIONS and np.max(np.abs(after - before)) < self.tolerance:
                now.status = Status.CONVERGED
                break
        return now

    def replicate(self, A: LinearOperator, y: Array, done: Progress) -> PolarImage:
        """Answer other noise on the frames, from an estimate on, with its weights and lambda."""
        now = replace(done, settled=True)
        square = mean_column_square(A)
        for _ in range(REPLICATE_STEPS):
            now.image = self._step(A, y, now, square)
        return now.image

    def _typical(self, now: Progress) -> float:
        return max(float(np.median(now.image.amplitude)), self.noise_sigma)

    def _step(self, A: LinearOperator, y: Array, now: Progress, column_square: float) -> PolarImage:
        """Solve the quadratic that touches F at the present image."""
        a, phase_rad = now.image.amplitude, now.image.phase_rad
        lever = np.maximum(a, self.noise_sigma)  # a phase of less than the noise has no grip
        deviation, for_amplitude, for_phase = self._coefficients(now)
        turn = np.exp(1j * phase_rad)
        weight = now.weight

        def apply(q: Array) -> Array:
            data = turn.conj() * A.adjoint(weight(A.forward(turn * q)))
            radial, across = np.zeros(a.shape), np.zeros(a.shape)
            add_weighted_laplacian(np.ascontiguousarray(q.real), for_amplitude, NEIGHBOURS, radial)
            add_weighted_laplacian(q.imag / lever, for_phase, NEIGHBOURS, across)
            return np.asarray(data + radial + 1j * across / lever)

        pull = np.zeros(a.shape)
        add_differences_adjoint(for_phase * deviation, NEIGHBOURS, pull)
        b = turn.conj() * A.adjoint(weight(y)) - 1j * pull / lever
        seen = A.adjoint(weight.isotropic) * (column_square * a.size / y.size) + 1e-9
        radial, across = seen.copy(), np.zeros(a.shape)
        add_laplacian_diagonal(for_amplitude, NEIGHBOURS, radial)
        add_laplacian_diagonal(for_phase, NEIGHBOURS, across)
        q = _conjugate_gradient(
            apply, b, a.astype(np.complex128), radial, seen + across / lever**2,
            self.inner_iterations,
        )  # fmt: skip
        step_rad = np.clip(q.imag / lever, -MAX_STEP_RAD, MAX_STEP_RAD)
        return PolarImage(np.maximum(q.real, 0.0), phase_rad + step_rad)

    def _coefficients(self, now: Progress) -> tuple[Array, Array, Array]:
        """Return D phi - s and the quadratics of both penalties; updates eps and lambda."""
        a, phase_rad, sigma = now.image.amplitude, now.image.phase_rad, self.noise_sigma
        if not now.settled:
            floor = FLOOR_SIGMAS * sigma
            now.smoothing = max(floor, now.smoothing * SMOOTHING_DECAY)
            now.phase_smoothing_rad = max(
                floor / self._typical(now), now.phase_smoothing_rad * SMOOTHING_DECAY
            )
        amplitude_step, phase_step = _differences(a), _differences(phase_rad)
        log_step = _differences(np.log(np.maximum(a, 2.0 * sigma)))
        log_step = np.minimum(np.abs(log_step), HIGHEST_LOG_STEP)
        deviation = phase_step - _mean_slope(phase_step, now.phase_smoothing_rad)
        amplitude_energy = _energy(amplitude_step**2, now.smoothing, AMPLITUDE_EXPONENT)
        phase_energy = _energy(deviation**2, now.phase_smoothing_rad, PHASE_EXPONENT)
        shown = amplitude_energy - self._hidden(now.smoothing, AMPLITUDE_EXPONENT)
        local = local_weight(shown, max(float(shown.mean()), 1e-12))
        if not now.settled:
            now.prior_weights = (
                self._prior_weight(
                    amplitude_energy, now.smoothing, AMPLITUDE_EXPONENT, now.prior_weights[0]
                ),
                self._prior_weight(
                    phase_energy, now.phase_smoothing_rad, PHASE_EXPONENT, now.prior_weights[1]
                ),
            )  # fmt: skip
        for_a, for_phi = now.prior_weights
        now.penalty = for_a * float(np.sum(local * amplitude_energy)) + for_phi * float(
            np.sum(phase_energy)
        )
        # Two phases that cancel in a pixel make it dark: the whole step of the phasor counts.
        phasor_step = _differences(now.image.phasor)
        for_amplitude = _touching(
            np.abs(phasor_step) ** 2, now.smoothing, AMPLITUDE_EXPONENT, for_a * local
        )
        # Such a pixel has the amplitude of neither surface: a Geman-McClure weight lets it go.
        for_amplitude /= (1.0 + (deviation / CANCELLING_RAD) ** 2) ** 2
        for_phase = _touching(
            deviation**2 + EDGE_COUPLING * log_step**2,
            now.phase_smoothing_rad, PHASE_EXPONENT, for_phi,
        )  # fmt: skip
        return deviation, for_amplitude, for_phase

    def _hidden(self, smoothing: float, exponent: float) -> float:
        """Return what eps adds to the energy of a pixel, but for that of its noise."""
        rest = smoothing**exponent - (0.3 * self.noise_sigma) ** exponent
        return float(SHARE.sum() * rest)

    def _prior_weight(
        self, energy: Array, smoothing: float, exponent: float, before: float
    ) -> float:
        """Return lambda = 2 c sigma^2 / (p P), P the mean of energy, averaged with before."""
        shown = max(float(energy.mean()) - self._hidden(smoothing, exponent), 1e-12)
        found = 2.0 * prior_share(self.blur_hr_px) * self.noise_sigma**2 / (exponent * shown)
        return float(np.sqrt(found * before)) if before > 0.0 else float(found)

    def _trust(self, A: LinearOperator, y: Array, weight: Array, x: Array) -> Trust:
        """Return what each LR pixel counts: outliers, odd frames and steep places less.

            C = sigma^2 + e^2 sum_d g_d g_d^T,   g_d = D_d x as a vector (real, imaginary)

        A pixel whose place is wrong by e errs along the gradient of the phasor alone. What a dark
        surface beside a bright one says of its phase stands across and is kept.
        """
        across, down, *diagonals = _differences(x)
        error2 = EDGE_ERROR_PX**2 + np.reshape(self.shift_error_hr_px, (-1, 1, 1)) ** 2
        power = np.abs(across) ** 2 + np.abs(down) ** 2
        square = across**2 + down**2
        for step in diagonals:
            power += 0.5 * np.abs(step) ** 2
            square += 0.5 * step**2
        variance = self.noise_sigma**2
        c0 = variance + 0.25 * error2 * np.maximum(A.forward(power), 0.0)
        c1 = 0.25 * error2 * A.forward(square)
        shrink = variance / (c0**2 - np.minimum(np.abs(c1), c0 - variance) ** 2)
        whole = Trust(c0 * shrink, -c1 * shrink)
        residual = y - A.forward(x)
        size = np.sqrt(np.maximum((residual.conj() * whole(residual)).real, 0.0))
        trust = weight * frame_confidence(residual, weight)[:, None, None]
        trust = trust * np.minimum(1.0, HUBER_SIGMAS * self.noise_sigma / np.maximum(size, 1e-300))
        return Trust(whole.isotropic * trust, whole.directed * trust)


def _differences(x: Array) -> Array:
    steps = np.empty((len(NEIGHBOURS), *x.shape), x.dtype)
    differences(x, NEIGHBOURS, steps)
    return steps


def _mean_slope(step_rad: Array, smoothing: float) -> Array:
    """Return the mean step [direction row col] of the surroundings; edges hardly count."""
    from scipy.ndimage import uniform_filter

    window = (0, SLOPE_WINDOW_HR_PX, SLOPE_WINDOW_HR_PX)
    flat = 1.0 / (step_rad**2 + smoothing**2)
    return np.asarray(uniform_filter(flat * step_rad, window) / uniform_filter(flat, window))


def _energy(square: Array, smoothing: float, exponent: float) -> Array:
    return np.asarray(np.sum(SHARE * (square + smoothing**2) ** (exponent / 2), axis=0))


def _touching(
    square: Array, smoothing: float, exponent: float, prior_weight: Array | float
) -> Array:
    slope = (square + smoothing**2) ** (exponent / 2 - 1.0)
    return np.asarray(0.5 * prior_weight * exponent * SHARE * slope)


def _misfit(A: LinearOperator, y: Array, weight: Trust, x: Array) -> float:
    residual = y - A.forward(x)
    return float(np.sum((residual.conj() * weight(residual)).real))


def _conjugate_gradient(
    apply: Callable[[Array], Array],
    b: Array,
    x: Array,
    real_diagonal: Array,
    imag_diagonal: Array,
    iterations: int,
    tolerance: float = 1e-4,
) -> Array:
    """Solve H x = b for an H symmetric over pairs of reals, preconditioned component by component.

    As `least_squares.conjugate_gradient`, but H does not commute with i.
    """

    def precondition(r: Array) -> Array:
        return np.asarray(r.real / real_diagonal + 1j * (r.imag / imag_diagonal))

    r = b - apply(x)
    z = precondition(r)
    p = z.copy()
    rz = np.vdot(r, z).real
    enough = tolerance**2 * np.vdot(b, precondition(b)).real
    for _ in range(iterations):
        if rz <= enough or rz == 0.0:
            break
        q = apply(p)
        step = rz / np.vdot(p, q).real
        x = x + step * p
        r -= step * q
        z = precondition(r)
        rz, before = np.vdot(r, z).real, rz
        p = z + (rz / before) * p
    return x
