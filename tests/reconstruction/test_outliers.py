"""Which pixels and frames keep their weight."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import interior_psnr, make_burst, photograph, truth

from lensshift.core.errors import QualityWarning
from lensshift.reconstruction.outliers import confidence, frame_confidence
from lensshift.reconstruction.reconstruct import reconstruct

COUNT, SHAPE, SIGMA = 8, (20, 24), 0.005
OFFSETS = np.random.default_rng(6).uniform(-0.5, 0.5, (COUNT, 2))
ONES = np.ones((COUNT, *SHAPE))


def _residual() -> np.ndarray:
    return SIGMA * np.random.default_rng(0).standard_normal(ONES.shape)


def test_good_frames_keep_their_weight() -> None:
    np.testing.assert_array_equal(frame_confidence(_residual(), ONES), 1.0)


@pytest.mark.parametrize("shift", [0.15, -0.15])
def test_a_brighter_or_darker_frame_loses_its_weight(shift: float) -> None:
    residual = _residual()
    residual[3] += shift
    expected = np.ones(COUNT)
    expected[3] = 0.0
    np.testing.assert_array_equal(frame_confidence(residual, ONES), expected)


def test_a_frame_that_does_not_fit_loses_its_weight() -> None:
    residual = _residual()
    residual[5] *= 4.0
    trust = frame_confidence(residual, ONES)
    assert trust[5] < 1e-3
    np.testing.assert_array_equal(np.delete(trust, 5), 1.0)


def test_frames_without_pixels_count_nothing_and_change_nothing() -> None:
    weight = ONES.copy()
    weight[2] = 0.0
    trust = frame_confidence(_residual(), weight)
    assert trust[2] == 0.0
    np.testing.assert_array_equal(np.delete(trust, 2), 1.0)


def test_where_all_frames_are_odd_or_there_is_one_nothing_is_left_out() -> None:
    np.testing.assert_array_equal(frame_confidence(_residual() + 0.3, ONES), 1.0)
    np.testing.assert_array_equal(frame_confidence(_residual()[:1], ONES[:1]), 1.0)


def test_pixels_lose_weight_beyond_two_sigma() -> None:
    residual = np.full(ONES.shape, 0.1 * SIGMA)
    residual[0, 0, :4] = np.array([1.0, 2.0, 4.0, -8.0]) * SIGMA
    found = confidence(residual, ONES, SIGMA)
    np.testing.assert_allclose(found[0, 0, :4], [1.0, 1.0, 0.5, 0.25])
    assert np.all(found[1:] == 1.0)
    phasors = confidence(residual * np.exp(0.4j), ONES, SIGMA)
    np.testing.assert_allclose(phasors, found)


def test_the_scale_may_differ_from_pixel_to_pixel() -> None:
    residual = np.full(ONES.shape, 4.0)
    residual[:, ::2] *= -1.0
    scale = np.ones(ONES.shape)
    scale[0, 0, 0] = 2.0
    found = confidence(residual, ONES, scale)
    assert found[0, 0, 0] == 1.0
    assert found[0, 0, 1] == 0.5


def _texture(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    return 0.5 + 0.2 * np.sin(1.1 * row + 0.3 * col) + 0.2 * np.cos(0.9 * col - 0.2 * row)


def _burst(spoil: str) -> tuple[np.ndarray, np.ndarray]:
    real = OFFSETS.copy()
    if spoil == "misregistered":
        real[2] += (1.7, -1.2)
    frames = photograph(_texture, SHAPE, real)
    frames += SIGMA * np.random.default_rng(1).standard_normal(frames.shape)
    if spoil == "biased":
        frames[2] += 0.15
    return frames, OFFSETS


@pytest.mark.parametrize("spoil", ["biased", "misregistered"])
def test_auto_leaves_out_the_frame_that_lies(spoil: str) -> None:
    estimate = reconstruct(make_burst(*_burst(spoil)), std=False).amplitude
    mean = estimate.confidence.mean(axis=(1, 2))
    assert mean[2] < 0.25  # Huber weights become small, never 0
    assert np.all(np.delete(mean, 2) > 0.75)
    assert estimate.notes["rejected"] == [2]
    clean = reconstruct(make_burst(*_burst("")), std=False).amplitude
    expected = truth(_texture, SHAPE, 2)
    assert interior_psnr(estimate.image, expected) > interior_psnr(clean.image, expected) - 3.0
    assert clean.notes["rejected"] == []


def test_auto_warns_when_many_frames_lie() -> None:
    frames, offsets = _burst("biased")
    frames[:3] += np.array([0.2, -0.2, 0.3])[:, None, None]
    with pytest.warns(QualityWarning, match="frames rejected"):
        estimate = reconstruct(make_burst(frames, offsets), std=False).amplitude
    assert set(estimate.notes["rejected"]) >= {0, 1, 2}
