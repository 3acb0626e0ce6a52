"""What rays meet, against closed forms, other ways to compute it, and integrals over all rays."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lensshift.scene import (
    Checker,
    Cuboid,
    Edge,
    Hits,
    Plane,
    Rectangle,
    Scene,
    Sphere,
    cast,
    visible,
)

Array = NDArray[np.float64]

angles = st.floats(-1.4, 1.4)
turns = st.tuples(angles, angles, angles)
directions = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.2, 1)).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def all_around(count: int) -> Array:
    """Return directions that cover the sphere evenly (Fibonacci)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=-1)


def assert_hits_agree(one: Hits, other: Hits) -> None:
    np.testing.assert_array_equal(one.hit, other.hit)
    for name in ("distance_m", "reflectance", "cos_incidence", "point_m", "normal"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9)


@given(turns, directions)
def test_a_plane_is_met_where_its_equation_says(
    turn_rad: tuple[float, float, float], direction: Array
) -> None:
    centre_m = np.array([0.3, -0.2, 3.0])
    normal = Rotation.from_euler("xyz", turn_rad).as_matrix()[:, 2]
    unit = direction / np.linalg.norm(direction)
    assume(abs(normal @ unit) > 1e-3)  # not along the plane
    expected_m = (normal @ centre_m) / (normal @ unit)
    seen = cast(Scene((Plane(centre_m=centre_m, turn_rad=turn_rad),)), direction)
    assert seen.hit == (expected_m > 0)
    if seen.hit:
        assert seen.distance_m == pytest.approx(expected_m, rel=1e-9)
        assert seen.cos_incidence == pytest.approx(abs(normal @ unit), rel=1e-9)
        np.testing.assert_allclose(seen.point_m, expected_m * unit, rtol=1e-9)
        np.testing.assert_allclose(seen.normal, -normal * np.sign(normal @ unit), atol=1e-12)


@given(st.floats(0.0, 0.999), st.floats(0, 2 * np.pi), st.floats(0.01, 2.0))
def test_a_sphere_is_met_by_the_law_of_cosines(share: float, turn: float, radius_m: float) -> None:
    centre_m = np.array([0.4, -0.3, 3.2])
    away_m = np.linalg.norm(centre_m)
    to_centre = centre_m / away_m
    sideways = np.cross(to_centre, [np.cos(turn), np.sin(turn), 0.3])
    sideways /= np.linalg.norm(sideways)
    sin = share * radius_m / away_m
    direction = np.sqrt(1 - sin**2) * to_centre + sin * sideways
    seen = cast(Scene((Sphere(centre_m=centre_m, radius_m=radius_m),)), 5.0 * direction)
    expected_m = away_m * np.sqrt(1 - sin**2) - np.sqrt(radius_m**2 - (away_m * sin) ** 2)
    assert seen.distance_m == pytest.approx(expected_m, rel=1e-12)
    assert seen.cos_incidence == pytest.approx(np.sqrt(1 - share**2), abs=1e-9)
    np.testing.assert_allclose(
        seen.normal, (seen.point_m - centre_m) / radius_m, atol=1e-9 / radius_m
    )


def test_a_sphere_ends_where_its_tangent_does() -> None:
    scene = Scene((Sphere(centre_m=(0, 0, 2.0), radius_m=0.5),))
    tangent = np.arcsin(0.25)
    angle = np.array([tangent - 1e-9, tangent + 1e-9])
    seen = cast(scene, np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1))
    np.testing.assert_array_equal(seen.hit, [True, False])


def test_an_upright_cuboid_shows_its_front_and_its_side() -> None:
    scene = Scene((Cuboid(centre_m=(1.0, 0.2, 3.0), size_m=(1.0, 2.0, 0.8)),))
    # At z = 2.6 the front spans x 0.5 .. 1.5; its left side is met from the axis beyond that.
    direction = np.array([[0.6, 0.1, 2.6], [0.5, -0.3, 2.9], [0.5, 0.0, 3.5], [0.7, 1.3, 2.6]])
    seen = cast(scene, direction)
    np.testing.assert_array_equal(seen.hit, [True, True, False, False])
    np.testing.assert_allclose(seen.point_m[:2], direction[:2], rtol=1e-12)
    np.testing.assert_array_equal(seen.normal[:2], [[0, 0, -1], [-1, 0, 0]])
    length_m = np.linalg.norm(direction[:2], axis=1)
    np.testing.assert_allclose(seen.distance_m[:2], length_m, rtol=1e-12)
    np.testing.assert_allclose(seen.cos_incidence[:2], [2.6, 0.5] / length_m, rtol=1e-12)


def cuboid_by_half_spaces(cuboid: Cuboid, unit: Array) -> Array:
    """Return distances to a convex body: after the last face entered, before the first left."""
    rotation = Rotation.from_euler("xyz", cuboid.turn_rad).as_matrix()
    enter, leave = np.full(len(unit), -np.inf), np.full(len(unit), np.inf)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * rotation[:, axis]
            room = normal @ np.array(cuboid.centre_m) + 0.5 * cuboid.size_m[axis]
            speed = unit @ normal
            enter = np.where(speed < 0, np.maximum(enter, room / speed), enter)
            leave = np.where(speed > 0, np.minimum(leave, room / speed), leave)
    return np.where((enter <= leave) & (leave > 0), np.where(enter > 0, enter, leave), np.inf)


@given(turns, seeds, st.booleans())
def test_a_turned_cuboid_is_the_body_between_its_faces(
    turn_rad: tuple[float, float, float], seed: int, inside: bool
) -> None:
    centre_m = (0.1, -0.1, 0.2) if inside else (0.2, -0.1, 1.9)
    cuboid = Cuboid(centre_m=centre_m, size_m=(0.9, 1.3, 0.7), turn_rad=turn_rad)
    unit = np.random.default_rng(seed).normal(size=(300, 3)) * (0.6, 0.6, 1.0)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    seen = cast(Scene((cuboid,)), unit)
    np.testing.assert_allclose(seen.distance_m, cuboid_by_half_spaces(cuboid, unit), rtol=1e-9)
    assert inside == seen.hit.all()


@pytest.mark.parametrize(
    ("turn_rad", "before", "after"),
    [
        ((np.pi / 2, 0, 0), (0, 1, 0), (0, 0, 1)),  # about x: down to forward
        ((0, np.pi / 2, 0), (0, 0, 1), (1, 0, 0)),  # about y: forward to right
        ((0, 0, np.pi / 2), (1, 0, 0), (0, 1, 0)),  # about z: right to down
        ((np.pi / 2, np.pi / 2, 0), (0, 1, 0), (1, 0, 0)),  # x before y
    ],
)
def test_positive_turns_are_clockwise_along_their_axis(turn_rad, before, after) -> None:
    rod = Cuboid(centre_m=(0, 0, 0), size_m=(0.1, 0.1, 0.1), turn_rad=turn_rad)
    np.testing.assert_allclose(rod.rotation @ before, after, atol=1e-15)


def test_columns_go_right_and_rows_go_down() -> None:
    card = {"centre_m": (0, 0, 2.0), "size_m": (1.0, 1.0)}
    right, down, left = (0.1, 0, 2.0), (0, 0.1, 2.0), (-0.1, 0, 2.0)
    upright = Scene((Rectangle(reflectance=Edge(0.0, dark=0.1, bright=0.9), **card),))
    np.testing.assert_array_equal(cast(upright, [right, left]).reflectance, [0.9, 0.1])
    quarter = Rectangle(reflectance=Edge(0.0, 0.1, 0.9), turn_rad=(0, 0, np.pi / 2), **card)
    assert cast(Scene((quarter,)), down).reflectance == 0.9


@pytest.mark.parametrize(
    ("axis", "x_axis", "y_axis"), [(0, 2, 1), (1, 0, 2), (2, 0, 1)], ids=["side", "top", "front"]
)
def test_faces_of_a_cuboid_have_their_own_coordinates(axis: int, x_axis: int, y_axis: int) -> None:
    at_m = np.array([0.11, -0.23, 0.17])
    at_m[axis] = -0.5
    start_m = at_m.copy()
    start_m[axis] = -4.0
    for along, expected in (("x", at_m[x_axis]), ("y", at_m[y_axis])):

        def texture(x_m: Array, y_m: Array, along: str = along) -> Array:
            return 0.5 + (x_m if along == "x" else y_m)

        box = Cuboid(centre_m=(0, 0, 0), size_m=(1, 1, 1), reflectance=texture)
        seen = cast(Scene((box,)), at_m - start_m, origin_m=start_m)
        assert seen.reflectance == pytest.approx(0.5 + expected)


def test_a_ball_has_arcs_as_coordinates() -> None:
    longitude, latitude, radius_m = 0.4, -0.3, 0.8
    from_centre = np.array(
        [np.sin(longitude) * np.cos(latitude), np.sin(latitude),
         -np.cos(longitude) * np.cos(latitude)]
    )  # fmt: skip
    for texture, arc in ((lambda x, y: 0.5 + x, longitude), (lambda x, y: 0.5 + y, latitude)):
        ball = Sphere(centre_m=(0.2, 0, 3), radius_m=radius_m, reflectance=texture)
        seen = cast(Scene((ball,)), -from_centre, origin_m=ball.centre_m + 2 * from_centre)
        assert seen.reflectance == pytest.approx(0.5 + radius_m * arc)


def zoo(rotation: Rotation, moved_m: Array) -> Scene:
    """Return some shapes, turned about the origin and then moved."""

    def placed(turn_rad, centre_m):
        turn = rotation * Rotation.from_euler("xyz", turn_rad)
        return {
            "turn_rad": turn.as_euler("xyz"),
            "centre_m": rotation.apply(centre_m) + moved_m,
            "reflectance": Checker(0.07),
        }

    return Scene(
        (
            Cuboid(size_m=(0.4, 0.5, 0.6), **placed((0.3, 0.2, -0.5), (-0.5, 0.1, 2.0))),
            Rectangle(size_m=(0.8, 0.5), **placed((0.1, -0.4, 0.2), (0.4, -0.2, 1.8))),
            Sphere(radius_m=0.3, **placed((0.0, 0.0, 0.0), (0.3, 0.4, 2.2))),
        ),
        background=Plane(**placed((0.2, 0.1, 0.0), (0.0, 0.0, 3.0))),
    )


@given(turns, seeds)
def test_turning_and_moving_everything_changes_nothing(
    turn_rad: tuple[float, float, float], seed: int
) -> None:
    rotation = Rotation.from_euler("zxz", turn_rad)
    rng = np.random.default_rng(seed)
    moved_m = rng.normal(size=3)
    direction = rng.normal(size=(200, 3)) * (0.3, 0.3, 0.1) + (0, 0, 1.0)
    before = cast(zoo(Rotation.identity(), np.zeros(3)), direction)
    after = cast(zoo(rotation, moved_m), rotation.apply(direction), origin_m=moved_m)
    np.testing.assert_allclose(after.distance_m, before.distance_m, rtol=1e-9)
    np.testing.assert_allclose(after.cos_incidence, before.cos_incidence, atol=1e-9)
    np.testing.assert_array_equal(after.reflectance, before.reflectance)
    np.testing.assert_allclose(after.normal, rotation.apply(before.normal), atol=1e-9)
    np.testing.assert_allclose(after.point_m, rotation.apply(before.point_m) + moved_m, atol=1e-9)


def test_the_nearest_shape_hides_the_others() -> None:
    scene = zoo(Rotation.identity(), np.zeros(3))
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(40_000, 3)) * (0.3, 0.3, 0.1) + (0, 0, 1.0)
    alone = [cast(Scene((shape,)), direction) for shape in scene.shapes]
    nearest = np.argmin([hits.distance_m for hits in alone], axis=0)
    assert set(nearest) == {0, 1, 2, 3}
    together = cast(scene, direction)
    for name in ("distance_m", "reflectance", "cos_incidence"):
        expected = np.choose(nearest, [getattr(hits, name) for hits in alone])
        np.testing.assert_array_equal(getattr(together, name), expected)
    # Any order, a shape of any rank, and a part of the rays: the same.
    assert_hits_agree(cast(Scene(scene.shapes[::-1]), direction), together)
    few = cast(scene, direction.reshape(200, 200, 3)[::67, ::71])
    np.testing.assert_array_equal(few.distance_m, together.distance_m.reshape(200, 200)[::67, ::71])


def test_normals_and_cosines_are_those_of_unit_vectors() -> None:
    direction = all_around(5000) * (1, 1, 3)
    seen = cast(zoo(Rotation.identity(), np.zeros(3)), direction)
    assert 0.2 < seen.hit.mean() < 0.8
    unit = (direction / np.linalg.norm(direction, axis=1, keepdims=True))[seen.hit]
    normal = seen.normal[seen.hit]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-12)
    cosine = -np.einsum("ri,ri->r", normal, unit)
    np.testing.assert_allclose(seen.cos_incidence[seen.hit], cosine, atol=1e-12)
    assert cosine.min() >= 0
    np.testing.assert_allclose(
        seen.point_m[seen.hit], seen.distance_m[seen.hit, None] * unit, rtol=1e-12
    )


def test_solid_angle_of_a_sphere_by_counting_rays() -> None:
    sphere = Sphere(centre_m=(1.0, -2.0, 0.5), radius_m=0.8)
    counted = 4 * np.pi * cast(Scene((sphere,)), all_around(40_000)).hit.mean()
    sin = sphere.radius_m / np.linalg.norm(sphere.centre_m)
    assert counted == pytest.approx(2 * np.pi * (1 - np.sqrt(1 - sin**2)), rel=5e-3)


@pytest.mark.parametrize(
    ("body", "volume_m3", "area_m2"),
    [
        (Cuboid(centre_m=(0, 0, 0), size_m=(1, 2, 3), turn_rad=(1, 2, 3)), 6.0, 22.0),
        (Sphere(centre_m=(0, 0, 0), radius_m=1.5), 4.5 * np.pi, 9 * np.pi),
    ],
)
def test_a_camera_inside_measures_volume_and_area(body, volume_m3: float, area_m2: float) -> None:
    # d(volume) = distance^3 / 3, d(area) = distance^2 / cos(incidence), per solid angle
    seen = cast(Scene((body,)), all_around(40_000), origin_m=(0.1, -0.2, 0.3))
    assert seen.hit.all()
    assert 4 * np.pi * np.mean(seen.distance_m**3 / 3) == pytest.approx(volume_m3, rel=1e-3)
    area = 4 * np.pi * np.mean(seen.distance_m**2 / seen.cos_incidence)
    assert area == pytest.approx(area_m2, rel=3e-3)


def test_a_lambertian_ball_lights_a_detector_by_its_view_factor() -> None:
    # Radiance 1: the integral of cos(angle) over the cone is pi sin^2 of its half angle.
    radius_m, away_m = 0.7, 2.0
    sphere = Scene((Sphere(centre_m=(0, 0, away_m), radius_m=radius_m),))
    direction = all_around(40_000)
    seen = cast(sphere, direction)
    irradiance = 4 * np.pi * np.mean(seen.hit * direction[:, 2])
    assert irradiance == pytest.approx(np.pi * (radius_m / away_m) ** 2, rel=5e-3)


def test_rays_that_miss_see_nothing() -> None:
    scene = Scene((Sphere(centre_m=(0, 0, 3), radius_m=0.1), Plane(centre_m=(0, 0, 4))))
    seen = cast(scene, [[0, 0, -1.0], [1, 0, 0.0], [0, 1, 0]])
    assert not seen.hit.any()
    assert np.isposinf(seen.distance_m).all()
    np.testing.assert_array_equal(seen.reflectance, 0)
    np.testing.assert_array_equal(seen.cos_incidence, 0)
    assert np.isnan(seen.point_m).all()
    assert np.isnan(seen.normal).all()
    assert not cast(Scene(()), [0, 0, 1.0]).hit


def test_hits_have_the_leading_axes_of_the_rays() -> None:
    scene = Scene((Plane(centre_m=(0, 0, 2)),))
    one = cast(scene, (0, 0, 7))
    assert one.distance_m.shape == one.hit.shape == ()
    assert one.point_m.shape == (3,)
    none = cast(scene, np.zeros((0, 3)))
    assert none.distance_m.shape == (0,)
    pupil_m = np.zeros((5, 1, 3))
    pupil_m[:, 0, 0] = np.linspace(-0.01, 0.01, 5)
    grid = cast(scene, [[0, 0.1, 1], [0.2, 0, 1], [0, 0, 1.0]], origin_m=pupil_m)
    assert grid.cos_incidence.shape == (5, 3)
    assert grid.normal.shape == (5, 3, 3)
    np.testing.assert_allclose(grid.point_m[:, 2, 0], pupil_m[:, 0, 0], atol=1e-15)
    np.testing.assert_allclose(grid.distance_m[:, 1], 2 * np.hypot(1, 0.2))


def test_a_ray_does_not_meet_the_surface_that_it_starts_on() -> None:
    room = Cuboid(centre_m=(0, 0, 0), size_m=(2, 2, 2))
    assert cast(Scene((room,)), [0, 0, 1], origin_m=(0, 0, -1)).distance_m == pytest.approx(2)
    assert not cast(Scene((room,)), [0, 0, 1], origin_m=(0, 0, 1)).hit


@given(seeds)
def test_points_see_each_other_unless_a_ball_is_between(seed: int) -> None:
    rng = np.random.default_rng(seed)
    from_m, to_m = rng.normal(size=(2, 100, 3)) * 2
    radius_m = 0.7
    outside = (np.linalg.norm([from_m, to_m], axis=-1) > radius_m).all(axis=0)
    from_m, to_m = from_m[outside], to_m[outside]
    away = to_m - from_m
    share = np.clip(-np.einsum("ri,ri->r", from_m, away) / np.sum(away**2, axis=1), 0, 1)
    closest_m = np.linalg.norm(from_m + share[:, None] * away, axis=1)
    ball = Scene((Sphere(centre_m=(0, 0, 0), radius_m=radius_m),))
    np.testing.assert_array_equal(visible(ball, from_m, to_m), closest_m > radius_m)
    np.testing.assert_array_equal(visible(ball, to_m, from_m), closest_m > radius_m)


def test_what_a_camera_sees_lies_in_the_light_unless_something_shades_it() -> None:
    scene = Scene(
        (Cuboid(centre_m=(0, 0, 2), size_m=(0.4, 0.4, 0.4), turn_rad=(0, 0.6, 0)),),
        background=Plane(centre_m=(0, 0, 3)),
    )
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(-0.3, 0.3, 23))
    seen = cast(scene, np.stack([x, y, np.ones_like(x)], axis=-1))
    assert visible(scene, (0, 0, 0), seen.point_m).all()
    light_m = np.array([1.0, 0, 0])
    lit = visible(scene, seen.point_m, light_m)
    # The light of a lamp on the right leaves a shadow on the wall, left of the box.
    wall = seen.point_m[..., 2] > 2.9
    shadow_x_m = seen.point_m[wall & ~lit][:, 0]
    assert -1.0 < shadow_x_m.mean() < -0.4
    assert lit[wall & (seen.point_m[..., 0] > 0)].all()
    faces_away = np.einsum("rci,rci->rc", seen.normal, light_m - seen.point_m) < 0
    np.testing.assert_array_equal(lit[~wall], ~faces_away[~wall])


def test_surfaces_within_a_micrometre_of_the_ends_do_not_block() -> None:
    scene = Scene((Plane(centre_m=(0, 0, 1)),))
    depth_m = np.array([1 - 5e-6, 1 - 5e-7, 1 + 5e-7])
    from_m = np.stack([0 * depth_m, 0 * depth_m, depth_m], axis=-1)
    np.testing.assert_array_equal(visible(scene, from_m, (0, 0, 2)), [False, True, True])
    np.testing.assert_array_equal(visible(scene, (0, 0, 2), from_m), [False, True, True])


def test_a_point_sees_itself_and_nothing_unknown() -> None:
    scene = Scene((Sphere(centre_m=(0, 0, 3), radius_m=0.1),))
    assert visible(scene, (1, 2, 3), (1, 2, 3))
    missed = cast(scene, [[0, 1, 0], [0, 0, 1.0]]).point_m
    np.testing.assert_array_equal(visible(scene, missed, (0, 0, 0)), [False, True])
    with pytest.raises(ValueError, match=r"from_m \[\.\.\. 3\]"):
        visible(scene, (0, 0), (0, 0, 0))


@pytest.mark.parametrize(
    ("direction", "origin_m", "message"),
    [
        ((0.0, 1.0), (0, 0, 0), r"direction \[\.\.\. 3\], got shape \(2,\)"),
        (1.0, (0, 0, 0), r"direction \[\.\.\. 3\]"),
        ((0, 0, 1), (0, 0), r"origin_m \[\.\.\. 3\]"),
        (np.ones((4, 3)), np.ones((3, 3)), "broadcast"),
        ((0, np.nan, 1), (0, 0, 0), "finite direction"),
        ((0, 0, 1), (0, np.inf, 0), "finite direction and origin_m"),
        (np.zeros((2, 3)), (0, 0, 0), "directions with a length"),
    ],
)
def test_rays_must_be_vectors(direction, origin_m, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cast(Scene((Plane(centre_m=(0, 0, 1)),)), direction, origin_m=origin_m)


@pytest.mark.parametrize(
    "texture",
    [lambda x, y: x + 2, lambda x, y: 0.5, lambda x, y: np.full_like(x, np.nan)],
)
def test_textures_must_return_reflectances(texture) -> None:
    scene = Scene((Plane(centre_m=(0, 0, 1), reflectance=texture, name="my wall"),))
    with pytest.raises(ValueError, match="texture of my wall"):
        cast(scene, np.ones((4, 3)))


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: Plane(centre_m=(0, 0)), ValueError, "3 finite numbers for centre_m"),
        (lambda: Plane(centre_m=4.0), TypeError, "3 finite numbers for centre_m"),
        (lambda: Plane(centre_m=(0, 0, np.inf)), ValueError, "finite each of centre_m"),
        (lambda: Plane(centre_m=(0, 0, "1")), TypeError, "number for each of centre_m"),
        (lambda: Plane(centre_m=(0, 0, 1), turn_rad=(1, 2)), ValueError, "turn_rad"),
        (lambda: Plane(centre_m=(0, 0, 1), reflectance=1.01), ValueError, "reflectance from 0"),
        (lambda: Plane(centre_m=(0, 0, 1), reflectance="w"), TypeError, "number for reflectance"),
        (lambda: Plane(centre_m=(0, 0, 1), name=3), TypeError, "text for name"),
        (lambda: Rectangle(centre_m=(0, 0, 1), size_m=(1, 0)), ValueError, "positive each of"),
        (lambda: Rectangle(centre_m=(0, 0, 1), size_m=(1, 1, 1)), ValueError, "2 finite numbers"),
        (lambda: Cuboid(centre_m=(0, 0, 1), size_m=(1, 1)), ValueError, "3 finite numbers"),
        (lambda: Sphere(centre_m=(0, 0, 1), radius_m=-1), ValueError, "positive radius_m"),
        (lambda: Scene(("ball",)), TypeError, "shapes in a scene, got str"),
        (lambda: Scene((), background=1), TypeError, "shapes in a scene, got int"),
    ],
)
def test_shapes_say_what_they_expect(make, error, message: str) -> None:
    with pytest.raises(error, match=message):
        make()
