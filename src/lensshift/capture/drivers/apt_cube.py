"""One APT controller in its own units: what it says is believed only when it says it twice.

The protocol has no checksum: a reply that lost a byte and took one from the next message looks
whole, and its position is wrong. So impossible replies are thrown away, the others must agree.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from statistics import median
from typing import TypeVar

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import CHANNEL, DamagedMessage, Id, Message, Status
from lensshift.capture.drivers.apt_link import AptLink
from lensshift.core.errors import DeviceError, DeviceTimeout

_MOST_COUNTS = 1_040_000  # 30 mm, and no Z8 actuator is longer than 25 mm
_STOP_S = 0.5  # the longest a motor told to stop is watched
_POLL_S = 0.002  # between two looks

R = TypeVar("R", apt.Info, apt.Limits)


class AptCube:
    """A TDC001 or KDC101 at a port; DeviceError if it cannot be had, or does not speak APT.

    A request is sent so many `attempts`, replies may disagree four times as often; those of a motor
    at rest may differ by the `tolerance` in counts.
    """

    def __init__(self, port: str, *, tolerance: int, reply_timeout_s: float, attempts: int) -> None:
        self.link = AptLink(port, reply_timeout_s=reply_timeout_s, attempts=attempts)
        self._tolerance = tolerance
        self._attempts = attempts
        self._recent: deque[int] = deque(maxlen=3)  # counts that were reported
        try:
            self.link.send(Message(Id.STOP_UPDATES))
            self.info = self.confirmed(Id.REQUEST_INFO, apt.Info)
        except DeviceError:
            self.link.close()
            raise
        self.link.device = f"{self.info.model} {self.info.serial_number}"

    @property
    def last_counts(self) -> float | None:
        """Where it was last known to be."""
        return median(self._recent) if self._recent else None

    def poll(self, *before: Message, attempts: int = 0) -> Status:
        """Return one possible status, not confirmed; send `before` together with the request."""
        request = Message(Id.REQUEST_STATUS, (CHANNEL, 0))
        status = self.link.ask(
            *before, request, answer=Id.STATUS, read=_possible_status, attempts=attempts
        )
        self._recent.append(status.counts)
        return status

    def status(self) -> Status:
        """Return a status that other replies confirm.

        Two replies in a row agree if the motor stands; while it moves, the middle one of three.
        After a reply that took a byte of the next message, the rest of that is no message: so
        replies with such a stretch between them do not count as in a row.
        """
        replies: list[Status] = []
        resyncs = self.link.resyncs
        for _ in range(4 * self._attempts):
            last = self.poll()
            if self.link.resyncs != resyncs:
                resyncs = self.link.resyncs
                replies.clear()
            replies.append(last)
            counts = [one.counts for one in replies[-2:] if not one.moving]
            rests = len(counts) == 2 and abs(counts[0] - counts[1]) <= self._tolerance
            if rests and _agree(replies[-2:], 2):
                return last
            if _agree(replies[-3:], 3) and last.moving:
                return sorted(replies[-3:], key=lambda one: one.counts)[1]
        raise self._contradiction()

    def confirmed(self, request: Id, kind: type[R]) -> R:
        """Return a record that two replies in a row give; the answer has the id after `request`."""
        before = None
        for _ in range(4 * self._attempts):
            last = self.link.ask(
                Message(request, (CHANNEL, 0)),
                answer=request + 1,
                read=lambda reply: kind.unpack(reply.data),
            )
            if last == before:
                return last
            before = last
        raise self._contradiction()

    def write(self, name: str, setter: Id, wanted: apt.Record) -> None:
        """Set a record until it reads back, else raise; request and answer have the next ids."""
        for _ in range(self._attempts):
            kept = self.link.ask(
                Message(setter, data=wanted.pack()),
                Message(setter + 1, (CHANNEL, 0)),
                answer=setter + 2,
                read=lambda reply: type(wanted).unpack(reply.data),
            )
            if kept == wanted:
                return
        raise self.link.error(f"wrote {wanted}, reads back {kept}", f"set {name} parameters")

    def stand_still(self) -> None:
        """Say stop until two replies in a row say that the motor stands, for a while at most."""
        deadline_s = time.monotonic() + _STOP_S
        stop = Message(Id.MOVE_STOP, (CHANNEL, apt.STOP_AT_ONCE))
        still = 0
        while still < 2 and time.monotonic() < deadline_s:
            with suppress(DeviceTimeout):
                still = 0 if self.poll(stop, attempts=1).moving else still + 1
            time.sleep(_POLL_S)

    def _contradiction(self) -> DeviceError:
        problem = "its replies contradict each other (cable? two programs at one port?)"
        return DeviceError(problem, device=self.link.device)


def _possible_status(reply: Message) -> Status:
    status = Status.unpack(reply.data)
    if abs(status.counts) > _MOST_COUNTS:
        raise DamagedMessage(f"impossible position {status.counts}")
    return status


def _agree(replies: list[Status], number: int) -> bool:
    """Tell whether so many replies differ only in what may change from one to the next."""
    return len(replies) == number and len({one.bits & ~apt.CHANGING for one in replies}) == 1
