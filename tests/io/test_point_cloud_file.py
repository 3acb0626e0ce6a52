"""Points as files, read by others; bursts and results keep where their pixels look."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_burst_file import make_burst
from test_result_file import make_reconstruction

from lensshift.core.errors import DataError
from lensshift.core.intrinsics import Intrinsics, Pinhole, PixelDirections
from lensshift.core.point_cloud import PointCloud, make_cloud
from lensshift.io import (
    export_burst,
    export_reconstruction,
    load_burst,
    load_image_stack,
    load_reconstruction,
    save_burst,
    save_point_cloud,
    save_reconstruction,
)

SHAPE = (5, 7)
PINHOLE = Pinhole(9.0, 8.0, 3.1, 2.2, -0.01, 0.002, 0.003, -0.004, 0.0005)
EITHER = pytest.mark.parametrize(
    "intrinsics", [PINHOLE, PixelDirections(PINHOLE.directions(SHAPE))], ids=["pinhole", "pixels"]
)


def make_points(seed: int, *, normals: bool = True) -> PointCloud:
    rng = np.random.default_rng(seed)
    images = rng.uniform(0.5, 2.0, (3, 11, 17))
    images[0, 3, 4] = np.nan
    return make_cloud(
        images[0],
        Pinhole(20.0, 21.0, 8.0, 5.0),
        amplitude=images[1],
        std_m=0.01 * images[2],
        flying=rng.random((11, 17)) < 0.2,
        keep_flying=True,
        normals=normals,
    )


def columns(cloud: PointCloud, normal_names: tuple[str, ...]) -> dict[str, Any]:
    """Return what a file shall hold, by the names in the file."""
    found = dict(zip("xyz", cloud.point_m.T, strict=True))
    if cloud.normal is not None:
        found |= dict(zip(normal_names, cloud.normal.T, strict=True))
    return found | {"amplitude": cloud.amplitude, "std": cloud.std_m, "flying": cloud.flying}


@pytest.mark.parametrize("normals", [False, True])
def test_ply_is_read_by_trimesh(tmp_path: Path, normals: bool) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    cloud = make_points(0, normals=normals)
    save_point_cloud(cloud, tmp_path / "a.ply")
    loaded = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_array_equal(loaded.vertices, cloud.point_m.astype(np.float32))
    read = loaded.metadata["_ply_raw"]["vertex"]["data"]
    expected = columns(cloud, ("nx", "ny", "nz"))
    assert set(read.dtype.names) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(read[name], np.asarray(values).astype(read[name].dtype))


@pytest.mark.parametrize("normals", [False, True])
def test_pcd_is_read_by_pypcd4(tmp_path: Path, normals: bool) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    cloud = make_points(1, normals=normals)
    save_point_cloud(cloud, tmp_path / "a.pcd")
    read = pypcd4.PointCloud.from_path(tmp_path / "a.pcd")
    expected = columns(cloud, ("normal_x", "normal_y", "normal_z"))
    assert set(read.fields) == set(expected)
    for name, values in expected.items():
        got = read.pc_data[name]
        np.testing.assert_array_equal(got, np.asarray(values).astype(got.dtype))


@pytest.mark.parametrize("name", ["a.ply", "a.pcd"])
def test_both_are_read_by_open3d(tmp_path: Path, name: str) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    cloud = make_points(2)
    save_point_cloud(cloud, tmp_path / name)
    plain = open3d.io.read_point_cloud(str(tmp_path / name))
    np.testing.assert_allclose(np.asarray(plain.points), cloud.point_m, rtol=1e-6)
    assert cloud.normal is not None
    np.testing.assert_allclose(np.asarray(plain.normals), cloud.normal, atol=1e-6)
    read = open3d.t.io.read_point_cloud(str(tmp_path / name)).point
    for field, values in (("amplitude", cloud.amplitude), ("std", cloud.std_m)):
        assert values is not None
        np.testing.assert_allclose(read[field].numpy().ravel(), values, rtol=1e-6)
    np.testing.assert_array_equal(read["flying"].numpy().ravel(), cloud.flying)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd"])
def test_files_are_little_endian_without_gaps(tmp_path: Path, name: str) -> None:
    cloud = make_points(3)
    save_point_cloud(cloud, tmp_path / name)
    data = (tmp_path / name).read_bytes()
    end = b"end_header\n" if name == "a.ply" else b"DATA binary\n"
    body = data[data.index(end) + len(end) :]
    assert len(body) == len(cloud) * (8 * 4 + 1)
    first = np.frombuffer(body, "<f4", 3)
    np.testing.assert_array_equal(first, cloud.point_m[0].astype("f4"))


def test_npz_holds_every_field(tmp_path: Path) -> None:
    cloud = make_points(4)
    save_point_cloud(cloud, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as read:
        assert set(read) == set(cloud.__dataclass_fields__)
        for name in read:
            np.testing.assert_array_equal(read[name], getattr(cloud, name))


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.npz"])
def test_nothing_is_left_where_it_cannot_be_written(tmp_path: Path, name: str) -> None:
    with pytest.raises(DataError, match="cannot write"):
        save_point_cloud(make_points(0), tmp_path / "none" / name)
    with pytest.raises(ValueError, match="ends in"):
        save_point_cloud(make_points(0), tmp_path / "a.xyz")
    assert list(tmp_path.iterdir()) == []


@EITHER
def test_burst_files_keep_where_pixels_look(tmp_path: Path, intrinsics: Intrinsics) -> None:
    burst = make_burst(intrinsics=intrinsics)
    save_burst(burst, tmp_path / "a.nc")
    export_burst(burst, tmp_path / "a.npz")
    for read in (load_burst(tmp_path / "a.nc"), load_image_stack(tmp_path / "a.npz")):
        assert type(read.intrinsics) is type(intrinsics)
        assert read.intrinsics is not None
        shape = burst.grid.shape
        got, expected = (one.directions(shape) for one in (read.intrinsics, intrinsics))
        np.testing.assert_allclose(got, expected, rtol=1e-14)
        assert read.select([0]).intrinsics is read.intrinsics


@EITHER
def test_result_files_keep_where_pixels_look(tmp_path: Path, intrinsics: Intrinsics) -> None:
    result = make_reconstruction(intrinsics=intrinsics.refine(2))
    save_reconstruction(result, tmp_path / "a.nc")
    read = load_reconstruction(tmp_path / "a.nc")
    got, expected = (one.point_cloud().point_m for one in (read, result))
    np.testing.assert_allclose(got, expected, rtol=1e-14)
    export_reconstruction(result, tmp_path / "a.npz")
    export_reconstruction(read, tmp_path / "a.ply", normals=True)
    assert result.distance_m is not None
    with np.load(tmp_path / "a.npz", allow_pickle=False) as fields:
        distance_m = np.linalg.norm(fields["point_m"], axis=-1)
        np.testing.assert_allclose(distance_m, abs(result.distance_m.image), rtol=1e-12)
    assert b"property float nx" in (tmp_path / "a.ply").read_bytes()[:500]


def test_half_an_intrinsic_is_an_error(tmp_path: Path) -> None:
    fields = {"amplitude": np.ones((1, *SHAPE)), "offset_px": np.zeros((1, 2)), "pitch_mm": 0.1}
    np.savez(tmp_path / "a.npz", focal_px=np.array([9.0, 8.0]), **fields)
    with pytest.raises(DataError, match=r"a\.npz: centre_px: expected 2 numbers"):
        load_image_stack(tmp_path / "a.npz")
