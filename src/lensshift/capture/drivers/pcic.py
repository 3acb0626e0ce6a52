"""ifm O3D, O3X and O3R over TCP: asks for results and turns them into frames."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from lensshift.capture.drivers import pcic_protocol as pcic
from lensshift.capture.drivers.receiver import LOOK_S, ReceivingCamera, counter_steps
from lensshift.capture.rig import CameraFrame
from lensshift.core.errors import DataError, DeviceTimeout
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import PixelDirections
from lensshift.core.types import Frame

RESULT_PORT = 50010  # of an O3D and O3R unless set otherwise
_RECEIVE_BYTES = 1 << 16  # at once
_FRAME_COUNT_AT = 4 + 32  # in a result: after `star`, in the first chunk


class PcicCamera(ReceivingCamera):
    """A client of a camera's process interface. A lost connection is not made again."""

    def __init__(
        self,
        host: str,  # address of the camera
        port: int = RESULT_PORT,  # 50010; of an O3R 50010 + number of the camera's port
        *,
        pitch_mm: float | tuple[float, float],  # pixel pitch, one number or (row, col)
        schema: str | None = None,  # what a result holds, with an amplitude; None: as it is
        modulation_hz: float | None = None,  # modulation frequency, if known
        timeout_s: float = 5.0,  # for connection, answer, first frame
    ) -> None:
        super().__init__(f"PCIC camera {host}:{port}", pitch_mm, modulation_hz)
        self._address = (host, port)
        self._schema = schema
        self._timeout_s = timeout_s
        self._socket: socket.socket | None = None
        self._reset()

    def _reset(self) -> None:
        self._parser = pcic.PcicParser()
        self._lock = threading.RLock()  # entered itself, as in `Receiver`
        self._changed = threading.Condition(self._lock)
        self._answers: dict[bytes, bytes] = {}
        self._ticket = 1000
        self._grid: Grid | None = None
        self._image: pcic.PcicImage | None = None
        self._newest = -1
        self._raw_count = 0
        self._time_us = 0
        self._bytes = 0  # of results
        self._wrong = 0
        self._problem = ""

    @property
    def intrinsics(self) -> PixelDirections | None:
        """Where the pixels look, as an O3R tells with each result, an O3D if asked; or None."""
        direction = None if self._image is None else self._image.direction
        return None if direction is None else PixelDirections(direction)

    def open(self) -> None:
        """Connect, set the schema, ask for results, wait for the first; DeviceError if it fails."""
        self._refuse_open()
        try:
            self._socket = socket.create_connection(self._address, self._timeout_s)
        except OSError as error:
            raise self._error(f"cannot connect: {error}") from error
        self._reset()
        self._socket.settimeout(LOOK_S)
        self._start()
        opened = False
        try:
            if self._schema is not None:
                text = self._schema.encode()
                self._command(b"c%09d%s" % (len(text), text))
            self._command(b"p1")
            with self._lock:
                opened = self._changed.wait_for(lambda: self._grid is not None, self._timeout_s)
            if not opened:
                problem = f"no result in {self._timeout_s:g} s: {self._explain(0, 0)}"
                raise self._error(problem, kind=DeviceTimeout)
        finally:
            if not opened:
                self.close()

    def _command(self, command: bytes) -> None:
        """Send a command and wait for its answer; raise if the camera refuses it."""
        what = command[:20].decode("ascii", "replace")
        with self._lock:
            self._ticket += 1
            ticket = b"%04d" % self._ticket
        if self._socket is None:
            raise self._error("not open: call open() first")
        try:
            self._socket.sendall(pcic.write_message(ticket, command))
        except OSError as error:
            raise self._error(f"the connection is lost: {error}", what) from error
        with self._lock:
            if not self._changed.wait_for(lambda: ticket in self._answers, self._timeout_s):
                raise self._error(f"no answer in {self._timeout_s:g} s", what, DeviceTimeout)
            answer = self._answers.pop(ticket)
        if answer[:1] in (b"!", b"?"):
            raise self._error(f"refused with {answer!r}", what)

    def _receive(self, stop: threading.Event) -> None:
        connection, parser = self._socket, self._parser
        while connection is not None and not stop.is_set():
            try:
                data = connection.recv(_RECEIVE_BYTES)
            except TimeoutError:
                continue
            except OSError as error:
                self._receiver.end(f"the connection is lost: {error}; open it again")
                return
            if not data:
                self._receiver.end("the camera has closed the connection; open it again")
                return
            self._bytes += len(data)
            for message in parser.feed(data):
                self._take(message)
            self._notice_begun(parser.begun())

    def _notice_begun(self, begun: bytes) -> None:
        """Follow the counter of a result of which only the first bytes have come."""
        if self._image is not None and len(begun) >= _FRAME_COUNT_AT + 4:
            (count,) = struct.unpack_from("<I", begun, _FRAME_COUNT_AT)
            self._newest += max(0, counter_steps(count, self._raw_count))
            self._raw_count = count

    def _take(self, message: pcic.Message) -> None:
        if message.ticket != pcic.RESULT_TICKET:
            self._bytes -= len(pcic.write_message(*message))
            with self._lock:
                if len(self._answers) < 16:  # nobody waits for more
                    self._answers[message.ticket] = message.content
                self._changed.notify_all()
            return
        try:
            image = pcic.read_result(message.content)
        except DataError as error:
            self._wrong += 1
            self._problem = str(error)
            return
        self._put(image)

    def _put(self, image: pcic.PcicImage) -> None:
        rows, cols = image.amplitude.shape
        if self._grid is not None and self._grid.shape != (rows, cols):
            self._wrong += 1
            self._problem = f"the image has become {cols} x {rows} pixels; open it again"
            return
        if self._image is None:
            self._newest, self._time_us = image.frame_count, image.time_us
        else:
            step = counter_steps(image.frame_count, self._raw_count)
            if step < 0:
                self._receiver.interrupt(
                    f"the camera has started anew: its frame count went back by {-step}"
                )
                step = 1
            self._newest += step
            self._time_us += counter_steps(image.time_us, self._image.time_us)
        self._raw_count = image.frame_count
        self._image = image
        time_s = self._time_us * 1e-6 if image.time_s is None else image.time_s
        frame = Frame(image.amplitude, image.distance_m, image.valid, time_s)
        self._receiver.put(CameraFrame(frame, self._newest, time.monotonic(), image.raw))
        if self._grid is None:
            with self._lock:
                self._grid = Grid((int(rows), int(cols)), self._pitch_mm)
                self._changed.notify_all()

    def _explain(self, bytes_before: int, wrong_before: int) -> str:
        """Tell why no frame came since so many bytes and wrong results."""
        if self._wrong > wrong_before:
            return f"{self._wrong - wrong_before} results could not be used ({self._problem})"
        if self._bytes > bytes_before:
            return (
                f"{self._bytes - bytes_before} bytes came, but no whole result "
                f"({self._parser.skipped_bytes} bytes skipped, {self._parser.oversize} messages "
                "too long)"
            )
        return "the camera sends no results; is it running, or waiting for a trigger?"

    def newest_cycle(self) -> int:
        """Return the counter of the newest frame that has begun to arrive, -1 before the first."""
        return self._newest

    def _explaining(self) -> Callable[[], str]:
        seen, wrong = self._bytes, self._wrong
        return lambda: self._explain(seen, wrong)

    def _losses(self) -> dict[str, int]:
        return {
            "wrong_results": self._wrong,
            "skipped_bytes": self._parser.skipped_bytes,
            "oversize_messages": self._parser.oversize,
        }

    def close(self) -> None:
        """Ask for silence, stop receiving, disconnect; a second call does nothing."""
        if self._socket is None:
            return
        with suppress(OSError):  # it may be gone already
            self._socket.sendall(pcic.write_message(b"9999", b"p0"))
        super().close()
        self._socket.close()
        self._socket = None

    def describe(self) -> Mapping[str, Any]:
        """Return what to keep beside the frames: address and what the camera told."""
        host, port = self._address
        known: dict[str, Any] = {"model": "ifm, PCIC", "address": f"{host}:{port}"}
        if self._schema is not None:
            known["schema"] = self._schema
        info = None if self._image is None else self._image.info
        if info is not None:
            known["distance_resolution_m"] = info.distance_resolution_m
            known["amplitude_resolution"] = info.amplitude_resolution
            known["amplitude_factors"] = list(info.amplitude_factors)
            known["extrinsic"] = list(info.extrinsic)
        return known
