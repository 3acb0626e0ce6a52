"""Cameras by a function, through GenICam, and from recordings."""

import math
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift.capture.drivers.from_callable import CallableCamera, frame_from
from lensshift.capture.drivers.genicam import GenicamCamera, read_components
from lensshift.capture.drivers.receiver import Receiver
from lensshift.capture.drivers.replay import ReplayCamera
from lensshift.capture.emulators.o3m import packetise, pixel_message
from lensshift.capture.rig import Camera, CameraFrame
from lensshift.core.errors import DataError, DeviceError, DeviceTimeout
from lensshift.core.types import Frame

WAIT_S = 30.0


# By a function


def test_a_function_becomes_a_camera() -> None:
    numbers = iter(range(10**9))

    def grab() -> NDArray[Any]:
        return np.full((3, 5), float(next(numbers)))

    camera: Camera = CallableCamera(grab, pitch_mm=0.01, name="mine", about={"gain": 2})
    assert camera.newest_cycle() == -1
    assert camera.counts()["frames"] == 0
    with pytest.raises(DeviceError, match="open"):
        _ = camera.grid
    camera.open()
    frames = [camera.next_frame(WAIT_S) for _ in range(5)]
    assert [one.frame.amplitude[0, 0] for one in frames] == [1, 2, 3, 4, 5]
    assert [one.cycle for one in frames] == [0, 1, 2, 3, 4]
    assert camera.newest_cycle() >= 4
    assert camera.grid.shape == (3, 5)
    assert camera.describe() == {"model": "mine", "gain": 2}
    with pytest.raises(DeviceError, match="already"):
        camera.open()
    camera.close()
    camera.close()
    with pytest.raises(DeviceError, match="not open"):
        camera.next_frame(0.0)


def test_a_frame_began_after_its_call() -> None:
    """The newest cycle is the call under way: whatever is later was exposed later."""
    inside, go_on = threading.Event(), threading.Event()
    calls = []

    def grab() -> NDArray[Any]:
        calls.append(time.monotonic())
        if len(calls) == 3:
            inside.set()
            assert go_on.wait(WAIT_S)
        return np.ones((3, 5))

    camera = CallableCamera(grab, pitch_mm=0.01)
    camera.open()
    assert inside.wait(WAIT_S)
    assert camera.newest_cycle() == 1
    assert camera.next_frame(WAIT_S).cycle == 0
    go_on.set()
    assert camera.next_frame(WAIT_S).cycle == 1
    camera.close()


@pytest.mark.parametrize("late", [True, False])
def test_what_the_function_raises_is_told(late: bool) -> None:
    calls = []

    def grab() -> NDArray[Any]:
        calls.append(1)
        if not late or len(calls) > 2:
            raise OSError("the cable is out")
        return np.ones((3, 5))

    camera = CallableCamera(grab, pitch_mm=0.01)
    if late:
        camera.open()
        camera.next_frame(WAIT_S)
        with pytest.raises(DeviceError, match="the cable is out"):
            camera.next_frame(WAIT_S)
        camera.close()
    else:
        with pytest.raises(OSError, match="cable"):
            camera.open()


def test_a_picture_that_changes_its_shape_is_told() -> None:
    shapes = iter([(3, 5), (3, 5), (5, 3)])
    camera = CallableCamera(lambda: np.ones(next(shapes)), pitch_mm=0.01)
    camera.open()
    camera.next_frame(WAIT_S)
    with pytest.raises(DeviceError, match="has become"):
        camera.next_frame(WAIT_S)
    camera.close()


def test_pictures_in_all_their_forms() -> None:
    amplitude = np.array([[1.0, np.nan, 3.0]])
    distance_m = [[1.0, 2.0, np.inf]]
    frame, raw = frame_from((amplitude, distance_m))
    assert frame.valid.tolist() == [[True, False, False]]
    assert not raw
    frame, raw = frame_from(
        {"amplitude": [[1, 2]], "valid": [[1, 0]], "time_s": 5.0, "temperature": 40.5}
    )
    assert frame.valid.tolist() == [[True, False]]
    assert frame.distance_m is None
    assert frame.time_s == 5.0
    assert raw["temperature"] == 40.5
    masked = np.ma.masked_array([[1.0, 2.0, 3.0]], [[False, True, False]])
    frame, _ = frame_from((masked, np.ma.masked_array([[1.0, 1.0, 0.0]], [[False, False, True]])))
    assert frame.valid.tolist() == [[True, False, False]]
    before_s = time.time()
    frame, _ = frame_from({"amplitude": np.ones((2, 3)), "time_s": None})
    assert before_s <= frame.time_s <= time.time()
    buffer = np.ones((2, 3))
    kept, _ = frame_from(buffer)
    buffer[:] = 7
    assert kept.amplitude.max() == 1


@pytest.mark.parametrize(
    "bad",
    [
        None,
        {},
        np.ones(3),
        np.ones((0, 3)),
        [["a", "b"]],
        (np.ones((2, 3)), np.ones((3, 2))),
        {"amplitude": np.ones((2, 3)), "valid": np.ones((3, 2))},
        np.ones((2, 3), dtype=complex),
        np.ones((2, 3), dtype=bool),
        {"amplitude": np.ones((2, 3)), "time_s": np.nan},
    ],
)
def test_other_pictures_are_refused(bad: Any) -> None:
    with pytest.raises((TypeError, ValueError), match="expected"):
        frame_from(bad)


def test_wrong_arguments() -> None:
    with pytest.raises(TypeError, match="function"):
        CallableCamera(3, pitch_mm=1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="rate"):
        CallableCamera(lambda: None, pitch_mm=1.0, rate_hz=0.0)
    with pytest.raises(ValueError, match="pitch"):
        CallableCamera(lambda: None, pitch_mm=0.0)


def test_a_full_queue_makes_a_recording_wait() -> None:
    receiver = Receiver("camera", depth=2)
    frame = Frame(np.ones((2, 3)), None, np.ones((2, 3), dtype=bool), 0.0)

    def play(stop: threading.Event) -> None:
        for cycle in range(10):
            receiver.put(CameraFrame(frame, cycle, 0.0), wait=True)
        receiver.interrupt("half-time", wait=True)
        receiver.put(CameraFrame(frame, 10, 0.0), wait=True)
        receiver.end("over")

    receiver.start(play)
    assert [receiver.take(WAIT_S, str).cycle for _ in range(10)] == list(range(10))
    with pytest.raises(DeviceError, match="half-time"):
        receiver.take(WAIT_S, str)
    assert receiver.take(WAIT_S, str).cycle == 10
    for _ in range(2):
        with pytest.raises(DeviceError, match="over"):
            receiver.take(WAIT_S, str)
    assert receiver.dropped == 0
    receiver.close()


# GenICam, with a stand-in for harvesters


@dataclass
class Component:
    data_format: str
    data: NDArray[Any]
    width: int = 3
    height: int = 2


@dataclass
class Value:
    value: float


@dataclass
class Nodes:
    Scan3dCoordinateScale: Value = field(default_factory=lambda: Value(0.25))


class StandIn:
    """A harvester, its camera, the camera's device, and a payload: as much as the driver sees."""

    def __init__(self, components: list[Component]) -> None:
        self.device_info_list = ["camera"]
        self.components = components
        self.calls: list[str] = []
        self.node_map = Nodes()
        self.remote_device = self
        self.payload = self

    def create(self, index: int) -> "StandIn":
        return self

    def start(self) -> None:
        self.calls.append("start")

    @contextmanager
    def fetch(self, timeout: float) -> Iterator["StandIn"]:
        yield self

    def stop(self) -> None:
        self.calls.append("stop")

    def destroy(self) -> None:
        self.calls.append("destroy")


INTENSITY = Component("Mono16", np.arange(6, dtype=np.uint16))


def test_range_and_intensity_of_a_genicam_camera() -> None:
    ranges = np.array([0, 4, 8, 12, 16, 20], dtype=np.uint16)
    harvester = StandIn([Component("Coord3D_C16", ranges), INTENSITY])
    camera: Camera = GenicamCamera(pitch_mm=0.01, harvester=harvester)
    camera.open()
    frame = camera.next_frame(WAIT_S).frame
    camera.close()
    camera.close()
    assert harvester.calls == ["start", "stop", "destroy"]
    np.testing.assert_array_equal(frame.amplitude, [[0, 1, 2], [3, 4, 5]])
    assert frame.distance_m is not None
    np.testing.assert_allclose(frame.distance_m, [[0, 1e-3, 2e-3], [3e-3, 4e-3, 5e-3]])
    assert frame.valid.tolist() == [[False, True, True], [True, True, True]]


def test_points_of_a_genicam_camera_give_the_radial_distance() -> None:
    points = np.zeros((6, 3), dtype=np.float32)
    points[:, 2] = 4000.0
    points[1] = (3000.0, 0.0, 4000.0)
    confidence = Component("Confidence16", np.array([1, 1, 1, 0, 1, 1], dtype=np.uint16))
    found = read_components([Component("Coord3D_ABC32f", points.ravel()), INTENSITY, confidence])
    np.testing.assert_allclose(found["distance_m"], [[4, 5, 4], [4, 4, 4]])
    assert found["valid"].tolist() == [[True, True, True], [False, True, True]]


def test_genicam_errors() -> None:
    with pytest.raises(DataError, match="Mono16"):
        read_components([Component("Coord3D_C16", np.ones(6))])
    with pytest.raises(DataError, match="5 values"):
        read_components([Component("Mono16", np.ones(5))])
    with pytest.raises(DeviceError, match="finds 1 cameras"):
        GenicamCamera(pitch_mm=0.01, index=1, harvester=StandIn([INTENSITY])).open()


def test_genicam_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(ImportError, match=r"lensshift\[genicam\]"):
        GenicamCamera("vendor.cti", pitch_mm=0.01)


# Recordings


def seen(number: int) -> Frame:
    amplitude = np.full((16, 64), 0.1 + 0.01 * number)
    return Frame(amplitude, 2.0 + amplitude, np.ones((16, 64), dtype=bool), 0.0)


def write_pcap(path: Path, packets: list[tuple[float, bytes]], port: int = 42000) -> None:
    """Write UDP payloads as a pcap file of raw IP packets from 192.168.0.69:50000."""
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101))
        for time_s, payload in packets:
            udp = struct.pack(">HHHH", 50000, port, 8 + len(payload), 0) + payload
            ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0)
            ip += bytes([192, 168, 0, 69, 255, 255, 255, 255]) + udp
            micro = round(time_s * 1e6)
            head = struct.pack("<IIII", micro // 10**6, micro % 10**6, len(ip), len(ip))
            file.write(head + ip)


def recorded(cycles: list[int], rate_hz: float = 50.0) -> list[tuple[float, bytes]]:
    packets = []
    for number, cycle in enumerate(cycles):
        message = pixel_message(seen(number), timestamp_us=number * 20000)
        for packet in packetise({8: message}, cycle, 14 * cycle):
            packets.append((1000.0 + number / rate_hz, packet))
    return packets


@pytest.mark.parametrize("speed", [math.inf, 4.0])
def test_a_recording_of_an_o3m_plays(tmp_path: Path, speed: float) -> None:
    path = tmp_path / "o3m.pcap"
    write_pcap(path, recorded(list(range(100, 120))))
    camera: Camera = ReplayCamera(path, pitch_mm=0.155, speed=speed, modulation_hz=15e6)
    assert camera.grid.shape == (16, 64)
    begin_s = time.monotonic()
    camera.open()
    frames = [camera.next_frame(WAIT_S) for _ in range(20)]
    took_s = time.monotonic() - begin_s
    assert [one.cycle for one in frames] == list(range(100, 120))
    for number, one in enumerate(frames):
        np.testing.assert_allclose(one.frame.amplitude, 0.1 + 0.01 * number, atol=2e-5)
        assert one.frame.time_s == pytest.approx(0.02 * number)
    if speed == 4.0:
        assert took_s >= 19 / 50 / 4
    assert camera.newest_cycle() == 119
    with pytest.raises(DeviceError, match="the recording has ended after 20 frames"):
        camera.next_frame(WAIT_S)
    assert camera.counts()["frames"] == 20
    assert camera.describe()["recording"] == "o3m.pcap"
    camera.close()
    camera.close()


def test_a_fast_recording_waits_for_the_one_who_fetches(tmp_path: Path) -> None:
    path = tmp_path / "o3m.pcap"
    write_pcap(path, recorded(list(range(90))))
    camera = ReplayCamera(path, pitch_mm=0.155, speed=math.inf)
    camera.open()
    assert camera.newest_cycle() == -1
    assert camera.next_frame(WAIT_S).cycle == 0
    assert camera.newest_cycle() == 0
    assert [camera.next_frame(WAIT_S).cycle for _ in range(89)] == list(range(1, 90))
    assert camera.counts()["dropped_frames"] == 0
    camera.close()


def test_a_restart_in_a_recording_is_told(tmp_path: Path) -> None:
    path = tmp_path / "o3m.pcap"
    write_pcap(path, recorded([100, 101, 3, 4, 5]))
    camera = ReplayCamera(path, pitch_mm=0.155, speed=math.inf)
    camera.open()
    assert [camera.next_frame(WAIT_S).cycle for _ in range(2)] == [100, 101]
    with pytest.raises(DeviceError, match="started anew"):
        camera.next_frame(WAIT_S)
    assert [camera.next_frame(WAIT_S).cycle for _ in range(3)] == [102, 103, 104]
    camera.close()


def test_a_recording_without_frames_says_why(tmp_path: Path) -> None:
    path = tmp_path / "o3m.pcap"
    write_pcap(path, [(1.0, b"hello")])
    camera = ReplayCamera(path, pitch_mm=0.155)
    camera.open()
    with pytest.raises(DeviceError, match=r"0 frames: 1 datagrams came from 192\.168"):
        camera.next_frame(WAIT_S)
    camera.close()
    camera = ReplayCamera(path, pitch_mm=0.155, port=1)
    camera.open()
    with pytest.raises(
        DeviceError, match="0 frames: it holds no UDP datagrams to port 1, in which"
    ):
        camera.next_frame(WAIT_S)
    camera.close()


def test_a_damaged_recording_is_told(tmp_path: Path) -> None:
    path = tmp_path / "o3m.pcap"
    write_pcap(path, recorded([5, 6]))
    path.write_bytes(path.read_bytes() + b"\xff" * 16)
    camera = ReplayCamera(path, pitch_mm=0.155, speed=math.inf)
    camera.open()
    assert [camera.next_frame(WAIT_S).cycle for _ in range(2)] == [5, 6]
    with pytest.raises(DeviceError, match="damaged"):
        camera.next_frame(WAIT_S)
    camera.close()


def test_recordings_wrong_arguments(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="speed"):
        ReplayCamera(tmp_path, pitch_mm=1.0, speed=0.0)
    with pytest.raises(ValueError, match="topic"):
        ReplayCamera(tmp_path, pitch_mm=1.0)
    with pytest.raises(DataError, match=r"none\.pcap: there is no such file"):
        ReplayCamera(tmp_path / "none.pcap", pitch_mm=1.0)
    (tmp_path / "burst.nc").write_bytes(b"x")
    with pytest.raises(DataError, match=r"burst\.nc: expected a pcap, a pcapng or a ROS bag"):
        ReplayCamera(tmp_path / "burst.nc", pitch_mm=1.0)
    pytest.importorskip("rosbags")
    camera = ReplayCamera(tmp_path / "none.bag", pitch_mm=1.0, amplitude_topic="/amplitude")
    with pytest.raises(DeviceError, match="no such file"):
        camera.open()
    with pytest.raises(DeviceError, match="not open"):
        camera.next_frame(0.0)


def write_bag(folder: Path, images: list[tuple[float, str, NDArray[Any]]]) -> None:
    """Write images into a ROS 2 bag."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    encodings = {"f4": "32FC1", "u2": "16UC1", "u1": "mono8"}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = {
            topic: bag.add_connection(topic, "sensor_msgs/msg/Image", typestore=store)
            for topic in dict.fromkeys(topic for _, topic, _ in images)
        }
        for time_s, topic, image in images:
            nano = round(time_s * 1e9)
            stamp = kinds["builtin_interfaces/msg/Time"](sec=nano // 10**9, nanosec=nano % 10**9)
            message = kinds["sensor_msgs/msg/Image"](
                header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
                height=image.shape[0],
                width=image.shape[1],
                encoding=encodings[image.dtype.str[1:]],
                is_bigendian=0,
                step=image.strides[0],
                data=image.view(np.uint8).ravel(),
            )
            data = store.serialize_cdr(message, "sensor_msgs/msg/Image")
            bag.write(topics[topic], nano, data)


def test_a_bag_plays_pairs_of_images(tmp_path: Path) -> None:
    images: list[tuple[float, str, NDArray[Any]]] = []
    for number in range(6):
        time_s = 10.0 + 0.1 * number
        images.append((time_s, "/amplitude", np.full((3, 5), number, np.uint16)))
        if number == 4:
            images.pop()  # lost
        if number != 2:  # lost
            distance = np.full((3, 5), 1000 + number, np.uint16)
            distance[0, 0] = 0
            images.append((time_s + 0.001, "/distance", distance))
    write_bag(tmp_path / "bag", images)
    camera: Camera = ReplayCamera(
        tmp_path / "bag",
        pitch_mm=0.1,
        speed=math.inf,
        amplitude_topic="/amplitude",
        distance_topic="/distance",
    )
    camera.open()
    assert camera.grid.shape == (3, 5)
    with pytest.raises(DeviceError, match="already"):
        camera.open()
    frames = [camera.next_frame(WAIT_S) for _ in range(4)]
    assert [one.frame.amplitude[0, 0] for one in frames] == [0, 1, 3, 5]
    assert [one.cycle for one in frames] == [0, 1, 2, 3]
    for one in frames:
        number = one.frame.amplitude[0, 0]
        assert one.frame.distance_m is not None
        assert one.frame.distance_m[1, 1] == pytest.approx(1.0 + 0.001 * number)
        assert one.frame.valid.sum() == 14
        assert one.frame.time_s == pytest.approx(10.0 + 0.1 * number)
    with pytest.raises(DeviceError, match="has ended after 4 frames"):
        camera.next_frame(WAIT_S)
    assert camera.counts()["unpaired_images"] == 2
    camera.close()


def test_images_of_a_bag_must_have_one_size(tmp_path: Path) -> None:
    one, two = np.ones((3, 5), np.uint16), np.ones((5, 3), np.uint16)
    write_bag(tmp_path / "bag", [(1.0, "/a", one), (1.0, "/d", two)])
    camera = ReplayCamera(tmp_path / "bag", pitch_mm=0.1, amplitude_topic="/a", distance_topic="/d")
    camera.open()
    with pytest.raises(DeviceError, match="like amplitude"):
        camera.next_frame(WAIT_S)
    camera.close()


def test_a_bag_of_amplitudes_alone(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", [(1.0, "/a", np.ones((3, 5), np.float32))])
    camera = ReplayCamera(tmp_path / "bag", pitch_mm=0.1, amplitude_topic="/a")
    camera.open()
    frame = camera.next_frame(WAIT_S).frame
    assert frame.distance_m is None
    assert frame.amplitude.shape == (3, 5)
    camera.close()
    camera = ReplayCamera(tmp_path / "bag", pitch_mm=0.1, amplitude_topic="/b")
    with pytest.raises(DeviceError, match="no images of topic /b"):
        camera.open()


def test_a_gap_in_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "o3m.pcap"
    write_pcap(path, recorded([5, 6], rate_hz=0.001))
    camera = ReplayCamera(path, pitch_mm=0.155)
    camera.open()
    camera.next_frame(WAIT_S)
    with pytest.raises(DeviceTimeout, match="gap"):
        camera.next_frame(0.05)
    camera.close()
