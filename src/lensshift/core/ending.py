"""Come to an orderly end when asked to: by `kill`, a shutdown, or a terminal that is closed."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Python leaves these to the system, which ends the process at once, without any `finally`.
# SIGBREAK is how Windows says that the console is closed.
_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)


class _Ending:
    """Takes signals: the first one ends the block, those after it do not disturb its end.

    What must not be cut short waits instead, and says so; only a second Ctrl-C cuts it short.
    """

    def __init__(self, *, at_once: bool, meanwhile: str) -> None:
        self.at_once = at_once
        self.number = 0
        self._meanwhile = meanwhile
        self._told = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        again = self._told and number == signal.SIGINT
        if self._meanwhile and not self._told:
            self._told = True  # first: a handler may be interrupted by itself
            os.write(2, f"{self._meanwhile}\n".encode())  # print is not safe within a signal
        if again or (self.at_once and not self.number):
            self.number = number
            raise self.error()
        self.number = number

    def error(self) -> BaseException:
        """Return what ends a program as this signal does."""
        if self.number == signal.SIGINT:
            return KeyboardInterrupt()
        return SystemExit(128 + self.number)  # what a shell says of a process that a signal ended


@contextmanager
def ended_by_signals(
    *, at_once: bool = True, ctrl_c: bool = False, meanwhile: str = ""
) -> Iterator[None]:
    """Let SIGTERM and a closed terminal raise `SystemExit` in the block, as Ctrl-C would.

    Signals that somebody else handles or ignores (`nohup`) stay theirs. In another thread than
    the main one, where Python delivers no signals, it does nothing.

    Parameters
    ----------
    at_once : or only after the block, for what must not be cut short
    ctrl_c : take Ctrl-C as well, so that a second one does not cut short the end of the first
    meanwhile : what to say on stderr when a signal has to wait
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ending = _Ending(at_once=at_once, meanwhile=meanwhile)
    before = {one: signal.getsignal(one) for one in _SIGNALS}
    ours = [n for n, one in before.items() if one is signal.SIG_DFL or isinstance(one, _Ending)]
    if ctrl_c:
        before[signal.SIGINT] = keyboard = signal.getsignal(signal.SIGINT)
        if keyboard is signal.default_int_handler or isinstance(keyboard, _Ending):
            ours.append(signal.SIGINT)
    for number in ours:
        signal.signal(number, ending)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():  # a generator may end elsewhere
            for number in ours:
                signal.signal(number, before[number])
    if ending.number and not at_once:
        raise ending.error()
