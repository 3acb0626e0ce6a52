"""Emulated APT controllers at the end of a real link: loopback TCP or a pty."""

from __future__ import annotations

import os
import select
import socket
import threading
from contextlib import ExitStack, suppress
from typing import Any, Literal, Self

import numpy as np

from lensshift.capture.emulators.apt_controller import AptController
from lensshift.capture.emulators.listener import listen
from lensshift.core.arrays import Floats
from lensshift.core.ending import Closing

__all__ = ["AptController", "EmulatedStagePair", "Served", "serve_pty", "serve_tcp"]

_LOOK_S = 0.02  # how soon it notices a pulled cable or the end
_BLOCK_BYTES = 4096  # at once; a message has 90 at most


class _Tcp:
    """A TCP server that talks to one host at a time."""

    def __init__(self, host: str, port: int) -> None:
        self._server = listen(host, port)
        self._host: socket.socket | None = None
        address = self._server.getsockname()
        self.url = f"socket://{address[0]}:{address[1]}"

    def exchange(self, controller: AptController, wait_s: float) -> None:
        """Pass bytes in and answers out; wait for bytes at most so long."""
        ready, _, _ = select.select([self._host or self._server], [], [], wait_s)
        if ready and self._host is None:
            self._host, _ = self._server.accept()
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        elif self._host is not None:
            try:
                data = self._host.recv(_BLOCK_BYTES) if ready else None
                if data == b"":
                    self.drop()
                    return
                self._host.sendall(controller.receive(data) if data else controller.due())
            except OSError:
                self.drop()

    def drop(self) -> None:
        """End the connection with the host; another may come."""
        if self._host is not None:
            self._host.close()
            self._host = None

    def close(self) -> None:
        """Let go of everything."""
        self.drop()
        self._server.close()


class _Pty:
    """A pseudo terminal."""

    def __init__(self) -> None:
        import tty

        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        # Our own hold on the host's end keeps the pty alive while no host has it open.
        self.url = os.ttyname(self._theirs)

    def exchange(self, controller: AptController, wait_s: float) -> None:
        """Pass bytes in and answers out; wait for bytes at most so long."""
        ready, _, _ = select.select([self._ours], [], [], wait_s)
        with suppress(OSError):
            data = os.read(self._ours, _BLOCK_BYTES) if ready else b""
            answers = controller.receive(data) if data else controller.due()
            os.write(self._ours, answers)

    def close(self) -> None:
        """Let go of everything; the host sees its device vanish."""
        os.close(self._theirs)
        os.close(self._ours)


class Served(Closing):
    """A controller that answers at `url` until `close`, in a thread of its own."""

    def __init__(self, controller: AptController, line: _Tcp | _Pty) -> None:
        self.controller = controller
        self.url = line.url
        self._line = line
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self._serve, name=f"emulator {line.url}", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop serving; a second call does nothing."""
        self._ended.set()
        self._thread.join()

    def _serve(self) -> None:
        while self.controller.plugged and not self._ended.is_set():
            self._line.exchange(self.controller, min(self.controller.quiet_s, _LOOK_S))
        self._line.close()


def serve_tcp(controller: AptController, host: str = "127.0.0.1", port: int = 0) -> Served:
    """Serve one host at a time over TCP (port 0: a free one); `url` is "socket://host:port"."""
    return Served(controller, _Tcp(host, port))


def serve_pty(controller: AptController) -> Served:
    """Serve a pseudo terminal; `url` is its path. Not on Windows."""
    return Served(controller, _Pty())


class EmulatedStagePair:
    """Two controllers, row and col, with actuators, for a `with` statement; see `AptController`."""

    def __init__(
        self, *, seed: int = 0, link: Literal["tcp", "pty"] = "tcp", **settings: Any
    ) -> None:
        if link not in ("tcp", "pty"):
            raise ValueError(f"expected link 'tcp' or 'pty', got {link!r}")
        row = AptController(model="KDC101", serial_number=27000001, seed=2 * seed, **settings)
        col = AptController(model="TDC001", serial_number=83000001, seed=2 * seed + 1, **settings)
        self.controllers = row, col
        self.urls = "", ""
        self._link = link
        self._served = ExitStack()

    def lens_mm(self, now_s: float | None = None) -> Floats:
        """Return the true position [2] of the lens at `time.monotonic()`, also seconds ago."""
        return np.array([one.lens_mm(now_s) for one in self.controllers])

    def __enter__(self) -> Self:
        serve = serve_pty if self._link == "pty" else serve_tcp
        row, col = (self._served.enter_context(serve(one)) for one in self.controllers)
        self.urls = row.url, col.url
        return self

    def __exit__(self, *_: object) -> None:
        self._served.close()
