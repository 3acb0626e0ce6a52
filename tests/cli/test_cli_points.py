"""Point clouds from the command line: where pixels look, files, words and refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from stand_in import Call, FakeReconstruct, Refused

from lensshift.core.intrinsics import Pinhole
from lensshift.core.types import Burst
from lensshift.io import load_burst, load_reconstruction, save_burst
from lensshift.optics.directions import lens_directions
from lensshift.optics.lens_file import load_lens

ANGLE = ["--fov-deg", "50x40"]


@pytest.mark.usefixtures("drawn")
def test_points_are_written_and_drawn(
    call: Call, fake: FakeReconstruct, burst_file: Path, tmp_path: Path
) -> None:
    files = [tmp_path / f"a{suffix}" for suffix in (".ply", ".pcd", ".npz")]
    exports = [part for file in files for part in ("--export", file)]
    done = call("reconstruct", burst_file, "--channel", "distance", *ANGLE, "--normals", *exports)
    assert done.exit_code == 0, done.output
    result = load_reconstruction(tmp_path / "burst_x2.nc")
    expected = result.point_cloud().point_m
    wanted = Pinhole.of_field(result.grid, np.deg2rad(50), np.deg2rad(40)).directions((10, 14))
    assert result.intrinsics is not None
    np.testing.assert_allclose(result.intrinsics.directions((10, 14)), wanted, rtol=1e-12)
    for file, end in zip(files, (b"end_header\n", b"DATA binary\n"), strict=False):
        head, _, body = file.read_bytes().partition(end)
        assert b"normal_x" in head or b"float nx" in head
        table = np.frombuffer(body, "<f4").reshape(len(expected), 7)  # and normals, std
        np.testing.assert_allclose(table[:, :3], expected, rtol=1e-6)
    with np.load(files[2]) as fields:
        np.testing.assert_array_equal(fields["point_m"].reshape(-1, 3), expected)
    with Image.open(tmp_path / "burst_x2_preview.png") as picture:
        colours = np.asarray(picture.convert("RGB")) @ [1, 256, 65536]  # numbers sort in no time
        assert len(np.unique(colours)) > 300


@pytest.mark.usefixtures("drawn")
def test_a_stream_has_the_points_that_a_user_knows(
    call: Call, fake: FakeReconstruct, burst_file: Path, tmp_path: Path
) -> None:
    reader = pytest.importorskip("mcap.reader")
    pytest.importorskip("mcap_ros2")
    assert call("reconstruct", burst_file, "--channel", "distance").exit_code == 0
    file = tmp_path / "a.mcap"
    for options, expected in (([], 0), (ANGLE, 1)):
        assert call("convert", tmp_path / "burst_x2.nc", file, *options).exit_code == 0
        with file.open("rb") as content:
            channels = reader.make_reader(content).get_summary().channels.values()
        assert [one.topic for one in channels].count("/lensshift/points") == expected


@pytest.mark.parametrize(
    ("options", "focal_px"),
    [
        (["--fov-deg", "50"], 3.5 / np.tan(np.deg2rad(25))),
        (["--focal-length-px", "8.5"], 8.5),
        (["--focal-length-mm", "0.9"], 9.0),
    ],
)
def test_a_user_knows_the_lens(
    call: Call, burst_file: Path, tmp_path: Path, options: list[str], focal_px: float
) -> None:
    assert call("convert", burst_file, tmp_path / "b.nc", *options).exit_code == 0
    # Pixels of 0.1 mm along columns, 0.15 mm along rows.
    read = load_burst(tmp_path / "b.nc").intrinsics
    assert isinstance(read, Pinhole)
    assert (read.fx_px, read.fy_px) == pytest.approx((focal_px, focal_px / 1.5))
    assert (read.cx_px, read.cy_px) == (3.0, 2.0)


def test_a_lens_is_traced_for_directions(call: Call, burst_file: Path, tmp_path: Path) -> None:
    assert call("convert", burst_file, tmp_path / "b.nc", "--lens", "petzval_a").exit_code == 0
    burst = load_burst(tmp_path / "b.nc")
    assert burst.intrinsics is not None
    expected = lens_directions(load_lens("petzval_a"), burst.grid).direction
    np.testing.assert_allclose(burst.intrinsics.directions((5, 7)), expected, atol=1e-15)


def test_a_result_becomes_points_later(
    call: Call, fake: FakeReconstruct, burst_file: Path, tmp_path: Path
) -> None:
    assert call("reconstruct", burst_file, "--channel", "distance").exit_code == 0
    result = tmp_path / "burst_x2.nc"
    assert "looks       not known where" in call("info", result).stdout
    refused = call("convert", result, tmp_path / "a.ply")
    assert refused.exit_code == 2
    assert "give --fov-deg" in " ".join(refused.stderr.split())
    done = call("convert", result, tmp_path / "a.ply", "--focal-length-px", 9)
    assert done.exit_code == 0, done.output
    read = load_reconstruction(result)
    expected = read.point_cloud(Pinhole.centred(read.grid, 18.0)).point_m
    body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[2]
    table = np.frombuffer(body, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(table[:, :3], expected, rtol=1e-6)


def test_info_says_how_wide_a_camera_looks(call: Call, burst: Burst, tmp_path: Path) -> None:
    save_burst(replace(burst, intrinsics=Pinhole(3.0, 2.0, 3.0, 2.0)), tmp_path / "b.nc")
    said = call("info", tmp_path / "b.nc").stdout
    assert "looks       90.00 x 90.00 deg between the outermost pixels, a pinhole" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([*ANGLE, "--focal-length-px", "3"], "give one of them"),
        (["--fov-deg", "wide"], "expected degrees as in 60 or 60x45, got 'wide'"),
        (["--fov-deg", "180"], "below 180 degrees, got '180'"),
        (["--focal-length-mm", "-1"], "not 42700 or 0.0427; got -1"),
        (["--focal-length-px", "-1"], "focal lengths above 0"),
        (["--export", "a.ply"], "points need to know where the pixels look"),
        ([*ANGLE, "--export", "a.pcd", "--channel", "amplitude"], "points need distances"),
    ],
)
def test_refusals_come_before_the_work(
    refused: Refused, fake: FakeReconstruct, burst_file: Path, options: list[str], said: str
) -> None:
    refused(["reconstruct", burst_file, *options], 2, said)
    assert fake.calls == []


def test_a_calibration_of_opencv_says_where_pixels_look(
    call: Call, burst_file: Path, refused: Refused, tmp_path: Path
) -> None:
    calibration = tmp_path / "calib.json"
    calibration.write_text('{"camera_matrix": [[6, 0, 3], [0, 6.5, 2], [0, 0, 1]]}')
    told = ["convert", burst_file, tmp_path / "a.nc", "--intrinsics", calibration]
    assert call(*told).exit_code == 0
    assert load_burst(tmp_path / "a.nc").intrinsics == Pinhole(6, 6.5, 3, 2)
    refused([*told, *ANGLE], 2, "give one of them")
