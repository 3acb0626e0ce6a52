"""The phasor channel: closed forms, a card before a wall, and what it refuses."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift import Burst, reconstruct
from lensshift.core.errors import QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Pinhole
from lensshift.core.types import Reconstruction
from lensshift.core.units import (
    SPEED_OF_LIGHT_MPS,
    distance_to_phase,
    phase_to_distance,
    unambiguous_range_m,
)
from lensshift.reconstruction.phasor import PhasorFrames, flying_pixels, phasor_from_phases
from lensshift.reconstruction.phasor.channel import NO_PHASE_RAD
from lensshift.reconstruction.phasor.common_light import phase_drift
from lensshift.reconstruction.phasor.frames import polar_frames
from lensshift.reconstruction.photometry import lights

Array = NDArray[Any]

F_HZ = 15e6
RANGE_M = unambiguous_range_m(F_HZ)
SHAPE = (13, 17)
OFFSETS = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])
FINE = 8  # samples of the scene across an LR pixel


def card(rows_px: Array, cols_px: Array) -> tuple[Array, Array]:
    """Amplitude and distance of a bright card that leans before a dim wall that leans."""
    on = (np.abs(rows_px - 6.2) < 3.6) & (np.abs(cols_px - 8.3 - 0.15 * rows_px) < 4.1)
    distance_m = np.where(on, 2.6 + 0.01 * rows_px, 3.4 + 0.008 * cols_px)
    return np.where(on, 0.7, 0.25), distance_m


def pixel_means(offset_px: Array, per_px: int) -> Array:
    """Return the mean phasor of the card over each of `per_px` x `per_px` parts of the pixels."""
    fine = (np.arange(FINE * max(SHAPE)) + 0.5) / FINE - 0.5
    rows, cols = np.meshgrid(
        fine[: FINE * SHAPE[0]] - offset_px[0], fine[: FINE * SHAPE[1]] - offset_px[1],
        indexing="ij",
    )  # fmt: skip
    a, d = card(rows, cols)
    x = a * np.exp(1j * distance_to_phase(d, F_HZ))
    n = FINE // per_px
    return np.asarray(x.reshape(SHAPE[0] * per_px, n, SHAPE[1] * per_px, n).mean(axis=(1, 3)))


def burst_of(phasor: Array, **fields: Any) -> Burst:
    return Burst.from_arrays(
        np.abs(phasor), phase_to_distance(np.angle(phasor), F_HZ), offset_px=OFFSETS,
        pitch_mm=0.1, **({"modulation_hz": F_HZ} | fields),
    )  # fmt: skip


def card_burst(sigma: float, seed: int = 0) -> Burst:
    rng = np.random.default_rng(seed)
    y = np.stack([pixel_means(offset, 1) for offset in OFFSETS])
    return burst_of(y + sigma * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)))


def truth() -> tuple[Array, Array]:
    x = pixel_means(np.zeros(2), 2)
    return np.abs(x), phase_to_distance(np.angle(x), F_HZ)


def images(result: Reconstruction) -> tuple[Array, Array]:
    assert result.amplitude is not None
    assert result.distance_m is not None
    return result.amplitude.image, result.distance_m.image


@pytest.mark.parametrize("method", ["auto", "tikhonov", "tv"])
def test_a_uniform_phasor_stays(method: str) -> None:
    y = np.full((4, *SHAPE), 0.6 * np.exp(1j * distance_to_phase(7.3, F_HZ)))
    result = reconstruct(burst_of(y), method=method, channel="phasor")
    amplitude, distance_m = images(result)
    assert amplitude.shape == (2 * SHAPE[0], 2 * SHAPE[1])
    np.testing.assert_allclose(amplitude, 0.6, atol=0.003)  # conjugate gradients at the border
    np.testing.assert_allclose(distance_m, 7.3, atol=0.003)
    assert result.flying is not None
    assert not result.flying.any()


def test_a_leaning_plane_stays_a_plane() -> None:
    rows, cols = np.meshgrid(*map(np.arange, SHAPE), indexing="ij")
    d = np.stack([3.0 + 0.02 * (rows - o[0]) + 0.03 * (cols - o[1]) for o in OFFSETS])
    result = reconstruct(burst_of(0.5 * np.exp(1j * distance_to_phase(d, F_HZ))), channel="phasor")
    u, v = np.meshgrid(*((np.arange(2 * n) + 0.5) / 2 - 0.5 for n in SHAPE), indexing="ij")
    inside = (slice(3, -3), slice(3, -3))
    expected_m = 3.0 + 0.02 * u + 0.03 * v
    off_m = (images(result)[1] - expected_m)[inside]
    assert np.sqrt(np.mean(off_m**2)) < 1e-3
    assert np.abs(off_m).max() < 5e-3  # the prior is learned: exact it is not


def test_brighter_frames_make_a_brighter_image_at_the_same_distance() -> None:
    burst = card_burst(0.01)
    a, d = images(reconstruct(burst, channel="phasor"))
    brighter = replace(burst, amplitude=3.0 * burst.amplitude)
    a3, d3 = images(reconstruct(brighter, channel="phasor"))
    np.testing.assert_allclose(a3, 3.0 * a, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(d3, d, atol=1e-5)


@pytest.mark.parametrize("more_m", [1.0, 6.8])
def test_a_farther_scene_moves_in_distance_alone_and_comes_round(more_m: float) -> None:
    burst = card_burst(0.01)
    a, d = images(reconstruct(burst, channel="phasor"))
    assert burst.distance_m is not None
    farther = replace(burst, distance_m=np.mod(burst.distance_m + more_m, RANGE_M))
    a2, d2 = images(reconstruct(farther, channel="phasor"))
    np.testing.assert_allclose(a2, a, atol=1e-6)
    np.testing.assert_allclose(d2, np.mod(d + more_m, RANGE_M), atol=1e-5)


@pytest.mark.parametrize("method", ["auto", "tikhonov", "tv"])
@pytest.mark.parametrize("garbage", [np.nan, 1e6, -5.0])
def test_invalid_pixels_change_nothing(method: str, garbage: float) -> None:
    burst = card_burst(0.01)
    valid = np.random.default_rng(3).random(burst.amplitude.shape) > 0.1
    found = []
    for value in (0.0, garbage):
        assert burst.distance_m is not None
        spoilt = replace(
            burst, valid=valid, amplitude=np.where(valid, burst.amplitude, value),
            distance_m=np.where(valid, burst.distance_m, value),
        )  # fmt: skip
        found.append(images(reconstruct(spoilt, method=method, channel="phasor")))
    np.testing.assert_array_equal(found[0], found[1])
    assert np.all(np.isfinite(found[0]))


@pytest.mark.parametrize("kind", ["complex", "polar", "beyond the range"])
def test_frames_are_dark_where_they_are_not_valid(kind: str) -> None:
    burst = card_burst(0.01)
    valid = np.random.default_rng(3).random(burst.amplitude.shape) > 0.1
    amplitude, distance_m = burst.amplitude, np.asarray(burst.distance_m)
    if kind == "complex":
        burst = Burst.from_arrays(
            amplitude * np.exp(1j * distance_to_phase(distance_m, F_HZ)), offset_px=OFFSETS,
            pitch_mm=0.1, modulation_hz=F_HZ, valid=valid,
        )  # fmt: skip
    else:
        more_m = 0.0 if kind == "polar" else RANGE_M
        burst = replace(burst, valid=valid, distance_m=distance_m + more_m)
    found = polar_frames(burst)
    np.testing.assert_array_equal(found.amplitude[~valid], 0.0)
    np.testing.assert_array_equal(found.phase_rad[~valid], 0.0)
    np.testing.assert_allclose(found.amplitude[valid], amplitude[valid])
    off_m = (found.scale.distance_m(found.phase_rad) - distance_m)[valid]
    np.testing.assert_allclose(off_m, 0.0 if kind != "beyond the range" else RANGE_M, atol=1e-9)


def near_card_edge(distance_m: Array) -> NDArray[np.bool_]:
    from scipy.ndimage import maximum_filter, minimum_filter

    return np.asarray(maximum_filter(distance_m, 5) - minimum_filter(distance_m, 5) > 0.4)


def test_edges_are_better_than_from_distances_alone() -> None:
    true_m = truth()[1]
    edge = near_card_edge(true_m)
    for seed in range(2):
        burst = card_burst(0.005, seed)
        joint_m = images(reconstruct(burst, channel="phasor"))[1]
        alone = reconstruct(burst, channel="distance").distance_m
        assert alone is not None
        rms = [np.sqrt(np.mean((d - true_m)[edge] ** 2)) for d in (joint_m, alone.image)]
        assert rms[0] < 0.85 * rms[1]


def test_std_covers_the_errors_of_flat_parts() -> None:
    true_a, true_m = truth()
    flat = ~near_card_edge(true_m)
    flat[:3] = flat[-3:] = flat[:, :3] = flat[:, -3:] = False
    result = reconstruct(card_burst(0.01), channel="phasor")
    for estimate, true in ((result.amplitude, true_a), (result.distance_m, true_m)):
        assert estimate is not None
        assert estimate.std is not None
        pull = (estimate.image - true)[flat] / estimate.std[flat]
        assert np.mean(np.abs(pull) < 2) >= 0.9
        assert np.sqrt(np.mean(pull**2)) > 0.3  # flat parts are easier than what std is learned on


@pytest.mark.parametrize("method", ["auto", "tikhonov"])
@pytest.mark.parametrize("dark", [0.1, 0.3])
def test_the_std_of_a_distance_grows_as_the_light_falls(method: str, dark: float) -> None:
    sigma, rng = 0.002, np.random.default_rng(3)
    cols = np.arange(SHAPE[1]) - OFFSETS[:, 1, None, None] + np.zeros((SHAPE[0], 1))
    light = dark ** np.clip((cols - 4.5) / 8, 0, 1)
    noise = sigma * (rng.standard_normal(light.shape) + 1j * rng.standard_normal(light.shape))
    burst = burst_of(light * np.exp(1j * distance_to_phase(3.0, F_HZ)) + noise)
    found = reconstruct(burst, method=method, channel="phasor").distance_m
    left, right = np.s_[5:-5, 2:7], np.s_[5:-5, -7:-2]
    assert np.median(found.std[right]) == pytest.approx(np.median(found.std[left]) / dark, rel=0.5)
    assert np.std(found.image[right]) < 1.5 * np.median(found.std[right])
    assert found.std.max() <= NO_PHASE_RAD / distance_to_phase(1.0, F_HZ)


def test_an_outlier_is_not_believed() -> None:
    burst = card_burst(0.005)
    clean = images(reconstruct(burst, channel="phasor"))
    assert burst.distance_m is not None
    amplitude, distance_m = burst.amplitude.copy(), burst.distance_m.copy()
    amplitude[1, 6, 2], distance_m[1, 6, 2] = 0.9, 8.0
    hit = replace(burst, amplitude=amplitude, distance_m=distance_m)
    result = reconstruct(hit, channel="phasor")
    assert np.max(np.abs(images(result)[1] - clean[1])[10:15, 2:7]) < 0.1
    assert result.amplitude is not None
    assert result.amplitude.confidence is not None
    assert result.amplitude.confidence[1, 6, 2] < 0.1


def test_flying_pixels_lie_between_two_surfaces() -> None:
    image_m = np.full((7, 9), 3.0)
    image_m[:, 5:] = 4.0
    image_m[2:5, 4] = 3.5
    expected = np.zeros((7, 9), bool)
    expected[2:5, 4] = True
    np.testing.assert_array_equal(flying_pixels(image_m), expected)
    assert not flying_pixels(image_m, noise_m=0.4).any()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("backwards", [False, True])
def test_a_pixel_within_the_noise_of_one_side_of_a_step_does_not_fly(
    backwards: bool, turned: bool
) -> None:
    """It is compared with what two pixels on a side go on to: 2 b - a, of sqrt(6) sigma."""
    sigma_m, step_m = 0.01, 0.19  # less than 5 % of the distance
    allowed_m = 3 * np.sqrt(6) * sigma_m
    for off_m, expected in ((allowed_m - 0.001, False), (allowed_m + 0.001, True)):
        image_m = np.full((7, 9), 4.0) + 0.001 * np.arange(7)[:, None]
        image_m[:, 5:] += step_m
        image_m[3, 4] += off_m
        image_m = image_m[:, ::-1] if backwards else image_m
        found = flying_pixels(image_m.T if turned else image_m, noise_m=sigma_m)
        assert np.any(found) == expected


def test_small_steps_have_flying_pixels_too_and_slanted_walls_none() -> None:
    rng = np.random.default_rng(4)
    row, col = np.mgrid[:9, :15]
    sigma_m = 0.002
    noise_m = sigma_m * rng.standard_normal(row.shape)
    wall_m = 4.0 + 0.02 * row - 0.03 * col + noise_m
    assert not flying_pixels(wall_m, noise_m=sigma_m).any()
    step_m = wall_m + 0.1 * (col > 7) + 0.05 * (col == 7)  # 2.5 % of the distance
    found = flying_pixels(step_m, noise_m=sigma_m)
    assert found[2:-2, 7].mean() > 0.9
    assert not np.delete(found, 7, axis=1).any()


def floor_m(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return the radial distances of a floor that a camera sees at 3 to 35 degrees."""
    pinhole = Pinhole.of_field(Grid(shape, (0.1, 0.1)), np.deg2rad(40.0))
    tilt_rad, turn_rad = np.deg2rad(rng.uniform(58.0, 62.0)), rng.uniform(0.0, 2.0 * np.pi)
    flat = np.sin(tilt_rad)
    normal = [flat * np.cos(turn_rad), flat * np.sin(turn_rad), np.cos(tilt_rad)]
    return np.asarray(1.2 / (pinhole.directions(shape) @ np.array(normal)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("share", [0.0003, 0.003])
def test_floors_do_not_fly_however_steep(seed: int, share: float) -> None:
    """Their neighbours differ by more than 5 %, which passed for two surfaces."""
    rng = np.random.default_rng(seed)
    wall_m = floor_m(rng, (24, 30))
    assert max(np.abs(np.diff(np.log(wall_m), axis=axis)).max() for axis in (0, 1)) > 0.05
    noise_m = share * wall_m
    found = flying_pixels(wall_m + noise_m * rng.standard_normal(wall_m.shape), noise_m=noise_m)
    assert found.mean() < 0.02  # a third to all of them before


@pytest.mark.parametrize("seed", range(6))
def test_pixels_that_mix_a_floor_with_a_box_before_it_fly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    row, _ = np.mgrid[:24, :30]
    wall_m = 1.0 / (0.15 + 0.01 * row)  # from 6.7 to 2.6 m, 4 % a row
    near_m = 0.6 * wall_m[12]
    image_m = wall_m + 0.01 * rng.standard_normal(wall_m.shape)
    image_m[8:16, 10:20] = near_m[10:20] + 0.01 * rng.standard_normal((8, 10))
    share = rng.uniform(0.3, 0.7, 8)
    image_m[8:16, 20] = share * near_m[20] + (1 - share) * wall_m[8:16, 20]
    assert flying_pixels(image_m, noise_m=0.01)[9:15, 20].all()


@pytest.mark.parametrize("seed", range(6))
def test_floors_beyond_the_range_do_not_fly(seed: int) -> None:
    """Told a turn nearer, their steps are more than 5 %, and 1 / distance is no straight line."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:24, :30]
    wall_m = 1.0 / (0.125 - 0.0021 * row + 0.0004 * col)  # from 8 to 13 m
    told_m = np.mod(wall_m + 0.003 * rng.standard_normal(wall_m.shape), 10.0)
    assert flying_pixels(told_m, noise_m=0.003).mean() > 0.1
    assert flying_pixels(told_m, noise_m=0.003, range_m=10.0).mean() < 0.02


def test_mixtures_fly_the_short_way_round() -> None:
    """Of a wall at 12 m, told as 2, and a box at 9 m, phasors mix what is told as 0.5."""
    image_m = np.full((9, 12), 2.0)
    image_m[:, 6:] = 9.0
    image_m[2:7, 5] = 0.5
    assert not flying_pixels(image_m, noise_m=0.01)[3:6, 5].any()
    found = flying_pixels(image_m, noise_m=0.01, range_m=10.0)
    assert found[3:6, 5].all()
    assert not np.delete(found, 5, axis=1).any()


def test_estimates_predict_the_frames() -> None:
    burst = card_burst(0.002)
    result = reconstruct(burst, channel="phasor")
    assert result.amplitude is not None
    assert result.distance_m is not None
    assert burst.distance_m is not None
    inside = (slice(2, -2), slice(2, -2))
    wrong = np.abs(result.amplitude.predict(2) - burst.amplitude[2])[inside]
    wrong_m = np.abs(result.distance_m.predict(2) - burst.distance_m[2])[inside]
    assert np.median(wrong) < 0.004
    assert np.median(wrong_m) < 0.02


def test_without_modulation_the_range_of_the_distances_decides() -> None:
    burst = replace(card_burst(0.005), modulation_hz=None)
    result = reconstruct(burst, channel="phasor")
    assert burst.distance_m is not None
    assert result.distance_m is not None
    notes = result.distance_m.notes
    assert notes["modulation_source"] == "range of the distances"
    span_m = np.ptp(burst.distance_m)
    assert unambiguous_range_m(notes["modulation_hz"]) == pytest.approx(2 * span_m)
    flat = ~near_card_edge(truth()[1])
    error_m = (result.distance_m.image - truth()[1])[flat]
    assert np.sqrt(np.mean(error_m**2)) < 0.05


def test_distances_beyond_the_range_are_kept() -> None:
    burst = card_burst(0.005)
    assert burst.distance_m is not None
    far = replace(burst, distance_m=burst.distance_m + 2 * RANGE_M)
    near_m, far_m = (images(reconstruct(b, channel="phasor"))[1] for b in (burst, far))
    np.testing.assert_allclose(far_m, near_m + 2 * RANGE_M, atol=0.02)


@pytest.mark.filterwarnings("ignore:the frames are complex")
def test_auto_chooses_phasors_only_where_they_can_be_had() -> None:
    burst = card_burst(0.01)
    waves = replace(burst, amplitude=burst.amplitude * np.exp(1j), distance_m=None)
    cases: list[tuple[Burst, dict[str, Any], str]] = [
        (burst, {}, "phasor"),
        (waves, {}, "phasor"),
        (replace(waves, modulation_hz=None), {}, "separate"),
        (replace(burst, modulation_hz=None), {}, "separate"),
        (replace(burst, distance_m=None), {}, "separate"),
        (replace(burst, amplitude=0 * burst.amplitude), {}, "separate"),
        (burst, {"method": "bicubic"}, "separate"),
        (burst, {"noise_sigma": 0.01}, "separate"),
        (burst, {"photometric": True}, "separate"),
    ]
    for given, settings, expected in cases:
        chosen = reconstruct(given, std=False, **settings).settings
        assert chosen["channel"] == expected
        assert chosen["channel_reason"]


@pytest.mark.parametrize(
    ("fields", "settings", "message"),
    [
        ({"distance_m": None}, {}, "no distance_m"),
        ({}, {"method": "irwsr"}, "among auto, tikhonov, tv"),
        ({}, {"prior_weight": 0.1}, "no prior to weigh"),
        ({}, {"photometric": True}, "photometric"),
        ({"amplitude": np.full((4, *SHAPE), -1.0)}, {}, "at least 0"),
        ({"amplitude": np.ones((4, *SHAPE), complex), "modulation_hz": None}, {}, "modulation_hz"),
    ],
)
def test_what_cannot_be_is_refused(
    fields: dict[str, Any], settings: dict[str, Any], message: str
) -> None:
    burst = replace(card_burst(0.01), **fields)
    with pytest.raises(ValueError, match=message):
        reconstruct(burst, channel="phasor", **settings)


def test_four_phases_make_the_phasor_and_its_noise() -> None:
    phasor = np.stack([pixel_means(offset, 1) for offset in OFFSETS])
    turns = np.exp(-0.5j * np.pi * np.arange(4))[None, :, None, None]
    difference = (phasor[:, None] * turns).real
    frames = phasor_from_phases(difference)
    assert isinstance(frames, PhasorFrames)
    np.testing.assert_allclose(frames.phasor, phasor, atol=1e-12)
    rng = np.random.default_rng(0)
    noisy = phasor_from_phases(0.3 * rng.standard_normal((50, 4, 20, 20)), 0.09)
    np.testing.assert_allclose(noisy.phasor.real.var(), noisy.variance.mean(), rtol=0.05)
    np.testing.assert_allclose(noisy.phasor.imag.var(), noisy.variance.mean(), rtol=0.05)


def test_phasors_go_into_a_burst_with_their_variance() -> None:
    by_distance = card_burst(0.01)
    phasor = polar_frames(by_distance).phasor
    frames = phasor_from_phases(np.stack([phasor.real, phasor.imag, -phasor.real, -phasor.imag], 1),
                                2e-4)  # fmt: skip
    burst = Burst.from_arrays(frames.phasor, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=F_HZ)
    result = reconstruct(burst, channel="phasor", pixel_variance=frames.variance)
    assert result.amplitude is not None
    assert result.amplitude.noise_sigma == pytest.approx(0.01)
    same = reconstruct(by_distance, channel="phasor", noise_sigma=0.01)
    np.testing.assert_allclose(images(result)[0], images(same)[0], atol=1e-6)


@pytest.mark.parametrize(
    ("difference", "variance", "message"),
    [
        (np.zeros((4, 5, 7)), 1.0, r"\[frame 4 row col\]"),
        (np.zeros((2, 3, 5, 7)), 1.0, r"\[frame 4 row col\]"),
        (np.zeros((2, 4, 5, 7), complex), 1.0, "real phases"),
        (np.zeros((2, 4, 5, 7)), 0.0, "positive"),
        (np.zeros((2, 4, 5, 7)), np.ones(3), "broadcast"),
    ],
)
def test_phases_of_another_kind_are_refused(difference: Array, variance: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        phasor_from_phases(difference, variance)


def test_phasor_case_of_the_reference_data(reference_dir: Path) -> None:
    with np.load(reference_dir / "irwsr" / "tofphasor_x2_4f_input.npz") as given:
        y, true, shifts = np.moveaxis(given["LR"], -1, 0), given["gt"], given["shifts"]
    hz = SPEED_OF_LIGHT_MPS / 2.5  # phases come back after 1.25 m
    burst = Burst.from_arrays(y, offset_px=-shifts[:, ::-1], pitch_mm=0.1, modulation_hz=hz)
    found_m = images(reconstruct(burst, channel="phasor", std=False))[1]
    error_m = (found_m - phase_to_distance(np.angle(true), hz))[4:-4, 4:-4]
    assert np.sqrt(np.mean(error_m**2)) < 0.0152
    assert np.median(np.abs(error_m)) < 0.002


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", ["polar", "complex", "frequencies"])
def test_light_that_differs_between_frames_is_allowed_for_and_said(kind: str, seed: int) -> None:
    """It passed for movement, took turns of phases with it, or was averaged."""
    even = card_burst(0.004)
    z, rng = polar_frames(even).phasor, np.random.default_rng(seed)
    gain = rng.uniform(0.6, 1.4, 4)
    if kind == "complex":
        even = Burst.from_arrays(z, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=F_HZ)
    if kind == "frequencies":
        both = np.stack([z, z**2 / np.abs(z)])
        even = Burst.from_arrays(
            both, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=(F_HZ, 2 * F_HZ)
        )
    each = gain[:, None, None]
    phasors = None if even.phasors is None else even.phasors * each
    uneven = replace(even, amplitude=even.amplitude * each, phasors=phasors)
    with pytest.warns(QualityWarning) as said:
        found = reconstruct(uneven)
    assert [one.filename for one in said] == [__file__]
    dark, bright = np.argmin(gain), np.argmax(gain)
    text = str(said[0].message)
    assert f"that of frame {bright} is " in text
    assert f"that of frame {dark}: " in text
    assert "allows for it" in text
    other, usual = reconstruct(even), np.median(gain)
    np.testing.assert_allclose(found["amplitude"].notes["gain"], gain / usual, rtol=0.01)
    light, far_m = images(found)
    np.testing.assert_allclose(light, usual * images(other)[0], atol=0.02 * light.max())
    apart_m = np.abs(far_m - images(other)[1])
    assert np.mean(apart_m < np.asarray(other["distance"].std)) > 0.98
    predicted = found["amplitude"].predict(int(bright))
    assert np.median(predicted / np.abs(uneven.amplitude[bright])) == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("kind", ["polar", "unwrapped", "complex", "frequencies"])
def test_distances_that_drift_between_frames_are_allowed_for_and_said(kind: str) -> None:
    """They were averaged at surfaces, with nothing in std, and mixed at edges."""
    even = card_burst(0.004)
    z, drift_m = polar_frames(even).phasor, np.array([0.01, -0.03, 0.0, 0.05])
    turned, twice = (
        np.exp(1j * distance_to_phase(drift_m, hz))[:, None, None] for hz in (F_HZ, 2 * F_HZ)
    )
    if kind == "complex":
        even = Burst.from_arrays(z, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=F_HZ)
        drifting = replace(even, amplitude=z * turned)
    elif kind == "frequencies":
        both = np.stack([z, z**2 / np.abs(z)])
        told = {"offset_px": OFFSETS, "pitch_mm": 0.1, "modulation_hz": (F_HZ, 2 * F_HZ)}
        even = Burst.from_arrays(both, **told)
        drifting = Burst.from_arrays(both * np.stack([turned, twice]), **told)
    else:
        beyond_m = RANGE_M if kind == "unwrapped" else 0.0
        even = replace(even, distance_m=even.distance_m + beyond_m)
        drifting = replace(even, distance_m=even.distance_m + drift_m[:, None, None])
    with pytest.warns(QualityWarning, match="frame 3 are .* than those of frame 1") as said:
        found = reconstruct(drifting)
    assert [one.filename for one in said] == [__file__]
    left_m = found["distance"].notes["drift_m"] - (drift_m - np.median(drift_m))
    np.testing.assert_allclose(left_m, 0, atol=0.008)  # four errors of a median
    apart_m = images(found)[1] - images(reconstruct(even))[1] - np.median(drift_m)
    assert np.median(np.abs(apart_m)) < 0.008
    std_m = np.asarray(found["distance"].std)
    assert std_m.min() > np.std(drift_m, ddof=1) / 2


@pytest.mark.parametrize("seed", range(20, 30))
def test_what_moves_or_a_shift_that_is_off_is_no_drift_of_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, 4, *SHAPE))
    off_px = OFFSETS + 0.04 * rng.standard_normal(OFFSETS.shape)
    still = np.stack([pixel_means(at, 1) for at in off_px]) + 0.002 * (noise[0] + 1j * noise[1])
    told = {"offset_px": OFFSETS, "pitch_mm": 0.1, "modulation_hz": F_HZ}
    moved = still.copy()
    moved[2:, :, 3:7] = 0.4 * np.exp(1j * rng.uniform(0, 6)) + 0.002 * noise[0, 2:, :, :4]
    assert np.all(phase_drift(Burst.from_arrays(moved, **told), 0) == 0)
    drifts = still * np.exp(1j * rng.uniform(-0.5, 0.5, 4))[:, None, None]
    assert np.any(phase_drift(Burst.from_arrays(drifts, **told), 0) != 0)


@pytest.mark.parametrize("seed", range(20, 30))
def test_a_dark_thing_before_half_of_the_picture_is_no_other_light(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, 4, *SHAPE))
    z = (0.5 + 0.5 * rng.random(SHAPE)) * np.exp(1j) + 0.01 * (noise[0] + 1j * noise[1])
    thing = rng.uniform(0.1, 0.4) * np.exp(1j * rng.uniform(0, 6))
    z[2:, :, :9] = thing * (1 + 0.02 * rng.standard_normal((2, 13, 9)))
    moved = Burst.from_arrays(z, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=F_HZ)
    assert np.all(lights(moved, 0) == 1)


@pytest.mark.parametrize("shape", [(1, 30), (30, 1)])
def test_a_line_of_pixels_has_distances(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((2, 4, *shape))
    z = np.exp(1j) + 0.01 * (noise[0] + 1j * noise[1])
    axis = int(np.argmax(shape))
    offset_px = np.zeros((4, 2))
    offset_px[:, axis] = [-0.25, 0.25, -0.25, 0.25]
    burst = Burst.from_arrays(z, offset_px=offset_px, pitch_mm=0.1, modulation_hz=15e6)
    found_m = images(reconstruct(burst, channel="phasor"))[1]
    np.testing.assert_allclose(found_m, phase_to_distance(1.0, 15e6), atol=0.05)
