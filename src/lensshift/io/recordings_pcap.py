"""The files of packet recorders: pcap and pcapng, block by block."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from lensshift.core.errors import DataError, QualityWarning

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
        warnings.warn(
            f"{name}: the file is cut off after {count} packets", QualityWarning, stacklevel=3
        )


def _take(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise _CutOffError
    return data


def _check_size(size: int, least: int, at: int) -> None:
    if not least <= size <= _MAX_BYTES:
        raise DataError(f"damaged: a block of {size} bytes before byte {at}", field="packet")


def _pcap(file: BinaryIO, order: str, tick_s: float) -> Iterator[Packet]:
    head = _take(file, 20)
    link = int(struct.unpack(order + "I", head[16:])[0]) & 0xFFFF  # above: check sums
    record = struct.Struct(order + "4I")
    while data := file.read(record.size):
        if len(data) < record.size:
            raise _CutOffError
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
        if kind == _SECTION:
            magic = _take(file, 4)
            if magic not in _ORDERS:
                raise DataError(f"damaged: byte order {magic!r}", field="section")
            order, interfaces = _ORDERS[magic], []
            read = 12
        else:
            read = 8
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
        kind = file.read(4)
        if 0 < len(kind) < 4:
            raise _CutOffError


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
