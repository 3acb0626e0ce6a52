"""Noise that a camera cuts off at the dark end."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pixel_camera import photograph, truth

import lensshift
from lensshift.core.types import Burst

SHAPE = (24, 28)
PLACES = np.random.default_rng(0).uniform(0.0, 24.0, (7, 2))


def spots(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return seven discs of light before nothing."""
    near = [np.hypot(row - r, col - c) < 1.0 + 0.3 * k for k, (r, c) in enumerate(PLACES)]
    return np.asarray(np.any(near, axis=0), float)


def _frames(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    offset_px = rng.uniform(-0.5, 0.5, (count, 2))
    return photograph(spots, SHAPE, offset_px), offset_px, rng


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("count", "sigma", "dark"), [(4, 0.2, 0.0), (12, 0.1, 0.0), (4, 0.1, 0.5)])
def test_the_dark_is_as_dark_as_it_is_behind_noise_that_was_cut_off(
    count: int, sigma: float, dark: float, seed: int
) -> None:
    frames, offset_px, rng = _frames(count, seed)
    light = frames + dark * sigma
    y = 3000 * np.maximum(light + sigma * rng.standard_normal(frames.shape), 0.0)
    expected = 3000 * (truth(spots, SHAPE, 2) + dark * sigma)
    with pytest.warns(lensshift.QualityWarning, match="noise is cut off at 0, where"):
        found = lensshift.reconstruct(Burst.from_arrays(y, offset_px=offset_px)).amplitude
    assert found is not None
    assert found.std is not None
    assert found.noise_sigma == pytest.approx(3000 * sigma, rel=0.25)
    inner = np.s_[4:-4, 4:-4]
    off = (found.image - expected)[inner]
    assert np.mean(np.abs(off) < 2 * found.std[inner]) > 0.9
    assert abs(np.median(off)) < 0.12 * 3000 * sigma


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("kind", ["photons", "masked", "dark level"])
def test_zeros_that_cut_no_noise_off_are_what_they_are(kind: str, seed: int) -> None:
    frames, offset_px, rng = _frames(4, seed)
    if kind == "photons":
        y = rng.poisson(0.7 + 12.0 * frames).astype(float)
    else:
        y = 100 + 300 * frames + 20 * rng.standard_normal(frames.shape)
        y = np.where(frames > 0, y, 0.0) if kind == "masked" else np.maximum(y, 0.0)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="noise is cut off")
        lensshift.reconstruct(Burst.from_arrays(y, offset_px=offset_px), std=False)


@pytest.mark.parametrize("fill", [0.0, np.nan])
def test_where_no_frame_has_a_valid_pixel_nothing_is_divided_by_nothing(fill: float) -> None:
    frames, offset_px, rng = _frames(4, 3)
    y = np.maximum(frames + 0.2 * rng.standard_normal(frames.shape), 0.0)
    valid = np.ones(y.shape, bool)
    valid[:, 4:11, 6:13] = valid[:, -4:] = False
    burst = Burst.from_arrays(np.where(valid, y, fill), offset_px=offset_px, valid=valid)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = lensshift.reconstruct(burst).amplitude
    assert found is not None
    assert np.all(np.isfinite(found.image))
    assert any("noise is cut off" in str(one.message) for one in said)
    assert all(one.category is lensshift.QualityWarning for one in said)
