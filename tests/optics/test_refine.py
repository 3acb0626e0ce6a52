"""Design by least squares against closed forms: bending, colour, conics, heat; and its limits."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lenses import WAVELENGTH_NM, perfect_lens

from lensshift.core.errors import QualityWarning
from lensshift.core.grid import Grid
from lensshift.optics.glass import refractive_index
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import Band, fast_mtf, led_band
from lensshift.optics.otf import exact_mtf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.refine import ray_error_um, refine
from lensshift.optics.spots import distortion, spots
from lensshift.optics.task import Limits, Task
from lensshift.optics.variables import Freedom, Variables, is_plate
from lensshift.optics.which import edge_fields, least_mtf

AXIS = (0.0,)
SENSOR = Grid((11, 31), (0.02, 0.02))


def singlet(front_mm: float, back_mm: float, thick_mm: float, stop_mm: float) -> Lens:
    glass = Element((Surface(front_mm), Surface(back_mm)), ("N-BK7",), (thick_mm,))
    lens = Lens((glass,), (90.0,), Stop(stop_mm), wavelength_nm=WAVELENGTH_NM)
    return lens.with_sensor(paraxial(lens).image_mm)


@pytest.mark.parametrize("front_mm", [40.0, 200.0, -400.0])
def test_the_best_bending_of_a_thin_lens_is_the_one_of_coddington(front_mm: float) -> None:
    """Least spherical aberration of far points: q = 2 (n^2 - 1) / (n + 2)."""
    index = refractive_index("N-BK7", WAVELENGTH_NM)
    back_mm = 1.0 / (1.0 / front_mm - 1.0 / (100.0 * (index - 1.0)))
    lens = singlet(front_mm, back_mm, 0.5, 6.0)
    task = Task(SENSOR, 100.0, 16.0, Limits(edge_mm=0.0), shares=AXIS)
    found = refine(lens, task, Freedom())
    first, second = (surface.radius_mm for surface in found.elements[0].surfaces)
    shape = (second + first) / (second - first)
    assert shape == pytest.approx(2.0 * (index**2 - 1.0) / (index + 2.0), rel=0.01)
    assert paraxial(found).focal_length_mm == pytest.approx(100.0, rel=1e-4)
    assert paraxial(found).f_number == pytest.approx(16.0, rel=1e-4)


def test_a_doublet_of_two_glasses_becomes_achromatic() -> None:
    """Powers of thin lenses times the change of the index cancel."""
    surfaces = tuple(map(Surface, (60.0, -60.0, math.inf)))
    glass = Element(surfaces, ("N-BK7", "N-SF11"), (0.05, 0.05))
    lens = Lens((glass,), (100.0,), Stop(2.0), wavelength_nm=850.0)
    ends_nm = np.array([780.0, 920.0])
    task = Task(SENSOR, 100.0, 50.0, Limits(edge_mm=0.0, glass_mm=(0.01, 1.0)),
                band=Band(ends_nm, np.ones(2)), shares=AXIS)  # fmt: skip
    before, after = lens, refine(lens, task, Freedom())
    first, second, third = (surface.curvature_per_mm for surface in after.elements[0].surfaces)
    change = [
        refractive_index(name, ends_nm[0]) - refractive_index(name, ends_nm[1])
        for name in ("N-BK7", "N-SF11")
    ]
    colours = (first - second) * change[0], (second - third) * change[1]
    assert colours[0] == pytest.approx(-colours[1], rel=0.02)
    foci = [[paraxial(one, float(nm)).back_focal_mm for nm in ends_nm] for one in (before, after)]
    assert abs(np.diff(foci[1])[0]) < 0.02 * abs(np.diff(foci[0])[0])
    powers = [change[1], -change[0]]  # of a thin achromat, each times n - 1 over its curvatures
    share = powers[0] * (refractive_index("N-BK7", 850.0) - 1.0)
    share /= share + powers[1] * (refractive_index("N-SF11", 850.0) - 1.0)
    of_first = (first - second) * (refractive_index("N-BK7", 850.0) - 1.0)
    assert of_first == pytest.approx(share / 100.0, rel=0.02)


def test_the_conic_that_images_a_point_perfectly_is_found() -> None:
    known = perfect_lens()
    (front, back), index = known.elements[0].surfaces, known.indices()[0][0]
    for conic in (0.0, -1.0, -4.0):
        start = replace(known.elements[0], surfaces=(front, replace(back, conic=conic)))
        lens = replace(known, elements=(start,), gaps_mm=(49.0,))
        task = Task(SENSOR, 50.0, 2.5, shares=AXIS)
        found = refine(lens, task, Freedom(radii=False, conics=True))
        assert found.elements[0].surfaces[1].conic == pytest.approx(-(index**2), abs=1e-4)
        assert ray_error_um(found, task)[0] < 1e-3 < ray_error_um(lens, task)[0]
        assert found.gaps_mm[-1] == pytest.approx(known.gaps_mm[-1], abs=1e-4)


def test_a_known_lens_is_found_again_from_a_disturbed_one() -> None:
    """Radius and even terms of a hyperboloid behind a plane: those of its power series."""
    known = perfect_lens()
    (front, back), index = known.elements[0].surfaces, known.indices()[0][0]
    # c r^2 / (1 + sqrt(1 - b c^2 r^2)) with b = 1 - n^2: 1/2 c r^2 + 1/8 b c^3 r^4 + ..., on a
    # sphere, which has terms of its own, with b = 1.
    c, b = back.curvature_per_mm, 1.0 - index**2
    wanted = (b - 1.0) * c**3 / 8.0, (b**2 - 1.0) * c**5 / 16.0
    start = replace(known.elements[0], surfaces=(front, replace(back, radius_mm=-24.0, conic=0.0)))
    lens = replace(known, elements=(start,), gaps_mm=(47.0,))
    task = Task(SENSOR, 50.0, 5.0, shares=AXIS)
    found = refine(lens, task, Freedom(aspheres=3, planes=True), steps=200)
    assert ray_error_um(found, task)[0] < 0.01 < 1.0 < ray_error_um(lens, task)[0]
    front, back = found.elements[0].surfaces
    assert math.isinf(front.radius_mm)
    assert not any(front.asphere)
    assert back.curvature_per_mm == pytest.approx(c, rel=1e-5)
    assert back.asphere[0] == pytest.approx(wanted[0], rel=0.01)
    assert back.asphere[1] == pytest.approx(wanted[1], rel=0.2)


def test_the_sensor_stands_between_the_foci_of_two_temperatures() -> None:
    glass = Element((Surface(40.0), Surface(-40.0)), ("fused silica",), (3.0,))
    lens = Lens((glass,), (39.0,), Stop(4.0), wavelength_nm=WAVELENGTH_NM)
    task = Task(SENSOR, paraxial(lens).focal_length_mm, 10.0, shares=AXIS)
    only_gaps = Freedom(radii=False)
    cold, warm = (
        refine(replace(lens, temperature_c=t), task, only_gaps).gaps_mm[-1] for t in (0.0, 60.0)
    )
    both = replace(task, temperatures_c=(0.0, 60.0))
    found = refine(lens, both, only_gaps)
    assert abs(warm - cold) > 0.04
    assert found.gaps_mm[-1] == pytest.approx(0.5 * (warm + cold), abs=0.02 * abs(warm - cold))
    assert ray_error_um(found, both)[0] < ray_error_um(lens.with_sensor(cold), both)[0]


@pytest.mark.slow
def test_a_stock_lens_stays_whole_beside_one_that_is_made() -> None:
    stock = load_lens("al2550").elements[0]
    made = Element((Surface(60.0), Surface(300.0)), ("N-SF11",), (3.0,), name="made")
    plate = cover_glass("N-BK7", 1.0)
    lens = Lens((stock, made, plate), (6.0, 20.0, 0.5), Stop(16.0, 8.0),
                object_mm=3000.0, wavelength_nm=WAVELENGTH_NM)  # fmt: skip
    sensor = Grid((16, 33), (0.1, 0.12))
    limits = Limits(glass_mm=(1.5, 4.0), edge_mm=1.0, air_mm=0.2, back_focal_mm=0.4, track_mm=45.0)
    task = Task(sensor, 35.0, 2.2, limits)
    found = refine(lens, task, Freedom((1,), thicknesses=True, stop=True))
    assert found.elements[0] == stock
    assert found.elements[2].thickness_mm == plate.thickness_mm
    assert found.gaps_mm[2] == 0.5
    assert found.elements[1] != made
    assert found.elements_before_stop() == 1
    data = paraxial(found)
    assert data.focal_length_mm == pytest.approx(35.0, rel=2e-3)
    assert data.f_number == pytest.approx(2.2, rel=2e-3)
    assert 1.499 <= found.elements[1].thickness_mm[0] <= 4.001
    assert found.positions_mm()[-1] <= 45.01
    assert min(found.gaps_mm) > 0.19
    assert ray_error_um(found, task).max() < 0.5 * ray_error_um(lens, task).max()
    front, back = found.elements[1].surfaces
    high_mm = np.array([min(front.semi_diameter_mm, back.semi_diameter_mm)])
    edge_mm = found.elements[1].thickness_mm[0] + back.sag_mm(high_mm) - front.sag_mm(high_mm)
    assert edge_mm[0] >= 0.98


def test_vectors_are_lenses() -> None:
    lens = load_lens("petzval_a")
    heights = np.array([s.semi_diameter_mm for e in lens.elements for s in e.surfaces])
    freedom = Freedom((0, 2), thicknesses=True, conics=True, aspheres=3, aspheric=(0,))
    variables = Variables(lens, freedom, heights)
    start = variables.start()
    again = variables.lens(start)
    for one, other in zip(again.elements, lens.elements, strict=True):
        assert one.thickness_mm == pytest.approx(other.thickness_mm)
        for a, b in zip(one.surfaces, other.surfaces, strict=True):
            assert a.curvature_per_mm == pytest.approx(b.curvature_per_mm)
            assert a.conic == b.conic
            assert a.asphere[: len(b.asphere)] == pytest.approx(b.asphere)
    assert again.gaps_mm == pytest.approx(lens.gaps_mm)
    # Four curvatures; two conics and six terms of the first element; two thicknesses; gaps.
    assert len(start) == 4 + 2 + 6 + 2 + 3
    moved = variables.lens(start + 0.01)
    assert moved.elements[1].thickness_mm == lens.elements[1].thickness_mm
    assert moved.elements[1].surfaces[0].radius_mm == lens.elements[1].surfaces[0].radius_mm


def test_a_lens_that_limits_leave_no_room_for_is_told() -> None:
    lens = singlet(100.0, -100.0, 2.0, 6.0)
    task = Task(SENSOR, 100.0, 16.0, Limits(edge_mm=0.0, track_mm=30.0), shares=(0.0, 1.0))
    with pytest.warns(QualityWarning, match=r"its focal length is .* mm, not 100 mm"):
        refine(lens, task, Freedom(), steps=30)


def test_fields_without_light_are_not_sharp() -> None:
    front = Surface(6.0, semi_diameter_mm=1.0)
    lens = Lens((Element((front, Surface(-6.0)), ("N-BK7",), (2.0,)),), (5.0,), Stop(2.0, -9.0))
    wide = Task(Grid((9, 9), (2.0, 2.0)), 5.0, 5.0)
    found_um = ray_error_um(lens, wide)
    assert 0.0 < found_um[0] < math.inf
    assert found_um[-1] == math.inf


def test_what_cannot_be() -> None:
    lens, task = load_lens("petzval_a"), Task(SENSOR, 40.0, 2.0)
    with pytest.raises(ValueError, match="something that may change"):
        refine(lens, task, Freedom((), gaps=False))
    with pytest.raises(ValueError, match="element from 0 to 2, got 3"):
        refine(lens, task, Freedom((3,)))
    for terms in (-1, 40):
        with pytest.raises(ValueError, match=f"0 to 20 terms, got {terms}"):
            Freedom(aspheres=terms)
    first = lens.elements[0]
    hidden = replace(first.surfaces[0], inner_mm=2.0)
    dark = replace(first, surfaces=(hidden, *first.surfaces[1:]))
    with pytest.raises(ValueError, match="without obstructions"):
        refine(replace(lens, elements=(dark, *lens.elements[1:])), task, Freedom())
    with pytest.raises(ValueError, match="aspheres or conics"):
        Freedom(aspheric=(0,))
    with pytest.raises(ValueError, match=r"among those made, \[3\], got \[2\]"):
        Freedom((2,), aspheres=1, aspheric=(1,))
    for grow in ((), (2.0,), (0.7, 0.4), (0.0, 1.0)):
        with pytest.raises(ValueError, match="rising shares"):
            refine(lens, task, Freedom(), grow=grow)
    with pytest.raises(ValueError, match="glass_mm"):
        Limits(glass_mm=(5.0, 1.0))
    with pytest.raises(ValueError, match="limits of at least 0"):
        Limits(air_mm=-1.0)
    with pytest.raises(ValueError, match="positive focal length"):
        Task(SENSOR, -1.0, 2.0)


def test_the_shipped_wide_lens_does_what_was_asked() -> None:
    lens, grid = load_lens("wide_940"), Grid((240, 320), (0.015, 0.015))
    data = paraxial(lens)
    assert data.f_number == pytest.approx(1.2, rel=2e-3)
    wanted_mm = 0.5 * math.hypot(4.8, 3.6) / math.tan(math.radians(30.0))
    assert data.focal_length_mm == pytest.approx(wanted_mm, rel=1e-3)
    assert is_plate(lens.elements[-1])
    assert 0 < lens.elements_before_stop() < 6
    corner = edge_fields(lens, grid)[-1]
    seen_deg = 2.0 * math.degrees(math.atan(np.linalg.norm(corner)))
    assert 60.0 < seen_deg < 63.0
    assert abs(distortion(lens, corner)) < 0.052
    assert spots(lens, corner).transmission > 0.999
    light = led_band(940.0, 30.0, samples=3)
    assert least_mtf(lens, grid, frequency_lpmm=0.5 / 0.015, band=light)[0] > 0.78
    # The exact and the fast OTF come from different sums.
    fast = fast_mtf(lens, corner, [33.3], rings=16)
    assert exact_mtf(lens, corner, 33.3).modulation[0] == pytest.approx(fast[0, 0], abs=0.03)


@pytest.mark.slow
def test_the_example_makes_the_shipped_wide_lens(tmp_path: Path) -> None:
    example = Path(__file__).resolve().parents[2] / "examples" / "design_wide.py"
    path = tmp_path / "lens.toml"
    command = [sys.executable, "-W", "error", str(example), "--out", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    grid = Grid((240, 320), (0.015, 0.015))
    made, shipped = (
        least_mtf(lens, grid, frequency_lpmm=0.5 / 0.015)[0]
        for lens in (load_lens(path), load_lens("wide_940"))
    )
    assert made > shipped - 0.05
