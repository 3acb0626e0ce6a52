"""Quantiles of few numbers, in a tenth of the time in which NumPy looks at what it was asked."""

from __future__ import annotations

import math

import numpy as np

from lensshift.core.arrays import Array


def quantile(ordered: Array, share: float) -> Array:
    """Return the quantile along the last axis of values that are in order, as `numpy.quantile`."""
    at = share * (ordered.shape[-1] - 1)
    below = ordered[..., int(at)]
    return np.asarray(below + (at % 1) * (ordered[..., math.ceil(at)] - below))


def median(values: Array) -> float:
    """Return the median of all values, none of them NaN, as `numpy.median`."""
    middle = (values.size - 1) // 2, values.size // 2
    ordered = np.partition(values, middle, axis=None)
    return float(0.5 * ordered[middle[0]] + 0.5 * ordered[middle[1]])


def median_of_known(values: Array, axis: int) -> Array:
    """Return the median along an axis of what is not NaN there, as `numpy.nanmedian`.

    Something has to be known everywhere.
    """
    ordered = np.sort(values, axis=axis)  # NaN last
    last = np.count_nonzero(ordered == ordered, axis=axis, keepdims=True) - 1
    middle = [np.take_along_axis(ordered, at, axis) for at in (last // 2, (last + 1) // 2)]
    return np.asarray(np.mean(middle, axis=0).squeeze(axis))
