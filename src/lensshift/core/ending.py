"""Come to an orderly end when asked to: by `kill`, a shutdown, or a terminal that is closed."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Self

# Python leaves these to the system, which ends the process at once, without any `finally`.
# SIGBREAK is how Windows says that the console is closed.
_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)
_SWALLOWED_S = 5.0  # a block that is not over so long after a signal has not felt it


class Closing(ABC):
    """What is closed at the end of a `with` block."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> None:
        """Let go; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Ended(SystemExit):
    """Ends a program as a signal does; any other `SystemExit` is of somebody else's code."""


class Ending:
    """Takes signals: the first one ends the block, those after it do not disturb its end.

    What must not be cut short waits instead, and says so; only a second Ctrl-C cuts it short.
    """

    def __init__(self, *, at_once: bool, meanwhile: str) -> None:
        self.at_once = at_once
        self.number = 0
        self._since_s = -math.inf
        self._meanwhile = meanwhile
        self._told = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal, as Python calls its handlers."""
        again = self._told and number == signal.SIGINT
        if self._meanwhile and not self._told:
            self._told = True  # first: a handler may be interrupted by itself
            os.write(2, f"{self._meanwhile}\n".encode())  # print is not safe within a signal
        now_s = time.monotonic()
        # Python swallows what is raised while it happens to clean up an object: not twice.
        lost = now_s - self._since_s > _SWALLOWED_S
        if again or (self.at_once and lost):
            self.number, self._since_s = number, now_s
            raise self.error()
        self.number = number

    def check(self) -> None:
        """Raise what a signal has raised before, if the block goes on all the same."""
        if self.number and self.at_once:
            raise self.error()

    def error(self) -> BaseException:
        """Return what ends a program as this signal does."""
        if self.number == signal.SIGINT:
            return KeyboardInterrupt()
        return Ended(128 + self.number)  # what a shell says of a process that a signal ended


def interruption(error: BaseException) -> BaseException | None:
    """Return the Ctrl-C or signal that an error is, or that it came of.

    What is left half done, such as a ZIP, may fail to close.
    """
    found: BaseException | None = error
    while found is not None and not isinstance(found, KeyboardInterrupt | Ended):
        found = found.__context__
    return found


@contextmanager
def ended_by_signals(
    *, at_once: bool = True, ctrl_c: bool = False, meanwhile: str = ""
) -> Iterator[Ending]:
    """Let SIGTERM and a closed terminal raise `Ended` in the block, as Ctrl-C would.

    Signals that somebody else handles or ignores (`nohup`) stay theirs. In another thread than
    the main one, where Python delivers no signals, it does nothing. What is raised may be swallowed
    (it is where an object is being cleaned up): a long block calls `check` now and then.

    Parameters
    ----------
    at_once : or only after the block, for what must not be cut short
    ctrl_c : take Ctrl-C as well, so that a second one does not cut short the end of the first
    meanwhile : what to say on stderr when a signal has to wait
    """
    ending = Ending(at_once=at_once, meanwhile=meanwhile)
    if threading.current_thread() is not threading.main_thread():
        yield ending
        return
    before = {one: signal.getsignal(one) for one in _SIGNALS}
    ours = [n for n, one in before.items() if one is signal.SIG_DFL or isinstance(one, Ending)]
    if ctrl_c:
        before[signal.SIGINT] = keyboard = signal.getsignal(signal.SIGINT)
        if keyboard is signal.default_int_handler or isinstance(keyboard, Ending):
            ours.append(signal.SIGINT)
    for number in ours:
        signal.signal(number, ending)
    try:
        yield ending
    finally:
        if threading.current_thread() is threading.main_thread():  # a generator may end elsewhere
            for number in ours:
                signal.signal(number, before[number])
        left = sys.exception()
        if isinstance(left, Exception) and ending.number and at_once:  # see `interruption`
            raise ending.error() from left
    if ending.number:  # it waited, or was swallowed
        raise ending.error()
