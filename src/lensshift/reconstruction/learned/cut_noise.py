"""Noise that is cut off at the dark end, as by cameras that subtract all of their dark level.

Frames are too bright there on average, by up to 0.4 of the noise s, and vary by as little as 0.58
of it. Both together tell the noise, and so the light m:

    E max(m + n, 0) = s (u cdf(u) + pdf(u)),   u = m / s
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.special import ndtr

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.reconstruction.clipping import AROUND_PX, CUT_SHARE, TELLING_SHARE
from lensshift.reconstruction.learned.noise import estimated_noise, light_step
from lensshift.reconstruction.noise_law import NoiseLaw
from lensshift.reconstruction.problem import Problem

# Light over noise, and mean and deviation of what is left: below nothing is, above nothing is cut.
_LIGHT = np.linspace(-4.0, 6.0, 1001)
_MEAN = _LIGHT * ndtr(_LIGHT) + np.exp(-(_LIGHT**2) / 2) / math.sqrt(2 * math.pi)
_SPREAD = np.sqrt(_LIGHT * _MEAN + ndtr(_LIGHT) - _MEAN**2)
# By how much that mean is more than the light, which is no less than 0; and -dm / ds of that light.
_TOO_BRIGHT, _BY_SIGMA = _MEAN - np.maximum(_LIGHT, 0.0), _MEAN / ndtr(_LIGHT) - _LIGHT
# On levels farther apart, of their noise, numbers may be counts of photons: there are none below 0.
COARSE = 0.5
# The noise is read where it is darkest, to so much of itself (125 bursts, rms).
DARKEST, READ_TO = 0.25, 0.1


def before_the_cut(
    problem: Problem, picture: Callable[[Problem, NoiseLaw], Array]
) -> tuple[Problem, NoiseLaw, Floats] | None:
    """Return the problem as if no noise were cut off, and its noise; None if none surely was.

    And the standard deviation [row col] that this adds. `picture` is what is too bright.
    """
    at_end, cut = _cut_off(problem)
    if problem.clipped is None or not cut.any():
        return None
    clipped, used, end = problem.clipped & ~at_end, problem.weight > 0, problem.y[at_end][0]
    problem = replace(problem, clipped=clipped if clipped.any() else None)
    law = estimated_noise(problem)
    light = np.mean(np.where(used, problem.y - end, 0.0), axis=0)
    light = _around(light) / np.maximum(_around(used.mean(axis=0)), 1e-3)
    dark = float(np.quantile(light[cut], DARKEST))
    left = math.sqrt(float(np.mean(law.variance(np.array(end + dark)))))
    u = np.interp(-left / dark, -_SPREAD / _MEAN, _LIGHT)
    sigma = problem.told or left / float(np.interp(u, _LIGHT, _SPREAD))
    law = law.at_least(sigma)
    image = picture(problem, law)
    seen = (problem.model.operator.forward(image) - end) / sigma
    y = np.where(used, problem.y - sigma * np.interp(seen, _MEAN, _TOO_BRIGHT), 0.0)
    by_sigma = np.interp((image - end) / sigma, _MEAN[_LIGHT >= 0], _BY_SIGMA[_LIGHT >= 0])
    return replace(problem, y=y), law, READ_TO * sigma * by_sigma


def cut_off(problem: Problem) -> str | None:
    """Say that noise was cut off at the dark end of the frames, and what to do, if it was."""
    at_end, cut = _cut_off(problem)
    if not cut.any():
        return None
    end = float(problem.y[at_end][0]) * problem.intensity + problem.level
    return (
        f"noise is cut off at {end:.4g}, where {100 * at_end[problem.weight > 0].mean():.0f} % of "
        "the pixels are: frames are too bright where it is dark, by up to 0.4 of the noise, for "
        "which auto allows (keep some of the dark level)"
    )


def _cut_off(problem: Problem) -> tuple[Mask, Mask]:
    """Return the pixels [frame row col] at the dark end, and where noise was cut [row col].

    There some pixels are at the end and some are not: where all are, somebody put 0.
    """
    y, used = problem.y, problem.weight > 0
    at_end = np.zeros(y.shape, np.bool_) if problem.clipped is None else problem.clipped & used
    at_end &= y == y[used].min()
    share = _around(at_end.mean(axis=0)) / np.maximum(_around(used.mean(axis=0)), 1e-3)
    cut = (share > CUT_SHARE) & (share < 1.0 - CUT_SHARE)
    above = np.where(used, y - y[used].min(), 0.0)
    local = _around(np.mean(above**2, axis=0)) - _around(above.mean(axis=0)) ** 2
    varies = math.sqrt(np.median(local[cut])) if cut.any() else 0.0
    many = max(TELLING_SHARE * np.count_nonzero(used), np.count_nonzero(at_end) / 2)
    sure = np.count_nonzero(at_end[:, cut]) > many and light_step(problem) < COARSE * varies
    return at_end, cut & np.bool_(sure)


def _around(values: Array) -> Array:
    return np.asarray(uniform_filter(values, AROUND_PX))
