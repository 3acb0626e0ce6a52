"""UDP datagrams out of recorded packets: link headers, IPv4, fragments."""

from __future__ import annotations

import socket
import struct
from typing import NamedTuple

from lensshift.io.recordings_pcap import Packet

_ETHERNET, _LINUX_COOKED, _LINUX_COOKED_2 = 1, 113, 276  # link types of tcpdump.org
_LOOPBACKS = (0, 108)  # BSD, OpenBSD
_RAW = (12, 14, 101, 228)  # IP without a link
_IPV4 = 0x0800  # EtherType
_VLAN_TAGS = (0x8100, 0x88A8, 0x9100)  # EtherTypes
_MAX_OPEN = 64  # datagrams of which fragments are missing
_MAX_BYTES = 65535  # of an IPv4 packet


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
        if at + len(part) > _MAX_BYTES:
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
        address = ".".join(str(one) for one in source)
        return Datagram(time_s, (address, from_port), to_port, body[8:size])


def ip_start(link: int, data: bytes) -> int | None:
    """Return where the IPv4 header begins, None if there is none or the link is not known."""
    if link in _RAW:
        return 0
    if link in _LOOPBACKS:
        # The address family, 2 for IPv4, in the byte order of whoever recorded it.
        return 4 if data[:4] in (b"\2\0\0\0", b"\0\0\0\2") else None
    if link == _LINUX_COOKED_2:
        return 20 if data[:2] == b"\x08\x00" else None
    if link == _LINUX_COOKED:
        at = 14
    elif link == _ETHERNET:
        at = 12
    else:
        return None
    kind = int.from_bytes(data[at : at + 2], "big")
    while kind in _VLAN_TAGS:
        at += 4
        kind = int.from_bytes(data[at : at + 2], "big")
    return at + 2 if kind == _IPV4 else None
