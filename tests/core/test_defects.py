"""Pixels that show the same whatever lies before them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from lensshift import Burst, QualityWarning, reconstruct, register
from lensshift.core.defects import not_measured, still_pixels, stuck_pixels

SHAPE = (23, 34)
FOUR_PX = np.array([(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)])


def soft_scene(seed: int, offset_px: np.ndarray, sigma: float = 0.01) -> np.ndarray:
    """Return frames [frame row col] of smooth texture that moves by Fourier's shift."""
    rng = np.random.default_rng(seed)
    scene = gaussian_filter(rng.standard_normal(SHAPE), 1.2, mode="wrap")
    scene = 0.5 + 0.15 * scene / scene.std()
    row, col = np.fft.fftfreq(SHAPE[0])[:, None], np.fft.fftfreq(SHAPE[1])
    turns = [np.exp(-2j * np.pi * (row * r + col * c)) for r, c in offset_px]
    y = np.stack([np.fft.ifft2(np.fft.fft2(scene) * turn).real for turn in turns])
    return np.asarray(y + sigma * rng.standard_normal(y.shape))


def star(at: tuple[float, float], offset_px: np.ndarray, lens_px: float) -> np.ndarray:
    """Return frames of a point of light 1 at a place, behind a Gaussian lens, by square pixels."""
    shares = []
    for axis, size in enumerate(SHAPE):
        edge = np.arange(size + 1) - 0.5 - at[axis] - offset_px[:, axis, None]
        shares.append(np.diff(0.5 * erf(edge / lens_px / np.sqrt(2)), axis=1))
    return np.einsum("kr,kc->krc", *shares)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("unit", [1.0, -250.0])
def test_hot_and_dead_pixels_are_found_and_no_others(seed: int, unit: float) -> None:
    y = soft_scene(seed, FOUR_PX)
    assert stuck_pixels(unit * y) is None
    y[:, 4, 7], y[:, 22, 0], y[:, 15, 30] = 9.0, 8.0, -6.0
    found = stuck_pixels(unit * y)
    assert found is not None
    assert np.argwhere(found).tolist() == [[4, 7], [15, 30], [22, 0]]
    valid = np.ones(y.shape, bool)
    valid[1, 4, 7] = valid[:, 15, 29] = False
    found = stuck_pixels(np.where(valid, unit * y, np.nan), valid)
    assert found is not None
    assert np.argwhere(found).tolist() == [[15, 30], [22, 0]]


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_that_noise_does_not_change_is_dead_though_it_does_not_stand_out(seed: int) -> None:
    moves_px = np.random.default_rng(seed).uniform(-0.9, 0.9, (20, 2))
    y = soft_scene(seed, moves_px)
    valid = np.ones(y.shape, bool)
    assert not still_pixels(y, valid).any()
    y[:, 4, 7], y[:, 15, 30] = np.median(y), y[0, 15, 30]
    assert stuck_pixels(y) is None
    assert np.argwhere(still_pixels(y, valid)).tolist() == [[4, 7], [15, 30]]
    valid[3, 4, 7] = False
    assert np.argwhere(still_pixels(y, valid)).tolist() == [[15, 30]]
    assert not still_pixels(y[:8], valid[:8]).any()  # too few frames to be sure
    flat = np.rint(2.0 * soft_scene(seed, moves_px, sigma=1e-3))  # noise below a converter's level
    assert not still_pixels(flat, np.ones(flat.shape, bool)).any()


@pytest.mark.parametrize("unit", [1.0, -250.0])
def test_dead_rows_and_columns_are_found_and_no_others(unit: float) -> None:
    y = soft_scene(3, FOUR_PX)
    y[:, 9], y[:, :, 20] = 0.0, 0.6
    found = stuck_pixels(unit * y)
    assert found is not None
    row, col = np.indices(SHAPE)
    np.testing.assert_array_equal(found, (row == 9) | (col == 20))
    y[:, 10:14] = 0.0  # what never changes need not be a defect: a border, a sky at its end
    found = stuck_pixels(unit * y)
    assert found is not None
    np.testing.assert_array_equal(found, col == 20)


def test_points_of_light_behind_a_lens_are_no_defects() -> None:
    rng = np.random.default_rng(4)
    for _ in range(40):
        at = rng.uniform(4, 19, 2)
        y = 0.2 + 30 * star((at[0], at[1]), FOUR_PX, float(rng.uniform(0.2, 0.5)))
        assert stuck_pixels(y + 0.01 * rng.standard_normal(y.shape)) is None


def test_levels_of_a_flat_hill_are_no_defects() -> None:
    row, col = np.indices(SHAPE)
    hill = 100.6 - ((row - 11) ** 2 + (col - 17) ** 2) / 30
    assert stuck_pixels(np.round(np.stack([hill] * 4))) is None


def test_few_frames_and_narrow_ones_tell_no_defects() -> None:
    y = soft_scene(1, FOUR_PX)
    y[:, 4, 7] = 9.0
    assert stuck_pixels(y[:2]) is None
    assert stuck_pixels(y[:, 4:6]) is None


def test_defects_pull_no_shifts_and_are_no_part_of_the_picture() -> None:
    clean = soft_scene(2, FOUR_PX)
    y = clean.copy()
    y[:, 4, 7], y[:, 15, 30], y[:, 12, 12] = 9.0, 8.0, -5.0
    unknown = Burst.from_arrays(y, offset_px=np.zeros((4, 2)), pitch_mm=0.1)
    found = register(unknown).offset_px
    np.testing.assert_allclose(found - found[0], FOUR_PX - FOUR_PX[0], atol=0.04)
    known = Burst.from_arrays(y, offset_px=FOUR_PX, pitch_mm=0.1)
    with pytest.warns(QualityWarning, match=r"do not follow.* 3, at .*\(4, 7\), \(12, 12") as said:
        with_defects = reconstruct(known, 2).amplitude
    assert said[0].filename == __file__
    right = reconstruct(Burst.from_arrays(clean, offset_px=FOUR_PX, pitch_mm=0.1), 2).amplitude
    assert np.sqrt(np.mean((with_defects.image - right.image) ** 2)) < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_a_phasor_without_light_is_found_however_bright_others_are(seed: int) -> None:
    light = 0.2 * soft_scene(seed, FOUR_PX) + 1.0
    light[:, :, 24:] += 40.0
    assert stuck_pixels(light, phasors=True) is None
    light[:, 8, 11] = 0.01
    found = stuck_pixels(light, phasors=True)
    assert found is not None
    assert np.argwhere(found).tolist() == [[8, 11]]


def test_a_phasor_of_0_amid_light_was_not_measured() -> None:
    lights = [soft_scene(seed, FOUR_PX) + 1.0 for seed in range(2)]
    valid = np.ones(lights[0].shape, bool)
    assert not not_measured(lights, valid).any()
    lights[1][2, 5:8, 5:8] = 0.0  # the other frequency shows light there
    lights[0][1, 9, 9] = 0.0
    found = np.zeros(valid.shape, bool)
    found[2, 5:8, 5:8] = found[1, 9, 9] = True
    np.testing.assert_array_equal(not_measured(lights, valid), found)
    black = lights[0].copy()
    black[:, 5:8, 5:8] = 0.0  # which of one frequency a surface may be
    assert np.argwhere(not_measured([black], valid)).tolist() == [[1, 9, 9]]
    coarse = np.rint(2.0 * soft_scene(0, FOUR_PX, 0.4))  # where some are rounded off to 0
    assert np.any(coarse == 0)
    assert not not_measured([coarse, np.rint(3.0 * soft_scene(1, FOUR_PX))], valid).any()


def test_no_light_at_all_is_no_defect() -> None:
    dark, valid = np.zeros((4, *SHAPE)), np.ones((4, *SHAPE), bool)
    valid[:, 0] = False
    assert not not_measured([dark], valid).any()
