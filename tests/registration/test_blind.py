"""Many sharp frames whose aliases dwarf the noise: which shifts are known, which seem so."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift.camera import RunningCamera, camera_preset, named_pattern_px, simulate_tof
from lensshift.registration import likely_shifts, phase_shifts
from lensshift.scene import Plane, Rectangle, Scene, slanted_edge_card

SIXTH_PX = (np.arange(6) - 2.5) / 6
SIXTHS_PX = np.array([(row, col) for row in SIXTH_PX for col in SIXTH_PX])


def cards(seed: int) -> Scene:
    """Return turned cards at several distances before a wall."""
    rng = np.random.default_rng(seed)
    shown = []
    for _ in range(12):
        down, right, z = rng.uniform(-0.03, 0.03), rng.uniform(-0.12, 0.12), rng.uniform(2.5, 4.5)
        shown.append(
            Rectangle(
                centre_m=(float(right * z), float(down * z), float(z)),
                size_m=tuple(float(size) for size in rng.uniform(0.05, 0.3, 2)),
                turn_rad=(0.0, float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-np.pi, np.pi))),
                reflectance=float(rng.uniform(0.1, 0.9)),
            )
        )
    return Scene((Plane(centre_m=(0.0, 0.0, 5.0), reflectance=0.3), *shown))


def valid(frames: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.ones(frames.shape, np.bool_)


@pytest.mark.parametrize(
    ("count", "seed"),
    [(20, 1), *(pytest.param(35, seed, marks=pytest.mark.slow) for seed in (1, 10, 11))],
)
def test_a_scene_of_cards_is_known(count: int, seed: int) -> None:
    """Frames of SNR 500 and more, as a scan takes them, from planned shifts.

    A second search from a quarter of a pixel beside ended elsewhere with thirty-five of them, and
    nothing passed for known.
    """
    rng = np.random.default_rng(seed)
    running = RunningCamera(cards(seed), camera_preset("o3m151"))
    true_px = rng.uniform(-1.0, 1.0, (count, 2))
    frames = np.array([
        np.mean([running.frame(one[None], rng).amplitude for _ in range(4)], axis=0)
        for one in true_px
    ])  # fmt: skip
    found = likely_shifts(frames, valid(frames), true_px + rng.normal(0.0, 0.02, true_px.shape))
    assert found.sigma_px.max() < 0.01
    wrong = (found.offset_px - true_px) - (found.offset_px - true_px)[0]
    assert np.abs(wrong).max() < 0.02


@pytest.mark.parametrize(
    ("plan_px", "seed"),
    [
        (named_pattern_px("3x3"), 7),
        pytest.param(SIXTHS_PX, 7, marks=pytest.mark.slow),
        pytest.param(SIXTHS_PX, 21, marks=pytest.mark.slow),
    ],
)
def test_along_an_edge_nothing_is_known(plan_px: NDArray[np.float64], seed: int) -> None:
    """Sharp frames at SNR 1000, from nothing: the likelihood has a maximum wherever it is asked."""
    order = np.random.default_rng(seed).permutation(len(plan_px))
    world = simulate_tof(
        slanted_edge_card(), camera_preset("o3m151"), np.asarray(plan_px)[order], scale=2,
        seed=seed, shift_error_px=0.02,
    )  # fmt: skip
    frames, true_px = world.burst.amplitude.astype(float), world.truth.offset_px
    found = likely_shifts(frames, valid(frames), phase_shifts(frames, 0))
    wrong = found.offset_px - (true_px - true_px[0])
    assert np.abs(wrong).max() > 0.1
    assert np.all(np.abs(wrong[1:]) < 2 * found.sigma_px[1:])
