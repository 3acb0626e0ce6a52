"""A capture as it grows: a journal of frames that survives a kill at any moment.

    file   = record, record, ...      the first one is the header
    record = "LSCAPTR1" | length of the payload, u64 | CRC-32 of the payload, u32 | payload
    header = JSON, frame = NPZ, both little-endian

A record counts once its checksum fits, so a writer that dies loses the record that it was
writing and nothing else. When a capture is complete, a burst file takes the journal's place.
`docs/decisions/0013-capture-journal.md` says why this is no HDF5.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import MISSING, dataclass, field, fields
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.atomic import GrowingFile, writable_target, writing
from lensshift.core.errors import DataError, naming
from lensshift.core.settings import parse_json
from lensshift.core.types import FRAME_FIELDS, Burst
from lensshift.io.container_writer import check_storable, to_json
from lensshift.io.reading import reading, require_file, unpacked_bytes

_MARK = b"LSCAPTR1"
_HEAD = struct.Struct("<8sQI")
_LARGEST = 1 << 31  # bytes of a record: more is damage
_SCHEMA = "lensshift-capture/1"
_RAW = "raw_"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FrameRecord:
    """One frame of a journal; `raw` is what the camera sent, with `cycle`, its counter."""

    step: int = 0  # place on the plan
    amplitude: Array  # [row col], as `valid` and `distance_m`
    valid: Array
    offset_px: Array  # [2] where the image lies
    time_s: float  # by the clock of the camera, or the host's
    distance_m: Array | None = None
    offset_sigma_px: Array | None = None
    stage_mm: Array | None = None  # [2] where the stage stood
    stage_commanded_mm: Array | None = None  # [2] and should have stood
    arrived_s: float = 0.0  # by the clock of the host
    raw: Mapping[str, Array] = field(default_factory=dict)

    def arrays(self) -> dict[str, Array]:
        """Return the fields that are known, by their names in the file."""
        own = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "raw"}
        named = {name: np.asarray(value) for name, value in own.items() if value is not None}
        return named | {f"{_RAW}{name}": np.asarray(value) for name, value in self.raw.items()}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array]) -> Self:
        """Return the record in arrays that `arrays` made; DataError if a field is wrong."""
        values: dict[str, Any] = {}
        for one in fields(cls):
            if one.name in arrays:
                found = arrays[one.name]
                number = one.type in ("int", "float")
                if number and (found.ndim or found.dtype.kind not in "iuf"):
                    raise DataError("expected a number", field=one.name)
                values[one.name] = found.item() if number else found
            elif one.default is MISSING and one.default_factory is MISSING:
                raise DataError("a frame lacks this field", field=one.name)
        return cls(**values, raw=_raw(arrays))


def _raw(arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {name.removeprefix(_RAW): one for name, one in arrays.items() if name.startswith(_RAW)}


class CaptureWriter(GrowingFile):
    """The only writer of a journal, by `create` or `resume`; others may read it at any time."""

    def __init__(
        self, path: Path, file: BinaryIO, header: Mapping[str, Any], frames: list[FrameRecord]
    ) -> None:
        super().__init__(file)
        self.path, self.header, self.frames, self.count = path, dict(header), frames, len(frames)
        self._first = frames[0].arrays() if frames else {}

    @classmethod
    def create(cls, path: str | Path, header: Mapping[str, Any]) -> Self:
        """Begin a new journal; DataError if the name is taken, or cannot be written."""
        payload = to_json({**header, "schema": _SCHEMA}, "header").encode()
        target, file = _new_file(path)
        with ExitStack() as undo:
            undo.callback(target.unlink, missing_ok=True)
            undo.callback(file.close)
            lock(file, target)
            writer = cls(target, file, header, [])
            writer._write(payload)
            undo.pop_all()
        return writer

    @classmethod
    def resume(cls, path: str | Path) -> Self:
        """Go on with a journal, without half a record at its end; DataError if it is in use."""
        target = writable_target(path)
        if not is_capture(target):
            raise DataError("expected an unfinished capture", source=path)
        with writing(path):
            file = target.open("r+b", buffering=0)
        with ExitStack() as undo:
            undo.callback(file.close)
            lock(file, target)
            records = [*_records(target)]
            length = records[-1][1]
            file.truncate(length)
            file.seek(length)
            undo.pop_all()
        return cls(target, file, records[0][0], [frame for frame, _ in records[1:]])

    def append(self, record: FrameRecord) -> None:
        """Add a frame, whole or not at all (DataError); it is with the system when this returns.

        One that makes no burst with those before is refused: after the last one it would be too
        late.
        """
        arrays, packed = record.arrays(), BytesIO()
        self._first = self._first or arrays
        with naming(self.path):
            for name, values in arrays.items():
                if name.startswith(_RAW):
                    check_storable(name, values)
                shape = self._first.get(name, values).shape
                if values.shape != shape:
                    problem = f"expected a shape of {shape}, as in the frames before"
                    raise DataError(f"{problem}, got {values.shape}", field=name)
            for name in {*FRAME_FIELDS} & (self._first.keys() ^ arrays.keys()):
                raise DataError("only some of the frames have it: all must, or none", field=name)
        np.savez(packed, **arrays)  # type: ignore[arg-type]  # names are ours
        self._write(packed.getbuffer())
        self.frames.append(record)
        self.count += 1

    def _write(self, payload: bytes | memoryview) -> None:
        start = self._file.tell()
        head = _HEAD.pack(_MARK, len(payload), zlib.crc32(payload))
        try:
            self._put(memoryview(head + bytes(payload)))
        except OSError as error:
            with suppress(OSError):  # readers skip half a record anyway
                self._file.seek(start)
                self._file.truncate(start)
            problem = f"cannot write: {error.strerror}; the {self.count} frames before are"
            raise DataError(f"{problem} kept", source=self.path) from error


def refuse_taken(path: str | Path) -> None:
    """Raise a DataError, before any device is opened, if no journal can begin at a name."""
    target, file = _new_file(path)
    file.close()
    target.unlink()


def _new_file(path: str | Path) -> tuple[Path, BinaryIO]:
    target = writable_target(path)
    with writing(path):
        try:
            return target, target.open("xb", buffering=0)
        except FileExistsError as error:
            problem = "there is a file of this name; resume it or choose another name"
            raise DataError(problem, source=path) from error


def is_capture(path: str | Path) -> bool:
    """Tell whether a file is the journal of a capture; a pipe, which would block, is none."""
    with suppress(OSError):
        if Path(path).is_file():
            with Path(path).open("rb") as file:
                return file.read(len(_MARK)) == _MARK
    return False


def read_capture(path: str | Path) -> tuple[dict[str, Any], list[FrameRecord]]:
    """Return header and frames of a journal, also of a growing one; DataError if it is none."""
    (header, _), *frames = _records(Path(path))
    return header, [frame for frame, _ in frames]


def burst_of_capture(
    header: Mapping[str, Any], frames: Sequence[FrameRecord], source: Path
) -> Burst:
    """Return the frames of a journal as a burst; DataError if there are none or they do not fit."""
    if not frames:
        raise DataError("the capture holds no whole frame", source=source)
    each = [one.arrays() for one in frames]
    names = set.intersection(*(set(one) for one in each))
    try:
        stacked = {name: np.stack([one[name] for one in each]) for name in names}
        known = {name: stacked.get(name) for name in ("offset_px", *FRAME_FIELDS)}
        return Burst.from_arrays(
            stacked["amplitude"], pitch_mm=header["pitch_mm"],
            modulation_hz=header.get("modulation_hz"),
            offset_source=header.get("offset_source", "planned"), raw=_raw(stacked),
            meta={**header.get("meta", {}), "step": stacked["step"].tolist()}, **known,
        )  # fmt: skip
    except DataError as error:
        raise error.in_file(source) from error
    except (KeyError, ValueError, TypeError) as error:
        raise DataError(f"the capture contradicts itself: {error}", source=source) from error


def frames_of_capture(path: str | Path) -> Iterator[FrameRecord]:
    """Yield the frames of a journal, which may be larger than memory; else as `read_capture`."""
    return (frame for frame, _ in islice(_records(Path(path)), 1, None))


def _records(path: Path) -> Iterator[tuple[Any, int]]:
    """Yield the header, then frame by frame, each with where it ends, as far as they are whole."""
    require_file(path)
    parsed: Callable[[bytes, Path], Any] = _header
    with reading(path), path.open("rb") as file:
        size, end = path.stat().st_size, 0
        while len(head := file.read(_HEAD.size)) == _HEAD.size:
            mark, length, checksum = _HEAD.unpack(head)
            end += _HEAD.size + length
            if mark != _MARK or length > _LARGEST or end > size:
                break
            payload = file.read(length)
            if zlib.crc32(payload) != checksum:
                break
            yield parsed(payload, path), end
            parsed = _frame
    if parsed is _header:
        raise DataError("expected the journal of a capture with a whole header", source=path)


def _header(payload: bytes, path: Path) -> dict[str, Any]:
    header = parse_json(payload, path, "header")
    if header.get("schema") != _SCHEMA:
        raise DataError(f"expected schema {_SCHEMA}", field="schema", source=path)
    return header


def _frame(payload: bytes, path: Path) -> FrameRecord:
    with reading(path, "frames"), np.load(BytesIO(payload), allow_pickle=False) as arrays:
        if unpacked_bytes(arrays) > len(payload):  # the writer does not compress
            raise DataError("a frame claims to hold more than is stored")
        return FrameRecord.of_arrays({name: arrays[name] for name in arrays.files})


def lock(file: BinaryIO, path: Path) -> None:
    """Keep other writers away until the file is closed or the process dies."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        else:
            import fcntl

            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise DataError("another process is writing this file", source=path) from error
