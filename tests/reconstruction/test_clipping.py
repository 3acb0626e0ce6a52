"""Frames that were cut off at an end of the range of the camera, or are on few levels."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mosaic import canvas, observe, square
from numpy.typing import NDArray

from lensshift import Burst, QualityWarning, Reconstruction, reconstruct
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.clipping import (
    beside,
    clipped_pixels,
    measured,
    overexposed,
    silent_pixels,
    without_blank,
    without_copies,
)
from lensshift.reconstruction.learned.noise import rounded_std
from lensshift.reconstruction.noise_law import constant_noise
from lensshift.reconstruction.problem import make_problem

SHAPE, SIGMA = (25, 34), 0.02
NINE_PX = square(3)


def without_stuck(burst: Burst) -> Burst:
    found, said = measured(burst)
    for text in said:
        warnings.warn(text, QualityWarning, stacklevel=2)
    return found


def seen(seed: int, offset_px: NDArray[np.float64] = NINE_PX) -> NDArray[np.float64]:
    """Return frames of a mosaic in 0.1 .. 0.9 or so, with noise."""
    rng = np.random.default_rng(seed)
    y = observe(canvas(rng, SHAPE), SHAPE, offset_px=offset_px, snr=1e6, rng=rng).y
    return np.asarray(y + SIGMA * rng.standard_normal(y.shape))


def reconstructed(y: NDArray[np.float64]) -> tuple[Reconstruction, list[str]]:
    burst = Burst.from_arrays(y, offset_px=NINE_PX, pitch_mm=0.1)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = reconstruct(burst, 2, psf_sigma_px=12**-0.5)
    assert all(one.filename == __file__ for one in said)
    return found, [str(one.message) for one in said]


@given(st.integers(0, 2**32 - 1), st.sampled_from([-1.0, 0.01, 37.0]), st.floats(-5, 5))
def test_what_is_cut_off_is_found_in_any_unit(seed: int, unit: float, level: float) -> None:
    rng = np.random.default_rng(seed)
    y = rng.uniform(0, 1, (4, 11, 13)) + 0.05 * rng.standard_normal((4, 11, 13))
    used = rng.random(y.shape) < 0.9
    assert clipped_pixels(unit * y + level, used) is None
    low, high = 0.15, 0.8
    found = clipped_pixels(unit * np.clip(y, low, high) + level, used)
    np.testing.assert_array_equal(found, used & ((y <= low) | (y >= high)))


def test_levels_of_a_converter_are_no_ends_of_its_range() -> None:
    for seed in range(20):
        y = np.random.default_rng(seed).normal(128, 3, (4, 21, 26)).round()
        assert clipped_pixels(y, np.ones(y.shape, bool)) is None


@pytest.mark.parametrize("seed", [3, 4, 8, 133])  # of the last four fifths are cut off
@pytest.mark.parametrize(("low", "high"), [(0.4, np.inf), (-np.inf, 0.6), (0.35, 0.65)])
def test_noise_is_read_beside_what_is_cut_off_and_nothing_seems_to_contradict(
    seed: int, low: float, high: float
) -> None:
    y = seen(seed)
    cut = np.clip(y, low, high)
    assert np.mean(cut != y) > 0.03
    found, said = reconstructed(cut)
    assert 0.7 * SIGMA < found["amplitude"].noise_sigma < 1.5 * SIGMA
    assert [one for one in said if f"noise is cut off at {low:g}" not in one] == []


def test_a_frame_that_lies_elsewhere_is_told_of_frames_that_are_cut_off() -> None:
    away_px = NINE_PX.copy()
    away_px[5] += (1.0, -0.75)
    for seed in (3, 4, 8, 103, 115):  # of the last two more than half of the pixels are left out
        _, said = reconstructed(np.clip(seen(seed, away_px), 0.3, 0.7))
        assert any("frame 5 does not fit" in one for one in said)


def test_places_without_light_and_noise_tell_none() -> None:
    rng = np.random.default_rng(5)
    fine = np.clip(canvas(rng, SHAPE) - 0.4, 0, None)
    y = observe(fine, SHAPE, offset_px=NINE_PX, snr=1e6, rng=rng).y
    y = np.where(y > 1e-4, y, 0.0)
    y = y + SIGMA * np.sqrt(y / 0.3) * rng.standard_normal(
        y.shape
    )  # shot noise alone, also below 0
    still = silent_pixels(y, None)
    assert np.all(y[still] == 0.0)
    assert still.mean() > 0.05
    found, said = reconstructed(y)
    true = SIGMA * np.sqrt(np.mean(np.maximum(y, 0.0)[~still]) / 0.3)
    assert 0.6 * true < found["amplitude"].noise_sigma < 1.6 * true
    assert said == []


@pytest.mark.parametrize(("end", "told"), [(1.0, True), (255.0, True), (0.83, False)])
def test_overexposed_frames_are_told_with_the_cure(end: float, told: bool) -> None:
    y = np.minimum(seen(4) / 0.6, 1.0) * end
    share = np.mean(y == end)
    assert share > 0.05
    _, said = reconstructed(y)
    assert [f"{100 * share:.0f} % of the pixels are at {end:g}" in one for one in said] == (
        [True] if told else []
    )
    assert all("shorter time" in one for one in said)
    few = np.zeros(y.shape, bool)
    few[0, :2] = y[0, :2] == end
    assert overexposed(y, few) is None


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.2, 0.3, 0.5])
def test_what_rounding_shares_is_what_a_mean_over_its_noise_leaves(sigma: float) -> None:
    step, rng = 0.04, np.random.default_rng(3)
    light = rng.uniform(0, 1, (4, 40, 60)) * 40 * step
    rounded = np.round(light / step + sigma * rng.standard_normal((4000, 1, 1, 1))) * step
    shared = np.sqrt(np.mean((rounded.mean(axis=0) - light) ** 2))
    burst = Burst.from_arrays(rounded[0], offset_px=square(2), pitch_mm=0.1)
    problem = make_problem(
        burst, burst.amplitude, 2, blur=GaussianBlur(0.3), shift_field=None, noise_sigma=None
    )
    law = constant_noise(step * np.sqrt(sigma**2 + 1 / 12) / problem.intensity)
    found = rounded_std(problem, law) * problem.intensity
    chance = step * np.sqrt((sigma**2 + 1 / 12) / 4000)
    assert found == pytest.approx(shared, rel=0.05, abs=2 * chance)


@pytest.mark.parametrize("seed", [3, 4, 8])
def test_std_holds_the_step_of_a_converter_that_noise_does_not_dither(seed: int) -> None:
    rng, step = np.random.default_rng(seed), 0.03
    scene = observe(canvas(rng, SHAPE), SHAPE, offset_px=NINE_PX, snr=1e6, rng=rng)
    y = np.round((scene.y + 0.15 * step * rng.standard_normal(scene.y.shape)) / step) * step
    found, said = reconstructed(y)
    image, std = found["amplitude"].image, found["amplitude"].std
    assert found["amplitude"].noise_sigma >= step / np.sqrt(12) * 0.999
    assert np.mean(np.abs(image - scene.truth) < 2 * std) > 0.9
    assert said == []


@pytest.mark.parametrize("levels", [2, 8])
def test_the_outermost_of_levels_that_are_equally_frequent_is_no_end(levels: int) -> None:
    y = np.arange(4 * 31 * 40.0).reshape(4, 31, 40) % levels
    assert clipped_pixels(y, np.ones(y.shape, bool)) is None


def test_what_lies_within_a_pixel_of_the_clipped_says_nothing_and_no_more() -> None:
    clipped = np.zeros((4, 11, 13), bool)
    clipped[:, 5, 6] = True
    square_px = square(2)
    A = forward_model((11, 13), 2, square_px, blur=GaussianBlur(0.3)).operator
    near = beside(A, clipped, 2)
    assert near[:, 4:7, 5:8].all()
    away = np.hypot(*np.ogrid[-5:6, -6:7]) > 4.0
    assert not near[:, away].any()
    some = clipped & (np.arange(4) == 2)[:, None, None]
    assert not beside(A, some, 2).any()  # in one frame of four something moved


def test_points_of_light_are_looked_for_only_where_the_frames_lie_apart() -> None:
    y = seen(3, 0.15 * NINE_PX / np.ptp(NINE_PX))
    y[:, 12, 17] = 4.0
    still = Burst.from_arrays(y, offset_px=0.15 * NINE_PX / np.ptp(NINE_PX), pitch_mm=0.1)
    assert without_stuck(still) is still
    with pytest.warns(QualityWarning, match=r"left out as defective: 1, at .*\(12, 17\)"):
        without_stuck(replace(still, offset_px=NINE_PX))


def test_complex_frames_have_defects_too() -> None:
    y = seen(3) * np.exp(1j * np.linspace(0.0, 3.0, SHAPE[1]))
    clean = Burst.from_arrays(y, offset_px=NINE_PX, pitch_mm=0.1)
    assert without_stuck(clean) is clean
    y[:, 12, 17] = 4.0j
    with pytest.warns(QualityWarning, match=r"left out as defective: 1, at .*\(12, 17\)"):
        without_stuck(Burst.from_arrays(y, offset_px=NINE_PX, pitch_mm=0.1))


@pytest.mark.parametrize("axis", [1, 2])
def test_a_line_of_pixels_with_an_offset_is_left_out(axis: int) -> None:
    for seed in range(3):
        y = seen(20 + seed)
        off = y.copy()
        off[(slice(None), *(np.s_[9] if axis == k else slice(None) for k in (1, 2)))] += 0.7
        defect = np.zeros(SHAPE, np.bool_)
        defect[np.s_[9] if axis == 1 else np.s_[:, 9]] = True
        with pytest.warns(QualityWarning, match="left out as defective"):
            found = without_stuck(Burst.from_arrays(off, offset_px=NINE_PX, pitch_mm=0.1))
        np.testing.assert_array_equal(found.valid, np.broadcast_to(~defect, y.shape))
        clean = Burst.from_arrays(y, offset_px=NINE_PX, pitch_mm=0.1)
        assert without_stuck(clean) is clean


def test_a_line_of_the_scene_that_does_not_move_across_itself_is_no_defect() -> None:
    places = np.array([[-0.5, 0.0], [-0.2, 0.0], [0.2, 0.0], [0.5, 0.0]])
    y = seen(2, places)
    y[:, :, 9] += 0.7
    still = Burst.from_arrays(y, offset_px=places, pitch_mm=0.1)
    assert without_stuck(still) is still


@pytest.mark.parametrize("method", ["auto", "tikhonov", "nearest", "bicubic"])
def test_a_blank_frame_is_named_and_left_out(method: str) -> None:
    y = seen(4)
    y[0] = 0.0
    burst = Burst.from_arrays(y, offset_px=NINE_PX, pitch_mm=0.1)
    with pytest.warns(
        QualityWarning, match="frame 0: all valid pixels are alike.* left out"
    ) as all_:
        found = reconstruct(burst, method=method)
    assert len(all_) == 1
    assert all_[0].filename == __file__
    valid = np.ones(y.shape, bool)
    valid[0] = False
    others = reconstruct(replace(burst, valid=valid), method=method)
    np.testing.assert_array_equal(found["amplitude"].image, others["amplitude"].image)
    reconstruct(burst, method=method, frames=range(1, 9))  # of which it is none


def test_a_copy_of_a_frame_is_left_out_and_makes_no_noise_less() -> None:
    for seed in range(3):
        places = square(2)[[0, 1, 1, 3]]
        y = seen(seed, places)
        y[2] = y[1]
        burst = Burst.from_arrays(y, offset_px=places, pitch_mm=0.1)
        with pytest.warns(
            QualityWarning, match=r"noise and all, are left out: frame 2 \(of 1\)"
        ) as said:
            found = reconstruct(burst, 2, psf_sigma_px=12**-0.5)["amplitude"]
        assert said[0].filename == __file__
        assert found.noise_sigma is not None
        assert 0.7 * SIGMA < found.noise_sigma < 1.5 * SIGMA
        three = Burst.from_arrays(y[[0, 1, 3]], offset_px=places[[0, 1, 3]], pitch_mm=0.1)
        other = reconstruct(three, 2, psf_sigma_px=12**-0.5)["amplitude"]
        np.testing.assert_allclose(found.image, other.image, atol=SIGMA)


@pytest.mark.parametrize("phasors", [False, True])
def test_a_copy_that_was_told_to_lie_elsewhere_is_named_and_left_out(phasors: bool) -> None:
    """It passed for something that moved, or for a frame that lies elsewhere."""
    for seed in range(3):
        places, y = square(2), seen(seed, square(2))
        y[2] = y[1]
        told = {"offset_px": places, "pitch_mm": 0.1}
        burst = Burst.from_arrays(y, **told)
        if phasors:
            burst = Burst.from_arrays((0.5 + np.abs(y)) * np.exp(1j), modulation_hz=2e7, **told)
        left, said = without_copies(burst, range(4))
        assert "frame 2 (of 1)" in said[0]
        assert "told to lie elsewhere" in said[0]
        assert left.valid.any(axis=(1, 2)).tolist() == [True, True, False, True]


def test_frames_that_are_alike_elsewhere_or_show_nothing_are_no_copies() -> None:
    y = np.tile(np.linspace(0, 1, SHAPE[1]), (4, SHAPE[0], 1))
    burst = Burst.from_arrays(y, offset_px=[[-0.5, 0], [0, 0], [0.5, 0], [1, 0]], pitch_mm=0.1)
    assert without_copies(burst, range(4))[0] is burst
    flat = Burst.from_arrays(np.ones((4, *SHAPE)), offset_px=np.zeros((4, 2)), pitch_mm=0.1)
    assert without_copies(flat, range(4))[0] is flat


def test_frames_that_are_all_blank_are_what_they_are() -> None:
    flat = Burst.from_arrays(np.full((4, *SHAPE), 7.0), offset_px=square(2), pitch_mm=0.1)
    assert without_blank(flat, range(4))[0] is flat
