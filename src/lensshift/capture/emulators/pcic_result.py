"""What an emulated ifm O3D or O3R sends: results by a schema, chunk by chunk."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.core.types import Frame

MODELS = ("O3D", "O3R")
_DISTANCE_STEP_M = {"O3D": 1e-3, "O3R": 1.5259e-4}
_AMPLITUDE_STEP = {"O3D": 1e-3, "O3R": 1e-4}  # an O3D does not tell it: clients see counts
_HALF_FIELD_RAD = math.radians(6.5)  # sideways
_U1, _U2, _I2, _F4, _F4_3 = 0, 2, 3, 6, 10  # pixel formats
_LONGEST_SCHEMA = 256  # elements


class _Blob(NamedTuple):
    """One part of a result: number of its chunk, pixel format, what is in it."""

    kind: int
    pixel: int
    data: Array


class Seen(NamedTuple):
    """A frame, and the camera that sees it."""

    frame: Frame
    model: str


def _counts(seen: Seen, values: Array | None, step: float) -> Array:
    known = np.zeros(seen.frame.amplitude.shape) if values is None else values
    return np.clip(np.rint(np.where(seen.frame.valid, known, 0.0) / step), 0, 65535).astype("<u2")


def _distance(seen: Seen) -> _Blob:
    return _Blob(100, _U2, _counts(seen, seen.frame.distance_m, _DISTANCE_STEP_M[seen.model]))


def _amplitude(kind: int) -> Callable[[Seen], _Blob]:
    def blob(seen: Seen) -> _Blob:
        counts = _counts(seen, seen.frame.amplitude, _AMPLITUDE_STEP[seen.model])
        return _Blob(kind, _U2, counts)

    return blob


def _confidence(seen: Seen) -> _Blob:
    return _Blob(300, _U1, (~seen.frame.valid).astype("<u1"))


def _coordinate(axis: int) -> Callable[[Seen], _Blob]:
    """Return x right, y down or z forward, in mm."""

    def blob(seen: Seen) -> _Blob:
        frame = seen.frame
        distance_m = (
            np.zeros(frame.amplitude.shape) if frame.distance_m is None else frame.distance_m
        )
        along = directions(frame.amplitude.shape)[..., axis] * np.where(frame.valid, distance_m, 0)
        return _Blob(200 + axis, _I2, np.rint(1e3 * along).astype("<i2"))

    return blob


def _numbers(kind: int, numbers: Callable[[tuple[int, ...]], Sequence[float]]) -> Any:
    def blob(seen: Seen) -> _Blob:
        return _Blob(kind, _F4, np.asarray([numbers(seen.frame.amplitude.shape)], dtype="<f4"))

    return blob


def _diagnostic(seen: Seen) -> _Blob:
    """Temperatures in 0.1 degrees (illumination, two of the front end, evaluation), frame time."""
    return _Blob(302, 4, np.array([[450, 420, 420, 400, 100]], dtype="<u4"))


def _json_diagnostic(seen: Seen) -> _Blob:
    text = json.dumps({"AcquisitionDuration": 5.0, "EvaluationDuration": 2.0, "FrameRate": 10.0})
    return _Blob(305, _U1, np.frombuffer(text.encode(), dtype="<u1")[None])


def _tof_info(seen: Seen) -> _Blob:
    lens = _intrinsic(seen.frame.amplitude.shape)
    info = struct.pack(
        "<I2f3f6fI32fI32f",
        1, _DISTANCE_STEP_M[seen.model], _AMPLITUDE_STEP[seen.model], *[0.0] * 9,
        0, *lens, *[0.0] * (32 - len(lens)), 0, *[0.0] * 32,
    )  # fmt: skip
    return _Blob(420, _U1, np.frombuffer(info, dtype="<u1")[None])


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


BLOBS: Mapping[str, Callable[[Seen], _Blob]] = {
    "distance_image": _distance,
    "normalized_amplitude_image": _amplitude(101),
    "amplitude_image": _amplitude(103),
    "x_image": _coordinate(0),
    "y_image": _coordinate(1),
    "z_image": _coordinate(2),
    "confidence_image": _confidence,
    "all_unit_vector_matrices": lambda seen: _Blob(
        223, _F4_3, directions(seen.frame.amplitude.shape).astype("<f4")
    ),
    "extrinsic_calibration": _numbers(400, lambda _: [0.0] * 6),
    "intrinsic_calibration": _numbers(401, _intrinsic),
    "inverse_intrinsic_calibration": _numbers(402, _intrinsic),
    "diagnostic_data": _diagnostic,
    "diagnostic": _diagnostic,
    "json_diagnostic": _json_diagnostic,
    "RADIAL_DISTANCE_COMPRESSED": _distance,
    "AMPLITUDE_COMPRESSED": _amplitude(101),
    "CONFIDENCE": _confidence,
    "TOF_INFO": _tof_info,
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
    """Return the parts that a schema asks for: names of blobs, and bytes to send as they are.

    Raises
    ------
    ValueError
        If it is no schema, or asks for what this camera does not have.
    """
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
    model: str = "O3D",
    count: int = 0,
    time_s: float = 0.0,
    wanted: Sequence[str | bytes] | None = None,
) -> bytes:
    """Write a frame as a result, `star` to `stop` unless the schema has it otherwise.

    Parameters
    ----------
    frame : what the camera sees
    model : "O3D" (header version 1, distance in mm) or "O3R" (version 2, with TOF_INFO)
    count : frame count
    time_s : the camera's clock
    wanted : see `wanted_by`; what the camera sends unasked if None
    """
    seen = Seen(frame, model)
    out: list[bytes] = []
    unasked: tuple[str | bytes, ...] = (b"star", *DEFAULT[model], b"stop")
    for part in unasked if wanted is None else wanted:
        if isinstance(part, bytes):
            out.append(part)
        else:
            out.append(_chunk(BLOBS[part](seen), count, time_s, 1 if model == "O3D" else 2))
    return b"".join(out)


def _chunk(blob: _Blob, count: int, time_s: float, version: int) -> bytes:
    size, whole_s, data = 36 if version == 1 else 48, int(time_s), blob.data.tobytes()
    rows, cols = blob.data.shape[:2]
    header = struct.pack(
        "<9I",
        blob.kind, size + len(data), size, version, cols, rows, blob.pixel,
        int(time_s * 1e6) % 2**32, count % 2**32,
    )  # fmt: skip
    if version > 1:
        header += struct.pack("<3I", 0, whole_s % 2**32, int((time_s - whole_s) * 1e9))
    return header + data
