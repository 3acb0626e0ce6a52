"""Taking off what stays at the pixels: the pattern that a picture does not explain, step by step.

    x = picture of the frames y - f, with noise sigma^2 + n left
    f = w (f + mean_k (y_k - f - A_k x)),   w = P / (P + sigma^2 / K),

P the variance of the pattern (`fixed_pattern`), n of how many frames an HR pixel sees each pixel.
What is left of it is P - var f, as of any best guess, and the standard error of P: what is smooth
over the pixels cannot be told from the scene.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.types import Burst
from lensshift.forward.operator import single
from lensshift.reconstruction.clipping import clipped_pixels
from lensshift.reconstruction.fixed_pattern import pattern_power
from lensshift.reconstruction.learned.noise import noise_map
from lensshift.reconstruction.learned.solver import Asked, solve_together
from lensshift.reconstruction.problem import SQUARE_PIXEL_PX, make_blur, make_problem

# A strong pattern passes for a scene between the pixels, and comes off little by little.
MOST_STEPS = 8


def without_pattern(
    burst: Burst, part: Burst, scale: int, *, stacklevel: int = 2
) -> tuple[Burst, Burst, float, dict[str, float]]:
    """Return the frames without their fixed pattern, if they surely have one.

    Parameters
    ----------
    burst, part : the second has the used frames alone, by which the pattern is found

    Returns
    -------
    burst, part, left, settings
        `left` is the standard deviation of what is left of the pattern; settings are what a result
        should say of it

    Warns
    -----
    QualityWarning
        Of the pattern.
    """
    y = part.amplitude
    power = None if y.dtype.kind == "c" else pattern_power(y, part.valid, part.offset_px)
    if power is None or not power.certain:
        return burst, part, 0.0, {}
    pattern, variance = _taken_off(part, scale, power.variance)
    variance += power.variance / power.sure  # by as much the frames may have told too little of it
    size, left = float(np.sqrt(power.variance)), float(np.sqrt(variance))
    warn_quality(
        "the pixels have a pattern of their own that does not move with the scene, of about "
        f"{size:.3g} (rms): it is taken off as far as the frames tell it, and std holds the "
        f"{left:.2g} that may be left; subtract a dark frame (covered lens), which knows all of "
        "it. Or the scene did not move as offset_px says",
        stacklevel + 1,
    )
    burst, part = (_less(one, pattern) for one in (burst, part))
    return burst, part, left, {"fixed_pattern_std": size, "fixed_pattern_left": left}


def _taken_off(part: Burst, scale: int, variance: float) -> tuple[Floats, float]:
    """Return the pattern [row col] as far as the frames tell it, and the variance of its rest."""
    pattern, left = np.zeros(part.grid.shape), variance
    apart_px = np.abs(part.offset_px[:, None] - part.offset_px)
    # So many frames see a place by one pixel, on average, and share its error.
    seen_by = float(np.clip(1.0 - apart_px, 0.0, None).prod(axis=-1).sum(axis=1).mean())
    for _ in range(MOST_STEPS):
        rest, noise = _unexplained(_less(part, pattern), scale, seen_by * left)
        least = variance * noise / (variance + noise)
        found = variance / (variance + noise) * (pattern + rest)
        found -= found.mean()
        remains = max(variance - float(np.var(found)), least)
        if remains >= left:
            break
        pattern, left = found, remains
    return pattern, left


def _unexplained(part: Burst, scale: int, extra: float) -> tuple[Floats, float]:
    """Return what a picture leaves [row col] of the frames on average, and the noise of that.

    Parameters
    ----------
    extra : variance that the frames have beside the noise that is read
    """
    problem = make_problem(
        part, part.amplitude, scale, blur=make_blur(SQUARE_PIXEL_PX, None), shift_field=None,
        noise_sigma=None, take_level=True,
    )  # fmt: skip
    law, _, noise = noise_map(problem)
    unit, A = problem.intensity, problem.model.operator
    sigma = np.sqrt(noise**2 + extra / unit**2)
    found = solve_together([Asked(problem.model, problem.y, sigma, SQUARE_PIXEL_PX)])[0]
    weight = problem.telling_weight
    rest = np.sum(weight * (problem.y - A.forward(single(found.image))), axis=0)
    count = np.maximum(weight.sum(axis=0), 1.0)
    return unit * rest / count, float((unit * law.sigma) ** 2 / np.median(count))


def _less(burst: Burst, pattern: Floats) -> Burst:
    """Return the burst without the pattern; what was cut off at an end of the range stays there."""
    values = burst.amplitude.astype(np.float64)
    less, clipped = values - pattern, clipped_pixels(burst.amplitude, burst.valid)
    if clipped is not None:
        seen = values[burst.valid]
        less = np.where(clipped, values, np.clip(less, seen.min(), seen.max()))
    return replace(burst, amplitude=less)
