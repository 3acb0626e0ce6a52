"""APT messages that other programs send to a controller, beyond those of the own driver.

Source: Thorlabs APT communications protocol; layouts as in thorlabs-apt-protocol.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from lensshift.capture.drivers import apt_codec as apt

# A cube is also called as a rack with one bay, as older programs do.
ADDRESSES = (apt.CONTROLLER, 0x11, 0x21)


class More(IntEnum):
    """Ids; SET, REQUEST and the answer follow each other."""

    START_UPDATES = 0x0011
    IDENTIFY = 0x0223
    SET_ENCODER = 0x0409
    REQUEST_ENCODER = 0x040A
    ENCODER = 0x040B
    SET_POSITION = 0x0410
    REQUEST_POSITION = 0x0411
    POSITION = 0x0412
    JOG = 0x0418
    RELATIVE = 0x0447
    MOVE_RELATIVE = 0x0448
    ABSOLUTE = 0x0452
    MOVE_VELOCITY = 0x0457
    MOVE_JOG = 0x046A
    ACKNOWLEDGE = 0x0492
    GAINS = 0x04A2
    LAMPS = 0x04B5


@dataclass(frozen=True, slots=True)
class Jog(apt.Record, layout="<HHllllH"):
    """How to jog: mode (1 until stopped, 2 one step), step in counts, speeds, how to stop."""

    mode: int
    step: int
    lowest: int
    acceleration: int
    highest: int
    stop: int


@dataclass(frozen=True, slots=True)
class Gains(apt.Record, layout="<HllllH"):
    """Of the servo: proportional, integral, differential, limit of the integral, which count."""

    proportional: int
    integral: int
    differential: int
    limit: int
    which: int


@dataclass(frozen=True, slots=True)
class Lamps(apt.Record, layout="<HH"):
    """When the lamp of the controller shines."""

    mode: int


def records(counts_per_mm: float) -> dict[int, apt.Record]:
    """Return what a controller holds of these after power on."""
    speed, acceleration = apt.servo_velocity(counts_per_mm), apt.servo_acceleration(counts_per_mm)
    return {
        More.JOG: Jog(2, round(0.05 * counts_per_mm), 0, acceleration, speed, 2),
        More.RELATIVE: apt.Target(round(0.1 * counts_per_mm)),
        More.ABSOLUTE: apt.Target(0),
        More.GAINS: Gains(435, 195, 993, 195, 15),
        More.LAMPS: Lamps(15),
    }


_SET = {0x0416: 22, 0x0445: 6, 0x0450: 6, 0x04A0: 20, 0x04B3: 4}
# Bytes of data by message, as `apt_codec.TO_CONTROLLER`.
SIZES: Mapping[int, tuple[int, ...]] = {
    **apt.TO_CONTROLLER,
    **{number: (size,) for number, size in _SET.items()},
    **{number + 1: (0,) for number in _SET},
    **dict.fromkeys((apt.Id.DISCONNECT, More.START_UPDATES, More.IDENTIFY, More.ACKNOWLEDGE), (0,)),
    **dict.fromkeys((More.REQUEST_ENCODER, More.REQUEST_POSITION), (0,)),
    **dict.fromkeys((More.MOVE_VELOCITY, More.MOVE_JOG), (0,)),
    **dict.fromkeys((More.SET_ENCODER, More.SET_POSITION), (6,)),
    **dict.fromkeys((apt.Id.MOVE_ABSOLUTE, More.MOVE_RELATIVE), (0, 6)),
}
