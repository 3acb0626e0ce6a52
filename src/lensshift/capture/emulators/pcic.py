"""An ifm O3D or O3R that is not there: a PCIC server on this computer."""

from __future__ import annotations

import select
import socket
import threading
import time
from contextlib import suppress

from lensshift.capture.drivers.pcic_protocol import RESULT_TICKET, PcicParser, write_message
from lensshift.capture.emulators.listener import EmulatedCamera, Look, listen
from lensshift.capture.emulators.pcic_result import MODELS, result_content, schema_text, wanted_by

_LONGEST_COMMAND = 1 << 16  # a schema has a few thousand bytes
_SEND_S = 2.0  # a client that takes nothing for so long is dropped


class PcicServer(EmulatedCamera):
    """Answers commands and streams what `look` sees; a context manager with a thread.

    One client at a time. Commands: `p0`, `p1` output off and on, `V?`, `G?`, `C?`, `c` with a
    schema, which says what the results hold from then on.
    """

    def __init__(
        self,
        look: Look,  # called with begin and end of an exposure (`time.monotonic`), after its end
        *,
        rate_hz: float = 10.0,  # results a second
        host: str = "127.0.0.1",  # own address
        port: int = 0,  # 0 takes a free one
        model: str = "O3D",  # "O3D" or "O3R"
        exposure_s: float = 0.005,  # length of an exposure
        first_count: int = 100,  # frame count at the beginning
    ) -> None:
        super().__init__(look, host, rate_hz, exposure_s)
        if model not in MODELS:
            raise ValueError(f"expected a model of {', '.join(MODELS)}, got {model!r}")
        self.schema = schema_text(model)
        self._wanted = wanted_by(self.schema, model)
        self._model = model
        self._count = first_count
        self._streams = False
        self._garbage = b""
        self._hang_up = threading.Event()
        self._socket = listen(host, port)

    @property
    def port(self) -> int:
        """TCP port to connect to."""
        return int(self._socket.getsockname()[1])

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
            if select.select([self._socket], [], [], 0.05)[0]:
                client, _ = self._socket.accept()
                client.settimeout(_SEND_S)
                with client, suppress(OSError):  # the client may go at any time
                    self._serve(client)
                self._streams = False

    def _serve(self, client: socket.socket) -> None:
        self._hang_up.clear()
        commands = PcicParser(_LONGEST_COMMAND)
        begin_s = time.monotonic()
        while not (self._stop.is_set() or self._hang_up.is_set()):
            due_s = begin_s + self._exposure_s
            left_s = min(0.05, max(0.0, due_s - time.monotonic()))
            if select.select([client], [], [], left_s)[0]:
                data = client.recv(65536)
                if not data:
                    return
                for one in commands.feed(data):
                    client.sendall(write_message(one.ticket, self._answer(one.content)))
            if time.monotonic() >= due_s:
                if self._streams:
                    self._send_result(client, begin_s, due_s)
                self._count += 1
                begin_s = max(begin_s + self._period_s, time.monotonic() - self._exposure_s)

    def _send_result(self, client: socket.socket, begin_s: float, end_s: float) -> None:
        frame = self._look(begin_s, end_s)
        content = result_content(
            frame, model=self._model, count=self._count, time_s=begin_s, wanted=self._wanted
        )
        garbage, self._garbage = self._garbage, b""
        client.sendall(garbage + write_message(RESULT_TICKET, content))
        self.sent += 1

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
            try:
                self._wanted = wanted_by(command[10:], self._model)
            except ValueError:
                return b"!"
            self.schema = command[10:]
            return b"*"
        return b"?"
