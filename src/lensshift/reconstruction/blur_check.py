"""Whether a pixel response that was told is too wide for the frames.

Under too wide a response, sharp frames ask for a picture that rings, and no picture that the solver
believes in explains them: the residual falls when the response is narrower. Too narrow a response
leaves no residual, only a soft picture, and cannot be told from a soft scene.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.operator import single
from lensshift.reconstruction.learned.solver import solve
from lensshift.reconstruction.problem import Problem

Array = NDArray[Any]

# A part of the sensor tells enough, at a bounded price.
WINDOW_PX = 32
# The window cuts the response of its outermost pixels.
RING_PX = 2
# The residual of too wide a response goes with the curvature of the picture: with less than this
# part of it explained so no other width is tried, as in half of the right runs.
EXPLAINED = 0.05
# How much worse the told width has to fit than half of it, and any width than the best to be called
# fitting. In 132 right runs of random worlds the told one was at most 1.14 times worse.
REFUTED, FITTING = 1.2, 1.1
TRIED = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.33)
# Errors of shifts that slopes excuse, told or not, and where a pixel counts as an outlier.
ALLOWED_SHIFT_PX, MOST_SQUARE = 0.05, 25.0


def fitting_width_px(problem: Problem, image: Array, noise: Array, told_px: float) -> float | None:
    """Return a narrower response (LR pixels) that fits the frames clearly better, or None.

    Parameters
    ----------
    problem : frames and the model with the response that is assumed
    image : [row col] the picture under it, in units of the problem
    noise : [frame row col] standard deviations, infinite where a pixel was not used
    told_px : the response that was told, lens included; it may be wider than the assumed one
    """
    model = problem.model
    if model.offset_px is None or not isinstance(model.blur, GaussianBlur):
        return None
    scale = model.scale
    rows, cols = (slice(start := max(0, (n - WINDOW_PX) // 2), min(n, start + WINDOW_PX))
                  for n in model.lr_shape)  # fmt: skip
    y, sigma = problem.y[:, rows, cols].real.copy(), noise[:, rows, cols]
    if not np.isfinite(sigma).any():
        return None

    def solved(width_px: float) -> tuple[ForwardModel, Array]:
        blur = GaussianBlur(width_px)
        part = forward_model(model.lr_shape, scale, model.offset_px, blur=blur).crop(rows, cols)
        # Weights of one geometry have seen too few responses to refute any.
        return part, solve(part, y, sigma, blur_px=width_px, general=True).image

    def misfit(width_px: float) -> float:
        return _misfit(*solved(width_px), y, sigma)

    part, seen = model.crop(rows, cols), image.real[
        rows.start * scale : rows.stop * scale, cols.start * scale : cols.stop * scale
    ]  # fmt: skip
    if TRIED[0] * told_px > model.blur.sigma_px:
        part, seen = solved(told_px)
    if _curved(part, seen, y, sigma) < EXPLAINED:
        return None
    told = _misfit(part, seen, y, sigma)
    if told < REFUTED or told < REFUTED * misfit(0.5 * told_px):
        return None  # what is explained within its noise refutes nothing
    found = [(misfit(part_of * told_px), part_of * told_px) for part_of in TRIED]
    best = min(value for value, _ in found)
    return next(width for value, width in found if value <= FITTING * best)


def _curved(model: ForwardModel, image: Array, y: Array, sigma: Array) -> float:
    """Return the part of the residual that a narrower response would explain at first sight."""
    image = single(image)
    A, padded = model.operator, np.pad(image, 1, mode="edge")
    curvature = padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2]
    bent = A.forward(curvature - 4 * image)
    r, variance, used = _residual(model, image, y, sigma)
    with_it = float(np.sum((bent * r / variance)[used]))
    whole = np.sum((r * r / variance)[used]) * np.sum((bent * bent / variance)[used])
    return with_it**2 / max(float(whole), 1e-300) if with_it < 0 else 0.0


def _misfit(model: ForwardModel, image: Array, y: Array, sigma: Array) -> float:
    r, variance, used = (part[:, RING_PX:-RING_PX, RING_PX:-RING_PX]
                         for part in _residual(model, image, y, sigma))  # fmt: skip
    return float(np.mean(np.minimum((r * r / variance)[used], MOST_SQUARE))) if used.any() else 0.0


def _residual(
    model: ForwardModel, image: Array, y: Array, sigma: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    image = single(image)
    A, used = model.operator, np.isfinite(sigma)
    slopes = [model.scale * A.forward(np.ascontiguousarray(g)) for g in np.gradient(image)]
    excused = ALLOWED_SHIFT_PX**2 * sum(g * g for g in slopes)
    return y - A.forward(image), np.where(used, sigma, 1.0) ** 2 + excused, used
