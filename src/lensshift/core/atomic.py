"""Write files that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from lensshift.core.ending import Closing
from lensshift.core.errors import DataError


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; move it there if the block succeeds.

    Whatever ends the block (an error, Ctrl-C, a full disk), the temporary file is removed and a
    file that already had the name is left as it was. DataError if the folder is missing, the name
    cannot be written or the disk is full.
    """
    with writing(path):
        target = writable_target(path)
        temporary = target.parent / f".lensshift-{secrets.token_hex(8)}{target.suffix}"
        try:
            yield temporary
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Make what the system refuses in the block a `DataError` that names the file."""
    try:
        yield
    except OSError as error:
        raise DataError(f"cannot write: {error.strerror or error}", source=path) from error


def write_text(path: str | Path, text: str) -> None:
    """Write a text that appears whole or not at all; `DataError` as `written_whole`."""
    with written_whole(path) as part:
        part.write_text(text, encoding="utf-8")


class GrowingFile(Closing):
    """A file that is open for writing, and closed at the end of a `with` block."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def _put(self, data: memoryview) -> None:
        while data:
            data = data[self._file.write(data) :]

    def close(self) -> None:
        """Let go of the file; a second call does nothing."""
        self._file.close()


def writable_target(path: str | Path) -> Path:
    """Return the file that a name leads to; raise a `DataError` if it cannot be written."""
    try:
        target = Path(os.path.realpath(path))  # write through a link, do not replace it
    except ValueError as error:
        raise DataError(f"cannot write: {error}", source=path) from error
    if target.exists() and not target.is_file():
        kind = "a folder" if target.is_dir() else "a device or pipe"
        raise DataError(f"cannot write: this is {kind}, not a file", source=path)
    if not target.parent.is_dir():
        raise DataError(f"cannot write: there is no folder {target.parent}", source=path)
    if not os.access(target.parent, os.W_OK):
        raise DataError(f"cannot write: no permission to write to {target.parent}", source=path)
    return target
