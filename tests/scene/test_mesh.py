"""Meshes: the same as closed forms, as every triangle tried one by one, and as trimesh."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.scene import Cuboid, Edge, Mesh, Scene, cast, load_mesh, visible

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)
angles = st.floats(-3, 3)
POSE = {"centre_m": (0.1, -0.2, 2.0), "turn_rad": (0.4, -0.7, 1.1)}
TRIANGLE = {"vertices_m": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}


def halved(vertices: Array, triangles: NDArray[np.int64], times: int) -> tuple[Array, NDArray]:
    """Split every triangle in four, again and again; vertices are not shared."""
    corners = vertices[triangles]
    for _ in range(times):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def box(size_m: tuple[float, float, float], times: int) -> tuple[Array, NDArray]:
    vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in squares for t in ((a, b, c), (a, c, d))]
    return halved(vertices * 0.5 * np.array(size_m), np.array(triangles), times)


def ball(times: int) -> tuple[Array, NDArray]:
    """Return an octahedron whose faces were split and pushed out to the unit sphere."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    triangles = np.array([[i, j, k] for i in (0, 1) for j in (2, 3) for k in (4, 5)])
    vertices, triangles = halved(vertices, triangles, times)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), triangles


def some_rays(count: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(count, 3)) * (0.4, 0.4, 0.1) + (0, 0, 1.0)


@settings(max_examples=10)
@given(st.tuples(angles, angles, angles), seeds, st.sampled_from([0, 3]))
def test_a_mesh_of_a_box_is_the_box(
    turn_rad: tuple[float, float, float], seed: int, times: int
) -> None:
    size_m = (0.8, 1.2, 0.5)
    vertices_m, triangles = box(size_m, times)
    pose = {"centre_m": (0.2, -0.1, 2.0), "turn_rad": turn_rad}
    mesh = cast(
        Scene((Mesh(vertices_m=vertices_m, triangles=triangles, **pose),)), some_rays(2000, seed)
    )
    cuboid = cast(Scene((Cuboid(size_m=size_m, **pose),)), some_rays(2000, seed))
    assert 0.05 < mesh.hit.mean() < 0.95
    np.testing.assert_array_equal(mesh.hit, cuboid.hit)
    np.testing.assert_allclose(mesh.distance_m, cuboid.distance_m, rtol=1e-9)
    np.testing.assert_allclose(mesh.cos_incidence, cuboid.cos_incidence, atol=1e-9)
    np.testing.assert_allclose(mesh.normal, cuboid.normal, atol=1e-9)


@pytest.mark.parametrize("times", [0, 4])
def test_rays_along_the_axes_and_through_edges_meet_a_box(times: int) -> None:
    # Seams lie at multiples of 1/16 of the size: many of these rays go through them exactly.
    vertices_m, triangles = box((1, 1, 1), times)
    scene = Scene((Mesh(vertices_m=vertices_m, triangles=triangles, centre_m=(0, 0, 2)),))
    x, y = np.meshgrid(np.arange(-8, 9) / 16, np.arange(-7, 8) / 16)
    origin_m = np.stack([x, y, 0 * x], axis=-1)
    np.testing.assert_array_equal(cast(scene, (0, 0, 1), origin_m=origin_m).distance_m, 1.5)
    inside = cast(scene, np.add(origin_m, (0, 0, 0.5)), origin_m=(0, 0, 2))
    np.testing.assert_allclose(inside.point_m[..., 2], 2.5, rtol=1e-12)


def by_trying_every_triangle(vertices: Array, triangles: NDArray, direction: Array) -> Array:
    """Return the nearest distance in lengths of `direction`, by solving for each pair."""
    corner = vertices[triangles[:, 0]]
    edges = vertices[triangles[:, 1:]] - corner[:, None]
    nearest = np.full(len(direction), np.inf)
    for r, d in enumerate(direction):
        columns = np.stack([np.broadcast_to(d, corner.shape), -edges[:, 0], -edges[:, 1]], axis=-1)
        t, u, v = np.linalg.solve(columns, corner[..., None])[..., 0].T
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        nearest[r] = t[met].min(initial=np.inf)
    return nearest


@pytest.mark.parametrize("count", [1, 5, 800])
def test_the_tree_finds_what_trying_every_triangle_finds(count: int) -> None:
    rng = np.random.default_rng(count)
    middle = rng.uniform((-1, -1, 1.5), (1, 1, 3.5), (count, 1, 3))
    vertices_m = (middle + rng.normal(scale=0.15 + 1 / count, size=(count, 3, 3))).reshape(-1, 3)
    triangles = rng.permutation(3 * count).reshape(count, 3) if count < 9 else None
    triangles = np.arange(3 * count).reshape(count, 3) if triangles is None else triangles
    mesh = Mesh(vertices_m=vertices_m, triangles=triangles, centre_m=(0, 0, 0))
    direction = some_rays(300)
    seen = cast(Scene((mesh,)), direction)
    expected_m = by_trying_every_triangle(vertices_m, triangles, direction)
    expected_m = expected_m * np.linalg.norm(direction, axis=1)
    assert 0 < np.isfinite(expected_m).sum() < 300
    np.testing.assert_allclose(seen.distance_m, expected_m, rtol=1e-9)


def test_a_closed_mesh_has_no_holes_and_its_own_volume() -> None:
    vertices_m, triangles = ball(4)
    assert len(triangles) == 2048
    mesh = Mesh(vertices_m=vertices_m, triangles=triangles, **POSE)
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(100_000, 3))
    seen = cast(Scene((mesh,)), direction, origin_m=np.add(POSE["centre_m"], (0.2, 0.1, -0.3)))
    assert seen.hit.all()
    corners = vertices_m[triangles]
    volume_m3 = np.abs(np.linalg.det(corners)).sum() / 6
    counted = 4 * np.pi * seen.distance_m**3 / 3
    assert counted.mean() == pytest.approx(volume_m3, abs=5 * counted.std() / 1e5**0.5)
    # Straight at vertices and at the middles of edges, where triangles join.
    rays = np.concatenate(
        [corners.reshape(-1, 3), (corners + np.roll(corners, 1, 1)).reshape(-1, 3)]
    )
    upright = Mesh(vertices_m=vertices_m, triangles=triangles, centre_m=(0, 0, 0))
    assert cast(Scene((upright,)), rays).hit.all()


def test_triangles_without_area_are_never_met() -> None:
    third = 1 / 3
    flat = [[0, 0, 0], [third, third, 0.1], [2 * third, 2 * third, 0.2], [0, 0, 0]]
    vertices_m = [*TRIANGLE["vertices_m"], *flat]
    mesh = Mesh(
        vertices_m=vertices_m, triangles=[[3, 4, 5], [3, 3, 4], [0, 1, 2], [3, 6, 6]], **POSE
    )
    alone = Mesh(**TRIANGLE, **POSE)
    direction = np.array(POSE["centre_m"]) + some_rays(5000) * (1, 1, 0)
    np.testing.assert_array_equal(
        cast(Scene((mesh,)), direction).distance_m, cast(Scene((alone,)), direction).distance_m
    )
    with pytest.raises(ValueError, match="triangles with an area"):
        Mesh(vertices_m=vertices_m, triangles=[[3, 4, 5], [3, 3, 4]], **POSE)


def test_many_triangles_on_one_spot_are_one_triangle() -> None:
    pile = Mesh(vertices_m=TRIANGLE["vertices_m"], triangles=[[0, 1, 2]] * 100, centre_m=(0, 0, 1))
    assert cast(Scene((pile,)), (0.2, 0.2, 1)).distance_m == pytest.approx(np.sqrt(1.08))


def test_meshes_shade_and_have_textures() -> None:
    vertices_m, triangles = box((1, 1, 1), 3)
    mesh = Mesh(
        vertices_m=vertices_m, triangles=triangles, centre_m=(0, 0, 3),
        reflectance=Edge(0.0, dark=0.2, bright=0.7),
    )  # fmt: skip
    scene = Scene((mesh,))
    seen = cast(scene, [(-0.1, 0, 2.5), (0.1, 0, 2.5)])
    np.testing.assert_array_equal(seen.reflectance, [0.2, 0.7])
    np.testing.assert_array_equal(
        visible(scene, seen.point_m[:, None], [(0, 0, 0), (0, 0, 5)]), [[True, False]] * 2
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices_m": [[0, 0], [1, 0], [0, 1]]}, r"vertices_m \[vertex 3\]"),
        ({"vertices_m": [[0, 0, 0], [1, 0]]}, "table of numbers for vertices_m"),
        ({"vertices_m": [[0, 0, np.nan], [1, 0, 0], [0, 1, 0]]}, "finite .* for vertices_m"),
        ({"triangles": []}, r"\[row col\] for triangles"),
        ({"triangles": [[0, 1]]}, r"triangles \[triangle 3\]"),
        ({"triangles": [[0, 1, 1.5]]}, "whole numbers for triangles"),
        ({"triangles": [[0, 1, 3]]}, "vertices 0 to 2 for triangles, got 0 to 3"),
        ({"triangles": [[0, -1, 2]]}, "got -1 to 2"),
        ({"reflectance": -0.1}, "reflectance from 0 to 1"),
    ],
)
def test_meshes_say_what_they_expect(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(**{**TRIANGLE, "centre_m": (0, 0, 1), **change})


def test_meshes_cannot_be_changed_behind_their_tree() -> None:
    vertices_m = np.array(TRIANGLE["vertices_m"], dtype=float)
    mesh = Mesh(vertices_m=vertices_m, triangles=[[0, 1, 2]], centre_m=(0, 0, 1))
    vertices_m[:] = 0
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices_m[0, 0] = 1
    assert cast(Scene((mesh,)), (0.1, 0.1, 1)).hit


def test_a_file_needs_trimesh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"lensshift\[mesh\]"):
        load_mesh(tmp_path / "part.stl", centre_m=(0, 0, 1))


def test_files_are_read_in_their_unit(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    vertices, triangles = box((200, 300, 400), 0)
    file = tmp_path / "part.stl"
    trimesh.Trimesh(vertices, triangles).export(file)
    mesh = load_mesh(file, unit_m=0.001, name="part", **POSE)
    assert mesh.name == "part"
    expected = cast(Scene((Cuboid(size_m=(0.2, 0.3, 0.4), **POSE),)), some_rays(500))
    seen = cast(Scene((mesh,)), some_rays(500))
    np.testing.assert_allclose(seen.distance_m, expected.distance_m, rtol=1e-6)  # float32 in STL
    with pytest.raises(ValueError, match="positive unit_m"):
        load_mesh(file, unit_m=0.0, **POSE)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.stl", None, "found none"),
        ("empty.stl", b"", "triangles with an area"),
        ("plane.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "cannot read as a mesh"),
        (
            "list.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 1\nproperty list uchar int other\nend_header\n"
            b"0 0 0\n3 0 0 0\n",
            "cannot read as a mesh",
        ),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "triangles with an area"),
        ("outside.obj", b"v 0 0 0\nf 1 2 3\n", "cannot read as a mesh"),
        ("cut.ply", b"ply\n", "cannot read as a mesh"),
        ("what.unknown", b"?", "cannot read as a mesh"),
    ],
)
def test_files_without_a_mesh_are_named(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    pytest.importorskip("trimesh", reason="trimesh is not installed")
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=f"{name}: .*{message}"):
        load_mesh(tmp_path / name, **POSE)


def test_rays_meet_what_trimesh_says() -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="trimesh casts rays with rtree")
    vertices_m, triangles = ball(3)
    vertices_m = vertices_m * (0.5 + 0.2 * np.sin(5 * vertices_m[:, :1])) + (0.1, 0, 2.0)
    direction = some_rays(400)
    mesh = Mesh(vertices_m=vertices_m, triangles=triangles, centre_m=(0, 0, 0))
    seen = cast(Scene((mesh,)), direction)
    theirs = trimesh.Trimesh(vertices_m, triangles, process=False)
    point_m, ray, triangle = theirs.ray.intersects_location(
        np.zeros_like(direction), direction, multiple_hits=False
    )
    assert 50 < len(ray) < 350
    np.testing.assert_array_equal(np.flatnonzero(seen.hit), np.sort(ray))
    np.testing.assert_allclose(seen.point_m[ray], point_m, atol=1e-9)
    alike = np.abs(np.einsum("ri,ri->r", seen.normal[ray], theirs.face_normals[triangle]))
    np.testing.assert_allclose(alike, 1, atol=1e-9)
