"""Turns of the phase that a camera of several frequencies miscounts in the dark."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift import Burst, reconstruct
from lensshift.core.errors import QualityWarning
from lensshift.core.units import unambiguous_range_m
from lensshift.reconstruction.phasor.frames import PhaseScale, PolarFrames, polar_frames
from lensshift.reconstruction.phasor.turns import nearest_turns, settle_turns

Array = NDArray[np.float64]
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])
MODULATION_HZ = 30e6
SHAPE, SIGMA = (27, 34), 0.01


def slipping_burst(share: float, seed: int = 0) -> tuple[Burst, Array, NDArray[np.bool_]]:
    """A bright card at 3 m before a dark wall at 4.4 m; dark pixels slip by a turn or by thirty.

    Returns the burst, the distance without noise and the card [row col].
    """
    rng = np.random.default_rng(seed)
    card = np.zeros(SHAPE, np.bool_)
    card[9:19, 12:24] = True
    distance_m = np.where(card, 3.0, 4.4)
    amplitude = np.where(card, 0.8, 0.08)
    frames = (4, *SHAPE)
    noisy_m = distance_m + SIGMA / amplitude / (2 * np.pi) * 5.0 * rng.standard_normal(frames) / 2
    turn_m = unambiguous_range_m(MODULATION_HZ)
    slips = rng.choice([1.0, 29.0], frames) * (rng.random(frames) < share) * ~card
    burst = Burst.from_arrays(
        amplitude + SIGMA * rng.standard_normal(frames),
        distance_m=noisy_m + turn_m * slips,
        offset_px=np.zeros((4, 2)),
        pitch_mm=0.03,
        modulation_hz=MODULATION_HZ,
    )
    return burst, distance_m, card


def test_dark_pixels_turn_as_their_surroundings_and_bright_ones_keep_their_turns() -> None:
    burst, distance_m, card = slipping_burst(0.55)
    frames = polar_frames(burst)
    settled = settle_turns(frames, SIGMA)
    np.testing.assert_allclose(settled.phasor, frames.phasor, atol=1e-9)
    assert settled.phase_rad[:, card].tolist() == frames.phase_rad[:, card].tolist()
    off_m = np.abs(frames.scale.distance_m(settled.phase_rad) - distance_m)
    assert np.mean(np.abs(np.asarray(burst.distance_m) - distance_m) > 1.0) > 0.4
    assert np.mean(off_m > 1.0) < 0.001


def test_a_small_bright_object_a_turn_nearer_is_kept() -> None:
    burst, _, _ = slipping_burst(0.0)
    distance_m, amplitude = np.array(burst.distance_m), np.array(burst.amplitude)
    distance_m[:, 4, 5], amplitude[:, 4, 5] = (9.0, 9.01, 9.02, 8.99), 0.7
    frames = polar_frames(
        Burst.from_arrays(
            amplitude,
            distance_m=distance_m,
            offset_px=np.zeros((4, 2)),
            pitch_mm=0.03,
            modulation_hz=MODULATION_HZ,
        )
    )
    settled = settle_turns(frames, SIGMA)
    assert np.all(settled.phase_rad[:, 4, 5] == frames.phase_rad[:, 4, 5])


def test_phases_within_half_a_turn_stay_as_they_are() -> None:
    burst, _, _ = slipping_burst(0.0)
    frames = polar_frames(burst)
    assert settle_turns(frames, SIGMA) is frames


@pytest.mark.parametrize("move_px", [(0, 0), (2, -1), (-1, 3)])
@pytest.mark.parametrize("scale", [1, 2, 3])
def test_a_picture_takes_the_turns_that_the_frames_show_at_its_place(
    scale: int, move_px: tuple[int, int]
) -> None:
    """Content that a frame shows further down and right belongs further up and left."""
    rng = np.random.default_rng(scale)
    shape = (17, 22)
    turns = np.kron(rng.integers(-1, 4, (3, 4)), np.ones((6, 6)))[: shape[0], : shape[1]]
    within_rad = rng.uniform(-1, 1, shape)  # of neighbours too: a vote is for a turn alone
    phase_rad = np.roll(within_rad + 2 * np.pi * turns, move_px, (0, 1))[None]
    frames = PolarFrames(np.ones(phase_rad.shape), phase_rad, PhaseScale(30e6, 0.0, False, "burst"))
    seen = np.kron(within_rad, np.ones((scale, scale)))
    used = np.ones(phase_rad.shape, bool)
    found = nearest_turns(seen, frames, used, np.array([move_px], float), scale)
    expected = np.kron(within_rad + 2 * np.pi * turns, np.ones((scale, scale)))
    inner = (slice(3 * scale, -3 * scale),) * 2
    np.testing.assert_allclose(found[inner], expected[inner], atol=1e-9)


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_the_phasor_channel_survives_miscounted_turns() -> None:
    """The start of the joint fit used to be metres off, the bright card with it."""
    burst, distance_m, _ = slipping_burst(0.4)
    moved = Burst.from_arrays(
        burst.amplitude,
        distance_m=burst.distance_m,
        offset_px=SQUARE_PX,
        pitch_mm=0.03,
        modulation_hz=MODULATION_HZ,
    )
    result = reconstruct(moved, 2, std=False)
    assert result.distance_m is not None
    reference = np.kron(distance_m, np.ones((2, 2)))
    off_m = np.abs(result.distance_m.image - reference)[4:-4, 4:-4]
    assert np.median(off_m) < 0.03
    assert np.mean(off_m > 2.0) < 0.002


def test_a_dark_surface_that_all_frames_see_a_turn_nearer_stays_there() -> None:
    """Dark pixels took the turn of the wall around them, though no frame doubted it."""
    rng = np.random.default_rng(1)
    distance_m = np.full((4, *SHAPE), 9.0)
    distance_m[:, 10:14, 15:20] = 4.2
    phase_rad = 0.05 * rng.standard_normal(distance_m.shape)
    distance_m += phase_rad / (2 * np.pi) * unambiguous_range_m(MODULATION_HZ)
    burst = Burst.from_arrays(
        np.full(distance_m.shape, 0.15),
        distance_m=distance_m,
        offset_px=np.zeros((4, 2)),
        pitch_mm=0.03,
        modulation_hz=MODULATION_HZ,
    )
    frames = polar_frames(burst)
    settled = settle_turns(frames, SIGMA)
    np.testing.assert_allclose(frames.scale.distance_m(settled.phase_rad), distance_m, atol=1e-9)


def test_contested_turns_raise_a_warning() -> None:
    burst, _, _ = slipping_burst(0.4)
    with pytest.warns(QualityWarning, match="how often the phase has turned"):
        reconstruct(burst, 2, channel="phasor", std=False)
