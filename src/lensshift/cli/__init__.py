"""The command line: verbs for people and, with --json, for programs."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO, cast

from lensshift.core.errors import printable


def main() -> None:
    """Run `lensshift`; exit code 0: done, 1: failed, 2: wrong usage, 130: interrupted."""
    sys.excepthook = _one_line  # before the imports, which may be interrupted too

    from typer.main import get_command

    from lensshift.cli.app import app

    if sys.stdout is not None:  # as it is where the caller closed it
        sys.stdout = cast(TextIO, _Unread(sys.stdout))
    if sys.stderr is not None:
        sys.stderr = cast(TextIO, _Printable(sys.stderr))
    get_command(app)(prog_name="lensshift")


class _Stream:
    """A stream that writes in a way of its own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Unread(_Stream):
    """A stream that nobody may read to its end, as in `lensshift lens show petzval_a | head`.

    The work goes on, and its files are written; what is said about it is lost.
    """

    def write(self, text: str) -> int:
        with self._unless_closed():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._unless_closed():
            self._stream.flush()

    @contextmanager
    def _unless_closed(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            with Path(os.devnull).open("w") as nowhere:  # where Python flushes to when it ends, too
                os.dup2(nowhere.fileno(), self._stream.fileno())


class _Printable(_Stream):
    """A stream to a terminal for words that are not ours, as in messages about arguments."""

    def write(self, text: str) -> int:
        return self._stream.write("\r".join(printable(part) for part in text.split("\r")))


def _one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an error that no verb expected; it is ours, so ask for the traceback."""
    if issubclass(kind, KeyboardInterrupt):
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    text = " ".join(f"{kind.__name__}: {error}".split())
    sys.stderr.write(f"error: this should not happen ({text}); see where with --debug\n")
