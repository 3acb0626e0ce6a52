"""First-order data against the lensmaker's equation, the data sheets and traced rays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lenses import WAVELENGTH_NM

from lensshift.optics.glass import refractive_index
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.paraxial import (
    decenter_gains,
    focal_length_mm,
    paraxial,
)
from lensshift.optics.trace import Build, trace


@given(
    first_mm=st.floats(20.0, 200.0),
    second_mm=st.floats(-200.0, -20.0),
    thickness_mm=st.floats(1.0, 8.0),
)
def test_lensmakers_equation(first_mm: float, second_mm: float, thickness_mm: float) -> None:
    n = refractive_index("N-BK7", WAVELENGTH_NM)
    element = Element((Surface(first_mm), Surface(second_mm)), ("N-BK7",), (thickness_mm,))
    power = (n - 1.0) * (
        1.0 / first_mm - 1.0 / second_mm + (n - 1.0) * thickness_mm / (n * first_mm * second_mm)
    )
    assert focal_length_mm(element, (n,)) == pytest.approx(1.0 / power)
    data = paraxial(Lens((element,), (50.0,), Stop(5.0)))
    assert data.focal_length_mm == pytest.approx(1.0 / power)
    behind_mm = 1.0 / power * (1.0 - (n - 1.0) * thickness_mm / (n * first_mm))
    assert data.back_focal_mm == pytest.approx(behind_mm)


@pytest.mark.parametrize(
    ("name", "focal_mm"),
    [
        ("al2550", (49.46, 50.00, 50.13)),
        ("eo33944", (50.00, 50.57, 50.71)),
        ("eo33950", (50.02, 50.54, 50.67)),
        ("eo33093", (49.01, 49.55, 49.68)),
        ("lc1054", (-24.88, -25.16, -25.22)),
        ("lc4210", (-25.08, -25.35, -25.41)),
        ("eo45030", (-25.00, -25.62, -25.75)),
    ],
)
def test_stock_lenses_have_their_focal_lengths(name: str, focal_mm: tuple[float, ...]) -> None:
    lens = load_lens(name)
    computed = [paraxial(lens, nm).focal_length_mm for nm in (588.0, 780.0, 850.0)]
    assert computed == pytest.approx(focal_mm, abs=0.006)


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b"])
def test_the_paper_lens(name: str) -> None:
    lens = load_lens(name)
    data = paraxial(lens)
    assert data.focal_length_mm == pytest.approx(42.700, abs=0.005)
    assert data.entrance_pupil_diameter_mm == pytest.approx(20.0)
    assert data.entrance_pupil_mm == 0.0
    assert data.magnification == pytest.approx(-0.01246, abs=1e-6)
    assert data.working_f_number == pytest.approx(2.18, abs=0.005)


@pytest.mark.parametrize("stop", [Stop(10.0, -5.0), Stop(8.0, 20.0), Stop(6.0, 50.5)])
def test_traced_rays_near_the_axis_follow_the_paraxial_ones(stop: Stop) -> None:
    lens = replace(load_lens("petzval_a"), stop=stop)
    data = paraxial(lens)
    tiny = 1e-4
    rays = trace(lens.with_sensor(data.image_mm), [0.0, 0.0], [[0.0, 0.0], [tiny, 0.0]])
    assert rays.position_mm == pytest.approx(0.0, abs=1e-9)
    slope = abs(rays.direction[1, 0] / tiny)
    assert slope == pytest.approx(0.5 / data.working_f_number, rel=1e-6)
    # The exit pupil: where the chief ray of a small field appears to come from.
    chief = trace(lens, [tiny, 0.0], [[0.0, 0.0]])
    slope = chief.direction[0, 0] / chief.direction[0, 2]
    assert chief.position_mm[0, 0] / slope == pytest.approx(
        lens.gaps_mm[-1] - data.exit_pupil_mm, rel=1e-5
    )


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b"])
def test_decenter_gains_are_the_derivatives_of_traced_rays(name: str) -> None:
    lens = load_lens(name)
    lens = lens.with_sensor(paraxial(lens).image_mm)
    step_mm = 1e-4
    for element, gain in enumerate(decenter_gains(lens)):
        moves = np.zeros((3, 2))
        moves[element, 1] = step_mm
        rays = trace(lens, [0.0, 0.0], [[0.0, 0.0]], build=Build(decenter_mm=moves))
        assert rays.position_mm[0, 1] / step_mm == pytest.approx(gain, rel=1e-5)


def test_a_stop_in_the_front_focal_plane_makes_chief_rays_leave_along_the_axis() -> None:
    index, radius_mm, glass_mm, stop_mm = refractive_index("N-BK7", WAVELENGTH_NM), 51.0, 3.0, 4.0
    element = Element((Surface(radius_mm), Surface(math.inf)), ("N-BK7",), (glass_mm,))
    focal_mm = radius_mm / (index - 1.0)
    lens = Lens((element,), (focal_mm - glass_mm / index,), Stop(stop_mm, -focal_mm))
    data = paraxial(lens)
    assert data.exit_pupil_mm == data.exit_pupil_diameter_mm == math.inf
    assert data.focal_length_mm == pytest.approx(focal_mm)
    assert data.working_f_number == pytest.approx(focal_mm / stop_mm)
    # At twice the focal length the image is as large, and the cone is that of the stop.
    near = paraxial(replace(lens, object_mm=2.0 * focal_mm))
    assert near.magnification == pytest.approx(-1.0)
    assert near.working_f_number == pytest.approx(focal_mm / stop_mm)


def test_lenses_without_power_or_pupil() -> None:
    plate = cover_glass("N-BK7", 2.0)
    assert math.isinf(focal_length_mm(plate, (1.5,)))
    lens = Lens((plate,), (10.0,), Stop(5.0))
    with pytest.raises(ValueError, match="a lens with power"):
        paraxial(lens)
    assert decenter_gains(lens) == pytest.approx([0.0], abs=1e-15)
    thin = load_lens("al2550")
    relay = replace(thin.with_sensor(150.0), object_mm=100.0, stop=Stop(5.0, -100.0))
    with pytest.raises(ValueError, match="object away from the entrance pupil"):
        paraxial(relay)
    telecentric = load_lens("al2550")
    focus_mm = telecentric.elements[0].length_mm + paraxial(telecentric).back_focal_mm
    telecentric = replace(telecentric.with_sensor(60.0), stop=Stop(5.0, focus_mm))
    with pytest.raises(ValueError, match="stop is in a focal plane"):
        paraxial(telecentric)
