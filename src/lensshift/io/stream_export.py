"""Streams of pictures for robots and viewers: MCAP with ROS 2 messages, and Rerun.

    topic of .mcap, entity of .rrd   MCAP message                      of each picture
    amplitude, distance, std         sensor_msgs/Image, 32FC1          distances radial, in m
    camera_info                      sensor_msgs/CameraInfo            if it looks like a pinhole
    points                           sensor_msgs/PointCloud2           if it is known where it looks

All under /lensshift, in the optical frame (x right, y down, z forward) "lensshift_optical". Points
are exact for radial distances and any lens; flying pixels are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.atomic import written_whole
from lensshift.core.errors import DataError, of_extra
from lensshift.core.intrinsics import Pinhole
from lensshift.core.point_cloud import PointCloud
from lensshift.core.types import Reconstruction

STREAM_SUFFIXES = (".mcap", ".rrd")
_NEEDED = "this format needs a library: pip install "
_FRAME = "lensshift_optical"
_LATEST_S = 2.0**31 - 1  # builtin_interfaces/Time
_FLOAT32 = 7  # sensor_msgs/PointField
_START = "std_msgs/Header header\nuint32 height\nuint32 width\n"
_PART = "=" * 80 + "\nMSG: "  # a message within one
_HEADER = (
    f"{_PART}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_PART}builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
_KINDS = {
    "Image": f"{_START}string encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n{_HEADER}",
    "CameraInfo": f"{_START}string distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\n"
    "float64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
    f"{_HEADER}{_PART}sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\n"
    "uint32 height\nuint32 width\nbool do_rectify\n",
    "PointCloud2": f"{_START}sensor_msgs/PointField[] fields\nbool is_bigendian\n"
    "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n"
    f"{_HEADER}{_PART}sensor_msgs/PointField\n"
    "string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
}

Write = Callable[[float, Reconstruction], None]


def export_stream(pictures: Iterable[tuple[float, Reconstruction]], path: str | Path) -> int:
    """Write pictures with their times in seconds as .mcap or .rrd; return how many there were.

    The file appears whole or not at all. A time that is not finite becomes the number of the
    picture. ValueError if the ending is not supported. ImportError if the library for it is not
    installed. DataError if the file cannot be written, or a time is before 0 or beyond what ROS 2
    holds (2^31 s).
    """
    suffix = Path(path).suffix.lower()
    if suffix not in STREAM_SUFFIXES:
        raise ValueError(f"expected a name that ends in .mcap or .rrd, got {Path(path).name!r}")
    writing = _mcap if suffix == ".mcap" else _rerun
    number = -1
    with written_whole(path) as temporary, writing(temporary) as write:
        for number, (time_s, picture) in enumerate(pictures):
            write(time_s if math.isfinite(time_s) else float(number), picture)
    return number + 1


def _images(picture: Reconstruction) -> dict[str, NDArray[np.float32]]:
    """Return the images of a picture by the name that they get."""
    found = {name: estimate.image for name, estimate in picture.channels.items()}
    if picture.distance_m is not None and picture.distance_m.std is not None:
        found["std"] = picture.distance_m.std
    return {name: np.asarray(image, np.float32) for name, image in found.items()}


def _cloud(picture: Reconstruction) -> PointCloud | None:
    known = picture.intrinsics is not None and picture.distance_m is not None
    return picture.point_cloud() if known else None


@contextmanager
def _mcap(path: Path) -> Iterator[Write]:
    writer_of = of_extra("mcap_ros2.writer", f"{_NEEDED}'lensshift[mcap]'").Writer
    with path.open("wb") as file:
        writer = writer_of(file)
        schemas = {
            name: writer.register_msgdef(f"sensor_msgs/msg/{name}", text)
            for name, text in _KINDS.items()
        }

        def write(time_s: float, picture: Reconstruction) -> None:
            if not 0 <= time_s < _LATEST_S:
                raise DataError(f"expected seconds from 0 to 2^31, got {time_s:g}", field="time")
            stamp_ns = round(time_s * 1e9)
            for topic, kind, message in _messages(picture, stamp_ns):
                writer.write_message(
                    f"/lensshift/{topic}", schemas[kind], message, stamp_ns, stamp_ns
                )

        yield write
        writer.finish()


def _messages(picture: Reconstruction, stamp_ns: int) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield topic, kind and content of the messages of a picture."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": _FRAME}
    rows, cols = picture.grid.shape
    size = {"header": header, "height": rows, "width": cols}
    for topic, image in _images(picture).items():
        data = {"encoding": "32FC1", "is_bigendian": 0, "step": 4 * cols}
        yield topic, "Image", size | data | {"data": image.astype("<f4").tobytes()}
    if isinstance(picture.intrinsics, Pinhole):
        fx, fy, cx, cy, *distortion = astuple(picture.intrinsics)
        k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        yield "camera_info", "CameraInfo", size | {
            "distortion_model": "plumb_bob", "d": distortion, "k": k,
            "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "p": [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0], "binning_x": 0, "binning_y": 0,
            "roi": region,
        }  # fmt: skip
    cloud = _cloud(picture)
    if cloud is not None:
        named = {**dict(zip("xyz", cloud.point_m.T, strict=True)),
                 "amplitude": cloud.amplitude, "std": cloud.std_m}  # fmt: skip
        columns = {name: one for name, one in named.items() if one is not None}
        fields = [
            {"name": name, "offset": 4 * k, "datatype": _FLOAT32, "count": 1}
            for k, name in enumerate(columns)
        ]
        step, places = 4 * len(columns), np.stack([*columns.values()], axis=-1)
        yield "points", "PointCloud2", {
            "header": header, "height": 1, "width": len(cloud), "fields": fields,
            "is_bigendian": False, "point_step": step, "row_step": step * len(cloud),
            "data": places.astype("<f4").tobytes(), "is_dense": True,
        }  # fmt: skip


@contextmanager
def _rerun(path: Path) -> Iterator[Write]:
    rr = of_extra("rerun", f"{_NEEDED}'lensshift[rerun]'")
    recording = rr.RecordingStream("lensshift")
    recording.save(path)
    recording.log("lensshift", rr.ViewCoordinates.RDF, static=True)

    def write(time_s: float, picture: Reconstruction) -> None:
        recording.set_time("time", duration=time_s)
        for name, image in _images(picture).items():
            shown = rr.Image(image) if name == "amplitude" else rr.DepthImage(image, meter=1.0)
            recording.log(f"lensshift/{name}", shown)
        cloud = _cloud(picture)
        if cloud is not None:
            grey = None
            if cloud.amplitude is not None and len(cloud):
                top = max(float(np.quantile(cloud.amplitude, 0.99)), 1e-12)
                level = np.clip(255 * cloud.amplitude / top, 0, 255).astype(np.uint8)
                grey = np.stack([level] * 3, axis=-1)
            recording.log("lensshift/points", rr.Points3D(cloud.point_m, colors=grey))

    try:
        yield write
    finally:
        recording.flush()
        recording.disconnect()
