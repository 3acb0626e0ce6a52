"""Noise, saturation, quantisation, and which exposure a pixel takes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tof_worlds import HZ, LIGHT_MPS, make_camera, near_edge, quiet, still, wall

from lensshift.camera import (
    Ambient,
    Illumination,
    Pixels,
    PlainOptics,
    Readout,
    TofCamera,
    Validity,
    camera_preset,
    simulate_tof,
)
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid

MANY = Grid((40, 61), (0.1, 0.1))
SMALL = Grid((5, 9), (0.155, 0.155))
COARSE = {"samples_per_px": 2}  # enough for a wall


def closed_form_distance_std_m(
    amplitude_electrons: float,
    mean_electrons: float,
    modulation_hz: float,
    *,
    read_noise_electrons: float = 0.0,
    taps: int = 2,
) -> float:
    """Return the standard deviation of distances from four phases of little noise.

    Source: Lange, 3D time-of-flight distance measurement, PhD thesis, Siegen (2000).
    """
    root = np.sqrt(mean_electrons + read_noise_electrons**2)
    phase_rad = root / (amplitude_electrons * np.sqrt(2.0 * taps))
    return float(phase_rad * LIGHT_MPS / (4.0 * np.pi * modulation_hz))


def tap_means(camera: TofCamera, distance_m: float = 3.5, rho: float = 0.5) -> tuple[float, float]:
    """Return amplitude and mean of one tap in electrons, from a noiseless run and from sunlight."""
    noiseless = replace(camera, readout=quiet(exposure_s=camera.readout.exposure_s), ambient=None)
    difference = still(wall(distance_m, rho), noiseless, **COARSE).raw.difference[0, 0, :, 20, 30]
    amplitude = 0.25 * np.hypot(difference[0] - difference[2], difference[1] - difference[3])
    mean = amplitude / camera.pixels.contrast
    if camera.ambient is not None:
        pixel_m2 = 1e-6 * np.prod(camera.grid.pitch_mm)
        watts = rho * 0.9 / 110 * camera.ambient.illuminance_klx * camera.ambient.filter_width_nm
        watts *= camera.optics.transmission / (4 * camera.optics.f_number**2) * pixel_m2
        photons = watts * camera.readout.exposure_s[0] * 850e-9 / (6.62607015e-34 * LIGHT_MPS)
        mean += 0.5 * photons * camera.pixels.quantum_efficiency
    return float(amplitude), float(mean)


def distance_noise_m(camera: TofCamera) -> float:
    """Return the standard deviation of the distances to a wall."""
    return float(np.std(still(wall(3.5, 0.5), camera, seed=5, **COARSE).burst.distance_m))


@pytest.mark.parametrize("read_noise", [0.0, 300.0])
@pytest.mark.parametrize("light", [1.0, 0.05])
def test_distance_noise_is_that_of_the_closed_form(read_noise: float, light: float) -> None:
    camera = make_camera(
        MANY,
        illumination=Illumination((HZ,), intensity_w_per_sr=20 * light),
        readout=Readout(
            exposure_s=(4e-4,), saturates=False, bits=None, read_noise_electrons=read_noise
        ),
    )
    amplitude, mean = tap_means(camera)
    expected = closed_form_distance_std_m(amplitude, mean, HZ, read_noise_electrons=read_noise)
    assert distance_noise_m(camera) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("taps", [1, 2])
def test_closed_form_against_counted_electrons(taps: int) -> None:
    rng = np.random.default_rng(1)
    amplitude, mean, read_noise, count = 2000.0, 10_000.0, 50.0, 200_000
    phase = 1.1 - 0.5 * np.pi * np.arange(4)[:, None]

    def tap(sign: int) -> np.ndarray:
        counted = rng.poisson(mean + sign * amplitude * np.cos(phase), (4, count))
        return counted + rng.normal(0, read_noise, (4, count))

    d = tap(1) if taps == 1 else tap(1) - tap(-1)
    measured = np.std(np.arctan2(d[1] - d[3], d[0] - d[2])) * LIGHT_MPS / (4 * np.pi * 15e6)
    expected = closed_form_distance_std_m(
        amplitude, mean, 15e6, read_noise_electrons=read_noise, taps=taps
    )
    assert measured == pytest.approx(expected, rel=0.01)


def test_closed_form_has_the_published_values() -> None:
    # f = 15 MHz, a = 2000, B = 10000: 56.23 mm; two taps sqrt(1/2) of it.
    assert closed_form_distance_std_m(2000, 10_000, 15e6, taps=1) == pytest.approx(
        0.05623, abs=1e-5
    )
    assert closed_form_distance_std_m(2000, 10_000, 15e6) == pytest.approx(
        0.05623 * 0.5**0.5, abs=1e-5
    )


def test_suppressed_sunlight_leaves_its_noise() -> None:
    readout = Readout(exposure_s=(4e-4,), bits=None, full_well_electrons=4e6)
    camera = make_camera(MANY, pixels=Pixels(fill_factor=1.0), readout=readout)
    sunny = replace(camera, ambient=Ambient(100.0))
    assert not np.any(simulate_raw_saturated(camera))
    assert np.all(simulate_raw_saturated(sunny))
    suppressing = replace(sunny, readout=replace(readout, background_electrons=1e9))
    assert not np.any(simulate_raw_saturated(suppressing))
    amplitude, mean = tap_means(suppressing)
    assert mean > 5 * amplitude
    expected = closed_form_distance_std_m(amplitude, mean, HZ, read_noise_electrons=50.0)
    assert distance_noise_m(suppressing) == pytest.approx(expected, rel=0.05)
    assert expected > 2 * distance_noise_m(camera)


def simulate_raw_saturated(camera: TofCamera) -> Any:
    """Return which pixels of a wall are saturated, also where all of them are."""
    scene = wall(3.5, 0.5)
    try:
        return still(scene, camera, **COARSE).raw.saturated
    except DataError:
        return np.ones(camera.grid.shape, dtype=bool)


def test_full_pixels_are_invalid_and_others_not() -> None:
    camera = make_camera(readout=Readout(exposure_s=(4e-4,), full_well_electrons=4e5))
    bright_tap = tap_full(camera, 0.9, 2.0)
    dark_tap = tap_full(camera, 0.05, 4.0)
    assert dark_tap < 2e5 < 8e5 < bright_tap
    capture = still(near_edge(0.0, 2.0, 4.0, 0.9, 0.05), camera)
    valid = capture.burst.valid[0]
    assert not valid[:, :6].any()
    assert valid[:, 7:].all()
    np.testing.assert_array_equal(capture.raw.saturated[0, :, :6], True)


def tap_full(camera: TofCamera, rho: float, distance_m: float) -> float:
    """Return the electrons of the fuller tap at most, mean plus amplitude."""
    noiseless = replace(camera, readout=quiet(exposure_s=camera.readout.exposure_s))
    d = still(wall(distance_m, rho), noiseless).raw.difference[0, 0, :, 4, 6]
    amplitude = 0.25 * np.hypot(d[0] - d[2], d[1] - d[3])
    return float(amplitude * (1 + 1 / camera.pixels.contrast))


def test_each_pixel_takes_the_longest_exposure_and_highest_gain_that_fit() -> None:
    readout = Readout(exposure_s=(2e-5, 4e-4), gain=(1.0, 4.0), full_well_electrons=4e5)
    camera = make_camera(readout=readout, output="o3m")
    scene = near_edge(0.0, 2.0, 4.0, 0.9, 0.05)
    capture = still(scene, camera)
    assert capture.o3m is not None
    bright, dark = capture.raw.exposure[0, :, :6], capture.raw.exposure[0, :, 7:]
    assert np.all(bright == 0)
    assert np.all(dark == 1)
    assert capture.burst.valid.all()
    # Normalised amplitudes do not tell which exposure was used.
    smooth = still(scene, make_camera(readout=quiet(exposure_s=(4e-4,), full_well_electrons=4e5)))
    np.testing.assert_allclose(
        capture.burst.amplitude[0, :, [3, 9]].mean(axis=1),
        smooth.burst.amplitude[0, :, [3, 9]].mean(axis=1),
        rtol=0.03,
    )
    confidence = capture.o3m.confidence[0]
    assert np.all((confidence[:, :6] & 2) == 0)
    assert np.all((confidence[:, 7:] & 2) == 2)
    np.testing.assert_array_equal((confidence & 4) > 0, capture.raw.gain[0] == 1)
    factor = capture.o3m.amplitude_normalization[(confidence >> 1) & 3]
    np.testing.assert_allclose(capture.o3m.amplitude_counts[0] * factor, capture.burst.amplitude[0])
    assert capture.o3m.amplitude_counts.dtype == np.uint16


def test_whole_centimetres_are_off_by_an_even_error() -> None:
    fine = quiet(bits=16, full_well_electrons=2e7)
    settings: dict[str, Any] = {
        "optics": PlainOptics(20.0, 2.0),
        "readout": fine,
        "pixels": Pixels(contrast=0.9),
    }
    scene = wall(3.0, 0.3, turn_rad=(0.3, np.deg2rad(50.0), 0.0))
    exact = still(scene, make_camera(MANY, **settings), **COARSE).burst.distance_m
    capture = still(scene, make_camera(MANY, output="o3m", **settings), **COARSE)
    assert capture.o3m is not None
    assert capture.o3m.distance_cm.dtype == np.uint16
    np.testing.assert_array_equal(capture.burst.distance_m, capture.o3m.distance_cm / 100)
    error_m = (capture.burst.distance_m - exact).ravel()
    assert np.abs(error_m).max() <= 0.005 + 1e-9
    assert error_m.std() == pytest.approx(0.01 / np.sqrt(12), rel=0.03)
    assert abs(error_m.mean()) < 5e-4
    counts, _ = np.histogram(error_m, 5, (-0.005, 0.005))
    assert counts.min() > 0.85 * error_m.size / 5


def test_the_converter_has_its_steps() -> None:
    readout = quiet(bits=7, full_well_electrons=1e6)
    raw = still(near_edge(0.1, 3.0, 4.0, 0.8, 0.1), make_camera(readout=readout)).raw
    exact = still(near_edge(0.1, 3.0, 4.0, 0.8, 0.1), make_camera()).raw
    assert raw.difference.dtype == np.int32
    assert np.abs(raw.difference).max() <= 64
    np.testing.assert_array_equal(raw.electrons_per_count, 1e6 / 64)
    inside = np.abs(exact.difference) < 1e6
    error = raw.difference * 1e6 / 64 - exact.difference
    assert np.abs(error[inside]).max() <= 0.5 * 1e6 / 64 + 1e-6


def test_too_little_light_is_invalid() -> None:
    scene = near_edge(0.0, 2.0, 4.0, 0.9, 0.05)
    probe = still(scene, make_camera())
    electrons = probe.burst.amplitude[0, 4] * 5e5
    limit = float(np.sqrt(electrons[3] * electrons[9]))
    camera = make_camera(validity=Validity(min_amplitude_electrons=limit))
    valid = still(scene, camera).burst.valid[0]
    assert valid[:, :6].all()
    assert not valid[:, 7:].any()
    o3m = still(
        scene, replace(camera, output="o3m", readout=quiet(bits=16, full_well_electrons=2e7))
    ).o3m
    assert o3m is not None
    assert np.all(o3m.distance_cm[0, :, 7:] == 1)
    assert np.all(o3m.confidence[0, :, 7:] & (1 | 4096) == (1 | 4096))
    assert np.all(o3m.confidence[0, :, :6] & (1 | 4096) == 0)


@pytest.mark.parametrize("seed", [3, 4])
def test_what_an_o3m_cannot_write_is_invalid(seed: int) -> None:
    """A card at 149.9 m before a wall at 155 m, at a frequency that tells both."""
    scene = near_edge(0.0, 149.9, 155.0, 0.5, 0.5)
    camera = make_camera(illumination=Illumination((0.5e6,)), output="o3m", readout=quiet(bits=16))
    capture = still(scene, camera, seed=seed)
    assert capture.o3m is not None
    near, far = np.s_[0, :, :6], np.s_[0, :, 7:]
    np.testing.assert_allclose(capture.burst.distance_m[near], 149.9, atol=0.1)
    assert capture.burst.valid[near].all()
    assert not capture.burst.valid[far].any()
    assert np.all(capture.o3m.distance_cm[far] == 1)
    assert np.all(capture.o3m.confidence[far] & (1 | 4096) == 1)
    assert still(scene, replace(camera, output="float"), seed=seed).burst.valid.all()


def test_same_seed_same_burst() -> None:
    camera = replace(camera_preset("o3m151"), grid=SMALL)
    scene = near_edge(0.3, 3.3, 3.8, 0.4, 0.1)
    first, again, other = (simulate_tof(scene, camera, seed=seed) for seed in (5, 5, 6))
    for name in ("amplitude", "distance_m", "valid"):
        np.testing.assert_array_equal(getattr(first.burst, name), getattr(again.burst, name))
    np.testing.assert_array_equal(first.truth.offset_px, again.truth.offset_px)
    np.testing.assert_array_equal(first.raw.difference, again.raw.difference)
    assert np.any(first.burst.amplitude != other.burst.amplitude)
    assert np.any(first.truth.offset_px != other.truth.offset_px)


def test_without_noise_the_seed_does_not_matter() -> None:
    camera = replace(camera_preset("o3m151"), grid=SMALL).ideal()
    scene = near_edge(0.3, 3.3, 3.8, 0.4, 0.1)
    first, other = (still(scene, camera, seed=seed).burst for seed in (1, 2))
    np.testing.assert_array_equal(first.amplitude, other.amplitude)
    np.testing.assert_array_equal(first.distance_m, other.distance_m)
