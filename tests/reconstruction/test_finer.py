"""Where frames see more than the pixels asked for hold, smaller ones are found first."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from mosaic import (
    SAMPLES,
    MosaicBurst,
    canvas,
    mosaic_burst,
    observe,
    phasor_mosaic,
    square,
    weave,
)  # fmt: skip
from numpy.typing import NDArray

import lensshift
from lensshift import Burst, Estimate, reconstruct
from lensshift.core.units import phase_to_distance
from lensshift.forward.model import forward_model
from lensshift.io.result_file import load_reconstruction, save_reconstruction
from lensshift.reconstruction.learned.finer import FINEST, finer_grid, means

HZ = 15e6
LINE = (np.arange(4) - 2.0) / 4.0
SIXTEEN = np.array([(row, col) for row in LINE for col in LINE])
INNER = (slice(3, -3), slice(3, -3))


def solved(seen: MosaicBurst, **settings: object) -> Estimate:
    burst = Burst.from_arrays(seen.y, offset_px=seen.offset_px, pitch_mm=0.1)
    return reconstruct(burst, seen.scale, channel="amplitude", **settings).amplitude


def rms(found: Estimate, truth: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean((found.image - truth)[INNER] ** 2)))


@pytest.mark.parametrize("seed", [31, 32])
@pytest.mark.parametrize("offset_px", [square(2), SIXTEEN], ids=["4", "16"])
def test_pixels_of_the_frames_are_known_as_well_as_in_a_frame(
    seed: int, offset_px: NDArray[np.float64]
) -> None:
    """At scale 1 a frame at 0 would be the truth and its noise: more frames know it better."""
    rng = np.random.default_rng(seed)
    fine = canvas(rng, (19, 24)) + 0.05 * weave(rng, (19, 24), 0.9)
    seen = observe(fine, (19, 24), scale=1, offset_px=offset_px, snr=60.0, rng=rng)
    found = solved(seen)
    assert rms(found, seen.truth) < seen.sigma
    error = np.abs(found.image - seen.truth)[INNER]
    assert np.mean(error < 2 * np.asarray(found.std)[INNER]) > 0.9


def test_a_picture_is_the_mean_of_smaller_pixels(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    seen = observe(canvas(rng, (17, 21)), (17, 21), scale=1, offset_px=square(2), rng=rng)
    found = solved(seen)
    assert found.fine is not None
    assert found.fine.shape == (34, 42)
    np.testing.assert_allclose(means(found.fine), found.image, rtol=1e-12)
    assert np.sqrt(np.mean((found.predict(1) - seen.y[1])[INNER] ** 2)) < 1.5 * seen.sigma
    burst = Burst.from_arrays(seen.y, offset_px=seen.offset_px, pitch_mm=0.1)
    result = reconstruct(burst, 1)
    path = tmp_path / "native.nc"
    save_reconstruction(result, path)
    again = load_reconstruction(path).amplitude
    np.testing.assert_array_equal(again.fine, result.amplitude.fine)
    np.testing.assert_allclose(again.predict(2), result.amplitude.predict(2), rtol=1e-12)


def rings() -> NDArray[np.float64]:
    """Return a zone plate, up to 0.9 cycles per LR pixel, on the fine grid of 20 x 23 pixels."""
    row, col = np.mgrid[: 24 * SAMPLES, : 27 * SAMPLES] / SAMPLES
    return np.asarray(0.5 + 0.4 * np.cos(0.07 * np.pi * ((row - 12.0) ** 2 + (col - 13.3) ** 2)))


def narrowly_seen(
    fine: NDArray[np.float64], offset_px: NDArray[np.float64], sigma: float, seed: int
) -> NDArray[np.float64]:
    """Return frames [frame 20 23] of pixels whose middle half along each axis sees light."""
    rng, frames = np.random.default_rng(seed), []
    for row, col in np.rint(-offset_px * SAMPLES).astype(int) + 2 * SAMPLES:
        part = fine[row : row + 20 * SAMPLES, col : col + 23 * SAMPLES]
        frames.append(part.reshape(20, SAMPLES, 23, SAMPLES)[:, 3:9, :, 3:9].mean(axis=(1, 3)))
    return np.stack(frames) + sigma * rng.standard_normal((len(frames), 20, 23))


@pytest.mark.parametrize("seed", [41, 43])
def test_nine_frames_of_narrow_pixels_know_no_less_than_four(seed: int) -> None:
    """Narrow pixels see what HR pixels of x2 do not hold: nine frames drew these 1.6 times worse,
    rings four times.
    """
    for fine in (canvas(np.random.default_rng(seed), (20, 23)), rings()):
        errors = []
        for offset_px in (square(2), square(3)):
            y = narrowly_seen(fine, offset_px, 0.008, seed)
            truth = observe(fine, (20, 23), rng=np.random.default_rng(0)).truth
            found = solved(MosaicBurst(y, offset_px, truth, 0.008, 2), psf_sigma_px=0.145)
            errors.append(rms(found, truth))
        assert found.fine is not None
        assert errors[1] < 1.1 * errors[0]


def test_mirrored_and_turned_frames_give_mirrored_and_turned_pictures() -> None:
    """Where it is close which grid predicts better, that must not depend on how frames lie."""
    rng = np.random.default_rng(3)
    fine = canvas(rng, (18, 21)) + 0.05 * weave(rng, (18, 21), 0.8)
    seen = observe(fine, (18, 21), offset_px=SIXTEEN, snr=25.0, rng=rng)
    image = solved(seen).image
    for turned, offset_px, back in (
        (seen.y[:, ::-1], seen.offset_px * (-1, 1), lambda x: x[::-1]),
        (np.moveaxis(seen.y, 1, 2), seen.offset_px[:, ::-1], np.transpose),
    ):
        again = solved(MosaicBurst(turned, offset_px, seen.truth, seen.sigma, 2)).image
        np.testing.assert_allclose(back(again), image, atol=1e-3 * np.ptp(image))


@pytest.mark.parametrize("seed", [51, 52])
def test_noise_asks_for_no_smaller_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flat = np.full(canvas(rng, (18, 22)).shape, 0.5)
    seen = observe(flat, (18, 22), offset_px=SIXTEEN, snr=8.0, rng=rng)
    assert solved(seen).fine is None


def test_four_frames_at_twice_the_resolution_ask_nothing() -> None:
    assert solved(mosaic_burst(61)).fine is None


@pytest.mark.parametrize("seed", [71, 72])
def test_light_of_phasors_is_found_with_smaller_pixels(seed: int) -> None:
    """Rings on one surface, before narrow pixels."""
    fine, errors, sigma = rings(), [], 0.008
    truth = observe(fine, (20, 23), rng=np.random.default_rng(0)).truth
    for offset_px in (square(2), square(3)):
        light = narrowly_seen(fine, offset_px, sigma, seed)
        noise = np.random.default_rng(seed).standard_normal(light.shape)
        y = (light + 1j * sigma * noise) * np.exp(2.0j)
        burst = Burst.from_arrays(y, offset_px=offset_px, pitch_mm=0.1, modulation_hz=HZ)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lensshift.QualityWarning)
            found = reconstruct(burst, 2, channel="phasor", psf_sigma_px=0.145)
        errors.append(rms(found.amplitude, truth))
        off_m = (found.distance_m.image - phase_to_distance(2.0, HZ))[INNER]
        assert np.mean(np.abs(off_m) < 2 * found.distance_m.std[INNER]) > 0.9
    assert errors[1] < 1.2 * errors[0]


def test_phasors_of_the_pixels_of_the_frames() -> None:
    seen = phasor_mosaic(81, (20, 24))
    burst = Burst.from_arrays(seen.y, offset_px=seen.offset_px, pitch_mm=0.1, modulation_hz=HZ)
    found = reconstruct(burst, 1, channel="phasor")
    z = means(seen.truth)
    error = np.abs(found.amplitude.image - np.abs(z))[INNER]
    assert np.sqrt(np.mean(error**2)) < 3 * seen.sigma
    assert np.mean(error < 2 * found.amplitude.std[INNER]) > 0.9
    assert found.distance_m.fine is not None
    assert found.distance_m.fine.shape == (40, 48)
    rest = found.amplitude.predict(0) - np.abs(seen.y[0])
    assert np.sqrt(np.mean(rest[INNER] ** 2)) < 2 * seen.sigma


def test_places_decide_not_frames() -> None:
    """Sixteen frames at four places tell no more pixels apart than four."""
    at = forward_model((9, 11), 2, np.tile(square(2), (4, 1)))
    assert finer_grid(at) is None
    finer = finer_grid(forward_model((9, 11), 2, SIXTEEN + 3.0))
    assert finer is not None
    assert finer.hr_shape == (36, 44)
    assert finer_grid(forward_model((9, 11), FINEST, SIXTEEN)) is None


@pytest.mark.parametrize("shape", [(1, 9), (7, 1), (1, 1), (3, 2)])
@pytest.mark.parametrize("scale", [1, 2])
def test_frames_of_few_pixels(shape: tuple[int, int], scale: int) -> None:
    """As many as are asked for, of frames that are all valid and of one valid pixel."""
    y = 5.0 + np.random.default_rng(2).standard_normal((16, *shape))
    one = np.zeros(y.shape, np.bool_)
    one[3] = True
    for valid in (None, one):
        burst = Burst.from_arrays(y, offset_px=SIXTEEN, pitch_mm=0.1, valid=valid)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lensshift.QualityWarning)
            found = reconstruct(burst, scale, channel="amplitude").amplitude
        assert found.image.shape == (scale * shape[0], scale * shape[1])
        assert np.all(np.isfinite(found.image))


def test_a_stream_goes_on_with_smaller_pixels() -> None:
    """Live steps show what the last full step found, at the same grid."""
    y = narrowly_seen(rings(), square(3), 0.008, 9)
    truth = observe(rings(), (20, 23), rng=np.random.default_rng(0)).truth
    plan = Burst.from_arrays(y, offset_px=square(3), pitch_mm=0.1)
    camera = lensshift.stream(plan, psf_sigma_px=0.145)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lensshift.QualityWarning)  # of few frames of such rings
        pictures = [camera.step(frame) for frame in (*y, *y[:4])]
    assert [one.settings["pace"] for one in pictures[-3:]] == ["live"] * 3
    full = reconstruct(plan, 2, psf_sigma_px=0.145).amplitude
    assert rms(pictures[-1].amplitude, truth) < 1.1 * rms(full, truth)
    assert pictures[-1].amplitude.fine is not None
