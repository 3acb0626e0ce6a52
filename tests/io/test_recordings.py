"""UDP out of packet recordings, images out of bags, written here from the public formats."""

import gzip
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lensshift.core.errors import DataError, QualityWarning
from lensshift.io.recordings import is_udp_recording, read_bag, read_udp

PAYLOAD = bytes(range(200))
SENT = (("192.168.1.69", 1234), 42000, PAYLOAD)
MAC = bytes(12)


def udp(payload: bytes = PAYLOAD, source: int = 1234, target: int = 42000) -> bytes:
    return struct.pack(">HHHH", source, target, 8 + len(payload), 0) + payload


def ip(body: bytes, identity: int = 1, at: int = 0, more: bool = False, kind: int = 17) -> bytes:
    flags = (0x2000 if more else 0) | at // 8
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), identity, flags, 64, kind, 0)
    return head + bytes([192, 168, 1, 69, 192, 168, 1, 255]) + body


LINKS: dict[str, tuple[int, bytes]] = {
    "ethernet": (1, MAC + b"\x08\x00"),
    "vlan": (1, MAC + b"\x81\x00\x00\x05\x08\x00"),
    "two vlans": (1, MAC + b"\x88\xa8\x00\x05\x81\x00\x00\x05\x08\x00"),
    "linux cooked": (113, bytes(14) + b"\x08\x00"),
    "linux cooked 2": (276, b"\x08\x00" + bytes(18)),
    "raw ip": (101, b""),
    "raw ipv4": (228, b""),
    "loopback": (0, b"\x02\0\0\0"),
}


def pcap(
    packets: list[tuple[float, bytes]], link: int = 101, order: str = "<", tick: float = 1e-6
) -> bytes:
    magic = 0xA1B2C3D4 if tick == 1e-6 else 0xA1B23C4D
    out = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)
    for time_s, data in packets:
        ticks = round((time_s % 1) / tick)
        out += struct.pack(order + "IIII", int(time_s), ticks, len(data), len(data)) + data
    return out


def block(kind: int, body: bytes, order: str) -> bytes:
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + size + body + size


def pcapng(
    packets: list[tuple[float, bytes]], link: int = 101, order: str = "<", options: bytes = b""
) -> bytes:
    out = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)
    out += block(1, struct.pack(order + "HHI", link, 0, 0) + options, order)
    out += block(5, bytes(12), order)  # statistics: to be skipped
    tick = 1e-9 if options else 1e-6
    for time_s, data in packets:
        ticks = round(time_s / tick)
        head = struct.pack(
            order + "IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data)
        )
        out += block(6, head + data, order)
    return out


@pytest.fixture
def written(tmp_path: Path) -> Callable[[bytes], Path]:
    def write(content: bytes) -> Path:
        path = tmp_path / "recording.pcap"
        path.write_bytes(content)
        return path

    return write


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("container", [pcap, pcapng])
def test_every_link(
    container: Callable[..., bytes], link: str, written: Callable[[bytes], Path]
) -> None:
    number, head = LINKS[link]
    path = written(container([(100.25, head + ip(udp()))], number))
    assert is_udp_recording(path)
    (datagram,) = read_udp(path)
    assert datagram[1:] == SENT
    assert datagram.time_s == 100.25


@pytest.mark.parametrize("container", [pcap, pcapng])
def test_an_archive_is_read_as_it_is(
    container: Callable[..., bytes], written: Callable[[bytes], Path]
) -> None:
    packed = gzip.compress(container([(100.25, ip(udp()))]))
    path = written(packed)
    assert is_udp_recording(path)
    (datagram,) = read_udp(path)
    assert datagram[1:] == SENT
    with pytest.raises(DataError, match="damaged or cut short"):
        list(read_udp(written(packed[:-12])))
    assert not is_udp_recording(written(gzip.compress(b"no packets")))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("tick", [1e-6, 1e-9])
def test_byte_orders_and_ticks(order: str, tick: float, written: Callable[[bytes], Path]) -> None:
    packets = [(5.25, ip(udp(b"one"))), (6.5, ip(udp(b"two")))]
    got = list(read_udp(written(pcap(packets, order=order, tick=tick))))
    assert [(one.time_s, one.payload) for one in got] == [(5.25, b"one"), (6.5, b"two")]
    # Option 9: time in units of 10^-9 s.
    options = struct.pack(order + "HHB3xHH", 9, 1, 9, 0, 0) if tick == 1e-9 else b""
    got = list(read_udp(written(pcapng(packets, order=order, options=options))))
    assert [(one.time_s, one.payload) for one in got] == [(5.25, b"one"), (6.5, b"two")]


def test_sections_interfaces_and_simple_packets(written: Callable[[bytes], Path]) -> None:
    first = pcapng([(1.0, ip(udp(b"one")))])
    frame = MAC + b"\x08\x00" + ip(udp(b"two"))
    simple = block(3, struct.pack(">I", len(frame)) + frame, ">")
    # Option 9 with its top bit: powers of two; option 14: a start in seconds.
    options = struct.pack(">HHB3xHHqHH", 9, 1, 0x80 | 10, 14, 8, 1000, 0, 0)
    second = pcapng([], 1, ">", options)
    ticks = 3 * 1024
    old = struct.pack(">HHIIII", 0, 0, 0, ticks, len(frame), len(frame)) + frame
    got = list(read_udp(written(first + second + simple + block(2, old, ">"))))
    assert [one.payload for one in got] == [b"one", b"two", b"two"]
    assert got[2].time_s == 1003.0


def test_other_traffic_is_left_out(written: Callable[[bytes], Path]) -> None:
    ethernet = [
        MAC + b"\x08\x06" + bytes(28),  # ARP
        MAC + b"\x86\xdd" + bytes(60),  # IPv6
        MAC + b"\x08\x00" + ip(bytes(40), kind=6),  # TCP
        MAC,
        b"",
        MAC + b"\x08\x00" + b"\x45",
        MAC + b"\x08\x00" + ip(udp()) + bytes(6),  # padded to the least length of a frame
    ]
    got = list(read_udp(written(pcap([(1.0, one) for one in ethernet], 1))))
    assert [one[1:] for one in got] == [SENT]
    assert list(read_udp(written(pcap([(1.0, ip(udp()))], 147)))) == []


def test_fragments_are_put_together(written: Callable[[bytes], Path]) -> None:
    payload = bytes(n % 256 for n in range(5000))
    body = udp(payload)
    cuts = [(at, body[at : at + 1480]) for at in range(0, len(body), 1480)]
    parts = [ip(one, 9, at, more=at + len(one) < len(body)) for at, one in cuts]
    other = ip(udp(b"between"), 10)
    order = [parts[2], parts[0], other, parts[3], parts[0], parts[1]]
    got = list(read_udp(written(pcap([(1.0, one) for one in order]))))
    assert [one.payload for one in got] == [b"between", payload]


def test_a_missing_fragment_is_counted(written: Callable[[bytes], Path]) -> None:
    packets = [(1.0, ip(bytes(16), 9, 0, more=True)), (2.0, ip(udp()))]
    with pytest.warns(QualityWarning, match="1 lack a fragment"):
        assert [one[1:] for one in read_udp(written(pcap(packets)))] == [SENT]


def test_many_open_fragments_take_no_memory(written: Callable[[bytes], Path]) -> None:
    packets = [(1.0, ip(bytes(16), n, 0, more=True)) for n in range(500)]
    with pytest.warns(QualityWarning, match="500 lack a fragment"):
        assert list(read_udp(written(pcap(packets)))) == []


def test_packets_recorded_in_part_are_counted(written: Callable[[bytes], Path]) -> None:
    packets = [(1.0, ip(udp())[:96]), (2.0, ip(udp()))]
    with pytest.warns(QualityWarning, match="1 datagrams were recorded in part"):
        assert [one[1:] for one in read_udp(written(pcap(packets)))] == [SENT]


@pytest.mark.parametrize("container", [pcap, pcapng])
@pytest.mark.parametrize("missing", [1, 100, 230])
def test_a_file_cut_off_gives_what_is_whole(
    container: Callable[..., bytes], missing: int, written: Callable[[bytes], Path]
) -> None:
    content = container([(1.0, ip(udp())), (2.0, ip(udp()))])
    with pytest.warns(QualityWarning, match="cut off after 1 packets"):
        assert [one[1:] for one in read_udp(written(content[:-missing]))] == [SENT]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "empty"),
        (b"PK\x03\x04 a zip", "pcap"),
        (pcap([]) + b"\xff" * 16, "damaged"),
        (pcapng([]) + b"\xff" * 16, "damaged"),
        (pcapng([])[:-4] + b"\xff" * 4, "sizes"),
        (b"\x0a\x0d\x0d\x0a" + bytes(40), "byte order"),
        (pcapng([]) + block(6, struct.pack("<IIIII", 7, 0, 0, 0, 0), "<"), "interface 7"),
        (pcapng([]) + block(6, bytes(4), "<"), "damaged"),
    ],
)
def test_garbage_is_refused(content: bytes, told: str, written: Callable[[bytes], Path]) -> None:
    path = written(content)
    with pytest.raises(DataError, match=told) as error:
        list(read_udp(path))
    assert str(path) in str(error.value)


def test_no_file(tmp_path: Path) -> None:
    assert not is_udp_recording(tmp_path / "none")
    with pytest.raises(DataError, match="no such file"):
        list(read_udp(tmp_path / "none"))


@given(
    data=st.data(),
    container=st.sampled_from([pcap, pcapng]),
    link=st.sampled_from(list(LINKS.values())),
)
@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_damaged_files_give_datagrams_or_data_errors(
    tmp_path_factory: pytest.TempPathFactory,
    data: st.DataObject,
    container: Callable[..., bytes],
    link: tuple[int, bytes],
) -> None:
    content = bytearray(container([(1.0, link[1] + ip(udp()))] * 3, link[0]))
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damaged") / "recording"
    path.write_bytes(content)
    told = str(path)
    try:
        assert len(list(read_udp(path))) <= 3
    except DataError as error:
        told = str(error)
    assert str(path) in told


# Bags


def image_message(store: Any, image: NDArray[Any], encoding: str, **header: Any) -> Any:
    kinds = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=12, nanosec=250_000_000)
    order = image.dtype.byteorder == ">"
    return kinds["sensor_msgs/msg/Image"](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="camera", **header),
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=int(order),
        step=image.strides[0],
        data=np.frombuffer(image.tobytes(), np.uint8),
    )


def images() -> list[tuple[str, NDArray[Any]]]:
    rng = np.random.default_rng(0)
    return [
        ("32FC1", rng.random((3, 5)).astype(np.float32)),
        ("16UC1", rng.integers(0, 65535, (3, 5)).astype(np.uint16)),
        ("mono16", rng.integers(0, 65535, (3, 5)).astype(">u2")),
        ("mono8", rng.integers(0, 255, (3, 5)).astype(np.uint8)),
        ("rgb8", rng.integers(0, 255, (3, 15)).astype(np.uint8)),
    ]


def write_ros1(path: Path) -> Path:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "sensor_msgs/msg/Image"
    with Writer(path / "one.bag") as bag:
        for encoding, image in images():
            topic = bag.add_connection(f"/{encoding}", kind, typestore=store)
            data = store.serialize_ros1(image_message(store, image, encoding, seq=0), kind)
            bag.write(topic, 5 * 10**9, data)
    return path / "one.bag"


def write_ros2(path: Path, mcap: bool) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/Image"
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path / "two", version=9, storage_plugin=plugin) as bag:
        for encoding, image in images():
            topic = bag.add_connection(f"/{encoding}", kind, typestore=store)
            data = store.serialize_cdr(image_message(store, image, encoding), kind)
            bag.write(topic, 5 * 10**9, data)
    return path / "two"


@pytest.mark.parametrize("kind", ["ros1", "ros2", "mcap", "mcap file"])
def test_images_come_back_from_a_bag(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("rosbags")
    path = write_ros1(tmp_path) if kind == "ros1" else write_ros2(tmp_path, "mcap" in kind)
    if kind == "mcap file":
        (path,) = path.glob("*.mcap")
    got = {one.topic: one for one in read_bag(path)}
    assert sorted(got) == ["/16UC1", "/32FC1", "/mono16", "/mono8"]  # no colours
    for encoding, image in images()[:4]:
        one = got[f"/{encoding}"]
        np.testing.assert_array_equal(one.image, image)
        assert one.image.dtype.isnative
        assert one.time_s == 12.25
    assert [one.topic for one in read_bag(path, ["/mono8"])] == ["/mono8"]
    assert list(read_bag(path, ["/none"])) == []


def test_damaged_bags_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    for name in ("one.bag", "one.mcap", "one.txt"):
        path = tmp_path / name
        path.write_bytes(b"nothing of the kind" * 20)
        with pytest.raises(DataError, match=name):
            list(read_bag(path))
    with pytest.raises(DataError, match="no such file"):
        list(read_bag(tmp_path / "none.bag"))
    (tmp_path / "folder").mkdir()
    with pytest.raises(DataError, match="folder"):
        list(read_bag(tmp_path / "folder"))


def test_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ImportError, match=r"lensshift\[recordings\]"):
        list(read_bag(tmp_path))
