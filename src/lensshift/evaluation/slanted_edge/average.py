"""Several edges as one: curves and numbers averaged with their variances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lensshift.core.optical import MtfCurve
from lensshift.evaluation.slanted_edge.result import EdgeResult, Interval

_INTERVAL_SIGMAS = 3.92  # of a normal distribution in its 95 % interval
_LEAST_STD = 1e-6


def usable_edges(results: Sequence[EdgeResult]) -> list[EdgeResult]:
    """Return the edges whose MTF can be trusted; the first alone if there is none."""
    return [result for result in results if result.usable] or list(results[:1])


def average_curves(results: Sequence[EdgeResult]) -> MtfCurve:
    """Return the mean curve; edges count by their mean variance, so that the mean stays an MTF.

    Parameters
    ----------
    results : edges, of which `usable_edges` are taken; curves at other frequencies than the first
        one's are interpolated
    """
    results = usable_edges(results)
    if len(results) == 1:
        return results[0].mtf
    frequency_lpmm = results[0].mtf.frequency_lpmm
    values = np.stack([_at(frequency_lpmm, result.mtf) for result in results])
    label = f"mean of {len(results)} slanted edges"
    stds = [result.mtf.std for result in results]
    known = [std for std in stds if std is not None]
    if len(known) < len(stds):
        return MtfCurve(frequency_lpmm, values.mean(axis=0), None, label)
    weights = np.array([1.0 / (np.mean(std**2) + _LEAST_STD**2) for std in known])
    weights /= weights.sum()
    std = np.sqrt(np.sum((weights[:, None] * np.stack(known)) ** 2, axis=0))
    return MtfCurve(frequency_lpmm, weights @ values, std, label)


def _at(frequency_lpmm: NDArray[np.float64], curve: MtfCurve) -> NDArray[np.float64]:
    if np.array_equal(frequency_lpmm, curve.frequency_lpmm):
        return curve.modulation
    return np.interp(frequency_lpmm, curve.frequency_lpmm, curve.modulation)


def average_interval(numbers: Sequence[Interval]) -> Interval:
    """Return the mean of independent measurements of one quantity with its 95 % interval.

    Those that were not reached or have no interval are left out; if none has an interval, the
    plain mean is returned.

    Parameters
    ----------
    numbers : one for each edge
    """
    reached = [one for one in numbers if np.isfinite(one.value)]
    if not reached:
        return Interval(float("nan"))
    whole = [one for one in reached if np.isfinite(one.low) and np.isfinite(one.high)]
    if not whole:
        return Interval(float(np.mean([one.value for one in reached])))
    values = np.array([one.value for one in whole])
    std = np.array([(one.high - one.low) / _INTERVAL_SIGMAS for one in whole])
    weights = 1.0 / np.maximum(std, 1e-12 * np.abs(values) + np.finfo(float).tiny) ** 2
    mean = float(np.sum(weights * values) / np.sum(weights))
    half = 0.5 * _INTERVAL_SIGMAS / float(np.sqrt(np.sum(weights)))
    return Interval(mean, mean - half, mean + half)
