"""Why no frame comes: what the counters of camera and computer say, and where it sends to."""

from __future__ import annotations

import errno
import os
import selectors
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, suppress
from itertools import chain, islice
from pathlib import Path

from lensshift.capture.drivers.o3m_packets import MAX_PACKET_BYTES, read_header
from lensshift.capture.rig import Camera
from lensshift.core.errors import DeviceError
from lensshift.pipeline.doctor.findings import Finding, Level, cause_number

_USUAL = (42000, 50010, 10000)  # ports that are looked at first
_AT_ONCE = 500  # sockets; systems allow a program about 1000 files
_LISTEN_S = 0.15  # to each: six frames at 50 Hz, three at 25
_COUNT_S = 0.5  # of listening for the rate


def camera_fault(
    error: DeviceError, camera: Camera | None, port: int | None, say: Callable[[str], None]
) -> Finding:
    """Return the finding behind an error of the camera, if open; `say` what takes a while."""
    said, number = str(error), cause_number(error)
    if number == errno.EADDRINUSE:
        who = f" ({holder})" if port is not None and (holder := holder_of_udp(port)) else ""
        return Finding(Level.FAULT, "second process", said + who, "end it, or use another port")
    if number in (errno.EACCES, errno.EPERM):
        return Finding(Level.FAULT, "no permission", said, "choose a port above 1023")
    counts = {} if camera is None else camera.counts()
    if counts.get("wrong_size_or_version"):
        cure = "send a recording of it (pcap) to the developers; look for other firmware"
        return Finding(Level.FAULT, "other layout", said, cure)
    if counts.get("lost_packets") or counts.get("partial_cycles"):
        return Finding(Level.FAULT, "losses", said, "direct cable; net.core.rmem_max=4194304")
    if counts.get("foreign_packets") or counts.get("other_cameras_packets"):
        cure = "send the camera's data to this port, the other sender's elsewhere"
        return Finding(Level.FAULT, "foreign sender", said, cure)
    if port is not None and not counts.get("packets"):
        say("looking for the port that the camera sends to (half a minute at most)")
        return _silent(said, port)
    return Finding(Level.FAULT, "camera", said)


def _silent(said: str, port: int) -> Finding:
    """Tell a camera that sends to another port from one that is not heard at all."""
    unheard = datagrams_unheard(_COUNT_S)
    if unheard != 0:  # or nobody counts them
        near = range(max(port - 200, 1), min(port + 201, 65536))
        for other in sending_ports(chain(_USUAL, near, range(1024, 65536)), port):
            found = f"data come to UDP port {other}, the rig file says {port}"
            return Finding(Level.FAULT, "wrong port", found, f"write port = {other} in [camera]")
    return Finding(Level.FAULT, "camera silent", said, f"links: {links() or 'no cable is live'}")


def datagrams_unheard(seconds: float) -> int | None:
    """Return how many UDP datagrams came meanwhile for nobody; None where Linux does not tell."""
    before = _no_ports()
    if before is None:
        return None
    time.sleep(seconds)
    after = _no_ports()
    return None if after is None else after - before


def _no_ports() -> int | None:
    with suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/net/snmp").read_text(encoding="ascii").splitlines()
        names, values = (one.split() for one in lines if one.startswith("Udp:"))
        return int(values[names.index("NoPorts")])
    return None


def sending_ports(ports: Iterable[int], besides: int) -> Iterator[int]:
    """Yield the ports at which an O3M's packets arrive; listens at many at once."""
    wanted = iter(dict.fromkeys(port for port in ports if port != besides))
    while some := list(islice(wanted, _AT_ONCE)):
        with ExitStack() as opened, selectors.DefaultSelector() as selector:
            listening = {}
            for port in some:
                udp = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                with suppress(OSError):  # somebody else's
                    udp.bind(("", port))
                    listening[selector.register(udp, selectors.EVENT_READ).fd] = port, udp
            heard: set[int] = set()
            end_s = time.monotonic() + _LISTEN_S
            while not heard and time.monotonic() < end_s:
                for key, _ in selector.select(max(end_s - time.monotonic(), 0.0)):
                    port, udp = listening[key.fd]
                    if read_header(udp.recv(MAX_PACKET_BYTES)) is not None:
                        heard.add(port)
            yield from sorted(heard)


def holder_of_udp(port: int) -> str:
    """Return the name of the program that has a UDP port, empty if nobody may know."""
    nodes = set()
    with suppress(OSError, IndexError, ValueError):
        for line in Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            if int(fields[1].rpartition(":")[2], 16) == port:
                nodes.add(f"socket:[{fields[9]}]")
    return _holder(nodes)


def holder_of_file(path: str) -> str:
    """Return the name of another program that has a file or device open, empty if unknown."""
    return _holder({os.path.realpath(path)})


def _holder(names: set[str]) -> str:
    """Return who has one of these open, by the open files that Linux lists."""
    for folder in Path("/proc").glob("[0-9]*/fd"):
        with suppress(OSError):
            for one in folder.iterdir():
                if str(one.readlink()) in names and folder.parent.name != str(os.getpid()):
                    name = (folder.parent / "comm").read_text(encoding="utf-8").strip()
                    return f"{name}, process {folder.parent.name}"
    return ""


def links() -> str:
    """Return the network cards of this computer whose cable is live; empty if not known."""
    live = []
    for card in sorted(Path("/sys/class/net").glob("*")):
        with suppress(OSError):
            if card.name != "lo" and (card / "carrier").read_text(encoding="ascii").strip() == "1":
                live.append(card.name)
    return ", ".join(live)
