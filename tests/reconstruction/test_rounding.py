"""Numbers that are on few levels: what a surface shares of that, and what frames do not tell."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import SQUARE_PX

from lensshift import Burst, reconstruct
from lensshift.core.units import distance_to_phase
from lensshift.reconstruction.rounding import shared_rounding

HZ, SHAPE = 20e6, (20, 27)


def _slope(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return distances [frame row col] of a slanted wall, and those of a fine picture of it."""
    down, right = np.random.default_rng(seed).uniform(-0.004, 0.004, 2)
    row, col = np.indices(SHAPE)
    fine_row, fine_col = np.indices([2 * n for n in SHAPE]) / 2 - 0.25
    moved = SQUARE_PX[:, :, None, None]
    frames_m = 2.0 + down * (row - moved[:, 0]) + right * (col - moved[:, 1])
    return frames_m, 2.0 + down * fine_row + right * fine_col


def _within(z: np.ndarray, truth_m: np.ndarray, **fields) -> tuple[float, float]:
    """Return the share of distances within two std, and the middle std."""
    burst = Burst.from_arrays(z, offset_px=SQUARE_PX, pitch_mm=0.1, modulation_hz=HZ, **fields)
    found = reconstruct(burst).distance_m
    inner = np.s_[3:-3, 3:-3]
    inside = np.abs(found.image - truth_m)[inner] < 2 * found.std[inner]
    return float(np.mean(inside)), float(np.median(found.std[inner]))


@pytest.mark.parametrize("seed", range(4))
def test_a_converter_with_few_steps_is_in_the_std(seed: int) -> None:
    frames_m, truth_m = _slope(seed)
    z = 300.0 * np.exp(1j * distance_to_phase(frames_m, HZ))
    noise = np.random.default_rng([seed, 1]).standard_normal((2, *z.shape))
    z += 2.0 * (noise[0] + 1j * noise[1])
    rounded = 20.0 * (np.round(z.real / 20.0) + 1j * np.round(z.imag / 20.0))
    inside, std_m = _within(rounded, truth_m)
    assert inside > 0.93
    # 20 / sqrt(12) of 300 are 23 mm, of which 2 of noise dither nothing.
    assert 0.015 < std_m < 0.04
    assert _within(z, truth_m)[1] < 0.005


@pytest.mark.parametrize("seed", range(4))
def test_distances_in_whole_centimetres(seed: int) -> None:
    frames_m, truth_m = _slope(seed)
    frames_m += 0.0005 * np.random.default_rng([seed, 2]).standard_normal(frames_m.shape)
    amplitude = np.full(frames_m.shape, 3000.0)
    amplitude += np.random.default_rng([seed, 3]).standard_normal(frames_m.shape)
    inside, std_m = _within(amplitude, truth_m, distance_m=np.round(frames_m, 2))
    assert inside > 0.93
    assert 0.002 < std_m < 0.005  # 1 cm / sqrt(12) is 2.9 mm


def test_noise_dithers_what_is_shared() -> None:
    """Against means of many rounded numbers about levels that are spread over a step."""
    rng, level = np.random.default_rng(5), np.linspace(0.0, 1.0, 100, endpoint=False)
    for sigma in (0.0, 0.1, 0.2, 0.3, 0.5):
        mean = np.round(level[:, None] + sigma * rng.standard_normal((100, 40000))).mean(axis=1)
        shared = np.sqrt(np.mean((mean - level) ** 2))
        told = shared_rounding(1.0, np.array(np.hypot(sigma, np.sqrt(1 / 12))))
        assert told == pytest.approx(shared, abs=0.004)
    assert shared_rounding(0.0, np.array(1.0)) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_a_slope_on_few_levels_contradicts_nothing(seed: int) -> None:
    rng = np.random.default_rng([seed, 6])
    offset_px = rng.uniform(-0.6, 0.6, (int(rng.integers(4, 10)), 2))
    row, col = np.indices(SHAPE)
    down, right = rng.uniform(-0.2, 0.2, 2)
    moved = offset_px[:, :, None, None]
    light = 30.0 + down * (row - moved[:, 0]) + right * (col - moved[:, 1])
    light += rng.uniform(0.0, 0.3) * rng.standard_normal(light.shape)
    burst = Burst.from_arrays(np.round(light), offset_px=offset_px, pitch_mm=0.1)
    found = reconstruct(burst).amplitude  # warnings are errors
    fine_row, fine_col = np.indices([2 * n for n in SHAPE]) / 2 - 0.25
    error = (found.image - 30.0 - down * fine_row - right * fine_col)[3:-3, 3:-3]
    assert np.mean(np.abs(error) < 2 * found.std[3:-3, 3:-3]) > 0.93
