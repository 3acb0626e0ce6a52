"""How close an image is to the truth: PSNR, SSIM and RMSE without the border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.evaluation.inputs import check_finite, check_shape, real_array

SSIM_WINDOW_PX = 11  # a Gaussian of 1.5 px, cut at 3.5 sigma
_SSIM_SIGMA_PX = 1.5


@dataclass(frozen=True, slots=True)
class Fidelity:
    """Three numbers about one image.

    Parameters
    ----------
    psnr_db : peak signal to noise ratio, infinite for identical images
    ssim : mean structural similarity, 1 for identical images
    rmse : root mean square error, in the units of the image
    """

    psnr_db: float
    ssim: float
    rmse: float


def fidelity(
    image: ArrayLike, truth: ArrayLike, *, peak: float = 1.0, border_px: int = 4
) -> Fidelity:
    """Compare an image with the truth; see `psnr_db`, `ssim` and `rmse`.

    Of images that are too small for a window of `ssim`, such as those of sensors of 8 x 8 pixels,
    it is NaN.
    """
    error = rmse(image, truth, border_px=border_px)
    small = min(np.shape(image)) - 2 * border_px < SSIM_WINDOW_PX
    return Fidelity(
        psnr_db=psnr_db(image, truth, peak=peak, border_px=border_px),
        ssim=float("nan") if small else ssim(image, truth, peak=peak, border_px=border_px),
        rmse=error,
    )


def rmse(image: ArrayLike, truth: ArrayLike, *, border_px: int = 4) -> float:
    """Return the root mean square error over the interior.

        RMSE = sqrt( mean (image - truth)^2 )

    Parameters
    ----------
    image, truth : [row col], real and finite, of one shape
    border_px : pixels of these images left out along each edge

    Raises
    ------
    ValueError
        If the shapes differ, nothing is left, or a value is complex or not finite.
    """
    inside, true_inside = _interiors(image, truth, border_px)
    return float(np.sqrt(np.mean((inside - true_inside) ** 2)))


def psnr_db(image: ArrayLike, truth: ArrayLike, *, peak: float = 1.0, border_px: int = 4) -> float:
    """Return the peak signal to noise ratio over the interior.

        PSNR = 20 log10( peak / RMSE )

    Parameters
    ----------
    image, truth : [row col], real and finite, of one shape
    peak : value of white
    border_px : pixels of these images left out along each edge

    Raises
    ------
    ValueError
        If `peak` is not positive, or as in `rmse`.
    """
    _check_peak(peak)
    error = rmse(image, truth, border_px=border_px)
    return float(20.0 * np.log10(peak / error)) if error > 0 else float("inf")


def ssim(image: ArrayLike, truth: ArrayLike, *, peak: float = 1.0, border_px: int = 4) -> float:
    """Return the mean structural similarity over the interior.

        SSIM = mean (2 m_x m_y + C1) (2 s_xy + C2) / ((m_x^2 + m_y^2 + C1) (s_x^2 + s_y^2 + C2))

    Means and covariances under a Gaussian window of 1.5 px, C1 = (0.01 peak)^2 and C2 = (0.03
    peak)^2, as in scikit-image. The border is cut before the windows are laid.

    Parameters
    ----------
    image, truth : [row col], real and finite, of one shape
    peak : value of white
    border_px : pixels of these images left out along each edge

    Raises
    ------
    ValueError
        If less than 11 x 11 pixels are left, or as in `psnr_db`.

    Source: Wang, Bovik, Sheikh, Simoncelli, IEEE Trans. Image Processing 13 (2004) 600.
    """
    _check_peak(peak)
    inside, true_inside = _interiors(image, truth, border_px)
    if min(inside.shape) < SSIM_WINDOW_PX:
        raise ValueError(
            f"expected at least {SSIM_WINDOW_PX} x {SSIM_WINDOW_PX} pixels inside the border for "
            f"SSIM, got {inside.shape[0]} x {inside.shape[1]}"
        )
    mean, true_mean = _windowed(inside), _windowed(true_inside)
    variance = _windowed(inside**2) - mean**2 + _windowed(true_inside**2) - true_mean**2
    covariance = _windowed(inside * true_inside) - mean * true_mean
    c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    similarity = (2 * mean * true_mean + c1) * (2 * covariance + c2)
    similarity /= (mean**2 + true_mean**2 + c1) * (variance + c2)
    half = SSIM_WINDOW_PX // 2  # where the window lies inside the image
    return float(np.mean(similarity[half:-half, half:-half]))


def _windowed(values: Floats) -> Floats:
    from scipy.ndimage import gaussian_filter

    radius = SSIM_WINDOW_PX // 2
    return np.asarray(gaussian_filter(values, _SSIM_SIGMA_PX, radius=radius))


def _interiors(image: ArrayLike, truth: ArrayLike, border_px: int) -> tuple[Floats, Floats]:
    values, true_values = real_array(image, "image"), real_array(truth, "truth")
    check_shape(values, true_values)
    if border_px < 0 or 2 * border_px >= min(values.shape):
        raise ValueError(
            f"expected a border from 0 to {(min(values.shape) - 1) // 2} px for shape "
            f"{values.shape}, got {border_px}"
        )
    rows, cols = values.shape
    inside = (slice(border_px, rows - border_px), slice(border_px, cols - border_px))
    check_finite(values[inside], " in the image")
    check_finite(true_values[inside], " in the truth")
    return values[inside], true_values[inside]


def _check_peak(peak: float) -> None:
    if not (np.isfinite(peak) and peak > 0):
        raise ValueError(f"expected a positive peak, got {peak}")
