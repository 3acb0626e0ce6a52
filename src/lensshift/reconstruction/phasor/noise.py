"""How the noise of phasor frames grows with their brightness."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_BINS = 8
_FEWEST_IN_A_BIN = 40
# Blind to constants, slopes and saddles; unit noise gives unit variance.
_MASK = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0]) / 6.0


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
    from scipy.ndimage import convolve
    from scipy.optimize import nnls

    known = weight > 0
    usable = np.zeros_like(known)
    usable[:, 1:-1, 1:-1] = True
    for row in (-1, 0, 1):
        for col in (-1, 0, 1):
            usable &= np.roll(known, (row, col), axis=(1, 2))
    amplitude = np.abs(np.where(known, phasor, 0.0))
    ones = np.ones(phasor.shape)
    if usable.sum() < 2 * _FEWEST_IN_A_BIN:
        return ones
    filled = np.where(known, phasor, 0.0)
    left = np.abs(convolve(filled.real, _MASK[None]) + 1j * convolve(filled.imag, _MASK[None])) ** 2
    size, square = amplitude[usable], left[usable]
    bins = max(2, min(_BINS, size.size // _FEWEST_IN_A_BIN))
    parts = np.array_split(np.argsort(size, kind="stable"), bins)
    place = np.array([np.median(size[part]) for part in parts])
    variance = np.array([np.median(square[part]) for part in parts])
    if not np.all(variance > 0):
        return ones
    # Relative errors of all bins are alike.
    design = np.stack([np.ones(bins), place], axis=-1) / variance[:, None]
    (constant, slope), _ = nnls(design, np.ones(bins))
    modelled = constant + slope * amplitude
    typical = constant + slope * float(np.median(amplitude[known]))
    return np.asarray(np.maximum(modelled, 1e-12) / max(typical, 1e-12))
