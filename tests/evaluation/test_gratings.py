"""Groups of bars behind a Gaussian blur and square pixels: contrast, place, direction."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr
from seen_patterns import seen

from lensshift.core.errors import QualityWarning
from lensshift.evaluation import edge_and_pattern, gratings_mtf
from lensshift.evaluation.slanted_edge import measure_edge

Image = NDArray[np.float64]
SHAPE, SIGMA_PX = (71, 131), 0.7
LOW, HIGH = 0.1, 0.9
FREQUENCIES = (0.08, 0.14, 0.22, 0.31)
TURN = np.deg2rad(3.0)
BOXES = ((4, 30, 4, 60), (4, 30, 70, 126), (40, 66, 4, 60), (40, 66, 70, 126))


def truth(f: float, turn: float = TURN) -> float:
    pixel = np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))
    return float(np.exp(-2.0 * (np.pi * SIGMA_PX * f) ** 2) * pixel)


def groups(noise: float = 0.0, turn: float = TURN, seed: int = 1) -> Image:
    """Return four groups of square bars on white."""

    def bars(row: Image, col: Image) -> Image:
        drawn = np.full((row.size, col.size), HIGH)
        for f, (top, bottom, left, right) in zip(FREQUENCIES, BOXES, strict=True):
            phase = 2 * np.pi * f * (col * np.cos(turn) + row * np.sin(turn)) + 0.4
            wave = np.where(np.cos(phase) > 0, HIGH, LOW)
            inside = np.abs(row - 0.5 * (top + bottom - 1)) < 0.5 * (bottom - top)
            inside = inside & (np.abs(col - 0.5 * (left + right - 1)) < 0.5 * (right - left))
            drawn = np.where(inside, wave, drawn)
        return drawn

    rng = np.random.default_rng(seed)
    pixels = seen(bars, SHAPE, (0.0, 0.0), SIGMA_PX, finer=10)
    return pixels + noise * rng.standard_normal(SHAPE)


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("turn", [0.0, TURN])
def test_bars_show_the_closed_form(given: bool, turn: float) -> None:
    inner = [(r + 5, s - 5, c + 5, d - 5) for r, s, c, d in BOXES]
    found = gratings_mtf(
        groups(0.002, turn), FREQUENCIES, pitch_mm=1.0, regions=inner if given else None,
        levels=(LOW, HIGH),
    )  # fmt: skip
    expected = [truth(f, turn) for f in FREQUENCIES]
    np.testing.assert_allclose(found.mtf.modulation, expected, atol=0.015 if given else 0.03)
    np.testing.assert_allclose(np.mod(found.angle_rad + 1.0, np.pi) - 1.0, turn, atol=0.01)
    np.testing.assert_allclose(found.found_lpmm, FREQUENCIES, rtol=0.02)
    for box, whole in zip(found.regions, BOXES, strict=True):
        middle = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
        assert whole[0] < middle[0] < whole[1]
        assert whole[2] < middle[1] < whole[3]


def test_upright_bars_and_millimetres() -> None:
    image = groups(0.002, 0.0).T.copy()
    found = gratings_mtf(image, [10.0 * f for f in FREQUENCIES], pitch_mm=0.1, levels=(LOW, HIGH))
    np.testing.assert_allclose(np.abs(found.angle_rad), np.pi / 2, atol=0.01)
    np.testing.assert_allclose(
        found.mtf.modulation, [truth(f, 0.0) for f in FREQUENCIES], atol=0.03
    )


def test_an_extrapolated_contrast_says_how_far_it_may_be_off() -> None:
    image = groups(0.002)
    given = gratings_mtf(image, FREQUENCIES, pitch_mm=1.0, levels=(LOW, HIGH))
    found = gratings_mtf(image, FREQUENCIES, pitch_mm=1.0)
    assert given.contrast_std == 0.0
    assert found.contrast_std > 0.01
    assert abs(found.contrast - given.contrast) < 3.0 * found.contrast_std


@pytest.mark.parametrize(
    ("sigma_px", "verdict"),
    [(SIGMA_PX, "agree"), (0.35, "edge flatters"), (1.2, "pattern flatters")],
)
def test_bars_judge_the_edge_beside_them(sigma_px: float, verdict: str) -> None:
    row, col = np.indices((48, 61))
    normal = (col - 30.2) * np.cos(0.1) + (row - 24) * np.sin(0.1)
    rng = np.random.default_rng(3)
    edge = 0.1 + 0.8 * ndtr(normal / np.hypot(sigma_px, 12**-0.5))
    curve = measure_edge(edge + 0.005 * rng.standard_normal(row.shape)).mtf
    bars = gratings_mtf(groups(0.005), FREQUENCIES, pitch_mm=1.0, levels=(LOW, HIGH)).mtf
    assert edge_and_pattern(curve, bars).verdict == verdict


@pytest.mark.parametrize(
    ("frequencies", "options", "message"),
    [
        ((0.1, 0.2), {}, "expected levels, or 3 groups"),
        ((0.1, 0.6), {"levels": (LOW, HIGH)}, "below 0.5"),
        ((0.1, 0.1), {"levels": (LOW, HIGH)}, "frequencies apart"),
        ((0.1,), {"levels": (LOW, HIGH), "regions": [(0, 99, 0, 9)]}, "a region within"),
        ((0.02,), {"levels": (LOW, HIGH), "regions": [(0, 20, 0, 20)]}, "2 cycles"),
        ((0.1,), {"levels": (LOW, HIGH), "profile": "saw"}, "sine or square"),
    ],
)
def test_what_does_not_fit_is_refused(
    frequencies: tuple[float, ...], options: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        gratings_mtf(groups(), frequencies, pitch_mm=1.0, **options)  # type: ignore[arg-type]


def test_the_region_of_another_group_is_refused() -> None:
    regions = [(r + 4, s - 4, c + 4, d - 4) for r, s, c, d in (*BOXES[1:], BOXES[0])]
    with pytest.raises(ValueError, match="the region of another group"):
        gratings_mtf(groups(), FREQUENCIES, pitch_mm=1.0, regions=regions, levels=(LOW, HIGH))


@pytest.mark.parametrize("upright", [True, False])
def test_what_coarser_pixels_make_of_bars_is_named(upright: bool) -> None:
    """It was said to be the region of another group; bars beyond it were measured or refused."""
    lr_px, told = 2, 0.5 * 0.588
    place = (np.arange(60 * 60) + 0.5) / 60
    bars = np.where(np.cos(2 * np.pi * told * place) > 0, HIGH, LOW).reshape(60 // lr_px, -1)
    lines = np.interp(np.arange(60), lr_px * np.arange(30) + 0.5, bars.mean(axis=1))
    picture = np.tile(lines, (40, 1)) if upright else np.tile(lines[:, None], (1, 40))
    with pytest.warns(QualityWarning, match=r"not resolved: the lines there, of about 0\.2"):
        found = gratings_mtf(
            picture, [told], pitch_mm=1.0, levels=(LOW, HIGH), lr_pitch_mm=lr_px,
            regions=[(2, 38, 2, 58) if upright else (2, 58, 2, 38)],
        )  # fmt: skip
    assert found.mtf.modulation[0] < 0.25
    with pytest.raises(ValueError, match="the region of another group"):
        gratings_mtf(
            picture, [told], pitch_mm=1.0, levels=(LOW, HIGH), lr_pitch_mm=3.0,
            regions=[(2, 38, 2, 58) if upright else (2, 58, 2, 38)],
        )  # fmt: skip


@pytest.mark.parametrize("level", [1.0, 1.0 / 3.0, 0.1])
def test_a_flat_picture_holds_no_bars(level: float) -> None:
    with pytest.raises(ValueError, match="found no bars"):
        gratings_mtf(np.full(SHAPE, level), [0.1], pitch_mm=1.0, levels=(LOW, HIGH))


def test_bars_that_are_not_there_are_not_measured_at_the_ends_of_others() -> None:
    """They were: with a modulation of a few per cent, by which all other groups were divided."""
    with pytest.raises(ValueError, match="at one place"):
        gratings_mtf(groups(0.002, 0.0), (0.08, 0.095, 0.31), pitch_mm=1.0)


def test_a_group_that_is_too_short_to_be_found_asks_for_its_region() -> None:
    noise = np.random.default_rng(5).normal(0.5, 0.1, SHAPE)
    with pytest.raises(ValueError, match=r"found no bars of 0\.08 .* give their region"):
        gratings_mtf(noise, (0.08,), pitch_mm=1.0, levels=(LOW, HIGH))
