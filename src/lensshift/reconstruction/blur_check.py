"""Whether a pixel response that was told is too wide for the frames.

Under too wide a response, sharp frames ask for a picture that rings, and no picture that the solver
believes in explains them: the residual falls when the response is narrower. Too narrow a response
leaves no residual, only a soft picture, and cannot be told from a soft scene.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.forward.blur import ApertureBlur, Blur, GaussianBlur
from lensshift.forward.differences import image_slopes
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.operator import single
from lensshift.reconstruction.learned.solver import solve
from lensshift.reconstruction.problem import SQUARE_PIXEL_PX, Problem

Array = NDArray[Any]

# A part of the sensor tells enough, at a bounded price.
WINDOW_PX = 32
# The window cuts the response of its outermost pixels.
RING_PX = 2
# How much worse the told width has to fit than its noise and than half of it, and any width than
# the best to be called fitting.
REFUTED, FITTING = 1.2, 1.1
# Part of the difference between a square and a Gaussian of one width that is excused. With none, 8
# of 32 right runs of random worlds were refuted at SNR 1000; with half of it 1 of 48 of others
# (14 at SNR 3000), and pixels of half the width are seen from SNR 300 instead of 100.
SHAPE = 0.5
TRIED = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.33)
# Responses of one contrast of a half differ in width by a tenth by their shape (a square's is 0.31
# by that and 0.29 by its moment), those behind a lens by more: a width is told no better.
ALIKE = 0.8
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

    def part(blur: Blur) -> ForwardModel:
        return forward_model(model.lr_shape, scale, model.offset_px, blur=blur).crop(rows, cols)

    def solved(width_px: float) -> tuple[ForwardModel, Array]:
        narrower = part(GaussianBlur(width_px))
        # Weights of one geometry have seen too few responses to refute any.
        found = solve(narrower, y, sigma, blur_px=width_px, general=True).image
        return narrower, single(found)

    at_hand = TRIED[0] * told_px <= model.blur.sigma_px
    seen = image.real[
        rows.start * scale : rows.stop * scale, cols.start * scale : cols.stop * scale
    ]
    told = (model.crop(rows, cols), single(seen)) if at_hand else solved(told_px)
    if _misfit(*told, y, sigma) < REFUTED:
        return None  # what is explained within its noise refutes nothing
    half = solved(0.5 * told_px)
    # Pixels are no Gaussians: what a square of that width sees otherwise is no sign of another.
    shape = part(GaussianBlur(told_px)).operator.forward(half[1])
    shape = SHAPE * (shape - part(_square(told_px)).operator.forward(half[1]))

    def misfit(fit: tuple[ForwardModel, Array]) -> float:
        return _misfit(*fit, y, sigma, shape)

    if misfit(told) < REFUTED * max(1.0, misfit(half)):
        return None
    found = [(misfit(solved(part_of * told_px)), part_of * told_px) for part_of in TRIED]
    best = min(value for value, _ in found)
    width_px = next(width for value, width in found if value <= FITTING * best)
    return None if width_px >= ALIKE * told_px else width_px


def _square(width_px: float) -> ApertureBlur:
    """Return the aperture, if it is wider than a pixel behind a lens, of that width."""
    lens_px2 = max(width_px**2 - SQUARE_PIXEL_PX**2, 0.0)
    return ApertureBlur(min(width_px / SQUARE_PIXEL_PX, 1.0), lens_px2**0.5)


def _misfit(
    model: ForwardModel, image: Array, y: Array, sigma: Array, shape: Array | float = 0.0
) -> float:
    """Return the mean square residual over its variance, the ring left out.

    sigma^2 + e^2 |grad A x|^2 + shape^2,   e what shifts may be off by
    """
    A, used = model.operator, np.isfinite(sigma)
    steep = [model.scale * A.forward(np.ascontiguousarray(g)) for g in image_slopes(image)]
    variance = np.where(used, sigma, 1.0) ** 2 + shape**2
    variance = variance + ALLOWED_SHIFT_PX**2 * sum(g * g for g in steep)
    inner = (slice(None), slice(RING_PX, -RING_PX), slice(RING_PX, -RING_PX))
    square = ((y - A.forward(image)) ** 2 / variance)[inner][used[inner]]
    return float(np.mean(np.minimum(square, MOST_SQUARE))) if square.size else 0.0
