"""Noise that neighbours share."""

import numpy as np
import pytest

from lensshift.evaluation import noise_autocovariance


def test_autocovariance_of_a_moving_mean() -> None:
    white = np.random.default_rng(5).standard_normal((400, 21, 17))
    noise = (white[:, :-1] + white[:, 1:]) / 2  # neighbours in a column share half
    covariance = noise_autocovariance(noise, 2)
    expected = np.zeros((5, 5))
    expected[1:4, 2] = (0.25, 0.5, 0.25)
    assert covariance == pytest.approx(expected, abs=0.01)
    assert np.array_equal(covariance, covariance[::-1, ::-1])


def test_autocovariance_of_what_is_no_noise() -> None:
    with pytest.raises(ValueError, match="reach_px from 0 to 4"):
        noise_autocovariance(np.zeros((2, 5, 7)), 5)
    with pytest.raises(ValueError, match="finite frames"):
        noise_autocovariance(np.full((2, 5, 7), np.nan))
