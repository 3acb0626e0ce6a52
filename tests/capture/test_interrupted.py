"""A signal in the midst of a driver's own work leaves no lock behind that its end needs."""

import random
import signal
import threading
from collections.abc import Callable
from types import FrameType

import numpy as np
import pytest

from lensshift.capture.drivers.apt import AptSettings
from lensshift.capture.drivers.apt_axis import AptAxis
from lensshift.capture.drivers.receiver import Receiver
from lensshift.capture.emulators.apt import EmulatedStagePair
from lensshift.capture.rig import CameraFrame
from lensshift.core.types import Frame

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
        signal.setitimer(signal.ITIMER_REAL, after_s)
        while True:
            action()
    except _CutShort:
        pass
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
