"""Work that compiled code does without the interpreter, on the cores that this process may use."""

from __future__ import annotations

import _thread
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import lru_cache, partial
from itertools import pairwise
from queue import SimpleQueue
from typing import TypeVar

Task = Callable[[], None]
Item = TypeVar("Item")
Made = TypeVar("Made")


def core_count() -> int:
    """Return how many cores to use: those of this process, no more than OMP_NUM_THREADS says."""
    try:
        ours = len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        ours = os.cpu_count() or 1
    told = os.environ.get("OMP_NUM_THREADS", "")
    return min(ours, int(told)) if told.isdigit() and int(told) > 0 else ours


def bands(size: int, count: int) -> list[tuple[int, int]]:
    """Return the ends of `count` parts of a length, as even as can be; none is empty."""
    count = max(min(count, size), 1)
    return list(pairwise(size * n // count for n in range(count + 1)))


def on_threads(tasks: Sequence[Task]) -> None:
    """Run tasks side by side and wait for all; the last one runs here."""
    if len(tasks) < 2:
        for task in tasks:
            task()
        return
    told: SimpleQueue[BaseException | None] = SimpleQueue()
    others, errors = tasks[:-1], list[BaseException | None]()
    _workers(os.getpid()).take([(task, told) for task in others])
    try:
        tasks[-1]()
    finally:
        errors += [told.get() for _ in others]
    for error in errors:
        if error is not None:
            raise error


def in_order(work: Callable[[Item], Made], items: Iterable[Item], count: int) -> Iterator[Made]:
    """Yield what work makes of each item, in their order, `count` of which are in work at once.

    None of them may wait for `on_threads`, which has the same threads.
    """
    coming: deque[tuple[list[Made], SimpleQueue[BaseException | None]]] = deque()
    try:
        for item in items:
            made, told = list[Made](), SimpleQueue[BaseException | None]()
            task = partial(_put, made, work, item)
            _workers(os.getpid()).take([(task, told)], at_once=count)
            coming.append((made, told))  # after a Ctrl-C before, nobody waits for it
            if len(coming) > count:
                yield _made(*coming.popleft())
        while coming:
            yield _made(*coming.popleft())
    finally:  # nothing goes on behind an error, or a consumer that had enough
        for _, told in coming:
            told.get()


def _put(made: list[Made], work: Callable[[Item], Made], item: Item) -> None:
    made.append(work(item))


def _made(made: list[Made], told: SimpleQueue[BaseException | None]) -> Made:
    error = told.get()
    if error is not None:
        raise error
    return made[0]


class _Workers:
    """Threads that wait for tasks, as many as have been wanted at once and there are cores.

    No `ThreadPoolExecutor`: a Ctrl-C in the midst of its own work leaves locks that nobody frees,
    and whatever is reconstructed after it, as in a notebook, waits for ever. This queue has none.
    """

    def __init__(self) -> None:
        self._tasks: SimpleQueue[tuple[Task, SimpleQueue[BaseException | None]]] = SimpleQueue()
        self._count = 0

    def take(
        self, tasks: Sequence[tuple[Task, SimpleQueue[BaseException | None]]], at_once: int = 0
    ) -> None:
        """Do tasks, and tell each of their queues what was raised, or None."""
        while self._count < min(max(len(tasks), at_once), os.cpu_count() or 1):
            # Not `threading.Thread`, whose start waits in Python code, which a signal may tear up.
            _thread.start_new_thread(self._work, ())
            self._count += 1
        for one in tasks:
            self._tasks.put(one)

    def _work(self) -> None:
        while True:
            task, told = self._tasks.get()
            with _Telling(told):
                task()
            del task  # and what it holds, however long the next one is in coming


class _Telling(AbstractContextManager["_Telling"]):
    """Tells a queue what was raised."""

    def __init__(self, told: SimpleQueue[BaseException | None]) -> None:
        self._told = told

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        self._told.put(error)
        return True


@lru_cache(maxsize=1)
def _workers(process: int) -> _Workers:
    """Return the threads of a process; those of its parent did not come along."""
    return _Workers()
