"""How much less is known of a picture behind the spot of a lens than behind a pixel alone."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.order import median
from lensshift.reconstruction.problem import Problem, blur_width_px

_LARGEST_PX = 64.0  # structures larger than this add no more, as in `optics.picture`
_WAVES = 32  # frequencies along each axis
_WIDTHS = 32  # at which it is computed; it bends little between


def wider_behind_spots(problem: Problem, sigma: Floats) -> Floats:
    """Return by what factor [row col] errors of brightness grow behind the spots of a lens field.

        e^2(v) = integral T^2 S / (1 + K S exp(-4 pi^2 v f^2) / N) df,    factor = e(v) / e(v_0)

    the error of the best linear estimate of a scene with the power S ~ 1 / (f_0^2 + f^2) of natural
    ones from K frames of noise N, T the pixels of the picture, v the variance of the response and
    v_0 that of the pixel alone, which the prior is told and believes.

    Parameters
    ----------
    sigma : [frame row col] noise of each LR pixel, of each component if it has two; infinite where
        a pixel is not used

    Sources: N. Wiener, Extrapolation, Interpolation, and Smoothing (1949); the power of scenes:
    D. J. Field, J. Opt. Soc. Am. A 4 (1987) 2379.
    """
    model, used = problem.model, np.isfinite(sigma) & (problem.weight > 0)
    if model.spot_px2 is None:
        return np.ones(model.hr_shape)
    noise = max(median(sigma[used]), 1e-15) ** 2
    told = model.frames * max(float(np.var(np.abs(problem.y[used]))) / noise, 1.0)
    spot_px2 = np.maximum(model.spot_px2[..., :2].mean(axis=(0, 3)), 0.0)
    widths_px2 = np.linspace(0.0, max(float(spot_px2.max()), 1e-9), _WIDTHS)
    pixel_px2 = blur_width_px(model.blur) ** 2
    left = np.array([_left(pixel_px2 + more, model.scale, told) for more in widths_px2])
    factor = np.interp(spot_px2, widths_px2, np.sqrt(left / left[0]))
    return np.asarray(factor.repeat(model.scale, axis=0).repeat(model.scale, axis=1))


def _left(variance_px2: float, scale: int, told: float) -> float:
    """Return the mean square error over the variance of the scene, which is `told` noises."""
    highest_cpp = 0.5 * scale
    f = (np.arange(_WAVES) + 0.5) / _WAVES * highest_cpp
    square = f[:, None] ** 2 + f**2
    scene = 1.0 / (_LARGEST_PX**-2 + square)
    scene /= np.pi * np.log1p((highest_cpp * _LARGEST_PX) ** 2)
    wanted = np.outer(np.sinc(f / scale), np.sinc(f / scale)) ** 2 * scene
    passed = np.exp(-4.0 * np.pi**2 * variance_px2 * square)
    return float(np.sum(wanted / (1.0 + told * scene * passed)))
