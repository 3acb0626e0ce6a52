"""The unrolled solver: data steps with the exact forward model, prior steps learned.

    v_0      = argmin |y - A v|^2_W + c |grad v|^2
    x_t, s_t = prior_t(v_(t-1), residuals, noise of each HR pixel)
    v_t      = argmin |y - A v|^2_W + k_t |(v - x_t) / s_t|^2

W is the inverse noise variance, less where a pixel contradicts the picture. As noise falls, W grows
and the data decide. All numbers but the network's are the same everywhere: there is no switch and
no scale for the whole picture. `training/network.py` is the same chain in PyTorch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lensshift.forward.model import ForwardModel
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.learned.prior import Prior, fold, learned_weights, unfold

Single = NDArray[np.floating[Any]]  # float32, which NumPy's types lose on the way

# The form of the chain that the weights were trained in (training/network.py); not to be tuned.
START_STEPS, DATA_STEPS, LAST_STEPS = 8, 4, 8
START_STIFFNESS = np.float32(0.02)
LEAST_DENSITY = 0.02
PRECISION_RANGE = (1e-3, 1e4)
TINY = np.float32(1e-12)
# So that two std hold 95.45 % of the truth on mosaics of seeds that no test and no report uses
# (training/validate.py --calibrate); the likelihood alone makes std too wide, by tails.
STD_SCALE = 0.83
# Larger pictures are solved in tiles, so that memory is bounded. Nothing reaches farther than the
# halo but what is far below the noise (tests/reconstruction/test_learned.py).
TILE_HR_PX, HALO_HR_PX = 640, 32

Region = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What the solver found, in the units of the frames.

    Parameters
    ----------
    image, std : [row col] estimate and the standard deviation of its error
    weight : [frame row col] 0 .. 1, how much of each LR pixel was believed in the end
    change : rms change of the picture in the last stage over its std
    """

    image: NDArray[np.float64]
    std: NDArray[np.float64]
    weight: Single
    change: float


def solve(
    model: ForwardModel,
    y: NDArray[np.float64],
    sigma: NDArray[np.float64],
    *,
    blur_px: float,
    on_stage: Callable[[int, float], None] | None = None,
) -> Solution:
    """Return the picture that explains the frames y = A x + n.

    Parameters
    ----------
    model : how an HR image becomes the frames; its gain and bias are 1 and 0
    y : [frame row col] real
    sigma : [frame row col] noise of each LR pixel; infinite where a pixel must not be used
    blur_px : standard deviation of the pixel response in LR pixels
    on_stage : called with the number of the stage and the misfit in units of the noise
    """
    used = np.isfinite(sigma)
    unit, level = float(np.mean(sigma[used])), float(np.median(y[used]))
    known = np.where(used, (y - level) / unit, 0.0).astype(np.float32)
    relative = np.where(used, sigma / unit, 1.0).astype(np.float32)
    weight = np.where(used, relative**-2, 0).astype(np.float32)
    facts = _facts(blur_px * model.scale, model.scale, len(y))
    image, std = np.empty(model.hr_shape), np.empty(model.hr_shape)
    believed, changes = np.empty(y.shape, np.float32), []
    for part, inner in _tiles(model.lr_shape, model.scale):
        frames = (slice(None), *part)
        whole = all(p == slice(0, n) for p, n in zip(part, model.lr_shape, strict=True))
        operator = (model if whole else model.crop(*part)).operator
        chain = _Chain(
            operator, known[frames], relative[frames], weight[frames], facts, model.scale
        )
        v, s, robust, change = chain.run(on_stage)
        rows, cols = (slice(i.start - p.start, i.stop - p.start)
                      for i, p in zip(inner, part, strict=True))  # fmt: skip
        to, of = (_times(place, model.scale) for place in (inner, (rows, cols)))
        image[to], std[to] = v[of], s[of]
        believed[(slice(None), *inner)] = robust[:, rows, cols]
        changes.append(change)
    return Solution(
        image=image * unit + level,
        std=std * (STD_SCALE * unit),
        weight=believed / np.maximum(weight, TINY),
        change=max(changes),
    )


def _tiles(lr_shape: tuple[int, int], scale: int) -> list[tuple[Region, Region]]:
    """Return the parts of a large burst with their halo, and what each is to fill, in LR pixels."""
    tile, halo = TILE_HR_PX // scale, -(-HALO_HR_PX // scale)
    lines: list[list[tuple[slice, slice]]] = []
    for size in lr_shape:
        count = 1 if size <= tile + 2 * halo else -(-size // tile)
        ends = [size * n // count for n in range(count + 1)]
        lines.append([
            (slice(max(a - halo, 0), min(b + halo, size)), slice(a, b))
            for a, b in pairwise(ends)
        ])  # fmt: skip
    return [((r[0], c[0]), (r[1], c[1])) for r in lines[0] for c in lines[1]]


def _times(region: Region, scale: int) -> Region:
    rows, cols = (slice(part.start * scale, part.stop * scale) for part in region)
    return rows, cols


def _facts(blur_hr_px: float, scale: int, frames: int) -> Single:
    samples = frames / scale**2
    return np.array(
        [blur_hr_px - 0.6, scale / 2 - 1, np.log(samples) / 2, 1 / (1 + samples)], np.float32
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Chain:
    """One burst in units of its noise: frames y, their relative sigma and weight 1 / sigma^2."""

    A: LinearOperator
    y: Single
    sigma: Single
    weight: Single
    facts: Single
    scale: int

    def run(
        self, on_stage: Callable[[int, float], None] | None
    ) -> tuple[Single, Single, Single, float]:
        """Return picture, its std, the robust weights and the change in the last stage."""
        learned = learned_weights()
        density = self.A.adjoint(self.weight)
        floor = np.float32(LEAST_DENSITY * len(self.y) / self.scale**2)
        noise: Single = 1 / np.sqrt(density + floor)
        past: Single = self.A.adjoint(self.weight * self.y) / (density + floor * np.float32(1e-3))
        v: Single = self._start(past, density, _sigmoid(learned.numbers["lowest"][0]))
        memory: Single | None = None
        std, robust, change = noise, self.weight, np.inf
        for t, prior in enumerate(learned.stages):
            numbers = {name: np.float32(np.exp(learned.numbers[name][t]))
                       for name in ("trust", "forgive", "floor", "doubt")}  # fmt: skip
            r = self.y - self.A.forward(v)
            robust = self._believed(r, numbers["forgive"], numbers["doubt"])
            mass = self.A.adjoint(robust)
            if on_stage is not None:
                on_stage(t + 1, float(np.sqrt(np.sum(robust * r * r) / np.sum(robust > 0))))
            pictures = self._pictures(v, past, r, robust, mass + floor, density + floor, noise)
            out = _stage(prior, pictures, memory, self.facts)
            memory = out[..., 8:]
            x = v + unfold(out[..., :4], v.shape)
            s = np.abs(unfold(out[..., 4:8], v.shape)) + numbers["floor"] * noise
            last = t + 1 == len(learned.stages)
            if last:
                least = np.float32(np.exp(learned.numbers["floor"][-1]))
                std = np.abs(unfold(out[..., 8:12], v.shape)) + least * noise
            k: Single = np.clip(numbers["trust"] / (s * s), *PRECISION_RANGE)
            k = k.astype(np.float32, copy=False)
            past, v = v, self._data_step(
                x, robust, mass, k, _sigmoid(learned.numbers["lowest"][t + 1]),
                LAST_STEPS if last else DATA_STEPS,
            )  # fmt: skip
            change = float(np.sqrt(np.mean(((v - past) / np.maximum(std, TINY)) ** 2)))
        return v, std, robust, change

    def _believed(self, r: Single, forgive: np.float32, doubt: np.float32) -> Single:
        """Return the weights after Huber: what a pixel may be off by grows with its neighbours."""
        seen = (self.weight > 0).astype(np.float32)
        square = uniform_filter(r * r * seen, (1, 3, 3), mode="constant")
        share = uniform_filter(seen, (1, 3, 3), mode="constant")
        around = np.sqrt(np.maximum(square, 0) / (share + np.float32(1e-6)))
        limit = forgive * self.sigma + doubt * around
        believed: Single = self.weight * np.minimum(limit / (np.abs(r) + TINY), 1)
        return believed

    def _pictures(
        self, v: Single, past: Single, r: Single, robust: Single, mass: Single,
        density: Single, noise: Single,
    ) -> list[Single]:  # fmt: skip
        """Return what the prior sees on the HR grid."""
        return [
            v,
            v - past,
            8 * self.A.adjoint(robust * r) / mass,
            2 * np.sqrt(np.maximum(self.A.adjoint(self.weight * r * r) / density, 0)),
            noise,
            1 / np.sqrt(mass),
        ]

    def _start(self, x: Single, density: Single, lowest: np.float32) -> Single:
        def apply(p: Single) -> Single:
            spread: Single = self.A.adjoint(self.weight * self.A.forward(p))
            return spread + START_STIFFNESS * _stiffness(p)

        b = self.A.adjoint(self.weight * self.y)
        return chebyshev(apply, b, x, density + 8 * START_STIFFNESS, lowest, START_STEPS)

    def _data_step(
        self, x: Single, robust: Single, mass: Single, k: Single, lowest: np.float32, steps: int
    ) -> Single:
        def apply(p: Single) -> Single:
            spread: Single = self.A.adjoint(robust * self.A.forward(p))
            spread += k * p
            return spread

        b = self.A.adjoint(robust * self.y) + k * x
        return chebyshev(apply, b, x, mass + k, lowest, steps)


def chebyshev(
    apply: Callable[[Single], Single],
    b: Single,
    x: Single,
    diagonal: Single,
    lowest: np.float32,
    steps: int,
) -> Single:
    """Return x after some Chebyshev steps on apply(x) = b.

    The eigenvalues of apply over `diagonal` are at most 1 (rows of A sum to 1); those below
    `lowest` are left to x. There is no inner product over the picture, so what one region holds
    cannot touch another. Source: Saad, Iterative Methods for Sparse Linear Systems, 12.3.
    """
    middle, half = (1 + lowest) / 2, (1 - lowest) / 2
    rho = half / middle
    r = b - apply(x)
    d = r / (diagonal * middle)
    x = x + d
    for _ in range(steps - 1):
        r -= apply(d)
        following = 1 / (2 * middle / half - rho)
        d = (following * rho) * d + (2 * following / half) * r / diagonal
        rho = following
        x += d
    return x


def _stage(prior: Prior, pictures: list[Single], memory: Single | None, facts: Single) -> Single:
    folded = fold(pictures)
    seen = prior.layers[0].shape[0] // 9 - folded.shape[2]
    if memory is None:
        memory = np.zeros((*folded.shape[:2], seen), np.float32)
    return prior(np.concatenate([folded, memory], axis=2), facts)


def _stiffness(x: Single) -> Single:
    """Return the gradient of half the squared differences between neighbours."""
    out = np.zeros_like(x)
    step = np.diff(x, axis=0)
    out[1:] += step
    out[:-1] -= step
    step = np.diff(x, axis=1)
    out[:, 1:] += step
    out[:, :-1] -= step
    return out


def _sigmoid(value: float) -> np.float32:
    return np.float32(1 / (1 + np.exp(-value)))
