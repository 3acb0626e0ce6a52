"""Deconvolution of a single upscaled frame, with scikit-image."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.reconstruction.baselines.interpolate import cubic_taps, resampled
from lensshift.reconstruction.baselines.result import Baseline

Restoration = Literal["wiener", "unsupervised", "richardson-lucy"]

# A frame without noise is still not deconvolved where the PSF has let nothing through.
_LEAST_BALANCE = 1e-3
# Share of the roughness that is taken for detail however noisy the frame.
_LEAST_DETAIL = 0.05
# Richardson-Lucy must not divide by less, in units of the largest value.
_DARK, _ITERATIONS = 1e-6, 20


def deconvolution(
    frame: Array,
    weight: Floats,
    offset_px: Floats,
    scale: int,
    psf_sigma_px: float,
    noise_sigma: float,
    method: Restoration = "wiener",
) -> Baseline:
    """Sharpen one bicubically upscaled, shift-aligned frame.

        min_x |y - h * x|^2 + (sigma^2 / tau^2) |L x|^2      ("wiener")

    with h a Gaussian, L the Laplacian and tau its rms on the upscaled frame y less the share of
    the noise. "unsupervised" lets scikit-image choose the balance (its random numbers are
    seeded); "richardson-lucy" wants values that are not negative.
    One frame carries no detail beyond its own sampling limit: this only undoes blur.

    Parameters
    ----------
    frame, weight : [row col]; pixels of weight 0 are filled from their neighbours
    offset_px : (row, col) of this frame
    psf_sigma_px : standard deviation of the PSF
    noise_sigma : of an LR pixel (or of a component of a phasor)

    Raises
    ------
    ValueError
        If the width is 0, or Richardson and Lucy's values are negative or complex.

    Source: skimage.restoration.
    """
    if not psf_sigma_px > 0:
        raise ValueError(f"expected a positive psf_sigma_px, got {psf_sigma_px}")
    blurred = resampled(frame, weight, offset_px, scale, cubic_taps).image
    balance = _balance(blurred, offset_px, scale, noise_sigma)
    if method == "richardson-lucy" and np.iscomplexobj(blurred):
        raise ValueError("richardson-lucy wants values that are not negative, got complex")
    parts = (blurred.real, blurred.imag) if np.iscomplexobj(blurred) else (blurred,)
    restored = [_restore(part, psf_sigma_px * scale, balance, method) for part in parts]
    return Baseline(restored[0] if len(restored) == 1 else restored[0] + 1j * restored[1])


def gaussian_psf(sigma_hr_px: float) -> Floats:
    """Return a Gaussian [row col] whose width is right even below one pixel.

    It is sampled in frequency, where exp(-2 (pi sigma f)^2) is cut at the Nyquist limit, and not
    in space, where a Gaussian narrower than about 0.7 px is no longer as wide as it says.
    """
    radius = int(np.ceil(6 * sigma_hr_px)) + 2
    frequency = np.fft.fftfreq(2 * radius + 1)
    line = np.fft.fftshift(np.fft.ifft(np.exp(-2 * (np.pi * sigma_hr_px * frequency) ** 2)).real)
    return np.outer(line, line)


def _restore(image: Floats, sigma_hr_px: float, balance: float, method: Restoration) -> Floats:
    """Deconvolve a real image, with a mirrored margin because the methods are periodic."""
    from skimage import restoration as untyped

    restoration: Any = untyped

    psf = gaussian_psf(sigma_hr_px)
    margin = psf.shape[0] + 8
    # The methods expect values of order one.
    size = float(np.abs(image).max()) or 1.0
    padded = np.pad(image, margin, mode="symmetric") / size
    if method == "wiener":
        restored = restoration.wiener(padded, psf, balance, clip=False)
    elif method == "unsupervised":
        restored, _ = restoration.unsupervised_wiener(padded, psf, clip=False, rng=0)
    elif image.min() < 0:
        raise ValueError(f"richardson-lucy wants values of at least 0, got {image.min():.3g}")
    else:
        restored = restoration.richardson_lucy(
            padded, psf, num_iter=_ITERATIONS, clip=False, filter_epsilon=_DARK
        )
    return np.asarray(restored[margin:-margin, margin:-margin] * size, dtype=np.float64)


def _balance(image: Array, offset_px: Floats, scale: int, noise_sigma: float) -> float:
    """Return the ratio of noise to detail, sigma^2 / tau^2.

    tau^2 is the mean square of the Laplacian of the upscaled image less what the noise adds to
    it, which the upscaled image of a single bright pixel tells.
    """
    from scipy.ndimage import laplace

    impulse = np.zeros((9, 9))
    impulse[4, 4] = 1.0
    everywhere = np.ones_like(impulse)
    answer = laplace(resampled(impulse, everywhere, offset_px % 1.0, scale, cubic_taps).image)
    from_noise = noise_sigma**2 * float(np.sum(answer**2)) / scale**2
    parts = 2 if np.iscomplexobj(image) else 1
    rough = float(np.mean(np.abs(laplace(image, mode="nearest")) ** 2)) / parts
    if rough == 0:
        return 1.0
    return _LEAST_BALANCE + noise_sigma**2 / max(rough - from_noise, _LEAST_DETAIL * rough)
