"""The ifm O3M151: 64 x 16 pixels over UDP, at up to 50 frames a second."""

from __future__ import annotations

import errno
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from lensshift.capture.drivers.o3m_layout import SHAPE
from lensshift.capture.drivers.o3m_packets import MAX_PACKET_BYTES
from lensshift.capture.drivers.o3m_stream import O3MStream
from lensshift.capture.drivers.receiver import LOOK_S, ReceivingCamera
from lensshift.core.errors import DeviceError
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import PixelDirections

DATA_PORT = 42000  # where a camera sends unless set otherwise
PITCH_MM = 0.155  # of the sensor, from the paper
_SOCKET_BYTES = 4 << 20  # about four seconds at 50 Hz, if the system grants it


class O3MCamera(ReceivingCamera):
    """Receives what an O3M sends; nothing is ever sent to the camera."""

    def __init__(
        self,
        port: int = DATA_PORT,  # UDP port that the camera is set to; 0 takes a free one
        *,
        # Own address: all of them, since broadcasts of a camera arrive at no single one.
        host: str = "0.0.0.0",
        source: str | None = None,  # of several cameras: "192.168.1.1", or with ":port"
        pitch_mm: float | tuple[float, float] = PITCH_MM,
        modulation_hz: float | None = None,  # the camera does not tell it
    ) -> None:
        if not 0 <= port <= 65535:
            raise ValueError(f"expected a UDP port from 0 to 65535, got {port}")
        super().__init__(f"O3M on UDP port {port}", pitch_mm, modulation_hz)
        self._grid = Grid(SHAPE, self._pitch_mm)
        self._host = host
        self.port = port  # that listened at; of port 0 known once it is open
        self._stream = O3MStream(source)
        self._socket: socket.socket | None = None
        self._held_bytes = 0

    @property
    def intrinsics(self) -> PixelDirections | None:
        """Where the pixels look, as the coordinates of the newest image tell, or None."""
        image = self._stream.image
        direction = None if image is None else image.direction
        return None if direction is None else PixelDirections(direction)

    def open(self) -> None:
        """Begin to receive. DeviceError if it is open already, or another program has the port."""
        self._refuse_open()
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
            udp.bind((self._host, self.port))
        except OSError as error:
            udp.close()
            taken = error.errno == errno.EADDRINUSE
            cure = "close other programs that receive from the camera" if taken else "look at host"
            problem = f"cannot listen at {self._host}: {error.strerror}; {cure}"
            raise self._error(problem) from error
        # The system may have granted less; Linux tells twice what it holds.
        self._held_bytes = udp.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        udp.settimeout(LOOK_S)
        self.port = udp.getsockname()[1]
        self.name = f"O3M on UDP port {self.port}"
        self._socket = udp
        self._stream = O3MStream(self._stream.source)
        self._start()

    def _receive(self, stop: threading.Event) -> None:
        udp, stream, receiver = self._socket, self._stream, self._receiver
        if udp is None:
            return
        buffer = bytearray(MAX_PACKET_BYTES + 1)  # one more shows a datagram that is too long
        view = memoryview(buffer)
        while not stop.is_set():
            try:
                size, address = udp.recvfrom_into(buffer)
            except TimeoutError:
                continue
            try:
                frame = stream.push(view[:size], address, time.monotonic())
            except DeviceError as error:
                receiver.interrupt(error.problem)
                continue
            if frame is not None:
                receiver.put(frame)

    def newest_cycle(self) -> int:
        """Return the counter of the newest frame that has begun to arrive, -1 before the first."""
        return self._stream.newest_cycle()

    def _explaining(self) -> Callable[[], str]:
        before = self._stream.snapshot()
        return lambda: self._stream.explain(before)

    def _losses(self) -> dict[str, int]:
        return self._stream.totals()

    def close(self) -> None:
        """Stop receiving and let go of the port; a second call does nothing."""
        super().close()
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def describe(self) -> Mapping[str, Any]:
        """Return what to keep beside the frames: layout, temperatures, parameters, factors."""
        held = {"receive_buffer_bytes": self._held_bytes}
        return {**self._stream.describe(), "port": self.port, **held}
