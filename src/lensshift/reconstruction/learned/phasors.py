"""What the frames add to a picture of phasors: local means, and texture of surfaces.

Phasors of one surface have one phase, and along it they are light that pixels average. The weights
for phasors were trained where surfaces mix and draw fine texture soft; those for brightness know
texture, but no mixtures. Which of the two a place is, its frames say.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.special import expit

from lensshift.forward.operator import LinearOperator, single
from lensshift.reconstruction.displacement import ALLOWED_SHIFT_PX, WINDOW_PX, slopes_of
from lensshift.reconstruction.learned.solver import Asked, Solution, Texture

Array = NDArray[Any]

# Width of a mean, LR pixels, that is left to the frames: some 30 pixels of each. The noise of white
# frames through 2 g - g * g, g a Gaussian of width s, is this over 4 pi s^2.
LOW_PASS_PX, OF_TWO_PASSES = 1.5, 11 / 6
# Of the amplitude that it had, so that a phase is left where light was drawn below none.
LEAST_LEFT = 1e-3


def finished(
    asked: Asked,
    found: Solution,
    scale: int,
    solve: Callable[[Asked], Solution],
    rests: Texture | None,
) -> Solution:
    """Return the picture with the means of its frames and the texture of its surfaces.

    Parameters
    ----------
    asked, found, scale, solve : as in `with_texture`; found.std is [2 row col] at least, and
        [3 row col] afterwards, the third what both have from the means
    rests : the texture, if nothing has changed since it was found
    """
    weight = found.weight / np.where(np.isfinite(asked.sigma), asked.sigma, np.inf) ** 2
    image, of_means = with_means_of(
        asked.model.operator, found.image, asked.y, weight, LOW_PASS_PX * scale
    )
    std = np.stack([*np.hypot(found.std[:2], of_means), of_means])
    found = replace(found, image=image, std=std)
    if rests is None:
        return with_texture(asked, found, scale, solve)
    std[0] = rests.std
    return replace(found, image=image * rests.ratio, texture=rests)


def with_means_of(
    A: LinearOperator, image: Array, y: Array, weight: Array, low_hr_px: float
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return phasors whose local means agree with the frames, and the std that those leave.

        x <- x + G A^T W (y - A x) / G A^T W 1,   twice;   G a Gaussian low pass of width s
        std^2 = 11/6 / (4 pi s^2  G A^T W 1)

    The prior has the last word of a phasor, and draws a dark surface a little to the bright ones
    around it. Over many pixels the frames know better, whatever the errors of the shifts.

    Parameters
    ----------
    weight : [frame row col] inverse variance, 0 where a pixel is not believed
    low_hr_px : width of the low pass
    """
    from scipy.ndimage import gaussian_filter

    y, weight = single(y), single(weight)
    known = gaussian_filter(A.adjoint(weight), low_hr_px)
    least = 1e-9 * float(known.max())
    seen, known = known > least, np.maximum(known, least)
    for _ in range(2):
        rest = A.adjoint(weight * (y - A.forward(single(image))))
        image = image + gaussian_filter(rest, low_hr_px) / known
    of_noise = OF_TWO_PASSES / (4 * math.pi * low_hr_px**2)
    return np.asarray(image), np.where(seen, np.sqrt(of_noise / known), 0.0)


def mean_hr_px(scale: int) -> float:
    """Return how many HR pixels of white noise a mean of `with_means_of` is as good as."""
    return 4 * math.pi * (LOW_PASS_PX * scale) ** 2 / OF_TWO_PASSES


def with_texture(
    asked: Asked, found: Solution, scale: int, solve: Callable[[Asked], Solution]
) -> Solution:
    """Return the phasors with the amplitudes that explain the frames, of two for each pixel.

        a' = (1 - w) a + w b,   w = p / t_b^2 / (p / t_b^2 + (1 - p) / t_a^2)
        p = 1 / (1 + exp((Q_b - Q_a) / 2)),   Q = sum |y - A x|^2 / s^2
        t'^2 = (1 - w) t_a^2 + w t_b^2 + w (1 - w) (a - b)^2

    a +- t_a the amplitude of the picture, b +- t_b that of frames turned to its phase, both with
    its phase; Q over a window of all frames, s^2 with what shifts may be off. That is the mean over
    two models, each as sure as it says; both explain what the frames do not tell apart.

    Parameters
    ----------
    asked : frames of phasors
    found : their picture
    scale : HR pixels per LR pixel
    solve : finds the picture of frames
    """
    A, used = asked.model.operator, np.isfinite(asked.sigma)
    before = single(found.image)
    seen = A.forward(before)
    along = np.where(used, asked.y, 0) * seen.conj() / np.maximum(np.abs(seen), 1e-12)
    texture = solve(replace(asked, y=along.real, on_stage=None, held=None))
    a = np.abs(found.image)
    b = np.maximum(texture.image, LEAST_LEFT * a)
    p = _odds(A, asked, (before, single(found.image * (b / np.maximum(a, 1e-12)))), scale)
    std = found.std.copy()
    of_a, of_b = std[0] ** 2, texture.std**2
    w = p * of_a / np.maximum(p * of_a + (1 - p) * of_b, 1e-300)
    ratio = ((1 - w) * a + w * b) / np.maximum(a, 1e-12)
    std[0] = np.sqrt((1 - w) * of_a + w * of_b + w * (1 - w) * (a - b) ** 2)
    return replace(found, image=found.image * ratio, std=std, texture=Texture(ratio, std[0]))


def _odds(A: LinearOperator, asked: Asked, pictures: tuple[Array, Array], scale: int) -> Array:
    """Return [row col] the probability of the second picture, by what the frames around say."""
    used = np.isfinite(asked.sigma)
    contrast = np.maximum(*(slopes_of(A, picture, scale)[1] for picture in pictures))
    variance = np.where(used, asked.sigma, np.inf) ** 2 + ALLOWED_SHIFT_PX**2 / 2 * contrast
    squares = (np.abs(asked.y - A.forward(picture)) ** 2 / 2 / variance for picture in pictures)
    apart = np.subtract(*(np.where(used, square, 0.0).sum(axis=0) for square in squares))
    around = WINDOW_PX**2 * uniform_filter(apart, WINDOW_PX, mode="constant")
    odds = single(np.broadcast_to(expit(around / 2), used.shape) * used)
    return np.asarray(A.adjoint(odds) / np.maximum(A.adjoint(single(used)), 1e-9), np.float64)
