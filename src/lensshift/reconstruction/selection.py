"""Choose the weight of a prior without knowing the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lensshift.core.arrays import Array
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.uncertainty import white_noise

# A tenth of the pixels tells the error of a weight to some per cent and leaves a picture to fit.
HELD_OUT = 0.1
# A residual counts up to this many robust deviations.
CLIP_SIGMAS = 3.0
# Weights, of the one that is thought to be right, and the share of the frames that a fit may
# follow: of a larger one too little is left to judge by.
STEPS, MOST_FOLLOWED = np.logspace(-4, 0, 9), 0.98


def prior_share(blur_hr_px: float) -> float:
    """Return the part of the neighbour differences that the data can see through the blur.

    c = 0.45 / blur^1.5, fitted to natural and synthetic scenes at x2 to x4 (decision 0006); it
    scales the weight that the maximum a posteriori rule gives to a prior.
    """
    return float(0.45 * max(blur_hr_px, 0.3) ** -1.5)


def predicting_weight(
    solve: Callable[[float, Array], Array],
    A: LinearOperator,
    y: Array,
    weight: Array,
    start: float,
    noise_sigma: float,
    seed: int = 0,
) -> float:
    """Return a weight of the prior near `start` at which noise alone is left of the frames.

        sum w |y - A x|^2 <= M sigma^2

    (Morozov's discrepancy), looked for among softer ones in halves of a decade. As the noise may
    be more than is known, the one of those on the way is taken that predicts the frames best by
    generalised cross-validation, and stiffer ones as long as they predict better,

        V = (sum w |y - A x|^2 / M) / (1 - gamma / M)^2,   gamma = tr dA x / dy

    with gamma from the answer to a draw of noise, of the size of what is left.

    Parameters
    ----------
    solve : (lambda, frames [frame row col]) -> HR image
    weight : [frame row col] of the pixels that judge, 0 of the others
    noise_sigma : of a pixel of weight 1, per component if complex

    Source: Golub, Heath and Wahba 1979, doi 10.1080/00401706.1979.10489751; Girard 1989.
    """
    noise = white_noise(np.random.default_rng(seed), y, weight)
    count = np.count_nonzero(weight) * (2 if y.dtype.kind == "c" else 1)

    def judged(value: float) -> tuple[float, float]:
        x = solve(value, y)
        left = float(np.sum(weight * np.abs(y - A.forward(x)) ** 2)) / count
        size = np.sqrt(max(left, noise_sigma**2))
        moved = A.forward(solve(value, y + size * noise) - x)
        share = float(np.vdot(weight * noise, moved).real) / (size * count)
        return left / (1.0 - max(share, 0.0)) ** 2 if share < MOST_FOLLOWED else np.inf, left

    best, least = start, np.inf
    for value in start * STEPS[::-1]:
        risk, left = judged(value)
        if risk < least:
            best, least = float(value), risk
        if left <= noise_sigma**2:
            break
    for value in start / STEPS[-2::-1]:
        risk, _ = judged(value)
        if risk >= least < np.inf:
            break
        if risk < least:
            best, least = float(value), risk
    return best


def cross_validate(
    solve: Callable[[float, Array], Array],
    A: LinearOperator,
    y: Array,
    weight: Array,
    seed: int,
    on_trial: Callable[[int, float], None] | None = None,
) -> float:
    """Return the weight of the prior that predicts LR pixels best which it has not seen.

    A tenth of the usable pixels, drawn with `seed`, is held out; weights from 1e-6 to 1 are
    tried in decades, then in thirds and ninths of a decade around the best, at the final scale.
    The score is the mean of min(|r|, 3 s): a few outliers, or edges that no model gets right,
    do not decide.

    Parameters
    ----------
    solve : (lambda, weight [frame row col]) -> HR image
    """
    drawn = np.random.default_rng(seed).random(y.shape) < HELD_OUT
    held = drawn & (weight > 0)
    if not held.any():
        raise ValueError("too few valid pixels for cross-validation; give prior_weight a number")
    training = np.where(held, 0.0, weight)
    residuals: dict[float, Array] = {}

    def try_weights(exponents: Array) -> float:
        for exponent in exponents:
            value = float(np.round(exponent, 6))
            if value not in residuals:
                image = solve(10.0**value, training)
                residuals[value] = np.abs(y - A.forward(image))[held]
                if on_trial is not None:
                    on_trial(len(residuals), float(np.mean(residuals[value])))
        clip = CLIP_SIGMAS * min(robust_scale(np.concatenate([r, -r])) for r in residuals.values())
        return min(residuals, key=lambda value: float(np.mean(np.minimum(residuals[value], clip))))

    best = try_weights(np.arange(-6.0, 0.1, 1.0))
    for step in (1 / 3, 1 / 9):
        best = try_weights(best + step * np.array([-2, -1, 1, 2]))
    return float(10.0**best)
