"""The port at which an emulated device waits, and the thread in which an emulated camera runs."""

from __future__ import annotations

import ipaddress
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self

from lensshift.core.types import Frame

Look = Callable[[float, float], Frame]


def check_own(host: str) -> None:
    """Refuse an address beyond this computer (ValueError): an emulator has no business there."""
    if host != "localhost" and not ipaddress.ip_address(host).is_loopback:
        raise ValueError(f"expected an address of this computer, got {host}")


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens at a TCP port (0: any that is free); or say which, and raise."""
    try:
        return socket.create_server((host, port))
    except OSError as error:
        raise OSError(
            f"cannot listen at {host}:{port} ({error.strerror}); "
            "is another emulator running there? Choose another port, or 0 for any that is free"
        ) from error


def free_udp_port() -> int:
    """Return a UDP port of this computer at which nobody listens now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        return int(udp.getsockname()[1])


class EmulatedCamera(ABC):
    """Sends what `look` sees, in a thread of its own, until the end of the `with` block.

    `look` is called with begin and end of an exposure (`time.monotonic`), after its end.
    """

    _socket: socket.socket

    def __init__(self, look: Look, host: str, rate_hz: float, exposure_s: float) -> None:
        check_own(host)
        if not (rate_hz > 0 and 0 <= exposure_s <= 1 / rate_hz):
            raise ValueError(
                "expected a positive rate and an exposure within its period, got "
                f"{rate_hz} Hz and {exposure_s} s"
            )
        self.sent = 0
        self._look = look
        self._period_s = 1.0 / rate_hz
        self._exposure_s = exposure_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    @abstractmethod
    def _run(self) -> None:
        """Send until it is to stop."""
