"""What the doctor says: one line each, with what to do, the worst first."""

from __future__ import annotations

import errno
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from lensshift.core.errors import DeviceError


class Level(IntEnum):
    """How bad a finding is."""

    NOTE = 0  # worth knowing
    DOUBT = 1  # the rig works, but not as well as it should
    FAULT = 2  # it does not work


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was found."""

    level: Level  # how bad it is
    name: str  # what it is called, two words at most
    said: str  # what is so, with numbers
    cure: str = ""  # what to do

    @property
    def line(self) -> str:
        """All of it on one line."""
        cure = f"; {self.cure}" if self.cure else ""
        return f"{self.level.name} {self.name}: {self.said}{cure}"


# Words of a driver's error -> name of the fault, and what to do.
_STAGE = (
    ("limit switch", "limit", "move it off the switch by hand, choose rest_mm and travel_mm anew"),
    ("out of travel", "limit", "choose rest_mm in the middle of the travel"),
    ("bytes come", "wrong baud", "look at `lensshift info --devices`: is this port an APT cube?"),
    ("no answer", "stage silent", "switch the cube on, look at `lensshift info --devices`"),
    ("no usb device", "stage missing", "plug it in; Windows: tick Load VCP in its driver"),
    ("cannot be opened", "stage missing", "plug it in; `lensshift info --devices` lists the ports"),
    ("nobody has allowed", "homing", "look that the lens may go there, then --yes"),
    ("connection lost", "stage lost", "look at its cable and power"),
    ("strayed", "stage strays", "who touched it? Weight against its approach_direction? hold_mm"),
    ("contradict", "second process", "close other programs that use it; look at the cable"),
    ("does not know its zero", "homing", 'home = "ask" in the rig file'),
)  # fmt: skip
_BLOCKED = "look for what holds mount or screw; move it by hand; tightened clamp?"


def cause_number(error: BaseException) -> int | None:
    """Return the errno of the system's error behind an error, None if there is none."""
    at: BaseException | None = error
    while at is not None:
        if isinstance(at, OSError) and at.errno is not None:
            return at.errno
        at = at.__cause__
    return None


def stage_fault(error: Exception) -> Finding:
    """Return the finding behind an error of the stage."""
    said = str(error)
    number = cause_number(error)
    if number in (errno.EACCES, errno.EPERM):
        group = _group_of(error.device) if isinstance(error, DeviceError) else "dialout"
        cure = f"sudo usermod -aG {group} $USER and log in anew; Windows: close Kinesis"
        return Finding(Level.FAULT, "no permission", said, cure)
    if number in (errno.EBUSY, errno.EAGAIN):
        return Finding(Level.FAULT, "second process", said, "close other programs that use it")
    for words, name, cure in _STAGE:
        if words in said.lower():
            if name == "stage missing" and unbound_cubes():
                cure = "it is plugged in, without a driver: sudo modprobe ftdi_sio, docs/rig.md"
            return Finding(Level.FAULT, name, said, cure)
    moved = isinstance(error, DeviceError) and error.command and error.__cause__ is None
    name = "stage blocked" if moved else "stage"  # what its own code raises is another matter
    return Finding(Level.FAULT, name, said, _BLOCKED if name == "stage blocked" else "")


def _group_of(port: str) -> str:
    """Return the group whose members may use a port."""
    with suppress(OSError, KeyError, NotImplementedError):
        return Path(port).group()
    return "dialout"


def unbound_cubes() -> list[str]:
    """Return the APT cubes on USB that have no serial port, as Linux lists them."""
    found = []
    for device in Path("/sys/bus/usb/devices").glob("*"):
        with suppress(OSError):
            told = [(device / name).read_text().strip() for name in ("idVendor", "idProduct")]
            if told == ["0403", "faf0"] and not list(device.glob("*/ttyUSB*")):
                found.append(device.name)
    return found


def disk_fault(error: Exception) -> Finding | None:
    """Return the finding if an error says that a disk is full, or takes no larger files."""
    if cause_number(error) not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return None
    return Finding(Level.FAULT, "full disk", str(error), "make room, or choose another --out")
