"""The noise of a burst, from the burst alone."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, edge_scene, photograph, smooth_scene

from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.noise import estimate_noise, robust_scale

SHAPE = (40, 48)
OFFSETS = {
    "square": SQUARE_PX,
    "random": np.random.default_rng(8).uniform(-1.0, 1.0, (6, 2)),
    "one frame": np.zeros((1, 2)),
}


def _operator(offset_px: np.ndarray, scale: int = 2) -> LinearOperator:
    return forward_model(SHAPE, scale, offset_px, blur=GaussianBlur(0.3)).operator


def _white(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(100 + seed).standard_normal(shape)


@pytest.mark.parametrize("scene", [smooth_scene, edge_scene])
@pytest.mark.parametrize("offsets", ["square", "random"])
@pytest.mark.parametrize("sigma", [0.005, 0.03])
def test_white_noise_is_found_within_ten_percent(scene, offsets: str, sigma: float) -> None:
    offset_px = OFFSETS[offsets]
    clean = photograph(scene, SHAPE, offset_px)
    y = clean + sigma * _white(clean.shape)
    noise = estimate_noise(_operator(offset_px), y, np.ones(y.shape))
    assert noise.sigma == pytest.approx(sigma, rel=0.1)
    assert noise.total >= noise.sigma * 0.99


def test_white_noise_is_found_at_scale_three() -> None:
    y = photograph(smooth_scene, SHAPE, OFFSETS["random"])
    y += 0.02 * _white(y.shape)
    noise = estimate_noise(_operator(OFFSETS["random"], 3), y, np.ones(y.shape))
    assert noise.sigma == pytest.approx(0.02, rel=0.1)


def test_invalid_pixels_do_not_count() -> None:
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    y += 0.02 * _white(y.shape)
    weight = (np.random.default_rng(3).random(y.shape) > 0.2).astype(float)
    weight[1, 10:20, 10:20] = 0.0
    A = _operator(SQUARE_PX)
    noise = estimate_noise(A, np.where(weight > 0, y, 0.0), weight)
    assert noise.sigma == pytest.approx(0.02, rel=0.1)
    assert not noise.inlier[weight == 0].any()
    other = estimate_noise(A, np.where(weight > 0, y, 9.0), weight)
    assert other.sigma == noise.sigma


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_is_found_where_each_block_has_few_pixels_that_count(seed: int) -> None:
    y = 0.5 + 0.02 * _white((4, *SHAPE), seed)
    weight = np.zeros(y.shape)
    weight[:, ::2, ::2] = 1.0  # a quarter
    noise = estimate_noise(_operator(SQUARE_PX), y, weight)
    assert noise.sigma == pytest.approx(0.02, rel=0.15)


def test_noise_of_phasors_is_per_component() -> None:
    clean = photograph(smooth_scene, SHAPE, SQUARE_PX) * np.exp(0.6j)
    y = clean + 0.02 * (_white(clean.shape) + 1j * _white(clean.shape, 1))
    noise = estimate_noise(_operator(SQUARE_PX), y, np.ones(y.shape))
    assert noise.sigma == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("scene", [smooth_scene, edge_scene])
def test_salt_and_pepper_barely_move_the_noise(scene) -> None:
    clean = photograph(scene, SHAPE, OFFSETS["random"])
    y = clean + 0.02 * _white(clean.shape)
    rng = np.random.default_rng(4)
    hit = rng.random(y.shape) < 0.05
    y = np.where(hit, rng.integers(0, 2, y.shape), y)
    noise = estimate_noise(_operator(OFFSETS["random"]), y, np.ones(y.shape))
    assert noise.sigma == pytest.approx(0.02, rel=0.2)
    assert noise.total > 2.0 * noise.sigma
    assert np.mean(noise.inlier[hit]) < 0.05
    assert np.mean(noise.inlier[~hit]) > 0.9


def test_noise_scales_with_the_frames() -> None:
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    y += 0.02 * _white(y.shape)
    A = _operator(SQUARE_PX)
    small, large = (estimate_noise(A, factor * y, np.ones(y.shape)) for factor in (1.0, 250.0))
    assert large.sigma == pytest.approx(250.0 * small.sigma, rel=1e-6)


def test_flat_frames_without_noise_give_next_to_none() -> None:
    y = np.full((4, *SHAPE), 0.5)
    noise = estimate_noise(_operator(SQUARE_PX), y, np.ones(y.shape))
    assert 0.0 <= noise.sigma < 1e-3
    black = estimate_noise(_operator(SQUARE_PX), 0.0 * y, np.ones(y.shape))
    assert black.sigma == 0.0
    assert black.inlier.all()


def test_flat_frames_with_noise() -> None:
    y = 0.5 + 0.01 * _white((4, *SHAPE))
    noise = estimate_noise(_operator(SQUARE_PX), y, np.ones(y.shape))
    assert noise.sigma == pytest.approx(0.01, rel=0.1)
    assert noise.total == pytest.approx(0.01, rel=0.1)


def test_the_estimate_is_repeatable() -> None:
    y = 0.5 + 0.01 * _white((4, *SHAPE))
    A = _operator(SQUARE_PX)
    assert (
        estimate_noise(A, y, np.ones(y.shape)).sigma == estimate_noise(A, y, np.ones(y.shape)).sigma
    )


def test_robust_scale_of_gaussian_values() -> None:
    values = 3.0 + 2.0 * _white((20000,))
    assert robust_scale(values) == pytest.approx(2.0, rel=0.03)
    values[:1000] = 1e6
    assert robust_scale(values) == pytest.approx(2.0, rel=0.1)
    phasors = 2.0 * (_white((20000,)) + 1j * _white((20000,), 1))
    assert robust_scale(phasors) == pytest.approx(2.0, rel=0.03)


def _rings(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Rings about the middle that grow finer outwards, up to 0.45 cycles per LR pixel."""
    return 0.5 + 0.4 * np.cos(np.pi * 0.45 / 20.0 * ((row - 20) ** 2 + (col - 24) ** 2))


@pytest.mark.parametrize("sigma", [0.016, 0.004])
def test_fine_rings_are_not_taken_for_noise(sigma: float) -> None:
    y = photograph(_rings, SHAPE, SQUARE_PX)
    y += sigma * _white(y.shape)
    noise = estimate_noise(_operator(SQUARE_PX), y, np.ones(y.shape))
    assert noise.sigma == pytest.approx(sigma, rel=0.4)
    assert noise.sigma <= noise.effective <= noise.unexplained


def test_quiet_pixels_do_not_speak_for_noisy_ones() -> None:
    """Distances of a bright card are quiet, those of the dark wall are what has to be smoothed."""
    spread = np.where(np.arange(SHAPE[1]) < 8, 0.002, 0.05)
    y = photograph(smooth_scene, SHAPE, SQUARE_PX)
    y += spread * _white(y.shape)
    even, uneven = (
        estimate_noise(_operator(SQUARE_PX), y, np.ones(y.shape), even=even)
        for even in (True, False)
    )
    assert even.sigma < 0.01
    assert uneven.sigma == uneven.effective == uneven.unexplained > 3.0 * even.sigma
