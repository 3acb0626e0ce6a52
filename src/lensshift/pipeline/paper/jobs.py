"""Independent pieces of work, side by side."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

# What its result is filed under, and a call of a function of a module: another process finds it.
Job = tuple[str, Callable[[], Any]]


def carry_out_jobs(
    jobs: Sequence[Job], processes: int, on_step: Callable[[int, int], None] | None = None
) -> list[tuple[str, Any]]:
    """Return kind and result of each job, in their order; one process is this one.

    ValueError if there is not at least one; whatever a job raises. `on_step` hears how many jobs
    of all are done.
    """
    if processes < 1:
        raise ValueError(f"expected at least one process, got {processes}")
    if processes == 1:
        results = []
        for number, (_, job) in enumerate(jobs):
            results.append(job())
            if on_step is not None:
                on_step(number + 1, len(jobs))
        return [(kind, result) for (kind, _), result in zip(jobs, results, strict=True)]
    # Fresh processes: a forked one may inherit locks of numerical libraries.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures = [pool.submit(job) for _, job in jobs]
        try:
            for number, future in enumerate(as_completed(futures)):
                future.result()
                if on_step is not None:
                    on_step(number + 1, len(jobs))
        finally:
            pool.shutdown(cancel_futures=True)  # after a failure the rest is not wanted
        return [(kind, one.result()) for (kind, _), one in zip(jobs, futures, strict=True)]
