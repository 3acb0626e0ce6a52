"""Ray fans, focal surfaces and illumination against Coddington, Petzval, Foote and conservation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lenses import perfect_lens

from lensshift.core.grid import Grid
from lensshift.optics.aberrations import (
    focal_surfaces,
    petzval_curvature_per_mm,
    ray_fan,
    relative_illumination,
    section_mtf,
    sections,
    sensor_fields,
)
from lensshift.optics.lens import Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.spots import image_per_field_mm, spots
from lensshift.optics.trace import trace

FIELDS = np.array([[0.0, 0.02], [0.03, 0.0], [0.02, -0.09]])


def curvatures(surface: Surface, height_mm: float) -> tuple[float, float, float]:
    """Return slope, and the curvatures in the section through the axis and across it."""
    c, k = surface.curvature_per_mm, surface.conic
    root = math.sqrt(1.0 - (1.0 + k) * c * c * height_mm**2)
    slope, bend = c * height_mm / root, c / root**3
    for power, a in enumerate(surface.asphere, start=2):
        slope += 2 * power * a * height_mm ** (2 * power - 1)
        bend += 2 * power * (2 * power - 1) * a * height_mm ** (2 * power - 2)
    long = math.sqrt(1.0 + slope * slope)
    across = slope / (height_mm * long) if height_mm else bend
    return slope, bend / long**3, across


def coddington_mm(lens: Lens, field_tan: float) -> tuple[float, float]:
    """Return both foci behind the sensor, along the axis, for a field along columns."""
    ray = trace(lens, [0.0, field_tan], np.zeros((1, 2)), crossings=True)
    assert ray.crossing_mm is not None
    met = [ray.crossing_mm[0, n, 1:] for n in range(ray.crossing_mm.shape[1])]
    met.append(np.array([ray.position_mm[0, 1], lens.positions_mm()[-1]]))
    surfaces = [surface for element in lens.elements for surface in element.surfaces]
    behind = [n for indices in lens.indices() for n in (*indices, 1.0)]
    direction = np.array([field_tan, 1.0]) / math.hypot(field_tan, 1.0)
    tangential = sagittal = 0.0  # one over the distance, negative: from where the light comes
    if math.isfinite(lens.object_mm):
        pupil_mm = paraxial(lens).entrance_pupil_mm
        source = np.array([-field_tan * (lens.object_mm + pupil_mm), -lens.object_mm])
        tangential = sagittal = -1.0 / float(np.linalg.norm(met[0] - source))
        direction = (met[0] - source) / np.linalg.norm(met[0] - source)
    before = 1.0
    for surface, n, here, there in zip(surfaces, behind, met[:-1], met[1:], strict=True):
        slope, c_t, c_s = curvatures(surface, float(here[0]))
        normal = np.array([-slope, 1.0]) / math.hypot(slope, 1.0)
        onward = (there - here) / np.linalg.norm(there - here)
        cos_in, cos_out = float(direction @ normal), float(onward @ normal)
        power = n * cos_out - before * cos_in
        tangential = (before * cos_in**2 * tangential + power * c_t) / (n * cos_out**2)
        sagittal = (before * sagittal + power * c_s) / n
        length_mm = float(np.linalg.norm(there - here))
        tangential = tangential / (1.0 - length_mm * tangential)
        sagittal = sagittal / (1.0 - length_mm * sagittal)
        direction, before = onward, n
    return float(direction[1]) / tangential, float(direction[1]) / sagittal


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b", "al2550", "eo33093"])
@pytest.mark.parametrize("object_mm", [3500.0, math.inf])
@pytest.mark.parametrize("stop", [Stop(10.0), Stop(6.0, -3.0)])
def test_focal_surfaces_are_those_of_coddington(name: str, object_mm: float, stop: Stop) -> None:
    lens = replace(load_lens(name), object_mm=object_mm, stop=stop)
    tangents = [0.005, 0.05, 0.1]
    found = focal_surfaces(lens, [[0.0, tangent] for tangent in tangents])
    wanted = np.array([coddington_mm(lens, tangent) for tangent in tangents])
    assert found.tangential_mm == pytest.approx(wanted[:, 0], abs=2e-6)
    assert found.sagittal_mm == pytest.approx(wanted[:, 1], abs=2e-6)
    turned = focal_surfaces(lens, [[tangent, 0.0] for tangent in tangents])
    assert turned.tangential_mm == pytest.approx(found.tangential_mm, abs=1e-8)


def test_an_interior_stop_is_aimed_through() -> None:
    lens = replace(load_lens("petzval_a"), stop=Stop(8.0, 20.0), object_mm=math.inf)
    found = focal_surfaces(lens, [0.0, 0.08])
    assert (found.tangential_mm, found.sagittal_mm) == pytest.approx(
        coddington_mm(lens, 0.08), abs=2e-6
    )


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b", "al2550"])
def test_in_third_order_the_petzval_surface_is_between_both(name: str) -> None:
    lens = replace(load_lens(name), object_mm=math.inf)
    lens = lens.with_sensor(paraxial(lens).image_mm)
    tangents = np.array([1e-6, 0.01, 0.02])
    found = focal_surfaces(lens, np.stack([0.0 * tangents, tangents], axis=-1))
    middle_mm = 0.5 * (3.0 * found.sagittal_mm - found.tangential_mm)
    bend = 2.0 * (middle_mm[1:] - middle_mm[0]) / (tangents[1:] * image_per_field_mm(lens)) ** 2
    at_axis = bend[0] - (bend[1] - bend[0]) / 3.0  # what is left of fifth order goes with field^2
    assert at_axis == pytest.approx(petzval_curvature_per_mm(lens), rel=2e-3)


def test_petzval_sums_of_a_lens_and_of_a_mirror() -> None:
    lens = perfect_lens()
    index, focal_mm = lens.indices()[0][0], paraxial(lens).focal_length_mm
    assert petzval_curvature_per_mm(lens) == pytest.approx(-1.0 / (index * focal_mm))
    mirror = replace(
        lens,
        elements=(replace(lens.elements[0], surfaces=(Surface(-100.0, mirror=True),), glass=(),
                          thickness_mm=()),),
        stop=Stop(5.0, -100.0),
    )  # fmt: skip
    # A stop in the centre of curvature sees the same mirror from everywhere: the image lies on a
    # sphere about it, of half the radius, and without astigmatism.
    assert petzval_curvature_per_mm(mirror) == pytest.approx(2.0 / 100.0)
    found = focal_surfaces(mirror.with_sensor(50.0), [0.0, 0.05])
    assert found.tangential_mm == pytest.approx(found.sagittal_mm, abs=1e-6)
    height_mm = 50.0 * math.sin(math.atan(0.05))
    assert found.sagittal_mm == pytest.approx(50.0 - math.sqrt(50.0**2 - height_mm**2), abs=1e-6)


@pytest.mark.parametrize("name", ["petzval_b", "al2550"])
def test_a_fan_leaves_the_chief_ray_by_its_defocus(name: str) -> None:
    lens = load_lens(name)
    near = 1e-3
    for field in FIELDS:
        fan, focus = ray_fan(lens, field, rays=2001), focal_surfaces(lens, field)
        for error_mm, focus_mm, along in zip(
            (fan.tangential_mm, fan.sagittal_mm),
            (focus.tangential_mm, focus.sagittal_mm),
            sections(field),
            strict=True,
        ):
            rays = trace(lens, field, np.outer([near, -near], along))
            slope = (rays.direction[:, :2] / rays.direction[:, 2:]) @ along
            wanted = -float(focus_mm) * (slope[0] - slope[1]) / (2.0 * near)
            got = (error_mm[1001] - error_mm[999]) / (fan.pupil[1001] - fan.pupil[999])
            assert got == pytest.approx(wanted, abs=1e-8)
            assert error_mm[1000] == pytest.approx(0.0, abs=1e-14)


def test_fans_of_a_lens_that_turns_turn_with_the_field() -> None:
    lens = load_lens("petzval_b")
    along_columns, aslant = ray_fan(lens, [[0.0, 0.1], [0.06, 0.08]]).tangential_mm
    assert aslant == pytest.approx(along_columns, abs=1e-10)
    sagittal = ray_fan(lens, [0.06, 0.08]).sagittal_mm
    assert sagittal == pytest.approx(-sagittal[::-1], abs=1e-10)
    perfect = ray_fan(perfect_lens(), [0.0, 0.0])
    assert np.abs(perfect.tangential_mm).max() < 1e-10
    assert ray_fan(lens, [0.0, 0.1], rays=3, wavelength_nm=900.0).pupil.tolist() == [-1, 0, 1]
    narrow = replace(lens, elements=(lens.elements[0],), gaps_mm=(20.0,), stop=Stop(20.0, -60.0))
    lost = ray_fan(narrow, [0.0, 0.1]).tangential_mm
    assert np.isnan(lost).any()
    assert np.isfinite(lost).any()
    with pytest.raises(ValueError, match="odd number of rays"):
        ray_fan(lens, [0.0, 0.0], rays=10)


def disc(distance_mm: float, height_mm: float, radius_mm: float) -> float:
    """Return the irradiance off the axis of a disc of radiance 1 (Foote, 1915)."""
    a, h, d = radius_mm**2, height_mm**2, distance_mm**2
    return 0.5 * math.pi * (1.0 - (d + h - a) / math.sqrt((d + h + a) ** 2 - 4.0 * a * h))


@pytest.mark.parametrize("radius_mm", [0.5, 6.0])
@pytest.mark.parametrize("object_mm", [400.0, math.inf])
def test_a_stop_behind_the_lens_lights_as_a_disc(radius_mm: float, object_mm: float) -> None:
    # Whatever lies in front of it: a point of the sensor sees a bright disc.
    singlet = load_lens("al2550")
    distance_mm = 30.0
    lens = replace(
        singlet, stop=Stop(2.0 * radius_mm, singlet.elements[0].length_mm + 12.0),
        gaps_mm=(12.0 + distance_mm,), object_mm=object_mm,
    )  # fmt: skip
    fields = np.array([[0.0, 0.03], [-0.04, 0.05], [0.0, -0.1]])
    chief_mm = trace(lens, fields, np.zeros((1, 2))).position_mm[:, 0]
    heights_mm = np.linalg.norm(chief_mm, axis=-1)
    found = relative_illumination(lens, fields)
    if radius_mm < 1.0:  # all rays of a field land together
        wanted = [disc(distance_mm, h, radius_mm) for h in heights_mm]
        wanted = np.array(wanted) / disc(distance_mm, 0.0, radius_mm)
        assert found == pytest.approx(wanted, rel=2e-4)
        cos = distance_mm / np.hypot(distance_mm, heights_mm)
        assert found == pytest.approx(cos**4, rel=1e-3)
    else:
        assert np.all(np.diff(found[[0, 1, 2]]) < 0)


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b"])
def test_light_is_conserved_behind_a_stop_in_front(name: str) -> None:
    # Through the stop comes cos^4 of it, spread over the area that the image takes.
    lens = replace(load_lens(name), object_mm=math.inf)
    step = 1e-4
    fields = np.array([[0.0, 0.0], [0.0, 0.05], [0.03, 0.1]])
    areas = []
    for field in fields:
        sides = field + step * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        at_mm = spots(lens, sides, rings=8).centroid_mm
        moved = np.stack([at_mm[0] - at_mm[1], at_mm[2] - at_mm[3]], axis=-1) / (2.0 * step)
        areas.append(abs(np.linalg.det(moved)))
    cos4 = (1.0 + np.sum(fields**2, axis=-1)) ** -2.0
    wanted = cos4 * areas[0] / np.array(areas)
    assert relative_illumination(lens, fields) == pytest.approx(wanted, abs=2e-3)
    assert wanted[-1] < 0.97


def test_vignetting_takes_its_share() -> None:
    # A window as wide as the stop, far in front: what passes is where two circles overlap.
    singlet, radius_mm, away_mm = load_lens("al2550"), 5.0, 40.0
    lenses = [
        replace(
            singlet,
            elements=(cover_glass("N-BK7", 0.1, edge_mm), *singlet.elements),
            gaps_mm=(away_mm + 1.0, *singlet.gaps_mm),
            stop=Stop(2.0 * radius_mm, 0.1 + away_mm),
            object_mm=math.inf,
        )
        for edge_mm in (math.inf, radius_mm)
    ]
    tangent = 0.1
    v = 0.5 * tangent * away_mm / radius_mm
    overlap = 2.0 / math.pi * (math.acos(v) - v * math.sqrt(1.0 - v * v))
    assert 0.4 < overlap < 0.6
    clear, cut = (relative_illumination(one, [0.0, tangent], rings=40) for one in lenses)
    assert cut / clear == pytest.approx(overlap, abs=0.01)


def test_sections_of_the_mtf() -> None:
    lens = load_lens("petzval_b")
    found = section_mtf(lens, [0.0, 0.11], [3.0, 6.0])
    assert found == pytest.approx(np.abs(exact_otf(lens, [0.0, 0.11], [3.0, 6.0])), abs=1e-12)
    turned = section_mtf(lens, [0.11, 0.0], [3.0, 6.0])
    assert turned == pytest.approx(found, abs=1e-3)
    assert found[0, 1] < found[1, 1]
    fields = sensor_fields(lens, Grid((16, 64), (0.155, 0.155)), [0.0, 1.0])
    assert spots(lens, fields[1], rings=2).centroid_mm == pytest.approx([1.24, 4.96], abs=1e-6)
