"""Light from levels: closed forms, and a mosaic whose truth is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.levels import CHANNELS, bayer_frames, linear_light, one_channel
from lensshift.evaluation.slanted_edge import measure_edge


@given(st.floats(0.3, 3.5))
def test_a_gamma_is_undone(gamma: float) -> None:
    light = np.linspace(0.0, 1.0, 21).reshape(3, 7)
    np.testing.assert_allclose(linear_light(light ** (1.0 / gamma), gamma), light, atol=1e-12)
    whole = np.rint(65535 * light ** (1.0 / gamma)).astype(np.uint16)
    # Half a level of rounding is much light where the curve is steep.
    rounded = (np.abs((whole + half) / 65535) ** gamma for half in (-0.5, 0.5))
    wide = np.maximum(*(np.abs(edge - light) for edge in rounded)) + 1e-9
    assert np.all(np.abs(linear_light(whole, gamma) / 65535 - light) <= wide)


def test_a_measured_curve_is_undone_between_its_points() -> None:
    level = np.linspace(0.0, 255.0, 18)
    table = np.column_stack([level, level**2 + level])
    np.testing.assert_allclose(linear_light(level, table), table[:, 1])
    assert linear_light(7.5, table) == pytest.approx(0.5 * table[1, 1])  # straight between two
    assert linear_light(np.array([3, 4])).dtype == float


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        (0.0, "positive gamma"),
        (float("nan"), "positive gamma"),
        ([1.0, 2.0], "expected an OECF"),
        ([[0.0, 0.0], [1.0, -1.0]], "rising"),
        ([[0.0, 0.0], [3.0, 1.0]], "knows levels from 0 to 3"),
        ([[0.0, -2.0], [9.0, 0.0]], "log10 of the exposure"),
    ],
)
def test_curves_that_are_none(curve: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        linear_light(np.array([[1.0, 5.0]]), curve)  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [1.0 / 255.0, 1.0, 257.0])
@pytest.mark.parametrize("of_table", [1.0 / 255.0, 1.0, 257.0])
def test_a_table_in_another_unit_than_the_image_is_told(scale: float, of_table: float) -> None:
    """Of a 16 bit table an 8 bit picture took the first 256 levels: MTF50 3.4 % low, no word."""
    level = np.arange(256.0)
    table = np.column_stack([of_table * level, (level / 255.0) ** 2.2])
    kind = {1.0: np.uint8, 257.0: np.uint16}.get(scale, float)
    image = (scale * np.array([[60.0, 230.0]])).astype(kind)
    if scale > of_table:
        with pytest.raises(ValueError, match="knows levels from 0"):
            linear_light(image, table)
    elif scale < of_table:
        with pytest.warns(QualityWarning, match="are they in one unit"):
            linear_light(image, table)
    else:
        light = linear_light(image, table)
        np.testing.assert_allclose(light, (np.array([[60.0, 230.0]]) / 255.0) ** 2.2)


def test_channels_of_a_photograph() -> None:
    rgb = np.random.default_rng(0).random((3, 5, 3))
    for k, name in enumerate(CHANNELS[1:]):
        np.testing.assert_array_equal(one_channel(rgb, name), rgb[..., k])
    grey = np.broadcast_to(rgb[..., :1], rgb.shape)
    np.testing.assert_allclose(one_channel(grey), grey[..., 0])  # the shares sum to 1
    np.testing.assert_array_equal(one_channel(rgb[..., 0]), rgb[..., 0])
    with pytest.raises(ValueError, match="this one is grey"):
        one_channel(rgb[..., 0], "red")
    with pytest.raises(ValueError, match="expected a channel"):
        one_channel(rgb, "violet")


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_a_mosaic_comes_apart_without_interpolation(pattern: str) -> None:
    """Content that is linear in its place tells where each pixel of a frame looks."""
    row, col = np.mgrid[:5, :9].astype(float)
    colours = np.array([pattern.index(one) if one != "G" else -1 for one in "RGB"])
    for k, name in ((0, "red"), (2, "blue")):
        frames, offset_px = bayer_frames(10.0 * row + col, pattern, name)
        assert frames.shape == (1, 2, 4)
        assert frames[0, 0, 0] == 10.0 * (colours[k] // 2) + colours[k] % 2
        np.testing.assert_array_equal(offset_px, [[0.0, 0.0]])
    frames, offset_px = bayer_frames(10.0 * row + col, pattern, "green")
    # A pixel of the second frame sees what lies 2 * offset before that of the first.
    moved = frames[1, 0, 0] - frames[0, 0, 0]
    assert moved == pytest.approx(-2.0 * (10.0 * offset_px[1, 0] + offset_px[1, 1]))


def test_an_edge_of_a_mosaic_has_the_mtf_of_the_lens() -> None:
    """The colours have levels of their own; the pixels of one see the same edge, twice as far."""
    row, col = np.mgrid[:90, :81].astype(float)
    normal = (col - 40.3) * np.cos(0.1) + (row - 44.5) * np.sin(0.1)
    noise = np.random.default_rng(3).normal(0.0, 0.003, normal.shape)
    light = 0.2 + 0.6 * ndtr(normal / 0.55) + noise
    whole = measure_edge(light).mtf50_lpmm
    mosaic = light * np.tile([[0.5, 1.0], [1.0, 0.3]], (45, 41))[:, :81]
    frames, offset_px = bayer_frames(mosaic, "RGGB", "green")
    green = measure_edge(frames, 2.0, offset_px=offset_px).mtf50_lpmm
    assert green.value == pytest.approx(whole.value, rel=0.02)
    red, _ = bayer_frames(mosaic, "RGGB", "red")
    assert measure_edge(red[0], 2.0).mtf50_lpmm.value == pytest.approx(whole.value, rel=0.03)


@pytest.mark.parametrize(
    ("shape", "pattern", "channel", "message"),
    [
        ((4, 4), "RGBG", "green", "expected a pattern"),
        ((4, 4), "RGGB", "luminance", "expected red, green or blue"),
        ((4, 4, 3), "RGGB", "green", "expected a mosaic"),
    ],
)
def test_mosaics_that_are_none(
    shape: tuple[int, ...], pattern: str, channel: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        bayer_frames(np.zeros(shape), pattern, channel)
