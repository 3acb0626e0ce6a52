"""The camera before flat targets: areas, directions and noise come out as physics says."""

import numpy as np
import pytest

from lensshift.camera import QUARTER_SQUARE_PX, Sensor, pixel_means, simulate_burst
from lensshift.core.grid import Grid
from lensshift.scene import Box, Place, Target, boxes, demo_target

GRID = Grid((7, 11), (0.2, 0.1))


def flat(radiance: float) -> Target:
    return lambda row_mm, col_mm: np.full(np.broadcast(row_mm, col_mm).shape, radiance)


def wave(frequency_lpmm: float) -> Target:
    def radiance(row_mm: Place, col_mm: Place) -> np.ndarray:
        return 0.5 + 0.4 * np.cos(2 * np.pi * frequency_lpmm * col_mm) + 0.0 * row_mm

    return radiance


def test_a_pixel_gets_the_share_of_its_area() -> None:
    # One box of 1.5 x 2.25 px in the middle of an odd sensor: the areas can be counted by hand.
    box = boxes([Box((0.0, 0.0), (1.5 * 0.2, 2.25 * 0.1), 1.0)])
    seen = pixel_means(box, GRID, (0, 0), samples=32, optics_sigma_px=0.0)
    background = seen[0, 0]
    share = (seen - background) / (1 - background)
    np.testing.assert_allclose(share[2:5, 4:7].sum(), 1.5 * 2.25, rtol=3e-3)
    np.testing.assert_allclose(share[3, 4:7], [0.625, 1.0, 0.625], atol=0.02)
    np.testing.assert_allclose(share[2:5, 5], [0.25, 1.0, 0.25], atol=0.02)


def test_large_sensors_are_done_in_strips(monkeypatch: pytest.MonkeyPatch) -> None:
    target = demo_target((1.4, 1.1))
    whole = pixel_means(target, GRID, (0.3, -0.1), 8, 0.4)
    monkeypatch.setattr("lensshift.camera.flat._SAMPLES_AT_ONCE", 8 * 8 * 15 * 2)
    np.testing.assert_allclose(pixel_means(target, GRID, (0.3, -0.1), 8, 0.4), whole, atol=1e-12)


def test_positive_offset_moves_the_content_down_and_right() -> None:
    target = demo_target((7 * 0.2, 11 * 0.1))
    still = pixel_means(target, GRID, (0, 0), 16, 0.2)
    moved = pixel_means(target, GRID, (1, 2), 16, 0.2)
    np.testing.assert_allclose(moved[2:, 3:], still[1:-1, 1:-2], atol=0.05)
    assert np.abs(moved[2:, 3:] - still[2:, 3:]).max() > 0.2


@pytest.mark.parametrize(("frequency_lpmm", "sigma_px"), [(1.7, 0.0), (3.1, 0.0), (2.3, 0.35)])
def test_contrast_of_a_wave_is_aperture_times_optics(
    frequency_lpmm: float, sigma_px: float
) -> None:
    pitch_mm = 0.1
    seen = pixel_means(wave(frequency_lpmm), Grid((3, 21), (0.2, pitch_mm)), (0, 0), 24, sigma_px)
    per_px = frequency_lpmm * pitch_mm
    contrast = np.sinc(per_px) * np.exp(-2 * (np.pi * per_px * sigma_px) ** 2)
    centre = np.arange(21) - 10
    expected = 0.5 + 0.4 * contrast * np.cos(2 * np.pi * per_px * centre)
    np.testing.assert_allclose(seen, np.broadcast_to(expected, seen.shape), atol=2e-3)


@pytest.mark.parametrize("level", [0.1, 0.7])
def test_noise_is_shot_and_read_noise(level: float) -> None:
    sensor = Sensor(Grid((40, 60), (0.1, 0.1)), 5_000.0, read_noise_electrons=30.0, bits=14)
    burst, truth = simulate_burst(flat(level), sensor, [(0, 0), (0.1, 0.4)], seed=4)
    expected = np.sqrt(level * 5_000 + 30**2) / 5_000
    assert burst.amplitude.std() == pytest.approx(expected, rel=0.05)
    assert burst.amplitude.mean() == pytest.approx(level, rel=5e-3)
    np.testing.assert_allclose(truth.image, level)


def test_converter_has_its_steps_and_saturates() -> None:
    sensor = Sensor(GRID, bits=5)
    burst, _ = simulate_burst(demo_target((1.4, 1.1)), sensor)
    codes = burst.amplitude * 31
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-12)
    bright, _ = simulate_burst(flat(1.5), sensor)
    assert bright.amplitude.max() == 1.0


def test_truth_is_what_smaller_pixels_see() -> None:
    burst, truth = simulate_burst(demo_target((1.4, 1.1)), Sensor(GRID), scale=3, seed=1)
    assert truth.image.shape == (21, 33)
    at_rest = pixel_means(demo_target((1.4, 1.1)), GRID, (0, 0), 30, 0.1)
    binned = truth.image.reshape(7, 3, 11, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(binned, at_rest, atol=0.01)
    assert burst.grid == GRID


def test_offsets_are_the_planned_ones_and_the_lens_errs_by_as_much_as_it_says() -> None:
    planned = np.tile(QUARTER_SQUARE_PX, (50, 1))
    sensor = Sensor(Grid((2, 3), (0.1, 0.1)))
    burst, truth = simulate_burst(flat(0.5), sensor, planned, shift_error_px=0.02, seed=3)
    np.testing.assert_array_equal(burst.offset_px, planned)
    error = truth.offset_px - planned
    assert error.std() == pytest.approx(0.02, rel=0.15)
    assert burst.offset_sigma_px is not None
    np.testing.assert_array_equal(burst.offset_sigma_px, 0.02)


def test_same_seed_same_burst() -> None:
    target, sensor = demo_target((1.4, 1.1)), Sensor(GRID)
    first, again, other = (simulate_burst(target, sensor, seed=seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.amplitude, again.amplitude)
    assert np.any(first.amplitude != other.amplitude)


def test_nonsense_is_refused() -> None:
    target, sensor = flat(0.5), Sensor(GRID)
    with pytest.raises(ValueError, match="planned_px"):
        simulate_burst(target, sensor, [0.25, 0.25])
    with pytest.raises(ValueError, match="integer scale"):
        simulate_burst(target, sensor, scale=0)
    with pytest.raises(ValueError, match="shift_error_px"):
        simulate_burst(target, sensor, shift_error_px=-1.0)
    with pytest.raises(ValueError, match="full well"):
        Sensor(GRID, full_well_electrons=0.0)
    with pytest.raises(ValueError, match="bits"):
        Sensor(GRID, bits=0)
