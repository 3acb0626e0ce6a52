"""From phasors to distances: four phases, harmonics, several frequencies, drift."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from tof_worlds import HZ, LIGHT_MPS, ODD, make_camera, near_edge, phasors, quiet, still, wall

from lensshift.camera import Drift, Illumination, Pixels, PlainOptics, Readout, simulate_tof_burst
from lensshift.camera.demodulate import unambiguous_distance_m, unwrap
from lensshift.core.grid import Grid

WIDE = Grid((3, 41), (0.1, 0.1))
FAST = Illumination((100e6,))


def tilted() -> dict:
    """Return a wall whose distance covers more than a quarter turn of 100 MHz."""
    return {"distance_m": 2.0, "turn_rad": (0.0, np.deg2rad(50.0), 0.0)}


def test_raw_phases_are_those_of_four_steps() -> None:
    camera = make_camera(illumination=Illumination((20e6, 15e6)))
    raw = still(wall(2.9), camera).raw
    assert raw.difference.shape == (1, 2, 4, 9, 13)
    assert raw.modulation_hz == (20e6, 15e6)
    for number, hz in enumerate(raw.modulation_hz):
        phase = 4 * np.pi * hz * 2.9 / LIGHT_MPS - np.arange(4) * np.pi / 2
        seen = raw.difference[0, number, :, 4, 6]
        np.testing.assert_allclose(seen / np.hypot(seen[0], seen[1]), np.cos(phase), atol=1e-4)


@pytest.mark.filterwarnings("ignore:.*valid pixels see beyond")
@pytest.mark.parametrize(("name", "turn"), [("harmonic_3", -4), ("harmonic_5", 4)])
def test_harmonics_make_distances_wiggle(name: str, turn: int) -> None:
    """Four steps fold h exp(-3 i p) (and h exp(5 i p)) into exp(i p)."""
    share = 0.08
    optics = PlainOptics(6.0, 2.0)
    plain, bent = (
        still(
            wall(**tilted()),
            make_camera(WIDE, optics=optics, illumination=FAST, pixels=Pixels(0.01, **more)),
        ).burst
        for more in ({}, {name: share})
    )
    phase = 4 * np.pi * 100e6 * plain.distance_m / LIGHT_MPS
    factor = 1 + share * np.exp(1j * turn * phase)
    range_m = LIGHT_MPS / 200e6
    error_m = np.mod(bent.distance_m - plain.distance_m + 0.5 * range_m, range_m) - 0.5 * range_m
    np.testing.assert_allclose(error_m, np.angle(factor) * range_m / (2 * np.pi), atol=1e-4)
    np.testing.assert_allclose(bent.amplitude / plain.amplitude, np.abs(factor), rtol=1e-3)
    assert np.abs(error_m).max() == pytest.approx(
        np.arcsin(share) * range_m / (2 * np.pi), rel=0.01
    )


@pytest.mark.parametrize("distance_m", [0.4, 12.3, 23.45, 77.7, 149.2])
def test_three_frequencies_measure_far_beyond_one(distance_m: float) -> None:
    camera = make_camera(illumination=Illumination((28e6, 29e6, 30e6)))
    seen = still(wall(distance_m), camera).burst.distance_m
    np.testing.assert_allclose(seen, distance_m, rtol=2e-6)
    camera = make_camera(illumination=Illumination((30e6,)))
    beyond = distance_m > LIGHT_MPS / 60e6
    told = pytest.warns(UserWarning, match="30 MHz") if beyond else contextlib.nullcontext()
    with told:
        once = still(wall(distance_m), camera).burst.distance_m
    np.testing.assert_allclose(once, np.mod(distance_m, LIGHT_MPS / 60e6), atol=1e-4)


def test_two_frequencies_with_noise() -> None:
    readout = Readout(exposure_s=(1e-4,), saturates=False, read_noise_electrons=0.0, bits=None)
    camera = make_camera(
        Grid((30, 40), (0.1, 0.1)), illumination=Illumination((20e6, 100e6)), readout=readout
    )
    capture = still(wall(6.2), camera, samples_per_px=2)
    assert capture.burst.modulation_hz == (20e6, 100e6)
    phasors = capture.burst.phasors
    assert phasors is not None
    np.testing.assert_allclose(np.abs(phasors).mean(axis=0), capture.burst.amplitude)
    error_m = capture.burst.distance_m - 6.2
    assert np.abs(error_m).max() < 0.1  # nowhere a wrong turn, which is 1.5 m
    slow_camera = replace(camera, illumination=Illumination((20e6,)))
    slow = still(wall(6.2), slow_camera, samples_per_px=2)
    # Weights (a f)^2: the information of 20 and 100 MHz adds up, 1 and 25 parts.
    gain = np.std(slow.burst.distance_m) / np.std(error_m)
    assert gain == pytest.approx(np.sqrt(26), rel=0.12)


def test_unwrapping_against_every_distance() -> None:
    rng = np.random.default_rng(2)
    true_m = rng.uniform(0.0, 15.0, (5, 7))
    hz = (40e6, 30e6)  # together 15 m
    assert unambiguous_distance_m(hz) == pytest.approx(LIGHT_MPS / 20e6)
    turns = 4 * np.pi * np.array(hz)[:, None, None] * true_m / LIGHT_MPS
    noisy = turns + 0.05 * rng.standard_normal(turns.shape)
    seen = unwrap(np.angle(np.exp(1j * noisy)), np.ones(turns.shape), hz)
    tried_m = np.linspace(0, LIGHT_MPS / 20e6, 200_001)
    for place in np.ndindex(true_m.shape):
        here = noisy[:, *place][:, None]
        misfit = np.sum(
            1 - np.cos(here - 4 * np.pi * np.array(hz)[:, None] * tried_m / LIGHT_MPS), 0
        )
        assert seen[place] == pytest.approx(tried_m[misfit.argmin()], abs=2e-2)


def test_mixed_pixels_mix_at_every_frequency() -> None:
    hz = (20e6, 50e6)
    camera = make_camera(illumination=Illumination(hz))
    raw = still(near_edge(0.2, 2.0, 2.9, 0.4, 0.7), camera).raw
    for number, f in enumerate(hz):
        d = raw.difference[0, number]
        seen = (d[0] - d[2]) + 1j * (d[1] - d[3])
        near, far = seen[4, 3], seen[4, 9]
        assert near / abs(near) == pytest.approx(phasors(1.0, 2.0, f), abs=1e-3)
        assert seen[4, 6] == pytest.approx(0.7 * near + 0.3 * far, abs=0.002 * abs(near - far))


def test_drift_grows_with_temperature() -> None:
    drift = Drift(mm_per_k=1.5, temperature_rise_k=4.0, warming_k_per_frame=2.0)
    planned = np.zeros((3, 2))
    burst, truth = simulate_tof_burst(
        wall(3.0), make_camera(drift=drift), planned, shift_error_px=0
    )
    error_m = burst.distance_m[:, 4, 6] - truth.distance_m[8, 12]
    np.testing.assert_allclose(error_m, [6e-3, 9e-3, 12e-3], atol=1e-7)


def test_truth_of_several_frequencies_does_not_wrap() -> None:
    camera = make_camera(ODD, illumination=Illumination((30e6, 29e6, 28e6)), readout=quiet())
    truth = still(near_edge(0.25, 11.0, 11.4, 0.4, 0.4), camera).truth
    assert truth.distance_m.min() == pytest.approx(11.0, abs=1e-4)
    assert truth.distance_m.max() == pytest.approx(11.4, abs=1e-4)


def test_distances_beyond_one_turn_come_back() -> None:
    with pytest.warns(UserWarning, match=r"100 % .* beyond 9.993 m, .*: 13 m is told as 3.007"):
        seen = still(wall(13.0), make_camera()).burst.distance_m
    np.testing.assert_allclose(seen, 13.0 - LIGHT_MPS / (2 * HZ), atol=1e-4)
