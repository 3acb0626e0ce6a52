"""Frames that differ in noise: what each has of it, and what passes for it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, edge_scene, interior_psnr, photograph, smooth_scene, truth

from lensshift import Burst, reconstruct
from lensshift.reconstruction.frame_noise import with_frames
from lensshift.reconstruction.noise_law import NoiseLaw, noise_law

SHAPE = (39, 56)
FINE = np.random.default_rng(3).uniform(-0.6, 0.6, (11, 2))


def _law(y: np.ndarray, offset_px: np.ndarray, weight: np.ndarray | None = None) -> NoiseLaw:
    weight = np.ones(y.shape) if weight is None else weight
    law = noise_law(offset_px, y, weight, 0.3)
    return with_frames(law, offset_px, y, weight, 0.3)


def _sigma(law: NoiseLaw, light: float = 0.5) -> np.ndarray:
    return np.sqrt(law.variance(np.full((1, 1, 1), light))).ravel()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scene", [smooth_scene, edge_scene])
@pytest.mark.parametrize("phasors", [False, True])
def test_each_frame_has_the_noise_that_it_has(scene, phasors: bool, seed: int) -> None:
    rng = np.random.default_rng([seed, 40])
    for offset_px in (SQUARE_PX, FINE):
        sigma = 0.01 * rng.permutation(np.geomspace(0.5, 4.0, len(offset_px)))
        noise = sigma[:, None, None] * rng.standard_normal((2, len(sigma), *SHAPE))
        y = photograph(scene, SHAPE, offset_px) + noise[0] + 1j * noise[1] * phasors
        found = _sigma(_law(y if phasors else y.real, offset_px))
        noisy = sigma >= np.median(sigma)  # the others hold more of these than of their own
        np.testing.assert_allclose(found[noisy], sigma[noisy], rtol=0.3)
        of_one_law = np.log(sigma / np.sqrt(np.mean(sigma**2)))
        assert np.std(np.log(found / sigma)) < 0.7 * np.std(of_one_law)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("scene", [smooth_scene, edge_scene])
def test_frames_of_equal_noise_have_one_law(scene, seed: int) -> None:
    rng = np.random.default_rng([seed, 41])
    y = photograph(scene, SHAPE, FINE) + 0.01 * rng.standard_normal((len(FINE), *SHAPE))
    assert _law(y, FINE).of_frames == ()


def test_what_moves_lies_elsewhere_or_flickers_is_no_noise() -> None:
    rng = np.random.default_rng(42)
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    elsewhere = photograph(edge_scene, SHAPE, SQUARE_PX + np.eye(4)[:, 1:2] * [1.2, 0.7])
    moved, lit = y.copy(), y.copy()
    moved[2, 8:20, 30:45] += 0.3
    lit[1] = 1.1 * lit[1] + 0.05
    for frames in (elsewhere, moved, lit):
        assert _law(frames + 0.01 * rng.standard_normal(y.shape), SQUARE_PX).of_frames == ()


def test_a_frame_without_pixels_and_a_weight_that_stands_for_noise() -> None:
    rng = np.random.default_rng(43)
    sigma = np.array([1, 1, 4, 1, 1, 1.0]) * 0.01
    offset_px = FINE[: len(sigma)]
    y = photograph(edge_scene, SHAPE, offset_px)
    y += sigma[:, None, None] * rng.standard_normal(y.shape)
    weight = np.ones(y.shape)
    weight[2], weight[4] = 1 / 16, 0.0
    law = with_frames(noise_law(offset_px[:4], y[:4], weight[:4], 0.3), offset_px, y, weight, 0.3)
    told = _sigma(law)
    np.testing.assert_allclose(np.delete(told, 4), 0.01, rtol=0.25)
    assert np.isfinite(told).all()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("share", [0.01, 0.05])
@pytest.mark.parametrize("level", [0.0, 290.0, 3.0 + 5.0j])
def test_gaps_and_levels_hide_no_noisy_frame_and_make_none(
    level: complex, share: float, seed: int
) -> None:
    for sigma in (0.01 * np.ones(6), np.array([1, 1, 1, 1, 4, 1]) * 0.01):
        rng = np.random.default_rng([seed, 45])
        offset_px = rng.uniform(-0.6, 0.6, (6, 2))
        y = photograph((smooth_scene, edge_scene)[seed], SHAPE, offset_px)
        noise = sigma[:, None, None] * rng.standard_normal((2, *y.shape))
        y = y + level + noise[0] + (1j * noise[1] if isinstance(level, complex) else 0.0)
        weight = (rng.random(y.shape) > share) * 1.0
        law = _law(np.where(weight > 0, y, 0.0), offset_px, weight)
        if np.ptp(sigma) == 0.0:
            assert law.of_frames == ()
        else:
            np.testing.assert_allclose(_sigma(law, abs(level + 0.5)), sigma, rtol=0.35)


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_frame_is_believed_less_and_none_is_accused(seed: int) -> None:
    rng = np.random.default_rng([seed, 44])
    sigma = np.array([1.0, 1.0, 6.0, 1.0, 1.0]) * 0.012
    y, offset_px = photograph(edge_scene, SHAPE, FINE[:5]), FINE[:5]
    y += sigma[:, None, None] * rng.standard_normal(y.shape)
    burst = Burst.from_arrays(y, offset_px=offset_px, pitch_mm=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = reconstruct(burst, std=False).amplitude
    np.testing.assert_allclose(found.notes["noise_of_frames"], sigma, rtol=0.25)
    without = reconstruct(burst, frames=[0, 1, 3, 4], std=False).amplitude
    scene = truth(edge_scene, SHAPE, 2)
    assert interior_psnr(found.image, scene) > interior_psnr(without.image, scene) - 0.3
