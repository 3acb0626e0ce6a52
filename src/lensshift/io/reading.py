"""What every reader of foreign bytes needs: turn any failure into one line that names the file."""

from __future__ import annotations

import csv
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

from lensshift.core.errors import DataError

if TYPE_CHECKING:
    from numpy.lib.npyio import NpzFile

CONTAINER_SUFFIXES = (".nc", ".nc4", ".h5", ".hdf5")
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
RECORDING_SUFFIXES = (".pcap", ".pcapng", *BAG_SUFFIXES)
# What h5py, tifffile, Pillow and NumPy raise when a file is damaged.
_READ_ERRORS = (
    OSError, EOFError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError,
    AssertionError, AttributeError, BufferError, MemoryError, SyntaxError, SystemError, UserWarning,
    csv.Error, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
_DEFLATE_LIMIT = 1100  # zlib cannot shrink data by more than a factor of 1032
# Measured frames shrink by 10 at most, flags and other constants by 1000, but beside frames.
_UNPACKED_LIMIT = 100
_ALWAYS_UNPACKED_BYTES = 1 << 28  # 256 MiB, which every computer has
_allowed_bytes: ContextVar[int | None] = ContextVar("allowed_bytes", default=None)


@contextmanager
def reading(path: str | Path, field: str = "") -> Iterator[None]:
    """Turn whatever a reader raises in the block into a `DataError` that names the file."""
    try:
        yield
    except DataError as error:
        raise error.in_file(path) from error
    except BlockingIOError as error:
        raise DataError("another program is writing this file", source=path) from error
    except PermissionError as error:
        raise DataError("cannot read: permission denied", source=path) from error
    except _READ_ERRORS as error:
        reason = f"{error}"[:200] or type(error).__name__
        raise DataError(f"damaged or cut short ({reason})", field=field, source=path) from error


def check_held(shape: tuple[int, ...], claimed_bytes: int, stored_bytes: int, field: str) -> None:
    """Raise a `DataError` if so few stored bytes cannot hold an array of this shape."""
    if claimed_bytes > _DEFLATE_LIMIT * stored_bytes:
        raise DataError(f"damaged: {stored_bytes} bytes cannot hold shape {shape}", field=field)


def unpacked_bytes(archive: NpzFile) -> int:
    """Return the bytes that the arrays of an NPZ file claim to have; no more is ever read."""
    return sum(member.file_size for member in archive.zip.infolist()) if archive.zip else 0


@contextmanager
def memory_limit(limit_bytes: int | None) -> Iterator[None]:
    """Let the arrays of each file that is read in the block take so many bytes, and no more.

    Without it, or with None, they may take 256 MiB or a hundred times the size of the file.
    """
    if limit_bytes is not None and limit_bytes < 1:
        raise ValueError(f"expected a positive number of bytes, got {limit_bytes}")
    before = _allowed_bytes.set(limit_bytes)
    try:
        yield
    finally:
        _allowed_bytes.reset(before)


def check_unpacked(claimed_bytes: int, file_bytes: int, field: str) -> None:
    """Raise a `DataError` if a file asks for more memory than it may have, see `memory_limit`."""
    limit = _allowed_bytes.get()
    if limit is None:
        limit = max(_ALWAYS_UNPACKED_BYTES, _UNPACKED_LIMIT * file_bytes)
    if claimed_bytes > limit:
        raise DataError(
            f"expected at most {limit} bytes of memory for a file of {file_bytes}, got "
            f"{claimed_bytes}; if you trust it, allow more (lensshift --max-memory, memory_limit)",
            field=field,
        )


def require_file(path: str | Path) -> None:
    """Raise a `DataError` unless there is a regular file with something in it."""
    try:
        found = Path(path).stat()
    except FileNotFoundError as error:
        raise DataError("there is no such file", source=path) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot read: {reason}", source=path) from error
    if stat.S_ISDIR(found.st_mode):
        raise DataError("expected a file, got a folder", source=path)
    if not stat.S_ISREG(found.st_mode):
        raise DataError("expected a file, got a device or pipe", source=path)
    if found.st_size == 0:
        raise DataError("the file is empty", source=path)
