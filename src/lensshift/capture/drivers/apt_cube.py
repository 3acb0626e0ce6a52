"""One APT controller: its port, requests and whole answers, in its own units.

The protocol has no checksum: a reply that lost a byte and took one from the next message looks
whole, and its position is wrong. So impossible replies are thrown away, and what it says is
believed only when it says it twice.
"""

from __future__ import annotations

import os
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from statistics import median
from typing import Any, TypeVar

import serial
import serial.tools.list_ports

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import (
    CHANNEL,
    TO_HOST,
    DamagedMessage,
    Framer,
    Id,
    Message,
    Status,
)
from lensshift.core.errors import DeviceError, DeviceTimeout

_READ_S = 0.005  # longest wait for bytes before the deadline is looked at
_WRITE_S = 5.0  # a message takes milliseconds: by then the port is stuck
_DRAINED_MESSAGES = 100  # no more, in case something sends without end

T = TypeVar("T")
_MOST_COUNTS = 1_040_000  # 30 mm, and no Z8 actuator is longer than 25 mm
_STOP_S = 0.5  # the longest a motor told to stop is watched
_POLL_S = 0.002  # between two looks

R = TypeVar("R", apt.Info, apt.Limits)


def find_port(name: str) -> str:
    """Return the port of a USB serial number, or of what is a port already; DeviceError if none."""
    if not name.isdigit():
        return name
    there = list(serial.tools.list_ports.comports())
    for port in there:
        if port.serial_number == name:
            return str(port.device)
    listed = ", ".join(f"{one.device} ({one.serial_number or one.description})" for one in there)
    raise DeviceError(
        f"no USB device has this serial number; there are: {listed or 'no serial ports at all'}",
        device=name,
        command="open",
    )


class AptLink:
    """Requests and replies over one port, which no threads tear apart; DeviceError without one."""

    def __init__(self, port: str, *, reply_timeout_s: float, attempts: int) -> None:
        self.device = port  # how errors name it; the model, once it is known
        self.repeated = 0  # requests that had to be sent again
        self.heard: Counter[int] = Counter()  # messages that came, by id
        self._bytes = 0  # that came
        self._timeout_s = reply_timeout_s
        self._attempts = attempts
        self._framer = Framer(TO_HOST)
        self._lock = threading.RLock()
        self._alive = False
        try:
            self._port: Any = serial.serial_for_url(
                port, baudrate=115200, timeout=_READ_S, write_timeout=_WRITE_S, rtscts=True,
                exclusive=True,
            )  # fmt: skip
        except (OSError, ValueError) as error:
            number = getattr(error, "errno", None)  # pyserial names the port anew
            why = os.strerror(number) if number is not None else error
            raise DeviceError(f"cannot be opened ({why})", device=port, command="open") from error
        self._alive = True
        # FTDI chips keep short replies back for 16 ms unless told; other ports cannot be told.
        with suppress(AttributeError, NotImplementedError, OSError, ValueError):
            self._port.set_low_latency_mode(True)

    @property
    def alive(self) -> bool:
        """Whether the port is open and its other end was there when last used."""
        return self._alive

    @property
    def resyncs(self) -> int:
        """Stretches of bytes that were no message."""
        return self._framer.resyncs

    def send(self, *messages: Message) -> None:
        """Send messages that are not answered. DeviceError if the connection is lost."""
        with self._lock:
            self._write(messages)

    def ask(
        self, *messages: Message, answer: int, read: Callable[[Message], T], attempts: int = 0
    ) -> T:
        """Send messages, the last a request, until `answer` comes and `read` takes it.

        DeviceTimeout if none comes, DeviceError if the connection is lost; DamagedMessage of `read`
        asks again, so many `attempts`.
        """
        with self._lock:
            before = self._bytes, self.heard.total()
            for attempt in range(attempts or self._attempts):
                self.repeated += attempt > 0
                self._drain()
                self._write(messages)
                for reply in self._replies(answer):
                    with suppress(DamagedMessage):
                        return read(reply)
        garbled = self._bytes > before[0] and self.heard.total() == before[1]
        problem = "no answer (switched off, or no APT controller at this port?)"
        if garbled:
            problem = "bytes come, but no APT messages (another device, or another baud rate?)"
        raise self.error(problem, f"request {messages[-1].id:#06x}", DeviceTimeout)

    def error(
        self, problem: str, command: str = "", kind: type[DeviceError] = DeviceError
    ) -> DeviceError:
        """Return an error that names the device."""
        return kind(problem, device=self.device, command=command)

    def close(self) -> None:
        """Let go of the port."""
        self._alive = False
        # pyserial forgets to close a socket whose other end has gone; the garbage collector does.
        with self._lock, warnings.catch_warnings(), suppress(OSError):
            warnings.simplefilter("ignore", ResourceWarning)
            self._port.close()

    def _replies(self, answer: int) -> list[Message]:
        """Return the messages `answer` that arrive first, none if they are damaged or too late."""
        deadline_s = time.monotonic() + self._timeout_s
        resyncs = self._framer.resyncs
        replies: list[Message] = []
        late = False
        while not replies and not late and self._framer.resyncs == resyncs:
            # Once more when time is up: it may be this program that was kept from looking.
            late = time.monotonic() > deadline_s
            replies = [message for message in self._read() if message.id == answer]
        return replies

    def _drain(self) -> None:
        """Take what came unasked or too late, so that no old answer is taken for a new one."""
        for _ in range(_DRAINED_MESSAGES):
            if not self._use(lambda: self._port.in_waiting):
                break
            self._read()

    def _read(self) -> list[Message]:
        # Never more than is wanted: the port waits for all it is asked for.
        data = self._use(lambda: self._port.read(self._framer.wanted))
        self._bytes += len(data)
        messages = self._framer.feed(data, time.monotonic())
        self.heard.update(message.id for message in messages)
        return messages

    def _write(self, messages: tuple[Message, ...]) -> None:
        self._use(lambda: self._port.write(b"".join(one.to_bytes() for one in messages)))

    def _use(self, action: Callable[[], Any]) -> Any:
        """Use the port, and turn its errors into one that says what to look at."""
        if not self._alive:
            raise self.error("connection lost (cable?)")
        try:
            return action()
        except serial.SerialTimeoutException as error:
            problem = "the port takes no bytes (no APT controller at this port?)"
            raise self.error(problem, kind=DeviceTimeout) from error
        except OSError as error:
            self._alive = False
            raise self.error(f"connection lost (cable?): {error}") from error


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
