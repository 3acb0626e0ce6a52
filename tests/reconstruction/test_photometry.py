"""Gain and bias of each frame."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, Array, edge_scene, make_burst, photograph

from lensshift import QualityWarning, reconstruct
from lensshift.core.types import Estimate, Status
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import ESTIMATED
from lensshift.reconstruction.photometry import estimate_photometry, in_one_light
from lensshift.reconstruction.problem import Problem

SHAPE = (20, 24)
GAIN = np.array([1.1, 0.95, 1.0, 0.97])
BIAS = np.array([0.03, -0.02, -0.04, 0.03])


@pytest.fixture
def A():
    return forward_model(SHAPE, 2, SQUARE_PX, blur=GaussianBlur(0.3)).operator


def _frames() -> np.ndarray:
    frames = photograph(edge_scene, SHAPE, SQUARE_PX)
    frames = GAIN[:, None, None] * frames + BIAS[:, None, None]
    return frames + 0.003 * np.random.default_rng(0).standard_normal(frames.shape)


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_gain_and_bias_line_the_frames_up(A, outliers: float) -> None:
    y = _frames()
    rng = np.random.default_rng(1)
    y = np.where(rng.random(y.shape) < outliers, rng.integers(0, 2, y.shape), y)
    gain, bias = estimate_photometry(A, y, np.ones(y.shape))
    assert np.exp(np.mean(np.log(gain))) == pytest.approx(1.0)
    assert bias.mean() == pytest.approx(0.0, abs=1e-12)
    # The scene may take a common gain and bias: compare what a level of 0.2 and 0.8 becomes.
    true_gain = GAIN / np.exp(np.mean(np.log(GAIN)))
    np.testing.assert_allclose(gain, true_gain, atol=0.01)
    for level in (0.2, 0.8):
        brought_back = (GAIN * level + BIAS - bias) / gain
        assert np.ptp(brought_back) < 0.01


@pytest.mark.parametrize("seed", [0, 1])
def test_frames_brought_back_are_as_noisy_as_their_gain_is_small(seed: int) -> None:
    """Divided by it, the variance grows as 1 / gain^2; brighter ones are not believed more."""
    rng = np.random.default_rng(seed)
    scene, weight = rng.random((4, *SHAPE)), rng.random((4, *SHAPE)) * (rng.random(SHAPE) > 0.1)
    y = GAIN[:, None, None] * scene + BIAS[:, None, None]
    model = forward_model(SHAPE, 2, SQUARE_PX)
    found = Problem(y, weight, model, 1.0, 0.3, None).with_photometry(GAIN, BIAS)
    np.testing.assert_allclose(found.y, np.where(weight > 0, scene, 0.0), atol=1e-12)
    variance = 1 / np.minimum(GAIN, 1.0) ** 2
    np.testing.assert_allclose(found.weight, weight / variance[:, None, None])


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("gain", [(1.0, 0.5, 2.0, 0.7), (1.0, 0.25, 2.0, 4.0)])
def test_exposures_of_very_different_length_are_found(
    A, gain: tuple[float, ...], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    times = np.array(gain)[:, None, None]
    y = times * photograph(edge_scene, SHAPE, SQUARE_PX)
    y += 0.003 * rng.standard_normal(y.shape)
    found, bias = estimate_photometry(A, y, np.ones(y.shape))
    np.testing.assert_allclose(found, gain / np.exp(np.mean(np.log(gain))), rtol=0.01)
    np.testing.assert_allclose(bias, 0.0, atol=0.01)


def test_nobody_is_told_to_estimate_brightness_that_was_estimated() -> None:
    """In texture that frames alias what is brightness and what is a place is found roughly."""
    rng = np.random.default_rng(0)
    frequency, turn, phase = rng.uniform([[0.3], [0], [0]], [[0.6], [np.pi], [2 * np.pi]], (3, 30))

    def scene(row: np.ndarray, col: np.ndarray) -> np.ndarray:
        along = np.multiply.outer(row, np.cos(turn)) + np.multiply.outer(col, np.sin(turn))
        return 0.5 + 0.08 * np.cos(2 * np.pi * frequency * along + phase).sum(axis=-1)

    y = photograph(scene, SHAPE, SQUARE_PX) * np.array([1.0, 0.25, 2.0, 4.0])[:, None, None]
    y += 0.003 * rng.standard_normal(y.shape)
    with pytest.warns(QualityWarning, match="differ in brightness.*found for each frame do not"):
        reconstruct(make_burst(y), channel="amplitude", photometric=True, psf_sigma_px=0.3)


def test_what_is_allowed_for_is_light_and_not_what_is_said_before() -> None:
    burst = make_burst(_frames())
    lit = f"the frames differ in brightness by 2.2 times what they differ by otherwise: {ESTIMATED}"
    shook = "frame 0 is less sharp than the others, by (+0.5, +0.6) px: the picture allows for it"
    even = Estimate(np.ones((40, 48)), (), Status.COMPLETE)
    found = replace(even, notes={"contradiction": f"{shook}; and {lit}"})
    with pytest.warns(QualityWarning, match=r"^the frames differ in brightness by 2\.2 times"):
        assert in_one_light(found, burst.amplitude, burst, Request(), lambda: even) is even


def test_equal_frames_keep_gain_one_and_bias_zero(A) -> None:
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    gain, bias = estimate_photometry(A, y, np.ones(y.shape))
    np.testing.assert_allclose(gain, 1.0, atol=5e-3)
    np.testing.assert_allclose(bias, 0.0, atol=5e-3)


def test_flat_frames_are_brought_close_together(A) -> None:
    rng = np.random.default_rng(2)
    level = 0.5 + np.array([0.1, -0.1, 0.05, -0.05])
    y = level[:, None, None] * np.ones((4, *SHAPE))
    y += 0.01 * rng.standard_normal(y.shape)
    gain, bias = estimate_photometry(A, y, np.ones(y.shape))
    # What is gain and what is bias cannot be seen, but both stay tame.
    np.testing.assert_allclose(gain, 1.0, atol=0.1)
    assert np.ptp((level - bias) / gain) < np.ptp(level) / 4.0


def test_a_frame_without_valid_pixels_changes_nothing(A) -> None:
    y, weight = _frames(), np.ones((4, *SHAPE))
    weight[3] = 0.0
    y[3] = 0.0
    gain, bias = estimate_photometry(A, y, weight)
    assert np.all(np.isfinite(gain))
    assert np.all(np.isfinite(bias))
    np.testing.assert_allclose(gain[:3] / gain[0], GAIN[:3] / GAIN[0], atol=0.02)


def test_complex_frames_are_refused(A) -> None:
    with pytest.raises(ValueError, match="real frames"):
        estimate_photometry(A, np.ones((4, *SHAPE), complex), np.ones((4, *SHAPE)))


def _boxes(row: Array, col: Array) -> Array:
    """Two boxes of a few pixels in a dark field, as a wide lens sees them."""
    one = (np.abs(row - 5.3) < 1.2) & (np.abs(col - 4.1) < 1.7)
    other = (np.abs(row - 6.2) < 1.9) & (np.abs(col - 8.4) < 0.8)
    return np.asarray(0.03 + 0.8 * one + 0.5 * other)


@pytest.mark.parametrize(("gain", "least", "most"), [(1.0, 0, 0), (1.3, 4, 6)])
def test_few_bright_pixels_that_do_not_fit_are_no_other_brightness(
    gain: float, least: int, most: int
) -> None:
    told = 0
    for seed in range(1, 7):
        rng = np.random.default_rng(seed)
        y = photograph(_boxes, (12, 13), np.array(SQUARE_PX) + rng.normal(0, 0.02, (4, 2)))
        y += 0.003 * rng.standard_normal(y.shape) * np.sqrt(y / 0.8 + 0.02)
        y[2] *= gain
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", QualityWarning)
            reconstruct(make_burst(y), psf_sigma_px=0.289, std=False)
        told += any("differ in brightness" in str(one.message) for one in caught)
    assert least <= told <= most


def _said(y: Array, **settings: object) -> tuple[Array, list[str]]:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", QualityWarning)
        found = reconstruct(make_burst(y), psf_sigma_px=12**-0.5, **settings)["amplitude"]
    assert all(one.filename == __file__ for one in said)
    return found.image, [str(one.message) for one in said]


@pytest.mark.parametrize(("change", "silent"), [(0.0, True), (0.2, False), (1.0, False)])
def test_light_that_flickers_is_allowed_for_and_said(change: float, silent: bool) -> None:
    gain, bias = GAIN**change, change * BIAS
    clean = photograph(edge_scene, SHAPE, SQUARE_PX)
    y = gain[:, None, None] * clean + bias[:, None, None]
    y += 0.003 * np.random.default_rng(2).standard_normal(y.shape)
    image, said = _said(y)
    asked, _ = _said(y, photometric=True)
    assert any("the picture allows for it" in one for one in said) is not silent
    if silent:
        assert not said
    else:
        np.testing.assert_allclose(image, asked, atol=0.01)


def test_something_that_moved_is_not_taken_for_light() -> None:
    def moved(row: Array, col: Array) -> Array:
        inside = (np.abs(row - 9) < 3) & (np.abs(col - 14) < 3)
        return np.where(inside, 0.9, edge_scene(row, col))

    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    y[2] = photograph(moved, SHAPE, SQUARE_PX)[2]
    y += 0.01 * np.random.default_rng(3).standard_normal(y.shape)
    _, said = _said(y)
    assert said
    assert not any("allows for it" in one for one in said)


def _cells(seed: int) -> Callable[[Array, Array], Array]:
    rng = np.random.default_rng(seed)
    middle, radius = rng.uniform(0.0, 36.0, (40, 2)), np.exp(rng.uniform(-0.5, 1.5, 40))
    light = rng.uniform(0.1, 1.0, 40)

    def scene(row: Array, col: Array) -> Array:
        seen = np.zeros(np.broadcast(row, col).shape)
        for (down, right), r, bright in zip(middle, radius, light, strict=True):
            seen += bright * np.exp(-((((row - down) ** 2 + (col - right) ** 2) / r**2) ** 3))
        return seen

    return scene


def test_light_that_fades_does_not_pass_for_bright_parts_that_moved() -> None:
    """Fluorescence fades by 2 % from frame to frame; the noise of few photons is as large."""
    fading = 1.0 - 0.02 * np.arange(8)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        offset_px = rng.uniform(-0.8, 0.8, (8, 2)).round(1)
        clean = photograph(_cells(seed), (34, 35), offset_px, fine=10)
        y = rng.poisson(600.0 * fading[:, None, None] * clean) + rng.normal(100.0, 2.0, clean.shape)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", QualityWarning)
            reconstruct(make_burst(y, offset_px), std=False)
        said = [str(one.message) for one in caught]
        assert not any("moved" in one for one in said), seed
        assert all("brightness" in one or "light of the frames" in one for one in said)


def test_what_moves_while_the_light_fades_is_told_where_it_is() -> None:
    def moving(k: int) -> Callable[[Array, Array], Array]:
        def scene(row: Array, col: Array) -> Array:
            inside = (np.abs(row - 8.0 - k) < 2.5) & (np.abs(col - 7.0 - 1.5 * k) < 2.5)
            return np.where(inside, 1.2, _cells(12)(row, col))

        return scene

    offset_px = np.random.default_rng(4).uniform(-0.8, 0.8, (6, 2)).round(1)
    y = np.concatenate([
        (1.0 - 0.03 * k) * photograph(moving(k), (34, 35), offset_px[k], fine=10) for k in range(6)
    ])  # fmt: skip
    y += 0.01 * np.random.default_rng(5).standard_normal(y.shape)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", QualityWarning)
        reconstruct(make_burst(y, offset_px), std=False)
    light, moved = (str(one.message) for one in caught)
    assert "the picture allows for it" in light
    rows, columns = re.search(r"moved at rows (\d+) .. \d+, columns \d+ .. (\d+)", moved).groups()
    assert int(rows) > 2
    assert int(columns) < 24
