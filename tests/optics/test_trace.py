"""The ray trace against closed forms, symmetry and another program."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lenses import PLANE, WAVELENGTH_NM, batoid_trace, perfect_lens, pupil_grid

from lensshift.optics.glass import refractive_index
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.paraxial import paraxial
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.spots import fields_for_image, spots, wavefront
from lensshift.optics.trace import Build, trace

EDGE = math.tan(math.radians(6.5))


def test_hyperbola_images_without_spherical_aberration() -> None:
    lens = perfect_lens()
    points, _ = pupil_quadrature(6)
    rays = trace(lens, [0.0, 0.0], points)
    assert rays.position_mm == pytest.approx(0.0, abs=1e-11)
    assert np.ptp(rays.path_mm) < 1e-11
    assert wavefront(lens, [0.0, 0.0]).rms_waves < 1e-8


def test_asphere_that_repeats_the_conic_traces_alike() -> None:
    # A paraboloid is z = r^2 / (2 R): as a conic, and as a sphere plus its aspheric terms the same.
    radius_mm, height = 40.0, np.array([[0.0, 0.3], [0.5, -0.8]])
    c = 1.0 / radius_mm
    # Expansion of c r^2/2 - sphere: terms of the binomial series of the sphere's sag.
    terms = [-(c**3) / 8, -(c**5) / 16, -5 * c**7 / 128, -7 * c**9 / 256, -21 * c**11 / 1024]
    stop = Stop(10.0)
    conic = Element((Surface(radius_mm, -1.0), PLANE), ("N-BK7",), (4.0,))
    series = Element((Surface(radius_mm, 0.0, tuple(terms)), PLANE), ("N-BK7",), (4.0,))
    first = trace(Lens((conic,), (70.0,), stop), [0.02, 0.05], height)
    second = trace(Lens((series,), (70.0,), stop), [0.02, 0.05], height)
    assert first.position_mm == pytest.approx(second.position_mm, abs=1e-8)
    assert first.path_mm == pytest.approx(second.path_mm, abs=1e-8)


def test_tilted_plate_shifts_the_beam_by_the_closed_form() -> None:
    thickness_mm, angle = 5.0, 0.3
    lens = Lens((cover_glass("N-BK7", thickness_mm),), (20.0,), Stop(4.0))
    index = refractive_index("N-BK7", WAVELENGTH_NM)
    root = math.sqrt(index**2 - math.sin(angle) ** 2)
    moved_mm = thickness_mm * math.sin(angle) * (1.0 - math.cos(angle) / root)
    points = pupil_grid(5)
    straight = trace(lens, [0.0, 0.0], points)
    for axis in (0, 1):
        tilt_rad = np.zeros((1, 2))
        tilt_rad[0, axis] = angle
        rays = trace(lens, [0.0, 0.0], points, build=Build(tilt_rad=tilt_rad))
        expected = straight.position_mm.copy()
        expected[..., axis] += moved_mm  # the refracted ray leans as the axis does
        assert rays.position_mm == pytest.approx(expected, abs=1e-12)
        assert rays.direction == pytest.approx(straight.direction, abs=1e-14)


def test_rays_beyond_the_critical_angle_are_reflected_and_counted() -> None:
    index = refractive_index("N-BK7", WAVELENGTH_NM)
    radius_mm = 10.0
    element = Element((PLANE, Surface(-radius_mm)), ("N-BK7",), (15.0,))
    lens = Lens((element,), (5.0,), Stop(19.0))
    rows = np.linspace(-1.0, 1.0, 201)
    rays = trace(lens, [0.0, 0.0], np.stack([rows, 0.0 * rows], axis=-1))
    beyond = np.abs(rows) * 9.5 > radius_mm / index
    assert np.array_equal(rays.status == 2, beyond)
    assert np.all(rays.failed_at[beyond] == 1)
    assert np.all(np.isnan(rays.position_mm[beyond]))
    assert np.all(np.isfinite(rays.position_mm[~beyond]))
    counts = rays.counts()
    assert counts["reflected"] == beyond.sum() > 0
    assert counts["passed"] == (~beyond).sum()


def test_rays_beside_a_ball_miss_it() -> None:
    element = Element((Surface(5.0), Surface(-5.0)), ("N-BK7",), (10.0,))
    lens = Lens((element,), (5.0,), Stop(12.0, position_mm=-2.0))
    rows = np.linspace(-1.0, 1.0, 101)
    rays = trace(lens, [0.0, 0.0], np.stack([0.0 * rows, rows], axis=-1))
    assert np.array_equal(rays.status == 1, np.abs(rows) * 6.0 > 5.0)
    assert set(rays.failed_at[rays.status == 1]) == {0}


def test_rays_outside_a_semi_diameter_are_vignetted_but_traced() -> None:
    lens = Lens(
        (Element((Surface(60.0), replace(PLANE, semi_diameter_mm=4.0)), ("N-BK7",), (3.0,)),),
        (100.0,),
        Stop(10.0),
    )
    rays = trace(lens, [0.0, 0.0], pupil_grid(21), heights=True)
    assert rays.heights is not None
    outside = rays.heights[:, 1] > 1.0
    assert outside.any()
    assert np.array_equal(rays.status == 3, outside)
    assert set(rays.failed_at[outside]) == {1}
    assert np.all(np.isfinite(rays.position_mm))


def test_leading_axes_broadcast_and_equal_single_traces() -> None:
    lens = load_lens("petzval_a")
    rng = np.random.default_rng(1)
    fields = rng.uniform(-0.1, 0.1, (5, 2))
    decenter = rng.uniform(-0.1, 0.1, (3, 1, 3, 2))
    tilt = rng.uniform(-0.01, 0.01, (2, 1, 1, 3, 2))
    factor = rng.uniform(0.99, 1.01, (3, 1, 3))
    gap = rng.uniform(-0.05, 0.05, (2, 1, 1, 3))
    points, _ = pupil_quadrature(2)
    rays = trace(lens, fields, points, build=Build(decenter, tilt, gap, factor))
    assert rays.position_mm.shape == (2, 3, 5, len(points), 2)
    one = trace(
        lens,
        fields[4],
        points,
        build=Build(decenter[2, 0], tilt[1, 0, 0], gap[1, 0, 0], factor[2, 0]),
    )
    assert np.array_equal(rays.position_mm[1, 2, 4], one.position_mm)
    assert np.array_equal(rays.path_mm[1, 2, 4], one.path_mm)


def test_deviations_of_a_build_equal_a_changed_lens() -> None:
    lens = load_lens("petzval_b")
    points, _ = pupil_quadrature(3)
    changed = lens.with_decenter(1, (0.03, -0.1)).with_tilt(2, (0.01, 0.02))
    changed = replace(changed, gaps_mm=tuple(np.add(lens.gaps_mm, (0.1, -0.05, 0.02))))
    decenter, tilt = np.zeros((3, 2)), np.zeros((3, 2))
    decenter[1], tilt[2] = (0.03, -0.1), (0.01, 0.02)
    build = Build(decenter, tilt, np.array([0.1, -0.05, 0.02]))
    first = trace(changed, [0.02, 0.1], points)
    second = trace(lens, [0.02, 0.1], points, build=build)
    assert first.position_mm == pytest.approx(second.position_mm, abs=1e-11)
    assert first.path_mm == pytest.approx(second.path_mm, abs=1e-9)


@settings(max_examples=15)
@given(
    field=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    move=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    lean=st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
)
def test_mirror_images_trace_to_mirror_images(
    field: tuple[float, float], move: tuple[float, float], lean: tuple[float, float]
) -> None:
    lens = load_lens("petzval_a").with_decenter(0, move).with_tilt(1, lean)
    mirrored = load_lens("petzval_a").with_decenter(0, (move[0], -move[1]))
    mirrored = mirrored.with_tilt(1, (lean[0], -lean[1]))
    points = pupil_grid(4)
    flip = np.array([1.0, -1.0])
    first = trace(lens, field, points).position_mm
    second = trace(mirrored, field * flip, points * flip).position_mm
    assert second == pytest.approx(first * flip, abs=1e-12)


def test_moving_everything_moves_the_image_of_an_infinitely_far_object() -> None:
    lens = replace(load_lens("petzval_a"), object_mm=math.inf)
    lens = replace(lens, stop=replace(lens.stop, rides_on=0))
    points, _ = pupil_quadrature(2)
    move = np.array([0.05, -0.2])
    moved = trace(lens, [0.03, 0.1], points, build=Build(decenter_mm=np.tile(move, (3, 1))))
    rest = trace(lens, [0.03, 0.1], points)
    assert moved.position_mm == pytest.approx(rest.position_mm + move, abs=1e-12)


@pytest.mark.parametrize(("position_mm", "before"), [(20.0, 1), (34.0, 1), (44.5, 2)])
@pytest.mark.parametrize("object_mm", [math.inf, 3500.0])
def test_rays_pass_an_inner_stop_where_they_should(
    position_mm: float, before: int, object_mm: float
) -> None:
    lens = load_lens("petzval_b").with_decenter(0, (0.1, -0.2)).with_tilt(0, (0.01, 0.02))
    # A plate right behind the stop tells where the rays cross it.
    plate = cover_glass("N-BK7", 0.2, semi_diameter_mm=2.0)
    gap_mm = position_mm - lens.positions_mm()[before - 1] - lens.elements[before - 1].length_mm
    lens = Lens(
        (*lens.elements[:before], plate, *lens.elements[before:]),
        (
            *lens.gaps_mm[: before - 1],
            gap_mm,
            lens.gaps_mm[before - 1] - gap_mm - 0.2,
            *lens.gaps_mm[before:],
        ),
        Stop(4.0, position_mm),
        object_mm,
    )
    points = pupil_grid(5)
    rays = trace(lens, [0.02, 0.05], points, heights=True)
    assert rays.heights is not None
    crossed = rays.heights[:, 2 * before]
    assert crossed == pytest.approx(np.linalg.norm(points, axis=1), abs=1e-9)


def _launched(lens: Lens, field: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins on the object plane and directions of rays to a stop at the first vertex."""
    target = np.zeros((len(points), 3))
    target[:, :2] = 0.5 * lens.stop.diameter_mm * points
    origin = np.tile([*(-field * lens.object_mm), -lens.object_mm], (len(points), 1))
    direction = target - origin
    return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True)


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b"])
@pytest.mark.parametrize("case", ["centred", "first moved", "third moved", "all tilted"])
def test_rays_and_paths_agree_with_batoid(name: str, case: str) -> None:
    pytest.importorskip("batoid")
    lens = load_lens(name)
    decenter, tilt = np.zeros((3, 2)), np.zeros((3, 2))
    if case == "first moved":
        decenter[0] = (0.01, 0.044378)
    elif case == "third moved":
        decenter[2] = (0.1, -0.232492)
    elif case == "all tilted":
        decenter[1] = (-0.05, 0.02)
        tilt[:] = np.radians([[0.5, 0.3], [-0.5, 0.4], [0.2, -0.5]])
    build = Build(decenter_mm=decenter, tilt_rad=tilt)
    points = pupil_grid(9)
    for field in np.array([[0.0, 0.0], [0.0, EDGE], [-0.028, EDGE]]):
        ours = trace(lens, field, points, build=build)
        position, direction, path = batoid_trace(lens, build, *_launched(lens, field, points))
        found = np.isfinite(path)  # its search fails for single rays
        assert np.mean(found) > 0.9
        assert ours.position_mm[found] == pytest.approx(position[found], abs=1e-9)
        assert ours.direction[found] == pytest.approx(direction[found], abs=1e-10)
        assert ours.path_mm[found] == pytest.approx(path[found], abs=1e-8)  # 1e-5 waves


def test_the_paper_lens_traces_to_the_rays_of_five_programs() -> None:
    # Real chief rays at the sensor; sensor and gaps were rounded to 0.1 um since.
    lens = load_lens("petzval_a")
    for element, move_mm, field, image_mm in (
        (0, 0.044378, 0.0, 0.038449),
        (0, 0.044378, EDGE, 5.025102),
        (2, -0.232492, EDGE, 5.030681),
        (0, 0.044378, -EDGE, -4.944580),
        (2, -0.232492, -EDGE, -4.940033),
    ):
        moved = lens.with_decenter(element, (0.0, move_mm))
        rays = trace(moved, [0.0, field], [[0.0, 0.0]])
        assert rays.position_mm[0, 1] == pytest.approx(image_mm, abs=2e-5)


def test_catalogue_back_focal_distance_at_780_nm() -> None:
    lens = load_lens("al2550")
    assert paraxial(lens).back_focal_mm == pytest.approx(46.031233, abs=1e-5)
    # The design has no spherical aberration over the clear aperture.
    assert spots(lens, [0.0, 0.0]).rms_radius_mm < 2e-6


@pytest.mark.parametrize(("move_mm", "how"), [(30.0, "miss it"), (11.5, "lie outside its semi")])
def test_a_lens_that_loses_every_ray_says_where(move_mm: float, how: str) -> None:
    lens = load_lens("petzval_b").with_decenter(2, (0.0, move_mm))
    with pytest.raises(ValueError, match=rf"no ray of 1 of 1 fields.*surface 1 of .*LC1054.*{how}"):
        spots(lens, [0.0, 0.0])


@pytest.mark.parametrize(
    ("field", "points", "build", "message"),
    [
        ([0.0], [[0.0, 0.0]], None, "finite field_tan"),
        ([0.0, math.nan], [[0.0, 0.0]], None, "finite field_tan"),
        ([0.0, 0.0], [0.0, 0.0], None, r"pupil \[ray 2\]"),
        ([0.0, 0.0], [[0.0, 0.0]], Build(np.zeros((2, 2))), r"decenter_mm \[... 3 2\]"),
        ([0.0, 0.0], [[0.0, 0.0]], Build(gap_mm=np.zeros(2)), r"gap_mm \[... 3\]"),
        ([[0.0, 0.0]] * 2, [[0.0, 0.0]], Build(np.zeros((3, 3, 2))), "broadcast"),
    ],
)
def test_wrong_shapes(field: list, points: list, build: Build | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        trace(load_lens("petzval_a"), field, points, build=build)


@pytest.mark.parametrize("rings", [1, 2, 4])
def test_pupil_quadrature_integrates_polynomials(rings: int) -> None:
    points, weight = pupil_quadrature(rings)
    row, col = points.T
    assert weight.sum() == pytest.approx(1.0)
    # mean of r^2n over the disc is 1 / (n + 1), of row^2 half that of r^2.
    for n in range(2 * rings):
        assert weight @ (row**2 + col**2) ** n == pytest.approx(1.0 / (n + 1))
    assert weight @ row**2 == pytest.approx(0.25)
    assert weight @ (row * col) == pytest.approx(0.0, abs=1e-15)
    with pytest.raises(ValueError, match="at least 1 ring"):
        pupil_quadrature(0)


def test_a_hypercentric_lens_images_one_to_one() -> None:
    """A stop behind the focus is seen in front of the object; at 2 f and 2 f the image is -1."""
    radius_mm = 200.0 * (refractive_index("N-BK7", 850.0) - 1.0)
    thin = Element((Surface(radius_mm), Surface(-radius_mm)), ("N-BK7",), (0.01,))
    lens = Lens((thin,), (200.0,), Stop(2.0, 150.0), object_mm=200.0)
    pupil_mm = paraxial(lens).entrance_pupil_mm
    assert pupil_mm == pytest.approx(-300.0, abs=0.1)
    height_mm = 0.05
    rays = trace(lens, [0.0, -height_mm / (200.0 + pupil_mm)], [[0.0, 0.0], [0.1, 0.0]])
    assert rays.position_mm[:, 1] == pytest.approx(-height_mm, rel=1e-3)
    assert np.ptp(rays.path_mm) < 1e-6  # all ways to an image are equally long


def test_a_wide_field_reaches_the_inner_stop_as_light_that_goes_back() -> None:
    """At 75 degrees the pupil has moved by many times its size: rays backwards tell where to."""
    outer = Element((Surface(40.0, semi_diameter_mm=30.0), Surface(10.0)), ("N-BK7",), (1.5,))
    inner = Element((Surface(40.0), Surface(7.0)), ("N-BK7",), (1.0,))
    thick = Element((Surface(15.0), Surface(-12.0)), ("N-SF11",), (4.0,))
    back = Element((Surface(30.0), Surface(-10.0)), ("N-BK7",), (3.0,))
    front, gaps_mm, to_stop_mm = (outer, inner, thick), (11.0, 9.0), 1.0
    stop = Stop(2.0, sum(e.length_mm for e in front) + sum(gaps_mm) + to_stop_mm)
    lens = Lens((*front, back), (*gaps_mm, 2.0, 6.0), stop)
    at_mm = np.array([0.3, -0.5])  # in the stop: the object of the lens that is turned round
    turned = Lens(
        tuple(e.reversed() for e in front[::-1]), (*gaps_mm[::-1], 0.0), Stop(1e-3), to_stop_mm
    )
    for aside_mm in (0.0, 0.1, 0.15):
        leaving = trace(turned, -at_mm / to_stop_mm, [[0.0, 2e3 * aside_mm]], crossings=True)
        row, col, axial = leaving.direction[0]
        field = np.array([-row, -col]) / axial
        found = trace(lens, field, [at_mm / (0.5 * stop.diameter_mm)], crossings=True)
        assert leaving.crossing_mm is not None
        assert found.crossing_mm is not None
        assert found.status.tolist() == [0]
        assert found.crossing_mm[0, 0, :2] == pytest.approx(
            leaving.crossing_mm[0, -1, :2], abs=1e-7
        )
    assert math.degrees(math.atan(np.hypot(*field))) > 70.0
    places_mm = np.array([[0.0, 0.0], [0.0, 4.5], [3.0, -3.0]])
    fields = fields_for_image(lens, places_mm)  # barrel distortion of 60 % is no obstacle
    assert spots(lens, fields, rings=2).centroid_mm == pytest.approx(places_mm, abs=1e-7)
