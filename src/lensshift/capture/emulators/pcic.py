"""An ifm O3D or O3R that is not there: a PCIC server on this computer."""

from __future__ import annotations

import ipaddress
import re
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

import numpy as np

from lensshift.capture.emulators.listener import listen
from lensshift.core.types import Frame

Look = Callable[[float, float], Frame]

_DISTANCE_STEP_M = {"O3D": 1e-3, "O3R": 1.5259e-4}
_AMPLITUDE_STEP = {"O3D": 1e-3, "O3R": 1e-4}  # an O3D does not tell it: clients see counts
_COMMAND = re.compile(rb"(\d{4})L(\d{9})\r\n")
_SCHEMA = b'{"layouter": "flexible", "format": {"dataencoding": "ascii"}, "elements": []}'


def result_content(
    frame: Frame, *, model: str = "O3D", count: int = 0, time_s: float = 0.0
) -> bytes:
    """Write a frame as a result, `star` to `stop`.

    Parameters
    ----------
    frame : what the camera sees
    model : "O3D" (header version 1, distance in mm) or "O3R" (version 2, with TOF_INFO)
    count : frame count
    time_s : the camera's clock
    """
    distance_m = np.zeros(frame.amplitude.shape) if frame.distance_m is None else frame.distance_m
    distance = np.where(frame.valid, np.rint(distance_m / _DISTANCE_STEP_M[model]), 0)
    amplitude = np.rint(np.where(frame.valid, frame.amplitude, 0) / _AMPLITUDE_STEP[model])
    images = [
        (100, np.clip(distance, 0, 65535).astype("<u2")),
        (101, np.clip(amplitude, 0, 65535).astype("<u2")),
        (300, (~frame.valid).astype("<u1")),
    ]
    rows, cols = frame.amplitude.shape
    about = (cols, rows, count, time_s, 1 if model == "O3D" else 2)
    chunks = [_chunk(kind, 2 * (kind != 300), image.tobytes(), *about) for kind, image in images]
    if model == "O3R":
        steps = (_DISTANCE_STEP_M[model], _AMPLITUDE_STEP[model])
        info = struct.pack(
            "<I2f3f6fI32fI32f", 1, *steps, *[0.0] * 9, 0, *[0.0] * 32, 0, *[0.0] * 32
        )
        chunks.append(_chunk(420, 0, info, *about))
    return b"star" + b"".join(chunks) + b"stop"


def _chunk(
    kind: int,
    pixel: int,
    data: bytes,
    cols: int,
    rows: int,
    count: int,
    time_s: float,
    version: int,
) -> bytes:
    size = 36 if version == 1 else 48
    whole_s = int(time_s)
    header = struct.pack(
        "<9I",
        kind,
        size + len(data),
        size,
        version,
        cols,
        rows,
        pixel,
        int(time_s * 1e6) % 2**32,
        count % 2**32,
    )
    if version > 1:
        header += struct.pack("<3I", 0, whole_s % 2**32, int((time_s - whole_s) * 1e9))
    return header + data


class PcicServer:
    """Answers commands and streams what `look` sees; a context manager with a thread.

    One client at a time. Commands: `p0`, `p1` output off and on, `V?`, `G?`, `C?`, `c` with a
    schema, which is kept and has no effect.

    Parameters
    ----------
    look : called with begin and end of an exposure (`time.monotonic`), after its end
    rate_hz : results a second
    host : own address; other computers can connect only with `allow_remote`
    port : 0 takes a free one
    model : "O3D" or "O3R"
    exposure_s : length of an exposure
    first_count : frame count at the beginning
    """

    def __init__(
        self,
        look: Look,
        *,
        rate_hz: float = 10.0,
        host: str = "127.0.0.1",
        port: int = 0,
        model: str = "O3D",
        exposure_s: float = 0.005,
        first_count: int = 100,
        allow_remote: bool = False,
    ) -> None:
        if not allow_remote and host != "localhost" and not ipaddress.ip_address(host).is_loopback:
            raise ValueError(f"expected an address of this computer, got {host}")
        if model not in _DISTANCE_STEP_M:
            raise ValueError(f"expected a model of {', '.join(_DISTANCE_STEP_M)}, got {model!r}")
        if not (rate_hz > 0 and 0 <= exposure_s <= 1 / rate_hz):
            raise ValueError(
                "expected a positive rate and an exposure within its period, got "
                f"{rate_hz} Hz and {exposure_s} s"
            )
        self.sent = 0
        self.schema = _SCHEMA
        self._look = look
        self._period_s = 1.0 / rate_hz
        self._exposure_s = exposure_s
        self._model = model
        self._count = first_count
        self._streams = False
        self._garbage = b""
        self._hang_up = threading.Event()
        self._stop = threading.Event()
        self._listener = listen(host, port)
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def port(self) -> int:
        """TCP port to connect to."""
        return int(self._listener.getsockname()[1])

    def __enter__(self) -> PcicServer:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._listener.close()

    def hang_up(self) -> None:
        """Drop the connection."""
        self._hang_up.set()

    def inject(self, garbage: bytes) -> None:
        """Send these bytes before the next result."""
        self._garbage = garbage

    def reboot(self) -> None:
        """Begin to count anew, but keep the connection."""
        self._count = 0

    def _run(self) -> None:
        while not self._stop.is_set():
            if select.select([self._listener], [], [], 0.05)[0]:
                client, _ = self._listener.accept()
                with client, suppress(OSError):  # the client may go at any time
                    self._serve(client)
                self._streams = False

    def _serve(self, client: socket.socket) -> None:
        self._hang_up.clear()
        waiting = b""
        begin_s = time.monotonic()
        while not (self._stop.is_set() or self._hang_up.is_set()):
            due_s = begin_s + self._exposure_s
            left_s = min(0.05, max(0.0, due_s - time.monotonic()))
            if select.select([client], [], [], left_s)[0]:
                data = client.recv(65536)
                if not data:
                    return
                waiting = self._obey(client, waiting + data)
            if time.monotonic() >= due_s:
                if self._streams:
                    self._send_result(client, begin_s, due_s)
                self._count += 1
                begin_s = max(begin_s + self._period_s, time.monotonic() - self._exposure_s)

    def _send_result(self, client: socket.socket, begin_s: float, end_s: float) -> None:
        frame = self._look(begin_s, end_s)
        content = result_content(frame, model=self._model, count=self._count, time_s=begin_s)
        garbage, self._garbage = self._garbage, b""
        client.sendall(garbage + _message(b"0000", content))
        self.sent += 1

    def _obey(self, client: socket.socket, waiting: bytes) -> bytes:
        """Answer the whole commands in what has come; return the rest."""
        while head := _COMMAND.match(waiting):
            end = 16 + int(head[2])
            if len(waiting) < end:
                break
            client.sendall(_message(head[1], self._answer(waiting[20 : end - 2])))
            waiting = waiting[end:]
        return waiting

    def _answer(self, command: bytes) -> bytes:
        if command in (b"p0", b"p1"):
            self._streams = command == b"p1"
            return b"*"
        if command == b"V?":
            return b"03 01 04"
        if command == b"G?":
            return b"IFM ELECTRONIC\tEMULATOR\t" + self._model.encode()
        if command == b"C?":
            return b"%09d" % len(self.schema) + self.schema
        if command[:1] == b"c" and command[1:10] == b"%09d" % (len(command) - 10):
            self.schema = command[10:]
            return b"*"
        return b"?"


def _message(ticket: bytes, content: bytes) -> bytes:
    return ticket + b"L" + b"%09d" % (len(content) + 6) + b"\r\n" + ticket + content + b"\r\n"
