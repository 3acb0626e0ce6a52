"""Recordings of what a camera sent: UDP from pcap and pcapng files, images from ROS bags."""

from __future__ import annotations

import gzip
import socket
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, of_extra, warn_quality
from lensshift.io.reading import reading, require_file

_PCAP = {  # magic as it lies in the file -> byte order, seconds of a tick
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
_SECTION = b"\x0a\x0d\x0d\x0a"  # first block of a pcapng file, the same in both byte orders
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_INTERFACE, _PACKET, _SIMPLE, _ENHANCED = 1, 2, 3, 6  # blocks of pcapng
_TICK_OPTION, _START_OPTION = 9, 14  # of an interface: if_tsresol, if_tsoffset
_MAX_BYTES = 1 << 20  # of a packet or block; a datagram has 64 KiB at most
_MAX_INTERFACES = 1024  # more is damage

_ETHERNET, _LINUX_COOKED, _LINUX_COOKED_2 = 1, 113, 276  # link types of tcpdump.org
_LOOPBACKS = (0, 108)  # BSD, OpenBSD
_RAW = (12, 14, 101, 228)  # IP without a link
_IPV4 = 0x0800  # EtherType
_VLAN_TAGS = (0x8100, 0x88A8, 0x9100)  # EtherTypes
_MAX_OPEN = 64  # datagrams of which fragments are missing
_MAX_IP_BYTES = 65535  # of an IPv4 packet
_ENCODINGS = {"32FC1": "f4", "16UC1": "u2", "mono16": "u2", "mono8": "u1"}


class Packet(NamedTuple):
    """A packet as it was on the wire."""

    time_s: float  # since 1970
    link: int  # kind of its outermost header, a LINKTYPE
    data: bytes  # as far as it was recorded


class _CutOffError(Exception):
    """The file ends within a block."""


def is_capture(first: bytes) -> bool:
    """Tell by its first four bytes whether a file is pcap or pcapng."""
    return first in _PCAP or first == _SECTION


def read_packets(file: BinaryIO, name: str) -> Iterator[Packet]:
    """Yield the packets of an open pcap or pcapng file (or a DataError); warn if it is cut off."""
    magic = file.read(4)
    if not is_capture(magic):
        raise DataError(f"expected a pcap or pcapng file, got one that begins with {magic!r}")
    count = 0
    try:
        for packet in _pcapng(file) if magic == _SECTION else _pcap(file, *_PCAP[magic]):
            count += 1
            yield packet
    except _CutOffError:
        warn_quality(f"{name}: the file is cut off after {count} packets", 3)


def _take(file: BinaryIO, size: int, *, or_none: bool = False) -> bytes:
    data = file.read(size)
    if len(data) < size and not (or_none and not data):
        raise _CutOffError
    return data


def _check_size(size: int, least: int, at: int) -> None:
    if not least <= size <= _MAX_BYTES:
        raise DataError(f"damaged: a block of {size} bytes before byte {at}", field="packet")


def _pcap(file: BinaryIO, order: str, tick_s: float) -> Iterator[Packet]:
    head = _take(file, 20)
    link = int(struct.unpack(order + "I", head[16:])[0]) & 0xFFFF  # above: check sums
    record = struct.Struct(order + "4I")
    while data := _take(file, record.size, or_none=True):
        seconds, ticks, size, _ = record.unpack(data)
        _check_size(size, 0, file.tell())
        yield Packet(seconds + ticks * tick_s, link, _take(file, size))


class _Interface(NamedTuple):
    link: int
    tick_s: float
    start_s: int
    snap_bytes: int


def _pcapng(file: BinaryIO) -> Iterator[Packet]:
    order = ""
    interfaces: list[_Interface] = []
    kind = _SECTION
    while kind:
        size_bytes = _take(file, 4)
        read = 8
        if kind == _SECTION:
            magic = _take(file, 4)
            if magic not in _ORDERS:
                raise DataError(f"damaged: byte order {magic!r}", field="section")
            order, interfaces, read = _ORDERS[magic], [], 12
        size = int(struct.unpack(order + "I", size_bytes)[0])
        _check_size(size, read + 4, file.tell())
        body = _take(file, size - read)
        if body[-4:] != size_bytes:
            problem = f"damaged: the two sizes of a block differ before byte {file.tell()}"
            raise DataError(problem, field="packet")
        number = 0 if kind == _SECTION else struct.unpack(order + "I", kind)[0]
        if number == _INTERFACE and len(interfaces) < _MAX_INTERFACES:
            interfaces.append(_interface(body[:-4], order))
        elif number in (_ENHANCED, _PACKET, _SIMPLE):
            yield _packet(body[:-4], order, number, interfaces)
        kind = _take(file, 4, or_none=True)


def _interface(body: bytes, order: str) -> _Interface:
    link, _, snap = struct.unpack_from(order + "HHI", body)
    tick_s, start_s = 1e-6, 0
    at = 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(order + "HH", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == _TICK_OPTION and size == 1:
            tick_s = 2.0 ** -(value[0] & 0x7F) if value[0] & 0x80 else 10.0 ** -value[0]
        elif code == _START_OPTION and size == 8:
            start_s = int(struct.unpack(order + "q", value)[0])
        at += 4 + (size + 3) // 4 * 4
    return _Interface(link, tick_s, start_s, snap)


def _packet(body: bytes, order: str, number: int, interfaces: list[_Interface]) -> Packet:
    if number == _SIMPLE:
        (index, high, low), start = (0, 0, 0), 4
        size = int(struct.unpack_from(order + "I", body)[0])
        size = min(size, len(body) - start)
    else:
        layout = "IIIII" if number == _ENHANCED else "HHIIII"
        values = struct.unpack_from(order + layout, body)
        index, high, low, size = values[0], *values[-4:-1]
        start = 20
    if index >= len(interfaces) or start + size > len(body):
        raise DataError(f"damaged: {size} bytes of interface {index}", field="packet")
    interface = interfaces[index]
    if number == _SIMPLE and interface.snap_bytes:
        size = min(size, interface.snap_bytes)
    time_s = interface.start_s + ((high << 32) + low) * interface.tick_s
    return Packet(time_s, interface.link, body[start : start + size])


class Datagram(NamedTuple):
    """One UDP datagram."""

    time_s: float  # when it was recorded, since 1970
    source: tuple[str, int]  # (address, port) that it came from
    destination_port: int  # port that it went to
    payload: bytes  # what was in it


class _Fragments:
    """What has come of one fragmented IPv4 packet."""

    def __init__(self) -> None:
        self.parts: dict[int, bytes] = {}
        self.total: int | None = None

    def whole(self) -> bytes | None:
        """Return the joined fragments if there is no gap."""
        joined = bytearray()
        for start in sorted(self.parts):
            if start > len(joined):
                return None
            joined[start:] = self.parts[start]
        return bytes(joined) if len(joined) == self.total else None


class UdpReader:
    """Takes recorded packets, returns UDP datagrams; counts the `cut` and the `incomplete` ones."""

    def __init__(self) -> None:
        self.cut = 0
        self._given_up = 0
        self._open: dict[tuple[bytes, int], _Fragments] = {}

    @property
    def incomplete(self) -> int:
        """Number of datagrams of which a fragment is missing so far."""
        return self._given_up + len(self._open)

    def read(self, packet: Packet) -> Datagram | None:
        """Return the datagram that this packet is or completes, None if there is none."""
        start = ip_start(packet.link, packet.data)
        if start is None:
            return None
        ip = packet.data[start:]
        if len(ip) < 20 or ip[0] >> 4 != 4:
            return None
        header = 4 * (ip[0] & 15)
        total, identity, flags = struct.unpack_from(">HHH", ip, 2)
        if ip[9] != socket.IPPROTO_UDP or header < 20 or total < header:
            return None
        if len(ip) < total:
            self.cut += 1
            return None
        body: bytes | None = ip[header:total]
        at, more = 8 * (flags & 0x1FFF), bool(flags & 0x2000)
        if at or more:
            body = self._join((ip[12:20], identity), ip[header:total], at, more)
        return None if body is None else self._datagram(packet.time_s, ip[12:16], body)

    def _join(self, key: tuple[bytes, int], part: bytes, at: int, more: bool) -> bytes | None:
        """Add a fragment; return the body of the packet if it is whole now."""
        if at + len(part) > _MAX_IP_BYTES:
            return None
        if key not in self._open and len(self._open) >= _MAX_OPEN:
            del self._open[next(iter(self._open))]
            self._given_up += 1
        fragments = self._open.setdefault(key, _Fragments())
        fragments.parts[at] = part
        if not more:
            fragments.total = at + len(part)
        body = fragments.whole()
        if body is not None:
            del self._open[key]
        return body

    def _datagram(self, time_s: float, source: bytes, body: bytes) -> Datagram | None:
        if len(body) < 8:
            return None
        from_port, to_port, size = struct.unpack_from(">HHH", body)
        if not 8 <= size <= len(body):
            self.cut += 1
            return None
        return Datagram(time_s, (socket.inet_ntoa(source), from_port), to_port, body[8:size])


def ip_start(link: int, data: bytes) -> int | None:
    """Return where the IPv4 header begins, None if there is none or the link is not known."""
    if link in _RAW:
        return 0
    if link in _LOOPBACKS:
        # The address family, 2 for IPv4, in the byte order of whoever recorded it.
        return 4 if data[:4] in (b"\2\0\0\0", b"\0\0\0\2") else None
    if link == _LINUX_COOKED_2:
        return 20 if data[:2] == b"\x08\x00" else None
    at = {_LINUX_COOKED: 14, _ETHERNET: 12}.get(link)
    if at is None:
        return None
    kind = int.from_bytes(data[at : at + 2], "big")
    while kind in _VLAN_TAGS:
        at += 4
        kind = int.from_bytes(data[at : at + 2], "big")
    return at + 2 if kind == _IPV4 else None


def read_udp(path: str | Path) -> Iterator[Datagram]:
    """Read the UDP datagrams of a pcap or pcapng file, as Wireshark and tcpdump write them.

    Yields (time in s, (source address, source port), destination port, payload). Both byte orders,
    micro- and nanoseconds, Ethernet with VLAN tags, Linux cooked, raw IP and loopback; IPv4 with
    fragments put together. The file is read as it goes, so it may be long; it may be compressed by
    gzip. DataError if the file is missing, no such file, or damaged. A file cut off at its end and
    datagrams that were recorded in part give a `QualityWarning`.

    Source: IETF drafts draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng.
    """
    require_file(path)
    udp = UdpReader()
    with reading(path), _opened(path) as file:
        for packet in read_packets(file, str(path)):
            datagram = udp.read(packet)
            if datagram is not None:
                yield datagram
    if udp.cut or udp.incomplete:
        warn_quality(
            f"{path}: {udp.cut} datagrams were recorded in part and {udp.incomplete} lack a "
            "fragment; they are left out"
        )


def is_udp_recording(path: str | Path) -> bool:
    """Tell whether this is a pcap or pcapng file, by its first bytes."""
    if not Path(path).is_file():
        return False
    with reading(path), _opened(path) as file:
        return is_capture(file.read(4))


def _opened(path: str | Path) -> BinaryIO:
    """Open a recording, or what is in it if it is compressed by gzip, as archives are."""
    with Path(path).open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return cast(BinaryIO, gzip.open(path) if packed else Path(path).open("rb"))


class BagImage(NamedTuple):
    """One image of a bag."""

    time_s: float  # stamp of the image, or of the recording if the image has none
    topic: str  # where it was published
    image: NDArray[Any]  # [row col] in the units of the topic


def read_bag(path: str | Path, topics: Collection[str] = ()) -> Iterator[BagImage]:
    """Read images of a ROS 1 bag, a ROS 2 bag (a folder) or an MCAP file, of all topics or some.

    Images are `sensor_msgs/Image` of encoding 32FC1, 16UC1, mono16 or mono8; others are skipped.
    ImportError if the extra `recordings` is not installed. DataError if the bag cannot be read.
    """
    needed = "reading bags needs rosbags: pip install 'lensshift[recordings]'"
    highlevel = of_extra("rosbags.highlevel", needed)
    from rosbags.typesys import Stores, get_typestore

    if not Path(path).is_dir():
        require_file(path)
    known = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with reading(path), highlevel.AnyReader([Path(path)], default_typestore=known) as bag:
            kinds = [one for one in bag.connections if one.msgtype == "sensor_msgs/msg/Image"]
            wanted = [one for one in kinds if not topics or one.topic in topics]
            for connection, stamp_ns, data in bag.messages(wanted) if wanted else ():
                message = bag.deserialize(data, connection.msgtype)
                image, stamp = _image(message), message.header.stamp
                time_s = float(stamp.sec + stamp.nanosec * 1e-9) or stamp_ns * 1e-9
                if image is not None:
                    yield BagImage(time_s, connection.topic, image)
    except highlevel.AnyReaderError as error:
        raise DataError(f"cannot read this bag: {error}", source=path) from error


def _image(message: Any) -> NDArray[Any] | None:
    """Return the pixels of a message, None if they are of another kind."""
    name = _ENCODINGS.get(message.encoding)
    if name is None:
        return None
    pixel = np.dtype(name).newbyteorder(">" if message.is_bigendian else "<")
    rows, cols, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if rows < 1 or cols < 1 or step < cols * pixel.itemsize or data.size < rows * step:
        raise DataError(f"{data.size} bytes do not hold {rows} rows of {step}", field="image")
    lines = data[: rows * step].reshape(rows, step)[:, : cols * pixel.itemsize]
    image = np.ascontiguousarray(lines).view(pixel)
    return image.astype(pixel.newbyteorder("="))
