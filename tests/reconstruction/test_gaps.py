"""Pixels that are left out of all frames: what the picture is there, and what its errors say."""

from dataclasses import replace

import numpy as np
import pytest
from mosaic import phasor_mosaic

from lensshift.core.intrinsics import Pinhole
from lensshift.core.types import Burst, Estimate
from lensshift.core.units import distance_to_phase
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.unseen import LEAST_SEEN, beside_gaps, share_seen
from lensshift.reconstruction.reconstruct import reconstruct

SCALE, PER_M = 2, float(distance_to_phase(1.0, 20e6))


def gapped(seed: int, most_px: int) -> tuple[Burst, np.ndarray, np.ndarray]:
    """Return a burst of phasors with gaps, the true phasors, and the pixels deep in gaps."""
    one, rng = phasor_mosaic(seed, (22, 34)), np.random.default_rng(100 + seed)
    valid = np.ones(one.y.shape, bool)
    for _ in range(4):
        row, col = rng.integers(2, 22 - 8), rng.integers(2, 34 - 8)
        size = rng.integers(2, most_px + 1)
        valid[:, row : row + size, col : col + size] = False
    burst = Burst.from_arrays(
        np.abs(one.y), np.mod(np.angle(one.y), 2 * np.pi) / PER_M, valid=valid,
        offset_px=one.offset_px, pitch_mm=0.1, modulation_hz=20e6,
    )  # fmt: skip
    model = forward_model((22, 34), SCALE, one.offset_px)
    return burst, one.truth, share_seen(model.operator, valid) < 0.02


def covered(estimate: Estimate | None, truth: np.ndarray, where: np.ndarray) -> np.ndarray:
    assert estimate is not None
    return (np.abs(estimate.image - truth) < 2.0 * np.asarray(estimate.std))[where]


@pytest.mark.parametrize("channel", ["amplitude", "phasor"])
def test_two_std_hold_most_errors_in_gaps(channel: str) -> None:
    """They held less than a third; errors in a gap are alike, so many gaps count."""
    held: list[np.ndarray] = []
    of_phase: list[np.ndarray] = []
    for seed in range(10):
        burst, truth, unseen = gapped(seed, 6)
        found = reconstruct(burst, SCALE, channel=channel)  # type: ignore[arg-type]
        held.append(covered(found.amplitude, np.abs(truth), unseen))
        assert unseen.mean() < found["amplitude"].notes["unseen"] < 0.3
        if channel == "phasor":
            turned = np.exp(1j * found["distance"].image * PER_M) / np.exp(1j * np.angle(truth))
            std_rad = np.asarray(found["distance"].std) * PER_M
            of_phase.append((np.abs(np.angle(turned)) < 2.0 * std_rad)[unseen])
    assert np.mean(np.concatenate(held)) > 0.8
    assert not of_phase or np.mean(np.concatenate(of_phase)) > 0.8


def test_no_points_stand_where_nothing_was_measured() -> None:
    burst, _, unseen = gapped(3, 8)
    result = reconstruct(burst, SCALE)
    pinhole = Pinhole.of_focal_length(result.grid, 10.0)
    cloud = result.point_cloud(pinhole)
    assert not unseen[cloud.row, cloud.col].any()
    every = result.point_cloud(pinhole, keep_flying=True)
    assert unseen[every.row, every.col].sum() == unseen.sum()


def test_frames_without_gaps_are_seen_whole() -> None:
    burst, truth, _ = gapped(5, 3)
    whole = replace(burst, valid=np.ones(burst.valid.shape, bool))
    found = reconstruct(whole, SCALE).amplitude
    assert found is not None
    assert "unseen" not in found.notes
    assert np.mean(covered(found, np.abs(truth), np.ones(truth.shape, bool))) > 0.9


@pytest.mark.parametrize("period_px", [12, 20])
def test_std_grows_as_the_scene_differs(period_px: int) -> None:
    """A wave along the rows differs by 1 - cos(2 pi h / period) on average, along columns by 0."""
    wave = np.broadcast_to(np.sin(2 * np.pi * np.arange(240) / period_px), (60, 240))
    share = np.ones(wave.shape)
    share[10:50, 100:112] = 0.0
    image, std = beside_gaps(wave, np.full(wave.shape, 0.01), share)
    kept = share > LEAST_SEEN
    assert np.array_equal(image[kept], wave[kept])
    assert np.all(std[kept] == 0.01)
    for h in (1, 2, 5):  # from the side of the gap
        along, across = 60 * (240 - h), (60 - h) * 240  # pairs, nearly
        differ = along / (along + across) * (1 - np.cos(2 * np.pi * h / period_px))
        assert std[30, 99 + h] ** 2 == pytest.approx(differ + 1e-4, rel=0.05)
        assert image[30, 99 + h] == wave[30, 99]


def test_phases_differ_on_the_circle() -> None:
    """By a step of 0.2 rad across the turn, not by a turn; amplitudes do not differ."""
    phase = np.where(np.arange(80) % 2 == 0, np.pi - 0.1, -np.pi + 0.1) * np.ones((40, 1))
    share = np.ones(phase.shape)
    share[10:12, 30:32] = 0.0
    image, std = beside_gaps(2.0 * np.exp(1j * phase), np.full((2, *phase.shape), 1e-3), share)
    assert np.abs(image[10, 30]) == pytest.approx(2.0)
    np.testing.assert_allclose(std[0][10, 30], 1e-3, rtol=1e-6)
    assert std[1][10, 30] == pytest.approx(2.0 * 0.2 / np.sqrt(2.0), rel=0.02)


def test_a_response_that_hardly_sees_is_no_gap() -> None:
    """Of sparse frames most HR pixels lie between the samples."""
    model = forward_model((6, 7), 8, np.zeros((1, 2)))
    assert np.all(share_seen(model.operator, np.ones((1, 6, 7), bool)) == 1.0)
    one = np.ones((1, 6, 7), bool)
    one[0, 3, 3] = False
    share = share_seen(model.operator, one)
    assert share[28, 28] < 0.05
    assert np.all(share[:16] == 1.0)
