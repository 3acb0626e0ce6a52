"""The unrolled solver: data steps with the exact forward model, prior steps learned.

    v_0      = argmin |y - A v|^2_W + c |grad v|^2
    x_t, s_t = prior_t(v_(t-1), residuals, noise of each HR pixel)
    v_t      = argmin |y - A v|^2_W + k_t |(v - x_t) / s_t|^2

W is the inverse noise variance, less where a pixel contradicts the picture. As noise falls, W grows
and the data decide. All numbers but the network's are the same everywhere: there is no switch and
no scale for the whole picture. `training/network.py` is the same chain in PyTorch.

Bursts of one geometry go through it together, on their own axis. What it is computed with, compiled
kernels or the array API of a device, it is handed (`kernels.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.learned.kernels import Kernels
from lensshift.reconstruction.learned.turn import Turn

if TYPE_CHECKING:
    from lensshift.reconstruction.learned.priors import LearnedPrior

# Of NumPy or of the device, float32; a picture is complex64 for phasors.
Single = NDArray[np.floating[Any]]
Picture = Array

# The form of the chain that the weights were trained in (training/network.py); not to be tuned.
START_STEPS, DATA_STEPS = 8, 4
START_STIFFNESS = 0.02
LEAST_DENSITY = 0.02
PRECISION_RANGE = (1e-3, 1e4)
TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What a prior is shown of a picture before a stage, in units of the noise.

    Parameters
    ----------
    v, past : [burst row col] the picture and what it was a stage before
    gradient : [burst row col] where the frames want it to go, each HR pixel by its own sum of
        weights
    misfit : [burst row col] rms residual of the frames around
    noise, trusted : [burst row col] noise of the frames at an HR pixel, and of what is believed of
        them
    turn : how a network looks at them
    on : what it is computed with
    """

    v: Picture
    past: Picture
    gradient: Picture
    misfit: Single
    noise: Single
    trusted: Single
    turn: Turn
    on: Kernels


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Bursts in units of their noise: frames y, their relative sigma and weight 1 / sigma^2.

    `alike` believes all pixels alike, also those that contradict.
    """

    A: LinearOperator
    y: Picture
    sigma: Single
    weight: Single
    facts: NDArray[np.float32]
    scale: int
    turn: Turn
    on: Kernels
    alike: bool = False

    def run(
        self, prior: LearnedPrior, on_stage: Callable[[int, Any], None] | None = None
    ) -> tuple[Picture, Single, Single, Any]:
        """Return picture, what is said of its error, the weights, rms of the last step over s."""
        xp = self.on.xp
        density, floor = self.seen(self.weight), self.floor
        noise: Single = 1 / xp.sqrt(density + floor)
        used = xp.ones_like(self.weight) * (self.weight > 0)
        stages, share = len(prior.numbers["trust"]), self._around(used)
        v, past = self.start(density, prior.numbers)
        channels: Any = None  # of the stage before
        for t in range(stages):
            trust, forgive, doubt = (
                float(np.exp(prior.numbers[name][t])) for name in ("trust", "forgive", "doubt")
            )
            r = self.y - self.A.forward(v)
            size = self._size(r)
            robust = self._believed(size, used, share, forgive, doubt)
            mass = self.seen(robust)
            if on_stage is not None:
                left = _total(xp, robust * size**2) / _total(xp, robust > 0)
                on_stage(t + 1, xp.sqrt(left))
            chi_square = self.A.adjoint(self.weight * size**2) / (density + floor)
            state = State(
                v, past, self.A.adjoint(robust * r) / (mass + floor),
                xp.sqrt(xp.clip(chi_square, 0, None)), noise, 1 / xp.sqrt(mass + floor),
                self.turn, self.on,
            )  # fmt: skip
            x, s, channels = prior.improve(t, state, self.facts, channels)
            k: Single = xp.clip(trust / (s * s), *PRECISION_RANGE)
            past, v = v, self._data_step(
                x, robust, mass, k, _sigmoid(prior.numbers["lowest"][t + 1]),
                prior.last_steps if t + 1 == stages else DATA_STEPS,
            )  # fmt: skip
        change = xp.mean((xp.abs(v - past) / xp.clip(s, TINY, None)) ** 2, (1, 2))
        return v, prior.spread(channels, state), robust, xp.sqrt(change)

    def _believed(
        self, size: Single, used: Single, share: Single, forgive: float, doubt: float
    ) -> Single:
        """Return the weights after Huber: what a pixel may be off by grows with its neighbours."""
        xp = self.on.xp
        if self.alike:
            return self.weight
        square = self._around(used * size * size)
        around = xp.sqrt(xp.clip(square, 0, None) / (share + 1e-6))
        limit = forgive * self.sigma + doubt * around
        believed: Single = self.weight * xp.clip(limit / (size + TINY), None, 1)
        return believed

    def _around(self, values: Single) -> Single:
        """Return the sum over 3 x 3 pixels of each frame, over nine."""
        around: Single = self.on.mean_around(values, 3)
        return around

    def _size(self, r: Picture) -> Single:
        """Return the size of a residual, of each component if it has two."""
        xp = self.on.xp
        size: Single = xp.abs(r)
        return size * 0.5**0.5 if r.dtype == xp.complex64 else size

    def seen(self, weight: Single) -> Single:
        """Return how much weight sees each HR pixel; skewed responses have taps below 0."""
        seen: Single = self.on.xp.clip(self.A.adjoint(weight), 0, None)
        return seen

    @property
    def floor(self) -> float:
        """What counts as weight where no frame sees an HR pixel."""
        return LEAST_DENSITY * float(self.y.shape[1]) / self.scale**2

    def start(self, density: Single, numbers: Mapping[str, Floats]) -> tuple[Picture, Picture]:
        """Return v_0, and the weighted mean of the frames that it was found from."""

        def apply(p: Picture) -> Picture:
            spread: Picture = self.A.adjoint(self.weight * self.A.forward(p))
            return spread + START_STIFFNESS * _stiffness(self.on.xp, p)

        b = self.A.adjoint(self.weight * self.y)
        x: Picture = b / (density + self.floor * 1e-3)
        xp = self.on.xp
        most = xp.amax(xp.abs(self.y), (1, 2, 3))[:, None, None]
        x *= xp.clip(most / xp.clip(xp.abs(x), TINY, None), None, 1)  # a mean of the frames
        lowest, diagonal = _sigmoid(numbers["lowest"][0]), density + 8 * START_STIFFNESS
        return chebyshev(apply, b - apply(x), x, diagonal, lowest, START_STEPS), x

    def _data_step(
        self, x: Picture, robust: Single, mass: Single, k: Single, lowest: float, steps: int
    ) -> Picture:
        def apply(p: Picture) -> Picture:
            spread: Picture = self.A.adjoint(robust * self.A.forward(p))
            spread += k * p
            return spread

        if steps == 0:
            return x
        # The prior has its least at x: there the frames alone pull.
        pull = self.A.adjoint(robust * (self.y - self.A.forward(x)))
        return chebyshev(apply, pull, x, mass + k, lowest, steps)


def _total(xp: Any, values: Any) -> Any:
    """Return the sum over the frames of each burst."""
    return xp.sum(values, (1, 2, 3))


def chebyshev(
    apply: Callable[[Picture], Picture],
    r: Picture,
    x: Picture,
    diagonal: Single,
    lowest: float,
    steps: int,
) -> Picture:
    """Return x after some Chebyshev steps on apply(x) = b; r is b - apply(x), and overwritten.

    The eigenvalues of apply over `diagonal` are at most 1 (rows of A sum to 1); those below
    `lowest` are left to x. There is no inner product over the picture, so what one region holds
    cannot touch another. Source: Saad, Iterative Methods for Sparse Linear Systems, 12.3.
    """
    middle, half = (1 + lowest) / 2, (1 - lowest) / 2
    rho, scaled = half / middle, 1 / (diagonal * middle)
    d = scaled * r
    x = x + d
    for _ in range(steps - 1):
        r -= apply(d)
        following = 1 / (2 * middle / half - rho)
        d *= following * rho
        d += (2 * following * middle / half) * (scaled * r)
        rho = following
        x += d
    return x


def _stiffness(xp: Any, x: Picture) -> Picture:
    """Return the gradient of half the squared differences between neighbours."""
    out: Picture = xp.zeros_like(x)
    step = x[:, 1:] - x[:, :-1]
    out[:, 1:] += step
    out[:, :-1] -= step
    step = x[..., 1:] - x[..., :-1]
    out[..., 1:] += step
    out[..., :-1] -= step
    return out


def _sigmoid(value: float) -> float:
    return float(1 / (1 + np.exp(-value)))
