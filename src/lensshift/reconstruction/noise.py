"""Noise of one LR pixel, estimated from the frames themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Mask
from lensshift.core.gaussian import MAD_TO_SIGMA, UPPER_QUARTILE_SIZE
from lensshift.core.order import median, median_of_known, quantile
from lensshift.forward.differences import differences
from lensshift.forward.least_squares import NEIGHBOURS, smooth_fit
from lensshift.forward.operator import LinearOperator, single

# The residual of soft low passes, from stiff to soft: the soft ones follow fine texture.
STIFFNESS = (0.1, 0.01, 0.001)
# Of the stiffest, the calmest share of the pixels only is judged.
CALM_SHARE = 0.3
CALM_STIFFNESS = 3.0
# Of each, the quietest blocks; at most about so many of them, whatever the size of the frames.
BLOCK_PX, MOST_BLOCKS, QUIET_SHARE = 6, 1500, 0.1
OUTLIER_SIGMAS, PASSES = 4.0, 3
# Pixels of all frames among which an outlier has to stand out.
NEIGHBOURHOOD_PX = 3


def robust_scale(values: Array) -> float:
    """Return the standard deviation of Gaussian values from their median absolute deviation.

    Complex values count as twice as many real ones: the result is per component.
    """
    if values.dtype.kind == "c":
        values = np.concatenate([values.real.ravel(), values.imag.ravel()])
    return MAD_TO_SIGMA * median(np.abs(values - median(values)))


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What the frames say of their noise.

    Parameters
    ----------
    sigma : standard deviation of one LR pixel, per real component, outliers left out
    unexplained : what a smooth picture leaves over in the calmest parts: noise, fine texture and
        errors of the model
    excess : by how much the outliers widen it, at least 1
    inlier : [frame row col] False at outliers
    """

    sigma: float
    unexplained: float
    excess: float
    inlier: Mask

    @property
    def effective(self) -> float:
        """What to weigh a prior with: the geometric mean of `sigma` and `unexplained`.

        The noise alone trusts the model too far where the blur or a shift is wrong; what is
        unexplained blurs fine texture away. Between the two lay the best pictures.
        """
        return float(np.sqrt(self.sigma * self.unexplained))

    @property
    def total(self) -> float:
        """`effective` with the outliers: what a method feels that cannot leave them out."""
        return self.excess * self.effective


def estimate_noise(A: LinearOperator, y: Array, weight: Array, *, even: bool = True) -> Noise:
    """Estimate the noise of the frames and mark the pixels that are not outliers.

        sigma = min over low passes of  MAD(r(y)) / MAD(r(white noise)),   r = y - low pass

    Whatever a low pass of all frames misses of the scene makes its residual larger, never smaller:
    each gives an upper bound, and the lowest of several is taken. The same linear filter applied
    to unit white noise gives the factor exactly, whatever shifts, borders and gaps there are. A
    residual is judged where it is quietest: in the tenth of the blocks, and for `unexplained` at
    the pixels where the picture is calm (small gradient of a much smoother fit, which the noise
    hardly moves). Pixels beyond 4 sigma are left out of the next pass.

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col]
    y, weight : [frame row col]
    even : whether all pixels have about the same noise; else the quietest say nothing of the
        others, and `sigma` is `unexplained`
    """
    used: Mask = weight > 0
    unit = float(np.abs(y).max(initial=0.0, where=used)) or 1.0
    y, noise = single(y / unit), single(np.random.default_rng(0).standard_normal(y.shape))
    inlier, kept = used, single(used)
    references = [noise - A.forward(smooth_fit(A, noise, kept, s)) for s in STIFFNESS]
    lows: list[Array | None] = [None] * len(STIFFNESS)
    smooth = None  # each pass begins where the one before it ended
    sigma = unexplained = spread = 0.0
    for _ in range(PASSES):
        lows = [smooth_fit(A, y, kept, s, x0=low) for s, low in zip(STIFFNESS, lows, strict=True)]
        residuals = [np.where(used, y - A.forward(low), 0.0) for low in lows if low is not None]
        smooth = smooth_fit(A, y, kept, CALM_STIFFNESS, x0=smooth)
        calm = inlier & _calm(A, smooth, inlier)
        unexplained = _ratio(robust_scale, residuals[0][calm], references[0][calm])
        bounds = [unexplained]
        if spread == 0.0:
            spread = _ratio(_spread, residuals[0][calm], references[0][calm])
        for pair in zip(residuals, references, strict=True):
            quietest, of_noise = (_quietest(r, inlier) for r in pair)
            bounds.append(quietest / max(of_noise, 1e-12))
        sigma = min(bounds) if even else unexplained
        found = used & (np.abs(residuals[0]) <= OUTLIER_SIGMAS * max(unexplained, 1e-12))
        if np.count_nonzero(found) < 0.5 * np.count_nonzero(used) or np.array_equal(found, inlier):
            break
        inlier, kept = found, single(found)
    excess = max(1.0, spread / max(unexplained, 1e-12))
    return Noise(sigma * unit, unexplained * unit, excess, inlier)


def _ratio(scale: Callable[[Array], float], residual: Array, reference: Array) -> float:
    return scale(residual) / max(scale(reference), 1e-12)


def _calm(A: LinearOperator, smooth: Array, inlier: Mask) -> Mask:
    """Return the pixels [frame row col] where a smooth picture [row col] has the least gradient."""
    from scipy.ndimage import uniform_filter

    steps = np.abs(differences(smooth, NEIGHBOURS))
    unrest = A.forward(uniform_filter((steps**2).sum(axis=0), 5))
    return np.asarray(unrest <= np.quantile(unrest[inlier], CALM_SHARE))


def _quietest(residual: Array, kept: Mask) -> float:
    """Return the robust scale that the quietest blocks of all frames stay below."""
    if residual.dtype.kind == "c":
        residual, kept = np.concatenate([residual.real, residual.imag]), np.concatenate([kept] * 2)
    rows, cols = residual.shape[1:]
    side = min(BLOCK_PX, max(3, min(rows, cols) // 3), rows, cols)
    step = max(1, side // 2, int(np.sqrt(rows * cols / MOST_BLOCKS)))
    sizes = np.where(kept, np.abs(residual), np.nan)
    blocks = np.lib.stride_tricks.sliding_window_view(sizes, (side, side), (1, 2))
    blocks = np.moveaxis(blocks[:, ::step, ::step], 0, 2).reshape(-1, len(sizes) * side * side)
    full = np.isfinite(blocks).mean(axis=1) > 1 / 3
    if not full.any():
        full = np.isfinite(blocks).any(axis=1)
    if not full.any():  # what is valid lies between the blocks
        blocks, full = sizes.reshape(1, -1), np.array([True])
    middle = np.sort(median_of_known(blocks[full], axis=1))
    return float(MAD_TO_SIGMA * quantile(middle, QUIET_SHARE))


def usual_size(residual: Array) -> Array:
    """Return [row col] the robust scale of residuals [frame row col] around each pixel.

    From the upper quartile: the median says nothing of lines and corners that fill less than half
    of the neighbourhood, and outliers that fill a quarter of it are no outliers.
    """
    return quantile(ordered_around(np.abs(residual)), 0.75) / UPPER_QUARTILE_SIZE


def ordered_around(values: Array) -> Array:
    """Return [row col number] the values of all frames [frame row col] around a pixel, in order."""
    reach = NEIGHBOURHOOD_PX // 2
    padded = np.pad(values, ((0, 0), (reach, reach), (reach, reach)), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (NEIGHBOURHOOD_PX,) * 2, (1, 2))
    around = np.moveaxis(windows, 0, 2).reshape(*values.shape[1:], -1)
    around.sort(axis=-1)  # several times as fast as `median` or `quantile`
    return around


def light_of(y: Array, used: Mask) -> Array:
    """Return the light at each pixel [frame row col]: the median of it and its four neighbours.

    Of phasors the amplitude. The pixel alone would tell less noise where it is darker by chance,
    and what is weighed by that comes out too dark, by 1 / SNR^2; a mean tells too much noise in the
    dark beside the bright. Thin poles keep theirs.
    """
    y = (np.abs(y) if y.dtype.kind == "c" else y).astype(np.float32)
    on = [np.arange(size) for size in y.shape]  # pixels at an end have themselves beside them
    steps = [(axis, step) for axis in (1, 2) for step in (-1, 1)]
    places = [(axis, np.clip(on[axis] + step, 0, on[axis][-1])) for axis, step in steps]
    parts = [y.take(at, axis) for axis, at in places]
    if not used.all():
        parts = [np.where(used.take(at, axis), one, y)
                 for (axis, at), one in zip(places, parts, strict=True)]  # fmt: skip
    a, b, c, d = parts
    # Of five the median is that of the fifth, the greater of the small and the less of the great.
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.clip(y, np.minimum(low, high), np.maximum(low, high))


def _spread(values: Array) -> float:
    """Return the root mean square, per real component."""
    parts = 2.0 if values.dtype.kind == "c" else 1.0
    return float(np.sqrt(np.mean(np.abs(values) ** 2) / parts))
