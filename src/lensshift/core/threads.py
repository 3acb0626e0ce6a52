"""Work that compiled code does without the interpreter, on the cores that this process may use."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise


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


def on_threads(tasks: Sequence[Callable[[], None]]) -> None:
    """Run tasks side by side and wait for all; the last one runs here."""
    if len(tasks) < 2:
        for task in tasks:
            task()
        return
    waiting = [_pool(os.getpid()).submit(task) for task in tasks[:-1]]
    try:
        tasks[-1]()
    finally:
        for one in waiting:
            one.result()


@lru_cache(maxsize=1)
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process; those of its parent did not come along."""
    return ThreadPoolExecutor(max_workers=os.cpu_count() or 1, thread_name_prefix="lensshift")
