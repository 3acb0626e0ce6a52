"""Which LR pixels, and which frames, to believe."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

HUBER_SIGMAS = 2.0
# A frame whose median residual exceeds this (of a range of 0 .. 1) has another brightness.
BIAS_LIMIT = 0.02
# Noise alone moves no median by so many of its standard errors, 1.253 x 1.483 |r| / sqrt(n).
BIAS_SIGMAS, MEDIAN_ERROR = 4.0, 1.858
# A frame whose residual is wider than that of the median frame by more than this loses weight.
SPREAD_LIMIT, SPREAD_POWER = 1.5, 10


def confidence(residual: Array, weight: Array, scale: Array | float) -> NDArray[np.float64]:
    """Return a confidence in 0 .. 1 for each LR pixel.

        min(1, 2 scale / |r|) * [|median r_k| < 0.02] * min(1, 1.5 median_k(s_k) / s_k)^10

    Parameters
    ----------
    residual, weight : [frame row col]; pixels of weight 0 are not counted
    scale : [frame row col] or one number, the standard deviation expected of the residual
    """
    size = np.abs(residual)
    pixel = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(size, 1e-300))
    return np.asarray(pixel * frame_confidence(residual, weight)[:, None, None])


def frame_confidence(residual: Array, weight: Array) -> NDArray[np.float64]:
    """Return a confidence in 0 .. 1 for each frame, from the bias and the spread of its residual.

    Frames that stand alone, or all of which are odd, keep their weight.
    """
    used = weight > 0
    seen = np.any(used, axis=(1, 2))
    bias, spread, error = np.zeros((3, len(residual)))
    for k in np.flatnonzero(seen):
        values = residual[k][used[k]]
        bias[k] = abs(np.median(values.real))
        spread[k] = np.median(np.abs(values))
        error[k] = MEDIAN_ERROR * spread[k] / np.sqrt(values.size)
    even = bias < np.maximum(BIAS_LIMIT, BIAS_SIGMAS * error)
    if not np.any(even & seen):
        return np.asarray(seen, np.float64)
    typical = np.median(spread[even & seen])
    limit = SPREAD_LIMIT * typical
    narrow = np.where(spread <= limit, 1.0, limit / np.maximum(spread, 1e-300))
    return np.asarray(even * seen * narrow**SPREAD_POWER, np.float64)
