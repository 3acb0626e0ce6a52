"""Come to an orderly end when asked to: by `kill`, a shutdown, or a terminal that is closed."""

from __future__ import annotations

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
    """Takes signals: the first one ends the block, those after it do not disturb its end."""

    def __init__(self, *, at_once: bool) -> None:
        self.at_once = at_once
        self.number = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.number:
            self.number = number
            if self.at_once:
                raise SystemExit(128 + number)  # what a shell says of a process that a signal ended


@contextmanager
def ended_by_signals(*, at_once: bool = True) -> Iterator[None]:
    """Let SIGTERM and a closed terminal raise `SystemExit` in the block, as Ctrl-C would.

    Signals that somebody else handles or ignores (`nohup`) stay theirs. In another thread than
    the main one, where Python delivers no signals, it does nothing.

    Parameters
    ----------
    at_once : or only after the block, for what must not be cut short
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ending = _Ending(at_once=at_once)
    before = {one: signal.getsignal(one) for one in _SIGNALS}
    taken = [n for n, one in before.items() if one is signal.SIG_DFL or isinstance(one, _Ending)]
    for number in taken:
        signal.signal(number, ending)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():  # a generator may end elsewhere
            for number in taken:
                signal.signal(number, before[number])
    if ending.number and not at_once:
        raise SystemExit(128 + ending.number)
