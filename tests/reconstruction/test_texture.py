"""Texture of surfaces in phasor pictures: as fine as of brightness alone, if the frames say so."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, make_burst, photograph, truth

from lensshift import reconstruct
from lensshift.core.units import distance_to_phase
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.phasors import (
    LOW_PASS_PX,
    mean_hr_px,
    with_means_of,
    with_texture,
)
from lensshift.reconstruction.learned.solver import Asked, Solution, solve_together

SHAPE, INSIDE = (25, 38), (slice(5, -5), slice(5, -5))
F_HZ, AWAY_M = 15e6, 3.3


def rings(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Up to 0.8 cycles per LR pixel at 16 px from the middle."""
    return 0.5 + 0.4 * np.cos(np.pi * 0.05 * ((row - 11.7) ** 2 + (col - 18.4) ** 2))


@pytest.mark.parametrize(("snr", "seed"), [(30, 1), (100, 2), (100, 3)])
def test_texture_of_a_surface_is_as_fine_as_without_its_distance(snr: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = photograph(rings, SHAPE, SQUARE_PX)
    noise = rng.normal(scale=1 / snr, size=(2, *clean.shape))
    phasor = clean + noise[0] + 1j * noise[1]
    per_m = distance_to_phase(1.0, F_HZ)
    burst = make_burst(
        np.abs(phasor), distance_m=AWAY_M + np.angle(phasor) / per_m, modulation_hz=F_HZ
    )
    true = truth(rings, SHAPE, 2)

    def error(channel: str) -> float:
        found = reconstruct(burst, channel=channel).amplitude
        assert np.mean(np.abs(found.image - true)[INSIDE] < 2 * found.std[INSIDE]) > 0.9
        return float(np.sqrt(np.mean((found.image - true)[INSIDE] ** 2)))

    assert error("auto") < 1.15 * error("amplitude")  # 3 to 4 times as much without it


@pytest.mark.parametrize("spoilt", [False, True])
def test_the_frames_say_which_picture_is_right(spoilt: bool) -> None:
    rng = np.random.default_rng(4)
    clean, true = photograph(rings, SHAPE, SQUARE_PX), truth(rings, SHAPE, 2)
    model = forward_model(SHAPE, 2, SQUARE_PX, blur=GaussianBlur(0.25))
    sigma = 0.01
    y = clean + sigma * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
    asked = Asked(model, y, np.full(y.shape, sigma), 0.25)
    right, soft = solve_together([replace(asked, y=y.real)])[0], 0.5 + 0 * true
    std = np.full((3, *true.shape), 0.01)
    first = right.image if spoilt else soft
    other = replace(right, image=soft) if spoilt else right
    found: Solution = with_texture(
        asked, replace(right, image=first.astype(complex), std=std), 2, lambda _: other
    )
    np.testing.assert_allclose(found.image.real[INSIDE], right.image[INSIDE], atol=0.02)
    assert found.texture is not None
    np.testing.assert_allclose(found.texture.ratio * first, found.image.real, atol=1e-9)


@pytest.mark.parametrize("scale", [2, 3])
def test_means_of_a_picture_are_those_of_the_frames_with_the_noise_of_so_many(scale: int) -> None:
    """A picture that is off by a slow wave, where no frame is."""
    rng, shape, sigma = np.random.default_rng(scale), (60, 75), 0.05
    line = (np.arange(scale) - (scale - 1) / 2) / scale
    offset_px = np.array([(a, b) for a in line for b in line])
    A = forward_model(shape, scale, offset_px, blur=GaussianBlur(0.25)).operator
    true = np.full(A.in_shape, 0.8 * np.exp(0.7j))
    noise = rng.standard_normal((2, *A.out_shape))
    y, weight = A(true) + sigma * (noise[0] + 1j * noise[1]), np.full(A.out_shape, sigma**-2)
    off = 0.3 * np.exp(1j * np.arange(A.in_shape[1]) / (20 * scale)) + np.zeros(A.in_shape)
    image, std = with_means_of(A, true + off, y, weight, LOW_PASS_PX * scale)
    inner = np.s_[6 * scale : -6 * scale, 6 * scale : -6 * scale]
    error = (image - true)[inner]
    for part in (error.real, error.imag):
        assert np.sqrt(np.mean(part**2)) == pytest.approx(np.median(std[inner]), rel=0.25)
    expected = sigma / np.sqrt(mean_hr_px(scale) * len(offset_px) / scale**2)
    np.testing.assert_allclose(std[inner], expected, rtol=0.05)


def test_two_pictures_that_fit_alike_count_as_they_are_sure_and_tell_their_difference() -> None:
    model = forward_model(SHAPE, 2, SQUARE_PX, blur=GaussianBlur(0.25))
    asked = Asked(model, np.ones((4, *SHAPE), complex), np.full((4, *SHAPE), 0.5), 0.25)
    picture = partial(np.full, (50, 76))
    std = np.stack([picture(0.3), picture(0.2), picture(0.0)])
    found = Solution(picture(0.9).astype(complex), std, np.ones(asked.y.shape, np.float32), 0.0)
    texture = replace(found, image=picture(1.1), std=picture(0.1))
    mixed = with_texture(asked, found, 2, lambda _: texture)
    np.testing.assert_allclose(np.abs(mixed.image[INSIDE]), 0.1 * 0.9 + 0.9 * 1.1, atol=1e-3)
    told = np.sqrt(0.1 * 0.3**2 + 0.9 * 0.1**2 + 0.9 * 0.1 * 0.2**2)
    np.testing.assert_allclose(mixed.std[0][INSIDE], told, rtol=1e-2)
    np.testing.assert_array_equal(mixed.std[1], 0.2)
