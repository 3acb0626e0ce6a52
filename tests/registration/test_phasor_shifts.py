"""Shifts of bursts with distances: pixels average phasors, whose amplitude is no mean."""

from dataclasses import replace

import numpy as np
import pytest

from lensshift.core.types import Burst
from lensshift.core.units import phase_to_distance
from lensshift.registration import register

FINER, MARGIN_PX, MODULATION_HZ = 8, 3, 20e6


def cards(seed: int, shape: tuple[int, int], noise: float = 0.005) -> tuple[Burst, np.ndarray]:
    """Return a burst of cards at random distances of a turn, and its shifts in eighths of a px."""
    rng = np.random.default_rng(seed)
    rows, cols = ((n + 2 * MARGIN_PX) * FINER for n in shape)
    row, col = np.mgrid[:rows, :cols] / FINER
    scene = np.full((rows, cols), 0.4 + 0j)
    for _ in range(14):
        turn, middle, half = rng.uniform(0, np.pi), rng.uniform(0, 1, 2), rng.uniform(1, 5, 2)
        down, right = row - middle[0] * rows / FINER, col - middle[1] * cols / FINER
        along = down * np.cos(turn) + right * np.sin(turn)
        across = right * np.cos(turn) - down * np.sin(turn)
        here = (np.abs(along) < half[0]) & (np.abs(across) < half[1])
        scene[here] = rng.uniform(0.2, 1) * np.exp(1j * rng.uniform(0, 2 * np.pi))
    eighths = rng.integers(-FINER, FINER + 1, (6, 2))
    eighths[0] = 0
    frames = []
    for down, right in MARGIN_PX * FINER - eighths:
        seen = scene[down:, right:][: shape[0] * FINER, : shape[1] * FINER]
        frames.append(seen.reshape(shape[0], FINER, shape[1], FINER).mean(axis=(1, 3)))
    z = np.array(frames) + noise * (
        rng.standard_normal((6, *shape)) + 1j * rng.standard_normal((6, *shape))
    )
    burst = Burst.from_arrays(
        np.abs(z), distance_m=phase_to_distance(np.angle(z), MODULATION_HZ),
        modulation_hz=MODULATION_HZ, offset_px=None, pitch_mm=0.1,
    )  # fmt: skip
    return burst, eighths / FINER


def test_phasors_tell_shifts_that_their_amplitudes_do_not() -> None:
    of = {"auto": [], "phasor": [], "amplitude": []}
    inside = []
    for seed in range(4):
        burst, true_px = cards(seed, (22, 30))
        for channel, errors in of.items():
            found = register(burst, channel=channel)
            wrong_px = (found.offset_px - found.offset_px[0] - true_px)[1:]
            errors.append(np.sqrt(np.mean(wrong_px**2)))
            if channel == "auto":
                inside.append(np.abs(wrong_px) < 1.96 * found.offset_sigma_px[1:])
    auto, phasor, amplitude = (np.array(of[name]) for name in ("auto", "phasor", "amplitude"))
    np.testing.assert_array_equal(auto, phasor)
    assert np.sqrt(np.mean(auto**2)) < 0.006
    assert np.sqrt(np.mean(auto**2)) < 0.6 * np.sqrt(np.mean(amplitude**2))
    # Frames share the error of the reference: four bursts hold few more than eight errors.
    assert np.mean(inside) > 0.75


def test_a_channel_that_is_not_there_is_refused() -> None:
    burst, _ = cards(0, (12, 15))
    with pytest.raises(ValueError, match="expected a channel among auto, amplitude"):
        register(burst, channel="light")
    for without in (replace(burst, distance_m=None), replace(burst, modulation_hz=None)):
        with pytest.raises(ValueError, match="no phasors, nor distances of one modulation_hz"):
            register(without, channel="phasor")
        auto, amplitude = (register(without, channel=name) for name in ("auto", "amplitude"))
        np.testing.assert_array_equal(auto.offset_px, amplitude.offset_px)
