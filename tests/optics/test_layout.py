"""Sections through lenses, and the grid of image points."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lenses import perfect_lens

from lensshift.core.grid import Grid
from lensshift.optics.layout import distortion_grid, layout
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.spots import distortion, fields_for_image
from lensshift.optics.trace import trace

SENSOR = Grid((16, 64), (0.155, 0.155))
EDGE = math.tan(math.radians(6.5))


def test_surfaces_lie_where_the_prescription_puts_them() -> None:
    lens = load_lens("petzval_a")
    drawn = layout(lens)
    assert drawn.names == tuple(element.name for element in lens.elements)
    number = 0
    vertices_mm = np.cumsum([0.0, 6.0, 29.071, 6.0, 5.5676, 3.5])
    for element, lines in zip(lens.elements, drawn.surfaces, strict=True):
        for surface, line in zip(element.surfaces, lines, strict=True):
            expected = vertices_mm[number] + surface.sag_mm(line.height_mm)
            assert line.z_mm == pytest.approx(expected, abs=1e-12)
            assert np.ptp(line.height_mm) == pytest.approx(2 * surface.semi_diameter_mm)
            number += 1
    for outline in drawn.outlines:
        assert (outline.z_mm[0], outline.height_mm[0]) == (outline.z_mm[-1], outline.height_mm[-1])
    assert drawn.stop[0].height_mm[0] == -10.0
    assert drawn.stop[1].height_mm[0] == 10.0
    assert drawn.sensor.z_mm == pytest.approx(lens.positions_mm()[-1])


@pytest.mark.parametrize("axis", ["row", "col"])
def test_rays_bend_at_the_surfaces_only_and_by_the_law_of_refraction(axis: str) -> None:
    lens = load_lens("petzval_a")
    drawn = layout(lens, 0, (0.3, -0.4), axis=axis, rays=3)
    index = [1.0, *(n for one in lens.indices() for n in (*one, 1.0))]
    # Within the section of an element that is moved in this section only, Snell's law is plane.
    moved = layout(lens, 0, (0.0, -0.4) if axis == "col" else (0.3, 0.0), axis=axis, rays=3)
    decenter_mm = [-0.4 if axis == "col" else 0.3, 0.0, 0.0]
    assert len(drawn.rays) == len(moved.rays) == 6
    for ray in moved.rays:
        assert ray.arrived
        z, h = ray.line.z_mm, ray.line.height_mm
        assert len(z) == 8
        angle = np.arctan2(np.diff(h), np.diff(z))
        surfaces = [s for element in lens.elements for s in element.surfaces]
        for i, surface in enumerate(surfaces):
            r = h[i + 1] - decenter_mm[i // 2]
            step = 1e-5
            slope = np.diff(surface.sag_mm(np.array([r - step, r + step])))[0] / (2 * step)
            normal = math.atan(-slope)
            before, after = np.sin(angle[i : i + 2] - normal)
            assert index[i] * before == pytest.approx(index[i + 1] * after, abs=1e-8)


def test_rays_come_from_the_object_and_reach_the_traced_image() -> None:
    lens = load_lens("petzval_b")
    drawn = layout(lens, rays=1, field_tan=[EDGE], lead_mm=25.0)
    (ray,) = drawn.rays
    assert ray.line.z_mm[0] == -25.0
    slope = np.diff(ray.line.height_mm[:2])[0] / np.diff(ray.line.z_mm[:2])[0]
    object_mm = ray.line.height_mm[0] + slope * (-lens.object_mm + 25.0)
    assert object_mm == pytest.approx(-EDGE * lens.object_mm)
    image_mm = trace(lens, [0.0, EDGE], [[0.0, 0.0]]).position_mm[0, 1]
    assert ray.line.height_mm[-1] == image_mm
    far = layout(replace(lens, object_mm=math.inf), rays=2, field_tan=[EDGE]).rays
    for one in far:
        assert np.diff(one.line.height_mm[:2]) == pytest.approx(EDGE * np.diff(one.line.z_mm[:2]))


def test_tilted_elements_turn_about_their_first_vertex() -> None:
    plate = cover_glass("N-BK7", 4.0, 5.0)
    lens = Lens((plate,), (20.0,), Stop(4.0)).with_tilt(0, (0.0, 0.2)).with_decenter(0, (0.0, 1.0))
    front, back = layout(lens).surfaces[0]
    assert front.z_mm[16] == pytest.approx(0.0)
    assert front.height_mm[16] == pytest.approx(1.0)
    assert np.diff(front.height_mm) / np.diff(front.z_mm) == pytest.approx(-1 / math.tan(0.2))
    distance = np.hypot(back.z_mm - front.z_mm, back.height_mm - front.height_mm)
    assert distance == pytest.approx(4.0)
    assert back.height_mm[16] == pytest.approx(1.0 + 4.0 * math.sin(0.2))
    # The same tilt seen from the other side of the sensor is no lean.
    assert layout(lens, axis="row").surfaces[0][0].z_mm == pytest.approx(0.0)


def test_lost_rays_end_where_they_are_lost() -> None:
    lens = load_lens("petzval_b").with_decenter(2, (0.0, 5.0))
    drawn = layout(lens, field_tan=[0.0], rays=9)
    lost = [ray for ray in drawn.rays if not ray.arrived]
    assert 0 < len(lost) < 9
    for ray in lost:
        assert len(ray.line.z_mm) in (6, 7)  # before the lens, four surfaces, one or two more
        assert ray.line.z_mm[-1] < drawn.sensor.z_mm[0]
    ball = Element((Surface(5.0), Surface(-5.0)), ("N-BK7",), (10.0,))
    wide = layout(Lens((ball,), (5.0,), Stop(12.0, -2.0)), field_tan=[0.0], rays=5)
    assert len(wide.rays) == 3  # the outer two never meet glass


def test_surfaces_without_an_edge_are_drawn_as_far_as_rays_go() -> None:
    drawn = layout(perfect_lens(stop_mm=20.0), field_tan=[0.0])
    for line in drawn.surfaces[0]:
        assert 10.0 < np.abs(line.height_mm).max() < 12.0


def test_distortion_grid_agrees_with_distortion_and_its_inverse() -> None:
    lens = load_lens("petzval_b")
    got = distortion_grid(lens, SENSOR, (3, 5))
    assert got.paraxial_mm.shape == (3, 5, 2)
    assert got.paraxial_mm[0, 0] == pytest.approx([-1.24, -4.96])
    assert got.real_mm[1, 2] == pytest.approx([0.0, 0.0], abs=1e-12)
    fields = fields_for_image(lens, got.real_mm, rings=4)
    radial = np.linalg.norm(got.real_mm, axis=-1) / np.maximum(
        np.linalg.norm(got.paraxial_mm, axis=-1), 1e-9
    )
    edge = np.linalg.norm(fields, axis=-1) > 0.01
    assert radial[edge] - 1.0 == pytest.approx(distortion(lens, fields[edge]), abs=1e-7)
    assert got.error_px * 0.155 == pytest.approx(got.real_mm - got.paraxial_mm)
    # The studied 0.69 px of this build, at the corner.
    assert np.linalg.norm(got.error_px, axis=-1).max() == pytest.approx(0.69, abs=0.02)
    moved = distortion_grid(lens, SENSOR, (3, 5), element=0, decenter_mm=(0.0, 0.0441))
    assert (moved.error_px - got.error_px)[1, 2] == pytest.approx([0.0, 0.25], abs=1e-3)


def test_wrong_requests() -> None:
    lens = load_lens("petzval_a")
    with pytest.raises(ValueError, match="axis 'row' or 'col', got 'x'"):
        layout(lens, axis="x")
    with pytest.raises(ValueError, match="at least 1 ray"):
        layout(lens, rays=0)
    with pytest.raises(ValueError, match="element from 0 to 2, got 3"):
        layout(lens, 3)
    with pytest.raises(ValueError, match="finite field_tan"):
        layout(lens, field_tan=[math.nan])
    with pytest.raises(ValueError, match="at least 2 x 2 points"):
        distortion_grid(lens, SENSOR, (1, 5))
