"""Edges of photographs as one lens: places, zones, focus and acutance by closed forms."""

import runpy
import warnings
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.errors import QualityWarning
from lensshift.core.optical import MtfCurve
from lensshift.core.processes import ready_with
from lensshift.evaluation.chart import (
    ChartEdge,
    acutance,
    best_focus,
    edge_rows,
    modulation_at,
    zone_rows,
)
from lensshift.evaluation.chart_series import Photograph, focus_series, measure_chart
from lensshift.evaluation.slanted_edge import Interval

LENS = runpy.run_path(str(Path(__file__).resolve().parents[2] / "examples" / "measure_lens.py"))
TILE_PX = LENS["TILE_PX"]
TURN_RAD, RADIAL_PX, ROUND_PX = np.arctan2(1.0, 1.0), 1.1, 0.5


def photograph() -> np.ndarray:
    """Return an even picture with one dark square to the lower right of its middle.

    The lens blurs along the radius twice as much as across it.
    """
    light = np.full((3 * TILE_PX, 3 * TILE_PX), LENS["BRIGHT"])
    square = LENS["square"](38.0, RADIAL_PX, ROUND_PX, TURN_RAD)
    light[2 * TILE_PX :, 2 * TILE_PX :] = square
    return light + np.random.default_rng(5).normal(0.0, 0.002, light.shape)


@pytest.fixture(scope="module")
def edges() -> list[ChartEdge]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        return measure_chart([Photograph("one", photograph(), 3.0)], workers=1)


def test_lines_to_the_middle_are_sagittal(edges: list[ChartEdge]) -> None:
    """Edges along the radius measure the narrow blur across it, the two others the wide one."""
    assert len(edges) == 4
    assert all(0.5 < one.field < 0.85 for one in edges)
    for direction, width_px in (("sagittal", ROUND_PX), ("tangential", RADIAL_PX)):
        here = [one for one in edges if one.direction == direction]
        assert len(here) == 2
        for one in here:
            # Seven degrees off the radius, and the pixel's own blur of 0.29 px.
            sigma_px = np.hypot(width_px, 0.29)
            expected = np.sqrt(np.log(2.0) / 2.0) / np.pi / sigma_px
            assert one.result.mtf50_lpmm.value == pytest.approx(expected, rel=0.05)


def test_the_place_of_an_edge_is_on_it(edges: list[ChartEdge]) -> None:
    """Regions reach farther on one side: bars were drawn up to 12 px beside their edges."""
    middle_px, half_px = 2.5 * TILE_PX - 0.5, 0.29 * TILE_PX
    for one in edges:
        away = np.array([one.row_px, one.col_px]) - middle_px
        turn = one.result.angle_rad.value
        normal = np.array([np.sin(turn), np.cos(turn)])  # (row, col) of an upright edge
        normal = normal if one.result.orientation == "vertical" else normal[::-1]
        assert abs(away @ normal) == pytest.approx(half_px, abs=0.02)


def test_a_photograph_without_an_edge_is_named() -> None:
    square = photograph()[TILE_PX:, TILE_PX:]
    pictures = [Photograph("one", square), Photograph("blank", np.full((50, 50), 0.5))]
    with pytest.warns(QualityWarning, match="no slanted edge was found in blank"):
        measure_chart(pictures, workers=1)


def test_zones_count_usable_edges_only(edges: list[ChartEdge]) -> None:
    height = [0.1, 0.1, 0.5, 0.9]
    placed = [
        replace(one, field=at, direction="sagittal") for one, at in zip(edges, height, strict=True)
    ]
    bad = replace(placed[0], result=replace(placed[0].result, usable=False))
    rows = zone_rows([*placed, bad])
    assert [(row["zone"], row["edges"]) for row in rows] == [
        ("centre", 2), ("part way", 1), ("corners", 1)
    ]  # fmt: skip
    values = [one.result.mtf50_lpmm.value for one in placed[:2]]
    own = [one.result.mtf50_lpmm for one in placed[:2]]  # they agree, by chance to 1 in 10^5
    weights = [1.0 / (one.high - one.low) ** 2 for one in own]
    assert rows[0]["mtf50_lpmm"].value == pytest.approx(np.average(values, weights=weights))
    half = np.mean([one.high - one.low for one in own]) / 2.0**1.5
    found = rows[0]["mtf50_lpmm"]
    assert found.high - found.value == pytest.approx(half, rel=0.05)
    own, found = placed[2].result.mtf50_lpmm, rows[1]["mtf50_lpmm"]
    assert (found.low, found.high) == pytest.approx((own.low, own.high), rel=1e-3)
    assert rows[0]["worst_mtf50_lpmm"] == min(values)


def test_a_zone_of_edges_too_sharp_for_an_mtf50_has_a_row(edges: list[ChartEdge]) -> None:
    unknown = replace(edges[0].result, mtf50_lpmm=Interval(float("nan")))
    [row] = zone_rows([replace(edges[0], result=unknown)])
    assert row["edges"] == 1
    assert np.isnan([row["worst_mtf50_lpmm"], row["mtf50_lpmm"].value]).all()


def test_rows_of_a_table_are_in_the_unit(edges: list[ChartEdge]) -> None:
    [row, *_] = edge_rows(edges, [0.1], factor=20.0)
    found = edges[0].result
    assert row["mtf50"] == pytest.approx(20.0 * found.mtf50_lpmm.value)
    assert row["mtf_at_2"] == pytest.approx(modulation_at(found.mtf, 0.1).value)
    assert row["mtf_at_2_low"] < row["mtf_at_2"] < row["mtf_at_2_high"]
    assert row["angle_deg"] == pytest.approx(np.rad2deg(found.angle_rad.value))


def test_the_modulation_between_and_beyond() -> None:
    curve = MtfCurve(np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.6, 0.0]), np.full(3, 0.1))
    assert modulation_at(curve, 0.5) == Interval(0.8, 0.8 - 0.196, 0.8 + 0.196)
    assert modulation_at(curve, 2.0).low == 0.0
    assert np.isnan(modulation_at(curve, 2.1).value)
    bare = MtfCurve(np.array([0.0, 1.0]), np.array([1.0, 0.5]))
    assert np.isnan(modulation_at(bare, 0.5).low)


@given(st.floats(0.05, 0.4), st.floats(0.5, 5.0), st.floats(5.0, 30.0))
def test_acutance_of_an_exponential_is_in_closed_form(
    fall: float, heights: float, height_mm: float
) -> None:
    """MTF exp(-a f) against f^0.8 exp(-0.2 f): (0.2 / (0.2 + a))^1.8, a per cycle per degree."""
    per_lpmm = fall * height_mm * heights * np.pi / 180.0  # cycles per degree in one LP/mm
    frequency_lpmm = np.linspace(0.0, 80.0 * fall / per_lpmm, 20001)
    curve = MtfCurve(frequency_lpmm, np.exp(-per_lpmm * frequency_lpmm))
    expected = (0.2 / (0.2 + fall)) ** 1.8
    assert acutance(curve, height_mm, heights) == pytest.approx(expected, rel=2e-3)

    with pytest.raises(ValueError, match="positive"):
        acutance(curve, 0.0, heights)


@given(st.floats(-3.0, 3.0), st.floats(0.1, 2.0), st.permutations(range(7)))
def test_a_parabola_is_found_whatever_the_order(top: float, bend: float, order: list[int]) -> None:
    focus = np.linspace(-5.0, 5.0, 7)[order]
    fit = best_focus(focus, 40.0 - bend * (focus - top) ** 2)
    assert fit.focus == pytest.approx(top, abs=1e-6)
    assert fit.mtf50_lpmm == pytest.approx(40.0, rel=1e-9)
    assert fit.sigma == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("focus", [(-30.0, 0.0, 10.0, 20.0, 40.0), (-15.0, 0.0, 15.0)])
def test_blur_that_adds_up_in_squares_is_followed_from_uneven_places(
    focus: tuple[float, ...],
) -> None:
    """A parabola through MTF50 itself was 5.9 and 1.6 off."""
    place, sharpest = np.array(focus), 3.7
    fit = best_focus(focus, (0.5**-2 / 40.0**2 * (0.5**2 + (0.06 * (place - 3.7)) ** 2)) ** -0.5)
    assert fit.focus == pytest.approx(sharpest, abs=1e-6)
    assert fit.mtf50_lpmm == pytest.approx(40.0)


def test_the_error_of_the_focus_is_its_scatter() -> None:
    rng = np.random.default_rng(2)
    focus = np.arange(-2.0, 3.0)
    fits = [best_focus(focus, 10 - (focus - 0.2) ** 2 + rng.normal(0, 0.2, 5)) for _ in range(300)]
    told = np.sqrt(np.mean([one.sigma**2 for one in fits]))
    assert np.std([one.focus for one in fits]) == pytest.approx(told, rel=0.2)


def test_three_photographs_tell_the_error_of_the_focus_by_their_own() -> None:
    rng = np.random.default_rng(2)
    focus, std = np.array([-1.0, 0.0, 1.5]), np.array([0.02, 0.05, 0.03])
    fits = [
        best_focus(focus, 10 - (focus - 0.2) ** 2 + rng.normal(0, std), std) for _ in range(300)
    ]
    assert np.std([one.focus for one in fits]) == pytest.approx(fits[0].sigma, rel=0.15)
    assert np.isnan(best_focus(focus, 10 - (focus - 0.2) ** 2).sigma)


@pytest.mark.parametrize("photographs", [4, 5, 9, 21, 41])
@pytest.mark.parametrize("noise", [0.003, 0.02])
def test_more_photographs_tell_the_focus_better_and_their_interval_holds(
    photographs: int, noise: float
) -> None:
    """Of 41 photographs the five at the largest, which noise chose, were 0.22 off rms."""
    rng = np.random.default_rng(photographs)
    errors, inside = [], []
    for _ in range(100):
        best, place = rng.uniform(-1.0, 1.0), np.linspace(-2.0, 2.0, photographs)
        half = 40.0 / np.sqrt(1.0 + (place - best) ** 2)
        std = np.full(photographs, noise * 40.0)
        fit = best_focus(place, half + rng.normal(0.0, std), std)
        errors.append(fit.focus - best)
        inside.append(fit.low <= best <= fit.high)
    assert np.mean(inside) >= 0.85  # of 95 %, three standard errors
    assert np.sqrt(np.mean(np.square(errors))) < 5.0 * noise / np.sqrt(photographs)


@pytest.mark.parametrize("photographs", [8, 15, 30])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_curve_that_falls_faster_on_one_side_is_followed(photographs: int, side: float) -> None:
    """As with spherical aberration. A parabola was 0.12 off, and its interval of 0.03 held none."""
    rng = np.random.default_rng(photographs)
    errors, inside = [], []
    for _ in range(60):
        best, place = rng.uniform(-1.0, 1.0), np.linspace(-2.2, 2.2, photographs)
        away = side * (place - best)
        half = 40.0 / np.sqrt(1.0 + away**2 * (1.0 + 0.3 * np.tanh(away)))
        fit = best_focus(place, half + rng.normal(0.0, 0.12, photographs))
        errors.append(fit.focus - best)
        inside.append(fit.low <= best <= fit.high)
    assert np.sqrt(np.mean(np.square(errors))) < 0.06
    assert np.mean(inside) >= 0.8


@pytest.mark.parametrize("photographs", [3, 4, 6, 10])
def test_the_interval_holds_the_focus_of_a_lens_that_leans_unseen(photographs: int) -> None:
    """Of 3 and 4 photographs it held none to a tenth, of the errors of MTF50 alone."""
    rng = np.random.default_rng(40 + photographs)
    inside = []
    for _ in range(100):
        best, place = rng.uniform(-0.4, 0.4), np.linspace(-1.3, 1.3, photographs)
        lean = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4)
        away = place - best
        half = 40.0 / np.sqrt(1.0 + away**2 * (1.0 + lean * np.tanh(away)))
        std = np.full(photographs, 0.12)
        fit = best_focus(place, half + rng.normal(0.0, std), std)
        inside.append(fit.low <= best <= fit.high)
    assert np.mean(inside) >= 0.9


@pytest.mark.parametrize(
    ("focus", "mtf50", "message"),
    [
        ([0, 1], [1, 2], "three positions"),
        ([0, 1, 2], [1, 2, np.nan], "three positions"),
        ([0, 1, 2], [1, 2, 3], "go on there"),
        ([0.0, 0.0, 1.0, 2.0], [0.30, 0.31, 0.25, 0.2], "first or last"),
    ],
)
def test_series_without_a_best_focus(focus: list[float], mtf50: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        best_focus(focus, mtf50)


def test_through_focus(edges: list[ChartEdge]) -> None:
    def at(focus: float) -> list[ChartEdge]:
        factor = 1.0 - 0.02 * (focus - 1.0) ** 2
        return [
            replace(one, focus=focus, result=replace(
                one.result, mtf50_lpmm=one.result.mtf50_lpmm.scaled(factor)
            ))
            for one in edges
        ]  # fmt: skip

    series, fits = focus_series([one for focus in (2.0, -2.0, 4.0, 0.0) for one in at(focus)])
    assert {row["zone"] for row in series} == set(fits)
    assert all(fit.focus == pytest.approx(1.0, abs=1e-6) for fit in fits.values())
    _, fits = focus_series([one for focus in (-2.0, 0.0, 3.0) for one in at(focus)])
    assert all(0.0 < fit.sigma < 1.0 for fit in fits.values())
    with pytest.warns(QualityWarning, match=r"no best focus .*: the sharpest photograph"):
        focus_series([one for focus in (-2.0, 0.0, 1.0) for one in at(focus)])


def through_focus(edges: list[ChartEdge], places: dict[float, float]) -> list[ChartEdge]:
    """Return a series of a lens with astigmatism; each focus is told as another one."""

    def at(one: ChartEdge, focus: float) -> ChartEdge:
        best = 1.0 if one.direction == "sagittal" else -1.0
        factor = 1.0 / np.hypot(1.0, 0.4 * (focus - best))
        half = one.result.mtf50_lpmm.scaled(factor)
        return replace(one, focus=places[focus], result=replace(one.result, mtf50_lpmm=half))

    return [at(one, focus) for focus in places for one in edges]


def test_sagittal_and_tangential_lines_have_their_own_focus(edges: list[ChartEdge]) -> None:
    """Their mean has one between the two, where neither is sharp."""
    turned = [replace(one, direction="tangential") for one in edges]  # at the same places
    told = through_focus([*edges, *turned], {z: z for z in (-6.0, -3.0, 0.0, 2.0, 4.0, 7.0)})
    _, fits = focus_series(told)
    assert len(fits) == 2 * len({zone.rpartition(" ")[0] for zone in fits})
    for zone, fit in fits.items():
        assert fit.focus == pytest.approx(1.0 if zone.endswith("sagittal") else -1.0, abs=1e-6)


def test_positions_in_another_order_than_the_photographs_are_asked_about(
    edges: list[ChartEdge],
) -> None:
    right = {z: z for z in (-6.0, -3.0, 0.0, 2.0, 4.0, 7.0)}
    with warnings.catch_warnings(action="error"):
        focus_series(through_focus(edges, right))
    by_name = right | {-6.0: -3.0, -3.0: -6.0}
    with pytest.warns(QualityWarning, match="in the order of the photographs"):
        focus_series(through_focus(edges, by_name))


@pytest.mark.parametrize(("photographs", "expected"), [(1, 1), (2, 3)])
def test_eight_edges_are_worth_a_process_on_each_core(
    monkeypatch: pytest.MonkeyPatch, photographs: int, expected: int
) -> None:
    asked: list[int] = []

    @contextmanager
    def measured(work: Any, tasks: Any, workers: int, context: Any) -> Any:
        asked.append(workers)
        yield iter(())

    monkeypatch.setattr("lensshift.evaluation.chart_series._measured", measured)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    with pytest.raises(ValueError, match="found none"):
        measure_chart([Photograph("one", photograph())] * photographs)
    assert asked == [expected]


@pytest.mark.parametrize("ready", [pytest.param(False, marks=pytest.mark.slow), True])
def test_workers_find_the_same(edges: list[ChartEdge], ready: bool) -> None:
    """And a photograph without an edge costs nothing but a line of its own."""
    empty = np.random.default_rng(1).normal(0.5, 0.01, (80, 90))
    told: list[tuple[int, int]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        again = measure_chart(
            [Photograph("empty", empty), Photograph("one", photograph(), 3.0)],
            workers=2,
            context=ready_with("lensshift.evaluation.chart_series") if ready else None,
            on_edge=lambda done, of: told.append((done, of)),
        )
    for one, other in zip(again, edges, strict=True):  # threads of linear algebra sum otherwise
        a, b = one.result.mtf50_lpmm, other.result.mtf50_lpmm
        np.testing.assert_allclose([a.value, a.low, a.high], [b.value, b.low, b.high], rtol=1e-7)
    assert told[-1] == (4, 4)
    with pytest.raises(ValueError, match="found none in empty"):
        measure_chart([Photograph("empty", empty)])
