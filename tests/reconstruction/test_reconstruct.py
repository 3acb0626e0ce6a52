"""The one call for all methods: what it promises, whatever the method."""

from __future__ import annotations

import math
import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from pixel_camera import (
    SQUARE_PX,
    edge_scene,
    interior_psnr,
    make_burst,
    photograph,
    smooth_scene,
    truth,
)

from lensshift.core.errors import DataError
from lensshift.core.types import Burst, ShiftField, Status
from lensshift.reconstruction.methods import Tv, find_method, method_names
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.reconstruction.toolbox.irwsr import irwsr_toolbox

SHAPE, HR_SHAPE = (9, 13), (18, 26)
LINEAR = ("nearest", "bicubic", "shift-and-add", "drizzle", "tikhonov")
PLAIN = ("nearest", "bicubic", "shift-and-add", "drizzle", "deconvolution")
REAL_ONLY = ("l1-btv", "map", "irwsr", "irwsr-toolbox")


def _noisy(scene=smooth_scene, shape=SHAPE, sigma: float = 0.01, seed: int = 0) -> np.ndarray:
    frames = photograph(scene, shape, SQUARE_PX)
    return frames + sigma * np.random.default_rng(seed).standard_normal(frames.shape)


def _image(burst: Burst, method: str = "auto", **settings: Any) -> np.ndarray:
    found = reconstruct(burst, method=method, **settings).amplitude
    assert found is not None
    return found.image


def _weight(method: str) -> dict[str, Any]:
    return {} if method in (*PLAIN, "auto") else {"prior_weight": 0.01}


# ---- every method


@pytest.mark.parametrize("method", method_names())
def test_every_method_runs_on_a_small_odd_burst(method: str) -> None:
    found = reconstruct(make_burst(_noisy()), 2, method)
    estimate = found.amplitude
    assert estimate is not None
    assert found.distance_m is None
    assert (found.method, found.scale, found.grid.shape) == (method, 2, HR_SHAPE)
    assert estimate.image.shape == HR_SHAPE
    assert np.all(np.isfinite(estimate.image))
    assert estimate.status is not Status.NOT_FINITE
    assert interior_psnr(estimate.image, truth(smooth_scene, SHAPE, 2)) > 25.0
    if estimate.std is not None:
        assert estimate.std.shape == HR_SHAPE
        assert np.all(estimate.std >= 0)
        assert np.all(np.isfinite(estimate.std))
    assert find_method(method).summary


@pytest.mark.parametrize("method", sorted({*method_names()} - {"drizzle", "irwsr-toolbox"}))
@pytest.mark.parametrize("scale", [1, 2])
def test_a_line_of_pixels_is_a_burst_like_any_other(method: str, scale: int) -> None:
    line = photograph(lambda row, col: 0.5 + 0.3 * np.sin(0.4 * col) + 0 * row, (1, 23), SQUARE_PX)
    told = _weight(method)
    lying, standing = (
        _image(make_burst(y, offset_px=offset), method, scale=scale, **told)
        for y, offset in ((line, SQUARE_PX), (line.swapaxes(1, 2), SQUARE_PX[:, ::-1]))
    )
    assert lying.shape == (scale, 23 * scale)
    np.testing.assert_allclose(standing, lying.T, atol=0.025 if method == "irwsr" else 1e-3)
    middle = 0.5 + 0.3 * np.sin(0.4 * ((np.arange(23 * scale) + 0.5) / scale - 0.5))
    assert np.max(np.abs(lying.mean(axis=0) - middle)[scale:-scale]) < 0.1


def test_drizzle_refuses_a_line_of_pixels() -> None:
    with pytest.raises(ValueError, match="2 x 2 pixels or more"):
        reconstruct(make_burst(np.ones((4, 1, 9))), 2, "drizzle")


@pytest.mark.parametrize(
    ("odd", "usual"), [(np.float16, np.float32), (np.longdouble, np.float64), (">f2", np.float32)]
)
def test_frames_of_odd_precision_are_read_as_they_are(odd: str, usual: str) -> None:
    y = _noisy().astype(odd)
    np.testing.assert_array_equal(_image(make_burst(y)), _image(make_burst(y.astype(usual))))


@pytest.mark.parametrize("method", method_names())
def test_no_method_touches_the_burst(method: str) -> None:
    burst = make_burst(_noisy())
    before = burst.amplitude.copy()
    reconstruct(burst, 2, method, **_weight(method))
    np.testing.assert_array_equal(burst.amplitude, before)


@pytest.mark.parametrize("method", method_names())
def test_what_invalid_pixels_hold_does_not_matter(method: str) -> None:
    frames = _noisy()
    valid = np.ones(frames.shape, bool)
    valid[0, 4, 5] = valid[2, 1, 7:9] = valid[3, :, 12] = False
    settings = _weight(method)
    images = []
    for value in (0.0, 1e6, np.nan, np.inf):
        images.append(
            _image(make_burst(np.where(valid, frames, value), valid=valid), method, **settings)
        )
    assert np.all(np.isfinite(images[0]))
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


@pytest.mark.parametrize("method", method_names())
def test_negative_values_can_be_forbidden(method: str) -> None:
    burst = make_burst(_noisy(edge_scene) - 0.21)
    if method == "irwsr-toolbox":
        with pytest.raises(ValueError, match="non-negative"):
            reconstruct(burst, method=method, non_negative=True)
        return
    assert _image(burst, method, **_weight(method)).min() < 0.0
    assert _image(burst, method, non_negative=True, **_weight(method)).min() >= 0.0


@pytest.mark.parametrize("method", LINEAR)
def test_real_and_imaginary_parts_of_phasors_do_not_mix(method: str) -> None:
    real, imaginary = _noisy(seed=1), _noisy(edge_scene, seed=2) - 0.5
    settings = _weight(method) | {"noise_sigma": 0.01, "channel": "amplitude"}
    both = _image(make_burst(real + 1j * imaginary), method, **settings)
    parts = [_image(make_burst(part), method, **settings) for part in (real, imaginary)]
    assert both.dtype.kind == "c"
    # The conjugate gradients stop at a relative residual of 1e-4.
    tolerance = 2e-3 if method == "tikhonov" else 1e-9
    np.testing.assert_allclose(both.real, parts[0], atol=tolerance)
    np.testing.assert_allclose(both.imag, parts[1], atol=tolerance)


@pytest.mark.parametrize("method", [*LINEAR, "deconvolution"])
def test_a_common_phase_of_phasors_comes_through(method: str) -> None:
    frames, turn = _noisy(seed=1) * np.exp(0.3j), np.exp(0.7j)
    settings = _weight(method) | {"noise_sigma": 0.01, "channel": "amplitude"}
    image = _image(make_burst(frames), method, **settings)
    turned = _image(make_burst(turn * frames), method, **settings)
    np.testing.assert_allclose(turned, turn * image, atol=1e-6)


@pytest.mark.parametrize("method", ["auto", "tv"])
def test_sparse_methods_take_phasors(method: str) -> None:
    image = _image(make_burst(_noisy(seed=1) * np.exp(0.7j)), method, channel="amplitude")
    assert image.dtype.kind == "c"
    np.testing.assert_allclose(
        np.abs(image - truth(smooth_scene, SHAPE, 2) * np.exp(0.7j)), 0, atol=0.1
    )


@pytest.mark.parametrize("method", REAL_ONLY)
def test_methods_for_real_frames_refuse_phasors(method: str) -> None:
    with pytest.raises(ValueError, match=r"real|complex"):
        reconstruct(make_burst(_noisy() + 0j), method=method, channel="amplitude")


# ---- units


def test_auto_answers_a_hundredth_of_the_frames_with_a_hundredth_of_the_image() -> None:
    frames = _noisy(edge_scene, (16, 24))
    image = _image(make_burst(frames))
    np.testing.assert_allclose(_image(make_burst(0.01 * frames)), 0.01 * image, atol=1e-8)


@pytest.mark.parametrize("method", [one for one in method_names() if one != "irwsr-toolbox"])
def test_frames_in_another_unit_are_the_same_picture(method: str) -> None:
    """Watts or counts: the robust methods saw nothing in frames far below 1."""
    frames = _noisy(edge_scene, (16, 24))
    one = reconstruct(make_burst(frames), method=method).amplitude
    for unit in (1e-60, 1e-9, 0.03, 1e7):
        other = reconstruct(make_burst(unit * frames), method=method).amplitude
        np.testing.assert_allclose(other.image / unit, one.image, atol=1e-5, err_msg=str(unit))
        np.testing.assert_allclose(other.std / unit, one.std, rtol=1e-3, err_msg=str(unit))


def test_the_toolbox_takes_frames_in_watts() -> None:
    frames = _noisy(edge_scene, (16, 24))
    reference = truth(edge_scene, (16, 24), 2)
    one = _error(_image(make_burst(frames), "irwsr-toolbox"), reference)
    other = _error(_image(make_burst(1e-9 * frames), "irwsr-toolbox") / 1e-9, reference)
    assert other == pytest.approx(one, rel=0.1)


def test_a_frame_of_which_every_pixel_is_at_an_end_of_its_range_is_reconstructed() -> None:
    """None of them tells of the noise, and nothing was left to read it from."""
    frames = (np.random.default_rng(0).random((1, 9, 12)) > 0.5).astype(np.uint8) * 255
    burst = make_burst(frames, offset_px=np.zeros((1, 2)))
    for method in ("auto", "tv", "nearest"):
        assert np.all(np.isfinite(_image(burst, method)))


def test_std_and_noise_come_in_the_units_of_the_frames() -> None:
    frames = _noisy(sigma=0.02)
    for method in ("auto", "bicubic"):
        small = reconstruct(make_burst(frames), method=method).amplitude
        large = reconstruct(make_burst(100.0 * frames), method=method).amplitude
        assert large.noise_sigma == pytest.approx(100.0 * small.noise_sigma, rel=1e-6)
        np.testing.assert_allclose(large.std, 100.0 * small.std, rtol=1e-6)
        if method != "auto":  # whose std is more than noise
            assert large.noise_gain == pytest.approx(small.noise_gain, rel=1e-6)


@pytest.mark.parametrize("method", ["auto", "irwsr", "bicubic"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_integer_frames_come_back_in_their_units(method: str, kind: type) -> None:
    top = np.iinfo(kind).max
    frames = np.round(_noisy() * top).astype(kind)
    image = _image(make_burst(frames), method)
    np.testing.assert_allclose(image, truth(smooth_scene, SHAPE, 2) * top, atol=0.12 * top)
    as_floats = _image(make_burst(frames / top), method)
    np.testing.assert_allclose(image / top, as_floats, atol=1e-6)


def test_a_given_noise_is_believed() -> None:
    burst = make_burst(_noisy(edge_scene, (16, 24), sigma=0.02))
    quiet = reconstruct(burst, noise_sigma=0.005).amplitude
    loud = reconstruct(burst, noise_sigma=0.05).amplitude
    assert (quiet.noise_sigma, loud.noise_sigma) == (pytest.approx(0.005), pytest.approx(0.05))
    flat = (slice(6, -6), slice(-12, -4))
    assert loud.image[flat].std() < quiet.image[flat].std()


def _error(image: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(np.mean((image - reference)[4:-4, 4:-4] ** 2)))


@pytest.mark.parametrize("method", ["auto", "tikhonov", "tv", "irwsr"])
def test_a_large_level_costs_no_quality(method: str) -> None:
    """A scene of 290 K with a contrast of 2 K: what was relative to 290 K lost it."""
    frames, reference = _noisy(edge_scene, (16, 24)), truth(edge_scene, (16, 24), 2)
    plain = _error(_image(make_burst(frames), method, std=False), reference)
    lifted = reconstruct(make_burst(290.0 + frames), method=method, std=False).amplitude
    assert _error(lifted.image - 290.0, reference) < 1.25 * plain
    np.testing.assert_allclose(lifted.predict(1), 290.0 + frames[1], atol=0.15)


def test_gain_and_bias_are_found_on_a_large_level() -> None:
    frames, gain = _noisy(edge_scene, (16, 24)), np.array([1.0, 1.002, 1.0, 0.998])
    frames = gain[:, None, None] * (100.0 + frames)
    estimate = reconstruct(make_burst(frames), photometric=True, std=False).amplitude
    for k in range(4):
        assert abs(np.median((frames[k] - estimate.predict(k))[2:-2, 2:-2])) < 0.01


@pytest.mark.parametrize("shape", [SHAPE, (16, 24)])
def test_an_even_picture_raises_no_doubt(shape: tuple[int, int]) -> None:
    for level in (0.0, 0.5, 290.0):
        noise = 0.01 * np.random.default_rng(1).standard_normal((4, *shape))
        for burst in (make_burst(level + noise), make_burst(np.full((4, *shape), level))):
            np.testing.assert_allclose(_image(burst, std=False), level, atol=0.05)


@pytest.mark.parametrize("reference_px", [0.66, 0.0])
def test_an_error_that_all_shifts_share_does_not_blur(reference_px: float) -> None:

    def rings(row: np.ndarray, col: np.ndarray) -> np.ndarray:
        return 0.5 + 0.4 * np.cos(0.056 * ((row - 8) ** 2 + (col - 12) ** 2))

    frames, reference = _noisy(rings, (16, 24)), truth(rings, (16, 24), 2)
    told_px = np.full((4, 2), 0.66)
    told_px[0] = reference_px
    untold, told = (
        _error(_image(make_burst(frames, **fields), std=False), reference)
        for fields in ({}, {"offset_sigma_px": told_px})
    )
    assert told < 1.25 * untold


def test_a_fill_factor_stands_for_the_whole_response() -> None:
    burst = make_burst(_noisy(edge_scene))
    alone = _image(burst, "tikhonov", fill_factor=1.0, prior_weight=0.01)
    no_optics = _image(burst, "tikhonov", fill_factor=1.0, psf_sigma_px=0.0, prior_weight=0.01)
    np.testing.assert_array_equal(alone, no_optics)


def test_a_response_of_many_pixels_is_questioned_or_refused() -> None:
    burst = make_burst(_noisy())
    for width_px, questioned in ((3.0, True), (1.0, False)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            reconstruct(burst, psf_sigma_px=width_px, std=False)
        assert any("so wide" in str(w.message) for w in caught) is questioned
    with pytest.raises(ValueError, match="psf_sigma_px: expected 0 to 10"):
        reconstruct(burst, psf_sigma_px=30.0)


def test_the_blur_of_a_lens_is_not_undone_by_the_default() -> None:
    """Wanted is what smaller pixels see behind the same lens: wider than a pixel is the lens."""
    burst = make_burst(_noisy())
    pixel = reconstruct(burst, psf_sigma_px=1 / math.sqrt(12), std=False)
    wide = reconstruct(burst, psf_sigma_px=0.42, std=False)
    np.testing.assert_array_equal(wide.amplitude.image, pixel.amplitude.image)
    assert wide.settings["psf_sigma_px"] == 0.42
    sharp = reconstruct(burst, method="tikhonov", psf_sigma_px=0.42, std=False)
    soft = reconstruct(burst, method="tikhonov", psf_sigma_px=1 / math.sqrt(12), std=False)
    assert np.std(sharp.amplitude.image) > np.std(soft.amplitude.image)


def test_a_blur_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="psf_sigma_px: expected a number or 'auto'"):
        reconstruct(make_burst(_noisy()), psf_sigma_px="wide")


# ---- frames, shift fields, prediction


def test_the_toolbox_sees_every_pixel_as_published() -> None:
    """Pixels that look beyond the picture take part there, with the taps that are left."""
    offset_px = 3.0 * SQUARE_PX
    frames = photograph(edge_scene, SHAPE, offset_px)
    image = _image(make_burst(frames, offset_px), "irwsr-toolbox", prior_weight=0.01)
    published = irwsr_toolbox(frames, offset_px, 2, prior_weight=0.01)[0].image
    np.testing.assert_allclose(image, published, atol=1e-9)


def test_only_the_frames_asked_for_are_used() -> None:
    frames = _noisy()
    spoilt = frames.copy()
    spoilt[1] = 7.0
    found = reconstruct(make_burst(spoilt), frames=(3, 0, 2))
    alone = reconstruct(make_burst(frames[[3, 0, 2]], SQUARE_PX[[3, 0, 2]]))
    np.testing.assert_array_equal(found.amplitude.image, alone.amplitude.image)
    assert found.settings["frames"] == [3, 0, 2]


def test_frames_can_be_predicted_by_number_and_by_offset() -> None:
    shape = (16, 24)
    offsets = np.vstack([SQUARE_PX, (0.4, -0.1)])
    clean = photograph(smooth_scene, shape, offsets)
    burst = make_burst(clean, offsets)
    estimate = reconstruct(burst, frames=(0, 1, 2, 3)).amplitude
    inside = (slice(2, -2), slice(2, -2))
    for k in range(5):
        np.testing.assert_allclose(estimate.predict(k)[inside], clean[k][inside], atol=0.01)
    np.testing.assert_allclose(estimate.predict((0.4, -0.1)), estimate.predict(4), atol=1e-12)
    np.testing.assert_allclose(estimate.predict(offsets[2]), estimate.predict(2), atol=1e-12)
    for wrong in (5, -1):
        with pytest.raises(ValueError, match="frame from 0 to 4"):
            estimate.predict(wrong)
    with pytest.raises(ValueError, match="offset_px"):
        estimate.predict((0.1, 0.2, 0.3))
    with pytest.raises(ValueError, match="offset_px"):
        estimate.predict((0.1, np.nan))


def test_every_method_can_predict() -> None:
    burst = make_burst(_noisy())
    for method in PLAIN:
        assert reconstruct(burst, method=method).amplitude.predict(1).shape == SHAPE


def test_the_blur_is_that_of_the_burst_unless_told() -> None:
    told = make_burst(_noisy(), meta={"psf_sigma_px": 0.2})
    settings = {"method": "tikhonov", "prior_weight": 0.01}
    by_burst = reconstruct(told, **settings)
    assert (by_burst.settings["psf_sigma_px"], by_burst.settings["psf_source"]) == (0.2, "burst")
    np.testing.assert_array_equal(
        by_burst.amplitude.image, _image(make_burst(_noisy()), psf_sigma_px=0.2, **settings)
    )
    assert reconstruct(told, psf_sigma_px=0.4, **settings).settings["psf_source"] == "given"
    assert reconstruct(make_burst(_noisy()), **settings).settings["psf_source"] == "assumed"
    alone = reconstruct(told, fill_factor=0.5, **settings)  # that of the burst holds the pixel
    assert alone.settings["psf_source"] == "assumed"
    with pytest.raises(DataError, match=r"meta\.psf_sigma_px: expected a number, got 'wide'"):
        reconstruct(make_burst(_noisy(), meta={"psf_sigma_px": "wide"}))


@pytest.mark.parametrize("method", ["auto", "tikhonov", "irwsr", "shift-and-add", "bicubic"])
def test_a_constant_shift_field_equals_the_offsets(method: str) -> None:
    burst = make_burst(_noisy())
    field = ShiftField(np.broadcast_to(SQUARE_PX[:, None, None, :], (4, *SHAPE, 2)).copy())
    elsewhere = make_burst(burst.amplitude, SQUARE_PX + 0.4)
    settings = _weight(method)
    expected = _image(burst, method, **settings)
    found = _image(elsewhere, method, shift_field=field, **settings)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_shift_field_is_selected_with_its_frames() -> None:
    burst = make_burst(_noisy())
    field = ShiftField(np.broadcast_to(SQUARE_PX[:, None, None, :], (4, *SHAPE, 2)).copy())
    elsewhere = make_burst(burst.amplitude, SQUARE_PX + 0.4)
    found = _image(elsewhere, "tikhonov", shift_field=field, frames=(3, 1), prior_weight=0.01)
    expected = _image(burst, "tikhonov", frames=(3, 1), prior_weight=0.01)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_shift_field_of_another_burst_is_refused() -> None:
    burst = make_burst(_noisy())
    swapped = np.tile(SQUARE_PX[[0, 1, 3, 2], None, None], (1, *SHAPE, 1))
    with pytest.raises(DataError, match=r"offset_px: .* 0\.50 px more in 2 of 4 frames, frame 2"):
        reconstruct(burst, shift_field=ShiftField(swapped))
    own = np.tile(SQUARE_PX[:, None, None], (1, *SHAPE, 1))
    with pytest.raises(DataError, match=r"pitch_mm: .* pixels of \(0\.01, 0\.01\) mm, got"):
        reconstruct(burst, shift_field=ShiftField(own, (0.1, 0.155)))
    with pytest.raises(DataError, match="shift field of"):
        reconstruct(burst, shift_field=ShiftField(own[:3]))


def test_gain_and_bias_are_found_on_request() -> None:
    shape = (16, 24)
    gain, bias = np.array([1.1, 0.95, 1.0, 0.97]), np.array([0.02, -0.03, 0.02, -0.01])
    frames = 50.0 * (gain[:, None, None] * _noisy(edge_scene, shape) + bias[:, None, None])
    estimate = reconstruct(make_burst(frames), photometric=True).amplitude
    true_gain = gain / np.exp(np.mean(np.log(gain)))
    np.testing.assert_allclose(estimate.notes["gain"], true_gain, atol=0.02)
    found_gain, found_bias = np.array(estimate.notes["gain"]), np.array(estimate.notes["bias"])
    for level in (0.2, 0.8):
        seen = 50.0 * (gain * level + bias)
        assert np.ptp((seen - found_bias) / found_gain) < 50.0 * 0.01
    # The prediction of a used frame has its gain and bias in it again.
    for k in range(4):
        residual = (frames[k] - estimate.predict(k))[2:-2, 2:-2]
        assert abs(np.median(residual)) < 50.0 * 0.005


def test_std_holds_the_level_that_no_frame_tells() -> None:
    """Gains are known against each other only: their mean is off, and the picture with it."""
    inside = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        gain, bias = 1 + 0.05 * rng.standard_normal(4), 0.02 * rng.standard_normal(4)
        frames = gain[:, None, None] * _noisy(edge_scene, SHAPE, seed=seed) + bias[:, None, None]
        estimate = reconstruct(make_burst(frames), photometric=True).amplitude
        assert isinstance(estimate.std, np.ndarray)
        off = np.abs(estimate.image - truth(edge_scene, SHAPE, 2)) / estimate.std
        inside.append(np.mean(off[4:-4, 4:-4] < 2))
    # A mean of four with a spread that is known from the four: 86 % by Student's law.
    assert np.mean(inside) > 0.8


@pytest.mark.filterwarnings("ignore:the frames contradict offset_px")  # the frame of noise does
def test_known_variance_takes_a_bad_frame_out() -> None:
    frames = _noisy(smooth_scene, (16, 24), sigma=0.002)
    frames[1] += 0.5 * np.random.default_rng(3).standard_normal(frames[1].shape)
    variance = np.full(frames.shape, 0.002**2)
    variance[1] = 0.5**2
    expected = truth(smooth_scene, (16, 24), 2)
    blind = _image(make_burst(frames), "tikhonov", prior_weight=0.01)
    told = _image(make_burst(frames), "tikhonov", prior_weight=0.01, pixel_variance=variance)
    assert interior_psnr(told, expected) > interior_psnr(blind, expected) + 6.0


def test_a_burst_with_distance_gives_both_channels() -> None:
    amplitude, distance = _noisy(edge_scene), 2.0 + _noisy()
    burst = make_burst(amplitude, distance_m=distance)
    both = reconstruct(burst)
    np.testing.assert_array_equal(both.amplitude.image, _image(make_burst(amplitude)))
    np.testing.assert_allclose(both.distance_m.image, 2.0 + truth(smooth_scene, SHAPE, 2), atol=0.1)
    assert reconstruct(burst, channel="amplitude").distance_m is None
    alone = reconstruct(burst, channel="distance")
    assert alone.amplitude is None
    np.testing.assert_array_equal(alone.distance_m.image, both.distance_m.image)


# ---- weights, progress, arguments


@pytest.mark.parametrize("method", ["tikhonov", "tv", "irwsr", "l1-btv"])
def test_cross_validation_is_repeatable(method: str) -> None:
    burst = make_burst(_noisy(edge_scene))
    settings = {"prior_weight": "cross-validation", "seed": 4, "std": False}
    first = reconstruct(burst, method=method, **settings).amplitude
    second = reconstruct(burst, method=method, **settings).amplitude
    assert 1e-8 < first.prior_weight < 10.0
    assert first.prior_weight == second.prior_weight
    np.testing.assert_array_equal(first.image, second.image)


@pytest.mark.parametrize("method", ["tikhonov", "tv", "l1-btv", "map", "irwsr"])
def test_a_given_weight_is_kept_and_its_std_is_repeatable(method: str) -> None:
    burst = make_burst(_noisy(edge_scene))
    first, second = (reconstruct(burst, method=method, prior_weight=0.02).amplitude for _ in "ab")
    assert first.prior_weight == pytest.approx(0.02)
    np.testing.assert_array_equal(first.std, second.std)


def test_std_can_be_left_out() -> None:
    for method in ("auto", "shift-and-add", "irwsr"):
        estimate = reconstruct(make_burst(_noisy()), method=method, std=False).amplitude
        assert estimate.std is None
        assert estimate.noise_gain is None


class _StopError(Exception):
    """What a user's callback raises to stop."""


@pytest.mark.parametrize("method", ["auto", "tikhonov", "tv", "l1-btv", "map", "irwsr"])
def test_progress_is_reported_and_can_stop_the_work(method: str) -> None:
    burst = make_burst(_noisy())
    calls: list[tuple[int, float]] = []
    reconstruct(
        burst, method=method, **_weight(method),
        on_iteration=lambda step, value: calls.append((step, value)),
    )  # fmt: skip
    steps = [step for step, _ in calls]
    assert steps
    assert steps == sorted(set(steps))
    assert all(np.isfinite(value) for _, value in calls)

    def stop(step: int, value: float) -> None:
        raise _StopError

    with pytest.raises(_StopError):
        reconstruct(burst, method=method, on_iteration=stop)


def test_iterations_are_an_option() -> None:
    estimate = reconstruct(make_burst(_noisy()), method="tv", iterations=2).amplitude
    assert len(estimate.objective) == 2
    assert estimate.status is Status.MAX_ITERATIONS


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"method": "magic"}, "auto, nearest, bicubic"),
        ({"window": 2}, "auto does not know window; its options: none"),
        ({"method": "tikhonov", "pixfrac": 1.0}, "pixfrac; its options: prior_weight"),
        ({"scale": 0}, "whole scale from 1 to 8"),
        ({"scale": 9}, "whole scale from 1 to 8"),
        ({"scale": 2.5}, "whole scale from 1 to 8"),
        ({"scale": True}, "whole scale from 1 to 8"),
        ({"channel": "colour"}, "amplitude, distance or phasor"),
        ({"channel": "phasor"}, "no distance_m"),
        ({"channel": "distance"}, "no distance_m"),
        ({"prior_weight": -0.1}, "at least 0"),
        ({"prior_weight": np.nan}, "at least 0"),
        ({"prior_weight": "guess"}, "cross-validation"),
        ({"noise_sigma": 0.0}, "noise_sigma: expected a positive"),
        ({"noise_sigma": np.inf}, "noise_sigma: expected a positive"),
        ({"frames": ()}, "frames from 0 to 3"),
        ({"frames": (0, 4)}, "frames from 0 to 3"),
        ({"frames": (-1, 0)}, "frames from 0 to 3"),
        ({"frames": (1, 1)}, "each frame once"),
        ({"psf_sigma_px": -1.0}, "sigma"),
        ({"fill_factor": 1.5}, "fill"),
        ({"shift_field": ShiftField(np.zeros((4, 9, 12, 2)))}, r"shift field of \(4, 9, 13, 2\)"),
        ({"pixel_variance": np.zeros((4, *SHAPE))}, "positive, finite pixel_variance"),
        ({"pixel_variance": np.ones((4, 9, 12))}, r"pixel_variance of \(4, 9, 13\)"),
        ({"method": "nearest", "frame": 4}, "frame from 0 to 3"),
        ({"method": "map", "prior": "magic"}, "tv"),
        ({"method": "map", "prior": "tv", "window": 2}, "prior tv does not know window"),
    ],
)
def test_a_wrong_argument_says_what_was_expected(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        reconstruct(make_burst(_noisy()), **settings)


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("auto", {"iterations": 2}),
        ("auto", {"prior_weight": 0.1}),
        ("tv", {"iterations": 2.5}),
        ("tv", {"iterations": -3}),
        ("tv", {"iterations": "5"}),
        ("l1-btv", {"iterations": 0}),
        ("l1-btv", {"alpha": np.nan}),
        ("irwsr", {"window": 1.5}),
        ("irwsr", {"sparsity": 0}),
        ("irwsr", {"inner_iterations": True}),
        ("irwsr-toolbox", {"iterations": 1.5}),
        ("irwsr-toolbox", {"noise_sigma": 0.01}),
        ("map", {"threshold": -1.0, "prior": "huber"}),
        ("map", {"data_term": 2}),
        ("nearest", {"frame": True}),
        ("bicubic", {"frame": 1, "combine": "mean"}),
        ("bicubic", {"prior_weight": 0.1}),
        ("shift-and-add", {"combine": 3}),
        ("shift-and-add", {"combine": "first"}),
        ("drizzle", {"pixfrac": "a"}),
        ("drizzle", {"kernel": "round"}),
        ("deconvolution", {"algorithm": "magic"}),
        ("auto", {"photometric": "false"}),
        ("auto", {"std": 1}),
        ("auto", {"seed": 0.5}),
    ],
)
def test_no_method_takes_an_impossible_or_idle_option(method: str, options: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        reconstruct(make_burst(_noisy()), method=method, **options)


def test_a_method_may_be_made_before_it_is_used() -> None:
    burst = make_burst(_noisy(edge_scene))
    made = reconstruct(burst, 2, Tv(prior_weight=0.02, iterations=3), std=False)
    named = reconstruct(burst, 2, "tv", prior_weight=0.02, iterations=3, std=False)
    np.testing.assert_array_equal(made.amplitude.image, named.amplitude.image)
    assert made.method == "tv"
    assert made.settings == named.settings
    assert (made.settings["prior_weight"], made.settings["iterations"]) == (0.02, 3)
    with pytest.raises(ValueError, match="tv has its options already, got iterations"):
        reconstruct(burst, 2, Tv(), iterations=3)
    with pytest.raises(ValueError, match="iterations: expected a whole"):
        Tv(iterations=0)


def test_a_std_that_is_not_computed_yet_is_plain_data() -> None:
    estimate = reconstruct(make_burst(_noisy(edge_scene)), 2, "tikhonov").amplitude
    promise = estimate.uncertainty
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(promise))(), estimate.std)


def test_offsets_far_beyond_the_frame_are_refused() -> None:
    with pytest.raises(ValueError, match="are they in pixels"):
        reconstruct(make_burst(_noisy(), SQUARE_PX + 500.0))
