"""Shifts as told, corrected by what the frames show: right ones stay, wrong ones come right."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import random_boxes, taken
from test_register import edge

from lensshift.core.types import Burst
from lensshift.registration import told
from lensshift.registration.likelihood import UNKNOWN_PX, likely_shifts
from lensshift.registration.told import Correction, corrected_shifts

Array = NDArray[np.float64]


def corrected(burst: Burst, told_px: Array | None = None) -> Correction | None:
    frames = np.asarray(burst.amplitude, np.float64)
    valid = np.ones(frames.shape, np.bool_)
    return corrected_shifts(frames, valid, burst.offset_px if told_px is None else told_px)


def about_mean(offset_px: Array) -> Array:
    return np.asarray(offset_px - offset_px.mean(axis=0))


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_right_shifts_stay(seed: int) -> None:
    burst, true_px = taken(random_boxes(seed), error_px=0.0, seed=seed)
    np.testing.assert_allclose(about_mean(true_px), about_mean(burst.offset_px), atol=1e-12)
    assert corrected(burst) is None


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_wrong_shifts_come_right_and_keep_their_mean(seed: int) -> None:
    burst, true_px = taken(random_boxes(seed), error_px=0.1, seed=seed)
    found = corrected(burst)
    assert found is not None
    wrong_px = about_mean(burst.offset_px - true_px)
    left_px = about_mean(found.offset_px - true_px)
    assert np.std(left_px) < 0.2 * np.std(wrong_px)
    assert np.all(np.abs(left_px) < 4 * found.sigma_px)
    assert found.error_px == pytest.approx(np.std(wrong_px), rel=0.5)
    mean_px = burst.offset_px.mean(axis=0)
    np.testing.assert_allclose(found.offset_px.mean(axis=0), mean_px, atol=1e-12)


@pytest.mark.parametrize("angle_deg", [0.0, 4.0, 82.0])
def test_of_a_single_edge_shifts_stay_as_told(angle_deg: float) -> None:
    """Along it they show nowhere, and one along the pixels looks alike in many places."""
    for seed in range(3):
        burst = edge(angle_deg, seed)
        error_px = np.random.default_rng(seed).normal(scale=0.08, size=(4, 2))
        assert corrected(burst, burst.offset_px + error_px) is None


@pytest.mark.parametrize("seed", [8, 9])
def test_many_frames_are_asked_some_at_a_time(seed: int) -> None:
    planned_px = tuple(map(tuple, np.random.default_rng(seed).uniform(-0.5, 0.5, (12, 2))))
    burst, true_px = taken(random_boxes(seed), 0.1, seed, planned_px)
    found = corrected(burst)
    assert found is not None
    left_px = about_mean(found.offset_px - true_px)
    assert np.std(left_px) < 0.25 * np.std(about_mean(burst.offset_px - true_px))
    assert 0.5 < np.sqrt(np.mean(left_px**2) / np.mean(found.sigma_px**2)) < 1.6


def test_frames_that_differ_in_brightness_have_not_moved() -> None:
    burst, _ = taken(random_boxes(6), error_px=0.0, seed=6)
    gain, bias = np.array([1.0, 1.06, 0.94, 1.03]), np.array([0.0, 0.02, -0.01, 0.01])
    frames = gain[:, None, None] * burst.amplitude + bias[:, None, None]
    assert corrected_shifts(frames, np.ones(frames.shape, np.bool_), burst.offset_px) is None


def test_a_frame_that_lies_elsewhere_is_left_to_others() -> None:
    burst, true_px = taken(random_boxes(7), error_px=0.0, seed=7)
    told_px = true_px.copy()
    told_px[2] += [0.9, -0.7]
    assert corrected(burst, told_px) is None


@pytest.mark.parametrize("seed", [0, 1])
def test_trust_is_the_empirical_bayes_estimate(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """With equal variances v, s^2 = mean d^2 - v and e = (1 - v / mean d^2) d: James and Stein."""
    rng = np.random.default_rng(seed)
    direction = np.linalg.qr(rng.standard_normal((10, 10)))[0][:, 2:]
    away, variance = rng.normal(scale=0.1, size=8), np.full(8, 0.03**2)
    monkeypatch.setattr(told, "_told_apart", lambda *_: (away, variance, direction))
    told_px, frames = rng.uniform(-1, 1, (5, 2)), np.zeros((5, 3, 4))
    found = corrected_shifts(frames, frames == 0, told_px)
    assert found is not None
    whole = np.mean(away**2)
    assert found.error_px == pytest.approx(np.sqrt(whole - 0.03**2), rel=1e-3)
    expected_px = told_px.ravel() + direction @ ((1 - 0.03**2 / whole) * away)
    np.testing.assert_allclose(found.offset_px.ravel(), expected_px, atol=1e-5)
    left = np.sum(found.sigma_px**2)
    assert left == pytest.approx(8 * 0.03**2 * (1 - 0.03**2 / whole), rel=1e-3)
    monkeypatch.setattr(told, "_told_apart", lambda *_: (0.2 * away, variance, direction))
    assert corrected_shifts(frames, frames == 0, told_px) is None


@pytest.mark.parametrize("seed", [0, 1, 3, 5, 7, 12, 14, 18, 20])  # others end elsewhere
def test_a_search_that_leaves_what_the_frames_share_knows_nothing(seed: int) -> None:
    """Each frame has one bright spot, anywhere: as a reflector at a corner of a part of others."""
    rng, (row, col) = np.random.default_rng(seed), np.mgrid[:8, :8]
    at = rng.uniform(-1, 8, (4, 2))
    frames = np.stack([np.exp(-((row - r) ** 2 + (col - c) ** 2) / 2) for r, c in at])
    frames += 1e-3 * rng.standard_normal(frames.shape)
    start_px = np.array([(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)])
    fit = likely_shifts(frames, np.ones(frames.shape, np.bool_), start_px, photometric=True)
    assert np.ptp(fit.offset_px, axis=0).max() <= 8 - 4
    assert not fit.converged
    assert np.all(fit.sigma_px[1:] > UNKNOWN_PX)
