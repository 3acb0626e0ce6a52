"""Noise near an edge, where it is not that of the plateaus."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from lensshift.evaluation.slanted_edge.edge_model import Vector
from lensshift.evaluation.slanted_edge.noise_model import (
    FEWEST_SITES,
    NEAR_PX,
    NEAR_STEP_PX,
    NOISELESS,
    SIGNIFICANT,
    NearNoise,
    NoiseModel,
    best_prediction,
)

_NEAR_STEPS, _NEAREST = 6, 3  # where there may be more noise, and where it is looked for
_FREE_ERROR = 2e-3  # of the contrast: what a free ESF may be off by near a sharp edge


def with_edge(
    noise: NoiseModel,
    residual: Vector,
    response: Vector,
    normal_px: Vector,
    places: NDArray[np.intp],
) -> NoiseModel:
    """Return the noise with that near the edge, if there is more of it than on plateaus (F test).

    Compression keeps more of the noise in blocks with an edge, and adds what its steps cut off;
    lines that are displaced or pixels that differ show at the edge alone.

    Parameters
    ----------
    noise : of the plateaus
    residual : [n] pixels minus a free ESF
    response, normal_px : [n] the ESF, and distances from the edge
    places : [n 3] frame, row, column
    """
    if noise.dark_sigma <= NOISELESS:
        return noise
    scaled = residual / noise.relative_sigma(response, normal_px)
    number = np.minimum(np.abs(normal_px) / NEAR_STEP_PX, _NEAR_STEPS).astype(np.intp)
    counts = np.bincount(number, minlength=_NEAR_STEPS + 1)
    sums = np.bincount(number, weights=scaled**2, minlength=_NEAR_STEPS + 1)
    near, far = int(counts[:_NEAREST].sum()), int(counts[_NEAR_STEPS])
    level = float(sums[_NEAR_STEPS]) / max(far, 1)
    if min(near, far) < FEWEST_SITES or level <= 0.0:
        return noise
    most = float(sums[:_NEAREST].sum()) / near - _FREE_ERROR**2
    freedom = (1 + 2 * noise.order) ** 2
    if fdtrc(near / freedom, far / freedom, most / level) > SIGNIFICANT:
        return noise
    each = (sums / np.maximum(counts, 1) - _FREE_ERROR**2)[:_NEAR_STEPS] / level
    louder = NearNoise(np.append(np.maximum(each, 1.0), 1.0), 0, np.zeros(0), 1.0)
    noise = replace(noise, near=louder)
    scaled = residual / noise.relative_sigma(response, normal_px)
    close = np.abs(normal_px) < NEAR_PX
    order, prediction, left = best_prediction(scaled, places, np.flatnonzero(close))
    beyond = best_prediction(scaled, places, np.flatnonzero(~close))[2]
    innovation = left / max(beyond, np.finfo(float).tiny)
    return replace(noise, near=NearNoise(louder.variance, order, prediction, innovation))
