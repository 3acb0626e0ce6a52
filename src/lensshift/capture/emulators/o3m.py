"""An ifm O3M that is not there: sends what it sees as the real one does, to this computer."""

from __future__ import annotations

import math
import socket
import struct
import threading
import time
from collections.abc import Mapping
from functools import cache

import numpy as np

from lensshift.capture.emulators.listener import EmulatedCamera, Look
from lensshift.core.arrays import Floats
from lensshift.core.types import Frame

ROWS, COLS = 16, 64  # of the only sensor there is
LAYOUTS = {"1.0": 18900, "1.1": 19036, "1.2": 19044, "1.3": 19224, "1.4": 19224}  # bytes
RUN_MODE = 0x22

PACKET_BYTES = 1460  # header and payload
# Sizes, names and versions as in ifm's own example parser; what the parameters hold at which place
# is not public knowledge, so theirs are zero.
_DIAGNOSIS = (b"O3M!DIK1\x01\x05\0\0", 360)
_PARAMETERS = (b"O3M!DID1\x01\x04\0\0", 6648)
_LONG_EXPOSURE, _HIGH_GAIN = 10.0, 4.0  # how much more a pixel reads
_FARTHEST_M = 150.0  # what two bytes of centimetres are defined for; farther is invalid
_FULL_COUNT = 60000  # above it a pixel takes the next weaker setting
_HALF_FIELD_RAD = (math.radians(1.6), math.radians(6.5))  # (row, col)
_CAMERA_M = (1.5, 0.2, 0.8)  # where it stands in the coordinates of the vehicle
_FIRST_CYCLE = 1000  # it has been running for a while
_DELAY_S = 0.002  # from the end of an exposure to the first packet


def packetise(
    channels: Mapping[int, bytes],  # channel -> message, in the order of sending
    cycle: int,
    first_packet: int,
    *,
    packet_bytes: int = PACKET_BYTES,  # longest packet, header and all
) -> list[bytes]:
    """Cut the messages of one cycle into packets as the camera does; its counters wrap at 2^32."""
    room = packet_bytes - 32
    cut: list[tuple[int, int, list[bytes]]] = []
    for channel, message in channels.items():
        whole = struct.pack("<I24x", 0xFFFFFFFF) + message
        chunks = [whole[at : at + room] for at in range(0, len(whole), room)]
        if len(chunks[-1]) + 4 > room:  # the end delimiter is never torn apart
            chunks.append(b"")
        chunks[-1] += struct.pack("<I", 0xAAAAAAAA)
        cut.append((channel, len(message) + 32, chunks))
    total = sum(len(chunks) for _, _, chunks in cut)
    packets: list[bytes] = []
    for channel, length, chunks in cut:
        for index, chunk in enumerate(chunks):
            number = len(packets)
            counters = (first_packet + number) % 2**32, cycle % 2**32
            place = total, number, len(chunks), index, channel, length, len(chunk)
            packets.append(struct.pack("<HHIIHHHHIII", 1, 1, *counters, *place) + chunk)
    return packets


def pixel_message(
    frame: Frame, *, layout: str = "1.4", full_scale: float = 4.0, timestamp_us: int = 0
) -> bytes:
    """Write a frame of 64 x 16 pixels as the camera's pixel data, in one of `LAYOUTS`.

    Each pixel takes the most sensitive of four settings (exposure 1 or 10, gain 1 or 4) that does
    not saturate it, and says so in its confidence; the factors that undo it stand beside. The
    weakest can just read an amplitude of `full_scale`.
    """
    if frame.amplitude.shape != (ROWS, COLS):
        raise ValueError(f"expected a frame of shape ({ROWS}, {COLS}), got {frame.amplitude.shape}")
    seen_m = np.zeros((ROWS, COLS)) if frame.distance_m is None else frame.distance_m
    told = np.isfinite(seen_m) & (seen_m <= _FARTHEST_M)
    valid = frame.valid & told
    amplitude = np.where(valid, np.nan_to_num(frame.amplitude, nan=0.0), 0.0)
    sensitivity = np.array([1.0, _LONG_EXPOSURE, _HIGH_GAIN, _LONG_EXPOSURE * _HIGH_GAIN])
    factors = (full_scale / _FULL_COUNT / sensitivity).astype("<f4")
    setting = np.zeros((ROWS, COLS), dtype=np.uint16)
    for choice in (2, 1, 3):  # from weak to sensitive
        setting[amplitude <= _FULL_COUNT * factors[choice]] = choice
    counts = np.clip(np.rint(amplitude / factors[setting]), 0, 65535)
    confidence = (setting << 1) | ~valid
    distance_m = np.where(valid, seen_m, 0.01)  # invalid: 1 cm
    coarse_cm = np.maximum(np.rint(distance_m * 100.0), 0)
    place_m = np.asarray(_CAMERA_M)[:, None, None] + _directions() * distance_m
    pixels = (coarse_cm, "<u2"), (place_m, "<f4"), (confidence, "<u2"), (counts, "<u2")
    body = struct.pack("<HH", COLS, ROWS)
    body += b"".join(values.astype(kind).tobytes() for values, kind in pixels) + factors.tobytes()
    body += struct.pack("<III6f", timestamp_us % 2**32, 0, 0, *_CAMERA_M, 0.0, 0.0, 0.0)
    body += _directions()[:, [0, 0, -1, -1], [0, -1, 0, -1]].T.astype("<f4").tobytes()
    major, minor = (int(part) for part in layout.split("."))
    magic = b"" if layout == "1.0" else b"O3M!DIA1" + bytes([major, minor, 0, 0])
    return (magic + body).ljust(LAYOUTS[layout], b"\0")


@cache
def _directions() -> Floats:
    """Return unit vectors [3 row col]: x forward, y left, z up; row 0 is the top."""
    up = np.tan(_HALF_FIELD_RAD[0]) * np.linspace(1, -1, ROWS)[:, None]
    left = np.tan(_HALF_FIELD_RAD[1]) * np.linspace(1, -1, COLS)[None, :]
    forward = np.ones((ROWS, COLS))
    vector = np.stack([forward, np.broadcast_to(left, forward.shape), up * forward])
    return np.asarray(vector / np.linalg.norm(vector, axis=0))


def diagnosis_message(mode: int) -> bytes:
    """Write the diagnosis, temperatures of 41.5 and 48.25 degrees; it alone is big-endian."""
    magic, size = _DIAGNOSIS
    return struct.pack(">12sf132xfB", magic, 41.5, 48.25, mode).ljust(size, b"\0")


def parameter_message() -> bytes:
    """Write the parameters: a whole message that says nothing."""
    magic, size = _PARAMETERS
    return magic.ljust(size, b"\0")


class O3MSender(EmulatedCamera):
    """Sends what `look` sees, cycle by cycle; a context manager with a thread."""

    def __init__(
        self,
        look: Look,
        *,
        port: int,  # UDP port of the receiver
        rate_hz: float = 25.0,  # cycles a second
        host: str = "127.0.0.1",  # of the receiver
        layout: str = "1.4",  # of the pixel data, "1.0" to "1.4"
        loss: float = 0.0,  # probability that a packet gets lost
        reorder: float = 0.0,  # changes places with the next
        duplicate: float = 0.0,  # comes twice
        exposure_s: float = 0.005,  # length of an exposure
        full_scale: float = 4.0,  # amplitude that saturates the weakest setting
        seed: int = 0,  # of the faults
    ) -> None:
        super().__init__(look, host, rate_hz, exposure_s)
        if not 0 < port <= 65535:
            raise ValueError(f"expected the UDP port of the receiver, got {port}")
        self.frames_dropped = 0
        self._target = (host, port)
        self._faults = (loss, reorder, duplicate)
        self._full_scale = full_scale
        self._rng = np.random.default_rng(seed)
        self._paused = False
        self._cycle = _FIRST_CYCLE
        self._packet = _FIRST_CYCLE * 15
        self._lock = threading.Lock()
        self.set_layout(layout)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))

    @property
    def address(self) -> tuple[str, int]:
        """Address that the packets come from."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    def pause(self) -> None:
        """Fall silent; the cycles go on."""
        self._paused = True

    def resume(self) -> None:
        """Send again."""
        self._paused = False

    def reboot(self) -> None:
        """Begin to count anew, as after a loss of power."""
        with self._lock:
            self._cycle = 0
            self._packet = 0

    def set_layout(self, layout: str) -> None:
        """Send another layout from now on."""
        if layout not in LAYOUTS:
            raise ValueError(f"expected a layout of {', '.join(LAYOUTS)}, got {layout!r}")
        self._layout = layout

    def _run(self) -> None:
        begin_s = time.monotonic()
        told_s = -math.inf
        while self._wait(begin_s + self._exposure_s):
            end_s = begin_s + self._exposure_s
            pixels = pixel_message(
                self._look(begin_s, end_s), layout=self._layout, full_scale=self._full_scale,
                timestamp_us=int(begin_s * 1e6),
            )  # fmt: skip
            channels = {8: pixels}
            if end_s - told_s >= 1.0:
                told_s = end_s
                channels[256] = diagnosis_message(RUN_MODE)
                channels[14] = parameter_message()
            self._wait(end_s + _DELAY_S)
            self._send(channels)
            begin_s = self._next_begin_s(begin_s)

    def _next_begin_s(self, begin_s: float) -> float:
        """Return when the next exposure begins; drop those that have passed unseen."""
        late_s = time.monotonic() - (begin_s + self._period_s + self._exposure_s)
        missed = max(0, math.floor(late_s / self._period_s))
        self.frames_dropped += missed
        with self._lock:
            self._cycle += 1 + missed
        return begin_s + (1 + missed) * self._period_s

    def _wait(self, until_s: float) -> bool:
        """Wait for an instant; return False if all is over."""
        return not self._stop.wait(max(0.0, until_s - time.monotonic()))

    def _send(self, channels: Mapping[int, bytes]) -> None:
        with self._lock:
            packets = packetise(channels, self._cycle, self._packet)
            self._packet += len(packets)
        if self._paused or not packets:
            return
        damaged = _with_faults(packets, self._faults, self._rng)
        for packet in damaged:
            self._socket.sendto(packet, self._target)
        self.sent += 8 in channels and set(packets) <= set(damaged)


def _with_faults(
    packets: list[bytes], faults: tuple[float, float, float], rng: np.random.Generator
) -> list[bytes]:
    """Lose, double and swap packets by chance."""
    loss, reorder, duplicate = faults
    if not any(faults):
        return packets
    chance = rng.random((3, len(packets)))
    out: list[bytes] = []
    for index, packet in enumerate(packets):
        if chance[0, index] >= loss:
            out += [packet, packet] if chance[1, index] < duplicate else [packet]
    for index in range(len(out) - 1):
        if chance[2, index % len(packets)] < reorder:
            out[index], out[index + 1] = out[index + 1], out[index]
    return out
