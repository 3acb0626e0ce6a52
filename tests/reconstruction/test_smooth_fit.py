"""What a smooth fit leaves: of white noise, of missing pixels, and of those that others predict."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, photograph, smooth_scene

from lensshift.reconstruction.smooth_fit import (
    MIDDLE,
    REFILLED,
    SmoothFits,
    _continued,
    outliers,
    refilled,
    smooth_fits,
)

SHAPE = (17, 22)


def _fits(count: int = 4, shape: tuple[int, int] = SHAPE) -> SmoothFits:
    offset_px = SQUARE_PX if count == 4 else _shifts(count)
    return smooth_fits(offset_px.tobytes(), count, shape, 0.3)


def _shifts(count: int) -> np.ndarray:
    return np.random.default_rng(count).uniform(-0.5, 0.5, (count, 2))


def _white(seed: int, windows: int, count: int, shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((windows, count, *shape)).astype(np.float32)


@pytest.mark.parametrize("shape", [(16, 21), (23, 24)])
@pytest.mark.parametrize("count", [1, 5])
def test_white_noise_of_one_leaves_one(shape: tuple[int, int], count: int) -> None:
    rest = _fits(count, shape).residuals(_white(count, 200, count, shape))
    inner = rest[..., 4:-4, 4:-4]  # what lies beyond the border is continued, no noise
    np.testing.assert_allclose(np.sqrt(np.mean(inner**2, axis=(1, 3, 4))), 1.0, rtol=0.03)


@pytest.mark.parametrize("count", [2, 5])
def test_a_pixel_lies_off_what_others_predict_by_its_residual_over_the_share(count: int) -> None:
    shape, at = (19, 26), (..., 9, 12)
    fits, values = _fits(count, shape), _white(count, 40, count, shape)
    for frame in range(count):
        missing = np.zeros(values.shape, bool)
        missing[:, frame, 9, 12] = True
        rest = fits.residuals(values, MIDDLE)[0]
        off = (values - refilled(fits, values, rest, missing))[:, frame][at]
        expected = rest[:, frame][at] / fits.share[frame]
        np.testing.assert_allclose(off, expected, atol=0.03 * np.std(expected))


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("seed", [0, 1])
def test_missing_pixels_are_filled_in_as_the_fit_expects_in_any_unit(
    seed: int, unit: float
) -> None:
    rng = np.random.default_rng(seed)
    fits = _fits()
    values = photograph(smooth_scene, SHAPE, SQUARE_PX).astype(np.float32)[None]
    missing = rng.random(values.shape) < 0.1
    values[missing] = rng.standard_normal(missing.sum())
    values *= np.float32(unit)
    rest = fits.residuals(values, MIDDLE)[0]
    before, filled = np.linalg.norm(rest[missing]), values
    for most in (20.0, 2.0):  # in hundredths of what there was; again from where it ended
        filled = refilled(fits, values, rest, missing, start=filled)
        np.testing.assert_array_equal(filled[~missing], values[~missing])
        left = np.linalg.norm(fits.residuals(filled, MIDDLE)[0][missing])
        assert left < most * REFILLED * before


@pytest.mark.parametrize("seed", range(3))
def test_lone_pixels_that_are_off_are_found_and_no_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = photograph(smooth_scene, SHAPE, SQUARE_PX)[None]
    values = (values + 0.02 * rng.standard_normal(values.shape)).astype(np.float32)
    off = rng.permutation(values.size) < 12
    off = off.reshape(values.shape)
    values[off] += np.float32(0.5) * rng.choice([-1, 1], 12)
    fits = _fits()
    rest = fits.residuals(values, MIDDLE)[0]
    found, _ = outliers(fits, values, rest, np.ones(values.shape, bool))
    assert np.count_nonzero(found & ~off) <= 1
    assert np.count_nonzero(off & ~found) <= 2  # beside another, or in a corner


@pytest.mark.parametrize("shape", [(1, 9), (2, 3), (3, 5), (7, 10)])
def test_frames_go_on_as_their_mirror_image_turned_over(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(shape[1]).standard_normal((2, 3, *shape))
    room = [(min(4, n - 1),) * 2 for n in shape]
    expected = np.pad(values, [(0, 0), (0, 0), *room], mode="reflect", reflect_type="odd")
    wide = _continued(values, (17, 20))
    rows, cols = expected.shape[-2:]
    np.testing.assert_allclose(wide[..., :rows, :cols], expected, atol=1e-12)
    assert not wide[..., rows:, :].any()
    assert not wide[..., cols:].any()
