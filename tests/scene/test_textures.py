"""Textures: reflectance where geometry says it, and their means and frequencies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.scene import (
    Checker,
    Constant,
    Edge,
    ImageTexture,
    LinePairs,
    SiemensStar,
    ZonePlate,
)

seeds = st.integers(0, 2**32 - 1)


def test_a_constant_is_the_same_everywhere() -> None:
    seen = Constant(0.3)(np.zeros((3, 1)), np.ones(5))
    assert seen.shape == (3, 5)
    np.testing.assert_array_equal(seen, 0.3)


def test_a_chessboard_has_a_dark_square_below_right_of_its_middle() -> None:
    board = Checker(0.2, dark=0.1, bright=0.9)
    x_m = np.array([0.1, -0.1, 0.1, -0.1, 0.3, 0.3])
    y_m = np.array([0.1, 0.1, -0.1, -0.1, 0.1, -0.1])
    np.testing.assert_array_equal(board(x_m, y_m), [0.1, 0.9, 0.9, 0.1, 0.9, 0.1])


@given(st.floats(-3, 3), st.floats(-2, 2))
def test_an_edge_turns_about_the_middle(slant_rad: float, along_m: float) -> None:
    edge = Edge(slant_rad, dark=0.2, bright=0.7)
    # Down along the edge and to its right, perpendicular to it.
    down, right = (np.sin(slant_rad), np.cos(slant_rad)), (np.cos(slant_rad), -np.sin(slant_rad))
    side_m = np.array([-1e-6, 1e-6])
    seen = edge(along_m * down[0] + side_m * right[0], along_m * down[1] + side_m * right[1])
    np.testing.assert_array_equal(seen, [0.2, 0.7])


@pytest.mark.parametrize("binary", [False, True])
def test_a_star_has_its_cycles_on_every_circle(binary: bool) -> None:
    star = SiemensStar(0.5, cycles=9, dark=0.1, bright=0.9, binary=binary)
    angle_rad = 2 * np.pi * (np.arange(3600) + 0.5) / 3600
    for radius_m in (0.01, 0.499):
        ring = star(radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad))
        spectrum = np.abs(np.fft.rfft(ring)) / 1800
        assert spectrum[0] / 2 == pytest.approx(0.5)
        # A square wave of +-0.4 has a fundamental of 4/pi of that and only odd harmonics.
        assert spectrum[9] == pytest.approx(0.4 * (4 / np.pi if binary else 1.0), rel=1e-4)
        assert spectrum[18] == pytest.approx(0.0, abs=1e-12)
        assert spectrum[27] == pytest.approx(0.4 * 4 / np.pi / 3 if binary else 0.0, abs=1e-4)
    assert star(np.array([0.501]), np.array([0.0]))[0] == 0.5
    # The first sector, from the right downwards, is bright.
    assert star(np.array([0.3]), np.array([0.05]))[0] > 0.5


def test_a_zone_plate_has_rings_of_equal_area_and_their_mean() -> None:
    radius_m, finest_m = 0.3, 0.02
    plate = ZonePlate(radius_m, finest_m, dark=0.2, bright=0.8)
    ring_m = np.sqrt(np.arange(30) * radius_m * finest_m)  # phase n pi
    inside = ring_m < radius_m
    np.testing.assert_allclose(
        plate(ring_m * 0.6, ring_m * 0.8)[inside], np.where(np.arange(30) % 2, 0.2, 0.8)[inside]
    )
    # Over the disc: 0.5 + 0.3 sin(k)/k, k = pi radius / finest; for a disc of another radius too.
    for disc_m in (0.3, 0.041):
        k = np.pi * disc_m**2 / (radius_m * finest_m)
        at_m = disc_m * np.sqrt((np.arange(20_000) + 0.5) / 20_000)  # equal areas
        mean = plate(at_m, np.zeros_like(at_m)).mean()
        assert mean == pytest.approx(0.5 + 0.3 * np.sin(k) / k, abs=1e-6)
    assert plate(np.array([0.31]), np.array([0.0]))[0] == pytest.approx(0.5)


def test_the_last_ring_of_a_zone_plate_has_the_finest_period() -> None:
    plate = ZonePlate(0.3, 0.01)
    at_m = np.linspace(0.25, 0.2999, 200_001)
    seen = plate(at_m, np.zeros_like(at_m))
    peaks_m = at_m[1:-1][(seen[1:-1] > seen[:-2]) & (seen[1:-1] >= seen[2:])]
    middle_m = 0.5 * (peaks_m[1:] + peaks_m[:-1])
    np.testing.assert_allclose(np.diff(peaks_m), 0.01 * 0.3 / middle_m, rtol=1e-3)


def test_line_pairs_have_their_periods_from_top_to_bottom() -> None:
    lines = LinePairs((0.4, 0.25, 0.1), size_m=1.2, dark=0.0, bright=1.0)
    x_m = np.linspace(-0.7, 0.7, 14_001)[:-1] + 5e-5
    for y_m, period_m in ((-0.5, 0.4), (0.0, 0.25), (0.5, 0.1)):
        band = lines(x_m, np.full_like(x_m, y_m))
        inside = band != 0.5
        whole_m = np.floor(1.2 / period_m + 1e-9) * period_m
        np.testing.assert_allclose(x_m[inside][[0, -1]], (-0.6, -0.6 + whole_m), atol=1e-4)
        assert np.count_nonzero(np.diff(band[inside])) == round(2 * whole_m / period_m) - 1
        assert band[inside].mean() == pytest.approx(0.5, abs=1e-3)
        assert band[inside][0] == 1.0
    np.testing.assert_array_equal(lines(np.zeros(2), np.array([-0.61, 0.61])), 0.5)


@given(seeds)
def test_a_picture_is_itself_at_the_centres_of_its_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = rng.uniform(size=(5, 8))
    picture = ImageTexture(image, (1.6, 0.5))  # pixels of 0.2 x 0.1 m
    x_m, y_m = np.meshgrid(-0.7 + 0.2 * np.arange(8), -0.2 + 0.1 * np.arange(5))
    np.testing.assert_allclose(picture(x_m, y_m), image, atol=1e-12)
    between = picture(x_m[:-1, :-1] + 0.1, y_m[:-1, :-1] + 0.05)
    corners = image[:-1, :-1] + image[1:, :-1] + image[:-1, 1:] + image[1:, 1:]
    np.testing.assert_allclose(between, corners / 4, atol=1e-12)
    np.testing.assert_allclose(picture(np.array([-9.0, 9]), np.array([9, -9.0])),
                               [image[-1, 0], image[0, -1]])  # fmt: skip


def test_a_picture_of_a_ramp_is_the_ramp() -> None:
    row, col = np.mgrid[:6, :4]
    picture = ImageTexture((row + 2 * col) / 20, (4.0, 6.0))
    x_m, y_m = np.random.default_rng(0).uniform(-1, 1, (2, 100)) * [[1.5], [2.5]]
    np.testing.assert_allclose(picture(x_m, y_m), (y_m + 2.5 + 2 * (x_m + 1.5)) / 20)
    one = ImageTexture([[0.4]], (1.0, 1.0))
    np.testing.assert_allclose(one(np.array([-2.0, 0.0, 0.3]), np.zeros(3)), 0.4)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: Constant(-0.1), ValueError, "reflectance from 0 to 1"),
        (lambda: Constant(True), TypeError, "number for reflectance"),
        (lambda: Checker(0.0), ValueError, "positive size_m"),
        (lambda: Checker(0.1, dark=2), ValueError, "dark from 0 to 1"),
        (lambda: Edge(np.nan), ValueError, "finite slant_rad"),
        (lambda: Edge(0.1, bright="white"), TypeError, "number for bright"),
        (lambda: SiemensStar(-1.0), ValueError, "positive radius_m"),
        (lambda: SiemensStar(1.0, cycles=2.5), ValueError, "whole number of cycles"),
        (lambda: SiemensStar(1.0, cycles=0), ValueError, "positive cycles"),
        (lambda: SiemensStar(1.0, binary=1), TypeError, "true or false for binary"),
        (lambda: ZonePlate(1.0, 0.0), ValueError, "positive finest_period_m"),
        (lambda: LinePairs((), 1.0), ValueError, "period_m"),
        (lambda: LinePairs((0.1, 2.0), 1.0), ValueError, "up to size_m 1"),
        (lambda: LinePairs((0.1, -0.1), 1.0), ValueError, "positive each of period_m"),
        (lambda: LinePairs(0.1, 1.0), TypeError, "finite numbers for period_m"),
        (lambda: ImageTexture([0.1, 0.2], (1, 1)), ValueError, r"\[row col\] for image"),
        (lambda: ImageTexture([["a"]], (1, 1)), ValueError, "table of numbers for image"),
        (lambda: ImageTexture([[0.1, 1.2]], (1, 1)), ValueError, "got 0.1 to 1.2"),
        (lambda: ImageTexture([[0.1]], (1, 0)), ValueError, "positive each of size_m"),
    ],
)
def test_textures_say_what_they_expect(make, error, message: str) -> None:
    with pytest.raises(error, match=message):
        make()
