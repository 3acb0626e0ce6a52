"""The search for gaps, orientations and stock lenses."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lensshift.core.grid import Grid
from lensshift.optics.design import assess, optimise_gaps
from lensshift.optics.focus import scan_focus, spot_means
from lensshift.optics.glass import refractive_index
from lensshift.optics.goal import Goal
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import fast_mtf, led_band
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.shift import decenter_for_shift, moving, shift_map, shift_uniformity
from lensshift.optics.spots import image_per_field_mm, obstruction, spots
from lensshift.optics.stock import format_designs, search_stock
from lensshift.optics.trace import trace
from lensshift.optics.which import least_mtf

SENSOR = Grid((16, 64), (0.155, 0.155))
GOAL = Goal(SENSOR, focal_length_mm=42.7, object_mm=3500.0)
AL2550, EO33950, EO45030, LC1054 = (
    load_lens(name).elements[0] for name in ("al2550", "eo33950", "eo45030", "lc1054")
)
QUARTERS = 0.25 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
CORNER = np.tan(np.radians([1.6, 6.5]))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the rays of")  # the same few rays on both sides
def test_a_focus_scan_equals_the_fast_mtf_of_moved_sensors() -> None:
    lens = load_lens("petzval_b").with_decenter(2, (0.0, 4.8))  # some rays are lost
    fields = np.array([[0.0, 0.0], [0.02, 0.1], [-0.03, 0.05]])
    points, weight = pupil_quadrature(4)
    rays = trace(lens, fields, points)
    assert rays.counts()["vignetted"] > 0
    azimuths = [0.0, 0.7, math.pi / 2]
    first_mm = np.array([-0.3, 0.1, 0.0])
    got = scan_focus(
        rays, weight, 4, 5.0, azimuths, 850.0, first_mm=first_mm, step_mm=0.05, planes=4
    )
    assert got.shape == (3, 3, 4)
    for plane in range(4):
        defocus_mm = first_mm + 0.05 * plane
        expected = fast_mtf(lens, fields, [5.0], azimuths, defocus_mm=defocus_mm, rings=4)
        assert got[..., plane] == pytest.approx(expected[..., 0], abs=1e-12)
    (light, centroid_mm, slope), spot = spot_means(rays, weight), spots(lens, fields, rings=4)
    assert light == pytest.approx(spot.transmission)
    assert centroid_mm == pytest.approx(spot.centroid_mm, abs=1e-13)
    away = spots(lens.with_sensor(lens.gaps_mm[-1] + 0.2), fields, rings=4).centroid_mm
    assert centroid_mm + 0.2 * slope == pytest.approx(away, abs=1e-12)


def test_a_focus_scan_of_an_obstructed_lens_equals_the_fast_mtf() -> None:
    surface = Surface(-200.0, -1.0, semi_diameter_mm=12.5, inner_mm=4.0, mirror=True)
    lens = Lens((Element((surface,), (), ()),), (100.1,), Stop(20.0), wavelength_nm=550.0)
    points, weight = pupil_quadrature(6, inner=obstruction(lens))
    rays = trace(lens, [0.0, 0.005], points)
    lpmm, azimuths = 60.0, [0.0, 1.0]
    got = scan_focus(rays, weight, 6, lpmm, azimuths, 550.0, step_mm=0.02, planes=2, inner=0.4)
    for plane in range(2):
        expected = fast_mtf(lens, [0.0, 0.005], [lpmm], azimuths, defocus_mm=0.02 * plane, rings=6)
        assert got[:, plane] == pytest.approx(expected[:, 0], abs=1e-4)


def test_dark_spots_have_no_sharpness_but_raise_nothing() -> None:
    lens = load_lens("petzval_b").with_decenter(2, (0.0, 30.0))
    points, weight = pupil_quadrature(2)
    rays = trace(lens, [0.0, 0.0], points)
    assert scan_focus(rays, weight, 2, 5.0, [0.0], 850.0)[0, 0] == 0.0
    light, centroid_mm, _ = spot_means(rays, weight)
    assert light == 0.0
    assert np.all(np.isnan(centroid_mm))


def test_the_only_gap_of_two_lenses_follows_from_the_focal_length() -> None:
    design = optimise_gaps([AL2550, EO33950], GOAL, turn=False)
    assert paraxial(design.lens).focal_length_mm == pytest.approx(42.7, abs=1e-3)
    # 1/f = 1/f1 + 1/f2 - d/(f1 f2) between principal planes: a gap that is shorter is stronger.
    nearer = replace(design.lens, gaps_mm=(design.lens.gaps_mm[0] - 1.0, design.lens.gaps_mm[1]))
    assert 1 / 42.7 - 1 / paraxial(nearer).focal_length_mm == pytest.approx(
        -1.0 / (50.129 * 50.667), rel=1e-3
    )
    assert design.element is None
    assert design.shift_error_px == design.stroke_mm == 0.0
    assert design.mtf_moved == design.mtf_centred


@pytest.mark.slow
def test_the_optimum_is_the_studied_lens_or_better_and_all_neighbours_are_worse() -> None:
    studied = assess(replace(load_lens("petzval_a"), object_mm=3500.0), GOAL, 1, (False,) * 3)
    seen: list[tuple[int, int]] = []
    design = optimise_gaps(
        [AL2550, AL2550, EO45030],
        GOAL,
        element=1,
        on_progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(n, 8) for n in range(1, 9)]
    assert design.turned == (False, False, False)  # convex, convex, concave to the object
    assert design.mtf_moved > studied.mtf_moved
    assert design.meets(GOAL)
    assert not design.meets(replace(GOAL, mtf=0.99))
    assert design.lens.gaps_mm[-1] >= 2.0
    assert paraxial(design.lens).focal_length_mm == pytest.approx(42.7, abs=2e-4)
    best = worst_mtf(design.lens)
    for step_mm in (-0.4, 0.4):
        first_mm = design.lens.gaps_mm[0] + step_mm
        gaps_mm = np.array([first_mm, 0.0, 2.0])
        powers = []
        for gap_mm in (5.0, 6.0):  # the power is linear in the second gap
            gaps_mm[1] = gap_mm
            trial = replace(design.lens, gaps_mm=tuple(gaps_mm))
            powers.append(1.0 / paraxial(trial).focal_length_mm)
        gaps_mm[1] = 5.0 + (1 / 42.7 - powers[0]) / (powers[1] - powers[0])
        for back_mm in np.arange(2.0, 2.3, 0.01):
            gaps_mm[2] = back_mm
            assert worst_mtf(replace(design.lens, gaps_mm=tuple(gaps_mm))) < best + 5e-4


def worst_mtf(lens: Lens) -> float:
    """Return the least MTF over fields, azimuths and positions of the second element."""
    shares = np.array([(0.0, 0.0), (0.0, 0.6), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)])
    fields = shares * [1.24, 4.96] / image_per_field_mm(lens)
    moves_mm = np.concatenate([np.zeros((1, 2)), decenter_for_shift(lens, 1, QUARTERS, SENSOR)])
    build = moving(lens, 1, moves_mm[:, None])
    return float(fast_mtf(lens, fields, [6.45], np.arange(6) * math.pi / 6, build=build).min())


def test_the_back_focal_distance_is_kept() -> None:
    goal = replace(GOAL, back_focal_mm=3.5)
    near = optimise_gaps([AL2550, AL2550, EO45030], GOAL, turn=False)
    far = optimise_gaps([AL2550, AL2550, EO45030], goal, turn=False)
    assert far.lens.gaps_mm[-1] >= 3.5 > near.lens.gaps_mm[-1] >= 2.0
    assert far.mtf_centred < near.mtf_centred
    assert far.transmission == pytest.approx(1.0)


def test_a_cover_glass_moves_the_sensor_back_as_paraxial_rays_want() -> None:
    """By t (n - 1) / n, where spherical aberration of the plate is small."""
    window = cover_glass("N-BK7", 1.5)
    goal = replace(GOAL, stop=Stop(6.0), back_focal_mm=4.0)
    covered = replace(goal, cover=window, cover_mm=0.8)
    bare, glazed = (optimise_gaps([AL2550, EO33950], one, turn=False) for one in (goal, covered))
    index = refractive_index("N-BK7", 850.0)
    longer_mm = 1.5 * (index - 1.0) / index
    assert glazed.lens.elements[-1] == window
    assert glazed.lens.gaps_mm[-1] == 0.8
    assert glazed.back_focal_mm == pytest.approx(bare.back_focal_mm + longer_mm, abs=0.02)
    assert glazed.mtf_centred == pytest.approx(bare.mtf_centred, abs=0.01)
    assert paraxial(glazed.lens).focal_length_mm == pytest.approx(42.7, abs=1e-3)
    assert bare.meets(replace(goal, mtf=0.0))
    tight = replace(covered, back_focal_mm=glazed.back_focal_mm + 3.0)
    assert not glazed.meets(replace(tight, mtf=0.0))


@pytest.mark.parametrize("last", [LC1054, EO45030])
def test_a_cover_stands_clear_of_a_hollow_last_surface(last: Element) -> None:
    """Whose edge lies r - sqrt(r^2 - h^2) behind its vertex, farther than the cover would."""
    plate = cover_glass("N-BK7", 1.0)
    goal = replace(GOAL, focal_length_mm=60.0, stop=Stop(8.0), cover=plate, cover_mm=0.5)
    hollow = last.reversed()
    radius_mm, height_mm = hollow.surfaces[-1].radius_mm, hollow.surfaces[-1].semi_diameter_mm
    edge_mm = radius_mm - math.sqrt(radius_mm**2 - height_mm**2)
    assert edge_mm > goal.back_focal_mm - 1.5
    design = optimise_gaps([AL2550, hollow], goal, turn=False)
    assert design.lens.gaps_mm[1] >= edge_mm + goal.clearance_mm - 1e-4
    assert optimise_gaps([AL2550, last], goal).mtf_centred >= design.mtf_centred


def test_the_light_and_the_heat_of_the_goal_are_those_of_the_design() -> None:
    pair = [EO33950, AL2550]
    warm = optimise_gaps(pair, replace(GOAL, temperature_c=80.0), turn=False).lens
    assert warm.temperature_c == 80.0
    assert paraxial(warm).focal_length_mm == pytest.approx(42.7, abs=1e-3)
    assert paraxial(replace(warm, temperature_c=20.0)).focal_length_mm > 42.71  # dn/dT > 0
    small = replace(GOAL, grid=Grid((3, 5), (0.155, 0.155)))  # near the axis colour is all
    narrow, broad = (
        optimise_gaps(pair, replace(small, band=led_band(850.0, fwhm_nm)), turn=False)
        for fwhm_nm in (1.0, 120.0)
    )
    plain = optimise_gaps(pair, small, turn=False)
    assert narrow.mtf_centred == pytest.approx(plain.mtf_centred, abs=2e-3)
    assert broad.mtf_centred < narrow.mtf_centred - 0.01
    told = least_mtf(broad.lens, small.grid, band=led_band(850.0, 120.0))
    assert broad.mtf_centred == told[0]


def test_a_stop_between_elements_stays_there() -> None:
    goal = replace(GOAL, stop=Stop(18.0, 3.0), stop_behind=1, clearance_mm=0.5)
    design = optimise_gaps([AL2550, AL2550, EO45030], goal, turn=False)
    lens = design.lens
    assert lens.elements_before_stop() == 1
    assert lens.stop.position_mm == pytest.approx(lens.elements[0].length_mm + 3.0)
    assert lens.gaps_mm[0] >= 3.5
    assert paraxial(lens).focal_length_mm == pytest.approx(42.7, abs=1e-3)
    front = optimise_gaps([AL2550, AL2550, EO45030], GOAL, turn=False)
    assert design.mtf_centred > 0.5 * front.mtf_centred
    with pytest.raises(ValueError, match="behind fewer than 3 elements, got 3"):
        optimise_gaps([AL2550, AL2550, EO45030], replace(goal, stop_behind=3), turn=False)


def test_a_small_search_finds_the_sharper_pair() -> None:
    seen: list[tuple[int, int]] = []
    designs = search_stock(
        [[AL2550], [load_lens("eo33093"), AL2550], [EO45030]],
        GOAL,
        movers=[1],
        keep=2,
        on_progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(n, 18) for n in range(1, 19)]
    assert 1 <= len(designs) <= 2
    best = designs[0]
    assert [element.name for element in best.lens.elements] == [
        "Thorlabs AL2550", "Thorlabs AL2550", "Edmund 45030",
    ]  # fmt: skip
    assert best.turned == (False, False, False)
    assert best.meets(GOAL)
    table = format_designs(designs).splitlines()
    assert len(table) == 1 + len(designs)
    assert "126." in table[1]


def test_the_shipped_result_of_the_search_does_what_was_asked() -> None:
    lens = load_lens("petzval_search")
    data = paraxial(lens)
    assert data.focal_length_mm == pytest.approx(42.7, abs=5e-4)
    assert data.entrance_pupil_diameter_mm == pytest.approx(20.0)
    assert lens.object_mm == 3500.0
    assert lens.gaps_mm[-1] >= 2.0
    moves_mm = decenter_for_shift(lens, 1, QUARTERS, SENSOR)
    even = shift_uniformity(shift_map(lens, 1, moves_mm, SENSOR), QUARTERS)
    assert max(one.max_error_px for one in even) <= 0.01
    azimuths = np.linspace(0.0, np.pi, 4, endpoint=False)
    for move_mm in (np.zeros(2), *moves_mm):
        build = moving(lens, 1, move_mm)
        assert np.abs(exact_otf(lens, CORNER, [6.45], azimuths, build=build)).min() >= 0.90


@pytest.mark.slow
def test_the_example_makes_the_shipped_lens(tmp_path: Path) -> None:
    example = Path(__file__).resolve().parents[2] / "examples" / "design_petzval.py"
    path = tmp_path / "lens.toml"
    command = [sys.executable, "-W", "error", str(example), "--out", str(path), "--keep", "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "designs meet the goal" in done.stdout
    made, shipped = load_lens(path), load_lens("petzval_search")
    assert made.elements == shipped.elements
    assert made.gaps_mm == pytest.approx(shipped.gaps_mm, abs=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal_length_mm": -1.0}, "positive focal length"),
        ({"shift_px": 0.0}, "positive focal length, .* shift"),
        ({"clearance_mm": -0.1}, "clearance of at least 0 mm"),
        ({"stop": Stop(20.0, 3.0)}, "stop at or in front of the first vertex"),
        ({"stop": Stop(20.0, -3.0), "stop_behind": 1}, "expected the stop behind element 1"),
        ({"cover_mm": -1.0}, "cover_mm and stop_behind of at least 0"),
    ],
)
def test_goals_that_cannot_be(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(GOAL, **change)


def test_trains_that_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"reach a focal length of 42.7 mm .* in 4 orientations"):
        optimise_gaps([EO45030, EO45030], GOAL)
    with pytest.raises(ValueError, match=r"no wider than the lens beside it, 11\.43 mm, got 20 mm"):
        optimise_gaps([LC1054, AL2550], GOAL, turn=False)
    with pytest.raises(ValueError, match="2 to 5 elements, got 1"):
        optimise_gaps([AL2550], GOAL)
    with pytest.raises(ValueError, match="element from 0 to 1, got 2"):
        optimise_gaps([AL2550, EO45030], GOAL, element=2)
    with pytest.raises(ValueError, match="at least two places"):
        search_stock([[AL2550]], GOAL)
    with pytest.raises(ValueError, match="at least two places with lenses"):
        search_stock([[AL2550], []], GOAL)
    with pytest.raises(ValueError, match="a lens of one element, got Petzval A of 3"):
        search_stock([[AL2550], [load_lens("petzval_a")]], GOAL)
    with pytest.raises(ValueError, match="got none in 4 trains"):
        search_stock([[EO45030], [EO45030]], GOAL)
