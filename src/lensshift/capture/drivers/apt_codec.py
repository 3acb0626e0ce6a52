"""Thorlabs APT messages: records to bytes and back, also out of a stream that lost some.

A message has six bytes of header, little endian:

    id (2), parameters (2), destination, source                 short
    id (2), length of the data (2), destination | 0x80, source  long, then the data

There is no checksum: a message that lost a byte and took one from the next looks whole. So records
are checked where they are redundant, and nobody acts on a single reply (`apt_axis`).

Source: Thorlabs APT communications protocol; layouts checked against thorlabs-apt-protocol.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from enum import IntEnum, IntFlag
from typing import Any, ClassVar, Self

HOST, CONTROLLER = 0x01, 0x50  # a cube on its own USB port
CHANNEL = 1  # the only one of a cube
LONG = 0x80  # in the destination of a message with data
_SHORT, _LONG = struct.Struct("<HBBBB"), struct.Struct("<HHBB")
HEADER_BYTES = _SHORT.size
SAMPLE_S = 2048 / 6e6  # servo cycle of TDC001 and KDC101: the unit of time of their speeds


class Id(IntEnum):
    """Messages in use; SET, REQUEST and MOVE go to the controller, the others come from it."""

    DISCONNECT = 0x0002
    REQUEST_INFO = 0x0005
    INFO = 0x0006
    STOP_UPDATES = 0x0012
    RESPONSE = 0x0080
    RICH_RESPONSE = 0x0081
    SET_ENABLED = 0x0210
    REQUEST_ENABLED = 0x0211
    ENABLED = 0x0212
    SET_VELOCITY = 0x0413
    REQUEST_VELOCITY = 0x0414
    VELOCITY = 0x0415
    SET_LIMITS = 0x0423
    REQUEST_LIMITS = 0x0424
    LIMITS = 0x0425
    REQUEST_BITS = 0x0429
    BITS = 0x042A
    SET_BACKLASH = 0x043A
    REQUEST_BACKLASH = 0x043B
    BACKLASH = 0x043C
    SET_HOME = 0x0440
    REQUEST_HOME = 0x0441
    HOME = 0x0442
    MOVE_HOME = 0x0443
    HOMED = 0x0444
    MOVE_ABSOLUTE = 0x0453
    COMPLETED = 0x0464
    MOVE_STOP = 0x0465
    STOPPED = 0x0466
    REQUEST_STATUS = 0x0490
    STATUS = 0x0491


STOP_AT_ONCE, STOP_PROFILED = 1, 2  # first parameter of MOVE_STOP

# Bytes of data by message; 0 is the short form. Other messages count as damaged.
TO_HOST: Mapping[int, tuple[int, ...]] = {
    **dict.fromkeys((Id.DISCONNECT, Id.RESPONSE, Id.ENABLED, Id.HOMED), (0,)),
    **dict.fromkeys((Id.BITS, Id.BACKLASH), (6,)),
    **dict.fromkeys((Id.VELOCITY, Id.HOME, Id.STATUS), (14,)),
    **dict.fromkeys((Id.COMPLETED, Id.STOPPED), (0, 14)),
    Id.LIMITS: (16,),
    Id.RICH_RESPONSE: (68,),
    Id.INFO: (84,),
}
_REQUESTS = (
    Id.REQUEST_INFO, Id.REQUEST_ENABLED, Id.REQUEST_VELOCITY, Id.REQUEST_LIMITS, Id.REQUEST_BITS,
    Id.REQUEST_BACKLASH, Id.REQUEST_HOME, Id.REQUEST_STATUS,
)  # fmt: skip
TO_CONTROLLER: Mapping[int, tuple[int, ...]] = {
    **dict.fromkeys((*_REQUESTS, Id.STOP_UPDATES, Id.SET_ENABLED), (0,)),
    **dict.fromkeys((Id.MOVE_HOME, Id.MOVE_STOP), (0,)),
    **dict.fromkeys((Id.MOVE_ABSOLUTE, Id.SET_BACKLASH), (6,)),
    **dict.fromkeys((Id.SET_VELOCITY, Id.SET_HOME), (14,)),
    Id.SET_LIMITS: (16,),
}


class DamagedMessage(ValueError):  # noqa: N818 - what it is says more than Error
    """A message whose content contradicts itself."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message: either two parameters or data."""

    id: int
    parameters: tuple[int, int] = (0, 0)
    data: bytes = b""

    def to_bytes(self, destination: int = CONTROLLER, source: int = HOST) -> bytes:
        """Return the bytes for the wire, from the host to a controller unless told."""
        if not self.data:
            return _SHORT.pack(self.id, *self.parameters, destination, source)
        header = _LONG.pack(self.id, len(self.data), destination | LONG, source)
        return header + self.data


class Bits(IntFlag):
    """Status of the motor; directions as in the protocol, which other programs turn round."""

    FORWARD_LIMIT = 0x1
    BACKWARD_LIMIT = 0x2
    FORWARD_SOFT_LIMIT = 0x4
    BACKWARD_SOFT_LIMIT = 0x8
    MOVING_FORWARD = 0x10
    MOVING_BACKWARD = 0x20
    JOGGING_FORWARD = 0x40
    JOGGING_BACKWARD = 0x80
    CONNECTED = 0x100
    HOMING = 0x200
    HOMED = 0x400
    TRACKING = 0x1000
    SETTLED = 0x2000
    MOTION_ERROR = 0x4000
    CURRENT_LIMIT = 0x01000000
    ENCODER_FAULT = 0x02000000
    ENABLED = 0x80000000


LIMITS = Bits.FORWARD_LIMIT | Bits.BACKWARD_LIMIT
_SOFT_LIMITS = Bits.FORWARD_SOFT_LIMIT | Bits.BACKWARD_SOFT_LIMIT
_MOVES = Bits.MOVING_FORWARD | Bits.MOVING_BACKWARD
_JOGS = Bits.JOGGING_FORWARD | Bits.JOGGING_BACKWARD
MOVING = _MOVES | _JOGS | Bits.HOMING
# What may differ between two replies of a motor that is well.
CHANGING = MOVING | LIMITS | _SOFT_LIMITS | Bits.TRACKING | Bits.SETTLED
FAULTS = Bits.MOTION_ERROR | Bits.CURRENT_LIMIT | Bits.ENCODER_FAULT
_BOTH_WAYS = (LIMITS, _MOVES, _JOGS)


def _unpacked(layout: str, data: bytes) -> tuple[Any, ...]:
    if len(data) != struct.calcsize(layout):
        raise DamagedMessage(f"expected {struct.calcsize(layout)} bytes, got {len(data)}")
    return struct.unpack(layout, data)


class Record:
    """Fields that follow the channel number in the data of a message."""

    FORMAT: ClassVar[str]

    def __init_subclass__(cls, layout: str = "") -> None:
        if layout:  # not when `slots` makes the class anew
            cls.FORMAT = layout

    def pack(self) -> bytes:
        """Return the data of the message."""
        try:
            return struct.pack(self.FORMAT, CHANNEL, *astuple(self))  # type: ignore[call-overload]
        except struct.error as error:  # a setting beyond all motors
            problem = f"{self} does not fit the numbers of a controller; look at speeds and scale"
            raise ValueError(problem) from error

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Return the record in the data. DamagedMessage if the length or the channel is wrong."""
        channel, *fields = _unpacked(cls.FORMAT, data)
        if channel != CHANNEL:
            raise DamagedMessage(f"expected channel {CHANNEL}, got {channel}")
        return cls(*fields)


@dataclass(frozen=True, slots=True)
class Target(Record, layout="<Hl"):
    """A length in counts: where a move goes, or how far the firmware overruns a backward one."""

    counts: int


@dataclass(frozen=True, slots=True)
class Velocity(Record, layout="<Hlll"):
    """Speed and acceleration in units of the servo, see `servo_velocity`."""

    lowest: int
    acceleration: int
    highest: int


@dataclass(frozen=True, slots=True)
class Home(Record, layout="<HHHll"):
    """How to find the zero: direction (2: backward), switch (1: backward), speed, way back."""

    direction: int
    switch: int
    velocity: int
    offset: int


@dataclass(frozen=True, slots=True)
class Limits(Record, layout="<HHHllH"):
    """Sense of the two switches, soft limits in counts, what happens at these (1: nothing)."""

    forward_switch: int
    backward_switch: int
    forward: int
    backward: int
    mode: int


@dataclass(frozen=True, slots=True)
class Status(Record, layout="<HlhhL"):
    """Where the motor is: counts, speed, current (or nothing), `Bits`."""

    counts: int
    velocity: int
    current: int
    bits: int

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Return the status; DamagedMessage also if it moves or stands at limits both ways."""
        status = super(Status, cls).unpack(data)
        if any(status.bits & both == both for both in _BOTH_WAYS):
            raise DamagedMessage(f"impossible status {status.bits:#010x}")
        return status

    @property
    def moving(self) -> bool:
        """Whether it moves, jogs or looks for its zero."""
        return bool(self.bits & MOVING)


@dataclass(frozen=True, slots=True)
class Info:
    """What a controller says of itself; stage 11 is the Z806."""

    serial_number: int
    model: str
    firmware: str
    notes: str
    stage_id: int

    FORMAT: ClassVar[str] = "<L8sH4B48s10sHHHH"

    def pack(self) -> bytes:
        """Return the data of the message."""
        firmware = [int(part) for part in self.firmware.split(".")]
        texts = self.model.encode("ascii"), self.notes.encode("ascii")
        return struct.pack(
            self.FORMAT, self.serial_number, texts[0], 16, *reversed(firmware), 0, texts[1], b"",
            self.stage_id, 1, 0, 1,
        )  # fmt: skip

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Return what is in the data; DamagedMessage if its length or its model is wrong."""
        fields = _unpacked(cls.FORMAT, data)
        serial_number, model, _, minor, interim, major, _, notes = fields[:8]
        text = model.split(b"\0")[0].decode("ascii", "replace").strip()
        if not text.isalnum():
            raise DamagedMessage(f"impossible model {text!r}")
        told = notes.split(b"\0")[0].decode("ascii", "replace").strip()
        return cls(serial_number, text, f"{major}.{interim}.{minor}", told, fields[9])


def servo_velocity(counts_per_s: float) -> int:
    """Return a speed in units of the servo: counts per cycle, times 65536."""
    return round(counts_per_s * SAMPLE_S * 65536)


def servo_acceleration(counts_per_s2: float) -> int:
    """Return an acceleration in units of the servo: counts per cycle squared, times 65536."""
    return round(counts_per_s2 * SAMPLE_S**2 * 65536)


class Framer:
    """Finds messages in any stream of bytes; it holds less than one.

    What is no message, or of a length that its id does not have, is skipped byte by byte; half a
    message is dropped when nothing follows it in time.
    """

    def __init__(
        self,
        sizes: Mapping[int, tuple[int, ...]],  # bytes of data by message id; 0 is the short form
        *,
        destination: int | tuple[int, ...] = HOST,  # accepted, one or several
        source: int = CONTROLLER,
        patience_s: float = 0.03,  # how long half a message waits for its next byte
    ) -> None:
        self.resyncs = 0  # stretches of bytes that were no message
        self._sizes = sizes
        self._destinations = (destination,) if isinstance(destination, int) else destination
        self._source = source
        self.called = self._destinations[0]  # destination of the last message
        self._patience_s = patience_s
        self._held = b""
        self._last_s = 0.0
        self._lost = False

    @property
    def wanted(self) -> int:
        """Bytes that complete the message in hand, or its header: what to read next."""
        size = self._size(self._held)
        return HEADER_BYTES - len(self._held) if size is None else size - len(self._held)

    def feed(self, data: bytes, now_s: float) -> list[Message]:
        """Return the messages that `data`, come at `now_s` (any clock), makes whole."""
        late = now_s - self._last_s > self._patience_s
        found = self._take(len(self._held)) if late and self._held else []
        if data:
            self._last_s = now_s
            self._held += data
            found += self._take(0)
        return found

    def _take(self, drop: int) -> list[Message]:
        """Cut whole messages off; rather than wait for more, skip a byte of the first `drop`."""
        found, at = [], 0
        while len(self._held) > at:
            size = self._size(self._held[at : at + HEADER_BYTES])
            if size is not None and 0 < size <= len(self._held) - at:
                found.append(self._message(self._held[at : at + size]))
                at += size
                self._lost = False
            elif size == 0 or at < drop:
                self.resyncs += not self._lost
                self._lost = True
                at += 1
            else:
                break
        self._held = self._held[at:]
        return found

    def _size(self, held: bytes) -> int | None:
        """Return the length of the message that begins here, 0 if none does, None if unknown."""
        if len(held) < HEADER_BYTES:
            return None
        message_id, length, destination, source = struct.unpack_from("<HHBB", held)
        if destination & ~LONG not in self._destinations or source != self._source:
            return 0
        data = length if destination & LONG else 0
        return HEADER_BYTES + data if data in self._sizes.get(message_id, ()) else 0

    def _message(self, raw: bytes) -> Message:
        message_id, *parameters, destination = struct.unpack_from("<HBBB", raw)
        self.called = destination & ~LONG
        data = raw[HEADER_BYTES:]
        if data:
            return Message(message_id, data=data)
        return Message(message_id, (parameters[0], parameters[1]))
