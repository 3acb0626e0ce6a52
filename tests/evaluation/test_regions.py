"""Slanted edges found on charts and photographs, and what is none."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge import find_regions, measure_edges

CHARTS = runpy.run_path(str(Path(__file__).resolve().parents[2] / "examples" / "charts.py"))


@pytest.mark.parametrize(("name", "shape"), [("board", (650, 851)), ("star_chart", (1101, 1600))])
def test_edges_of_charts(name: str, shape: tuple[int, int]) -> None:
    found = there = false = 0
    for seed in (101, 102):
        counts = CHARTS["score"](CHARTS[name](seed, shape))
        found, there, false = found + counts[0], there + counts[1], false + counts[2]
    assert found >= 0.95 * there
    assert false < 0.05 * there


def seen(radiance: NDArray[np.float64], noise: float = 1.0) -> NDArray[np.float64]:
    rng = np.random.default_rng(3)
    return gaussian_filter(radiance, 0.7) + noise * rng.standard_normal(radiance.shape)


def slanted(shape: tuple[int, int], slope: float, place: float) -> NDArray[np.float64]:
    row, col = np.indices(shape)
    return col - place - slope * (row - shape[0] / 2)


def test_what_is_no_slanted_edge() -> None:
    shape = (121, 173)
    line = np.where(np.abs(slanted(shape, 0.09, 80.0)) < 1.5, 30.0, 200.0)
    bar = np.where(np.abs(slanted(shape, 0.09, 80.0)) < 4.0, 30.0, 200.0)
    upright = np.where(slanted(shape, 0.0, 80.0) > 0, 30.0, 200.0)
    upright[:70] = 90.0
    steep = np.where(slanted(shape, 1.0, 80.0) > 0, 30.0, 200.0)
    steep[:70] = 90.0
    fine = np.where(np.sin(slanted(shape, 0.09, 80.0)) > 0, 30.0, 200.0)
    for none in (line, bar, upright, steep, fine, np.full(shape, 90.0)):
        with pytest.raises(ValueError, match="no slanted edge"):
            find_regions(seen(none))


def test_a_faint_edge_is_found_beside_a_strong_frame() -> None:
    image = np.where(slanted((140, 200), 0.1, 90.0) > 0, 120.0, 100.0)
    image[:12], image[-12:], image[:, :12], image[:, -12:] = 0.0, 0.0, 255.0, 0.0
    [region] = find_regions(seen(image))
    assert region.row_stop - region.row_start > 60
    assert region.col_start < 80
    assert region.col_stop > 100


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_integers_are_numbers(kind: type) -> None:
    image = np.round(seen(np.where(slanted((140, 200), 0.1, 90.0) > 0, 120.0, 80.0)))
    assert find_regions(image.astype(kind)) == find_regions(image)


@pytest.mark.parametrize("value", [-40.0, 2000.0])
def test_hot_and_dead_pixels_do_not_hide_an_edge(value: float) -> None:
    image = np.where(slanted((140, 200), 0.1, 90.0) > 0, 120.0, 80.0)
    image[:, 150:] = 30.0
    picture = seen(image)
    picture[np.random.default_rng(4).random(picture.shape) < 0.003] = value
    [region] = find_regions(picture)
    assert region.row_stop - region.row_start > 120
    assert region.col_start < 75
    assert region.col_stop > 105


@pytest.mark.parametrize("angle_deg", [6.0, 12.0, 30.0])
def test_noise_beside_faint_edges_is_nothing_else(angle_deg: float) -> None:
    """With noise of a tenth of their contrast, half of the sides of squares were called cramped."""
    row, col = np.indices((320, 320)) % 160 - 79.7
    turn = np.deg2rad(angle_deg)
    u, v = col * np.cos(turn) + row * np.sin(turn), row * np.cos(turn) - col * np.sin(turn)
    squares = np.where(np.maximum(np.abs(u), np.abs(v)) < 35.0, 90.0, 100.0)
    assert len(find_regions(seen(squares))) == 16


@pytest.mark.parametrize("blur_px", [1.0, 1.4])
@pytest.mark.parametrize("radius_px", [40.0, 48.0])
def test_sides_of_wedges_are_found(radius_px: float, blur_px: float) -> None:
    """The other side of a wedge was taken for the flank of the first, of stars that are small."""
    row, col = np.indices((320, 320)) % 160 - 79.7
    sector = (np.arctan2(row, col) - np.deg2rad(6.0)) % (0.5 * np.pi) < 0.25 * np.pi
    star = np.where(sector & (np.hypot(row, col) < radius_px), 40.0, 200.0)
    noise = np.random.default_rng(5).standard_normal(star.shape)
    # Eight sides of each: four of six degrees, four of 39.
    assert len(find_regions(gaussian_filter(star, blur_px) + noise)) == 4 * 8


def card(seed: int, ground: float, ghost: float = 0.0) -> NDArray[np.float64]:
    """Return a slanted edge in the middle of 51 x 90 px, what is beside it 18 px away, and noise.

    An upright step to the ground beside the dark, another one beside the bright; a ghost lies along
    the edge.
    """
    rng, row_px = np.random.default_rng(seed), np.arange(51)[:, None] - 25
    away_px = np.arange(90) - 45 - 0.12 * row_px
    image = ndtr(away_px / 0.6) + ghost * ndtr((away_px + 18) / 0.6)
    image = (
        image - ground * ndtr((24 - np.arange(90)) / 0.6) - 1.2 * ndtr((np.arange(90) - 72) / 0.6)
    )
    return image + rng.normal(0, 0.008, image.shape)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("ground", [0.0, 0.05, 0.15])
def test_faint_borders_far_beside_an_edge_are_left_out(ground: float, turned: bool) -> None:
    # Of a Gaussian of 0.6 px across columns, along the normal.
    truth = np.sqrt(np.log(2.0) / 2.0) / (np.pi * 0.6 * np.cos(np.arctan(0.12)))
    for seed in range(3):
        image = card(seed, ground)
        [edge] = measure_edges(image.T if turned else image)
        start = edge.region.row_start if turned else edge.region.col_start
        assert (start > 24) == (ground > 0.0)
        assert edge.mtf50_lpmm.value == pytest.approx(truth, rel=0.02)


def test_a_ghost_far_beside_an_edge_is_its_own() -> None:
    [edge] = measure_edges(card(0, 0.0, ghost=0.03))
    assert edge.region.col_start < 24
