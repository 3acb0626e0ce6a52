"""The width of the pixel response that nobody told, read from the frames."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from mosaic import SAMPLES, MosaicBurst, canvas, observe, square
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

import lensshift
from lensshift import Burst, fidelity, reconstruct
from lensshift.camera import camera_preset, named_pattern_px, simulate_tof
from lensshift.core.types import Status
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.pipeline.experiment_file import named_scene
from lensshift.reconstruction.learned import response
from lensshift.reconstruction.learned.response import (
    ASSUMED_PX,
    SCALE,
    Response,
    likely_response,
)
from lensshift.reconstruction.pixel_response import TELLING_PX
from lensshift.reconstruction.problem import NOMINAL_BLUR_PX

Array = NDArray[np.float64]


def read(y: Array, offset_px: Array, sigma: float) -> Response:
    """Return what frames of the given noise show."""
    model = forward_model(y.shape[1:], SCALE, offset_px, blur=GaussianBlur(ASSUMED_PX))
    return likely_response(model, y, np.full(y.shape, sigma))


def seen_by(side: int, seed: int, *, frames: int = 2, shape: tuple[int, int] = (21, 30),
            snr: float = 80.0) -> MosaicBurst:  # fmt: skip
    """Return a mosaic seen by pixels that are `side` fine samples wide."""
    rng = np.random.default_rng(seed)
    offset = np.round(square(frames) * SAMPLES) / SAMPLES
    return observe(canvas(rng, shape), shape, offset_px=offset, snr=snr, side=side, rng=rng)


def width_of(side: int) -> float:
    """Return the standard deviation of such a pixel, LR pixels."""
    return math.sqrt(side**2 - 1) / SAMPLES / math.sqrt(12)


def stack_of(seen: MosaicBurst) -> Burst:
    """Return frames with their places and nothing else."""
    return Burst.from_arrays(seen.y, offset_px=seen.offset_px, pitch_mm=0.05)


@pytest.mark.parametrize("frames", [2, 3])
def test_widths_of_pixels_are_read(frames: int) -> None:
    """Of random mosaics, which no training saw; the std that is said covers."""
    z, error = [], []
    for side in (4, 6, 8, 10, 12):
        for seed in range(500, 508):
            seen = seen_by(side, seed, frames=frames)
            found = read(seen.y, seen.offset_px, seen.sigma)
            if found.std_px <= TELLING_PX:
                error.append(found.width_px - width_of(side))
                z.append(error[-1] / found.std_px)
    assert len(z) >= 20
    assert np.sqrt(np.mean(np.square(error))) <= 0.03
    assert np.mean(np.abs(z) < 2) >= 0.9


def test_mirrors_levels_and_units_change_nothing() -> None:
    seen = seen_by(8, 511)
    found = read(seen.y, seen.offset_px, seen.sigma)
    others = [
        read(290 + 7 * seen.y, seen.offset_px, 7 * seen.sigma),
        read(seen.y[:, ::-1].copy(), seen.offset_px * [-1, 1], seen.sigma),
        read(seen.y.swapaxes(1, 2).copy(), seen.offset_px[:, ::-1], seen.sigma),
    ]
    for other in others:
        assert other.width_px == pytest.approx(found.width_px, abs=2e-3)
        assert other.std_px == pytest.approx(found.std_px, abs=2e-3)


def test_frames_without_an_edge_say_that_they_do_not_tell() -> None:
    """Noise, an even wall, and a scene that is far out of focus."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((4, 20, 31))
    soft = seen_by(12, 512).y
    fine = gaussian_filter(canvas(rng, (20, 31)), 1.2 * SAMPLES)
    soft = observe(fine, (20, 31), rng=rng, snr=100).y
    for y, sigma in ((noise, 1.0), (1e-9 * noise + 3, 1e-9), (soft, 0.008)):
        found = read(y, square(2), sigma)
        # Soft frames may say that no response is wider, as far as it goes.
        assert found.std_px > TELLING_PX or found.width_px >= 0.3
    result = reconstruct(Burst.from_arrays(noise, offset_px=square(2), pitch_mm=1.0))
    assert result.settings["psf_source"] == "assumed"
    assert result.settings["psf_sigma_px"] == NOMINAL_BLUR_PX


def test_what_is_told_is_not_read() -> None:
    seen = seen_by(6, 513)
    burst = stack_of(seen)
    assert reconstruct(burst, psf_sigma_px=0.15).settings["psf_source"] == "given"
    read_from = reconstruct(burst).settings
    assert read_from["psf_source"] == "frames"
    assert abs(read_from["psf_sigma_px"] - width_of(6)) < 3 * read_from["psf_std_px"]
    exact = reconstruct(burst, fill_factor=0.5).settings
    assert (exact["psf_source"], exact["psf_sigma_px"]) == ("assumed", 0.0)


# The usual width is too wide, and the frames say so.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")
def test_pictures_are_as_good_as_with_the_told_width() -> None:
    """Of half-wide pixels: half a decibel mostly, where the usual width loses many."""
    lost, usual = [], []
    for seed in range(520, 528):
        seen = seen_by(6, seed)
        burst = stack_of(seen)
        read_db, told_db, usual_db = (
            fidelity(reconstruct(burst, psf_sigma_px=width).amplitude.image, seen.truth).psnr_db
            for width in ("auto", width_of(6), NOMINAL_BLUR_PX)
        )
        lost.append(told_db - read_db)
        usual.append(told_db - usual_db)
    assert np.median(lost) <= 0.5
    assert np.mean(lost) <= 1.0
    assert np.mean(usual) >= 5.0


@pytest.mark.parametrize(
    ("side", "told_px", "snr", "said", "least", "most"),
    [
        (
            12,
            0.29,
            100,
            "",
            0,
            0,
        ),  # a square pixel: nobody hears anything, however quiet the frames
        (12, 0.29, 1500, "", 0, 0),
        (6, 0.145, 300, "", 0, 0),
        (6, None, 300, "", 0, 0),  # told nothing
        (12, 0.6, 100, "sharper", 6, 6),
        (12, 0.9, 300, "sharper", 6, 6),
        (6, 0.29, 300, "sharper", 6, 6),  # pixels of half the width
        (12, 0.15, 100, "softer", 4, 6),
        (12, 0.0, 20, "softer", 4, 6),
    ],
)
def test_frames_object_to_a_width(
    side: int, told_px: float | None, snr: float, said: str, least: int, most: int
) -> None:
    words = []
    for seed in range(20, 26):
        burst = stack_of(seen_by(side, seed, snr=snr))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = reconstruct(burst, psf_sigma_px="auto" if told_px is None else told_px)
        told = told_px is not None
        assert (result.settings["psf_source"] == "given") is told
        words += [str(w.message) for w in caught]
        assert (result.amplitude.status is Status.CONTRADICTED) is bool(caught)
    assert least <= len(words) <= most
    assert all(f"{said} than psf_sigma_px {told_px:g}" in text for text in words)


@pytest.mark.parametrize("lens_px", [0.4, 0.6, 0.9])
def test_a_wide_response_that_is_right_is_believed(lens_px: float) -> None:
    """Softer than any response that the reader knows."""
    rng = np.random.default_rng(31)
    for seed in range(4):
        fine = canvas(np.random.default_rng(seed), (21, 30))
        soft = observe(gaussian_filter(fine, lens_px * SAMPLES), (21, 30), rng=rng, snr=1500)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            reconstruct(stack_of(soft), psf_sigma_px=math.hypot(lens_px, width_of(12)))


def test_a_square_pixel_that_was_told_by_its_edge_is_believed() -> None:
    """At an edge it has the MTF50 of a Gaussian of 0.3106 px, and the variance of one of 0.2887."""
    edge_px = math.sqrt(math.log(2.0) / 2.0) / (math.pi * brentq(lambda f: np.sinc(f) - 0.5, 0, 1))
    for seed in (20, 21):
        burst = stack_of(seen_by(12, seed, shape=(72, 110), snr=3000))
        told = replace(burst, meta={**burst.meta, "psf_sigma_px": edge_px})
        with warnings.catch_warnings():
            warnings.simplefilter("error", lensshift.QualityWarning)
            reconstruct(told, method="tikhonov")
    with pytest.warns(lensshift.QualityWarning, match="sharper than psf_sigma_px"):
        reconstruct(replace(burst, meta={"psf_sigma_px": 0.4}), method="tikhonov")


def test_a_width_that_was_told_with_a_large_error_is_not_refuted() -> None:
    burst = stack_of(seen_by(12, 20, snr=300))
    with pytest.warns(lensshift.QualityWarning, match="sharper than psf_sigma_px"):
        reconstruct(replace(burst, meta={"psf_sigma_px": 0.45}), method="tikhonov")
    unsure = replace(burst, meta={"psf_sigma_px": 0.45, "psf_std_px": 0.1})
    with warnings.catch_warnings():
        warnings.simplefilter("error", lensshift.QualityWarning)
        reconstruct(unsure, method="tikhonov")


@pytest.mark.parametrize("method", ["auto", "tikhonov", "tv"])
def test_a_fill_factor_and_every_method_are_held_against_the_frames(method: str) -> None:
    burst, whole = stack_of(seen_by(6, 21, snr=300)), stack_of(seen_by(12, 21, snr=300))
    with pytest.warns(lensshift.QualityWarning, match="sharper than fill_factor 1 lets them be"):
        found = reconstruct(burst, method=method, fill_factor=1.0)
    assert found.amplitude.status is Status.CONTRADICTED
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reconstruct(burst, method=method, fill_factor=0.5)
        reconstruct(whole, method=method, fill_factor=0.2)  # behind a lens that nobody told
    with pytest.warns(lensshift.QualityWarning, match="softer than fill_factor 0.2 lets them be"):
        reconstruct(whole, method=method, fill_factor=0.2, psf_sigma_px=0.02)


@pytest.mark.parametrize("channel", ["amplitude", "auto", "phasor"])
def test_frames_of_distances_object_in_every_channel(channel: str) -> None:
    seen = simulate_tof(
        named_scene("four_boxes"), camera_preset("o3m151"), named_pattern_px("square"), seed=17
    ).burst
    with pytest.warns(lensshift.QualityWarning, match="sharper than psf_sigma_px 0.5"):
        reconstruct(seen, method="tikhonov", channel=channel, psf_sigma_px=0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reconstruct(seen, method="tikhonov", channel=channel)


@pytest.mark.parametrize("seed", [14, 15])
def test_four_boxes_of_an_unknown_camera(seed: int) -> None:
    """Light and distances within what they are with the width that the camera has."""
    seen = simulate_tof(
        named_scene("four_boxes"), camera_preset("o3m151"), named_pattern_px("square"), seed=seed,
        shift_error_px=0.02,
    )  # fmt: skip
    told = seen.burst
    bare = Burst.from_arrays(
        told.amplitude, told.distance_m, offset_px=told.offset_px, pitch_mm=told.grid.pitch_mm,
        modulation_hz=told.modulation_hz, meta={"stray_light": told.meta["stray_light"]},
    )  # fmt: skip
    for channel in ("amplitude", "phasor"):
        with warnings.catch_warnings():
            warnings.simplefilter("error", lensshift.QualityWarning)
            found, known = (reconstruct(one, channel=channel) for one in (bare, told))
        assert found.settings["psf_source"] == "frames"
        off_px = found.settings["psf_sigma_px"] - known.settings["psf_sigma_px"]
        assert abs(off_px) <= 0.03
        found_db, known_db = (
            fidelity(one.amplitude.image, seen.truth.amplitude).psnr_db for one in (found, known)
        )
        assert found_db >= known_db - 0.5


@pytest.mark.parametrize("without", ["one frequency", "light of its own"])
def test_a_told_width_is_believed_where_phasors_are_not_known(without: str) -> None:
    """Distances of two frequencies are no phase, and light less than none is no amplitude."""
    seen, hz = seen_by(12, 21).y, (100e6, 20e6) if without == "one frequency" else 20e6
    light = np.array(seen)
    light[:, 3, 4] *= -0.01 if without != "one frequency" else 1.0
    burst = Burst.from_arrays(
        light, np.full(light.shape, 1.2), offset_px=square(2), pitch_mm=0.1, modulation_hz=hz
    )
    found = reconstruct(burst, channel="amplitude", psf_sigma_px=0.29, method="tikhonov")
    wide = reconstruct(replace(burst, distance_m=None), psf_sigma_px=0.29, method="tikhonov")
    np.testing.assert_array_equal(found.amplitude.image, wide.amplitude.image)


def test_a_stream_keeps_what_was_read() -> None:
    seen = seen_by(6, 530)
    stream = lensshift.stream(square(2), shape=(21, 30))
    widths = [stream.step(seen.y[k % 4]).settings["psf_sigma_px"] for k in range(8)]
    live = [stream.step(seen.y[k % 4]).settings for k in range(3)]
    assert {one["pace"] for one in live} == {"live"}
    assert {one["psf_sigma_px"] for one in live} == {widths[-1]}
    assert widths[-1] == pytest.approx(width_of(6), abs=0.04)


def test_small_frames_and_frames_of_one_pixel_keep_the_usual_width() -> None:
    for shape in ((1, 1), (1, 9), (5, 40)):
        y = np.random.default_rng(1).random((4, *shape))
        result = reconstruct(Burst.from_arrays(y, offset_px=square(2), pitch_mm=1.0))
        assert result.settings["psf_source"] == "assumed"


def test_bytes_are_no_measure_of_edges() -> None:
    """Cameras for people sharpen, clip and bend; what was read from them was wrong and sure."""
    seen = seen_by(6, 513)
    rounded = np.clip(np.round(200 * seen.y), 0, 255)
    for y in (rounded, rounded.astype(np.uint8)):
        burst = Burst.from_arrays(y, offset_px=seen.offset_px, pitch_mm=0.05)
        assert reconstruct(burst, channel="amplitude").settings["psf_source"] == "assumed"


def test_a_hole_in_the_middle_of_a_large_sensor_is_no_obstacle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(response, "WINDOW_PX", 20)  # that is looked at of a larger sensor
    seen = seen_by(6, 531, shape=(26, 30))
    valid = np.ones(seen.y.shape, np.bool_)
    valid[:, 2:-2, 4:-4] = False
    sigma = np.where(valid, seen.sigma, np.inf)
    model = forward_model((26, 30), SCALE, seen.offset_px, blur=GaussianBlur(ASSUMED_PX))
    found = likely_response(model, seen.y, sigma)
    assert np.isfinite([found.width_px, found.std_px]).all()
