"""How the noise of phasor frames grows with their brightness."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.reconstruction.noise_law import light_of
from lensshift.reconstruction.quantiles import ENOUGH

Array = NDArray[Any]

_BINS = 8
_FEWEST_IN_A_BIN = 40
_ENOUGH = _BINS * ENOUGH  # so that the median of a bin is as good as one of `weighted_median`


def relative_variance(phasor: Array, weight: Array) -> NDArray[np.float64]:
    """Return the noise variance of each pixel over that of a pixel of median brightness.

        v(a) = v0 + v1 a,    v0, v1 >= 0

    Shot noise grows with the light, and so with the amplitude. In bins of the amplitude, the
    median of what a second difference along both axes leaves tells the variance; edges are the
    minority in a bin. All ones where there are too few pixels to tell.

    Parameters
    ----------
    phasor : [frame row col] complex
    weight : [frame row col] 0: not to be used

    Source: Immerkaer, Fast noise variance estimation, CVIU 64 (1996) 300, for the mask.
    """
    from scipy.optimize import nnls

    known = weight > 0
    filled = np.where(known, phasor, 0.0)
    amplitude = light_of(phasor, known)
    usable = known
    for axis in (1, 2):
        usable = _inner(usable, 0, axis) & _inner(usable, 1, axis) & _inner(usable, 2, axis)
        filled = _inner(filled, 0, axis) - 2 * _inner(filled, 1, axis) + _inner(filled, 2, axis)
    ones = np.ones(phasor.shape)
    if usable.sum() < 2 * _FEWEST_IN_A_BIN:
        return ones
    some = np.flatnonzero(usable)
    some = some[:: max(1, some.size // _ENOUGH) | 1]
    size, square = amplitude[:, 1:-1, 1:-1].ravel()[some], np.abs(filled.ravel()[some]) ** 2
    bins = max(2, min(_BINS, size.size // _FEWEST_IN_A_BIN))
    each = size.size // bins
    parts = np.argsort(size, kind="stable")[: bins * each].reshape(bins, each)
    place, variance = size[parts[:, each // 2]], np.median(square[parts], axis=1)
    if not np.all(variance > 0):
        return ones
    # Relative errors of all bins are alike.
    design = np.stack([np.ones(bins), place], axis=-1) / variance[:, None]
    (constant, slope), _ = nnls(design, np.ones(bins))
    modelled = constant + slope * amplitude
    typical = constant + slope * float(np.median(amplitude[known]))
    return np.asarray(np.maximum(modelled, 1e-12) / max(typical, 1e-12))


def _inner(values: Array, first: int, axis: int) -> Array:
    """Return all but two of the samples along an axis, from the first, second or third on."""
    size = values.shape[axis]
    return values[(slice(None),) * axis + (slice(first, max(size - 2 + first, first)),)]
