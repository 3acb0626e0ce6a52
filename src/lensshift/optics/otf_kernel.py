"""The inner loop of the geometric OTF: one sum over rays for each frequency."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def spot_sums(landing: Array, weight: Array, frequency: Array, out: Array) -> None:
    """Write sum_rays w exp(-2 pi i f e).

    Parameters
    ----------
    landing : [spot azimuth ray] e, in mm
    weight : [spot ray]
    frequency : [frequency] f, in line pairs per mm
    out : [spot azimuth frequency], complex
    """
    for s in range(landing.shape[0]):
        for a in range(landing.shape[1]):
            for f in range(frequency.size):
                turn = -2.0 * np.pi * frequency[f]
                real, imaginary = 0.0, 0.0
                for r in range(landing.shape[2]):
                    angle = turn * landing[s, a, r]
                    real += weight[s, r] * np.cos(angle)
                    imaginary += weight[s, r] * np.sin(angle)
                out[s, a, f] = complex(real, imaginary)
