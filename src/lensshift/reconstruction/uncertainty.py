"""How the noise of the frames comes out in the HR image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Floats


def white_noise(rng: np.random.Generator, y: Array, weight: Array) -> Array:
    """Return noise for y, of variance 1 / weight in each part of a number (1 at weight 0)."""
    noise = rng.standard_normal(y.shape)
    if y.dtype.kind == "c":
        noise = noise + 1j * rng.standard_normal(y.shape)
    return np.asarray(noise / np.sqrt(np.where(weight > 0, weight, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class PropagatedStd:
    """The standard deviation of each HR pixel, from replicates of the noise, when it is called.

        std^2 = var_j x(y + sigma n_j),   n_j white noise

    The whole solver answers each replicate, so what its weights do to the noise is in it: a
    sparse prior hides noise in flat parts and lets more through at edges. The variance of the
    few replicates is smoothed over about a pixel. It is the noise alone: what the prior or a
    wrong shift falsifies does not show.

    Parameters
    ----------
    resolve : frames [frame row col] -> HR image [row col], as the estimate was found
    y, weight : [frame row col], weight the relative inverse variance, at most 1
    noise_sigma : of one LR pixel (per component if complex)
    seed : of the replicates
    unit : what 1 stands for in the result
    replicates : how many
    smooth_hr_px : width of the smoothing in HR pixels, 0 for none
    """

    resolve: Callable[[Array], Array]
    y: Array
    weight: Array
    noise_sigma: float
    seed: int = 0
    unit: float = 1.0
    replicates: int = 12
    smooth_hr_px: float = 1.0

    def __call__(self) -> Floats:
        """Return the standard deviation [row col]."""
        from scipy.ndimage import gaussian_filter

        rng, y = np.random.default_rng(self.seed), self.y
        noises = (white_noise(rng, y, self.weight) for _ in range(self.replicates))
        answers = [self.resolve(y + self.noise_sigma * noise) for noise in noises]
        variance = np.var(answers, axis=0, ddof=1) / (2.0 if y.dtype.kind == "c" else 1.0)
        smooth = gaussian_filter(variance, self.smooth_hr_px, mode="nearest")
        return self.unit * np.sqrt(smooth, dtype=np.float64)
