"""PCIC, the protocol of ifm's O3D, O3X and O3R cameras: messages, chunks, images. No sockets."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.errors import DataError
from lensshift.core.units import MILLIMETRE_M

MAX_MESSAGE_BYTES = 4 << 20  # an O3R result with everything is a tenth of it
RESULT_TICKET = b"0000"

_HEAD = re.compile(rb"(\d{4})L(\d{9})\r\n")
_HEAD_BYTES = 16  # of `_HEAD`
_TICKET_BYTES = 4  # repeated before the content
_CHUNK = struct.Struct("<9I")
_CHUNK_TIME = struct.Struct("<3I")  # from header version 2 on
_METADATA_AT = 48  # from header version 3 on
_INFO = struct.Struct("<I2f3f6fI32fI32f")
_SCALARS = ("<u1", "<i1", "<u2", "<i2", "<u4", "<i4", "<f4", "<u8", "<f8")
_FORMATS = dict(enumerate(map(np.dtype, _SCALARS))) | {10: np.dtype(("<f4", (3,)))}
_INVALID = 1  # bit of the confidence
_STEEPEST = 1e3  # tangent of 89.94 degrees: no pixel of a lens looks farther aside
_BOUGUET = 0  # number of the model of `bouguet_directions` in an O3R's information


class ChunkKind(IntEnum):
    """What a chunk holds, of those that are read or sent here."""

    DISTANCE = 100
    NORMALISED_AMPLITUDE = 101
    AMPLITUDE = 103
    DISTANCE_NOISE = 105
    X = 200
    Y = 201
    Z = 202
    POINTS = 203
    UNIT_VECTORS = 223
    CONFIDENCE = 300
    DIAGNOSTIC = 302
    TOF_INFO = 420


_IMAGES: Mapping[int, str] = {
    kind: kind.name.lower()
    for kind in (
        ChunkKind.DISTANCE, ChunkKind.NORMALISED_AMPLITUDE, ChunkKind.AMPLITUDE,
        ChunkKind.DISTANCE_NOISE, ChunkKind.CONFIDENCE,
    )
}  # fmt: skip


class Message(NamedTuple):
    """An answer, or with ticket 0000 a result that nobody asked for."""

    ticket: bytes
    content: bytes


def write_message(ticket: bytes, content: bytes) -> bytes:
    """Return `<ticket>L<length>CRLF<ticket><content>CRLF`."""
    return b"%sL%09d\r\n%s%s\r\n" % (ticket, len(content) + 6, ticket, content)


class PcicParser:
    """Cuts the stream of bytes into messages; what is none, or too long, is skipped and counted."""

    def __init__(self, max_bytes: int = MAX_MESSAGE_BYTES) -> None:
        self.skipped_bytes = 0
        self.oversize = 0
        self._buffer = bytearray()
        self._max_bytes = max_bytes

    def feed(self, data: bytes | bytearray | memoryview) -> list[Message]:
        """Take bytes in; return the messages that are whole now."""
        buffer = self._buffer
        buffer += data
        messages = []
        at = 0
        while (head := _HEAD.search(buffer, at)) is not None:
            self.skipped_bytes += head.start() - at
            at = head.start()
            end = self._end(at)
            if end is None:
                at += 1
                self.skipped_bytes += 1
            elif end > len(buffer):
                break
            else:
                ticket = bytes(buffer[at : at + _TICKET_BYTES])
                content = bytes(buffer[at + _HEAD_BYTES + _TICKET_BYTES : end - 2])
                messages.append(Message(ticket, content))
                at = end
        else:
            kept = max(at, len(buffer) - _HEAD_BYTES + 1)
            self.skipped_bytes += kept - at
            at = kept
        del buffer[:at]
        return messages

    def begun(self) -> bytes:
        """Return the first bytes of a result that is under way, empty if there is none."""
        buffer = self._buffer
        if not (_HEAD.match(buffer) and buffer.startswith(RESULT_TICKET)):
            return b""
        at = _HEAD_BYTES + _TICKET_BYTES
        return bytes(buffer[at : at + 4 + _CHUNK.size])

    def _end(self, at: int) -> int | None:
        """Return where the message ends that may begin here, None if it is none."""
        buffer = self._buffer
        length = int(buffer[at + 5 : at + 14])
        if length > self._max_bytes:
            self.oversize += 1
            return None
        if length < _TICKET_BYTES + 2:
            return None
        body = at + _HEAD_BYTES
        ticket = buffer[at : at + _TICKET_BYTES]
        if not ticket.startswith(buffer[body : body + _TICKET_BYTES]):
            return None
        end = body + length
        if len(buffer) >= end and buffer[end - 2 : end] != b"\r\n":
            return None
        return end


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """One part of a result."""

    kind: int  # a `ChunkKind`, or a number that is not listed there
    shape: tuple[int, int]  # (rows, cols) as the header says; chunks without pixels say it too
    pixel_format: int  # number of the type of a pixel
    time_us: int  # time stamp, wraps at 2^32
    frame_count: int  # counter of the frames, wraps at 2^32
    time_s: float | None  # time of the camera's clock, None before header version 2
    metadata: Mapping[str, Any]  # from header version 3 on
    data: bytes  # everything after the header

    def image(self) -> Array:
        """Return the pixels [row col] or [row col 3]; DataError if there are none such."""
        if self.pixel_format not in _FORMATS:
            raise _of_chunk(self.kind, f"expected a known pixel format, got {self.pixel_format}")
        pixel = _FORMATS[self.pixel_format]
        count = self.shape[0] * self.shape[1]
        if not 0 < count * pixel.itemsize <= len(self.data):
            pixels = f"{self.shape[1]} x {self.shape[0]} pixels"
            raise _of_chunk(self.kind, f"{len(self.data)} bytes do not hold {pixels}")
        return np.frombuffer(self.data, pixel, count).reshape(self.shape + pixel.shape)


def _of_chunk(kind: int, problem: str) -> DataError:
    return DataError(problem, field=f"chunk {kind}")


def read_chunks(content: bytes) -> list[Chunk]:
    """Cut the content of a result, `star` to `stop`, into chunks, or raise a DataError."""
    if len(content) < 8 or not (content.startswith(b"star") and content.endswith(b"stop")):
        raise DataError(f"expected 'star' ... 'stop', got {content[:8]!r}", field="result")
    chunks = []
    at, end = 4, len(content) - 4
    while at < end:
        size = int.from_bytes(content[at + 4 : at + 8], "little")
        if not _CHUNK.size <= size <= end - at:
            raise DataError(
                f"expected a chunk of {_CHUNK.size} to {end - at} bytes, got {size}", field="result"
            )
        chunks.append(_read_chunk(content[at : at + size]))
        at += size
    return chunks


def _read_chunk(data: bytes) -> Chunk:
    kind, size, header, version, width, height, pixel, time_us, count = _CHUNK.unpack_from(data)
    if not _CHUNK.size <= header <= size:
        raise _of_chunk(kind, f"expected a header of {_CHUNK.size} to {size} bytes, got {header}")
    time_s = None
    if version >= 2 and header >= _METADATA_AT:
        _, seconds, nanoseconds = _CHUNK_TIME.unpack_from(data, _CHUNK.size)
        time_s = seconds + nanoseconds * 1e-9
    metadata = _metadata(data[_METADATA_AT:header]) if version >= 3 else {}
    return Chunk(kind, (height, width), pixel, time_us, count, time_s, metadata, data[header:])


def _metadata(text: bytes) -> Mapping[str, Any]:
    try:
        found = json.loads(text.rstrip(b"\0 ") or b"{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


@dataclass(frozen=True, slots=True)
class TofInfo:
    """What an O3R tells of itself with each frame."""

    version: int  # of this information
    distance_resolution_m: float  # value of one count
    amplitude_resolution: float
    amplitude_factors: tuple[float, ...]  # of the three exposures
    extrinsic: tuple[float, ...]  # place (x, y, z) in m and three angles in rad
    intrinsic_model: int
    intrinsic: tuple[float, ...]  # pixel to ray, by the model
    inverse_model: int
    inverse: tuple[float, ...]  # ray to pixel, by the model


def read_tof_info(chunk: Chunk) -> TofInfo:
    """Read the chunk TOF_INFO, without what versions above 1 add; DataError if it is too short."""
    if len(chunk.data) < _INFO.size:
        raise DataError(
            f"expected at least {_INFO.size} bytes, got {len(chunk.data)}", field="TOF_INFO"
        )
    v = _INFO.unpack_from(chunk.data)
    return TofInfo(v[0], v[1], v[2], v[3:6], v[6:12], v[12], v[13:45], v[45], v[46:78])


@dataclass(frozen=True, slots=True, eq=False)
class PcicImage:
    """One result as arrays; `raw`: as they came, by the name of their chunk."""

    amplitude: Floats  # [row col] normalised where the camera offers it
    distance_m: Floats | None  # [row col] radial, or None
    valid: Mask  # [row col] False where the confidence or a distance of zero says so
    frame_count: int  # as the camera counts, wraps at 2^32, as does `time_us`
    time_us: int
    time_s: float | None  # the camera's clock, or None
    info: TofInfo | None  # of an O3R, or None
    direction: Floats | None = None  # [row col 3] unit vectors (right, down, forward), or None
    raw: Mapping[str, Array] = field(default_factory=dict)


def read_result(content: bytes) -> PcicImage:
    """Read a result of an O3D (counts of mm) or O3R (of what it tells), or raise a DataError."""
    chunks = read_chunks(content)
    images = {one.kind: one for one in chunks if one.kind in _IMAGES}
    info = next((read_tof_info(one) for one in chunks if one.kind == ChunkKind.TOF_INFO), None)
    raw = {_IMAGES[kind]: one.image() for kind, one in images.items()}
    name = next((one for one in ("normalised_amplitude", "amplitude") if one in raw), None)
    if name is None:
        raise DataError(
            f"holds no amplitude, only chunks {[one.kind for one in chunks]}", field="result"
        )
    counts = raw[name]
    if counts.ndim != 2 or any(pixels.shape != counts.shape for pixels in raw.values()):
        raise DataError(
            f"images differ in size: {[pixels.shape for pixels in raw.values()]}", field="result"
        )
    with np.errstate(invalid="ignore", over="ignore"):  # numbers that are not finite
        amplitude = counts.astype(np.float64)
        if info is not None and counts.dtype.kind == "u":
            amplitude *= info.amplitude_resolution
        valid = np.isfinite(amplitude)
        if "confidence" in raw:
            if raw["confidence"].dtype.kind not in "ui":
                got = raw["confidence"].dtype
                raise DataError(f"expected whole numbers, got {got}", field="confidence")
            valid &= (raw["confidence"] & _INVALID) == 0
        distance_m = None
        if "distance" in raw:
            distance_m = _distance_m(images[ChunkKind.DISTANCE], raw["distance"], info)
            valid &= np.isfinite(distance_m) & (distance_m > 0)
    first = chunks[0]
    sent = next((one.image() for one in chunks if one.kind == ChunkKind.UNIT_VECTORS), None)
    direction = _sent_directions(sent, amplitude.shape)
    if sent is None and info is not None and info.intrinsic_model == _BOUGUET:
        direction = bouguet_directions(info.intrinsic, amplitude.shape)
    return PcicImage(
        amplitude, distance_m, valid, first.frame_count, first.time_us, first.time_s, info,
        direction, raw,
    )  # fmt: skip


def _distance_m(chunk: Chunk, counts: Array, info: TofInfo | None) -> Floats:
    """Return metres: floats are metres, counts have the resolution told, else millimetres."""
    if counts.dtype.kind == "f":
        return counts.astype(np.float64)
    told = chunk.metadata.get("DistanceResolution")
    if isinstance(told, float):
        return counts * told
    return counts * (MILLIMETRE_M if info is None else info.distance_resolution_m)


def _sent_directions(vectors: Array | None, shape: tuple[int, ...]) -> Floats | None:
    """Return unit vectors [row col 3] as an O3D sends them if asked; None if they are not whole."""
    if vectors is None or vectors.shape != (*shape, 3):
        return None
    whole = np.isfinite(vectors).all() and vectors.any(axis=2).all()
    return vectors.astype(np.float64) if whole else None


def bouguet_directions(numbers: Sequence[float], shape: tuple[int, ...]) -> Floats | None:
    """Return the directions [row col 3] that an O3R's intrinsic numbers lead to.

        x = (col + 1/2 - mx) / fx - alpha y,  y = (row + 1/2 - my) / fy,  r^2 = x^2 + y^2
        right = x R + 2 k3 x y + k4 (r^2 + 2 x^2),  down = y R + k3 (r^2 + 2 y^2) + 2 k4 x y
        R = 1 + k1 r^2 + k2 r^4 + k5 r^6

    None where they are not numbers of a lens, as those of a camera without a calibration.

    numbers : fx, fy, mx, my, alpha, k1, k2, k3, k4, k5, and others that do not matter

    Source: ifm's public examples for the O3R, function `intrinsic_projection`.
    """
    fx, fy, mx, my, alpha, k1, k2, k3, k4, k5 = numbers[:10]
    if not np.isfinite(numbers[:10]).all() or not min(fx, fy) > 0:
        return None
    row, col = np.indices(shape)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers of no lens
        y = (row + 0.5 - my) / fy
        x = (col + 0.5 - mx) / fx - alpha * y
        square, across = x * x + y * y, 2.0 * x * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k5))
        right = x * radial + k3 * across + k4 * (square + 2.0 * x * x)
        down = y * radial + k3 * (square + 2.0 * y * y) + k4 * across
        vectors = np.stack([right, down, np.ones_like(right)], axis=-1)
        if not np.all(np.abs(vectors) < _STEEPEST):  # also if it is no number
            return None
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
