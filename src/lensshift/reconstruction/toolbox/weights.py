"""Re-weighting: confidence of the observations and sparsity weights of the prior."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Floats

BIAS_THRESHOLD = 0.02
TUNING = 2.0
MAD_TO_SIGMA = 1.4826
# Noise-free frames leave rounding errors; without a floor all of them would be outliers.
_SIGMA_FLOOR = 1e-12


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the first value, in rising order, at which half of the weight is reached.

    Some weights may be negative: those of the prior are resized bicubically between levels.
    """
    order = np.argsort(values)
    reached = np.cumsum((weights / weights.sum())[order]) >= 0.5
    return float(values[order[int(np.argmax(reached))]])


def weighted_mad(values: Floats, weights: Floats) -> float:
    """Return the weighted median of the absolute deviation from the weighted median."""
    return weighted_median(np.abs(values - weighted_median(values, weights)), weights)


def observation_confidence(residual: Floats, confidence: Floats) -> tuple[Floats, float]:
    """Return the Huber weight of every residual and the noise scale sigma_n.

        beta = b_k min(1, 2 sigma_n / |r|),   b_k = 1 if |median r_k| < 0.02 else 0
        sigma_n = 1.4826 MAD(r; confidence b_k)

    Parameters
    ----------
    residual, confidence : [frame pixel]; the confidence of the previous iteration

    Source: estimateHuberObservationWeights of the toolbox.
    """
    unbiased = np.abs(np.median(residual, axis=1, keepdims=True)) < BIAS_THRESHOLD
    weight = confidence * unbiased
    counted = weight > 0
    if not counted.any():
        return np.zeros(residual.shape), float("nan")
    sigma = max(MAD_TO_SIGMA * weighted_mad(residual[counted], weight[counted]), _SIGMA_FLOOR)
    size = np.abs(residual)
    huber = np.ones(residual.shape)
    np.divide(TUNING * sigma, size, out=huber, where=size > TUNING * sigma)
    return unbiased * huber, sigma


def prior_weights(transformed: Floats, previous: Floats, sparsity: float) -> tuple[Floats, float]:
    """Return the weights of the prior and its scale sigma_p.

        a = 1 where |z| <= 2 sigma_p, else p (2 sigma_p)^(1-p) / |z|^(1-p)
        sigma_p = MAD(z; previous a)

    The weight jumps from 1 to p at the threshold, and sigma_p carries no factor 1.4826.

    Parameters
    ----------
    transformed, previous : vectors of equal length
    sparsity : exponent p in (0, 1]

    Source: estimateWBTVPriorWeights of the toolbox.
    """
    sigma = weighted_mad(transformed, previous)
    size = np.abs(transformed)
    threshold = TUNING * sigma
    weights = np.ones(transformed.shape)
    large = size > threshold
    weights[large] = sparsity * (threshold / size[large]) ** (1.0 - sparsity)
    return weights, sigma
