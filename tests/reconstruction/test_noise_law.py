"""Noise as a function of the light, with the scene in view."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from mosaic import canvas, observe, square
from pixel_camera import SQUARE_PX, edge_scene, photograph, smooth_scene
from scipy.ndimage import median_filter

from lensshift import Burst, QualityWarning, reconstruct
from lensshift.reconstruction.noise import light_of
from lensshift.reconstruction.noise_law import NoiseLaw, _blocks, _sampled, noise_law
from lensshift.reconstruction.smooth_fit import smooth_fits

SHAPE = (43, 56)
USED = np.ones((4, *SHAPE))


def _white(seed: int) -> np.ndarray:
    return np.random.default_rng(50 + seed).standard_normal((4, *SHAPE))


def _law(y: np.ndarray, used: np.ndarray = USED):
    return noise_law(SQUARE_PX, y, used, 0.3)


def _rings(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Rings that grow finer outwards, up to 0.45 cycles per LR pixel, brighter to the right."""
    return (0.3 + col / 150) * (
        1 + 0.8 * np.cos(np.pi * 0.45 / 20 * ((row - 20) ** 2 + (col - 24) ** 2))
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scene", [smooth_scene, edge_scene])
@pytest.mark.parametrize("sigma", [0.003, 0.03])
def test_even_noise_is_found_and_has_hardly_a_slope(scene, sigma: float, seed: int) -> None:
    y = photograph(scene, SHAPE, SQUARE_PX)
    y += sigma * _white(seed)
    law = _law(y)
    assert law.sigma == pytest.approx(sigma, rel=0.1)
    np.testing.assert_allclose(np.sqrt(law.variance(light_of(y, USED > 0))), sigma, rtol=0.15)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("turn_rad", [0.0, 0.4, 2.2])
def test_a_still_component_of_phasors_takes_no_part_for_the_whole(
    turn_rad: float, seed: int
) -> None:
    """Distances in centimetres leave no noise across the light, wherever that points."""
    y = photograph(edge_scene, SHAPE, SQUARE_PX) + 0.01 * _white(seed)
    law = _law(y * np.exp(1j * turn_rad))
    # One component varies more from block to block than the mean of two, and low ones tell.
    assert law.sigma == pytest.approx(0.01 / np.sqrt(2), rel=0.15)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("a", [0.0, 1e-4])
def test_the_noise_of_photons_grows_with_the_light(a: float, seed: int) -> None:
    clean = photograph(smooth_scene, SHAPE, SQUARE_PX)
    true = np.sqrt(a + 1e-3 * clean)
    y = clean + true * _white(seed)
    found = np.sqrt(_law(y).variance(light_of(y, USED > 0)))
    assert np.sqrt(np.mean(np.log(found / true) ** 2)) < 0.12
    even = np.sqrt(np.mean(true**2))
    assert np.sqrt(np.mean(np.log(even / true) ** 2)) > 0.15


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("frames", [2, 3])
def test_a_few_bright_blocks_tell_their_noise(frames: int, seed: int) -> None:
    """Two small cards before a large dark wall, and noise of photons: a camera's usual scene."""
    rng = np.random.default_rng(seed)
    bright = rng.uniform(0.5, 0.9, 2)

    def cards(row: np.ndarray, col: np.ndarray) -> np.ndarray:
        card = np.floor((col - 2.2) / 15).astype(int).clip(0, 1)
        on = (np.abs(row - 7.7) < 5.3) & ((col - 2.2) % 15 < 10.4) & (col < 33)
        return np.where(on, bright[card], 0.03)

    offset_px = square(frames)
    light = photograph(cards, (16, 64), offset_px)
    variance = 2e-6 * light
    y = light + np.sqrt(variance) * rng.standard_normal(light.shape)
    law = noise_law(offset_px, y, np.ones(y.shape), 0.3)
    for part in (light < 0.1, light > 0.4):
        told = np.sqrt(law.variance(light[part]).mean() / variance[part].mean())
        assert told == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("slope", [0.0, 30.0])
def test_noise_of_phasors_that_grows_with_the_light(slope: float) -> None:
    rng = np.random.default_rng(2)
    amplitude = np.repeat(np.geomspace(0.05, 1.0, 5), 13)[None, None, :] * np.ones((4, 31, 1))
    sigma = 0.004 * np.sqrt(1.0 + slope * amplitude)
    noise = rng.standard_normal((2, *amplitude.shape))
    phasor = amplitude * np.exp(0.7j) + sigma * (noise[0] + 1j * noise[1])
    weight = (rng.random(amplitude.shape) > 0.02).astype(float)
    phasor[weight == 0] = 0.0
    law = noise_law(SQUARE_PX, phasor, weight, 0.3)
    np.testing.assert_allclose(law.variance(amplitude[0, 0]) / sigma[0, 0] ** 2, 1.0, atol=0.35)


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_of_photons_alone_has_no_level(seed: int) -> None:
    rng = np.random.default_rng(seed)
    amplitude = photograph(lambda row, col: 0.01 + col / 161 + 0 * row, (83, 161), SQUARE_PX)
    noise = rng.standard_normal((2, *amplitude.shape))
    phasor = (amplitude + 1e-3 * np.sqrt(amplitude) * (noise[0] + 1j * noise[1])) * np.exp(0.7j)
    law = noise_law(SQUARE_PX, phasor, np.ones(amplitude.shape), 0.3)
    assert law.b == pytest.approx(1e-6, rel=0.15)
    assert abs(law.a) < 0.03 * 1e-6


def test_slopes_of_the_scene_are_no_noise() -> None:
    rng = np.random.default_rng(5)
    amplitude = photograph(
        lambda row, col: 1 + row / 8 + col / 13 + row * col / 600, (31, 40), SQUARE_PX
    )
    noise = rng.standard_normal((2, *amplitude.shape))
    phasor = amplitude * np.exp(0.7j) + 0.003 * (noise[0] + 1j * noise[1])
    law = noise_law(SQUARE_PX, phasor, np.ones(phasor.shape), 0.3)
    np.testing.assert_allclose(law.variance(amplitude), 9e-6, rtol=0.35)


@pytest.mark.parametrize("seed", range(3))
def test_texture_that_is_bright_gives_no_slope(seed: int) -> None:
    y = photograph(_rings, SHAPE, SQUARE_PX)
    y += 0.01 * _white(seed)
    found = np.sqrt(_law(y).variance(light_of(y, USED > 0)))
    np.testing.assert_allclose(found, 0.01, rtol=0.35)


def test_salt_and_pepper_on_fine_texture_do_not_count() -> None:
    y = photograph(_rings, SHAPE, SQUARE_PX)
    y += 0.01 * _white(6)
    draw = np.random.default_rng(2).random(y.shape)
    y = np.where(draw < 0.01, 0.0, np.where(draw > 0.99, 1.0, y))
    assert _law(y).sigma == pytest.approx(0.01, rel=0.4)


@pytest.mark.parametrize(("a", "b"), [(1.0, 290.0), (4000.0, -17.0), (1e-6, 3.0)])
def test_the_law_is_that_of_the_units(a: float, b: float) -> None:
    clean = photograph(smooth_scene, SHAPE, SQUARE_PX)
    y = clean + np.sqrt(1e-3 * clean) * _white(9)
    plain, other = _law(y), _law(a * y + b)
    assert plain.b > 0
    assert other.sigma == pytest.approx(a * plain.sigma, rel=1e-2)
    np.testing.assert_allclose(
        other.variance(a * clean + b), a * a * plain.variance(clean), rtol=0.02
    )


@pytest.mark.parametrize("spoil", ["dead", "salt"])
def test_pixels_that_lie_do_not_count(spoil: str) -> None:
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    y += 0.02 * _white(0)
    bad = np.random.default_rng(3).random(y.shape) < 0.03
    y = np.where(bad, 1.5, y)
    used = np.where(bad & (spoil == "dead"), 0.0, 1.0)
    assert _law(y, used).sigma == pytest.approx(0.02, rel=0.1)
    if spoil == "dead":
        assert _law(np.where(bad, -7.0, y), used) == _law(y, used)


@pytest.mark.parametrize("seed", range(3))
def test_a_frame_of_elsewhere_does_not_count(seed: int) -> None:
    offset_px = np.random.default_rng(seed).uniform(-0.5, 0.5, (9, 2))
    y = photograph(edge_scene, SHAPE, offset_px)
    y += 0.02 * np.random.default_rng(seed + 9).standard_normal(y.shape)
    y[4] = np.roll(y[4], (2, 1), (0, 1))
    assert noise_law(offset_px, y, np.ones(y.shape), 0.3).sigma == pytest.approx(0.02, rel=0.15)


@pytest.mark.parametrize("count", [3, 5, 12])
def test_any_shifts_and_number_of_frames(count: int) -> None:
    rng = np.random.default_rng(count)
    offset_px = rng.uniform(-0.5, 0.5, (count, 2))
    y = photograph(edge_scene, SHAPE, offset_px)
    y += 0.02 * rng.standard_normal(y.shape)
    assert noise_law(offset_px, y, np.ones(y.shape), 0.3).sigma == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("shape", [(5, 7), (1, 40), (16, 9)])
def test_small_frames(shape: tuple[int, int]) -> None:
    y = 0.5 + 0.1 * np.random.default_rng(1).standard_normal((4, *shape))
    assert noise_law(SQUARE_PX, y, np.ones(y.shape), 0.3).sigma == pytest.approx(0.1, rel=0.4)


def test_flat_frames_have_no_noise() -> None:
    law = _law(np.full((4, *SHAPE), 0.5))
    assert law.sigma == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("seed", [0, 1])
def test_offsets_and_types_of_numbers_change_nothing(seed: int) -> None:
    """A thermal scene of 290 K, and the counts of a converter."""
    rng = np.random.default_rng(seed)
    counts = np.rint(4000 * observe(canvas(rng, (22, 27)), (22, 27), rng=rng).y + 3000)

    def image(y: np.ndarray) -> np.ndarray:
        burst = Burst.from_arrays(y, offset_px=square(2), pitch_mm=0.1)
        return reconstruct(burst).amplitude.image

    plain = image(counts)
    np.testing.assert_array_equal(image(counts.astype(np.uint16)), plain)
    warm = image(counts / 4e4 + 290.0)
    np.testing.assert_allclose((warm - 290.0) * 4e4, plain, atol=0.02 * 80)


def test_what_was_found_of_the_noise_is_told() -> None:
    y = photograph(smooth_scene, SHAPE, SQUARE_PX)
    y += np.sqrt(1e-3 * y) * _white(4)
    burst = Burst.from_arrays(100.0 * y, offset_px=SQUARE_PX, pitch_mm=0.1)
    law = reconstruct(burst).amplitude.notes["noise_law"]
    assert law["b"] == pytest.approx(1e-3 * 100.0, rel=0.4)
    told = reconstruct(burst, noise_sigma=2.0).amplitude.notes["noise_law"]
    assert told == pytest.approx({"a": 4.0, "b": 0.0})


@pytest.mark.parametrize("shape", [(7, 10), (3, 16), (9, 3), (2, 12)])
def test_the_border_says_nothing_where_there_is_a_middle(shape: tuple[int, int]) -> None:
    inner = tuple(slice(1, -1) if n > 2 else slice(None) for n in shape)
    light = np.full((1, 4, *shape), 1e3)
    light[..., *inner] = 2.0
    fits = smooth_fits(SQUARE_PX.tobytes(), 4, shape, 0.3)
    flat, used = np.zeros(light.shape, np.float32), np.ones(light.shape, bool)
    np.testing.assert_allclose(_blocks(flat, used, fits, light, 1)[1], 2.0)


def test_blocks_of_which_a_third_or_less_is_used_count_only_if_there_are_no_others() -> None:
    shape = (21, 30)
    fits = smooth_fits(SQUARE_PX.tobytes(), 4, shape, 0.3)
    row, col = np.indices(shape)
    used = np.zeros((1, 4, *shape), bool)
    used[0, 0] = True
    used[0, 1] = (row % 3 > 0) & (col % 3 == 0)  # with those 11 of 36
    few, light = used.copy(), np.where(used, 9.0, 2.0)
    used[..., 15:] = True
    flat = np.zeros(used.shape, np.float32)
    light[..., 15:] = 2.0
    np.testing.assert_allclose(_blocks(flat, used, fits, light, 1)[1], 2.0)
    np.testing.assert_allclose(_blocks(flat, few, fits, 9.0 * few, 1)[1], np.full(70, 9.0))


@pytest.mark.parametrize("shape", [(5, 8), (2, 7), (1, 4), (9, 3), (10, 12)])
def test_blocks_of_three_lie_side_by_side_within_the_frame(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(3).standard_normal((2, *shape))
    sides = (min(3, shape[0]), min(3, shape[1]))
    blocks = np.lib.stride_tricks.sliding_window_view(values, sides, (1, 2))[:, ::3, ::3]
    np.testing.assert_allclose(_sampled(values), blocks.mean(axis=(-2, -1)), atol=1e-12)


def test_light_is_the_median_of_a_cross() -> None:
    y = np.random.default_rng(3).random((3, 7, 12))
    cross = np.array([[[0, 1, 0], [1, 1, 1], [0, 1, 0]]], bool)
    expected = median_filter(y, footprint=cross, mode="nearest")
    np.testing.assert_allclose(light_of(y, np.ones(y.shape, bool)), expected, rtol=1e-6)
    used = np.ones(y.shape, bool)
    used[:, 3, 4] = False
    wild = np.where(used, y, 1e6)
    assert light_of(wild, used)[used].max() <= 1.0


@pytest.mark.parametrize("channel", ["amplitude", "distance", "phasor"])
@pytest.mark.parametrize(
    ("shape", "part"),
    [
        ((200, 60), np.s_[:, 52:70, 10:50]),  # between what is looked at of large frames
        ((32, 3), np.s_[:, :4, :1]),
        ((25, 68), np.s_[:, 24]),
        ((40, 31), np.s_[2, 7, 9]),
    ],
)
def test_frames_that_are_valid_in_a_part_only(shape, part, channel: str) -> None:
    """As if they were masked around what is of interest: found, whatever lies there."""
    rng = np.random.default_rng(4)
    valid = np.zeros((4, *shape), bool)
    valid[part] = True
    burst = Burst.from_arrays(
        5 + rng.standard_normal(valid.shape), 3 + 0.1 * rng.standard_normal(valid.shape),
        offset_px=SQUARE_PX, pitch_mm=0.1, valid=valid, modulation_hz=15e6,
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        found = reconstruct(burst, channel=channel)
    for one in (found.amplitude, found.distance_m):
        assert one is None or np.all(np.isfinite(one.image))


def test_so_many_times_the_noise_has_the_square_of_it_as_variance_at_any_light() -> None:
    law, light = NoiseLaw(0.3, 0.04, 0.1, 0.1, 0.9), np.linspace(0.0, 1.0, 7)
    np.testing.assert_allclose(law.times(0.6).variance(light), 0.36 * law.variance(light))
    assert law.times(0.6).sigma == pytest.approx(0.18)


@pytest.mark.parametrize("sigma", [0.1, 0.27, 0.33, 0.5])
@pytest.mark.parametrize("b", [0.0, 0.1])
@pytest.mark.parametrize("of_frames", [(), (0.5, 2.0, 1.0)])
def test_noise_that_is_at_least_so_much_is_more_where_there_is_more(
    of_frames: tuple[float, ...], b: float, sigma: float
) -> None:
    """And frames that differ in it differ by as much."""
    light = np.linspace(-0.1, 1.1, 9) * np.ones((3, 2, 1))
    plain = NoiseLaw(float(np.sqrt(0.04 + 0.4 * b)), 0.04, b, 0.1, 0.9)
    found = replace(plain, of_frames=of_frames).at_least(sigma).variance(light)
    times = np.array(of_frames or (1.0, 1.0, 1.0))[:, None, None]
    np.testing.assert_allclose(found, times * np.maximum(plain.variance(light), sigma**2))


@pytest.mark.parametrize("unit", [1.0, 250.0])
def test_told_noise_that_the_frames_do_not_show_is_questioned(unit: float) -> None:
    y = unit * (photograph(edge_scene, SHAPE, SQUARE_PX) + 0.02 * _white(6))
    burst = Burst.from_arrays(y, offset_px=SQUARE_PX, pitch_mm=0.1)
    for told in (0.01, 0.02, 0.05):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            reconstruct(burst, noise_sigma=unit * told, std=False)
    for told in (0.001, 0.3):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            reconstruct(burst, noise_sigma=unit * told, std=False)
        assert f"noise_sigma {unit * told:.3g} is not what" in str(said[0].message)
        assert said[0].filename == __file__
