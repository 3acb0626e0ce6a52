"""The frames may refute the picture: what is wrong is named, what is right raises no alarm."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mosaic import MARGIN_PX, SAMPLES, canvas, mosaic_burst, observe, square
from pixel_camera import edge_scene, photograph, smooth_scene

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Status
from lensshift.forward.model import forward_model
from lensshift.io.result_file import load_reconstruction, save_reconstruction
from lensshift.reconstruction.displacement import displaced, told_shifts
from lensshift.reconstruction.misfit import _unexplained, find_misfit
from lensshift.reconstruction.reconstruct import reconstruct

SHAPE = (21, 26)
SIGMA = 0.016


def burst_of(y: np.ndarray, offset_px: np.ndarray | None = None) -> Burst:
    offset = square(2) if offset_px is None else offset_px
    return Burst.from_arrays(y, offset_px=offset, pitch_mm=0.1)


def moving(seed: int, by_px: float) -> tuple[np.ndarray, np.ndarray, tuple[slice, slice]]:
    """Return frames in which a bright square moves evenly to the right, the first alone, where."""
    rng = np.random.default_rng(seed)
    ground = canvas(rng, SHAPE)
    frames = []
    for k, offset in enumerate(square(2)):
        fine = ground.copy()
        top, left = (int((MARGIN_PX + 8) * SAMPLES + d) for d in (0, by_px * SAMPLES * k / 3))
        fine[top : top + 6 * SAMPLES, left : left + 6 * SAMPLES] = 1.2
        frames.append(observe(fine, SHAPE, offset_px=offset[None], snr=50.0, rng=rng))
    still = observe(_with_square(ground), SHAPE, snr=50.0, rng=rng)
    return np.concatenate([f.y for f in frames]), still.truth, (slice(14, 30), slice(14, 36))


def _with_square(ground: np.ndarray) -> np.ndarray:
    fine, at = ground.copy(), (MARGIN_PX + 8) * SAMPLES
    fine[at : at + 6 * SAMPLES, at : at + 6 * SAMPLES] = 1.2
    return fine


def warned(burst: Burst, **settings: object) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", QualityWarning)
        reconstruct(burst, std=False, **settings)  # type: ignore[arg-type]
    return [str(w.message) for w in caught]


def test_chi_square_of_noise_about_a_true_picture_is_one() -> None:
    rng = np.random.default_rng(4)
    model = forward_model(SHAPE, 2, square(2))
    for kind in (1, 1j):
        x = rng.uniform(0, 1, model.hr_shape) * (1 + (0 if kind == 1 else 1j))
        noise = rng.standard_normal((4, *SHAPE))
        if kind == 1j:
            noise = noise + 1j * rng.standard_normal(noise.shape)
        y = model.operator(x) + SIGMA * noise
        found = find_misfit(model.operator, x, y, np.full(y.shape, SIGMA), 2)
        assert found.chi_square.mean() == pytest.approx(1.0, abs=0.1)
        assert np.mean(found.unexplained > 0.0) < 0.02
        assert found.explain(range(4)) is None


def test_the_map_is_large_where_a_frame_is_off_and_one_elsewhere() -> None:
    rng = np.random.default_rng(5)
    model = forward_model(SHAPE, 2, square(2))
    y = SIGMA * rng.standard_normal((4, *SHAPE))
    y[2, 10:14, 5:9] += 8 * SIGMA
    found = find_misfit(model.operator, np.zeros(model.hr_shape), y, np.full(y.shape, SIGMA), 2)
    assert np.median(found.chi_square[22:27, 12:17]) > 8
    assert np.median(found.chi_square[:, 30:]) < 1.5
    assert found.weight(of_phasors=False)[2, 12, 7] == 0.0
    assert np.all(found.weight(of_phasors=False)[0] == 1.0)
    assert found.weight(of_phasors=False)[:, :5].mean() > 0.99


def against_black(y: np.ndarray) -> np.ndarray:
    """Return how much frames contradict a black picture, in which no shift shows."""
    model = forward_model(y.shape[1:], 2, square(2)[: len(y)])
    return find_misfit(model.operator, np.zeros(model.hr_shape), y, np.ones(y.shape), 2).against


@pytest.mark.parametrize("kind", [1.0, 1.0 + 1.0j])
def test_twice_the_noise_in_a_window_contradicts(kind: complex) -> None:
    y = np.zeros((4, *SHAPE))
    y[1, 8:13, 9:14] = 2.0
    against = against_black(kind * y)
    assert against[1, 10, 11] == pytest.approx(1.0)
    assert against[1, 10, 10] == against[1, 9, 11] == pytest.approx(0.8)
    assert not against[[0, 2, 3], 3:-3, 3:-3].any()
    y[1, 8:13, 9:14] = 100.0  # as large as can be, and nothing that stands alone
    assert against_black(kind * y)[1, 10, 11] == pytest.approx(25 / 4)


@pytest.mark.parametrize("share", [0.005, 0.02])
def test_windows_of_lone_outliers_are_eight_deviations_from_contradicting(share: float) -> None:
    rng = np.random.default_rng(12)
    y = np.clip(rng.standard_normal((4, 160, 210)), -3.0, 3.0)
    y[rng.random(y.shape) < share] = 1000.0
    inner = against_black(y)[:, 3:-3, 3:-3]
    assert 1.0 - inner.mean() == pytest.approx(8.0 * inner.std(), rel=0.02)


@pytest.mark.parametrize("kind", [1.0, 1.0 + 1.0j])
def test_what_all_frames_contradict_by_half_or_more_is_no_movement(kind: complex) -> None:
    """Detail finer than the grid looks so."""
    model, ones = forward_model(SHAPE, 2, square(2)), np.ones((4, *SHAPE))
    for least, doubted in ((0.45, 1.5), (0.55, 1.0)):
        y = np.zeros((4, *SHAPE))
        share = np.array([least, 1.0, least, 0.8])
        y[:, 10:15, 10:15] = 2.0 * np.sqrt(1.5 * share)[:, None, None]
        y[1, 5:10, 15:20] = 2.0 * np.sqrt(2.0)  # of this frame alone
        found = find_misfit(model.operator, np.zeros(model.hr_shape), kind * y, ones, 2)
        assert found.doubt[1, 12, 12] == pytest.approx(doubted)
        assert found.doubt[1, 7, 17] == pytest.approx(2.0)


@pytest.mark.parametrize("parts", [1.0, 2.0])
def test_three_standard_errors_of_a_mean_of_nine_pixels_of_all_frames_are_chance(
    parts: float,
) -> None:
    """The mean of n squares of white noise has the variance 2 / n."""
    model, sigma = forward_model((21, 26), 2, square(2)), 0.02
    seen, error = np.ones((4, 21, 26), np.float32), np.sqrt(2 / (9 * 4 * parts))
    for errors in (2.9, 4.0, 9.0):
        chi = seen * np.float32(1 + errors * error)
        found = _unexplained(model.operator, chi, seen * sigma**2, seen, parts)
        beyond = max((1 + errors * error) / (1 + 3 * error) - 1, 0.0)
        np.testing.assert_allclose(found[6:-6, 6:-6], sigma * np.sqrt(beyond), rtol=1e-3)


@pytest.mark.parametrize("of_phasors", [False, True])
@pytest.mark.parametrize(("off_px", "moved"), [(0.36, False), (0.39, True)])
def test_what_surrounds_an_error_of_a_shift_is_believed_less_if_it_is_movement(
    off_px: float, moved: bool, of_phasors: bool
) -> None:
    """Shifts of 0.1 px are allowed, four times their square contradicts, and 0.37 px is movement.

    Belief falls from doubts of a half to 0.8 beside movement and in phasors, else from 1 to 2.5.
    """
    model = forward_model(SHAPE, 2, square(2))
    black, ones = np.zeros((4, *SHAPE)), np.ones((4, *SHAPE))
    found = find_misfit(model.operator, np.zeros(model.hr_shape), black, ones, 2)
    against = 0.05 * ones
    around = np.array([0.4, 0.55, 0.65, 0.75, 0.9, 1.3, 1.75, 2.2, 2.6])
    against[2, 5, 3:12], against[2, 5, 12] = around, (off_px / 0.1) ** 2 / 4
    against[3, 5, 3:12] = around  # of another frame, beside nothing
    weight = replace(found, against=against).weight(of_phasors)
    beside = np.interp(around, (0.5, 0.8), (1.0, 0.0))
    alone = np.interp(around, (1.0, 2.5), (1.0, 0.0))
    np.testing.assert_allclose(weight[2, 5, 3:12], beside if moved or of_phasors else alone)
    np.testing.assert_allclose(weight[3, 5, 3:12], beside if of_phasors else alone)
    assert weight[2, 5, 12] == 0.0
    assert np.all(weight[:2] == 1.0)


@pytest.mark.parametrize(("columns", "lit"), [(4, False), (5, True)])
def test_less_than_a_window_of_pixels_tells_no_light(columns: int, lit: bool) -> None:
    rng = np.random.default_rng(3)
    model = forward_model(SHAPE, 2, square(2))
    y = model.predict(np.ones(model.hr_shape)) * np.array([1.0, 1.5, 0.7, 1.0])[:, None, None]
    y += SIGMA * rng.standard_normal(y.shape)
    sigma = np.full(y.shape, np.inf)
    sigma[:, 8:13, 9 : 9 + columns] = SIGMA
    found = find_misfit(model.operator, np.ones(model.hr_shape), y, sigma, 2)
    assert (found.brightness > 1.0) is lit
    assert lit or found.brightness == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_right_bursts_raise_no_alarm(seed: int) -> None:
    seen = mosaic_burst(400 + seed, SHAPE, snr=(20.0, 60.0, 200.0)[seed % 3])
    assert warned(burst_of(seen.y)) == []


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_a_frame_that_lies_elsewhere_is_named(seed: int) -> None:
    seen = mosaic_burst(seed, SHAPE)
    told = square(2)
    told[2] += (0.6, -0.8)
    texts = warned(burst_of(seen.y, told))
    assert len(texts) == 1
    assert "frame 2 does not fit" in texts[0]


@pytest.mark.parametrize("across_px", [-0.9, 0.5, 0.9])
@pytest.mark.parametrize("snr", [50.0, 200.0])
def test_a_frame_that_lies_elsewhere_is_named_where_there_is_one_edge(
    snr: float, across_px: float
) -> None:
    rng = np.random.default_rng(12)
    offset = rng.uniform(-0.5, 0.5, (6, 2))
    y = photograph(edge_scene, SHAPE, offset)
    y += rng.normal(0.0, 0.8 / snr, y.shape)
    told = offset.copy()
    told[4, 1] += across_px
    texts = warned(burst_of(y, told))
    assert len(texts) == 1
    assert texts[0].startswith("frame 4 does not fit")


def test_the_number_of_a_frame_is_that_in_the_burst() -> None:
    seen = mosaic_burst(31, SHAPE, offset_px=np.concatenate([square(2), square(2)]))
    told = np.concatenate([square(2), square(2)])
    told[6] += (0.6, -0.8)
    assert "frame 6 does" in warned(burst_of(seen.y, told), frames=(0, 2, 3, 5, 6))[0]


@pytest.mark.parametrize("by_px", [1.0, 3.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_moves_is_named_and_shown_as_in_the_first_frame(seed: int, by_px: float) -> None:
    y, truth, place = moving(seed, by_px)
    burst = burst_of(y)
    with pytest.warns(QualityWarning, match="something moved at rows"):
        result = reconstruct(burst).amplitude
    alone = reconstruct(burst, method="bicubic", frames=(0,), std=False).amplitude
    assert result is not None
    assert alone is not None
    assert result.status is Status.CONTRADICTED
    errors = [np.sqrt(np.mean((e.image - truth)[place] ** 2)) for e in (result, alone)]
    assert errors[0] < errors[1]


def test_what_else_looks_like_movement_is_said_beside_it() -> None:
    """Phasors of two distances in a pixel add up to less than their amplitudes do."""
    y = moving(1, 3.0)[0]
    burst = replace(burst_of(y), distance_m=np.ones_like(y))
    (text,) = warned(burst, channel="amplitude")
    assert "something moved" in text
    assert "channel phasor" in text
    assert "a larger one" not in text
    assert "channel phasor" not in warned(burst_of(y))[0]


def test_frames_of_other_brightness_are_named() -> None:
    seen = mosaic_burst(41, SHAPE)
    gain = np.array([1.0, 1.1, 0.92, 1.0])[:, None, None]
    assert "brightness" in warned(burst_of(gain * seen.y))[0]


def test_lone_outliers_are_nothing_that_moved() -> None:
    seen = mosaic_burst(42, SHAPE)
    rng = np.random.default_rng(6)
    y = np.where(rng.random(seen.y.shape) < 0.02, rng.integers(0, 2, seen.y.shape), seen.y)
    assert not any("moved" in text for text in warned(burst_of(y)))


@pytest.mark.parametrize("seed", [31, 32])
def test_lone_outliers_hardly_widen_std(seed: int) -> None:
    burst = mosaic_burst(seed, SHAPE, snr=60.0)
    rng = np.random.default_rng(seed)
    wild = np.zeros(burst.y.shape, bool)
    wild[:, 2:-2:6, 2:-2:6] = rng.random((4, 3, 4)) < 0.4  # 2 %, none beside another
    shown = np.where(wild, 1.5, burst.y)
    found, usual = (reconstruct(burst_of(y)).amplitude for y in (shown, burst.y))
    size = np.abs(found.image - burst.truth) / found.std
    assert np.mean(size < 2) > 0.9
    assert np.sqrt(np.mean(found.std**2)) < 1.5 * np.sqrt(np.mean(usual.std**2))


def test_misfit_widens_std_and_travels_with_the_result(tmp_path: Path) -> None:
    seen = mosaic_burst(43, SHAPE)
    right = reconstruct(burst_of(seen.y), noise_sigma=SIGMA)
    told_less = reconstruct(burst_of(seen.y), noise_sigma=SIGMA / 3)
    assert right.amplitude is not None
    assert told_less.amplitude is not None
    assert right.amplitude.misfit is not None
    assert told_less.amplitude.notes["misfit"] > 3 * right.amplitude.notes["misfit"]
    save_reconstruction(right, tmp_path / "r.nc")
    again = load_reconstruction(tmp_path / "r.nc").amplitude
    assert again is not None
    np.testing.assert_allclose(again.misfit, right.amplitude.misfit)  # type: ignore[arg-type]
    assert replace(right.amplitude, misfit=None).misfit is None


@pytest.mark.parametrize(
    ("elsewhere", "brightness", "doubt", "curable"),
    [(0, 0.0, 0.9, False), (0, 0.0, 1.1, True), (1, 0.0, 0.9, True), (1, 2.0, 0.9, True),
     (2, 0.0, 1.1, False), (2, 2.0, 1.1, False), (0, 2.0, 1.1, False)],
)  # fmt: skip
def test_what_few_frames_contradict_can_be_cured_and_other_light_cannot(
    elsewhere: int, brightness: float, doubt: float, curable: bool
) -> None:
    model = forward_model(SHAPE, 2, square(2))
    black, ones = np.zeros((4, *SHAPE)), np.ones((4, *SHAPE))
    found = replace(
        find_misfit(model.operator, np.zeros(model.hr_shape), black, ones, 2),
        off_px=dict.fromkeys(range(elsewhere), (0.5, 0.5)), brightness=brightness,
        doubt=doubt * ones,
    )  # fmt: skip
    assert found.curable is curable


@pytest.mark.parametrize("seed", [0, 1])
def test_along_a_single_edge_no_shift_is_told(seed: int) -> None:
    """Across it one frame lies off by half a pixel; along it all lie anywhere."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, np.pi)
    along, across = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    covariance = np.tile(np.outer(along, along) + 0.01**2 * np.outer(across, across), (7, 1, 1))
    found_px = rng.normal(size=(7, 1)) * along + 0.01 * rng.normal(size=(7, 1)) * across
    found_px[4] += 0.5 * across
    shifts, error = told_shifts(found_px, covariance)
    np.testing.assert_allclose(shifts[4], 0.5 * across, atol=0.04)
    assert error[4] == pytest.approx(0.01)
    assert not np.any(np.delete(shifts, 4, axis=0))


@pytest.mark.parametrize("kind", [1.0, np.exp(0.8j)])
def test_what_lies_elsewhere_shows_before_its_residuals_are_large(kind: complex) -> None:
    rng = np.random.default_rng(9)
    slopes = kind * rng.standard_normal((2, 3, 15, 23))
    variance, seen = np.full((3, 15, 23), 1.0), np.ones((3, 15, 23))
    off_px = np.zeros((2, 3, 15, 23))
    off_px[:, 1, :, 12:] = np.array([0.5, -0.3])[:, None, None]
    noise = rng.standard_normal((3, 15, 23)) * kind
    moved = np.sum(off_px * slopes, axis=0)
    assert np.mean(np.abs(moved[1, :, 12:]) ** 2) < 0.5  # half of the noise, chi-square 1.5
    strong = displaced(30.0 * moved + noise, 30.0 * slopes, variance, seen)
    assert strong[1, 2:-2, 14:-2].min() > 1.0
    assert strong[1, :, :10].max() < 1.0
    assert strong[::2].max() < 1.0
    # The same shift of slopes that noise hides is no evidence.
    weak = displaced(0.3 * moved + noise, 0.3 * slopes, variance, seen)
    assert weak.max() < 1.0


def test_where_something_lies_elsewhere_does_not_depend_on_the_axes() -> None:
    rng = np.random.default_rng(10)
    slopes, r = rng.standard_normal((2, 2, 9, 14)), rng.standard_normal((2, 9, 14))
    variance, seen = rng.uniform(0.5, 2.0, r.shape), (rng.random(r.shape) < 0.8).astype(float)
    doubt = displaced(r, slopes, variance, seen)
    over = [v.swapaxes(-1, -2) for v in (r, slopes[::-1], variance, seen)]
    np.testing.assert_allclose(displaced(*over), doubt.swapaxes(-1, -2), rtol=1e-9)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    turned = np.tensordot(turn, slopes, 1)
    np.testing.assert_allclose(displaced(r, turned, variance, seen).max(), doubt.max(), rtol=1e-9)


def test_outliers_lie_nowhere_else() -> None:
    rng = np.random.default_rng(11)
    slopes, r = 20 * rng.standard_normal((2, 4, 15, 15)), rng.standard_normal((4, 15, 15))
    r[rng.random(r.shape) < 0.05] = 500.0
    assert displaced(r, slopes, np.ones(r.shape), np.ones(r.shape)).max() < 1.0


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("count", [4, 9])
def test_the_noise_of_an_even_scene_lies_nowhere_else(count: int, tilt: float) -> None:
    """It is in the slopes of the picture and in the residuals of its frame, which go together."""
    for seed in (5, 6, 7):
        rng, shape = np.random.default_rng([seed, count]), (64, 80)
        offset_px = square(2) if count == 4 else rng.uniform(-0.5, 0.5, (9, 2))
        col = np.arange(shape[1]) - offset_px[:, 1, None, None]
        noise = 0.02 * rng.standard_normal((count, *shape))
        assert warned(burst_of(1 + tilt * col / shape[1] + noise, offset_px)) == []


@pytest.mark.parametrize("seed", range(8))
def test_a_smooth_scene_of_few_pixels_has_one_brightness(seed: int) -> None:
    """Light goes with its slopes; of 60 such bursts 32 were said to differ in brightness."""
    rng = np.random.default_rng([seed, 9])
    y = photograph(smooth_scene, (9, 13), square(2)) + 0.005 * rng.standard_normal((4, 9, 13))
    assert warned(burst_of(y)) == []


@pytest.mark.parametrize("px", [1, 2, 3])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("seed", range(3))
def test_a_disc_that_steps_aside_once_is_told_of_phasors(seed: int, axis: int, px: int) -> None:
    """Half of the frames show it elsewhere; a finer picture, of rows in turn, explains both."""
    shape, rng, offset_px = (24, 33), np.random.default_rng(seed), square(2)
    rows, cols = ((n + 2 * MARGIN_PX) * SAMPLES for n in shape)
    row, col = np.mgrid[:rows, :cols] / SAMPLES - MARGIN_PX
    at, radius = rng.uniform(8, [shape[0] - 8, shape[1] - 11]), rng.uniform(3, 5)
    frames = []
    for moved in (0, px):
        down, right = at + moved * np.eye(2)[axis]
        disc = (row - down) ** 2 + (col - right) ** 2 < radius**2
        fine = np.where(disc, 0.9, 0.2 + 0.002 * col) * np.exp(1j * np.where(disc, 0.3, 1.2))
        frames.append(observe(fine, shape, offset_px=offset_px, snr=1e9, rng=rng).y)
    y = np.concatenate([frames[0][:2], frames[1][2:]])
    y = y + 0.004 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    burst = Burst.from_arrays(y, offset_px=offset_px, pitch_mm=0.1, modulation_hz=15e6)
    with pytest.warns(QualityWarning, match="moved"):
        reconstruct(burst)
