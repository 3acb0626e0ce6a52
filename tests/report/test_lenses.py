"""Figures of lenses show what the optics computed, to scale or with a stated factor."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from drawn import assert_well_drawn, line_labelled
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle
from matplotlib.quiver import Quiver
from sights import built, movers, sensitivities

from lensshift.core.grid import Grid
from lensshift.core.motion import ShiftField
from lensshift.optics.aberrations import (
    focal_surfaces,
    ray_fan,
    relative_illumination,
    section_mtf,
    sensor_fields,
)
from lensshift.optics.actuator import ActuatorBudget
from lensshift.optics.layout import distortion_grid, layout
from lensshift.optics.lens import Lens
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import fast_mtf, led_band, sensor_mtf
from lensshift.optics.otf import diffraction_limit, exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.psf import ensquared_energy
from lensshift.optics.shift import moving, shift_map
from lensshift.optics.spots import spots
from lensshift.optics.trace import trace
from lensshift.report.lens_aberrations import (
    fans_figure,
    field_curves_figure,
    psf_figure,
    sections_figure,
)
from lensshift.report.lens_build import budget_figure, tolerance_figure
from lensshift.report.lens_maps import (
    distortion_figure,
    field_figure,
    focus_figure,
    shift_map_figure,
    spots_figure,
)
from lensshift.report.lenses import layout_figure, mtf_figure, which_figure
from lensshift.report.style import round_number

GRID = Grid((5, 17), (0.5, 0.6))  # few large pixels
TRAVEL_MM = (0.03, 0.05)
CORNER_TAN = (math.tan(math.radians(1.6)), math.tan(math.radians(6.5)))


@pytest.fixture(scope="module")
def lens() -> Lens:
    return load_lens("petzval_b")


def factor_in(text: str) -> float:
    """Return the number before "times" in a text, 1 without one."""
    found = re.search(r"([\d.]+) times as", text)
    return float(found.group(1)) if found else 1.0


def labels(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_the_layout_shows_lens_rays_and_the_moved_element_to_scale(lens: Lens) -> None:
    figure = layout_figure(lens, 1, TRAVEL_MM)
    (axes,) = figure.axes
    assert axes.get_aspect() == 1.0
    rest = layout(lens, field_tan=[0.0, CORNER_TAN[1]])
    drawn = [patch.get_xy() for patch in axes.patches]
    for outline, corners in zip(rest.outlines, drawn, strict=True):
        np.testing.assert_allclose(
            corners[: outline.z_mm.size], np.column_stack([outline.z_mm, outline.height_mm])
        )
    (label,) = (text for text in labels(axes) if "element 2 moved by 50.0 um" in text)
    moved = line_labelled(axes, "element 2 moved")
    shift_mm = moved[1] - rest.outlines[1].height_mm
    np.testing.assert_allclose(shift_mm, factor_in(label) * TRAVEL_MM[1], atol=1e-9)
    assert 0.02 < shift_mm[0] / rest.outlines[1].height_mm.max() < 0.2  # it is seen
    assert axes.get_xlim()[0] > -25.0  # not the 3.5 m to the object
    assert axes.get_xlim()[1] < 70.0


def test_a_travel_that_is_seen_is_not_enlarged(lens: Lens) -> None:
    (axes,) = layout_figure(lens, 0, (0.0, -2.0)).axes
    (label,) = (text for text in labels(axes) if "moved" in text)
    assert "times" not in label
    rest = layout(lens)
    shift_mm = line_labelled(axes, "element 1 moved")[1] - rest.outlines[0].height_mm
    np.testing.assert_allclose(shift_mm, -2.0)


def test_the_moved_outline_of_a_lens_without_edges_is_as_large(lens: Lens) -> None:
    """Its edges are drawn where rays are: those of the lens at rest."""
    bare = replace(
        lens.elements[0],
        surfaces=tuple(replace(s, semi_diameter_mm=math.inf) for s in lens.elements[0].surfaces),
    )
    lens = replace(lens, elements=(bare, *lens.elements[1:]))
    (axes,) = layout_figure(lens, 0, TRAVEL_MM).axes
    rest = layout(lens, field_tan=[0.0, CORNER_TAN[1]]).outlines[0].height_mm
    assert np.ptp(line_labelled(axes, "element 1 moved")[1]) == pytest.approx(np.ptp(rest))


def test_mtf_curves_are_the_exact_ones_with_the_limits_of_the_sensor(lens: Lens) -> None:
    figure = mtf_figure(lens, 0, TRAVEL_MM, GRID, [CORNER_TAN], highest_lpmm=4.0)
    axes, change = figure.axes
    some = [0, 20, 40]
    at = {}
    for state, sign in (("at rest", 0), ("moved", 1), ("moved the other way", -1)):
        (frequency, values) = next(
            np.array(line.get_data())
            for line in axes.get_lines()
            if str(line.get_label()) == f"1.6/6.5 degrees {state}"
        )
        build = moving(lens, 0, sign * np.asarray(TRAVEL_MM))
        exact = np.abs(exact_otf(lens, CORNER_TAN, frequency[some], 0.0, build=build)[0])
        np.testing.assert_allclose(values[some], exact, atol=1e-12)
        at[state] = values
    np.testing.assert_array_equal(change.get_lines()[0].get_ydata(), at["moved"] - at["at rest"])
    frequency, aperture = line_labelled(axes, "pixel |sinc|")
    np.testing.assert_allclose(aperture, np.abs(np.sinc(0.6 * frequency)), atol=1e-12)
    _, published = line_labelled(axes, "pixel sinc")
    np.testing.assert_allclose(published, aperture**2, atol=1e-12)
    frequency, limit = line_labelled(axes, "diffraction limit")
    marginal = trace(lens, [0.0, 0.0], [[1.0, 0.0]]).direction[0, 0]
    cutoff = 2e6 * abs(marginal) / lens.wavelength_nm
    assert 1.0 - limit[-1] == pytest.approx(4.0 / np.pi * frequency[-1] / cutoff, rel=0.05)
    np.testing.assert_array_equal(limit, diffraction_limit(lens, frequency).modulation)
    assert np.all(at["at rest"] <= limit + 1e-6)


def test_on_the_axis_both_ways_are_the_same(lens: Lens) -> None:
    figure = mtf_figure(lens, 0, TRAVEL_MM, GRID, [(0.0, 0.0)], azimuth_rad=0.5 * np.pi)
    one, other = (line.get_ydata() for line in figure.axes[1].get_lines()[:2])
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert figure.axes[0].get_ylabel() == "modulation along rows"
    frequency, aperture = line_labelled(figure.axes[0], "pixel |sinc|")
    np.testing.assert_allclose(aperture, np.abs(np.sinc(0.5 * frequency)), atol=1e-12)


def test_maps_over_the_sensor_show_the_worse_direction(lens: Lens) -> None:
    figure = field_figure(lens, 0, TRAVEL_MM, GRID, 2.0)
    rest, moved, change = (axes.images[0] for axes in figure.axes)
    both = sensor_mtf(lens, GRID, 2.0)[..., 0]
    np.testing.assert_allclose(rest.get_array(), np.minimum(both[..., 0], both[..., 1]))
    difference = moved.get_array() - rest.get_array()
    np.testing.assert_allclose(change.get_array(), difference)
    assert rest.get_clim() == moved.get_clim()
    assert {axes.get_aspect() for axes in figure.axes} == {0.5 / 0.6}


def test_focus_curves_are_those_of_a_moved_sensor(lens: Lens) -> None:
    figure = focus_figure(lens, [(0.0, 0.0), CORNER_TAN], 5.0)
    (axes,) = figure.axes
    for row, along in enumerate(("columns", "rows")):
        away_mm, values = line_labelled(axes, f"1.6/6.5 degrees along {along}")
        refocused = lens.with_sensor(lens.gaps_mm[-1] + away_mm[10])
        assert values[10] == pytest.approx(fast_mtf(refocused, CORNER_TAN, 5.0)[row, 0], abs=1e-9)
    assert_well_drawn(figure)


@pytest.mark.parametrize("wanted", [True, False], ids=["wanted", "mean"])
def test_arrows_are_departures_of_the_shift_times_the_stated_factor(
    lens: Lens, wanted: bool
) -> None:
    field = shift_map(lens, 0, [TRAVEL_MM, (-0.03, 0.05), (0.0, 0.1)], GRID)
    wish = field.offset_px[:, 2, 8] if wanted else None
    figure = shift_map_figure(field, GRID, wish)
    assert figure.get_suptitle().startswith("departure of the shift from the")
    assert ("wanted" in figure.get_suptitle()) == wanted
    times = factor_in(figure.get_suptitle())
    even = field.offset_px.mean(axis=(1, 2)) if wish is None else wish
    for frame in range(3):
        axes = figure.axes[frame]
        (arrows,) = (one for one in axes.collections if isinstance(one, Quiver))
        error = field.offset_px[frame] - even[frame]
        at = np.rint(arrows.XY).astype(int)
        np.testing.assert_allclose(arrows.U, times * error[at[:, 1], at[:, 0], 1])
        np.testing.assert_allclose(arrows.V, times * error[at[:, 1], at[:, 0], 0])
        assert arrows.angles == "xy"  # rows count downwards, and so do the arrows
        np.testing.assert_allclose(axes.images[0].get_array(), np.linalg.norm(error, axis=-1))
    assert not figure.axes[3].axison  # 3 frames in 4 places


def test_an_even_shift_is_drawn_without_arrows() -> None:
    even = ShiftField(np.tile([0.25, -0.25], (1, 5, 17, 1)))
    figure = shift_map_figure(even, GRID)
    (arrows,) = (one for one in figure.axes[0].collections if isinstance(one, Quiver))
    assert not np.any(arrows.U)
    with pytest.raises(ValueError, match=r"wanted_px \(1, 2\)"):
        shift_map_figure(even, GRID, [[0.25, 0.25], [0.0, 0.0]])


def test_the_grid_is_distorted_by_the_stated_factor(lens: Lens) -> None:
    figure = distortion_figure(lens, GRID)
    (axes,) = figure.axes
    (label,) = (text for text in labels(axes) if text.startswith("real"))
    found = distortion_grid(lens, GRID)
    lines = [line for line in axes.get_lines() if len(line.get_xdata()) == 17]
    ideal, real = lines[:5], lines[5:]
    assert len(real) == 5
    for number in range(5):
        moved = real[number].get_xydata() - ideal[number].get_xydata()
        expected = factor_in(label) * found.error_px[number, :, ::-1]
        np.testing.assert_allclose(moved, expected, atol=1e-9)
    corners = np.array([line.get_xydata()[[0, -1]] for line in (ideal[0], ideal[-1])])
    np.testing.assert_allclose(corners, [[[-0.5, -0.5], [16.5, -0.5]], [[-0.5, 4.5], [16.5, 4.5]]])


def test_spots_lie_in_a_pixel_with_the_airy_ring_to_scale(lens: Lens) -> None:
    figure = spots_figure(lens, 0, TRAVEL_MM, GRID, [(0.0, 0.0), CORNER_TAN])
    f_number = paraxial(lens).working_f_number
    for axes in figure.axes:
        (ring,) = (one for one in axes.patches if isinstance(one, Circle))
        assert ring.radius == pytest.approx(1.22 * 0.85 * f_number)
        (pixel,) = (one for one in axes.patches if isinstance(one, Rectangle))
        assert pixel.get_bbox().bounds == (-300.0, -250.0, 600.0, 500.0)
        assert axes.get_aspect() == 1.0
        assert axes.yaxis_inverted()
    corner, enlarged = figure.axes[1], figure.axes[3]
    spans = [axes.get_xlim()[1] - axes.get_xlim()[0] for axes in (corner, enlarged)]
    assert spans[0] / spans[1] == pytest.approx(
        float(enlarged.get_title("left").split()[0]), rel=0.06
    )
    assert spans[0] > 1.2 * spans[1]
    for line, build in zip(
        corner.get_lines(), (None, moving(lens, 0, np.asarray(TRAVEL_MM))), strict=True
    ):
        spot = spots(lens, CORNER_TAN, build=build, rings=10)
        np.testing.assert_allclose(line.get_xydata(), 1e3 * spot.ray_mm[:, ::-1])
        assert f"{1e3 * spot.rms_radius_mm:.1f}" in corner.get_title("left")


def test_fans_and_curves_show_what_the_optics_say(lens: Lens) -> None:
    figure = fans_figure(lens, GRID, [(0.0, 0.0), CORNER_TAN], band=led_band(850.0, 40.0))
    assert len(figure.axes) == 4
    corner = figure.axes[2]
    lines = [line for line in corner.get_lines() if len(line.get_xdata()) > 10]
    for line, nm in zip(
        lines, np.sort(led_band(850.0, 40.0).wavelength_nm)[[0, 2, 4]], strict=True
    ):
        fan = ray_fan(lens, CORNER_TAN, wavelength_nm=float(nm))
        np.testing.assert_allclose(line.get_ydata(), 1e3 * fan.tangential_mm)
    strip = corner.patches[0].get_extents().transformed(corner.transData.inverted())
    assert (strip.y0, strip.y1) == pytest.approx((-125.0, 125.0))  # half of 500 um
    focus, departure, light = field_curves_figure(lens, GRID).axes
    fields = sensor_fields(lens, GRID, [0.0, 0.5, 1.0])
    found = focal_surfaces(lens, fields)
    for name, wanted_mm in (("tan", found.tangential_mm), ("sag", found.sagittal_mm)):
        x, height_mm = line_labelled(focus, name)
        np.testing.assert_allclose(x[[0, 12, 24]], wanted_mm, atol=1e-7)
        assert height_mm[-1] == pytest.approx(math.hypot(1.25, 5.1))
    shown = light.get_lines()[0].get_xdata()
    np.testing.assert_allclose(shown[[0, 12, 24]], 100.0 * relative_illumination(lens, fields))
    assert departure.get_lines()[0].get_xdata()[0] == 0.0


def test_both_sections_and_the_light_of_points_are_drawn(lens: Lens) -> None:
    left, right = sections_figure(lens, GRID, [CORNER_TAN], highest_lpmm=3.0).axes
    for number, name in enumerate("TS"):
        frequency, values = line_labelled(left, f"1.6/6.5 degrees {name}")
        np.testing.assert_allclose(values, section_mtf(lens, CORNER_TAN, frequency)[number])
        over_field = line_labelled(right, f"1.67 LP/mm {name}")[1]
        corner = section_mtf(lens, sensor_fields(lens, GRID, [1.0])[0], [1.0 / 0.6])
        assert over_field[-1] == pytest.approx(corner[number, 0])
    figure = psf_figure(lens, GRID, [(0.0, 0.0), CORNER_TAN])
    (light,) = (axes for axes in figure.axes if axes.get_xlabel().startswith("side of a square"))
    side_um, percent = line_labelled(light, "1.6/6.5")
    wanted = ensquared_energy(lens, CORNER_TAN, 1e-3 * side_um[[20, 60, 100]])
    np.testing.assert_allclose(percent[[20, 60, 100]], 100.0 * wanted, atol=0.3)
    (pixel,) = (one for one in figure.axes[0].patches if isinstance(one, Rectangle))
    assert pixel.get_bbox().bounds == (-300.0, -250.0, 600.0, 500.0)


def test_bars_compare_the_elements_that_can_move() -> None:
    figure = which_figure(movers())
    widths = [[bar.get_width() for bar in axes.patches] for axes in figure.axes]
    np.testing.assert_allclose(widths[0], [44.4, 126.7, 232.0])
    np.testing.assert_allclose(widths[1], [0.0157, 0.0026, 0.08])
    np.testing.assert_allclose(widths[2], [0.022, 0.0291, 0.0824])
    np.testing.assert_allclose(widths[3], [0.953] * 3 + [0.931, 0.924, 0.87])
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert names == ["1 front", "2 middle", "4 last"]
    for axes, all_widths in zip(figure.axes, widths, strict=True):
        assert axes.get_xlim()[1] > max(all_widths)
        assert axes.get_ylim()[0] > axes.get_ylim()[1]  # the first element on top
    with pytest.raises(ValueError, match="at least one element"):
        which_figure([])


def test_builds_are_counted_and_the_yield_is_told() -> None:
    found = built()
    limit = float(np.percentile(found.worst_mtf, 30))
    figure = tolerance_figure(found, limit)
    worst, share, shift, focus = figure.axes
    for axes, values in (
        (worst, found.worst_mtf),
        (shift, found.shift_error_px),
        (focus, found.refocus_mm),
    ):
        heights = [bar.get_height() for bar in axes.patches]
        assert sum(heights) == 200
        assert axes.patches[0].get_x() == pytest.approx(values.min())
    assert worst.get_legend().get_title().get_text().startswith("70.0 % of 200 builds")
    assert share.get_lines()[-1].get_xydata().tolist() == [[limit, 70.0]]
    steps = share.get_lines()[0]
    at = np.searchsorted(steps.get_xdata(), limit)
    assert steps.get_ydata()[at] == pytest.approx(70.0)
    assert line_labelled(worst, "as drawn")[0][0] == 0.94
    with pytest.raises(ValueError, match="from 0 to 1"):
        tolerance_figure(found, 90.0)


def test_the_tolerances_that_matter_most_are_drawn_below() -> None:
    table = sensitivities()
    figure = tolerance_figure(built(30), 0.9, table=table)
    bars = figure.axes[4].patches
    np.testing.assert_allclose([bar.get_width() for bar in bars], [r.mtf_loss for r in table[:10]])
    assert figure.axes[4].yaxis_inverted()  # the largest loss on top


def test_a_budget_is_drawn_part_by_part() -> None:
    parts_px = {"repeatability": 0.03, "backlash": 0.04, "encoder": 0.0, "drift": 0.12}
    figure = budget_figure(ActuatorBudget(1, 44.4, 0.0056, 0.0059, parts_px, 0.13, 1.234, 0.056))
    (axes,) = figure.axes
    np.testing.assert_allclose(
        [bar.get_width() for bar in axes.patches], [*parts_px.values(), 0.13]
    )
    assert [text.get_text() for text in axes.get_yticklabels()] == [*parts_px, "all together"]
    assert axes.get_title("left") == "element 2: costs 1.23 dB of PSNR and 5.6 % of MTF50"
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # the first error on top
    assert_well_drawn(figure)


@given(st.floats(1e-9, 1e9))
def test_factors_are_round_and_not_too_large(value: float) -> None:
    found = round_number(value)
    assert found <= value * (1 + 1e-9)
    assert value < 2.5 * found * (1 + 1e-9)
    assert f"{found:.6e}"[0] in "125"
    assert f"{found:.6e}"[2:8] == "000000"
