"""The width of the pixel response, read from the frames where nobody told it.

    log p(w | y) = log p(w) + sum over places i of l_i(w) + const

A small network looks at a picture of half the pitch and says at each place how likely each width is
there: of an even surface nothing, of a sharp edge how wide the response is that drew it, and of a
soft edge that no response is wider. It was trained on worlds of which a quarter is out of focus as
a whole and many have no edge (`training/response.py`), so that where frames do not tell, the
spread of p says so. Pixel and lens are one to it, as in `psf_sigma_px`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from lensshift.core.arrays import Array, Floats
from lensshift.core.order import median
from lensshift.forward.model import ForwardModel
from lensshift.reconstruction.learned.chain import Chain
from lensshift.reconstruction.learned.kernels import COMPILED
from lensshift.reconstruction.learned.network import fold, learned_weights
from lensshift.reconstruction.learned.solver import facts_of
from lensshift.reconstruction.learned.turn import turn_of

# Of the form that the weights were trained in (training/response.py); not to be tuned.
SCALE, ASSUMED_PX, AROUND_HR_PX, VOTE = 2, 0.2, 5, 0.1
# A part of a large sensor tells enough, at a bounded price.
WINDOW_PX = 160


@dataclass(frozen=True, slots=True)
class Response:
    """A Gaussian width of the response and its standard deviation, LR pixels."""

    width_px: float
    std_px: float


def likely_response(model: ForwardModel, y: Array, sigma: Floats) -> Response:
    """Return the mean and the spread of p(w | y).

    Parameters
    ----------
    model : of half the pitch, with a Gaussian response of `ASSUMED_PX`
    y : [frame row col] real
    sigma : [frame row col] noise of each LR pixel, infinite where it must not be used
    """
    rows, cols = (slice(start := max(0, (n - WINDOW_PX) // 2), min(n, start + WINDOW_PX))
                  for n in model.lr_shape)  # fmt: skip
    if not np.isfinite(sigma[:, rows, cols]).any():  # a hole in the middle of the sensor
        rows, cols = (slice(0, n) for n in model.lr_shape)
    part = model.crop(rows, cols)
    seen = pictures_of(part, y[None, :, rows, cols], sigma[None, :, rows, cols])
    (network, *_), numbers = learned_weights("response")
    turned = fold(np, [turn_of(model.mean_offset_px).there(np, picture) for picture in seen])
    facts = facts_of(ASSUMED_PX * SCALE, SCALE, len(y))
    told = COMPILED.applied(network, [turned], facts)[0, 1:-1, 1:-1]
    log = numbers["prior"] + VOTE * np.sum(told, axis=(0, 1), dtype=np.float64)
    p = np.exp(log - log.max())
    p, widths = p / p.sum(), numbers["widths"]
    mean = float(p @ widths)
    return Response(mean, float(np.sqrt(p @ (widths - mean) ** 2)))


def known_widths_px() -> tuple[float, float]:
    """Return the least and the greatest width that the reader knows."""
    widths = learned_weights("response")[1]["widths"]
    return float(widths[0]), float(widths[-1])


def pictures_of(model: ForwardModel, y: Array, sigma: Floats) -> list[Array]:
    """Return what the network sees [burst row col] of bursts of one geometry.

    The picture without its local mean, what the frames want of it and leave of it, and the noise,
    each over its contrast around; and 1.

    Parameters
    ----------
    y, sigma : [burst frame row col], as in `likely_response`
    """
    used = np.isfinite(sigma)
    unit, level = (
        np.array([function(values[on]) for values, on in zip(all_, used, strict=True)])
        for function, all_ in ((np.mean, sigma), (median, y))
    )
    unit, level = unit[:, None, None, None], level[:, None, None, None]
    relative = np.where(used, sigma / unit, 1.0).astype(np.float32)
    z = np.where(used, (y - level) / unit, 0.0).astype(np.float32)
    weight = (used / relative**2).astype(np.float32)
    A, none = COMPILED.operator(model), np.empty(0, np.float32)
    turn = turn_of(model.mean_offset_px)
    chain = Chain(A, z, relative, weight, none, model.scale, turn, COMPILED)
    density = chain.seen(weight)
    v, _ = chain.start(density, learned_weights("brightness")[1])
    mass, r = density + chain.floor, z - A.forward(v)
    noise = 1 / np.sqrt(mass)
    left = np.sqrt(np.maximum(A.adjoint(weight * r * r) / mass, 0))
    apart = v - _around(v)
    contrast = np.sqrt(_around(apart**2) + noise**2)
    pictures = (apart, 8 * A.adjoint(weight * r) / mass, left, noise, contrast)
    return [(picture / contrast).astype(np.float32) for picture in pictures]


def _around(picture: Array) -> Array:
    """Return the mean over a window [burst row col]."""
    return np.asarray(uniform_filter(picture, (0, AROUND_HR_PX, AROUND_HR_PX), mode="nearest"))
