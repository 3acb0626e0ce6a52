"""Noise of one LR pixel, estimated from the frames themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.differences import differences
from lensshift.reconstruction.least_squares import NEIGHBOURS, smooth_fit

Array = NDArray[Any]

# The residual of the soft low pass is judged on the calmest share of the pixels only.
CALM_SHARE = 0.3
LOW_PASS_STIFFNESS = 0.1
CALM_STIFFNESS = 3.0
OUTLIER_SIGMAS = 4.0
GAUSSIAN_MAD = 1.4826
# Pixels of all frames among which an outlier has to stand out.
NEIGHBOURHOOD_PX = 3


def robust_scale(values: Array) -> float:
    """Return the standard deviation of Gaussian values from their median absolute deviation.

    Complex values count as twice as many real ones: the result is per component.
    """
    if values.dtype.kind == "c":
        values = np.concatenate([values.real.ravel(), values.imag.ravel()])
    return float(GAUSSIAN_MAD * np.median(np.abs(values - np.median(values))))


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What the frames say of their noise.

    Parameters
    ----------
    sigma : standard deviation of one LR pixel, per real component, outliers left out
    total : the same with the outliers: what a method feels that cannot leave them out
    inlier : [frame row col] False at outliers
    """

    sigma: float
    total: float
    inlier: NDArray[np.bool_]


def estimate_noise(
    A: LinearOperator,
    y: Array,
    weight: Array,
    passes: int = 3,
    seed: int = 0,
    *,
    lone_outliers: bool = False,
) -> Noise:
    """Estimate the noise of the frames and mark the pixels that are not outliers.

        sigma = MAD(r(y)) / MAD(r(white noise)),   r = residual of a soft low pass of all frames

    Together the shifted frames sample the scene more finely than its blur, so the highest
    frequencies of the burst hold little but noise. The same linear filter applied to unit white
    noise gives the factor exactly, whatever shifts, borders and gaps there are. Only the pixels
    where the picture is calm (small gradient of a much smoother fit, which the noise hardly
    moves) are counted; pixels beyond 4 sigma are left out of the next pass.

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col]
    y, weight : [frame row col]
    lone_outliers : whether pixels whose neighbours in all frames are off as well are kept: what
        the low pass misses there is the scene, unless noise or outliers come in clumps
    """
    from scipy.ndimage import uniform_filter

    noise = np.random.default_rng(seed).standard_normal(y.shape)
    kept = (weight > 0).astype(np.float64)
    inlier: NDArray[np.bool_] = kept > 0
    sigma = total = 0.0
    low = low_noise = smooth = None  # each pass begins where the one before it ended
    for _ in range(passes):
        low = smooth_fit(A, y, kept, LOW_PASS_STIFFNESS, x0=low)
        low_noise = smooth_fit(A, noise, kept, LOW_PASS_STIFFNESS, x0=low_noise)
        smooth = smooth_fit(A, y, kept, CALM_STIFFNESS, x0=smooth)
        residual, reference = y - A.forward(low), noise - A.forward(low_noise)
        steps = np.empty((len(NEIGHBOURS), *A.in_shape), smooth.dtype)
        differences(smooth, NEIGHBOURS, steps)
        unrest = A.forward(uniform_filter((np.abs(steps) ** 2).sum(axis=0), 5))
        calm = inlier & (unrest <= np.quantile(unrest[inlier], CALM_SHARE))
        sigma = robust_scale(residual[calm]) / max(robust_scale(reference[calm]), 1e-12)
        if total == 0.0:
            total = max(sigma, _spread(residual[calm]) / max(_spread(reference[calm]), 1e-12))
        usual: Array | float = max(sigma, 1e-12)
        if lone_outliers:
            usual = np.maximum(usual, _usual_size(np.where(weight > 0, residual, 0.0)))
        found = (np.abs(residual) <= OUTLIER_SIGMAS * usual) & (weight > 0)
        if np.count_nonzero(found) < 0.5 * np.count_nonzero(weight > 0):
            break
        if np.array_equal(found, inlier):
            break
        inlier, kept = found, found.astype(np.float64)
    return Noise(sigma, total, inlier)


def _usual_size(residual: Array) -> Array:
    """Return [row col] the robust scale of residuals [frame row col] around each pixel."""
    reach = NEIGHBOURHOOD_PX // 2
    padded = np.pad(np.abs(residual), ((0, 0), (reach, reach), (reach, reach)), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (NEIGHBOURHOOD_PX,) * 2, (1, 2))
    return np.asarray(GAUSSIAN_MAD * np.median(windows, axis=(0, 3, 4)))


def _spread(values: Array) -> float:
    """Return the root mean square, per real component."""
    parts = 2.0 if values.dtype.kind == "c" else 1.0
    return float(np.sqrt(np.mean(np.abs(values) ** 2) / parts))
