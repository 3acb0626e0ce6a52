"""Run the page: a socket, a token, a server until somebody ends it."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lensshift.core.errors import of_extra
from lensshift.live.server import make_app
from lensshift.live.worker import Live


def is_loopback(host: str) -> bool:
    """Tell whether nobody beyond this computer can reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens; OSError if the port is taken or the host is not our own."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        problem = f"cannot listen at {host}, port {port}: {error.strerror or error}"
        raise OSError(f"{problem}; --port 0 takes a free one") from error


def serve(
    live: Live,
    listener: socket.socket,
    folder: Path,  # for recordings and snapshots
    *,
    seconds: float | None = None,
    debug: bool = False,  # whether the log of the server is shown
    on_ready: Callable[[str], None],  # called with the address to open, once it answers
    # Called with what ends the server, for who serves in another thread.
    on_start: Callable[[Callable[[], None]], None] | None = None,
) -> None:
    """Serve until Ctrl-C (KeyboardInterrupt, when it has ended), SIGTERM or so many seconds."""
    import uvicorn

    token = secrets.token_urlsafe(16)
    # Pictures are not compressed on this computer, and a browser that stands still may stay.
    config = uvicorn.Config(
        make_app(live, token, folder),
        log_level="info" if debug else "critical",  # a request cut off by the end is no error
        access_log=False,
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )

    class _Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            on_ready(f"http://{_named(listener)}/{token}/")
            if seconds is not None:
                asyncio.get_running_loop().call_later(seconds, end)

    server = _Server(config)

    def end() -> None:
        server.should_exit = True

    if on_start is not None:
        on_start(end)
    with listener:
        server.run([listener])


def require_web() -> None:
    """Raise an ImportError with what to install if the extra `live` is not."""
    for name in ("starlette", "uvicorn", "websockets"):
        of_extra(name, "the live page needs a web server: python -m pip install 'lensshift[live]'")


def _named(listener: socket.socket) -> str:
    name: Any = listener.getsockname()
    host, port = name[0], name[1]
    if ipaddress.ip_address(host).is_unspecified:
        host = socket.gethostname()
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
