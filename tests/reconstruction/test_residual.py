"""Noise that texture hides, read from what a picture leaves over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from pixel_camera import photograph

from lensshift import Burst, reconstruct
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.residual import less_noise
from lensshift.reconstruction.learned.solver import Asked
from lensshift.reconstruction.noise_law import noise_law

SHAPE = (27, 34)
OFFSET_PX = np.array([[0.0, 0.0], [0.5, 0.5]])


@dataclass
class _Picture:
    image: np.ndarray


def _gratings(seed: int):
    """Return a scene of many fine gratings, from 0.25 to 0.7 cycles per LR pixel."""
    rng = np.random.default_rng(seed)
    lpp, turn, phase = rng.uniform([[0.25], [0], [0]], [[0.7], [np.pi], [6.28]], (3, 40))

    def scene(row: np.ndarray, col: np.ndarray) -> np.ndarray:
        along = np.multiply.outer(row, np.cos(turn)) + np.multiply.outer(col, np.sin(turn))
        return 0.5 + 0.05 * np.cos(2 * np.pi * lpp * along + phase).sum(axis=-1)

    return scene


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("believed", [1.5, 4.0, 20.0])
def test_the_best_linear_fit_of_a_white_scene_finds_its_noise_however_much_was_believed(
    believed: float, seed: int
) -> None:
    """The fit y S / (S + v) of a scene of variance S leaves v where v is the noise, else more."""
    sigma, rng = 0.01, np.random.default_rng(seed)
    model = forward_model(SHAPE, 1, np.zeros((1, 2)), blur=GaussianBlur(0.0))
    y = sigma * rng.standard_normal((1, *SHAPE)) + sigma * rng.standard_normal((1, *SHAPE))

    def fit(asked: Asked) -> _Picture:
        return _Picture(asked.y[0] * sigma**2 / (sigma**2 + asked.sigma[0, 0, 0] ** 2))

    found = believed * less_noise(Asked(model, y, np.full(y.shape, believed * sigma), 0.3), fit)
    assert found == pytest.approx(1.0, abs=0.2)
    assert less_noise(Asked(model, y, np.full(y.shape, sigma / 2), 0.3), fit) == 1.0


def test_no_noise_is_added_and_none_is_read_where_the_fit_follows_everything() -> None:
    model = forward_model(SHAPE, 1, np.zeros((1, 2)), blur=GaussianBlur(0.0))
    y = np.random.default_rng(4).standard_normal((1, *SHAPE))
    asked = Asked(model, y, np.full(y.shape, 0.1), 0.3)
    assert less_noise(asked, lambda one: _Picture(0.0 * one.y[0])) == 1.0
    assert less_noise(asked, lambda one: _Picture(0.99 * one.y[0])) == 1.0


def test_frames_that_a_picture_explains_to_the_last_digit_have_no_noise() -> None:
    """The next reading, in units of none, ended in a division by 0."""
    model = forward_model(SHAPE, 1, np.zeros((1, 2)), blur=GaussianBlur(0.0))
    asked = Asked(model, np.zeros((1, *SHAPE)), np.full((1, *SHAPE), 0.1), 0.3)
    found = less_noise(asked, lambda one: _Picture(0.0 / one.sigma[0]))
    assert found == 0.0


@pytest.mark.filterwarnings("error")
def test_complex_frames_are_read_without_a_warning_of_their_imaginary_part() -> None:
    rng = np.random.default_rng(5)
    phase = np.exp(6j * rng.random((2, *SHAPE)))
    burst = Burst.from_arrays(rng.random(phase.shape) * phase, offset_px=OFFSET_PX, pitch_mm=0.1)
    found = reconstruct(burst, channel="amplitude", psf_sigma_px=0.3).amplitude
    assert np.iscomplexobj(found.image)


@pytest.mark.parametrize("seed", range(3))
def test_the_picture_reads_closer_the_noise_of_two_textured_frames(seed: int) -> None:
    sigma, rng = 0.004, np.random.default_rng(70 + seed)
    y = photograph(_gratings(seed), SHAPE, OFFSET_PX)
    y += sigma * rng.standard_normal(y.shape)
    law = noise_law(OFFSET_PX, y, np.ones(y.shape), 0.3)
    burst = Burst.from_arrays(y, offset_px=OFFSET_PX, pitch_mm=0.1)
    found = reconstruct(burst, channel="amplitude", psf_sigma_px=0.3).amplitude
    assert sigma < found.noise_sigma < 0.75 * law.sigma


def test_where_noise_is_seen_it_is_no_upper_bound() -> None:
    y = 0.5 + 0.01 * np.random.default_rng(1).standard_normal((4, *SHAPE))
    offset_px = np.array([[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]])
    assert not noise_law(offset_px, y, np.ones(y.shape), 0.3).ceiling
