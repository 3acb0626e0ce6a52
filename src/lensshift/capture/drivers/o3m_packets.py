"""UDP packets of an ifm O3M: the header, and whole channel messages out of them. No sockets."""

from __future__ import annotations

import struct
from collections.abc import Container
from dataclasses import dataclass, field
from typing import NamedTuple

from lensshift.capture.drivers.receiver import counter_steps

MAX_PACKET_BYTES = 9216  # cameras send at most 1460; a jumbo frame is the most a LAN carries
MAX_PACKETS = 64  # of one message
MAX_MESSAGE_BYTES = 65536  # three times the longest layout
LATE_CYCLES = 2  # a packet may come this many cycles late; one from further back is a restart
QUIET_S = 2.0  # a camera takes longer than this to start anew, a message never to arrive

_HEADER = struct.Struct("<HHIIHHHHIII")
HEADER_BYTES = _HEADER.size  # 32
_CHANNEL_HEADER_BYTES = 28  # at the start of the first packet: delimiter and reserved words
_END_BYTES = 4  # delimiter at the end of the last packet
_MAX_OPEN = 4  # messages of one channel under way
_LATE_PACKETS = 64  # further back in the packet counter it says nothing about reordering


class PacketHeader(NamedTuple):
    """The 32 bytes at the start of every packet; what the two lengths count is not known."""

    version: int
    device: int
    packet_counter: int
    cycle_counter: int
    packets_in_cycle: int
    index_in_cycle: int
    packets_in_channel: int
    index_in_channel: int
    channel: int
    total_length: int
    payload_length: int


def read_header(datagram: bytes | bytearray | memoryview) -> PacketHeader | None:
    """Return the header of a packet, or None if this is no O3M packet."""
    size = len(datagram)
    if not HEADER_BYTES <= size <= MAX_PACKET_BYTES:
        return None
    header = PacketHeader._make(_HEADER.unpack_from(datagram))
    count, index = header.packets_in_channel, header.index_in_channel
    if not (count <= MAX_PACKETS and index < count):
        return None
    frame = _CHANNEL_HEADER_BYTES * (index == 0) + _END_BYTES * (index == count - 1)
    return header if size >= HEADER_BYTES + frame else None


class ChannelMessage(NamedTuple):
    """Everything a camera sent on one channel in one cycle."""

    channel: int  # 8 pixels, 14 parameters, 256 diagnosis
    cycle: int  # the cycle counter, unwrapped: it only grows, also when the camera starts anew
    content: bytes  # the bytes between the channel header and the end delimiter


@dataclass(slots=True)
class PacketCounts:
    """What came from one sender."""

    packets: int = 0  # with an O3M header
    lost: int = 0  # missing by the packet counter
    duplicate: int = 0  # came twice, or after their message was whole or given up
    reordered: int = 0  # came after a later one
    partial: int = 0  # messages given up because a packet was missing
    oversize: int = 0  # messages longer than any known
    restarts: int = 0  # most jumps back of the cycle counter of a channel


class Reassembler:
    """Puts the packets of one sender together to whole messages of some channels; counts them all.

    Bytes are joined only if they come from packets with the same cycle counter, channel and
    number of packets, with no gap and no more than 2 s between first and last. A message is
    yielded at most once, and never after a later one of its channel. Memory is bounded whatever
    arrives.
    """

    def __init__(self, channels: Container[int]) -> None:
        self.counts = PacketCounts()
        self._wanted = channels
        self._channels: dict[int, _Channel] = {}
        self._newest_packet: int | None = None

    def newest_cycle(self, channel: int) -> int:
        """Return the unwrapped counter of the newest cycle of a channel, -1 before the first."""
        found = self._channels.get(channel)
        return -1 if found is None else found.newest

    def restarts(self, channel: int) -> int:
        """Return how often the cycle counter of a channel jumped back."""
        found = self._channels.get(channel)
        return 0 if found is None else found.restarts

    def push(
        self, header: PacketHeader, datagram: bytes | bytearray | memoryview, arrived_s: float
    ) -> ChannelMessage | None:
        """Copy a packet; return the message that it completes, if any. Time is any rising clock."""
        self.counts.packets += 1
        message = None
        fresh = True
        if header.channel in self._wanted:
            channel = self._channels.get(header.channel)
            if channel is None:
                channel = _Channel(header, arrived_s, self.counts)
                self._channels[header.channel] = channel
            fresh, content = channel.push(header, datagram, arrived_s)
            if content is not None:
                message = ChannelMessage(header.channel, channel.done, content)
        self._count(header.packet_counter, fresh)
        return message

    def _count(self, packet: int, fresh: bool) -> None:
        """Follow the packet counter; a late packet had been counted as lost."""
        newest = self._newest_packet
        step = 1 if newest is None else counter_steps(packet, newest)
        if not fresh or step == 0:
            self.counts.duplicate += 1
        elif -_LATE_PACKETS <= step < 0:
            self.counts.reordered += 1
            self.counts.lost = max(0, self.counts.lost - 1)
        else:
            self.counts.lost += max(0, step - 1)
            self._newest_packet = packet


@dataclass(slots=True)
class _Open:
    """A message under way: its packets by their index."""

    since_s: float
    parts: dict[int, bytes] = field(default_factory=dict)
    size: int = 0


class _Channel:
    """The messages of one channel, in the order of their cycles."""

    def __init__(self, first: PacketHeader, arrived_s: float, counts: PacketCounts) -> None:
        self.newest = first.cycle_counter  # unwrapped
        self.done = -1  # unwrapped cycle of the last whole message
        self.restarts = 0
        self._counts = counts
        self._raw = first.cycle_counter
        self._heard_s = arrived_s
        self._open: dict[tuple[int, int], _Open] = {}

    def push(
        self, header: PacketHeader, datagram: bytes | bytearray | memoryview, arrived_s: float
    ) -> tuple[bool, bytes | None]:
        """Return whether the packet was new, and the content that it completes."""
        cycle = self._unwrap(header.cycle_counter, arrived_s)
        if cycle <= self.done:
            return False, None
        count = header.packets_in_channel
        message = self._message((cycle, count), arrived_s)
        if header.index_in_channel in message.parts:
            return False, None
        part = bytes(datagram[HEADER_BYTES:])
        message.parts[header.index_in_channel] = part
        message.size += len(part)
        if message.size > MAX_MESSAGE_BYTES:
            del self._open[cycle, count]
            self._counts.oversize += 1
            self._give_up(cycle)
            return True, None
        if len(message.parts) < count:
            return True, None
        del self._open[cycle, count]
        self._give_up(cycle)
        joined = b"".join([message.parts[index] for index in range(count)])
        return True, joined[_CHANNEL_HEADER_BYTES:-_END_BYTES]

    def _unwrap(self, raw: int, arrived_s: float) -> int:
        """Return the unwrapped cycle of a packet, after noticing a restart or a new cycle."""
        step = counter_steps(raw, self._raw)
        if step < -LATE_CYCLES or (step < 0 and arrived_s - self._heard_s > QUIET_S):
            self._give_up(self.newest)
            self.restarts += 1
            self._counts.restarts = max(self._counts.restarts, self.restarts)
            step = 1
        self._heard_s = arrived_s
        if step > 0:
            self.newest += step
            self._raw = raw
            if self._open:
                self._give_up(self.newest - LATE_CYCLES - 1)
            return self.newest
        return self.newest + step

    def _message(self, key: tuple[int, int], arrived_s: float) -> _Open:
        """Return the open message of this cycle and number of packets, a new one if need be."""
        message = self._open.get(key)
        if message is not None and arrived_s - message.since_s > QUIET_S:
            del self._open[key]
            self._counts.partial += 1
            message = None
        if message is None:
            if len(self._open) >= _MAX_OPEN:
                del self._open[min(self._open)]
                self._counts.partial += 1
            message = self._open[key] = _Open(arrived_s)
        return message

    def _give_up(self, cycle: int) -> None:
        """Forget the open messages up to this cycle and take no more packets of them."""
        self.done = max(self.done, cycle)
        for key in [key for key in self._open if key[0] <= cycle]:
            del self._open[key]
            self._counts.partial += 1
