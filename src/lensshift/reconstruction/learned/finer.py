"""Pictures that are found with smaller pixels than asked, where the frames see more than theirs.

A picture says of a scene what its pixels hold. Frames that see more than that contradict it, and
draw it to what explains them best with such pixels: the more frames, the worse. With smaller pixels
they agree, and the means over these are what was asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lensshift.core.arrays import Array, Mask
from lensshift.core.types import Estimate
from lensshift.forward.model import ForwardModel
from lensshift.forward.operator import single
from lensshift.reconstruction.learned.solver import Asked, Solution

# The finest grid that a sixth of the bursts of the training had; of finer ones it had few.
FINEST = 4
# One in so many pixels is left out to be predicted. Off by more standard deviations than three are
# outliers and what moved.
LEFT_OUT, MOST_SQUARE = 8, 9.0
# Standard errors that chance hardly reaches.
SURE = 2.0


def finer_grid(model: ForwardModel) -> ForwardModel | None:
    """Return the model with half as large HR pixels, if its frames may tell these apart.

    In at least half of them the middle of an LR pixel of some frame has to lie. Pixels as large as
    those of a frame never hold what it sees, half of the frequencies of which are above theirs.
    """
    scale = 2 * model.scale
    if scale > FINEST:
        return None
    places = {tuple(place) for place in np.floor(scale * (model.mean_offset_px % 1.0)).astype(int)}
    many = 2 * len(places) >= scale**2 or model.scale == 1
    return model.on_grid(scale) if many else None


def seen_finer(asked: Asked, solve: Callable[[Asked], Solution]) -> Asked | None:
    """Return what is asked on the finer grid, if it predicts pixels from all others better."""
    model = finer_grid(asked.model)
    if model is None:
        return None
    # Lines of pixels, others in each frame, that lie the same in mirrored and transposed frames.
    rows, cols = (np.minimum(at, at[::-1]) for at in map(np.arange, asked.y.shape[1:]))
    frame = np.arange(len(asked.y))[:, None, None]
    out = (rows[:, None] + cols + 3 * frame) % LEFT_OUT == 0
    used = np.isfinite(asked.sigma)
    if not np.any(used & out) or not np.any(used & ~out):
        return None
    finer = replace(asked, model=model)
    gain = _squares(asked, out, solve) - _squares(finer, out, solve)
    sure = float(gain.mean()) > SURE * float(gain.std()) / math.sqrt(gain.size)
    return finer if sure else None


def _squares(asked: Asked, out: Mask, solve: Callable[[Asked], Solution]) -> Array:
    """Return the errors, in units of the noise, of pixels that the picture did not know."""
    known = replace(asked, sigma=np.where(out, np.inf, asked.sigma), on_stage=None)
    rest = np.abs(asked.y - asked.model.operator.forward(single(solve(known).image)))
    judged = out & np.isfinite(asked.sigma)
    return np.asarray(np.minimum((rest[judged] / asked.sigma[judged]) ** 2, MOST_SQUARE))


def of_larger_pixels(found: Estimate, std: Array) -> tuple[Estimate, Array]:
    """Return an estimate and its std [.. row col] on the grid of twice the pitch."""
    misfit = None if found.misfit is None else means(found.misfit)
    fine = found.image if found.fine is None else found.fine
    return replace(found, image=means(found.image), misfit=misfit, fine=fine), std_of_means(std)


def means(image: Array) -> Array:
    """Return the means over 2 x 2 pixels [.. row col]."""
    *before, rows, cols = image.shape
    return np.asarray(image.reshape(*before, rows // 2, 2, cols // 2, 2).mean(axis=(-3, -1)))


def std_of_means(std: Array) -> Array:
    """Return the std of means over 2 x 2 pixels as if their errors were one: it is less."""
    return np.asarray(np.sqrt(means(std**2)))
