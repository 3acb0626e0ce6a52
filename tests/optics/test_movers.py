"""What moves the image besides decentred elements, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lenses import batoid_trace, pupil_grid

from lensshift.core.grid import Grid
from lensshift.optics.glass import refractive_index
from lensshift.optics.layout import layout
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.lens_file import format_lens, load_lens, parse_lens
from lensshift.optics.movers import wedge, which_mover, with_wedges
from lensshift.optics.paraxial import paraxial
from lensshift.optics.spots import image_per_field_mm, spots
from lensshift.optics.trace import Build, trace
from lensshift.optics.which import format_movers, which_element
from lensshift.optics.zmx import parse_zmx
from lensshift.optics.zmx_writer import format_zmx

INDEX = refractive_index("N-BK7", 850.0)
AXIS, MIDDLE = [0.0, 0.0], [[0.0, 0.0]]


@pytest.mark.slow
def test_all_movers_stand_in_one_table() -> None:
    lens, shift_px = load_lens("petzval_a"), 0.25
    grid = Grid((5, 9), (0.16, 0.15))
    movers = which_mover(lens, grid, shift_px=shift_px, frequency_lpmm=5.0)
    kinds = [mover.kind for mover in movers]
    assert kinds == ["decentre"] * 3 + ["tilt"] * 3 + ["plate", "wedges", "sensor"]
    lines = format_movers(movers).splitlines()
    assert len(lines) == 10
    assert len({len(line) for line in lines[1:]}) == 1
    *_, wedges, sensor = movers
    assert sensor.stroke_mm == pytest.approx(-shift_px * 0.15)
    assert (sensor.max_shift_error_px, sensor.mtf_loss) == (0.0, 0.0)
    # Weak wedges in front of the lens turn the view: hardly any loss.
    assert wedges.mtf_loss < 0.2 * min(one.mtf_loss for one in movers[:3])
    diagonal = math.hypot(0.16, 0.15)
    assert math.sin(math.radians(abs(wedges.stroke_deg))) == pytest.approx(
        0.5 * 0.15 / diagonal, rel=0.01
    )


def test_a_tilted_plate_shifts_by_its_closed_form() -> None:
    # A thin beam through a plate of thickness t: t sin a (1 - cos a / sqrt(n^2 - sin^2 a)).
    lens = replace(load_lens("al2550"), stop=Stop(0.5))
    lens = lens.with_sensor(paraxial(lens).image_mm)
    grid, shift_px = Grid((1, 1), (0.1, 0.1)), 0.25
    plate = next(m for m in which_mover(lens, grid, shift_px=shift_px) if m.kind == "plate")
    index = refractive_index("N-BK7", lens.wavelength_nm)
    sine = np.sin(np.deg2rad(plate.stroke_deg))
    cosine = np.sqrt(1.0 - sine**2)
    wanted_mm = sine * (1.0 - cosine / np.sqrt(index**2 - sine**2))
    assert abs(wanted_mm) == pytest.approx(shift_px * 0.1, rel=2e-4)
    assert plate.cross_talk_px < 1e-3


def test_where_n_bk7_is_dark_plate_and_wedges_are_of_the_glass_of_the_lens() -> None:
    infrared = Element((Surface(60.0), Surface(90.0)), ("GERMANIUM",), (3.0,), name="ge")
    lens = Lens((infrared,), (20.0,), Stop(8.0), wavelength_nm=10_000.0)
    lens = lens.with_sensor(paraxial(lens).image_mm)
    movers = {one.kind: one for one in which_mover(lens, Grid((1, 1), (0.05, 0.05)))}
    assert set(movers) == {"decentre", "tilt", "plate", "wedges", "sensor"}
    sine = math.sin(math.radians(movers["plate"].stroke_deg))
    index = refractive_index("GERMANIUM", 10_000.0)
    moved_mm = sine * (1.0 - math.sqrt(1.0 - sine**2) / math.sqrt(index**2 - sine**2))
    assert abs(moved_mm) == pytest.approx(0.25 * 0.05, rel=5e-3)


def test_a_mirror_is_not_tilted() -> None:
    """It would turn the image by twice the tilt, and all that is drawn behind it with it."""
    mirror = Element((Surface(-100.0, conic=-1.0, mirror=True),), (), (), name="mirror")
    lens = Lens((mirror,), (50.0,), Stop(10.0))
    movers = which_mover(lens, Grid((1, 1), (0.02, 0.02)))
    assert [one.kind for one in movers] == ["decentre", "plate", "wedges", "sensor"]
    with pytest.raises(ValueError, match="no tilt of element 1"):
        trace(lens, AXIS, MIDDLE, build=Build(tilt_rad=np.full((1, 2), 1e-3)))


@pytest.mark.parametrize("radius_mm", [-12.0, -50.0, 50.0])
def test_wedges_stand_clear_of_a_hollow_lens(radius_mm: float) -> None:
    """Its edge reaches 2.6 mm ahead of its vertex; a table of movers ended in `they overlap`."""
    front, back = Surface(radius_mm, semi_diameter_mm=7.5), Surface(-9.0, semi_diameter_mm=7.5)
    lens = Lens((Element((front, back), ("N-BK7",), (6.0,)),), (20.0,), Stop(3.0, 0.0))
    pair = with_wedges(lens, 1e-3, (0.0, math.pi))
    wedges, glass = pair.elements[:2], pair.elements[2]
    ahead_mm = pair.gaps_mm[1] + front.sag_mm(np.linspace(0.0, 7.5, 99)).min()
    assert ahead_mm == pytest.approx(1.0, abs=1e-9)
    assert (wedges[0].name, glass) == ("wedge", lens.elements[0])
    assert spots(pair, AXIS).centroid_mm == pytest.approx([0.0, 0.0], abs=2e-3)


@pytest.mark.parametrize("towards_deg", [0.0, 90.0, 217.0])
def test_a_wedge_turns_light_towards_its_thick_side(towards_deg: float) -> None:
    alpha, towards_rad, distance_mm = 0.02, math.radians(towards_deg), 30.0
    one = wedge("N-BK7", 2.0, alpha, towards_rad)
    ray = trace(Lens((one,), (distance_mm,), Stop(1.0)), AXIS, MIDDLE)
    turned = math.asin(INDEX * math.sin(alpha)) - alpha  # Snell at the side that leans
    assert turned == pytest.approx((INDEX - 1.0) * alpha, rel=1e-3)  # of a thin wedge
    there = np.array([math.sin(towards_rad), math.cos(towards_rad)])  # (row, col)
    assert ray.direction[0, :2] == pytest.approx(math.sin(turned) * there, abs=1e-12)
    assert ray.position_mm[0] == pytest.approx(distance_mm * math.tan(turned) * there, abs=1e-10)


def test_two_opposite_wedges_move_a_beam_by_deviation_times_distance() -> None:
    # All sides that lean are parallel: light leaves as it came, aside by d tan t between planes
    # that lean by alpha.
    alpha = 0.01
    pair = (wedge("N-BK7", 1.0, alpha, 0.0), wedge("N-BK7", 1.0, alpha, math.pi).reversed())
    near, far = (
        trace(Lens(pair, (apart_mm, 20.0), Stop(1.0)), AXIS, MIDDLE) for apart_mm in (5.0, 12.0)
    )
    shifted_mm = far.position_mm[0, 1] - near.position_mm[0, 1]
    slope = math.tan(math.asin(INDEX * math.sin(alpha)) - alpha)
    assert shifted_mm == pytest.approx(7.0 * slope / (1.0 - slope * math.tan(alpha)), abs=1e-10)
    assert shifted_mm == pytest.approx(7.0 * (INDEX - 1.0) * alpha, rel=3e-4)
    for rays in (near, far):
        assert rays.direction[0, :2] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_pair_that_turns_shifts_the_image_by_the_sum_of_its_wedges() -> None:
    lens = replace(load_lens("petzval_a"), object_mm=math.inf)
    alpha = 1e-3
    per_rad_mm = image_per_field_mm(lens)
    opposite = spots(with_wedges(lens, alpha, (0.0, math.pi)), AXIS, rings=4).centroid_mm
    assert opposite == pytest.approx([0.0, 0.0], abs=1e-6)
    for turn_rad in ((0.0, 0.0), (0.3, 1.4), (2.0, -2.5)):
        moved = spots(with_wedges(lens, alpha, turn_rad), AXIS, rings=4).centroid_mm
        wanted = sum(np.array([math.sin(at), math.cos(at)]) for at in turn_rad)
        assert moved == pytest.approx(
            per_rad_mm * (INDEX - 1.0) * alpha * wanted, rel=5e-3, abs=1e-5
        )
    riding = replace(lens, stop=Stop(18.0, -4.0, 0))
    kept = with_wedges(riding, alpha, (0.0, math.pi))
    assert kept.stop.rides_on == 2
    assert paraxial(kept).entrance_pupil_mm == pytest.approx(kept.stop.position_mm, abs=1.0)


LEANING = Element(
    (
        Surface(60.0, semi_diameter_mm=12.0, tilt_rad=(0.01, 0.0)),
        Surface(-70.0, semi_diameter_mm=12.0),
        Surface(-300.0, semi_diameter_mm=12.0, tilt_rad=(0.02, -0.03), conic=-2.0),
    ),
    ("N-BK7", "N-SF11"),
    (4.5, 2.0),
    tilt_rad=(0.01, 0.005),
    decenter_mm=(0.1, 0.2),
)


def leaning_lens() -> Lens:
    lens = load_lens("petzval_a")
    return replace(
        lens, elements=(LEANING, *lens.elements), gaps_mm=(2.0, *lens.gaps_mm),
        stop=Stop(12.0, 7.0),
    )  # fmt: skip


def test_leaning_surfaces_are_written_and_read_again() -> None:
    lens = leaning_lens()
    one = trace(lens, [[0.01, 0.03], AXIS], pupil_grid(5))
    assert one.passed.all()
    for back in (parse_zmx(format_zmx(lens)), parse_lens(format_lens(lens))):
        other = trace(back, [[0.01, 0.03], AXIS], pupil_grid(5))
        assert other.position_mm == pytest.approx(one.position_mm, abs=1e-9)
        assert other.path_mm == pytest.approx(one.path_mm, abs=1e-9)
    turned = replace(lens, elements=(LEANING.reversed(), *lens.elements[1:]))
    assert turned.elements[0].reversed() == LEANING
    with pytest.raises(ValueError, match="a mirror that leans with its whole element"):
        Surface(-50.0, mirror=True, tilt_rad=(0.1, 0.0))
    with pytest.raises(ValueError, match="overlap"):
        Element((Surface(math.inf, semi_diameter_mm=10.0),
                 Surface(math.inf, semi_diameter_mm=10.0, tilt_rad=(0.2, 0.0))),
                ("N-BK7",), (1.0,))  # fmt: skip


def test_rays_through_leaning_surfaces_agree_with_batoid() -> None:
    pytest.importorskip("batoid", reason="batoid is not installed")
    lens = replace(leaning_lens(), stop=Stop(12.0, 0.0), object_mm=math.inf)
    points, field = pupil_grid(9), np.array([0.02, -0.05])
    ours = trace(lens, field, points)
    direction = np.array([*field, 1.0]) / math.sqrt(1.0 + field @ field)
    origin = np.zeros((len(points), 3))
    origin[:, :2] = 6.0 * points
    origin = origin - 20.0 * direction
    position, cosines, _ = batoid_trace(lens, Build(), origin, np.tile(direction, (len(points), 1)))
    found = np.isfinite(position[:, 0])
    assert found.mean() > 0.9
    assert ours.position_mm[found] == pytest.approx(position[found], abs=1e-9)
    assert ours.direction[found] == pytest.approx(cosines[found], abs=1e-10)


def test_a_wedge_is_drawn_thicker_on_its_side() -> None:
    lens = load_lens("al2550")
    one = replace(wedge("N-BK7", 2.0, 0.1, 0.0), surfaces=tuple(
        replace(surface, semi_diameter_mm=8.0) for surface in wedge("N-BK7", 2.0, 0.1, 0.0).surfaces
    ))  # fmt: skip
    lens = replace(lens, elements=(one, *lens.elements), gaps_mm=(3.0, *lens.gaps_mm),
                   stop=Stop(10.0))  # fmt: skip
    front, back = layout(lens, field_tan=[0.0]).surfaces[0]
    upper, lower = (back.z_mm[n] - front.z_mm[n] for n in (-1, 0))
    assert upper - lower == pytest.approx(16.0 * math.sin(0.1), rel=1e-6)


@pytest.mark.parametrize("scale", [0.004, 10.0])
def test_movers_of_a_scaled_lens_are_scaled(scale: float) -> None:
    """A lens of 0.4 mm shifts as one of 100 mm; wedges find no room before a near object."""

    def lens(s: float) -> Lens:
        front, back = Surface(52.0 * s, semi_diameter_mm=6 * s), Surface(-310.0 * s)
        element = Element((front, back), ("N-BK7",), (3.0 * s,))
        return Lens((element,), (70.0 * s,), Stop(9.0 * s, -2.0 * s), object_mm=450.0 * s)

    grid, small = (Grid((8, 12), (0.2 * s, 0.2 * s)) for s in (1.0, scale))
    whole = {one.kind: one for one in which_mover(lens(1.0), grid)}
    found = {one.kind: one for one in which_mover(lens(scale), small)}
    assert ("wedges" in found) == (scale > 1)
    for kind in ("decentre", "tilt"):
        assert found[kind].stroke_mm == pytest.approx(scale * whole[kind].stroke_mm, rel=1e-5)
        assert found[kind].stroke_deg == pytest.approx(whole[kind].stroke_deg, rel=1e-5)
        wanted = whole[kind].max_shift_error_px
        assert found[kind].max_shift_error_px == pytest.approx(wanted, abs=1e-4)


def test_an_element_too_weak_to_make_the_shift_is_left_out() -> None:
    """A dome of next to no power would have to go where no light gets through."""
    lens = load_lens("al2550")
    thick_mm, gap_mm = 3.0, 8.0
    radii_mm = (60.0, 60.0 - thick_mm * (INDEX - 1.0) / INDEX)
    front, back = (Surface(radius_mm, semi_diameter_mm=25.0) for radius_mm in radii_mm)
    dome = Element((front, back), ("N-BK7",), (thick_mm,), name="dome")
    lens = replace(
        lens,
        elements=(dome, *lens.elements),
        gaps_mm=(gap_mm, *lens.gaps_mm),
        stop=replace(lens.stop, position_mm=lens.stop.position_mm + thick_mm + gap_mm),
    )
    movers = which_element(lens, Grid((1, 3), (0.1, 0.1)))
    assert [mover.element for mover in movers] == [1]
