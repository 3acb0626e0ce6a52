"""Patterns as a camera sees them: behind a Gaussian blur, averaged over square pixels."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensshift.evaluation.limits import pixel_aperture_mtf

Floats = NDArray[np.float64]


def seen(
    picture: Callable[[Floats, Floats], Floats],
    shape: tuple[int, int],
    center_px: tuple[float, float],
    sigma_px: float,
    finer: int = 8,
) -> Floats:
    """Return a picture, a function of (row, col) from a centre, drawn so many times finer."""
    pad = 4
    row, col = (
        (np.arange(-pad * finer, (n + pad) * finer) + 0.5) / finer - 0.5 - c
        for n, c in zip(shape, center_px, strict=True)
    )
    image = gaussian_filter(picture(row[:, None], col), sigma_px * finer)
    rows, cols = (n + 2 * pad for n in shape)
    pixels = image.reshape(rows, finer, cols, finer).mean(axis=(1, 3))
    return np.asarray(pixels[pad:-pad, pad:-pad])


def gaussian_mtf(frequency: Floats, sigma_px: float) -> Floats:
    return np.asarray(np.exp(-2 * (np.pi * sigma_px * frequency) ** 2))


def seen_mtf(
    frequency: Floats, sigma_px: float, half_rad: float = np.pi, middle_rad: float = 0.0
) -> Floats:
    """Return blur times pixel aperture, averaged over directions of the frequency."""
    angles = middle_rad + half_rad * ((np.arange(90) + 0.5) / 45 - 1)
    pixel = [pixel_aperture_mtf(frequency, 1.0, angle_rad=angle) for angle in angles]
    return gaussian_mtf(frequency, sigma_px) * np.mean(pixel, axis=0)
