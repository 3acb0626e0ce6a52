"""What is said of frames that no camera with one exposure and no filters gives of a still scene."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from lensshift.core.defects import colour_mosaic, repeated_frame, unequal_brightness


def _frames(seed: int = 0, shape: tuple[int, int] = (40, 52)) -> NDArray[np.float64]:
    """Return four frames of blobs on a slope, half a pixel apart, with noise."""
    rng = np.random.default_rng(seed)
    fine = 100 + np.add.outer(np.arange(2 * shape[0] + 2), 0.5 * np.arange(2 * shape[1] + 2))
    for width in (1, 3, 9):
        fine += 40 * width * ndimage.gaussian_filter(rng.normal(size=fine.shape), width)
    moved = [fine[r : r + 2 * shape[0], c : c + 2 * shape[1]] for r, c in np.ndindex(2, 2)]
    seen = [one.reshape(shape[0], 2, shape[1], 2).mean(axis=(1, 3)) for one in moved]
    return np.array(seen) + rng.normal(size=(4, *shape))


@pytest.mark.parametrize("seed", range(20))
def test_plain_frames_are_not_questioned(seed: int) -> None:
    frames = _frames(seed)
    assert colour_mosaic(frames) == unequal_brightness(frames) == ""
    noise = np.random.default_rng(seed).normal(size=(4, 12, 13))
    assert colour_mosaic(noise) == unequal_brightness(noise) == ""


@pytest.mark.parametrize("green", [0.8, 1.3])
def test_a_colour_mosaic_is_told_whatever_is_not_valid(green: float) -> None:
    frames = _frames()
    frames[:, ::2, 1::2] *= green
    frames[:, 1::2, ::2] *= green
    assert "Bayer" in colour_mosaic(frames)
    valid = np.ones(frames.shape, np.bool_)
    valid[:, 10:14, 20:31] = False
    frames[~valid] = np.nan
    assert "Bayer" in colour_mosaic(frames, valid)
    assert colour_mosaic(frames[:, ::2, 1::2], valid[:, ::2, 1::2]) == ""  # the cure


def test_another_exposure_is_told_with_its_frame() -> None:
    frames = _frames()
    frames[2] *= 1.5
    said = unequal_brightness(frames)
    assert f"{frames[2].mean():.4g} in frame 2" in said
    of_phasors, advice, cure = said.partition(", or have gain and bias estimated")
    assert advice
    assert "photometric=True" in cure
    assert unequal_brightness(frames * np.exp(0.3j)) == of_phasors  # of which no gain is estimated
    valid = np.ones(frames.shape, np.bool_)
    valid[2, 3:] = False  # of which too little is left to compare
    assert unequal_brightness(frames, valid) == ""


def test_a_frame_that_was_handed_out_twice_is_named() -> None:
    frames = np.random.default_rng(1).normal(size=(5, 6, 7))
    assert repeated_frame(frames) == ""
    frames[3] = frames[1]
    assert repeated_frame(frames).startswith("frame 3 is a copy of frame 1, noise and all")
    assert repeated_frame(np.zeros((3, 6, 7))) == ""  # blank, not copied
