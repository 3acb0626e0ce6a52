"""Filling pixels that nothing is known of from those around them."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Array, Floats

_FIRST_SIGMA_PX = 0.7
_REACH = 3.0


def fill_holes(image: Array, weight: Floats, variance: Floats) -> tuple[Array, Floats]:
    """Fill pixels of weight 0 by normalised convolution; return image and variance.

        x = (G * w v) / (G * w),   var x = (G^2 * w^2 var v) / (G * w)^2

    G is a Gaussian of 0.7 px, made twice as wide as often as a hole needs to see a known pixel.
    Known pixels stay what they are.

    Parameters
    ----------
    image, weight, variance : [row col]; values where the weight is 0 are not looked at

    Raises
    ------
    ValueError
        If every weight is 0.

    Source: Knutsson and Westin, Normalized and differential convolution, CVPR (1993).
    """
    from scipy.ndimage import correlate1d

    hole = weight == 0
    if hole.all():
        raise ValueError("every pixel has weight 0; nothing is left to use")
    filled, spread = np.where(hole, 0.0, image), np.where(hole, 0.0, variance)
    known, known_variance = weight * filled, weight**2 * spread
    sigma_px = _FIRST_SIGMA_PX
    while hole.any():
        radius = int(np.ceil(_REACH * sigma_px))
        taps = np.exp(-(np.arange(-radius, radius + 1) ** 2) / (2 * sigma_px**2))

        def smooth(values: Array, kernel: Floats) -> Array:
            rows = correlate1d(values, kernel, axis=0, mode="constant")
            return np.asarray(correlate1d(rows, kernel, axis=1, mode="constant"))

        total = smooth(weight, taps)
        reached = hole & (total > 0)
        filled[reached] = smooth(known, taps)[reached] / total[reached]
        spread[reached] = smooth(known_variance, taps**2)[reached] / total[reached] ** 2
        hole = hole & ~reached
        sigma_px *= 2.0
    return filled, spread
