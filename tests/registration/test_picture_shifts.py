"""Shifts through the picture: right where no spectrum describes the scene, no worse elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift.capture.emulators.rig import EmulatedWorld, RigSettings
from lensshift.core.types import Burst
from lensshift.registration import likely_shifts, register
from lensshift.registration.likelihood import ShiftFit
from lensshift.registration.picture import better_shifts, picture_shifts, prediction_error

FINE = 8
Frames = NDArray[np.float64]


def offsets(count: int, seed: int) -> Frames:
    found = np.random.default_rng(seed).uniform(-0.6, 0.6, (count, 2))
    return found - found[0]


def sampled(scene, offset_px: Frames, shape: tuple[int, int]) -> Frames:  # type: ignore[no-untyped-def]
    """Return frames of square pixels that look at scene(row_px, col_px)."""
    inside = (np.arange(FINE) + 0.5) / FINE - 0.5
    row, col = ((np.arange(size)[:, None] + inside).ravel() for size in shape)
    seen = [scene(row[:, None] - down, col - right) for down, right in offset_px]
    return np.array(seen).reshape(-1, shape[0], FINE, shape[1], FINE).mean(axis=(2, 4))


def bars(row: Frames, col: Frames) -> Frames:
    """Five patches of line pairs, along rows and cols in turn, up to 0.9 per pixel."""
    seen = np.full(np.broadcast_shapes(row.shape, col.shape), 50.0)
    for k, frequency in enumerate(np.linspace(0.25, 0.9, 5)):
        phase = 2 * np.pi * frequency * (row if k % 2 else col)
        inside = (abs(col - 7 * k - 4) < 2.7) & (abs(row - 15) < 12)
        seen = np.where(inside, 125 + 75 * np.sign(np.sin(phase)), seen)
    return seen


def waves(row: Frames, col: Frames) -> Frames:
    """Twenty waves over a column and a row of places: each is a product of both."""
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, 20)
    along_row, along_col = np.random.default_rng(6).normal(scale=0.15, size=(20, 2)).T
    down = np.exp(1j * (2 * np.pi * along_row * row + phases))
    return np.real(down @ np.exp(2j * np.pi * along_col[:, None] * col))


def noisy(frames: Frames, sigma: float, seed: int) -> Frames:
    return frames + np.random.default_rng(seed).normal(scale=sigma, size=frames.shape)


@pytest.mark.parametrize("seed", [12, 13])
def test_errors_of_four_large_noisy_frames_are_no_larger_than_they_are(seed: int) -> None:
    """A picture that is soft keeps the noise: it lay ten times its error beside the truth."""
    true_px = offsets(4, seed)
    frames = sampled(waves, true_px, (96, 112))
    frames = noisy(frames, 0.25 * frames.std(), seed)
    valid = np.ones(frames.shape, np.bool_)
    found = picture_shifts(frames, valid, true_px)
    told_px = np.sqrt(np.mean(found.sigma_px[1:] ** 2))
    assert np.std(found.offset_px - true_px) < 2.0 * told_px
    burst = register(Burst.from_arrays(frames, offset_px=0 * true_px, pitch_mm=0.1))
    assert burst.offset_sigma_px is not None
    error_px = (burst.offset_px - true_px)[1:]
    assert np.sqrt(np.mean(burst.offset_sigma_px[1:] ** 2)) < 3.0 * np.sqrt(np.mean(error_px**2))


@pytest.mark.parametrize("seed", [3, 4])
def test_errors_hold_on_line_pairs_which_no_spectrum_describes(seed: int) -> None:
    true_px = offsets(9, seed)
    frames = noisy(sampled(bars, true_px, (31, 36)), 1.0, seed)
    valid = np.ones(frames.shape, np.bool_)
    alone = likely_shifts(frames, valid, true_px)
    found = better_shifts(alone, frames, valid, 0)

    def over_told(fit: ShiftFit) -> float:
        wrong = (fit.offset_px - true_px)[1:]
        return float(np.sqrt(np.mean((wrong / fit.sigma_px[1:]) ** 2)))

    assert np.std(found.offset_px - true_px) <= np.std(alone.offset_px - true_px)
    assert over_told(found) < 2.5 < 4.0 < over_told(alone)


@pytest.mark.parametrize("moved", [0, 1])
def test_frames_that_nearly_all_lie_at_one_place_do_not_refute_the_others(moved: int) -> None:
    """A smooth picture of one place predicts a frame elsewhere best too near to it."""
    world = EmulatedWorld(RigSettings(seed=moved), None)
    true_px = np.zeros((7, 2))
    true_px[1, moved] = true_px[4, 1 - moved] = 0.225
    frames = [world.running.frame(one[None] - 0.03, world._rng).amplitude for one in true_px]
    burst = Burst.from_arrays(np.stack(frames), offset_px=0 * true_px, pitch_mm=0.1)
    found = register(burst)
    away_px = found.offset_px - found.offset_px[0] - true_px
    np.testing.assert_allclose(away_px, 0.0, atol=0.03)
    sigma_px = found.offset_sigma_px
    assert sigma_px is not None
    # The two frames elsewhere are off by 0.026 px, and are told to be; no picture took their place.
    assert np.all(np.abs(away_px[1:]) < 2.0 * sigma_px[1:])
    assert sigma_px.max() < 0.03


@pytest.mark.parametrize("seed", range(4))
def test_a_pattern_of_the_pixels_speaks_for_no_place(seed: int) -> None:
    """It stands still: were it not taken off, places too near to each other would predict it."""
    true_px = offsets(9, seed)
    frames = noisy(sampled(waves, true_px, (27, 40)), 0.02, seed)
    pattern = 0.3 * np.random.default_rng(50 + seed).standard_normal(frames.shape[1:])
    valid = np.ones(frames.shape, np.bool_)
    right, nearer = (
        prediction_error(frames + pattern, valid, share * true_px, patterned=True)[0]
        for share in (1.0, 0.95)
    )
    assert np.mean(right) < np.mean(nearer)


def test_a_right_fit_stays_and_a_wrong_one_goes() -> None:
    true_px = offsets(9, 2)
    frames = noisy(sampled(waves, true_px, (27, 40)), 0.05, 2)
    valid = np.ones(frames.shape, np.bool_)
    fit = likely_shifts(frames, valid, true_px)
    kept = better_shifts(fit, frames, valid, 0)
    np.testing.assert_array_equal(kept.offset_px, fit.offset_px)
    assert np.all(kept.sigma_px >= fit.sigma_px)
    off_px = np.random.default_rng(3).normal(scale=0.1, size=true_px.shape)
    wrong = replace(fit, offset_px=true_px + off_px - off_px[0])
    cured = better_shifts(wrong, frames, valid, 0)
    np.testing.assert_allclose(cured.offset_px, true_px, atol=0.01)


def test_errors_grow_by_what_the_two_ways_disagree() -> None:
    """The same offset error in all frames but the reference cannot be told by predicting."""
    true_px = offsets(8, 4)
    frames = noisy(sampled(waves, true_px, (27, 40)), 0.5, 4)
    valid = np.ones(frames.shape, np.bool_)
    fit = likely_shifts(frames, valid, true_px)
    moved_px = np.where(np.arange(8)[:, None] == 0, 0.0, [0.02, -0.03])
    sure = ShiftFit(true_px + moved_px, 1e-6 * fit.covariance_px2, fit.gain, 1.0, True)
    widened = better_shifts(sure, frames, valid, 0)
    if np.array_equal(widened.offset_px, sure.offset_px):
        assert np.all(np.abs(widened.offset_px - true_px) <= 3 * widened.sigma_px + 1e-12)
    else:
        np.testing.assert_allclose(widened.offset_px, true_px, atol=0.02)


def test_complex_frames_and_invalid_pixels() -> None:
    true_px = offsets(7, 5)
    frames = noisy(sampled(waves, true_px, (25, 30)), 0.02, 5)
    valid = np.random.default_rng(5).random(frames.shape) > 0.05
    turned = np.where(valid, frames * np.exp(0.7j), 1e3)
    found = picture_shifts(turned, valid, true_px + 0.1 * (np.arange(7) > 0)[:, None])
    np.testing.assert_allclose(found.offset_px, true_px, atol=0.01)
    right, wrong = (
        prediction_error(turned, valid, px)[0].mean() for px in (true_px, 1.3 * true_px)
    )
    assert right < 0.8 * wrong


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_along_an_edge_between_columns_nothing_is_known(seed: int) -> None:
    """The picture predicts such frames better, and drifts along the edge."""
    true_px = offsets(9, seed)
    step = sampled(lambda row, col: 0.0 * row + (col > 14.2), true_px, (21, 30))
    frames, valid = noisy(step, 0.003, seed), np.ones(step.shape, np.bool_)
    fit = likely_shifts(frames, valid, true_px)
    found = better_shifts(fit, frames, valid, 0)
    np.testing.assert_allclose(found.offset_px[:, 0], fit.offset_px[:, 0], atol=0.01)
    assert np.all(found.sigma_px[1:, 0] > 1.0)


def test_of_large_frames_the_part_that_shows_something_tells() -> None:
    true_px = offsets(4, 6)

    def corner(row: Frames, col: Frames) -> Frames:
        return np.where((row > 80) & (col > 40), waves(row, col), 0.0)

    frames = noisy(sampled(corner, true_px, (143, 110)), 0.05, 6)
    found = register(Burst.from_arrays(frames, offset_px=0 * true_px, pitch_mm=0.01))
    np.testing.assert_allclose(found.offset_px, true_px, atol=0.01)


def test_light_that_dwarfs_the_noise_at_low_frequencies() -> None:
    """Power of 10^18 times the noise leaves matrices that have no inverse in double precision."""
    true_px = offsets(5, 7)

    def hill(row: Frames, col: Frames) -> Frames:
        return 1e9 * np.exp(-((row - 40) ** 2 + (col - 50) ** 2) / 1200)

    frames = noisy(sampled(hill, true_px, (80, 97)), 1.0, 7)
    found = register(Burst.from_arrays(frames, offset_px=true_px, pitch_mm=0.01))
    assert np.all(np.isfinite(found.offset_px))
    np.testing.assert_allclose(found.offset_px, true_px, atol=0.02)
