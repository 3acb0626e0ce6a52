"""An ifm O3D or O3R that is not there: a PCIC server on this computer, results by a schema."""

from __future__ import annotations

import json
import math
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from typing import Any

import numpy as np

from lensshift.capture.drivers.pcic_protocol import RESULT_TICKET, PcicParser, write_message
from lensshift.capture.emulators.listener import EmulatedCamera, Look, listen
from lensshift.core.arrays import Array, Floats
from lensshift.core.types import Frame

MODELS = ("O3D", "O3R")
_DISTANCE_STEP_M = {"O3D": 1e-3, "O3R": 1.5259e-4}
_AMPLITUDE_STEP = {"O3D": 1e-3, "O3R": 1e-4}  # an O3D does not tell it: clients see counts
_HALF_FIELD_RAD = math.radians(6.5)  # sideways
_PIXELS = {"u1": 0, "u2": 2, "i2": 3, "u4": 4, "f4": 6}  # formats; 10 are three f4 for each
_LONGEST_SCHEMA = 256  # elements
_LONGEST_COMMAND = 1 << 16  # a schema has a few thousand bytes
_SEND_S = 2.0  # a client that takes nothing for so long is dropped


def _counts(frame: Frame, model: str, *, of: str, steps: Mapping[str, float]) -> Array:
    values = getattr(frame, of)
    known = np.zeros(frame.amplitude.shape) if values is None else values
    counts = np.rint(np.where(frame.valid, known, 0.0) / steps[model])
    return np.clip(counts, 0, 65535).astype("<u2")


_distance = partial(_counts, of="distance_m", steps=_DISTANCE_STEP_M)
_amplitude = partial(_counts, of="amplitude", steps=_AMPLITUDE_STEP)


def _confidence(frame: Frame, model: str) -> Array:
    return (~frame.valid).astype("<u1")


def _coordinate(frame: Frame, model: str, *, axis: int) -> Array:
    """Return x right, y down or z forward, in mm."""
    shape = frame.amplitude.shape
    seen_m = np.zeros(shape) if frame.distance_m is None else frame.distance_m
    along = directions(shape)[..., axis] * np.where(frame.valid, seen_m, 0)
    return np.rint(1e3 * along).astype("<i2")


def _calibration(frame: Frame, model: str) -> Array:
    return np.array([_intrinsic(frame.amplitude.shape)], dtype="<f4")


def _diagnostic(frame: Frame, model: str) -> Array:
    """Temperatures in 0.1 degrees (illumination, two of the front end, evaluation), frame time."""
    return np.array([[450, 420, 420, 400, 100]], dtype="<u4")


def _json_diagnostic(frame: Frame, model: str) -> Array:
    text = json.dumps({"AcquisitionDuration": 5.0, "EvaluationDuration": 2.0, "FrameRate": 10.0})
    return np.frombuffer(text.encode(), dtype="<u1")[None]


def _tof_info(frame: Frame, model: str) -> Array:
    lens = _intrinsic(frame.amplitude.shape)
    info = struct.pack(
        "<I2f3f6fI32fI32f",
        1, _DISTANCE_STEP_M[model], _AMPLITUDE_STEP[model], *[0.0] * 9,
        0, *lens, *[0.0] * (32 - len(lens)), 0, *[0.0] * 32,
    )  # fmt: skip
    return np.frombuffer(info, dtype="<u1")[None]


@cache
def directions(shape: tuple[int, ...]) -> Floats:
    """Return unit vectors [row col 3] of a pinhole: x right, y down, z forward."""
    fx, fy, mx, my = _intrinsic(shape)[:4]
    row, col = np.indices(shape)
    vectors = np.stack([(col + 0.5 - mx) / fx, (row + 0.5 - my) / fy, np.ones(shape)], axis=-1)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _intrinsic(shape: tuple[int, ...]) -> list[float]:
    """Return fx, fy, mx, my of a pinhole with square pixels, and 12 numbers that bend nothing."""
    focal_px = 0.5 * shape[1] / math.tan(_HALF_FIELD_RAD)
    return [focal_px, focal_px, 0.5 * shape[1], 0.5 * shape[0], *[0.0] * 12]


# Part of a schema -> number of its chunk, and what is in it.
BLOBS: Mapping[str, tuple[int, Callable[[Frame, str], Array]]] = {
    "distance_image": (100, _distance),
    "normalized_amplitude_image": (101, _amplitude),
    "amplitude_image": (103, _amplitude),
    "x_image": (200, partial(_coordinate, axis=0)),
    "y_image": (201, partial(_coordinate, axis=1)),
    "z_image": (202, partial(_coordinate, axis=2)),
    "confidence_image": (300, _confidence),
    "all_unit_vector_matrices": (
        223,
        lambda frame, _: directions(frame.amplitude.shape).astype("<f4"),
    ),
    "extrinsic_calibration": (400, lambda *_: np.zeros((1, 6), dtype="<f4")),
    "intrinsic_calibration": (401, _calibration),
    "inverse_intrinsic_calibration": (402, _calibration),
    "diagnostic_data": (302, _diagnostic),
    "diagnostic": (302, _diagnostic),
    "json_diagnostic": (305, _json_diagnostic),
    "RADIAL_DISTANCE_COMPRESSED": (100, _distance),
    "AMPLITUDE_COMPRESSED": (101, _amplitude),
    "CONFIDENCE": (300, _confidence),
    "TOF_INFO": (420, _tof_info),
}
DEFAULT: Mapping[str, tuple[str, ...]] = {
    "O3D": ("distance_image", "normalized_amplitude_image", "confidence_image"),
    "O3R": ("RADIAL_DISTANCE_COMPRESSED", "AMPLITUDE_COMPRESSED", "CONFIDENCE", "TOF_INFO"),
}


def schema_text(model: str) -> bytes:
    """Return the schema of a camera that nobody has asked for anything else."""
    blobs = [{"type": "blob", "id": name} for name in DEFAULT[model]]
    ends = [{"type": "string", "id": f"{one}_string", "value": word}
            for one, word in (("start", "star"), ("end", "stop"))]  # fmt: skip
    content = {"layouter": "flexible", "format": {"dataencoding": "ascii"},
               "elements": [ends[0], *blobs, ends[1]]}  # fmt: skip
    return json.dumps(content).encode()


def wanted_by(schema: bytes, model: str) -> tuple[str | bytes, ...]:
    """Return the blobs and bytes that a schema asks for; ValueError if the camera lacks one."""
    try:
        content = json.loads(schema)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(content, dict) or content.get("layouter", "flexible") != "flexible":
        raise ValueError("expected an object with a flexible layouter")
    if "elements" not in content:
        return (b"star", *DEFAULT[model], b"stop")
    elements = content["elements"]
    if not isinstance(elements, list) or len(elements) > _LONGEST_SCHEMA:
        raise ValueError("expected a list of elements")
    return tuple(_part(one) for one in elements)


def _part(element: Any) -> str | bytes:
    kind, name = (
        (element.get(one) for one in ("type", "id")) if isinstance(element, dict) else (0, 0)
    )
    value = element.get("value") if kind == "string" else None
    if isinstance(value, str):
        return value.encode()
    if kind != "blob" or name not in BLOBS:
        raise ValueError(f"cannot send {name!r:.60}")
    return str(name)


def result_content(
    frame: Frame,
    *,
    model: str = "O3D",  # "O3D" (header version 1, mm) or "O3R" (version 2, with TOF_INFO)
    count: int = 0,  # frame count
    time_s: float = 0.0,  # the camera's clock
    wanted: Sequence[str | bytes] | None = None,  # see `wanted_by`; None: what it sends unasked
) -> bytes:
    """Write a frame as a result, `star` to `stop` unless the schema has it otherwise."""
    out: list[bytes] = []
    unasked: tuple[str | bytes, ...] = (b"star", *DEFAULT[model], b"stop")
    for part in unasked if wanted is None else wanted:
        if isinstance(part, bytes):
            out.append(part)
            continue
        kind, look = BLOBS[part]
        out.append(_chunk(kind, look(frame, model), count, time_s, 1 if model == "O3D" else 2))
    return b"".join(out)


def _chunk(kind: int, pixels: Array, count: int, time_s: float, version: int) -> bytes:
    size, whole_s, data = 36 if version == 1 else 48, int(time_s), pixels.tobytes()
    rows, cols = pixels.shape[:2]
    pixel = 10 if pixels.ndim == 3 else _PIXELS[pixels.dtype.str[1:]]
    header = struct.pack(
        "<9I",
        kind, size + len(data), size, version, cols, rows, pixel,
        int(time_s * 1e6) % 2**32, count % 2**32,
    )  # fmt: skip
    if version > 1:
        header += struct.pack("<3I", 0, whole_s % 2**32, int((time_s - whole_s) * 1e9))
    return header + data


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
