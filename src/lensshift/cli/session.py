"""What all verbs share: results as text or JSON, warnings, one-line errors, progress."""

from __future__ import annotations

import sys
import threading
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from shutil import get_terminal_size
from typing import Annotated, Any, TextIO, TypeVar

import typer

from lensshift.core.ending import Closing, Ended, ended_by_signals, interruption
from lensshift.core.errors import QualityWarning, WorstWarning, printable
from lensshift.core.settings import to_json

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else, to stdout.")
]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]

T = TypeVar("T")

# What can go wrong without a fault in this program.
_FAILURES = (
    ValueError, TypeError, OSError, ImportError, RuntimeError, MemoryError, ArithmeticError,
)  # fmt: skip
# Package -> the extra that brings it.
_EXTRAS = {
    "matplotlib": "plot", "skimage": "deconvolution", "xarray": "notebook", "pandas": "notebook",
    "astropy": "fits", "torch": "torch", "distributed": "cluster", "starlette": "live",
}  # fmt: skip
MOST_ROWS = 40  # of a table on a terminal; a scan for a calibration has 35
_QUIET_S = 1.0  # what is over sooner needs no word
_PREPARING = "preparing (only the first call after an installation compiles)"
_TERMINAL_EVERY_S = 0.1  # smooth to the eye
_FILE_EVERY_S = 5.0  # a line of a log


@dataclass
class Session:
    """One run of a verb: what it says and what it hands back."""

    as_json: bool = False  # print only the result, as JSON
    debug: bool = False  # show where an error comes from
    result: dict[str, Any] = field(default_factory=dict)  # what JSON output holds beside "warnings"
    warnings: list[str] = field(default_factory=list)
    failed: bool = False  # whether the verb ends with 1 although it could be carried out
    waiting: Waiting | None = None
    worst: WorstWarning | None = None  # of those that are told once, in the end
    stdout: TextIO = field(default_factory=lambda: sys.stdout)

    def say(self, text: str) -> None:
        """Print a line for people; nothing with --json."""
        if self.waiting is not None:
            self.waiting.close()
        if not self.as_json:
            typer.echo(printable(text))

    def say_rows(self, rows: Sequence[str]) -> None:
        """Print the rows of a table, of a long one the first."""
        for row in rows[:MOST_ROWS]:
            self.say(row)
        if len(rows) > MOST_ROWS:
            self.say(f"  ... and {len(rows) - MOST_ROWS} more: --json has all of them")

    def count(self, done: int, total: int) -> None:
        """Take note of one step of a known number."""
        if self.waiting is not None:
            self.waiting.so_far = f", {done} of {total}"

    def wrote(self, *files: Path) -> None:
        """Say which files were written, and hand back their names."""
        self.say("wrote " + ", ".join(map(str, files)))
        self.result["files"] = files

    def tell(self, value: object, names: str) -> None:
        """Hand back some attributes of a value, by their names with blanks between."""
        self.result |= picked(value, names)

    def say_json(self, value: dict[str, Any], *, indent: int | None = 2) -> None:
        """Print a value for programs; nothing without --json."""
        if self.as_json and self.stdout is not None:  # as where the caller closed it
            typer.echo(to_json(value, indent=indent), file=self.stdout)

    def warn(self, message: Warning | str, *_: Any, **__: Any) -> None:
        """Print a warning once, on one line (takes what `warnings.showwarning` is given)."""
        if isinstance(message, WorstWarning):
            if self.worst is None or message.worse > self.worst.worse:
                self.worst = message
            return
        text = printable(" ".join(str(message).split()))
        if text not in self.warnings:
            self.warnings.append(text)
            if self.waiting is not None:
                self.waiting.end_line()
            typer.echo(f"warning: {text}", err=True)

    def tell_worst(self) -> None:
        """Print the warning of which only the worst is told."""
        if self.worst is not None:
            self.warn(str(self.worst))


@contextmanager
def session(*, as_json: bool, debug: bool, doing: str = "") -> Iterator[Session]:
    """Run a verb that is `doing` something; print its result, or its error on one line, exit 1."""
    current = Session(as_json, debug)
    current.waiting = Waiting(doing) if doing else None
    with (
        ended_by_signals(),
        warnings.catch_warnings(action="always", category=QualityWarning),
        # What devices of the user's own and other packages print is no result.
        redirect_stdout(sys.stderr if as_json else sys.stdout),
    ):
        warnings.showwarning = current.warn
        try:
            try:
                yield current
            finally:
                current.tell_worst()
        except typer.Exit:  # a RuntimeError in the eyes of Python
            raise
        except (KeyboardInterrupt, *_FAILURES) as error:
            ended = interruption(error)
            if isinstance(ended, Ended):
                raise ended from error
            if ended is None:
                _report(error, current)
                raise typer.Exit(1) from error
            typer.echo(f"interrupted: {ended}" if str(ended) else "interrupted", err=True)
            raise typer.Exit(130) from error
        finally:
            if current.waiting is not None:
                current.waiting.close()
    current.say_json(current.result | {"warnings": current.warnings})
    if current.failed:
        raise typer.Exit(1)


def picked(value: object, names: str) -> dict[str, Any]:
    """Return some attributes of a value, by their names with blanks between."""
    return {name: getattr(value, name) for name in names.split()}


def _report(error: BaseException, current: Session) -> None:
    if current.waiting is not None:
        current.waiting.close()
    if current.debug:
        traceback.print_exception(error)
    text = printable(" ".join(str(error).split())) or type(error).__name__
    extra = _EXTRAS.get((getattr(error, "name", None) or "").partition(".")[0])
    if isinstance(error, ImportError) and extra and "lensshift[" not in text:
        text += f"; pip install 'lensshift[{extra}]'"
    typer.echo(f"error: {text}", err=True)
    current.say_json({"error": text, "warnings": current.warnings})


class StatusLine:
    """A line on stderr: on a terminal each text takes the place of the one before."""

    def __init__(self) -> None:
        self.on_terminal = sys.stderr.isatty()
        self._open = False

    def show(self, text: str) -> None:
        """Show a text."""
        text, self._open = printable(text), self.on_terminal
        if self.on_terminal:  # a longer one would break, and the next begin a line below
            wide = get_terminal_size().columns - 1
            text = "\r" + (text if len(text) <= wide else text[: wide - 3] + "...").ljust(wide)
        typer.echo(text, err=True, nl=not self._open)

    def close(self) -> None:
        """End the line on a terminal; again does nothing."""
        if self._open:
            typer.echo("", err=True)
            self._open = False


class Progress(Closing):
    """Say how far an iteration is, on stderr, once it takes more than a second.

    preparing : whether it may take long before the first iteration, which is said then
    """

    def __init__(self, label: str, *, preparing: bool = False) -> None:
        self._label = label
        self._start_s = self._last_s = time.monotonic()
        self._line = StatusLine()
        self._begun = False
        if preparing:  # never cancelled: cut short by a signal, that would hold a lock for ever
            timer = threading.Timer(_QUIET_S, self._prepare)
            timer.daemon = True
            timer.start()

    def _prepare(self) -> None:
        if not self._begun:
            self.say(_PREPARING)

    def __call__(self, iteration: int, objective: float) -> None:
        """Take note of one iteration."""
        self._begun = True
        self.say(f"iteration {iteration}, objective {objective:.4g}")

    def count(self, done: int, total: int) -> None:
        """Take note of one step of a known number."""
        self.say(f"{done} of {total}")

    def counted(self, things: Iterable[T], total: int) -> Iterator[T]:
        """Yield things and take note of each."""
        for number, thing in enumerate(things):
            yield thing
            self.count(number + 1, total)

    def say(self, state: str) -> None:
        """Show a state, unless the last one is too fresh."""
        now_s = time.monotonic()
        every_s = _TERMINAL_EVERY_S if self._line.on_terminal else _FILE_EVERY_S
        first = self._last_s == self._start_s
        if now_s - self._start_s < _QUIET_S or (not first and now_s - self._last_s < every_s):
            return
        self._last_s = now_s
        self._line.show(f"{self._label}: {state}")

    def close(self) -> None:
        """End the line on a terminal."""
        self._begun = True
        self._line.close()


class Waiting(Closing):
    """Say every second on a terminal, else every five, that something still goes on."""

    def __init__(self, label: str) -> None:
        self._progress = Progress(label)
        self.so_far = ""  # what is said beside the seconds
        self._start_s = time.monotonic()
        self._over: SimpleQueue[None] = SimpleQueue()  # an Event may be cut short, see `Progress`
        self._thread = threading.Thread(target=self._tick, daemon=True)
        self._thread.start()

    def _tick(self) -> None:
        while True:
            with suppress(Empty):
                self._over.get(timeout=_QUIET_S if sys.stderr.isatty() else _FILE_EVERY_S)
                return
            self._progress.say(f"{time.monotonic() - self._start_s:.0f} s{self.so_far}")

    def end_line(self) -> None:
        """End the line on a terminal, before something else is printed."""
        self._progress.close()

    def close(self) -> None:
        """Stop, and end the line on a terminal; again does nothing."""
        self._over.put(None)
        self._thread.join()
        self._progress.close()
