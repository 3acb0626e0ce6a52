"""The driver of the O3M against the emulator, over the loopback of this computer."""

import gc
import itertools
import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from lensshift.capture.drivers.o3m import O3MCamera
from lensshift.capture.drivers.o3m_packets import Reassembler
from lensshift.capture.drivers.o3m_stream import O3MStream
from lensshift.capture.drivers.receiver import Receiver
from lensshift.capture.emulators.o3m import (
    Look,
    O3MSender,
    diagnosis_message,
    packetise,
    pixel_message,
)
from lensshift.capture.rig import CameraFrame
from lensshift.core.errors import DeviceError, DeviceTimeout
from lensshift.core.types import Frame

WAIT_S = 30.0  # for a slow machine; a frame comes after 20 ms
CAMERA = ("192.168.0.69", 50000)
OTHER = ("192.168.0.70", 50000)


def seen(number: int = 0) -> Frame:
    """Return a frame whose every pixel tells its number."""
    value = 0.1 + 0.01 * (number % 100)
    ramp = np.linspace(0, 0.005, 64)
    amplitude = np.broadcast_to(value + ramp, (16, 64)).copy()
    return Frame(amplitude, 2.0 + amplitude, np.ones((16, 64), dtype=bool), 0.0)


def number_of(frame: Frame) -> int:
    """Return the number of a frame; raise if its pixels are not all of one."""
    assert frame.distance_m is not None
    expected = seen(round((frame.amplitude[0, 0] - 0.1) * 100))
    np.testing.assert_allclose(frame.amplitude, expected.amplitude, atol=2e-5)
    assert expected.distance_m is not None
    np.testing.assert_allclose(frame.distance_m, expected.distance_m, atol=1e-5)
    return round((frame.amplitude[0, 0] - 0.1) * 100)


@pytest.fixture
def camera() -> Iterator[O3MCamera]:
    one = O3MCamera(0, host="127.0.0.1", modulation_hz=15e6)
    one.open()
    yield one
    one.close()


def sender(camera: O3MCamera, **settings: object) -> O3MSender:
    numbers = itertools.count()
    return O3MSender(
        lambda begin_s, end_s: seen(next(numbers)),
        port=camera.port,
        **settings,  # type: ignore[arg-type]
    )


def fetch_many(camera: O3MCamera) -> None:
    for _ in range(1000):
        camera.next_frame(WAIT_S)


def why_not(camera: O3MCamera) -> str:
    """Return why there is no frame in a short time, empty if there is one."""
    try:
        camera.next_frame(0.2)
    except DeviceTimeout as error:
        return str(error)
    return ""


def test_frames_arrive_whole_and_in_order_at_50_hz(camera: O3MCamera) -> None:
    with sender(camera, rate_hz=50.0) as emulator:
        frames = [camera.next_frame(WAIT_S) for _ in range(40)]
        numbers = [number_of(one.frame) for one in frames]
        assert np.all(np.diff(numbers) >= 1)
        # A busy machine may not fetch in time; what is missing then was held, and counted.
        assert numbers[-1] - 39 <= camera.counts()["dropped_frames"]
        cycles = [one.cycle for one in frames]
        assert all(np.diff(cycles) >= 1)
        assert camera.newest_cycle() >= cycles[-1]
        # The clock of the camera tells how far apart the exposures were.
        times_s = np.array([one.frame.time_s for one in frames])
        np.testing.assert_allclose(np.diff(times_s), np.diff(cycles) * 0.02, atol=1e-5)
        assert frames[0].arrived_s <= time.monotonic()
        assert set(frames[0].raw) >= {"distance_cm", "amplitude", "confidence", "normalization"}
    # Asked when the sender has ended: it counts a frame after the last packet has left.
    assert emulator.sent >= 40
    counts = camera.counts()
    assert counts["frames"] >= 40
    assert counts["lost_packets"] == counts["partial_cycles"] == counts["foreign_packets"] == 0
    about = camera.describe()
    assert about["layout"] == "DIA1 1.4"
    assert about["mode"] == "run"
    assert about["main_celsius"] == 41.5
    assert about["parameters_hex"].startswith(b"O3M!DID1".hex())
    assert len(about["normalization"]) == 4
    assert camera.grid.shape == (16, 64)
    assert camera.grid.pitch_mm == (0.155, 0.155)
    assert camera.modulation_hz == 15e6


def test_no_frame_is_mixed_although_packets_are_lost_doubled_and_swapped(
    camera: O3MCamera,
) -> None:
    with sender(camera, rate_hz=50.0, loss=0.03, reorder=0.1, duplicate=0.05, seed=3):
        frames = [camera.next_frame(WAIT_S) for _ in range(15)]
    numbers = [number_of(one.frame) for one in frames]
    assert np.all(np.diff(numbers) >= 1)
    counts = camera.counts()
    assert counts["lost_packets"] > 0
    assert counts["partial_cycles"] > 0
    assert counts["duplicate_packets"] > 0


def test_a_camera_that_starts_anew_is_told_and_frames_go_on(camera: O3MCamera) -> None:
    with sender(camera, rate_hz=50.0) as emulator:
        before = camera.next_frame(WAIT_S)
        emulator.reboot()
        with pytest.raises(DeviceError, match="started anew"):
            fetch_many(camera)
        assert camera.next_frame(WAIT_S).cycle > before.cycle
    assert camera.counts()["restarts"] == 1


def test_a_camera_that_falls_silent(camera: O3MCamera) -> None:
    with sender(camera, rate_hz=50.0) as emulator:
        camera.next_frame(WAIT_S)
        emulator.pause()
        told = ""
        while "nothing arrives any more" not in told:
            told = why_not(camera)
        emulator.resume()
        camera.next_frame(WAIT_S)


def test_another_version_is_named(camera: O3MCamera) -> None:
    with sender(camera, rate_hz=50.0, layout="1.0") as emulator:
        assert camera.next_frame(WAIT_S).frame.valid.all()
        assert camera.describe()["layout"] == "DI 1.0"
        emulator.set_layout("1.2")
        while camera.describe()["layout"] != "DIA1 1.2":
            camera.next_frame(WAIT_S)


def test_frames_that_nobody_fetches_are_dropped_oldest_first() -> None:
    receiver = Receiver("camera", depth=3)
    receiver.start(lambda stop: None)
    for cycle in range(5):
        receiver.put(CameraFrame(seen(), cycle, 0.0))
    assert [receiver.take(0, str).cycle for _ in range(3)] == [2, 3, 4]
    assert (receiver.frames, receiver.dropped) == (5, 2)
    with pytest.raises(DeviceTimeout, match="gone fishing"):
        receiver.take(0.01, lambda: "gone fishing")
    with pytest.raises(ValueError, match="-1"):
        receiver.take(-1, str)
    receiver.close()


def test_nothing_arrives(camera: O3MCamera) -> None:
    with pytest.raises(DeviceTimeout, match="nothing arrives; check power"):
        camera.next_frame(0.01)
    assert camera.newest_cycle() == -1


def test_the_port_is_taken(camera: O3MCamera) -> None:
    second = O3MCamera(camera.port, host="127.0.0.1")
    with pytest.raises(DeviceError, match="close other programs"):
        second.open()
    with pytest.raises(DeviceError, match="already"):
        camera.open()


def test_it_can_be_closed_twice_and_opened_again() -> None:
    camera = O3MCamera(0, host="127.0.0.1")
    with pytest.raises(DeviceError, match="not open"):
        camera.next_frame(0.0)
    for _ in range(2):
        camera.open()
        with sender(camera, rate_hz=50.0):
            camera.next_frame(WAIT_S)
        camera.close()
        camera.close()
    with pytest.raises(DeviceError, match="not open"):
        camera.next_frame(0.0)


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="65535"):
        O3MCamera(70000)
    with pytest.raises(ValueError, match="pitch"):
        O3MCamera(pitch_mm=-1.0)
    with pytest.raises(ValueError, match="this computer"):
        O3MSender(lambda a, b: seen(), port=1, host="192.168.0.1")
    with pytest.raises(ValueError, match="port"):
        O3MSender(lambda a, b: seen(), port=0)
    with pytest.raises(ValueError, match="exposure"):
        O3MSender(lambda a, b: seen(), port=1, rate_hz=50.0, exposure_s=0.03)
    with pytest.raises(ValueError, match="layout"):
        O3MSender(lambda a, b: seen(), port=1, layout="2.0")


def test_the_clock_of_the_camera_goes_on_where_its_counter_wraps() -> None:
    stream = O3MStream()
    times_s = []
    for cycle in range(4):
        message = pixel_message(seen(), timestamp_us=2**32 - 30_000 + cycle * 20_000)
        for packet in packetise({8: message}, cycle, 14 * cycle):
            frame = stream.push(packet, CAMERA, 0.02 * cycle)
        assert frame is not None
        times_s.append(frame.frame.time_s)
    np.testing.assert_allclose(np.diff(times_s), 0.02, atol=1e-9)


# Why no frame came, without sockets: datagrams are given to the stream by hand.


def reason(stream: O3MStream, packets: list[bytes], address: tuple[str, int] = CAMERA) -> str:
    before = stream.snapshot()
    for number, packet in enumerate(packets):
        assert stream.push(packet, address, 0.001 * number) is None
    return stream.explain(before)


def test_reason_foreign_datagrams() -> None:
    assert "192.168.0.69:50000, none an O3M's" in reason(O3MStream(), [b"hello"] * 5)


def test_reason_another_camera() -> None:
    packets = packetise({8: pixel_message(seen())}, 5, 0)
    told = reason(O3MStream("10.0.0.1"), packets)
    assert "only from 192.168.0.69:50000, none from 10.0.0.1" in told


def test_reason_partial_cycles() -> None:
    packets = [
        packet
        for cycle in range(10)
        for packet in packetise({8: pixel_message(seen())}, cycle, 14 * cycle)[:-7]
    ]
    told = reason(O3MStream(), packets)
    assert "only parts of cycles" in told
    assert "47 % of the packets are lost" in told  # 9 of 10 gaps are seen: 63 of 133


def test_reason_wrong_channel_and_mode() -> None:
    told = reason(O3MStream(), packetise({20: bytes(900), 256: diagnosis_message(0x15)}, 5, 0))
    assert "channel 20, 256 arrives, but not channel 8" in told
    assert "mode: booting" in told


def test_reason_wrong_size() -> None:
    told = reason(O3MStream(), packetise({8: bytes(17000)}, 5, 0))
    assert "1 messages of an unknown version or size" in told
    assert "17000 bytes" in told


def test_two_cameras_are_told_apart_by_their_address() -> None:
    streams = {None: O3MStream(), CAMERA[0]: O3MStream(CAMERA[0]), OTHER: O3MStream(OTHER[0])}
    one = packetise({8: pixel_message(seen(1))}, 5, 70)
    two = packetise({8: pixel_message(seen(2))}, 5, 70)
    numbers: dict[object, list[int]] = {source: [] for source in streams}
    for first, second in zip(one, two, strict=True):
        for source, stream in streams.items():
            for packet, address in ((first, CAMERA), (second, OTHER)):
                frame = stream.push(packet, address, 0.0)
                if frame is not None:
                    numbers[source].append(number_of(frame.frame))
    assert numbers == {None: [1], CAMERA[0]: [1], OTHER: [2]}
    assert streams[CAMERA[0]].totals()["other_cameras_packets"] == len(two)
    assert streams[None].totals()["other_cameras_images"] == 1
    assert "192.168.0.70:50000 sends images too" in streams[None].describe()["another_camera"]
    assert "another_camera" not in streams[CAMERA[0]].describe()


def test_a_second_camera_on_the_port_does_not_disturb_the_first(camera: O3MCamera) -> None:
    with sender(camera, rate_hz=50.0):
        first = number_of(camera.next_frame(WAIT_S).frame)
        with sender(camera, rate_hz=50.0):
            numbers = [number_of(camera.next_frame(WAIT_S).frame) for _ in range(40)]
        assert np.all(np.diff([first, *numbers]) >= 1)  # those of one camera, in order
    assert camera.counts()["other_cameras_images"] > 0


def test_one_of_two_cameras_is_chosen_by_its_port(camera: O3MCamera) -> None:
    def look(number: int) -> Look:
        return lambda begin_s, end_s: seen(number)

    one, two = (O3MSender(look(n), port=camera.port, rate_hz=50.0) for n in (1, 2))
    camera.close()
    host, port = two.address
    chosen = O3MCamera(camera.port, host="127.0.0.1", source=f"{host}:{port}")
    chosen.open()
    with one, two:
        assert {number_of(chosen.next_frame(WAIT_S).frame) for _ in range(5)} == {2}
    chosen.close()


def images(
    stream: O3MStream, address: tuple[str, int], numbers: range, start_s: float = 0.0
) -> list[int]:
    """Push whole images, one each 20 ms; return the numbers of those that came out."""
    came = []
    for number in numbers:
        message = pixel_message(seen(number))
        for packet in packetise({8: message}, 100 + number, 1000 + 14 * number):
            frame = stream.push(packet, address, start_s + 0.02 * number)
            if frame is not None:
                came.append(number_of(frame.frame))
    return came


@pytest.mark.parametrize("source", [None, CAMERA[0]])
def test_only_a_sender_of_pixels_is_the_camera(source: str | None) -> None:
    """A stranger's diagnosis, before the camera is heard and later, is counted and left aside."""
    stream = O3MStream(source)
    (stray,) = packetise({256: diagnosis_message(0x31)}, 5, 1)
    assert stream.push(stray, OTHER, 0.0) is None
    assert stream.newest_cycle() == -1
    assert images(stream, CAMERA, range(5)) == list(range(5))
    assert stream.push(stray, OTHER, 0.1) is None
    assert images(stream, CAMERA, range(5, 10)) == list(range(5, 10))
    assert "mode" not in stream.describe()
    (own,) = packetise({256: diagnosis_message(0x22)}, 5, 1)  # from another port of the camera
    assert stream.push(own, (CAMERA[0], 50001), 0.2) is None
    assert stream.describe()["mode"] == "run"
    assert stream.totals()["other_cameras_packets"] == (1 if source is None else 2)


def test_strangers_do_not_lock_the_camera_out() -> None:
    stream = O3MStream()
    part = packetise({8: pixel_message(seen())}, 5, 0)[0]
    for number in range(1000):
        stream.push(part, ("10.0.0.1", number), 0.0)
    held = sum(type(one) is Reassembler for one in gc.get_objects())
    assert held < 100  # and no memory taken
    assert images(stream, CAMERA, range(3)) == [0, 1, 2]
    for number in range(1000):
        stream.push(part, (CAMERA[0], number), 0.07)
    assert stream.totals()["other_cameras_packets"] == 1000
    assert images(stream, CAMERA, range(4, 7)) == [4, 5, 6]
    assert stream.totals()["lost_packets"] == 14  # image 3, and none of the strangers


def test_another_camera_takes_the_place_of_a_silent_one_only() -> None:
    stream = O3MStream()
    assert images(stream, CAMERA, range(3)) == [0, 1, 2]
    assert images(stream, OTHER, range(1), start_s=0.1) == []
    with pytest.raises(DeviceError, match=r"has fallen silent, images come from 192\.168\.0\.70:"):
        images(stream, OTHER, range(1, 2), start_s=5.0)  # told once: its counters are its own
    assert images(stream, OTHER, range(2, 5), start_s=5.0) == [2, 3, 4]
    assert stream.address == "192.168.0.70:50000"


def test_a_datagram_that_is_too_long_does_no_harm(camera: O3MCamera) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(bytes(30000), ("127.0.0.1", camera.port))
        stranger.sendto(b"", ("127.0.0.1", camera.port))
    with sender(camera, rate_hz=50.0):
        camera.next_frame(WAIT_S)
    assert camera.counts()["foreign_packets"] == 2
