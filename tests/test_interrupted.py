"""A signal in the midst of our own work leaves no lock behind that its end, or the next, needs."""

import random
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import cast

import numpy as np
import pytest

from lensshift.capture.drivers.apt import AptSettings
from lensshift.capture.drivers.apt_axis import AptAxis
from lensshift.capture.drivers.receiver import Receiver
from lensshift.capture.emulators.apt import EmulatedStagePair
from lensshift.capture.rig import CameraFrame
from lensshift.cli.session import Progress, Waiting
from lensshift.core.threads import in_order, on_threads
from lensshift.core.types import Frame
from lensshift.live.sources import Source
from lensshift.live.worker import Live

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no such timers there")
TIMES = 300


class _CutShort(BaseException):
    pass


def cut_short(action: Callable[[], None], after_s: float) -> None:
    """Do it again and again until a signal of the system comes."""

    def end(number: int, frame: FrameType | None) -> None:
        raise _CutShort

    before = signal.signal(signal.SIGALRM, end)
    try:
        signal.setitimer(signal.ITIMER_REAL, after_s, 1.0)  # again, if Python swallows the first
        while True:
            action()
    except _CutShort:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.signal(signal.SIGALRM, before)


def ends(action: Callable[[], None]) -> bool:
    thread = threading.Thread(target=action, daemon=True)
    thread.start()
    thread.join(5.0)
    return not thread.is_alive()


def test_a_move_that_is_cut_short_as_it_begins_can_be_halted() -> None:
    rng = random.Random(1)
    with EmulatedStagePair() as stages:
        axis = AptAxis(stages.urls[0], AptSettings())

        def begin() -> None:
            with axis._doing("move"):
                pass

        for _ in range(TIMES):
            cut_short(begin, rng.uniform(1e-4, 3e-4))
            assert ends(axis.halt)
        axis.close()


def test_frames_come_on_after_a_wait_that_was_cut_short() -> None:
    rng = random.Random(2)
    image = np.zeros((3, 5))
    one = CameraFrame(Frame(image, None, np.ones((3, 5), dtype=bool), 0.0), 1, 0.0)
    receiver = Receiver("camera")
    receiver.start(lambda stop: None)

    def take() -> None:
        receiver.put(one)
        receiver.take(1.0, str)

    for _ in range(TIMES):
        cut_short(take, rng.uniform(1e-4, 3e-4))
        assert ends(lambda: receiver.put(one))
    receiver.close()


def test_tasks_are_done_after_others_were_cut_short() -> None:
    rng = random.Random(3)
    tasks = [lambda: None] * 2
    for _ in range(3 * TIMES):
        cut_short(lambda: on_threads(tasks), rng.uniform(1e-4, 3e-4))
        assert ends(lambda: on_threads(tasks))
        cut_short(lambda: list(in_order(str, range(9), 2)), rng.uniform(1e-4, 3e-4))
        assert ends(lambda: list(in_order(str, range(9), 2)))


def test_the_line_of_an_iteration_that_was_cut_short_ends() -> None:
    rng = random.Random(4)
    progress = Progress("working", preparing=True)
    for _ in range(TIMES):
        cut_short(lambda: progress(1, 0.5), rng.uniform(1e-4, 3e-4))
        assert ends(progress.close)


class _Idle:
    """A thread that does nothing, and is soon started."""

    def __init__(self, **_: object) -> None: ...
    def start(self) -> None: ...
    def join(self) -> None: ...


def test_a_wait_whose_end_was_cut_short_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(5)
    waiting = [Waiting("working")]
    waiting[0].close()

    def wait() -> None:
        waiting[0] = Waiting("working")
        waiting[0].close()

    for _ in range(TIMES):
        with monkeypatch.context() as patch:
            patch.setattr(threading, "Thread", _Idle)
            cut_short(wait, rng.uniform(1e-4, 3e-4))
        assert ends(waiting[0].close)


def test_a_live_view_whose_end_was_cut_short_ends() -> None:
    rng = random.Random(6)
    for _ in range(TIMES):
        live = Live(cast(Source, None))
        cut_short(live.__exit__, rng.uniform(1e-4, 3e-4))
        assert ends(live.__exit__)
