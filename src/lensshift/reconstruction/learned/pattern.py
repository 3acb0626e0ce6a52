"""Taking off what stays at the pixels: the pattern that a picture does not explain, step by step.

    x = picture of the frames y - f, with noise sigma^2 + n left
    f = w (f + mean_k (y_k - f - A_k x)),   w = P / (P + sigma^2 / K),

P the variance of the pattern (`fixed_pattern`), n of how many frames an HR pixel sees each pixel.
What is left of it is P - var f, as of any best guess, and the standard error of P: what is smooth
over the pixels cannot be told from the scene. Of phasors f is a phase, y exp(-i f), of which frames
leave arg(y / A x), with noise sigma / |A x|; each frequency has its own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.core.errors import warn_quality
from lensshift.core.types import Burst
from lensshift.core.units import distance_to_phase
from lensshift.forward.operator import single
from lensshift.reconstruction.clipping import clipped_pixels
from lensshift.reconstruction.fixed_pattern import PatternPower, pattern_power
from lensshift.reconstruction.learned.method import with_shift_errors
from lensshift.reconstruction.learned.noise import noise_map
from lensshift.reconstruction.learned.solver import Asked, solve_together
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.phasor.common_light import divided
from lensshift.reconstruction.phasor.frames import phasors_of
from lensshift.reconstruction.problem import SQUARE_PIXEL_PX, make_blur, make_problem

# A strong pattern passes for a scene between the pixels, and comes off little by little.
MOST_STEPS = 8
SAID = (
    ", of about {} (rms): it is taken off as far as the frames tell it, and std holds the {} that "
    "may be left; {}. Or the scene did not move as offset_px says"
)
NAMES = (
    "the pixels have a pattern of their own that does not move with the scene",
    "the pixels have a pattern of distances of their own that does not move with the scene",
)
# Of phases, radians: what single precision leaves of them without noise is far less.
LEAST_RAD = 1e-5


def without_pattern(
    burst: Burst, request: Request, scale: int, *, phasors: bool = False, stacklevel: int = 2
) -> tuple[Burst, Request, dict[str, Any]]:
    """Return the frames without their fixed pattern, of light or of distances, if surely there.

    It is found by the used frames, whose numbers the request has. That gets the standard deviation
    of what is left of it; and the settings of a result say so.

    Warns
    -----
    QualityWarning
        Of the pattern.
    """
    part = burst.select(request.frames)
    if not phasors and part.amplitude.dtype.kind == "c":
        return burst, request, {}
    every, hz = phasors_of(part) if phasors else (part.amplitude[None], (1.0,))
    pattern, size, left = np.zeros((len(hz), 1, *part.grid.shape)), *np.zeros((2, len(hz)))
    for number, y in enumerate(every):
        shown = np.angle(y * y[part.valid].sum().conj()) if phasors else y
        power = pattern_power(shown, part.valid, part.offset_px, phases=phasors)
        least = LEAST_RAD if phasors else 0.0
        if power is not None and power.certain and power.variance > least**2:
            size[number] = np.sqrt(power.variance)
            pattern[number, 0], left[number] = _taken_off(part, y, scale, power)
    if not size.any():
        return burst, request, {}
    if not phasors:
        cure = "subtract a dark frame (covered lens), which knows all of it"
        of = f"{size[0]:.3g}", f"{left[0]:.2g}", cure
        said = {"fixed_pattern_std": float(size[0]), "fixed_pattern_left": float(left[0])}
        burst, request = _less(burst, pattern[0, 0]), replace(request, still_std=float(left[0]))
    else:
        most = int(np.argmax(size / hz))
        size_m, left_m = np.array([size[most], left[most]]) / distance_to_phase(1.0, hz[most])
        cure = "calibrate the distance of each pixel before a flat wall"
        of = f"{1e3 * size_m:.2g} mm", f"{1e3 * left_m:.2g} mm", cure
        said = {"distance_pattern_m": float(size_m), "distance_pattern_left_m": float(left_m)}
        burst, request = divided(burst, np.exp(1j * pattern)), replace(request, still_rad=left)
    warn_quality(NAMES[phasors] + SAID.format(*of), stacklevel + 1)
    return burst, request, said


def _taken_off(part: Burst, y: Array, scale: int, power: PatternPower) -> tuple[Floats, float]:
    """Return the pattern [row col] as far as the frames tell it, and the std of its rest."""
    variance = left = power.variance
    pattern = np.zeros(part.grid.shape)
    apart_px = np.abs(part.offset_px[:, None] - part.offset_px)
    # So many frames see a place by one pixel, on average, and share its error.
    seen_by = float(np.clip(1.0 - apart_px, 0.0, None).prod(axis=-1).sum(axis=1).mean())
    for _ in range(MOST_STEPS):
        waves = y.dtype.kind == "c"
        less = y * np.exp(-1j * pattern) if waves else _less(part, pattern).amplitude
        rest, noise = _unexplained(part, less, scale, seen_by * left)
        share = variance / (variance + noise)
        found = share * (pattern + rest)
        found -= found.mean()
        remains = max(variance - float(np.var(found)), float(np.mean(share * noise)))
        if remains >= left:
            break
        pattern, left = found, remains
    # By the error of the variance the frames may have told too little of it.
    return pattern, float(np.sqrt(left + variance / power.sure))


def _unexplained(part: Burst, frames: Array, scale: int, extra: float) -> tuple[Floats, Floats]:
    """Return what a picture leaves of frames on average, of phasors their phases, and its variance.

    Extra is the variance that these have beside the noise that is read.
    """
    problem = make_problem(
        part, frames, scale, blur=make_blur(SQUARE_PIXEL_PX, None), shift_field=None,
        noise_sigma=None, take_level=True,
    )  # fmt: skip
    law, _, noise = noise_map(problem)
    y, unit, A = problem.y, problem.intensity, problem.model.operator
    waves = y.dtype.kind == "c"
    sigma = np.sqrt(noise**2 + (extra / 2 * np.abs(y) ** 2 if waves else extra / unit**2))
    sigma = with_shift_errors(sigma, problem) if waves else sigma
    found = solve_together([Asked(problem.model, y, sigma, SQUARE_PIXEL_PX)])[0]
    seen = A.forward(single(found.image))
    if waves:
        weight = (problem.weight > 0) * np.abs(seen / with_shift_errors(noise, problem)) ** 2
        known = np.maximum(weight.sum(axis=0), np.finfo(np.float32).tiny)
        return np.sum(weight * np.angle(y * seen.conj()), axis=0) / known, 1 / known
    weight = problem.telling_weight
    count = np.maximum(weight.sum(axis=0), 1.0)
    rest = unit * np.sum(weight * (y - seen), axis=0) / count
    return rest, np.asarray((unit * law.sigma) ** 2 / np.median(count))


def _less(burst: Burst, pattern: Floats) -> Burst:
    """Return the burst without the pattern; what was cut off at an end of the range stays there."""
    values = burst.amplitude.astype(np.float64)
    less, clipped = values - pattern, clipped_pixels(burst.amplitude, burst.valid)
    if clipped is not None:
        seen = values[burst.valid]
        less = np.where(clipped, values, np.clip(less, seen.min(), seen.max()))
    return replace(burst, amplitude=less)
