"""Slopes and widths have closed forms; single profiles scatter as much as they should."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import erf

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.edge_gradient import (
    EdgeGradient,
    Limits,
    Plateaus,
    edge_gradient,
    gradient_ratio,
    profile_edge,
    split_index,
    steps_of,
)

Floats = NDArray[np.float64]
SLANT = np.tan(np.radians(10))


def box_pixels(place: Floats, width: float, edge: float | Floats) -> Floats:
    """Return the share of each pixel that lies behind the edge."""
    return np.clip((place + width / 2 - edge) / width, 0.0, 1.0)


def slanted_box_pixels(lines: int, samples: int, pitch: float, edge: float) -> Floats:
    """Return a 10 degree edge seen by square pixels; each row averages 15 thin lines."""
    place = (np.arange(samples) - (samples - 1) / 2) * pitch
    rows = (np.arange(lines * 15) - (lines * 15 - 1) / 2) / 15 * pitch
    thin = box_pixels(place, pitch, edge + SLANT * rows[:, None])
    return thin.reshape(lines, 15, samples).mean(axis=1)


def single(values: Floats, step_mm: float = 1.0, **settings: object) -> EdgeGradient:
    with pytest.warns(QualityWarning, match="one line profile"):
        return edge_gradient(values, step_mm=step_mm, **settings)  # type: ignore[arg-type]


def test_finely_sampled_ramp() -> None:
    place_mm = np.arange(801) * 0.01
    ramp = 2.0 + 3.0 * box_pixels(place_mm, 0.5, 4.0)
    edge = single(ramp, 0.01).lines[0]
    assert edge.width_mm == pytest.approx(0.8 * 0.5, rel=1e-9)
    assert edge.slope_per_mm == pytest.approx(3.0 / 0.5, rel=1e-9)
    assert edge.normalised_per_mm == pytest.approx(1 / 0.5, rel=1e-9)
    assert (edge.low, edge.high) == pytest.approx((2.0, 5.0))
    assert (edge.low_limit, edge.high_limit) == pytest.approx((2.3, 4.7))
    assert edge.position_mm == pytest.approx(4.0, rel=1e-9)
    assert edge.low_position_mm == pytest.approx(3.8, rel=1e-9)
    assert not edge.falling


@pytest.mark.parametrize(("share", "sigmas"), [(0.1, 2.5631), (0.05, 3.2897)])
def test_width_of_a_gaussian_edge(share: float, sigmas: float) -> None:
    place_mm = np.arange(801) * 0.01
    values = 0.5 * (1 + erf((place_mm - 4.007) / (0.3 * np.sqrt(2))))
    edge = single(values, 0.01, share=share).lines[0]
    assert edge.width_mm == pytest.approx(sigmas * 0.3, rel=2e-4)


@pytest.mark.parametrize("middle", [0.2, 0.37, 0.5, 0.8])
def test_one_pixel_in_the_transition_has_a_closed_form(middle: float) -> None:
    # 0 0 0 m 1 1 1: the crossings lie in the two intervals beside m.
    edge = single(np.array([0, 0, 0, middle, 1, 1, 1])).lines[0]
    assert edge.width_mm == pytest.approx(2 - 0.1 / middle - 0.1 / (1 - middle), rel=1e-9)


def test_single_profiles_cannot_measure_a_factor_of_two() -> None:
    coarse_mm, fine_mm = np.arange(-8, 9.0), np.arange(-16, 17) * 0.5 + 0.25

    def slope(place_mm: Floats, pitch_mm: float, edge_mm: float) -> float:
        pixels = box_pixels(place_mm, pitch_mm, edge_mm)
        return profile_edge(place_mm, pixels, "range", 0.1, "median").normalised_per_mm

    edges_mm = np.linspace(-0.5, 0.5, 801)
    ratio = [slope(fine_mm, 0.5, e) / slope(coarse_mm, 1.0, e) for e in edges_mm]
    expected = [1.3, 1.4, 1.9, 3.8, 4.0]
    assert np.percentile(ratio, [0, 5, 50, 95, 100]) == pytest.approx(expected, abs=0.06)


def test_lines_of_a_slanted_edge_measure_a_factor_of_two() -> None:
    rng = np.random.default_rng(2)
    means, averaged = [], []
    for edge_mm in rng.uniform(-0.5, 0.5, 12):
        fine = edge_gradient(slanted_box_pixels(31, 65, 0.5, edge_mm), step_mm=0.5)
        coarse = edge_gradient(slanted_box_pixels(16, 33, 1.0, edge_mm), step_mm=1.0)
        ratio = gradient_ratio(fine, coarse)
        assert ratio.interval is not None
        assert ratio.interval[0] < 2 < ratio.interval[1]
        means.append(ratio.ratio)
        averaged.append(ratio.averaged)
    assert means == pytest.approx([2.0] * 12, abs=0.2)
    assert averaged == pytest.approx([2.0] * 12, abs=0.12)


def test_average_of_the_lines_is_the_edge_of_one_pixel() -> None:
    # The pixel is 0.8 px wide between 10 and 90 %, also at 10 degrees; four bins a pixel add 7 %.
    gradient = edge_gradient(slanted_box_pixels(63, 33, 1.0, 0.2), step_mm=1.0)
    assert gradient.averaged is not None
    assert gradient.averaged.width_mm == pytest.approx(0.855, abs=0.03)
    # Linear interpolation between the pixels widens every line.
    assert gradient.width_mm.mean() > 1.15


@pytest.mark.parametrize("psf", ["g01", "g03", "g05", "g08"])
def test_width_of_the_reference_edges(reference_dir: Path, psf: str) -> None:
    with np.load(reference_dir / "slanted_edge" / "open" / "edges_64x16.npz") as stored:
        kinds = [json.loads(str(text)) for text in stored["meta"]]
        chosen = [k for k, m in enumerate(kinds) if (m["psf"], m["theta"]) == (psf, 10.0)
                  and m["noise"] <= 0.01]  # fmt: skip
        images = stored["images"][chosen].astype(np.float64)
    # Truth: the Gaussian edge averaged over the pixel, along the normal.
    slant, inside = np.radians(10), (np.arange(101) - 50) / 101
    place_px = np.linspace(-3, 3, 1201)
    pixel_px = np.add.outer(inside * np.cos(slant), inside * np.sin(slant)).ravel()
    bins, edges_px = np.histogram(pixel_px, 200)
    depth_px = place_px[:, None] - (edges_px[1:] + edges_px[:-1]) / 2
    esf = 0.5 * (1 + erf(depth_px / (kinds[chosen[0]]["sigmas"][0] * np.sqrt(2)))) @ bins / 101**2
    true_px = np.interp(0.9, esf, place_px) - np.interp(0.1, esf, place_px)
    for image in images:
        gradient = edge_gradient(image, step_mm=1.0)
        assert gradient.averaged is not None
        assert 0.97 < gradient.averaged.width_mm * np.cos(slant) / true_px < 1.11


def test_interval_covers_the_mean_of_noisy_lines() -> None:
    rng = np.random.default_rng(3)
    values = slanted_box_pixels(31, 25, 1.0, 0.1) + 0.02 * rng.standard_normal((31, 25))
    gradient = edge_gradient(values, step_mm=1.0)
    slopes = gradient.normalised_per_mm
    assert gradient.mean_per_mm == pytest.approx(slopes.mean())
    assert gradient.median_per_mm == pytest.approx(np.median(slopes))
    assert gradient.interval_per_mm is not None
    half = (gradient.interval_per_mm[1] - gradient.interval_per_mm[0]) / 2
    assert half == pytest.approx(1.96 * slopes.std() / np.sqrt(31), rel=0.15)
    assert gradient.slope_per_mm == pytest.approx(slopes, rel=0.1)


@given(
    gain=st.floats(0.01, 100),
    offset=st.floats(-50, 50),
    step_mm=st.floats(0.01, 10),
    edge=st.floats(5.0, 9.0),
)
def test_normalised_slope_knows_neither_gain_nor_offset(
    gain: float, offset: float, step_mm: float, edge: float
) -> None:
    values = box_pixels(np.arange(15.0), 1.0, edge)
    plain = single(values).lines[0]
    other = single(gain * values + offset, step_mm).lines[0]
    assert other.normalised_per_mm * step_mm == pytest.approx(plain.normalised_per_mm, rel=1e-6)
    assert other.slope_per_mm == pytest.approx(other.normalised_per_mm * gain, rel=1e-6)


@given(edge=st.floats(4.0, 10.0))
def test_falling_edge_mirrors_the_rising_one(edge: float) -> None:
    values = box_pixels(np.arange(15.0), 1.0, edge)
    rising, falling = single(values).lines[0], single(values[::-1]).lines[0]
    assert falling.falling
    assert falling.slope_per_mm == pytest.approx(rising.slope_per_mm, rel=1e-9)
    assert falling.position_mm == pytest.approx(14 - rising.position_mm, rel=1e-9)
    assert falling.low_position_mm == pytest.approx(14 - rising.low_position_mm, rel=1e-9)


def test_medians_withstand_overshoot_and_extremes_follow_it() -> None:
    values = np.array([0, 0, 0, 0, 0, -0.15, 0.5, 1.15, 1, 1, 1, 1, 1])
    median = single(values).lines[0]
    extremes = single(values, plateaus="extremes").lines[0]
    assert (median.low, median.high) == (0.0, 1.0)
    assert (extremes.low, extremes.high) == (-0.15, 1.15)
    assert median.slope_per_mm == pytest.approx(0.65, rel=1e-9)
    assert median.normalised_per_mm > extremes.normalised_per_mm


def test_literal_limits_are_those_of_the_words() -> None:
    values = 1.0 + 3.0 * box_pixels(np.arange(13.0), 1.0, 6.2)
    edge = single(values, limits="literal", share=0.05).lines[0]
    assert (edge.low_limit, edge.high_limit) == pytest.approx((1.05, 3.8))


def test_literal_limits_do_not_exist_for_a_small_step() -> None:
    step_m = 3.2 + 0.3 * box_pixels(np.arange(13.0), 1.0, 6.2)
    assert single(step_m, share=0.05).lines[0].high == pytest.approx(3.5)
    message = r"got 3\.36 and 3\.325.*below 0\.905, here it is 0\.914"
    with pytest.raises(ValueError, match=message):
        edge_gradient(step_m, step_mm=1.0, limits="literal", share=0.05)


def test_edges_that_miss_a_limit() -> None:
    negative = -1.0 + 3.0 * box_pixels(np.arange(13.0), 1.0, 6.2)
    with pytest.raises(ValueError, match=r"starts below the low limit -1\.1, got at least -1"):
        edge_gradient(negative, step_mm=1.0, limits="literal")
    with pytest.raises(ValueError, match="reaches the high limit"):
        edge_gradient([1, 1, 1, 6, 1, 1, 5, 5, 5, 5, 5.0], step_mm=1.0, plateaus="extremes")


@pytest.mark.parametrize("levels", [(0.0, 1.0, 0.3), (0.0, 0.5, 1.0), (1.0, 0.0, 0.4)])
def test_two_edges_in_the_region_are_refused(levels: tuple[float, float, float]) -> None:
    first, second = (slanted_box_pixels(12, 48, 1.0, at) for at in (-10.0, 8.0))
    values = levels[0] + np.diff(levels) @ np.stack([first, second]).reshape(2, -1)
    noise = 0.02 * np.random.default_rng(0).standard_normal((12, 48))
    with pytest.raises(
        ValueError, match=r"got several in 12 of 12 lines, as after samples 1\d and"
    ):
        edge_gradient(values.reshape(12, 48) + noise, step_mm=1.0)


@pytest.mark.parametrize("noise", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("width", [1.0, 6.0])
def test_one_edge_is_one_edge(width: float, noise: float) -> None:
    rng = np.random.default_rng(1)
    lines = box_pixels(np.arange(48.0), width, rng.uniform(20, 28, (200, 1)))
    lines += noise * rng.standard_normal(lines.shape)
    assert sum(len(steps_of(line)) > 1 for line in lines) <= 4
    overshot = [0, 0, 0, 0, 0, -0.15, 0.5, 1.4, 1, 1, 1, 1, 1, 0, 1, 1, 1]  # a dead pixel as well
    assert len(steps_of(np.array(overshot, dtype=float))) == 1


def test_unslanted_lines_warn_and_are_not_averaged() -> None:
    values = np.tile(box_pixels(np.arange(13.0), 1.0, 6.2), (9, 1))
    with pytest.warns(QualityWarning, match=r"leaves 1\.00 of a pixel unvisited in 9 lines"):
        gradient = edge_gradient(values, step_mm=1.0)
    assert gradient.averaged is None
    assert gradient_ratio(gradient, gradient).averaged is None


def test_enough_lines_do_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        edge_gradient(slanted_box_pixels(9, 15, 1.0, 0.0), step_mm=1.0)


def test_ratio_of_single_lines_has_no_interval() -> None:
    one = single(box_pixels(np.arange(13.0), 1.0, 6.2))
    ratio = gradient_ratio(one, one)
    assert (ratio.ratio, ratio.interval, ratio.averaged) == (1.0, None, None)


@given(
    seed=st.integers(0, 10_000),
    count=st.integers(4, 30),
    limits=st.sampled_from(["range", "literal"]),
    plateaus=st.sampled_from(["median", "extremes"]),
)
def test_any_profile_gives_an_edge_within_it_or_a_reason(
    seed: int, count: int, limits: Limits, plateaus: Plateaus
) -> None:
    rng = np.random.default_rng(seed)
    values = np.round(rng.standard_normal(count), 1) + rng.choice([0, 3]) * (np.arange(count) > 3)
    try:
        edge = profile_edge(np.arange(float(count)), values, limits, 0.1, plateaus)
    except ValueError as error:
        assert "expected" in str(error)  # noqa: PT017
    else:
        places = [edge.low_position_mm, edge.position_mm, edge.high_position_mm]
        assert sorted(places, reverse=edge.falling) == places
        assert 0 <= min(places) < max(places) <= count - 1
        crossed = np.interp(places, np.arange(count), values)
        middle = (edge.low_limit + edge.high_limit) / 2
        assert crossed == pytest.approx([edge.low_limit, middle, edge.high_limit])


@given(count=st.integers(2, 40), edge=st.integers(1, 39), seed=st.integers(0, 1000))
def test_split_is_the_least_squares_one(count: int, edge: int, seed: int) -> None:
    values = np.random.default_rng(seed).standard_normal(count) + (np.arange(count) >= edge)
    errors = [
        values[:k].var() * k + values[k:].var() * (count - k) for k in range(1, count)
    ]  # brute force
    assert errors[split_index(values) - 1] == pytest.approx(min(errors), abs=1e-9)


GOOD = np.array([0.0, 0, 0, 1, 1, 1])


@pytest.mark.parametrize(
    ("values", "settings", "message"),
    [
        (GOOD[:3], {}, "at least 4 samples, got"),
        (np.zeros((2, 3, 9)), {}, r"got shape \(2, 3, 9\)"),
        (GOOD * 1j, {}, "dtype complex128"),
        (np.where(GOOD > 0, np.nan, 0), {}, "got 3 NaN"),
        (np.ones(9), {}, "line 0: expected an edge, got plateaus of 1 and 1"),
        (np.stack([GOOD, GOOD[::-1]]), {}, "got 1 falling of 2 lines"),
        (GOOD, {"step_mm": 0.0}, "positive step in mm, got 0"),
        (GOOD, {"step_mm": np.nan}, "positive step"),
        (GOOD, {"share": 0.5}, "share above 0 and below 0.5, got 0.5"),
        (GOOD, {"limits": "ISO"}, "'range' or 'literal', got 'ISO'"),
        (GOOD, {"plateaus": "mean"}, "'median' or 'extremes', got 'mean'"),
    ],
)
def test_bad_input(values: Floats, settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        edge_gradient(values, **{"step_mm": 1.0, **settings})  # type: ignore[arg-type]
