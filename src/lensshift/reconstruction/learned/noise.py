"""The noise of a problem as the learned solver believes it: as told, else as the frames say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.reconstruction.clipping import silent_pixels
from lensshift.reconstruction.learned.memory import Memory
from lensshift.reconstruction.noise import estimate_noise, light_of
from lensshift.reconstruction.noise_law import NoiseLaw, constant_noise, noise_law
from lensshift.reconstruction.problem import Problem

# Training went down to noise of 2e-4 (SNR 4000); the median standard deviation of a scene is 0.15:
# of less the weights have seen nothing, and errors of the model are larger.
LEAST_SHARE = 2e-4 / 0.15
# Smaller than any noise of numbers in 0 .. 1 that went through a converter of 24 bits.
LEAST_SIGMA = 1e-7
# Shifts that differ less over the sensor are one shift: what they are told to.
EVEN_SHIFT_PX = 0.05
# Fewer frames show no frequency that a scene hardly reaches.
LEAST_FRAMES = 3


def noise_of(
    problem: Problem, memory: Memory | None = None, known: NoiseLaw | None = None
) -> NoiseLaw:
    """Return the noise of an LR pixel in units of the problem: as told, else as the frames say.

    `known` is what they said before, in units of the burst; what is remembered goes before it.
    """
    recalled = None if memory is None else memory.recalled()
    known = known if recalled is None else recalled
    law: NoiseLaw = (
        _estimated_noise(problem)
        if known is None
        else known.scaled(1 / problem.intensity, -problem.level / problem.intensity)
    )
    if memory is not None:
        memory.keep(law.scaled(problem.intensity, problem.level))
    return law


def noise_map(
    problem: Problem, memory: Memory | None = None, known: NoiseLaw | None = None
) -> tuple[NoiseLaw, float, NDArray[np.float64]]:
    """Return law, least noise that is believed, and the noise [frame row col] of each LR pixel.

    Infinite where a pixel must not be used.
    """
    law, used = noise_of(problem, memory, known), problem.weight > 0
    least = max(LEAST_SHARE * float(np.std(problem.y[used])), LEAST_SIGMA)
    variance = np.maximum(law.variance(light_of(problem.y, used)), least**2)
    variance = variance / np.where(used, problem.weight, 1.0)
    return law, least, np.where(used, np.sqrt(variance), np.inf)


def _estimated_noise(problem: Problem) -> NoiseLaw:
    told = problem.noise_sigma if problem.noise_sigma is not None else problem.told_sigma
    if told is not None:
        return constant_noise(told)
    y, weight, model = problem.y, problem.weight, problem.model
    plain = problem.even_noise and model.shift_spread_px < EVEN_SHIFT_PX
    some = np.any(weight > 0, axis=(1, 2))
    if plain and np.count_nonzero(some) >= LEAST_FRAMES:
        silent = None if y.dtype.kind == "c" else silent_pixels(y, problem.clipped)[some]
        law = noise_law(
            problem.offset_px[some], y[some], weight[some], problem.blur_sigma_px, silent
        )
        if law is not None:
            return law
    weight = problem.telling_weight
    return constant_noise(estimate_noise(model.operator, y, weight, even=problem.even_noise).sigma)
