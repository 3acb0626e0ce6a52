"""The noise of a problem as the learned solver believes it: as told, else as the frames say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.reconstruction.clipping import silent_pixels
from lensshift.reconstruction.frame_noise import with_frames
from lensshift.reconstruction.noise import light_of
from lensshift.reconstruction.noise_law import NoiseLaw, constant_noise, noise_law
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.rounding import shared_rounding, step_of, within_rounding

# Training went down to noise of 2e-4 (SNR 4000); the median standard deviation of a scene is 0.15:
# of less the weights have seen nothing, and errors of the model are larger.
LEAST_SHARE = 2e-4 / 0.15
# Smaller than any noise of numbers in 0 .. 1 that went through a converter of 24 bits.
LEAST_SIGMA = 1e-7
# Shifts that differ less over the sensor are one shift: what they are told to.
EVEN_SHIFT_PX = 0.05
# Noise that is read beside fine detail may be three times the truth (the worst of 232 cases).
UNLIKE = 5.0
# Fewer frames show no frequency that a scene hardly reaches.
LEAST_FRAMES = 3


def noise_of(problem: Problem, known: NoiseLaw | None = None) -> NoiseLaw:
    """Return the noise of an LR pixel in units of the problem: as told, else as the frames say.

    `known` is what they said before, in units of the burst.
    """
    if known is None:
        return estimated_noise(problem)
    return known.scaled(1 / problem.intensity, -problem.level / problem.intensity)


def noise_map(problem: Problem, known: NoiseLaw | None = None) -> tuple[NoiseLaw, float, Floats]:
    """Return law, least noise that is believed, and the noise [frame row col] of each LR pixel.

    Infinite where a pixel must not be used.
    """
    law, used = noise_of(problem, known), problem.weight > 0
    rounding = light_step(problem) / math.sqrt(12)
    least = max(LEAST_SHARE * float(np.std(problem.y[used])), LEAST_SIGMA, rounding)
    variance = np.maximum(law.variance(light_of(problem.y, used)), least**2)
    variance = variance / np.where(used, problem.weight, 1.0)
    return law, least, np.where(used, np.sqrt(variance), np.inf)


def doubt_about_noise(problem: Problem) -> str | None:
    """Say that the frames show another noise than was told, if they surely do."""
    if problem.noise_sigma is None or not problem.even_noise:
        return None
    law = estimated_noise(replace(problem, noise_sigma=None))
    ratio = problem.noise_sigma / max(law.sigma, LEAST_SIGMA)
    if 1 / UNLIKE < ratio < UNLIKE or (ratio < 1.0 and law.ceiling):
        return None
    told, shown = (sigma * problem.intensity for sigma in (problem.noise_sigma, law.sigma))
    return (
        f"noise_sigma {told:.3g} is not what the frames show, which is {shown:.3g}: it is the "
        "deviation of a pixel in units of the frames; leave it out to have it read"
    )


def rounded_std(problem: Problem, law: NoiseLaw) -> float:
    """Return the error that all pixels of a surface share since their numbers are on levels."""
    return float(shared_rounding(light_step(problem), np.array(law.sigma)))


def tells_little(problem: Problem) -> bool:
    """Return whether the frames of light differ by the rounding of their numbers alone."""
    light = problem.y.dtype.kind != "c"
    return light and within_rounding(_as_sent(problem), problem.weight > 0)


def light_step(problem: Problem) -> float:
    """Return the distance between the levels that light is on, 0 if it is on none."""
    if problem.y.dtype.kind == "c":
        return 0.0
    return step_of(_as_sent(problem), problem.weight > 0) / problem.intensity


def _as_sent(problem: Problem) -> Array:
    stray, y = problem.stray_light, problem.y
    seen = y if stray is None else stray.added(y)
    return np.asarray(seen * problem.intensity + problem.level)


def estimated_noise(problem: Problem) -> NoiseLaw:
    """Return the noise of an LR pixel as told, else as the frames say."""
    told = problem.noise_sigma if problem.noise_sigma is not None else problem.told_sigma
    if told is not None:
        return constant_noise(told)
    y, weight, model = problem.y, problem.weight, problem.model
    plain = problem.even_noise and model.shift_spread_px < EVEN_SHIFT_PX
    some = np.any(weight > 0, axis=(1, 2))
    if plain and np.count_nonzero(some) >= LEAST_FRAMES:
        silent = None if y.dtype.kind == "c" else silent_pixels(y, problem.clipped)[some]
        at, blur_px = problem.offset_px, problem.blur_sigma_px
        law = noise_law(at[some], y[some], weight[some], blur_px, silent)
        if law is not None:
            # Fine texture all over is in some frames more than in others, as noise would be.
            return law if law.ceiling else with_frames(law, at, y, problem.telling_weight, blur_px)
    return constant_noise(problem.shown_noise.sigma, ceiling=problem.even_noise)
