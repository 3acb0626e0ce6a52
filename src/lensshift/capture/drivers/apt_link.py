"""The port of one APT controller: find it, open it, ask until a whole answer comes."""

from __future__ import annotations

import os
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import serial
import serial.tools.list_ports

from lensshift.capture.drivers.apt_codec import TO_HOST, DamagedMessage, Message
from lensshift.capture.drivers.apt_framer import Framer
from lensshift.core.errors import DeviceError, DeviceTimeout

_READ_S = 0.005  # longest wait for bytes before the deadline is looked at
_WRITE_S = 5.0  # a message takes milliseconds: by then the port is stuck
_DRAINED_MESSAGES = 100  # no more, in case something sends without end

T = TypeVar("T")


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
