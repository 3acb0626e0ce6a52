"""What is believed of a stream of replies that lost bytes."""

from collections import deque
from collections.abc import Iterable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import Bits, DamagedMessage, Framer, Id, Message, Status
from lensshift.capture.drivers.apt_cube import AptCube, _possible_status
from lensshift.core.errors import DeviceError

WELL = Bits.CONNECTED | Bits.HOMED | Bits.ENABLED
TOLERANCE = 35


class _Replayed(AptCube):
    """Its polls are replies from a list."""

    def __init__(self, replies: Iterable[tuple[Status, int]]) -> None:
        self._tolerance, self._attempts = TOLERANCE, 10
        self._recent = deque(maxlen=3)
        self.left = deque(replies)
        self.link = SimpleNamespace(device="KDC101 1", resyncs=0)

    def poll(self, *before: Message, attempts: int = 0) -> Status:
        status, self.link.resyncs = self.left.popleft()
        return status


def damaged(sent: list[Status], loss: float, seed: int) -> Iterator[tuple[Status, int]]:
    """Yield possible replies, and resyncs until then, when some of those sent lost a byte.

    Worse than any line: between two requests there is a pause in which half a reply is dropped.
    """
    draw = np.random.default_rng(seed)
    framer = Framer(apt.TO_HOST)
    for status in sent:
        data = Message(Id.STATUS, data=status.pack()).to_bytes(0x01, 0x50)
        if draw.random() < loss:
            lost = draw.integers(len(data))
            data = data[:lost] + data[lost + 1 :]
        for message in framer.feed(data, 0.0):
            try:
                yield _possible_status(message), framer.resyncs
            except DamagedMessage:
                continue


@pytest.mark.parametrize("loss", [0.02, 0.1])
@pytest.mark.parametrize("step", [0, 40])
def test_single_replies_lie_but_what_is_confirmed_is_true(loss: float, step: int) -> None:
    draw = np.random.default_rng(7)
    bits = WELL | (Bits.MOVING_FORWARD if step else Bits.SETTLED)
    start, count = 12345, 5000
    truth = start + step * (np.arange(count) % 4000)
    sent = [Status(int(at + draw.integers(-2, 3)), 0, 0, int(bits)) for at in truth]
    replies = list(damaged(sent, loss, seed=11))
    low, high = truth.min() - 2, truth.max() + 2
    lies = [one.counts for one, _ in replies if not low <= one.counts <= high]
    assert len(lies) > count * loss / 100  # the test has something to find
    cube, believed = _Replayed(replies), []
    while len(cube.left) > 40:
        believed.append(cube.status().counts)
    assert len(believed) > count / 10
    assert low <= min(believed)
    assert max(believed) <= high


def test_replies_that_never_agree_are_an_error() -> None:
    replies = [(Status(1000 * at, 0, 0, int(WELL)), 0) for at in range(40)]
    with pytest.raises(DeviceError, match="KDC101 1: its replies contradict each other"):
        _Replayed(replies).status()


def test_middle_one_of_three_is_taken_while_it_moves() -> None:
    bits = int(WELL | Bits.MOVING_BACKWARD)
    replies = [(Status(counts, 0, 0, bits), 0) for counts in (900, 70, 800)]
    assert _Replayed(replies).status().counts == 800
