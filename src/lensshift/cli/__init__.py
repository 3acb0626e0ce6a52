"""The command line: verbs for people and, with --json, for programs."""

from __future__ import annotations

import sys
from types import TracebackType


def main() -> None:
    """Run `lensshift`; exit code 0: done, 1: failed, 2: wrong usage, 130: interrupted."""
    from typer.main import get_command

    from lensshift.cli.app import app

    sys.excepthook = _one_line
    get_command(app)(prog_name="lensshift")


def _one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an error that no verb expected; it is ours, so ask for the traceback."""
    if issubclass(kind, KeyboardInterrupt):
        sys.exit(130)
    text = " ".join(f"{kind.__name__}: {error}".split())
    sys.stderr.write(f"error: this should not happen ({text}); see where with --debug\n")
