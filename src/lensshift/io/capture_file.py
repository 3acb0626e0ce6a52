"""A capture as it grows: a journal of frames that survives a kill at any moment.

    file   = record, record, ...      the first one is the header
    record = "LSCAPTR1" | length of the payload, u64 | CRC-32 of the payload, u32 | payload
    header = JSON, frame = NPZ, both little-endian

A record counts once its checksum fits, so a writer that dies loses the record that it was
writing and nothing else. When a capture is complete, a burst file takes the journal's place.
`docs/decisions/0013-capture-journal.md` says why this is no HDF5.
"""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.core.types import Burst
from lensshift.io.atomic import writable_target
from lensshift.io.container_writer import to_json
from lensshift.io.reading import require_file, unpacked_bytes

Record = dict[str, NDArray[Any]]

_MARK = b"LSCAPTR1"
_HEAD = struct.Struct("<8sQI")
_LARGEST = 1 << 31  # bytes of a record: more is damage
_SCHEMA = "lensshift-capture/1"
# Fields of a record that every frame has; those that it has if a stage moved the lens.
FRAME_FIELDS = ("amplitude", "valid", "offset_px", "time_s")
_STAGE_FIELDS = ("offset_sigma_px", "stage_mm", "stage_commanded_mm")


class CaptureWriter:
    """The only writer of a journal; others may read it at any time.

    Use `create` or `resume`, in a `with` block.

    Parameters
    ----------
    header : text and numbers about the whole capture
    frames : records that are already there
    """

    def __init__(
        self, path: Path, file: BinaryIO, header: Mapping[str, Any], frames: list[Record]
    ) -> None:
        self.path, self.header, self.frames = path, dict(header), frames
        self._file = file

    @classmethod
    def create(cls, path: str | Path, header: Mapping[str, Any]) -> Self:
        """Begin a new journal.

        Raises
        ------
        DataError
            If there is a file of that name already, or it cannot be written.
        """
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
        """Go on with a journal; half a record at its end is cut off.

        Raises
        ------
        DataError
            If it is no journal, or another process writes it.
        """
        target = writable_target(path)
        if not is_capture(target):
            raise DataError("expected an unfinished capture", source=path)
        try:
            file = target.open("r+b", buffering=0)
        except OSError as error:
            raise DataError(f"cannot write: {error.strerror}", source=path) from error
        with ExitStack() as undo:
            undo.callback(file.close)
            lock(file, target)
            header, frames, length = _records(target)
            file.truncate(length)
            file.seek(length)
            undo.pop_all()
        return cls(target, file, header, frames)

    def append(self, record: Mapping[str, Any]) -> None:
        """Add a frame; it is with the operating system when this returns.

        Raises
        ------
        DataError
            If the disk is full or gone; the frames before are kept.
        """
        arrays = {name: np.asarray(value) for name, value in record.items()}
        packed = BytesIO()
        np.savez(packed, **arrays)  # type: ignore[arg-type]  # names are ours
        self._write(packed.getbuffer())
        self.frames.append(arrays)

    def close(self) -> None:
        """Let go of the file; a second call does nothing."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _write(self, payload: bytes | memoryview) -> None:
        start = self._file.tell()
        data = memoryview(_HEAD.pack(_MARK, len(payload), zlib.crc32(payload)) + bytes(payload))
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._cut(start)
            problem = f"cannot write: {error.strerror}; the {len(self.frames)} frames before are"
            raise DataError(f"{problem} kept", source=self.path) from error

    def _cut(self, length: int) -> None:
        """Take back half a record; readers skip it anyway where that fails."""
        try:
            self._file.seek(length)
            self._file.truncate(length)
        except OSError:
            return


def refuse_taken(path: str | Path) -> None:
    """Refuse a name at which no journal can begin, before any device is opened for it.

    Raises
    ------
    DataError
        If there is a file of that name already, or it cannot be written.
    """
    target, file = _new_file(path)
    file.close()
    target.unlink()


def _new_file(path: str | Path) -> tuple[Path, BinaryIO]:
    target = writable_target(path)
    try:
        return target, target.open("xb", buffering=0)
    except FileExistsError as error:
        problem = "there is a file of this name; resume it or choose another name"
        raise DataError(problem, source=path) from error
    except OSError as error:
        raise DataError(f"cannot write: {error.strerror}", source=path) from error


def is_capture(path: str | Path) -> bool:
    """Tell whether a file is the journal of a capture; a pipe, which would block, is none."""
    try:
        if not Path(path).is_file():
            return False
        with Path(path).open("rb") as file:
            return file.read(len(_MARK)) == _MARK
    except OSError:
        return False


def read_capture(path: str | Path) -> tuple[dict[str, Any], list[Record]]:
    """Return header and frames of a journal, also while it is being written.

    Raises
    ------
    DataError
        If the file is missing or no journal.
    """
    header, frames, _ = _records(Path(path))
    return header, frames


def burst_of_capture(header: Mapping[str, Any], frames: Sequence[Record], source: Path) -> Burst:
    """Return the frames of a journal as a burst.

    Raises
    ------
    DataError
        If there is no frame yet, or frames do not fit together.
    """
    if not frames:
        raise DataError("the capture holds no whole frame", source=source)
    names = set.intersection(*(set(one) for one in frames))
    missing = [name for name in FRAME_FIELDS if name not in names]
    if missing:
        raise DataError("a frame lacks this field", field=missing[0], source=source)
    try:
        stacked = {name: np.stack([one[name] for one in frames]) for name in names}
        per_frame: dict[str, Any] = {
            name: stacked.get(name) for name in (*FRAME_FIELDS[1:], *_STAGE_FIELDS)
        }
        return Burst.from_arrays(
            stacked["amplitude"],
            stacked.get("distance_m"),
            pitch_mm=header["pitch_mm"],
            modulation_hz=header.get("modulation_hz"),
            offset_source=header.get("offset_source", "planned"),
            raw={
                name.removeprefix("raw_"): values
                for name, values in stacked.items()
                if name.startswith("raw_")
            },
            meta={**header.get("meta", {}), "step": stacked["step"].tolist()},
            **per_frame,
        )
    except DataError as error:
        raise error.in_file(source) from error
    except (KeyError, ValueError, TypeError) as error:
        raise DataError(f"the capture contradicts itself: {error}", source=source) from error


def _records(path: Path) -> tuple[dict[str, Any], list[Record], int]:
    """Return the header, the whole frames, and where the last one ends."""
    require_file(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"cannot read: {error.strerror}", source=path) from error
    payloads, end = [], 0
    while len(data) >= end + _HEAD.size:
        mark, length, checksum = _HEAD.unpack_from(data, end)
        start = end + _HEAD.size
        if mark != _MARK or length > _LARGEST or len(data) < start + length:
            break
        payload = data[start : start + length]
        if zlib.crc32(payload) != checksum:
            break
        payloads.append(payload)
        end = start + length
    if not payloads:
        raise DataError("expected the journal of a capture with a whole header", source=path)
    try:
        header = json.loads(payloads[0])
        frames = [_unpacked(payload) for payload in payloads[1:]]
    except (ValueError, zipfile.BadZipFile, OSError) as error:
        raise DataError(f"the capture is damaged: {error}", source=path) from error
    if not isinstance(header, dict) or header.get("schema") != _SCHEMA:
        raise DataError(f"expected schema {_SCHEMA}", field="schema", source=path)
    return header, frames, end


def _unpacked(payload: bytes) -> Record:
    with np.load(BytesIO(payload), allow_pickle=False) as arrays:
        if unpacked_bytes(arrays) > len(payload):  # the writer does not compress
            raise DataError("a frame claims to hold more than is stored")
        return {name: arrays[name] for name in arrays.files}


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
