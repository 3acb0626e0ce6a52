"""Figures of gradients, stars, zone plates and distances show what was measured."""

import numpy as np
import pytest
from drawn import axes_titled, bands, line_labelled
from matplotlib.collections import LineCollection
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from sights import CENTER_PX, CYCLES, MODULATION, SIDES_MM, star_image, stepped

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.depth import depth_error, near_edges
from lensshift.evaluation.edge_gradient import EdgeGradient, edge_gradient
from lensshift.evaluation.siemens import SiemensResult, siemens_star_mtf
from lensshift.evaluation.surface import flying_pixel_fraction
from lensshift.evaluation.zone_plate import zone_plate_response
from lensshift.report.depth import depth_figure
from lensshift.report.gradient import MeasuredLines, gradient_figure
from lensshift.report.images import outline
from lensshift.report.stars import ring_wave, star_figure, zone_plate_figure
from lensshift.report.style import new_figure

STEP_MM = 0.155


@pytest.fixture(scope="module")
def lines() -> NDArray[np.float64]:
    place = np.arange(23.0) - np.linspace(9.0, 12.0, 11)[:, None]
    return 0.8 - 0.6 * np.clip(place / 1.7 + 0.5, 0.0, 1.0)  # falling ramps 1.7 pixels wide


@pytest.fixture(scope="module")
def gradient(lines: NDArray[np.float64]) -> EdgeGradient:
    return edge_gradient(lines, step_mm=STEP_MM)


def test_the_gradient_is_drawn_between_its_limits(
    gradient: EdgeGradient, lines: NDArray[np.float64]
) -> None:
    figure = gradient_figure(gradient, lines, step_mm=STEP_MM, unit="V")
    axes = axes_titled(figure, "lines across")
    place, value = line_labelled(axes, "image, line 5 of 11")
    edge = gradient.lines[5]
    assert value.tolist() == [edge.low_limit, edge.high_limit]
    assert abs(np.diff(value)[0] / np.diff(place)[0]) == pytest.approx(edge.slope_per_mm)
    levels = [line.get_ydata()[0] for line in axes.get_lines() if line.get_linestyle() == "--"]
    np.testing.assert_allclose(levels, [0.26, 0.74])  # 10 % and 90 % of 0.2 to 0.8
    assert {text.get_text() for text in axes.texts} == {"10 % of the step", "90 % of the step"}
    assert axes.get_ylabel() == "value (V)"


def test_lines_are_laid_onto_one_another_at_the_edge(
    gradient: EdgeGradient, lines: NDArray[np.float64]
) -> None:
    axes = axes_titled(gradient_figure(gradient, lines, step_mm=STEP_MM), "lines across")
    drawn = [line for line in axes.get_lines() if len(line.get_xdata()) == 23]
    assert len(drawn) == 12  # the middle one twice
    for line in drawn:
        np.testing.assert_allclose(np.interp(0.0, line.get_xdata(), line.get_ydata()), 0.5)


def test_every_slope_is_drawn_with_the_mean_and_its_interval(
    gradient: EdgeGradient, lines: NDArray[np.float64]
) -> None:
    axes = axes_titled(gradient_figure(gradient, lines, step_mm=STEP_MM), "gradient of")
    dots = next(line for line in axes.get_lines() if line.get_marker() == "o")
    np.testing.assert_allclose(dots.get_ydata(), gradient.normalised_per_mm)
    assert set(line_labelled(axes, "image, mean")[1]) == {gradient.mean_per_mm}
    assert gradient.averaged is not None
    averaged = line_labelled(axes, "image, averaged")[1]
    assert set(averaged) == {gradient.averaged.normalised_per_mm}
    (span,) = axes.patches
    assert gradient.interval_per_mm is not None
    assert (span.get_y(), span.get_y() + span.get_height()) == pytest.approx(
        gradient.interval_per_mm
    )


def test_a_single_line_has_neither_interval_nor_average(lines: NDArray[np.float64]) -> None:
    with pytest.warns(QualityWarning):
        one = edge_gradient(lines[0], step_mm=STEP_MM, share=0.05)
    figure = gradient_figure(one, lines[0], step_mm=STEP_MM, length="px")
    assert not axes_titled(figure, "gradient of").patches
    texts = {text.get_text() for text in axes_titled(figure, "lines across").texts}
    assert texts == {"5 % of the step", "95 % of the step"}
    assert "(px)" in axes_titled(figure, "lines across").get_xlabel()


def test_two_images_are_compared_about_the_same_edge(
    gradient: EdgeGradient, lines: NDArray[np.float64]
) -> None:
    coarse = MeasuredLines(gradient, lines, STEP_MM, "frame")
    fine = edge_gradient(lines, step_mm=STEP_MM / 2)
    figure = gradient_figure(fine, lines, step_mm=STEP_MM / 2, name="SR", against=coarse)
    axes = axes_titled(figure, "lines across")
    widths = [np.ptp(line_labelled(axes, name)[0]) for name in ("SR", "frame")]
    assert widths[1] == pytest.approx(2 * widths[0])
    assert len(axes_titled(figure, "gradient of").patches) == 2
    with pytest.raises(ValueError, match="expected 11 lines"):
        gradient_figure(gradient, lines[:4], step_mm=STEP_MM)


@pytest.fixture(scope="module", name="star_image")
def the_star() -> NDArray[np.float64]:
    return star_image()


@pytest.fixture(scope="module")
def star(star_image: NDArray[np.float64]) -> SiemensResult:
    levels = (100.0 * (1 - MODULATION), 100.0 * (1 + MODULATION))
    return siemens_star_mtf(
        star_image, cycles=CYCLES, pitch_mm=SIDES_MM, center_px=CENTER_PX, levels=levels, sectors=4
    )


def test_the_star_is_drawn_with_band_limits_and_sectors(
    star: SiemensResult, star_image: NDArray[np.float64]
) -> None:
    figure = star_figure(star, star_image, SIDES_MM)
    axes = axes_titled(figure, "MTF of the Siemens")
    frequency, modulation = line_labelled(axes, "all directions")
    np.testing.assert_array_equal(frequency, star.mtf.frequency_lpmm)
    np.testing.assert_array_equal(modulation, star.mtf.modulation)
    for number, turn in enumerate((0, 90, 180, 270)):
        drawn = line_labelled(axes, f"{turn} degrees")[1]
        np.testing.assert_array_equal(drawn, star.sectors[number].modulation)
    assert len(bands(axes)) == 5
    frequency, limit = line_labelled(axes, "|sinc| of pixel")
    angle = np.linspace(0.0, 2 * np.pi, 721)[:-1, None]  # over a whole turn, otherwise sampled
    product = np.sinc(SIDES_MM[0] * frequency * np.sin(angle))
    product = product * np.sinc(SIDES_MM[1] * frequency * np.cos(angle))
    np.testing.assert_allclose(limit, np.abs(product).mean(axis=0), atol=2e-3)


def test_rings_are_drawn_round_on_the_target(
    star: SiemensResult, star_image: NDArray[np.float64]
) -> None:
    axes = axes_titled(star_figure(star, star_image, SIDES_MM), "rings")
    rings = [one for one in axes.patches if isinstance(one, Ellipse)]
    assert [ring.get_center() for ring in rings] == [(CENTER_PX[1], CENTER_PX[0])] * 3
    for ring, place in zip(rings, (0, star.radius_mm.size // 2, -1), strict=True):
        radius_mm = (0.5 * ring.height * SIDES_MM[0], 0.5 * ring.width * SIDES_MM[1])
        assert radius_mm == pytest.approx((star.radius_mm[place],) * 2, rel=0.05)
    assert axes.get_aspect() == SIDES_MM[0] / SIDES_MM[1]
    assert rings[0].width > rings[2].width


def test_the_wave_of_a_ring_is_the_one_that_was_measured(
    star: SiemensResult, star_image: NDArray[np.float64]
) -> None:
    for ring in (0, star.radius_mm.size // 2):
        phase, values, modulation = ring_wave(star, ring, star_image, SIDES_MM)
        assert modulation == pytest.approx(star.mtf.modulation[ring] * star.contrast, rel=0.002)
        assert modulation == pytest.approx(MODULATION / (1.0 + 5e-4 * CENTER_PX[1]), rel=0.002)
        np.testing.assert_allclose(values, 1.0 + modulation * np.cos(2 * np.pi * phase), atol=0.01)
        assert np.ptp(phase) > 0.9


def test_a_zone_plate_is_drawn_with_its_folded_part() -> None:
    chirp, pitch_mm, lr_mm = 0.008, 1.0, 2.0
    row, col = np.indices((91, 97)) - np.array([45.2, 47.7])[:, None, None]
    image = 1.0 + 0.5 * np.cos(np.pi * chirp * (row**2 + col**2))
    plate = zone_plate_response(
        image, pitch_mm=pitch_mm, chirp_lpmm_per_mm=chirp, lr_pitch_mm=lr_mm, levels=(0.5, 1.5)
    )
    figure = zone_plate_figure(plate, image, pitch_mm, lr_pitch_mm=lr_mm, unit="cycles/px")
    axes = axes_titled(figure, "response")
    assert plate.folded is not None
    for name, curve in (
        ("all directions", plate.radial),
        ("along rows", plate.row),
        ("folded, along col", plate.folded[1]),
    ):
        np.testing.assert_array_equal(line_labelled(axes, name)[1], curve.modulation)
    assert [text.get_text() for text in axes.texts] == ["Nyquist"]
    assert axes.texts[0].xy[0] == 0.5 / lr_mm
    places = axes_titled(figure, "centre")
    lines = [line.get_xydata() for line in places.get_lines() if len(line.get_xdata()) == 2]
    steep = [abs(np.diff(line[:, 1]) / np.diff(line[:, 0]))[0] for line in lines]
    np.testing.assert_allclose(np.rad2deg(np.arctan(steep)), [75.0, 75.0, 15.0, 15.0])


@pytest.fixture(scope="module")
def scene() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return stepped()


def test_errors_of_distances_are_drawn_where_they_are(
    scene: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    measured_m, true_m = scene
    figure = depth_figure(measured_m, true_m)
    shown = axes_titled(figure, "measured minus").images[0]
    error_mm = np.ma.filled(shown.get_array(), np.nan)
    np.testing.assert_allclose(error_mm, 1e3 * (measured_m - true_m))
    assert shown.get_clim()[0] == -shown.get_clim()[1]
    axes = axes_titled(figure, "distance")
    crosses = next(line for line in axes.get_lines() if line.get_marker() == "x").get_xydata()
    flying = flying_pixel_fraction(measured_m, true_m).flying
    assert {(int(row), int(col)) for col, row in crosses} == set(
        zip(*np.nonzero(flying), strict=True)
    )
    assert len(crosses) == 8


def test_histograms_split_edges_from_the_rest(
    scene: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    measured_m, true_m = scene
    found = depth_error(measured_m, true_m)
    axes = axes_titled(depth_figure(measured_m, true_m), "all:")
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert f"RMSE {1e3 * found.edge_rmse_m:.3g} mm, {found.edge_count} px" in texts[0]
    rest = found.count - found.edge_count
    assert f"RMSE {1e3 * found.flat_rmse_m:.3g} mm, {rest} px" in texts[1]
    for patch in axes.patches:  # each histogram holds all of its pixels, those beyond too
        outline_xy = patch.get_xy()
        steps = np.unique(outline_xy[:, 0])
        heights = [outline_xy[np.isclose(outline_xy[:, 0], x), 1].max() for x in steps]
        assert len(steps) == 62
        assert max(heights) <= 100.0
    assert near_edges(true_m).sum() > found.edge_count - 1


def test_distances_without_truth_or_without_edges(
    scene: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    measured_m, _ = scene
    figure = depth_figure(measured_m, valid=measured_m < 3.4)
    (axes,) = figure.axes
    assert [scale.get_ylabel() for scale in axes.child_axes] == ["distance (m)"]
    shown = axes.images[0].get_array()
    assert np.ma.getmaskarray(shown).sum() == np.count_nonzero(~(measured_m < 3.4))
    flat = depth_figure(np.full((7, 9), 2.0), np.full((7, 9), 2.0))
    assert "no edge" in flat.axes[0].get_title("left")


def test_an_outline_runs_between_pixels() -> None:
    mask = np.zeros((4, 6), dtype=bool)
    mask[1:3, 2:5] = True
    axes = new_figure(2.0, 2.0).subplots()
    outline(axes, mask, "black")
    (lines,) = (one for one in axes.collections if isinstance(one, LineCollection))
    ends = np.array(lines.get_segments())
    assert len(ends) == 10  # the perimeter of 2 x 3 pixels
    assert (ends[..., 0].min(), ends[..., 0].max()) == (1.5, 4.5)
    assert (ends[..., 1].min(), ends[..., 1].max()) == (0.5, 2.5)
    assert np.allclose(np.abs(np.diff(ends, axis=1)).sum(axis=-1), 1.0)


def test_a_real_distance_image_is_drawn(reference_dir) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(reference_dir / "tof_data" / "ifm_o3d303" / "o3d3xx.h5") as file:
        frames = file["o3d3xx/camera/depth"]
        depth_m = 1e-3 * np.array([frames[name] for name in sorted(frames)], dtype=float)
    depth_m[depth_m == 0] = np.nan
    figure = depth_figure(depth_m[0, :60, :80], depth_m[1, :60, :80])
    shown = axes_titled(figure, "measured minus").images[0]
    assert 1.0 < shown.get_clim()[1] < 200.0
