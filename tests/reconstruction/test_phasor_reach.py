"""Phases of a picture stay near those of its frames, and what does not is said to be unknown."""

import numpy as np
import pytest

from lensshift.reconstruction.learned.reach import Reach

SHAPE, NEAR_RAD, FAR_RAD = (9, 13), 0.2, 0.5
OFFSET_PX = np.array([(-0.25, -0.25), (0.25, 3.25)])
USED = np.ones((2, *SHAPE), np.bool_)


def frames(turn_rad: float) -> np.ndarray:
    """Two surfaces that meet between columns 5 and 6; the second frame looks 3 px to the left."""
    phase = np.where(np.arange(13) - np.array([0, 3])[:, None] < 6, NEAR_RAD, FAR_RAD) + turn_rad
    return np.broadcast_to(np.exp(1j * phase)[:, None], USED.shape).copy()


@pytest.mark.parametrize("turn_rad", [0.0, 2.9, -3.3])
def test_what_no_mixture_of_the_surfaces_has_is_moved_and_told(turn_rad: float) -> None:
    phase = np.full((18, 26), 0.3 + turn_rad)
    phase[8, 12] = 2.0 + turn_rad  # at the step; (lo + hi) / 2 + 3/2 (hi - lo) is 0.8
    phase[4, 11] = 0.75 + turn_rad  # in reach: what mixes may be as far from its mixtures
    reach = Reach.of(frames(turn_rad), USED, OFFSET_PX, 2)
    moved, std = reach.hold(phase, np.full(phase.shape, 0.1))
    near = (slice(None), slice(8, 16))
    expected, told = phase.copy(), np.full(phase.shape, 0.1)
    expected[8, 12], told[8, 12] = 0.8 + turn_rad, np.hypot(0.1, 1.2)
    np.testing.assert_allclose(moved[near], expected[near], atol=1e-9)
    np.testing.assert_allclose(std[near], told[near], atol=1e-9)


def test_where_nothing_is_seen_nothing_is_known_better() -> None:
    phase, used = np.full((18, 26), 2.5), USED.copy()
    used[:, :, :8] = False
    reach = Reach.of(frames(0.0), used, OFFSET_PX, 2)
    moved, std = reach.hold(phase, np.full(phase.shape, 0.1))
    np.testing.assert_array_equal(moved[:, :4], 2.5)
    np.testing.assert_array_equal(std[:, :4], 0.1)
    np.testing.assert_allclose(moved[:, -4:], FAR_RAD, atol=1e-9)  # one surface has one phase
    np.testing.assert_allclose(std[:, -4:], np.hypot(0.1, 2.0), atol=1e-9)
