"""Whole messages out of packets that get lost, change places, double and mix with others'."""

import struct
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.capture.drivers.o3m_packets import (
    MAX_MESSAGE_BYTES,
    MAX_PACKET_BYTES,
    ChannelMessage,
    Reassembler,
    read_header,
)
from lensshift.capture.drivers.receiver import counter_steps
from lensshift.capture.emulators.o3m import packetise

CHANNELS = frozenset({8, 14, 256})
SMALL_PACKET = 32 + 64  # few bytes a packet give many packets


def messages_of(camera: int, cycle: int) -> dict[int, bytes]:
    """Return messages that tell camera, cycle and place of every four bytes."""
    pixels = b"".join(struct.pack("<BBH", camera, cycle % 256, n) for n in range(90 + camera))
    return {8: pixels, 256: pixels[::-1][:77]} if cycle % 3 == 0 else {8: pixels}


def packets_of(camera: int, cycles: Sequence[int], first_packet: int = 0) -> list[bytes]:
    packets: list[bytes] = []
    for cycle in cycles:
        number = first_packet + len(packets)
        packets += packetise(messages_of(camera, cycle), cycle, number, packet_bytes=SMALL_PACKET)
    return packets


def push_all(
    reassembler: Reassembler, packets: Sequence[bytes], start_s: float = 0.0
) -> list[ChannelMessage]:
    got = []
    for number, packet in enumerate(packets):
        header = read_header(packet)
        assert header is not None
        message = reassembler.push(header, packet, start_s + number * 1e-4)
        if message is not None:
            got.append(message)
    return got


@given(
    length=st.integers(0, 4000),
    packet_bytes=st.integers(32 + 32, 1500),
    cycle=st.integers(0, 2**32 - 1),
    first=st.integers(0, 2**32 - 1),
)
def test_what_is_cut_into_packets_comes_back(
    length: int, packet_bytes: int, cycle: int, first: int
) -> None:
    message = bytes(n % 251 for n in range(length))
    packets = packetise({8: message}, cycle, first, packet_bytes=packet_bytes)
    if len(packets) > 64:
        return
    assert max(map(len, packets)) <= packet_bytes
    reassembler = Reassembler(CHANNELS)
    assert [one.content for one in push_all(reassembler, packets)] == [message]
    assert reassembler.counts.lost == 0


def test_header_fields_lie_where_the_format_puts_them() -> None:
    written = bytes.fromhex(
        "0100 0200 03000000 04000000 0500 0600 0700 0000 08000000 09000000 0a000000".replace(
            " ", ""
        )
    )
    header = read_header(written + bytes(28))
    assert header == (1, 2, 3, 4, 5, 6, 7, 0, 8, 9, 10)


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\0" * 31,
        struct.pack("<HHIIHHHHIII", 1, 1, 0, 0, 3, 0, 0, 0, 8, 0, 0) + bytes(40),
        struct.pack("<HHIIHHHHIII", 1, 1, 0, 0, 3, 0, 3, 3, 8, 0, 0) + bytes(40),
        struct.pack("<HHIIHHHHIII", 1, 1, 0, 0, 900, 0, 900, 0, 8, 0, 0) + bytes(40),
        struct.pack("<HHIIHHHHIII", 1, 1, 0, 0, 3, 0, 3, 0, 8, 0, 0) + bytes(27),
        struct.pack("<HHIIHHHHIII", 1, 1, 0, 0, 3, 2, 3, 2, 8, 0, 0) + bytes(3),
        struct.pack("<HHIIHHHHIII", 1, 1, 0, 0, 3, 1, 3, 1, 8, 0, 0) + bytes(MAX_PACKET_BYTES),
    ],
    ids=["empty", "short", "no packets", "index", "too many", "first", "last", "too long"],
)
def test_what_is_no_packet_of_an_o3m_is_refused(packet: bytes) -> None:
    assert read_header(packet) is None


@pytest.mark.parametrize("first", [0, 7, 2**32 - 3])
def test_all_cycles_come_in_order_also_where_the_counters_wrap(first: int) -> None:
    cycles = [first + n for n in range(6)]
    reassembler = Reassembler(CHANNELS)
    got = push_all(reassembler, packets_of(1, cycles, first_packet=2**32 - 20))
    pixels = [one for one in got if one.channel == 8]
    assert [one.cycle for one in pixels] == cycles
    assert [one.content for one in pixels] == [messages_of(1, cycle)[8] for cycle in cycles]
    counts = reassembler.counts
    assert (counts.lost, counts.duplicate, counts.reordered, counts.partial) == (0, 0, 0, 0)
    assert reassembler.newest_cycle(8) == cycles[-1]


def test_a_cycle_that_misses_a_packet_is_dropped_and_counted() -> None:
    packets = packets_of(1, [1, 2, 4])
    lost = next(n for n, one in enumerate(packets) if one[8:12] == struct.pack("<I", 2)) + 2
    del packets[lost]
    reassembler = Reassembler(CHANNELS)
    assert [one.cycle for one in push_all(reassembler, packets)] == [1, 4]
    assert reassembler.counts.lost == 1
    assert reassembler.counts.partial == 1


def test_neighbours_that_change_places_do_no_harm_and_are_counted() -> None:
    packets = packets_of(1, [1, 2])
    packets[2], packets[3] = packets[3], packets[2]
    reassembler = Reassembler(CHANNELS)
    assert [one.cycle for one in push_all(reassembler, packets)] == [1, 2]
    assert (reassembler.counts.reordered, reassembler.counts.lost) == (1, 0)


def test_a_message_comes_once_although_its_packets_come_twice() -> None:
    once = packets_of(1, [1, 2])
    packets = [one for packet in once for one in (packet, packet)] + once + once
    reassembler = Reassembler(CHANNELS)
    assert [one.cycle for one in push_all(reassembler, packets)] == [1, 2]
    assert reassembler.counts.duplicate == 3 * len(once)


def test_a_late_cycle_never_comes_after_a_newer_one() -> None:
    one, two = packets_of(1, [1]), packets_of(1, [2], first_packet=100)
    got = push_all(Reassembler(CHANNELS), [*one[:-1], *two, one[-1]])
    assert [message.cycle for message in got] == [2]


def test_a_counter_that_jumps_back_is_a_restart_and_cycles_grow_on() -> None:
    reassembler = Reassembler(CHANNELS)
    got = push_all(reassembler, packets_of(1, [1001, 1002]) + packets_of(1, [1, 2, 4, 6]))
    assert reassembler.restarts(8) == 1
    assert reassembler.counts.restarts == 1  # although every channel jumped back
    assert [one.cycle for one in got if one.channel == 8] == [1001, 1002, 1003, 1004, 1006, 1008]


def test_packets_from_before_and_after_a_silence_are_not_joined() -> None:
    before, after = packets_of(1, [1]), packets_of(2, [1])
    reassembler = Reassembler(CHANNELS)
    assert push_all(reassembler, before[:3], start_s=0.0) == []
    assert push_all(reassembler, after[3:], start_s=5.0) == []
    assert reassembler.counts.partial == 1


def test_a_small_step_back_after_a_silence_is_a_restart_too() -> None:
    reassembler = Reassembler(CHANNELS)
    push_all(reassembler, packets_of(1, [2]), start_s=0.0)
    got = push_all(reassembler, packets_of(1, [1]), start_s=5.0)
    assert reassembler.restarts(8) == 1
    assert [one.cycle for one in got] == [3]


def test_a_cycle_is_given_up_when_the_third_after_it_begins() -> None:
    first, second, third = (packets_of(1, [cycle], 20 * cycle) for cycle in (1, 2, 4))
    reassembler = Reassembler(CHANNELS)
    push_all(reassembler, [*first[:-1], second[0]])
    assert reassembler.counts.partial == 0
    push_all(reassembler, third[:1])
    assert reassembler.counts.partial == 1


def test_the_oldest_of_many_messages_under_way_is_given_up() -> None:
    reassembler = Reassembler(CHANNELS)
    # Four that differ in their number of packets, and then a fifth of the cycle after.
    many = [packetise({8: bytes(100 * n)}, 1, 0, packet_bytes=SMALL_PACKET) for n in (2, 3, 4, 5)]
    fifth = packetise({8: b"whole" * 30}, 2, 50, packet_bytes=SMALL_PACKET)
    push_all(reassembler, [*(packets[0] for packets in many), fifth[0]])
    assert reassembler.counts.partial == 1
    got = push_all(reassembler, [*many[0][1:], *many[3][1:], *fifth[1:]])
    assert [one.content for one in got] == [bytes(500), b"whole" * 30]


def test_packets_that_disagree_in_their_number_are_not_joined() -> None:
    short, long = packets_of(0, [1]), packets_of(40, [1])
    assert len(short) != len(long)
    reassembler = Reassembler(CHANNELS)
    got = push_all(reassembler, [*short[:-1], *long])
    assert [one.content for one in got] == [messages_of(40, 1)[8]]


def test_an_endless_message_is_given_up() -> None:
    big = packetise({8: bytes(MAX_MESSAGE_BYTES + 1)}, 5, 0, packet_bytes=8000)
    reassembler = Reassembler(CHANNELS)
    assert push_all(reassembler, big) == []
    assert reassembler.counts.oversize == 1


def test_channels_that_nobody_wants_are_only_counted() -> None:
    reassembler = Reassembler(frozenset({8}))
    packets = packetise({20: bytes(400)}, 5, 0, packet_bytes=SMALL_PACKET)
    assert push_all(reassembler, packets) == []
    assert reassembler.counts.packets == len(packets)


@given(st.data())
def test_only_whole_messages_of_one_camera_come_out(data: st.DataObject) -> None:
    """Loss, any order, doubles, and two cameras with the same counters on one port."""
    cycles = range(data.draw(st.integers(0, 5)), data.draw(st.integers(6, 9)))
    sent = [(camera, packet) for camera in (1, 2) for packet in packets_of(camera, cycles)]
    order = data.draw(st.lists(st.integers(0, len(sent) - 1), max_size=3 * len(sent)))
    cameras = {camera: Reassembler(CHANNELS) for camera in (1, 2)}
    for number, index in enumerate(order):
        camera, packet = sent[index]
        header = read_header(packet)
        assert header is not None
        message = cameras[camera].push(header, packet, number * 1e-3)
        if message is not None:
            genuine = [messages_of(camera, cycle).get(message.channel) for cycle in cycles]
            assert message.content in genuine


@given(
    late=st.lists(st.floats(0, 3), min_size=50, max_size=50),
    doubles=st.lists(st.booleans(), min_size=50, max_size=50),
)
def test_nothing_is_lost_if_packets_come_up_to_three_places_late(
    late: list[float], doubles: list[bool]
) -> None:
    cycles = range(3, 8)
    packets = packets_of(1, cycles)
    assert len(packets) < len(late)
    order = sorted(range(len(packets)), key=lambda n: n + late[n])
    came = [packets[n] for n in order for _ in range(1 + doubles[n])]
    reassembler = Reassembler(CHANNELS)
    got = [one for one in push_all(reassembler, came) if one.channel == 8]
    assert [one.cycle for one in got] == list(cycles)
    assert [one.content for one in got] == [messages_of(1, cycle)[8] for cycle in cycles]
    assert (reassembler.counts.partial, reassembler.counts.lost) == (0, 0)
    assert reassembler.counts.duplicate == len(came) - len(packets)


@given(
    start=st.integers(0, 2**32 - 1),
    steps=st.lists(st.integers(-(2**31), 2**31 - 1), max_size=5),
)
def test_steps_of_a_wrapping_counter_are_those_it_made(start: int, steps: list[int]) -> None:
    now = start
    for step in steps:
        assert counter_steps((now + step) % 2**32, now) == step
        now = (now + step) % 2**32
