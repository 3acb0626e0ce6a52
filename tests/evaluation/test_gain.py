"""Ratios of two measurements of one edge."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.gain import (
    average_gain,
    pair_edges,
    ratio_of,
    resolution_gain,
)
from lensshift.evaluation.slanted_edge import EdgeResult, Interval, Region, measure_edge

ANGLE_RAD = 0.17


@cache
def edge(shape: tuple[int, int], sigma_px: float, noise: float = 0.0) -> EdgeResult:
    row, col = np.mgrid[: shape[0], : shape[1]].astype(float)
    middle = (col - 0.5 * (shape[1] - 1)) * np.cos(ANGLE_RAD)
    normal = middle + (row - 0.5 * (shape[0] - 1)) * np.sin(ANGLE_RAD)
    image = 0.2 + 0.6 * ndtr(normal / sigma_px)
    image += 0.6 * noise * np.random.default_rng(3).standard_normal(shape)
    return measure_edge(image, aperture_px=0.0, region=(0, shape[0], 0, shape[1]))


def test_gain_of_gaussian_edges_is_the_ratio_of_their_widths() -> None:
    gain = resolution_gain(edge((17, 33), 0.7), edge((17, 33), 1.1))
    for ratio in (gain.mtf50, gain.mtf10, gain.width):
        assert ratio.value == pytest.approx(1.1 / 0.7, rel=2e-3)


@pytest.mark.parametrize("amount", [0.0, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_sharpened_image_is_told(amount: float, seed: int) -> None:
    """Unsharp masking had a gain of 1.4 without a word."""
    row, col = np.mgrid[:40, :50].astype(float)
    normal = (col - 24.3) * np.cos(ANGLE_RAD) + (row - 20) * np.sin(ANGLE_RAD)
    light = 0.2 + 0.6 * ((1 + amount) * ndtr(normal / 0.6) - amount * ndtr(normal / 1.6))
    noise = 0.006 * np.random.default_rng(seed).standard_normal((2, 40, 50))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        plain = measure_edge(0.2 + 0.6 * ndtr(normal / 0.6) + noise[0])
        other = measure_edge(light + noise[1])
        resolution_gain(other, plain)
        resolution_gain(plain, other)
    named = [word for one in caught for word in ("finer", "coarser") if word in str(one.message)]
    assert named == (["finer", "coarser"] if amount else [])


def test_noise_is_compared_over_the_contrast() -> None:
    gain = resolution_gain(edge((17, 33), 0.8, 0.04), edge((17, 33), 0.8, 0.02))
    assert gain.noise == pytest.approx(2.0, rel=0.02)
    assert gain.mtf50.low < 1.0 < gain.mtf50.high
    assert gain.width.low < 1.0 < gain.width.high


def test_interval_of_a_ratio_covers_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    truth, std = (2.0, 1.5), (0.15, 0.08)
    covered = []
    for _ in range(2000):
        above, below = (
            Interval(value, value - 1.96 * sigma, value + 1.96 * sigma)
            for value, sigma in zip(rng.normal(truth, std), std, strict=True)
        )
        ratio = ratio_of(above, below)
        covered.append(ratio.low <= truth[0] / truth[1] <= ratio.high)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.015)


positive = st.floats(0.1, 10.0)


@given(above=positive, below=positive, spread=st.floats(1.01, 1.5))
def test_turned_around_the_ratio_is_the_inverse(above: float, below: float, spread: float) -> None:
    one, other = (Interval(v, v / spread, v * spread) for v in (above, below))
    there, back = ratio_of(one, other), ratio_of(other, one)
    assert there.value == pytest.approx(1 / back.value)
    assert there.low == pytest.approx(1 / back.high)
    assert there.high == pytest.approx(1 / back.low)


def test_a_number_that_was_not_reached_gives_no_ratio() -> None:
    assert np.isnan(ratio_of(Interval(float("nan")), Interval(1.0, 0.9, 1.1)).value)
    open_ended = ratio_of(Interval(2.0, 1.9, float("inf")), Interval(1.0, 0.9, 1.1))
    assert np.isinf(open_ended.high)
    assert 1.5 < open_ended.low < 2.0


def test_equal_edges_average_to_themselves_with_a_narrower_interval() -> None:
    gain = resolution_gain(edge((17, 33), 0.7, 0.02), edge((17, 33), 1.1, 0.02))
    mean = average_gain([gain] * 4)
    assert mean.edges == 4
    assert mean.mtf50.value == pytest.approx(gain.mtf50.value)
    wide, narrow = (np.log(one.high / one.low) for one in (gain.mtf50, mean.mtf50))
    assert narrow == pytest.approx(wide / 2, rel=1e-6)
    with pytest.raises(ValueError, match="at least one gain"):
        average_gain([])


def test_different_edges_are_doubted_with_their_angles() -> None:
    one = edge((17, 33), 0.8)
    upright, slanted = (replace(one, angle_rad=Interval(angle)) for angle in (0.12, 0.2))
    with pytest.warns(QualityWarning, match=r"vertical at 6\.9 degrees and vertical at 11\.5"):
        resolution_gain(upright, slanted)


def pictures(place_px: float, turn_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return one edge in pixels of a half, and in whole ones."""
    both = []
    for scale in (2, 1):
        row, col = ((np.arange(n * scale) + 0.5) / scale - 0.5 for n in (30, 34))
        across = (col - place_px) * np.cos(turn_rad) + (row[:, None] - 14) * np.sin(turn_rad)
        noise = 0.003 * np.random.default_rng(scale).standard_normal(across.shape)
        both.append(0.2 + 0.6 * ndtr(across / (0.4 / scale + 0.4)) + noise)
    return both[0], both[1]


@pytest.mark.parametrize("turn_rad", [-0.2, 0.13])
@pytest.mark.parametrize("lies", [False, True])
def test_another_picture_is_told_and_the_same_is_not(turn_rad: float, lies: bool) -> None:
    """Inverted, mirrored and shifted pictures had a gain without a word."""
    fine, coarse = pictures(16.0, turn_rad)
    moved, _ = pictures(19.0, turn_rad)
    cases = {
        "": fine, "inverted": 1.0 - fine, "px of the coarser image aside": moved,
        "mirrored": fine[::-1, ::-1],
    }  # fmt: skip
    parts = ((4, 50, 4, 66), (6, 28, 1, 33))  # middles at other lines of the edge
    for word, image in cases.items():
        images, places = (image, coarse), parts
        if lies:
            images, places = (image.T, coarse.T), [(c, d, a, b) for a, b, c, d in parts]
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            edges = [
                measure_edge(one, pitch, region=place, scale=scale)
                for one, pitch, place, scale in zip(images, (0.5, 1.0), places, (2, 1), strict=True)
            ]
            caught.clear()
            resolution_gain(*edges)
        assert len(caught) == bool(word)
        assert all(word in str(one.message) for one in caught)


def lying(at_px: float, region: Region) -> EdgeResult:
    return replace(edge((17, 33), 0.8), region=region, position_px=Interval(at_px))


def test_edges_are_paired_by_their_place() -> None:
    here, there = lying(12.0, Region(0, 10, 0, 20)), lying(51.5, Region(0, 10, 40, 60))
    # What lies beside an edge is cut off elsewhere in another image.
    fine = [lying(103.6, Region(0, 20, 90, 150)), lying(24.4, Region(0, 20, 2, 40))]
    pairs = pair_edges(fine, [here, there], 2)
    assert [(a.region.col_start, b.region.col_start) for a, b in pairs] == [(2, 0), (90, 40)]
    assert pair_edges([lying(30.0, Region(0, 20, 2, 40))], [here], 2) == []
    spoiled = [replace(fine[0], usable=False), *fine[1:]]
    assert [one.region.col_start for one, _ in pair_edges(spoiled, [here, there], 2)] == [2]
