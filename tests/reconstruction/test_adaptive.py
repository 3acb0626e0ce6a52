"""The prior of `auto` where a scene is not alike everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, Array, Scene, make_burst, photograph, truth

from lensshift import reconstruct

SHAPE, LARGE, MIDDLE = (90, 102), (132, 176), (slice(112, 152), slice(156, 196))
SIGMA = 0.003


def target(row: Array, col: Array) -> Array:
    """Rings on a small bright target before a large, dark, even background."""
    row, col = row - 65.5, col - 87.5
    rings = 0.55 + 0.25 * np.cos((row**2 + col**2) / 8.0) * np.exp(-(row**2 + col**2) / 60.0)
    return np.where((np.abs(row) < 13) & (np.abs(col) < 13), rings, 0.03)


def disks(row: Array, col: Array) -> Array:
    """Faint disks, ten times the noise, on the left; strong stripes on the right."""
    faint = np.zeros(np.broadcast(row, col).shape)
    for y, x, r in ((20, 12, 3.0), (45, 25, 1.6), (70, 14, 2.2), (30, 33, 2.6), (76, 34, 1.4)):
        faint[np.hypot(row - y, col - x) < r] = 10 * SIGMA
    stripes = 0.3 + 0.5 * (np.floor((col + 0.3 * row) / 2.3) % 2)
    return np.where(col > 51, stripes, 0.1 + faint)


def frames(scene: Scene, shape: tuple[int, int], seed: int) -> Array:
    clean = photograph(scene, shape, SQUARE_PX)
    return clean + SIGMA * np.random.default_rng(seed).standard_normal(clean.shape)


def rms(image: Array, reference: Array, part: tuple[slice, slice]) -> float:
    return float(np.sqrt(np.mean((image - reference)[part] ** 2)))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_small_target_is_not_wiped_out_by_a_large_calm_background(seed: int) -> None:
    """One weight for the whole picture took the rings away: a larger error than bicubic's."""
    burst, reference = make_burst(frames(target, LARGE, seed)), truth(target, LARGE, 2)
    error = {
        method: rms(
            reconstruct(burst, 2, method, psf_sigma_px=0.29, std=False).amplitude.image,
            reference,
            MIDDLE,
        )
        for method in ("auto", "bicubic")
    }
    assert error["auto"] < 0.75 * error["bicubic"]


def test_a_calm_half_is_denoised_beside_a_busy_one() -> None:
    """With one weight for the whole picture the calm half kept all of its noise."""
    burst, reference = make_burst(frames(disks, SHAPE, 2)), truth(disks, SHAPE, 2)
    image = reconstruct(burst, 2, psf_sigma_px=0.29, std=False).amplitude.image
    calm = (slice(4, -4), slice(4, 80))
    assert rms(image, reference, calm) < 0.6 * SIGMA
    # The disks are still there.
    found = np.corrcoef(image[calm].ravel(), reference[calm].ravel())[0, 1]
    assert found > 0.97


@pytest.mark.parametrize("share", [0.0, 0.02])
def test_fine_rings_are_kept_with_and_without_outliers(share: float) -> None:
    """Taken for noise, they were blurred away: worse than interlacing the frames."""

    def rings(row: Array, col: Array) -> Array:
        return 0.5 + 0.4 * np.cos(np.pi * 0.45 / 14.0 * ((row - 13.5) ** 2 + (col - 15.5) ** 2))

    y, reference = photograph(rings, (28, 32), SQUARE_PX), truth(rings, (28, 32), 2)
    rng = np.random.default_rng(3)
    y += 0.016 * rng.standard_normal(y.shape)
    inside = (slice(4, -4), slice(4, -4))
    plain = reconstruct(make_burst(y), method="shift-and-add").amplitude.image
    y = np.where(rng.random(y.shape) < share, rng.integers(0, 2, y.shape), y)
    image = reconstruct(make_burst(y), std=False).amplitude.image
    assert rms(image, reference, inside) < 0.7 * rms(plain, reference, inside)
