"""Every figure, drawn: not blank, numbers named, no text cut off."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drawn import assert_well_drawn
from matplotlib.figure import Figure
from sights import built, card, movers, sensitivities, star_image, stepped

from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Pinhole
from lensshift.core.motion import ShiftField
from lensshift.core.point_cloud import PointCloud, make_cloud
from lensshift.evaluation.edge_gradient import edge_gradient
from lensshift.evaluation.gain import resolution_gain
from lensshift.evaluation.siemens import siemens_star_mtf
from lensshift.evaluation.slanted_edge import EdgeResult, Region, measure_edge
from lensshift.evaluation.zone_plate import zone_plate_response
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import led_band
from lensshift.report.claims import gains_figure
from lensshift.report.depth import depth_figure
from lensshift.report.edges import edge_figure, gain_figure
from lensshift.report.gradient import MeasuredLines, gradient_figure
from lensshift.report.lens_aberrations import (
    fans_figure,
    field_curves_figure,
    psf_figure,
    sections_figure,
)
from lensshift.report.lens_build import tolerance_figure
from lensshift.report.lens_maps import (
    distortion_figure,
    field_figure,
    shift_map_figure,
    spots_figure,
)
from lensshift.report.lenses import layout_figure, mtf_figure, which_figure
from lensshift.report.result import cloud_figure
from lensshift.report.shots import shots_figure
from lensshift.report.stars import star_figure, zone_plate_figure

GRID = Grid((5, 17), (0.5, 0.6))
TRAVEL_MM = (0.03, 0.05)
FIELDS_TAN = [(0.0, 0.0), (math.tan(math.radians(1.6)), math.tan(math.radians(6.5)))]


def edge() -> EdgeResult:
    return measure_edge(card((17, 62), np.deg2rad(7.0), 29.3), 0.155, method="sfrmat3")


def edges(*shape: int) -> Figure:
    """Return the figure of two edges in an image of some shape, with a hole."""
    picture = np.random.default_rng(1).normal(size=shape)
    picture[3:6, 2:9] = np.nan
    one = edge()
    one = replace(one, low=0.9 * one.mtf.modulation, high=1.1 * one.mtf.modulation)
    regions = (Region(1, 14, 2, 30), Region(3, 16, 9, 37))
    found = [replace(one, region=place, residual=np.zeros((13, 28))) for place in regions]
    return edge_figure(found, picture)


def gain() -> Figure:
    return gain_figure(edge(), edge(), resolution_gain(edge(), edge()))


def gradients() -> Figure:
    lines = card((12, 30), np.deg2rad(9.0), 14.0)
    found = edge_gradient(lines, step_mm=0.155)
    return gradient_figure(
        found, lines, step_mm=0.155, against=MeasuredLines(found, lines, 0.155, "frame")
    )


def star() -> Figure:
    image, sides_mm = star_image(), (0.02, 0.025)
    found = siemens_star_mtf(
        image, cycles=24, pitch_mm=sides_mm, center_px=(33.3, 37.6), levels=(40, 160), sectors=4
    )
    return star_figure(found, image, sides_mm)


def zone_plate() -> Figure:
    row, col = np.indices((91, 97)) - np.array([45.2, 47.7])[:, None, None]
    image = 1.0 + 0.5 * np.cos(np.pi * 0.008 * (row**2 + col**2))
    found = zone_plate_response(
        image, pitch_mm=1.0, chirp_lpmm_per_mm=0.008, lr_pitch_mm=2.0, center_px=(45.2, 47.7)
    )
    return zone_plate_figure(found, image, 1.0, lr_pitch_mm=2.0)


def shifts() -> Figure:
    offset_px = 0.25 + 0.01 * np.random.default_rng(2).normal(size=(3, 5, 17, 2))
    return shift_map_figure(ShiftField(offset_px), GRID)


def points(spread_m: float) -> PointCloud:
    distance_m = 2.0 + spread_m * (np.indices((11, 23))[1] > 9)
    return make_cloud(distance_m, Pinhole.of_field(Grid((11, 23), (0.1, 0.1)), 0.8))


FIGURES: dict[str, Callable[[], Figure]] = {
    "edges, wide": lambda: edges(17, 64),
    "depth": lambda: depth_figure(*stepped()),
    "layout": lambda: layout_figure(load_lens("petzval_b"), 0, TRAVEL_MM),
}
MORE_FIGURES: dict[str, Callable[[], Figure]] = {
    "edges, tall": lambda: edges(90, 40),
    "edges, square": lambda: edges(41, 45),
    "gain": gain,
    "gradients": gradients,
    "star": star,
    "zone plate": zone_plate,
    "depth, square": lambda: depth_figure(*(image[:, :17] for image in stepped())),
    "depth without truth": lambda: depth_figure(stepped()[0]),
    "flat depth": lambda: depth_figure(np.full((7, 9), 2.0), np.full((7, 9), 2.0)),
    "mtf": lambda: mtf_figure(load_lens("petzval_b"), 0, TRAVEL_MM, GRID, FIELDS_TAN),
    "field": lambda: field_figure(load_lens("petzval_b"), 0, TRAVEL_MM, GRID, 2.0),
    "shifts": shifts,
    "distortion": lambda: distortion_figure(load_lens("petzval_a"), GRID),
    "spots": lambda: spots_figure(load_lens("petzval_a"), 0, TRAVEL_MM, GRID, FIELDS_TAN),
    "which": lambda: which_figure(movers()),
    "fans": lambda: fans_figure(load_lens("petzval_a"), GRID, FIELDS_TAN, band=led_band(850, 40)),
    "sections": lambda: sections_figure(load_lens("petzval_a"), GRID, FIELDS_TAN),
    "field curves": lambda: field_curves_figure(load_lens("petzval_b"), GRID),
    "points": lambda: psf_figure(load_lens("petzval_b"), GRID, FIELDS_TAN),
    "layout, other element": lambda: layout_figure(load_lens("petzval_a"), 2, TRAVEL_MM),
    "tolerance": lambda: tolerance_figure(built(), 0.87),
    "cloud": lambda: cloud_figure(points(spread_m=0.4)),
    "cloud, flat": lambda: cloud_figure(points(spread_m=0.0), "a wall"),
    "tolerance, table": lambda: tolerance_figure(built(30), 0.87, table=sensitivities()),
}


@pytest.mark.parametrize(
    "name", [*FIGURES, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE_FIGURES)]
)
def test_a_figure_is_well_drawn(name: str) -> None:
    assert_well_drawn((FIGURES | MORE_FIGURES)[name]())


@pytest.mark.parametrize("count", [1, 4, 9])
@pytest.mark.parametrize("shape", [(16, 64), (40, 56), (64, 16)])
@pytest.mark.parametrize("channels", [("amplitude",), ("amplitude", "distance")])
def test_scales_of_many_images_are_not_cut_off(
    shape: tuple[int, int], count: int, channels: tuple[str, ...]
) -> None:
    image = np.random.default_rng(2).normal(size=shape) + 5.0
    shown = {f"method {n}": dict.fromkeys(channels, image) for n in range(count)}
    assert_well_drawn(shots_figure(shown, "all of them", wide_in=8.0))


def test_means_of_large_gains_are_on_the_axis() -> None:
    gain = {"mean": 7.5, "interval": (5.0, 10.0), "least": 1.0, "most": 30.0}
    row = {"contrast": 0.15, "width_px": 1.0, "snr": 400.0, "phasor": gain}
    assert gains_figure([row], ("phasor",), "gains").axes[0].get_xlim()[1] > 7.5
