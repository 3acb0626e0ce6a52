"""Shifts made better through the forward model."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene, taken

from lensshift.reconstruction.shift_refinement import refine_shifts


def about_mean(offset_px: np.ndarray) -> np.ndarray:
    return offset_px - offset_px.mean(axis=0)


@pytest.mark.parametrize("name", ["four boxes", "demo"])
def test_errors_of_the_shifts_are_halved(name: str) -> None:
    before, after = [], []
    for seed in (0, 1):
        burst, true_px = taken(scene(name), seed=seed)
        refined = refine_shifts(burst)
        before.append(about_mean(burst.offset_px - true_px))
        after.append(about_mean(refined.offset_px - true_px))
        assert refined.offset_source == "registered"
        np.testing.assert_allclose(
            refined.offset_px.mean(axis=0), burst.offset_px.mean(axis=0), atol=1e-9
        )
    assert np.sqrt(np.mean(np.square(after))) < 0.5 * np.sqrt(np.mean(np.square(before)))


def test_shifts_that_are_sure_stay() -> None:
    burst, _ = taken(scene("four boxes"))
    sure = replace(burst, offset_sigma_px=np.full((4, 2), 2e-4))
    np.testing.assert_allclose(refine_shifts(sure).offset_px, burst.offset_px, atol=2e-3)


def test_one_frame_has_nothing_to_compare() -> None:
    burst, _ = taken(scene("four boxes"))
    with pytest.raises(ValueError, match="at least 2 frames"):
        refine_shifts(burst.select([0]))
