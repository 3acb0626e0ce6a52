"""Figures of edges show the numbers of the result, at the pixels they were measured at."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn import axes_titled, bands, line_labelled
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image
from sights import card

from lensshift.core.optical import MtfCurve
from lensshift.evaluation.gain import resolution_gain
from lensshift.evaluation.limits import diffraction_mtf
from lensshift.evaluation.slanted_edge import EdgeResult, Region, measure_edge, measure_edges
from lensshift.report.edges import edge_figure, edge_line_px, gain_figure
from lensshift.report.save import save_figure
from lensshift.report.style import COLOURS

PITCH_MM = 0.155
CURVES, PROFILES, PLACES = "MTF along", "edge spread", "region"
RESIDUALS = "pixels minus"


@pytest.fixture(scope="module")
def image() -> NDArray[np.float64]:
    return card((17, 62), np.deg2rad(7.0), 29.3)


@pytest.fixture(scope="module")
def result(image: NDArray[np.float64]) -> EdgeResult:
    return measure_edge(image, PITCH_MM, region=(1, 16, 9, 51))


def published(image: NDArray[np.float64]) -> EdgeResult:
    return measure_edge(image, PITCH_MM, method="sfrmat3")


def elsewhere(result: EdgeResult, row: int, col: int) -> EdgeResult:
    """Return the same edge further down and right."""
    place = result.region
    moved = Region(
        place.row_start + row, place.row_stop + row, place.col_start + col, place.col_stop + col
    )
    position = replace(result.position_px, value=result.position_px.value + col)
    return replace(result, region=moved, position_px=position)


def test_curve_band_and_mtf50_are_those_of_the_result(result: EdgeResult) -> None:
    axes = axes_titled(edge_figure([result]), CURVES)
    frequency, modulation = line_labelled(axes, "edge, MTF50")
    np.testing.assert_array_equal(frequency, result.mtf.frequency_lpmm)
    np.testing.assert_array_equal(modulation, result.mtf.modulation)
    (band,) = bands(axes)
    corners = band.get_paths()[0].vertices
    assert result.low is not None
    assert result.high is not None
    at = 40
    here = corners[np.isclose(corners[:, 0], frequency[at]), 1]
    assert set(np.round(here, 9)) == {round(result.low[at], 9), round(result.high[at], 9)}
    dots = [line for line in axes.get_lines() if line.get_marker() == "o"]
    assert [line.get_xydata().tolist() for line in dots] == [[[result.mtf50_lpmm.value, 0.5]]]


def test_limits_are_those_of_the_pixel_along_the_normal(result: EdgeResult) -> None:
    axes = axes_titled(edge_figure([result]), CURVES)
    angle_rad = result.angle_rad.value
    for label, side_mm in (("|sinc| of pixel", PITCH_MM), ("|sinc| of half", PITCH_MM / 2)):
        frequency, modulation = line_labelled(axes, label)
        across = np.sinc(frequency * side_mm * np.cos(angle_rad))
        along = np.sinc(frequency * side_mm * np.sin(angle_rad))
        np.testing.assert_allclose(modulation, np.abs(across * along), atol=1e-12)
    uprights = [line.get_xdata()[0] for line in axes.get_lines() if len(set(line.get_xdata())) == 1]
    assert 0.5 / PITCH_MM in uprights  # LR Nyquist


def test_the_limits_of_a_horizontal_edge_on_oblong_pixels(image: NDArray[np.float64]) -> None:
    sides_mm = (0.2, 0.1)  # (row, col)
    lying = measure_edge(image.T, sides_mm)
    assert lying.orientation == "horizontal"
    axes = axes_titled(edge_figure([lying], pitch_mm=sides_mm), CURVES)
    frequency, modulation = line_labelled(axes, "|sinc| of pixel")
    row = np.sinc(frequency * sides_mm[0] * np.cos(lying.angle_rad.value))
    col = np.sinc(frequency * sides_mm[1] * np.sin(lying.angle_rad.value))
    np.testing.assert_allclose(modulation, np.abs(row * col), atol=1e-12)


def test_another_unit_stretches_every_frequency(result: EdgeResult) -> None:
    factor = 0.0427
    plain = axes_titled(edge_figure([result]), CURVES)
    other = axes_titled(edge_figure([result], unit="cycles/mrad", factor=factor), CURVES)
    assert other.get_xlabel() == "spatial frequency (cycles/mrad)"
    assert other.get_xlim()[1] == pytest.approx(factor * plain.get_xlim()[1])
    for before, after in zip(plain.get_lines(), other.get_lines(), strict=True):
        if before.get_label() == "_child0" or set(before.get_xdata()) == {0.0, 1.0}:
            continue  # lines across the axes
        np.testing.assert_allclose(after.get_xdata(), factor * np.asarray(before.get_xdata()))


def test_the_region_is_drawn_at_the_borders_of_its_pixels(
    result: EdgeResult, image: NDArray[np.float64]
) -> None:
    axes = axes_titled(edge_figure([result], image), PLACES)
    (frame,) = (one for one in axes.patches if isinstance(one, Rectangle))
    assert frame.get_bbox().bounds == (8.5, 0.5, 42, 15)
    assert axes.get_xlim() == (-0.5, 61.5)
    assert axes.get_ylim() == (16.5, -0.5)


@pytest.mark.parametrize("turned", [False, True], ids=["vertical", "horizontal"])
def test_the_edge_is_drawn_where_it_is(image: NDArray[np.float64], turned: bool) -> None:
    found = measure_edge(image.T if turned else image, PITCH_MM, region=None)
    along, across = edge_line_px(found)[:: -1 if turned else 1]
    assert along.tolist() == [-0.5, 16.5]
    expected = 29.3 - np.tan(np.deg2rad(7.0)) * (along - 8.0)
    np.testing.assert_allclose(across, expected, atol=0.05)


def test_residuals_are_in_standard_deviations_and_at_their_place(result: EdgeResult) -> None:
    (shown,) = axes_titled(edge_figure([result]), RESIDUALS).images
    assert result.residual is not None
    values = np.ma.filled(shown.get_array(), np.nan)
    np.testing.assert_allclose(values, result.residual / result.noise)
    assert 0.5 < np.nanstd(values) < 2.0
    assert shown.get_extent() == [8.5, 50.5, 15.5, 0.5]
    assert shown.get_clim() == (-4.0, 4.0)


def test_the_words_beside_a_scale_are_not_cut_off(tmp_path: Path) -> None:
    image = card((32, 128), np.deg2rad(10.0), 63.3)
    result = measure_edge(image, PITCH_MM, region=(3, 29, 37, 91))
    save_figure(edge_figure([result], image), tmp_path / "edge.png")
    with Image.open(tmp_path / "edge.png") as shown:
        border = np.asarray(shown.convert("L"))[:, -3:]
    assert border.min() == 255


def test_residuals_of_several_edges_share_one_map(result: EdgeResult) -> None:
    far = elsewhere(result, 40, 90)
    (shown,) = axes_titled(edge_figure([result, far]), RESIDUALS).images
    values = np.ma.filled(shown.get_array(), np.nan)
    assert values.shape == (55, 132)
    np.testing.assert_array_equal(values[:15, :42], values[40:, 90:])
    assert np.isnan(values[20:38]).all()


def test_every_edge_has_its_colour_and_number(result: EdgeResult) -> None:
    edges = [result, elsewhere(result, 20, 5), elsewhere(result, 40, 9)]
    figure = edge_figure(edges, np.zeros((60, 80)))
    curves, places = axes_titled(figure, CURVES), axes_titled(figure, PLACES)
    named = [line for line in curves.get_lines() if str(line.get_label()).startswith("edge")]
    assert [str(line.get_label())[:6] for line in named] == ["edge 1", "edge 2", "edge 3"]
    frames = [one for one in places.patches if isinstance(one, Rectangle)]
    for number in range(3):
        colours = {named[number].get_color(), to_hex(frames[number].get_edgecolor(), False).upper()}
        assert colours == {COLOURS[number]}
    assert [text.get_text() for text in places.texts] == ["1", "2", "3"]
    assert len(bands(curves)) == 3


def test_without_uncertainty_there_is_no_band(image: NDArray[np.float64]) -> None:
    figure = edge_figure([published(image)], image)
    axes = axes_titled(figure, CURVES)
    assert bands(axes) == []
    assert "95" not in axes.get_legend().get_title().get_text()
    assert bands(axes_titled(figure, PROFILES)) == []
    assert not any(one.get_title("left").startswith(RESIDUALS) for one in figure.axes)


def test_a_curve_that_never_falls_to_a_half_is_drawn_without_mark(result: EdgeResult) -> None:
    nan = float("nan")
    high = replace(result, mtf50_lpmm=replace(result.mtf50_lpmm, value=nan, low=nan, high=nan))
    axes = axes_titled(edge_figure([high]), CURVES)
    assert "not reached" in axes.get_legend().get_texts()[0].get_text()
    assert not any(line.get_marker() == "o" for line in axes.get_lines())


def test_further_limits_are_drawn_with_their_names(result: EdgeResult) -> None:
    frequency = np.linspace(0.0, 600.0, 5000)
    limit = MtfCurve(frequency, diffraction_mtf(frequency, 850.0, 2.17), label="diffraction limit")
    axes = axes_titled(edge_figure([result], limits=[limit]), CURVES)
    shown, modulation = line_labelled(axes, "diffraction")
    assert shown[-1] <= axes.get_xlim()[1] < 7.0
    np.testing.assert_array_equal(modulation, limit.modulation[: shown.size])


def test_the_gain_is_drawn_with_both_curves_and_their_ratio(
    result: EdgeResult, image: NDArray[np.float64]
) -> None:
    coarse = result
    fine = measure_edge(card((34, 124), np.deg2rad(7.0), 59.1), PITCH_MM / 2, scale=2)
    gain = resolution_gain(fine, coarse)
    figure = gain_figure(fine, coarse, gain, names=("SR", "frame"))
    axes = axes_titled(figure, CURVES)
    for name, one in (("SR", fine), ("frame", coarse)):
        frequency, modulation = line_labelled(axes, name)
        np.testing.assert_array_equal(frequency, one.mtf.frequency_lpmm)
        np.testing.assert_array_equal(modulation, one.mtf.modulation)
    ratio = axes_titled(figure, "ratio")
    frequency, value = ratio.get_lines()[0].get_data()
    under = np.interp(frequency, coarse.mtf.frequency_lpmm, coarse.mtf.modulation)
    over = np.interp(frequency, fine.mtf.frequency_lpmm, fine.mtf.modulation)
    np.testing.assert_allclose(value, over / under)
    assert 0.04 < under.min() < 0.2
    gains = axes_titled(figure, "gain")
    dots = [line.get_xydata()[0] for line in gains.get_lines() if line.get_marker() == "o"]
    expected = [gain.mtf50.value, gain.mtf10.value, gain.width.value, gain.noise]
    np.testing.assert_allclose(dots, np.column_stack([expected, range(4)]))


def test_a_gain_without_intervals_has_no_bands(image: NDArray[np.float64]) -> None:
    one = published(image)
    figure = gain_figure(one, one, resolution_gain(one, one))
    assert bands(axes_titled(figure, CURVES)) == []
    assert all(line.get_marker() == "o" for line in axes_titled(figure, "gain").get_lines()[:-1])


def test_wrong_input_is_refused(result: EdgeResult) -> None:
    with pytest.raises(ValueError, match="at least one edge"):
        edge_figure([])
    with pytest.raises(ValueError, match=r"\(2, 3, 4\)"):
        edge_figure([result], np.zeros((2, 3, 4)))


def test_a_stored_edge_is_drawn_at_its_place(reference_dir: Path) -> None:
    stored = np.load(reference_dir / "slanted_edge" / "open" / "edges_64x16.npz")
    truths = [json.loads(str(one)) for one in stored["meta"]]
    chosen = [k for k, truth in enumerate(truths) if truth["theta"] == 10 and truth["noise"] > 0]
    for number in (chosen[0], chosen[-1]):
        (found,) = measure_edges(stored["images"][number].astype(float), 1.0)
        rows, cols = edge_line_px(found)
        lean = abs((cols[1] - cols[0]) / (rows[1] - rows[0]))
        assert lean == pytest.approx(np.tan(np.deg2rad(10.0)), abs=0.01)
        image = stored["images"][number].astype(float)
        half = 0.5 * (found.dark + found.bright)
        for row in (2, 13):  # where the line of the figure crosses a row, its grey is half way
            col = np.interp(row, rows, cols)
            assert np.interp(col, np.arange(64), image[row]) == pytest.approx(half, rel=0.35)


def test_many_edges_are_one_mean(result: EdgeResult) -> None:
    """A legend of a hundred edges left no place for curves."""
    axes = axes_titled(edge_figure([result] * 30), CURVES)
    legend = axes.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[0] == "mean of 30 slanted edges"
    assert len(labels) == 3
