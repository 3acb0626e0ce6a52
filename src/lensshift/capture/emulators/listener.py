"""The port at which an emulated device waits."""

from __future__ import annotations

import ipaddress
import socket


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
