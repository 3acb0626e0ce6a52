"""Tasks side by side: all are done, none of the errors is lost."""

import os
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.threads import bands, core_count, in_order, on_threads


@given(st.integers(1, 50), st.integers(1, 9))
def test_bands_cover_a_length(size: int, count: int) -> None:
    found = bands(size, count)
    assert [index for first, end in found for index in range(first, end)] == list(range(size))
    lengths = [end - first for first, end in found]
    assert len(found) == min(size, count)
    assert max(lengths) - min(lengths) <= 1


def test_tasks_run_at_the_same_time_and_errors_come_back() -> None:
    count = (os.cpu_count() or 1) + 1  # this thread has none of the pool
    meet = threading.Barrier(count, timeout=20)  # passes only if all are there
    done: list[int] = []
    on_threads([lambda: done.append(meet.wait())] * count)
    assert sorted(done) == list(range(count))
    done.clear()

    def fail() -> None:
        raise ZeroDivisionError("one task")

    with pytest.raises(ZeroDivisionError, match="one task"):
        on_threads([fail, lambda: done.append(1)])
    assert done == [1]


def test_what_is_made_comes_in_order_and_no_more_is_made_than_asked() -> None:
    begun: list[int] = []

    def square(number: int) -> int:
        begun.append(number)
        time.sleep(0.002 * (number % 3))  # later ones are done earlier
        if number == 7:
            raise ZeroDivisionError("the seventh")
        return number**2

    found = in_order(square, range(100), 2)
    assert [next(found) for _ in range(7)] == [n**2 for n in range(7)]
    with pytest.raises(ZeroDivisionError, match="the seventh"):
        next(found)
    assert max(begun) <= 10
    count = len(begun)
    ahead = in_order(square, iter([1, 2, 3, 4, 5, 6]), 2)
    assert next(ahead) == 1
    ahead.close()  # what was begun is done: nothing goes on behind
    assert len(begun) <= count + 4
    assert list(in_order(square, [], 3)) == []


def test_as_many_cores_as_there_are_or_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert 1 <= core_count() <= (os.cpu_count() or 1)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert core_count() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "many")
    assert core_count() >= 1
