"""The command line: verbs for people and, with --json, for programs."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any, TextIO, cast

from lensshift.core.errors import printable


def main() -> None:
    """Run `lensshift`; exit code 0: done, 1: failed, 2: wrong usage, 130: interrupted."""
    from typer.main import get_command

    from lensshift.cli.app import app

    sys.excepthook = _one_line
    sys.stderr = cast(TextIO, _Printable(sys.stderr))
    get_command(app)(prog_name="lensshift")


class _Printable:
    """A stream to a terminal for words that are not ours, as in messages about arguments."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write("\r".join(printable(part) for part in text.split("\r")))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an error that no verb expected; it is ours, so ask for the traceback."""
    if issubclass(kind, KeyboardInterrupt):
        sys.exit(130)
    text = " ".join(f"{kind.__name__}: {error}".split())
    sys.stderr.write(f"error: this should not happen ({text}); see where with --debug\n")
