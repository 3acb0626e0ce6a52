"""Streams of pictures, read by the programs that they are for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lensshift import Pinhole, Reconstruction
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.types import Estimate
from lensshift.io.stream_export import export_stream

SHAPE = (7, 11)


def picture(number: int, *, look: bool = True) -> Reconstruction:
    rng = np.random.default_rng(number)
    amplitude, distance_m = rng.random(SHAPE), 3 + rng.random(SHAPE)
    distance_m[2, 3] = np.nan
    flying = rng.random(SHAPE) < 0.2
    return Reconstruction(
        Estimate(amplitude, 0.1 * amplitude), Estimate(distance_m, 0.01 * distance_m),
        Grid(SHAPE, (0.1, 0.1)), 2, "auto", flying=flying,
        intrinsics=Pinhole(30.0, 31.0, 5.1, 2.9, k1=-0.1) if look else None,
    )  # fmt: skip


@pytest.mark.parametrize("time_s", [-0.5, 1.7e12])
def test_times_that_robots_do_not_know_are_refused(tmp_path: Path, time_s: float) -> None:
    pytest.importorskip("mcap_ros2.writer", reason="mcap is not installed")
    with pytest.raises(DataError, match=r"time: expected seconds from 0 to 2\^31"):
        export_stream([(time_s, picture(0))], tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_robot_reads_what_was_seen(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap is not installed")
    told = [(0.25, picture(0)), (1.5, picture(1)), (float("nan"), picture(2))]
    assert export_stream(told, tmp_path / "a.mcap") == 3
    found = list(reader.read_ros2_messages(tmp_path / "a.mcap"))
    assert [one.log_time_ns for one in found[::5]] == [250_000_000, 1_500_000_000, 2_000_000_000]
    for number in range(3):
        expected = picture(number)
        of = {one.channel.topic: one.ros_msg for one in found[5 * number : 5 * number + 5]}
        images = {
            "amplitude": expected.amplitude.image,
            "distance": expected.distance_m.image,
            "std": expected.distance_m.std,
        }
        for name, image in images.items():
            sent = of[f"/lensshift/{name}"]
            assert (sent.height, sent.width, sent.encoding, sent.step) == (7, 11, "32FC1", 44)
            got = np.frombuffer(bytes(sent.data), "<f4").reshape(SHAPE)
            np.testing.assert_array_equal(got, image.astype(np.float32))
        info, cloud = of["/lensshift/camera_info"], of["/lensshift/points"]
        np.testing.assert_allclose(info.k, [30, 0, 5.1, 0, 31, 2.9, 0, 0, 1])
        np.testing.assert_allclose(info.p, [30, 0, 5.1, 0, 0, 31, 2.9, 0, 0, 0, 1, 0])
        np.testing.assert_allclose(info.d, [-0.1, 0, 0, 0, 0])
        points = expected.point_cloud()
        assert len(points) == cloud.width == np.sum(~expected.flying) - (not expected.flying[2, 3])
        assert [f.name for f in cloud.fields] == ["x", "y", "z", "amplitude", "std"]
        assert [f.offset for f in cloud.fields] == [0, 4, 8, 12, 16]
        table = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, cloud.point_step // 4)
        np.testing.assert_allclose(table[:, :3], points.point_m, rtol=1e-6)
        np.testing.assert_allclose(table[:, 4], points.std_m, rtol=1e-6)
        assert cloud.header.frame_id == "lensshift_optical"


def test_nothing_is_said_of_points_where_nobody_knows_where_it_looks(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap is not installed")
    export_stream([(0.0, picture(0, look=False))], tmp_path / "a.mcap")
    topics = {m.channel.topic for m in reader.read_ros2_messages(tmp_path / "a.mcap")}
    assert topics == {f"/lensshift/{name}" for name in ("amplitude", "distance", "std")}


def test_rerun_verifies_its_file(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    target = tmp_path / "a.rrd"
    assert export_stream([(0.1 * k, picture(k)) for k in range(3)], target) == 3
    for verb, said in (("verify", "1 file verified"), ("print", "/lensshift/points")):
        asked = [sys.executable, "-m", "rerun", "rrd", verb, str(target)]
        found = subprocess.run(asked, capture_output=True, text=True, timeout=60, check=True)
        assert said in found.stdout + found.stderr


def test_another_ending_is_refused_and_a_break_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\.mcap or \.rrd"):
        export_stream([], tmp_path / "a.bag")
    pytest.importorskip("mcap_ros2.writer", reason="mcap is not installed")

    def broken():
        yield 0.0, picture(0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_stream(broken(), tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("ending", "extra"), [("mcap", "mcap"), ("rrd", "rerun")])
def test_a_missing_library_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match=rf"pip install 'lensshift\[{extra}\]'"):
        export_stream([(0.0, picture(0))], tmp_path / f"a.{ending}")
    assert list(tmp_path.iterdir()) == []
