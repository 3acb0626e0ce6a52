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
    alike = float("nan") if small else ssim(image, truth, peak=peak, border_px=border_px)
    return Fidelity(psnr_db(image, truth, peak=peak, border_px=border_px), alike, error)


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
    from scipy.ndimage import gaussian_filter

    half = SSIM_WINDOW_PX // 2
    both = (inside, true_inside, inside**2 + true_inside**2, inside * true_inside)
    windowed = (gaussian_filter(one, _SSIM_SIGMA_PX, radius=half) for one in both)
    mean, true_mean, squares, products = (np.asarray(one) for one in windowed)
    squared_means, c1, c2 = mean**2 + true_mean**2, (0.01 * peak) ** 2, (0.03 * peak) ** 2
    similarity = (2 * mean * true_mean + c1) * (2 * (products - mean * true_mean) + c2)
    similarity /= (squared_means + c1) * (squares - squared_means + c2)
    return float(np.mean(similarity[half:-half, half:-half]))  # where the window lies inside


def _interiors(image: ArrayLike, truth: ArrayLike, border_px: int) -> tuple[Floats, Floats]:
    values, true_values = real_array(image, "image"), real_array(truth, "truth")
    check_shape(values, true_values)
    if border_px < 0 or 2 * border_px >= min(values.shape):
        raise ValueError(
            f"expected a border from 0 to {(min(values.shape) - 1) // 2} px for shape "
            f"{values.shape}, got {border_px}"
        )
    inside = tuple(slice(border_px, count - border_px) for count in values.shape)
    check_finite(values[inside], " in the image")
    check_finite(true_values[inside], " in the truth")
    return values[inside], true_values[inside]


def _check_peak(peak: float) -> None:
    if not (np.isfinite(peak) and peak > 0):
        raise ValueError(f"expected a positive peak, got {peak}")
