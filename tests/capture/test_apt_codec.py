"""The codec against an independent one, and messages out of damaged streams."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import Framer, Id, Message

oracle = pytest.importorskip("thorlabs_apt_protocol")

USB, HOST = 0x50, 0x01
INT32 = st.integers(-(2**31), 2**31 - 1)
INT16 = st.integers(-(2**15), 2**15 - 1)
WORD = st.integers(0, 2**16 - 1)


def decoded(message: Message):
    """Return what the oracle reads in a message from a controller."""
    unpacker = oracle.Unpacker(on_error="raise")
    unpacker.feed(message.to_bytes(HOST, USB))
    return next(unpacker)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (Message(Id.REQUEST_INFO), oracle.hw_req_info(USB, HOST)),
        (Message(Id.STOP_UPDATES), oracle.hw_stop_updatemsgs(USB, HOST)),
        (Message(Id.SET_ENABLED, (1, 1)), oracle.mod_set_chanenablestate(USB, HOST, 1, 1)),
        (Message(Id.REQUEST_ENABLED, (1, 0)), oracle.mod_req_chanenablestate(USB, HOST, 1)),
        (Message(Id.REQUEST_VELOCITY, (1, 0)), oracle.mot_req_velparams(USB, HOST, 1)),
        (Message(Id.REQUEST_HOME, (1, 0)), oracle.mot_req_homeparams(USB, HOST, 1)),
        (Message(Id.REQUEST_BACKLASH, (1, 0)), oracle.mot_req_genmoveparams(USB, HOST, 1)),
        (Message(Id.REQUEST_LIMITS, (1, 0)), oracle.mot_req_limswitchparams(USB, HOST, 1)),
        (Message(Id.REQUEST_STATUS, (1, 0)), oracle.mot_req_dcstatusupdate(USB, HOST, 1)),
        (Message(Id.MOVE_HOME, (1, 0)), oracle.mot_move_home(USB, HOST, 1)),
        (Message(Id.MOVE_STOP, (1, apt.STOP_AT_ONCE)), oracle.mot_move_stop(USB, HOST, 1, 1)),
        (Message(Id.MOVE_STOP, (1, apt.STOP_PROFILED)), oracle.mot_move_stop(USB, HOST, 1, 2)),
    ],
)
def test_short_messages_are_those_of_the_oracle(message: Message, expected: bytes) -> None:
    assert message.to_bytes() == expected


@given(a=INT32, b=INT32, c=INT32, d=WORD, e=WORD, f=st.integers(0, 2**31 - 1))
def test_records_are_encoded_as_by_the_oracle(a, b, c, d, e, f) -> None:
    pairs = [
        (Id.MOVE_ABSOLUTE, apt.Target(a), oracle.mot_move_absolute(USB, HOST, 1, a)),
        (Id.SET_VELOCITY, apt.Velocity(a, b, c), oracle.mot_set_velparams(USB, HOST, 1, a, b, c)),
        (Id.SET_HOME, apt.Home(d, e, a, b), oracle.mot_set_homeparams(USB, HOST, 1, d, e, a, b)),
        (Id.SET_BACKLASH, apt.Target(a), oracle.mot_set_genmoveparams(USB, HOST, 1, a)),
        (
            Id.SET_LIMITS,
            apt.Limits(d, e, f, f // 2, 2),
            oracle.mot_set_limswitchparams(USB, HOST, 1, d, e, f, f // 2, 2),
        ),
    ]
    for message_id, record, expected in pairs:
        assert Message(message_id, data=record.pack()).to_bytes() == expected


@given(counts=INT32, velocity=INT16, bits=st.integers(0, 2**32 - 1))
def test_status_is_decoded_as_by_the_oracle(counts, velocity, bits) -> None:
    status = apt.Status(counts, velocity, 0, bits)
    for message_id in (Id.STATUS, Id.COMPLETED, Id.STOPPED):
        theirs = decoded(Message(message_id, data=status.pack()))
        assert (theirs.position, theirs.velocity) == (counts, velocity)
        for name, bit in {
            "forward_limit_switch": apt.Bits.FORWARD_LIMIT,
            "reverse_limit_switch": apt.Bits.BACKWARD_LIMIT,
            "moving_forward": apt.Bits.MOVING_FORWARD,
            "moving_reverse": apt.Bits.MOVING_BACKWARD,
            "jogging_forward": apt.Bits.JOGGING_FORWARD,
            "jogging_reverse": apt.Bits.JOGGING_BACKWARD,
            "motor_connected": apt.Bits.CONNECTED,
            "homing": apt.Bits.HOMING,
            "homed": apt.Bits.HOMED,
            "tracking": apt.Bits.TRACKING,
            "settled": apt.Bits.SETTLED,
            "motion_error": apt.Bits.MOTION_ERROR,
            "motor_current_limit_reached": apt.Bits.CURRENT_LIMIT,
            "encoder_fault": apt.Bits.ENCODER_FAULT,
            "channel_enabled": apt.Bits.ENABLED,
        }.items():
            assert getattr(theirs, name) == bool(bits & bit), name


@given(a=INT32, b=INT32, c=INT32, d=WORD, e=WORD)
def test_records_are_decoded_as_by_the_oracle(a, b, c, d, e) -> None:
    velocity = decoded(Message(Id.VELOCITY, data=apt.Velocity(a, b, c).pack()))
    assert (velocity.min_velocity, velocity.acceleration, velocity.max_velocity) == (a, b, c)
    home = decoded(Message(Id.HOME, data=apt.Home(d, e, a, b).pack()))
    assert (home.home_dir, home.limit_switch, home.home_velocity, home.offset_distance) == (
        d, e, a, b,
    )  # fmt: skip
    backlash = decoded(Message(Id.BACKLASH, data=apt.Target(a).pack()))
    assert backlash.backlash_distance == a
    limits = decoded(Message(Id.LIMITS, data=apt.Limits(d, e, abs(a) // 2, 0, 1).pack()))
    assert (limits.cw_hardlimit, limits.ccw_hardlimit, limits.cw_softlimit) == (d, e, abs(a) // 2)
    for record in (apt.Velocity(a, b, c), apt.Home(d, e, a, b), apt.Target(a)):
        assert type(record).unpack(record.pack()) == record


def test_hardware_information_is_decoded_as_by_the_oracle() -> None:
    info = apt.Info(27000123, "KDC101", "2.1.4", "some notes", 11)
    theirs = decoded(Message(Id.INFO, data=info.pack()))
    assert theirs.serial_number == 27000123
    assert theirs.model_number == b"KDC101\0\0"
    assert list(theirs.firmware_version)[-3:] == [2, 1, 4]
    assert theirs.nchs == 1
    assert apt.Info.unpack(info.pack()) == info
    assert struct.unpack_from("<H", info.pack(), 76) == (11,)  # where others read the stage


def test_homed_and_enabled_are_decoded_as_by_the_oracle() -> None:
    assert decoded(Message(Id.HOMED, (1, 0))).chan_ident == 1
    assert decoded(Message(Id.ENABLED, (1, 1))).enabled
    assert not decoded(Message(Id.ENABLED, (1, 2))).enabled


def test_speeds_in_servo_units_are_those_of_the_protocol() -> None:
    # APT protocol of 28 November 2022, Z8xx: 1 mm/s and 1 mm/s^2.
    assert apt.servo_velocity(34554.96) == round(772981.3692)
    assert apt.servo_acceleration(34554.96) == round(263.8443072)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (apt.Status(5, 0, 0, 0x30).pack(), "impossible status"),
        (apt.Status(5, 0, 0, 0x3).pack(), "impossible status"),
        (b"\x02" + apt.Status(5, 0, 0, 0).pack()[1:], "expected channel 1, got 2"),
        (apt.Status(5, 0, 0, 0).pack()[:-1], "expected 14 bytes, got 13"),
    ],
)
def test_contradictions_are_damage(data: bytes, reason: str) -> None:
    with pytest.raises(apt.DamagedMessage, match=reason):
        apt.Status.unpack(data)


def test_a_model_that_is_no_text_is_damage() -> None:
    data = apt.Info(1, "KDC101", "1.0.0", "", 11).pack()
    with pytest.raises(apt.DamagedMessage, match="impossible model"):
        apt.Info.unpack(data[:4] + b"\xff\x01" + data[6:])
    with pytest.raises(apt.DamagedMessage, match="84 bytes"):
        apt.Info.unpack(data[:-1])


STATUSES = [
    Message(Id.STATUS, data=apt.Status(counts, 0, 0, 0x80000400).pack()) for counts in range(30)
]
LONGEST = 6 + 84


def stream(messages: list[Message]) -> bytes:
    return b"".join(message.to_bytes(HOST, USB) for message in messages)


@given(cuts=st.lists(st.integers(1, 40), max_size=30))
def test_messages_come_whole_however_the_stream_is_cut(cuts: list[int]) -> None:
    sent = [STATUSES[3], Message(Id.HOMED, (1, 0)), STATUSES[4], Message(Id.COMPLETED, (1, 0))]
    left, framer, found = stream(sent), Framer(apt.TO_HOST), []
    for cut in [*cuts, 1000]:
        found += framer.feed(left[:cut], 0.0)
        left = left[cut:]
    assert found == sent
    assert framer.resyncs == 0
    assert framer.wanted == 6


@given(blocks=st.lists(st.binary(max_size=300), max_size=8))
def test_any_bytes_are_survived_with_little_held(blocks: list[bytes]) -> None:
    framer = Framer(apt.TO_HOST)
    for block in blocks:
        framer.feed(block, 0.0)
        assert 0 < framer.wanted <= LONGEST


# Bytes that look like the beginning of messages, which is worse than noise.
TREACHEROUS = st.lists(
    st.sampled_from(
        [b"\x91\x04\x0e\x00\x81\x50", b"\x06\x00\x54\x00\x81\x50", b"\x91", b"\x50\x01"]
    )
    | st.binary(max_size=9),
    max_size=12,
).map(b"".join)


@given(garbage=TREACHEROUS)
def test_after_garbage_and_a_pause_every_message_is_found(garbage: bytes) -> None:
    framer = Framer(apt.TO_HOST, patience_s=0.03)
    framer.feed(garbage, 0.0)
    framer.feed(b"", 0.1)
    assert framer.wanted == 6
    assert framer.feed(stream(STATUSES), 0.2) == STATUSES


@given(garbage=TREACHEROUS)
def test_after_garbage_without_a_pause_messages_are_found_again(garbage: bytes) -> None:
    found = Framer(apt.TO_HOST).feed(garbage + stream(STATUSES), 0.0)
    swallowed = LONGEST // 20 + 1  # at most those that end in the longest message that was begun
    assert found[-len(STATUSES) + swallowed + 1 :] == STATUSES[swallowed + 1 :]


@given(lost=st.integers(0, 19), which=st.integers(0, 28))
def test_a_lost_byte_costs_one_message_and_the_next(lost: int, which: int) -> None:
    data = stream(STATUSES)
    at = 20 * which + lost
    framer = Framer(apt.TO_HOST)
    found = framer.feed(data[:at] + data[at + 1 :], 0.0) + framer.feed(b"", 1.0)
    assert framer.resyncs >= 1
    assert found[:which] == STATUSES[:which]
    assert found[len(found) - (28 - which) :] == STATUSES[which + 2 :]


def test_half_a_message_is_dropped_in_time_and_what_it_swallowed_is_found() -> None:
    framer = Framer(apt.TO_HOST, patience_s=0.03)
    damaged = STATUSES[1].to_bytes(HOST, USB)[:-8]
    homed = Message(Id.HOMED, (1, 0))
    assert framer.feed(damaged + homed.to_bytes(HOST, USB), 0.0) == []
    assert framer.feed(b"", 0.02) == []
    assert framer.feed(b"", 0.04) == [homed]
    assert framer.resyncs == 1


@pytest.mark.parametrize(
    "foreign",
    [
        Message(0x1234).to_bytes(HOST, USB),  # unknown id
        STATUSES[0].to_bytes(0x22, USB),  # to somebody else
        STATUSES[0].to_bytes(HOST, 0x11),  # from somebody else
        Message(Id.STATUS, data=b"\1" * 13).to_bytes(HOST, USB),  # too short
        Message(Id.STATUS, (1, 0)).to_bytes(HOST, USB),  # short where it must be long
    ],
)
def test_foreign_messages_are_skipped(foreign: bytes) -> None:
    framer = Framer(apt.TO_HOST)
    found = framer.feed(foreign + STATUSES[7].to_bytes(HOST, USB), 0.0)
    assert found == [STATUSES[7]]
    assert framer.resyncs == 1
