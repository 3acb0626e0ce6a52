"""Noise: scatter of repeated frames, how far neighbours share it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.evaluation.inputs import mask_array, real_array

_MAX_NOISE_ERROR = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class TemporalNoise:
    """Scatter of each pixel over repeated frames, in the units of the frames."""

    std: Floats  # [row col], NaN where fewer than two frames are valid
    median: float  # median over the pixels, freed from the skew that few frames cause


def temporal_noise(frames: ArrayLike, *, valid: ArrayLike | None = None) -> TemporalNoise:
    """Measure the noise of each pixel over frames of a static scene.

        std^2 = sum_k (y_k - mean y)^2 / nu,   nu = valid frames - 1
        median = sqrt( median( std^2 / c ) ),   c = (1 - 2 / (9 nu))^3

    c is the median of chi^2 / nu; with 3 frames the plain median would be 17 % low.

    Parameters
    ----------
    frames : [frame row col], at least two; NaN is invalid
    valid : [frame row col], False for pixels left out

    Raises
    ------
    ValueError
        If the shapes differ, or no pixel is valid in two frames.

    Warns
    -----
    QualityWarning
        If so few pixels and frames make `median` uncertain by more than 10 %.

    Source: Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684.
    """
    values = real_array(frames, "stack of frames", "[frame row col]")
    values = np.where(mask_array(valid, values.shape) & np.isfinite(values), values, np.nan)
    count = np.count_nonzero(np.isfinite(values), axis=0)
    repeated = count >= 2
    if not repeated.any():
        raise ValueError(f"expected pixels valid in two of {len(values)} frames, got none")
    freedom = count[repeated] - 1
    variance = np.full(count.shape, np.nan)
    variance[repeated] = np.nanvar(values[:, repeated], axis=0, ddof=1)
    # A median has 1.25 (many frames) to 1.65 times (two frames) the standard error of a mean.
    error = 1.5 / np.sqrt(2.0 * freedom.sum())
    if error > _MAX_NOISE_ERROR:
        warn_quality(
            f"{freedom.size} pixels in {len(values)} frames tell the noise to {100 * error:.0f} %"
        )
    middle = np.median(variance[repeated] / (1 - 2 / (9 * freedom)) ** 3)
    return TemporalNoise(std=np.sqrt(variance), median=float(np.sqrt(middle)))


def noise_autocovariance(noise_frames: ArrayLike, reach_px: int = 3) -> Floats:
    """Return the autocovariance of noise, averaged over frames and places.

        C(r, c) = mean over k, i, j of n_k(i, j) n_k(i + r, j + c)

    For the slanted edge of a super-resolved image, whose noise is correlated: reconstruct frames of
    noise alone as the image was (a linear method), or subtract the mean of repeated results.

    Parameters
    ----------
    noise_frames : [frame row col] of mean 0
    reach_px : largest lag

    Returns
    -------
    [2 reach + 1, 2 reach + 1], the variance in the middle.

    Raises
    ------
    ValueError
        If the frames are not real and finite, or smaller than the reach.
    """
    noise = real_array(noise_frames, "stack of frames", "[frame row col]")
    rows, cols = noise.shape[1:]
    if not np.all(np.isfinite(noise)):
        raise ValueError("expected finite frames of noise")
    if not 0 <= reach_px < min(rows, cols):
        raise ValueError(f"expected a reach_px from 0 to {min(rows, cols) - 1}, got {reach_px}")
    covariance = np.empty((2 * reach_px + 1,) * 2)
    for row in range(reach_px + 1):
        for col in range(-reach_px, reach_px + 1):
            here = noise[:, : rows - row, max(0, -col) : cols - max(0, col)]
            there = noise[:, row:, max(0, col) : cols - max(0, -col)]
            at = np.array([[row, -row], [col, -col]]) + reach_px  # equal at opposite lags
            covariance[tuple(at)] = np.mean(here * there)
    return covariance
