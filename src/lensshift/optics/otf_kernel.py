"""The inner loop of the fast OTF: one sum over rays for each frequency."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def overlap_square(shear: float, along: float) -> float:
    """Return the squared radius at which two unit discs cease to overlap along an arm.

    Parameters
    ----------
    shear : distance of the disc centres from the middle, 0 .. 1
    along : |cosine| of the angle between the arm and the line of the centres
    """
    root = 1.0 - shear * shear * (1.0 - along * along)
    return float(max(np.sqrt(root) - shear * along, 0.0) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def diffraction(v: float) -> float:
    """Return the MTF of a perfect lens at `v` times its cutoff, 0 <= v <= 1."""
    return float(2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_rays(
    landing: Array, weight: Array, along: Array, edges: Array, v: float, turn: float
) -> complex:
    """Return the OTF of one spot, azimuth and frequency."""
    rings, arms = edges.size - 1, along.size
    real, imaginary, total = 0.0, 0.0, 0.0
    for j in range(arms):
        square = overlap_square(v, along[j])
        for k in range(rings):
            share = min((square - edges[k]) / (edges[k + 1] - edges[k]), 1.0)
            if share <= 0.0:
                break
            r = k * arms + j
            part = share * weight[r]
            real += part * np.cos(turn * landing[r])
            imaginary += part * np.sin(turn * landing[r])
            total += part
    scale = diffraction(v) / total if total > 0.0 else 0.0
    return complex(scale * real, scale * imaginary)


@njit(cache=True, nogil=True, error_model="numpy")
def spot_otf(
    landing: Array, weight: Array, along: Array, edges: Array, shear: Array, frequency: Array,
    out: Array,
) -> None:  # fmt: skip
    """Write D sum w m exp(-2 pi i f e) / sum w m over the rays of each spot.

    m is the share of the ray's part of the pupil that stays in the overlap with the pupil
    sheared by f, and D the diffraction MTF.

    Parameters
    ----------
    landing : [spot azimuth ray] e, in mm; rays ring by ring, as `pupil_quadrature` has them
    weight : [spot ray]
    along : [azimuth arm] |cosine| of the angle between arm and azimuth
    edges : [ring + 1] squared radii of the annuli that the rings stand for
    shear : [spot azimuth] 1 / cutoff, in mm
    frequency : [frequency] f, in line pairs per mm
    out : [spot azimuth frequency], complex
    """
    for s in range(out.shape[0]):
        for a in range(out.shape[1]):
            for f in range(out.shape[2]):
                turns = frequency[f]
                v = min(shear[s, a] * abs(turns), 1.0)
                out[s, a, f] = _sum_rays(
                    landing[s, a], weight[s], along[a], edges, v, -2.0 * np.pi * turns
                )
