"""How many threads the linear algebra has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from threading import current_thread, main_thread

from threadpoolctl import ThreadpoolController


@lru_cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Do linear algebra with one thread meanwhile, if this is the main thread of the process.

    Over matrices of some hundred numbers a side several threads only wait for one another. OpenBLAS
    does not always heed other threads than the main one, which could not give its threads back.
    """
    if current_thread() is not main_thread():
        yield
        return
    with _libraries().limit(limits=1, user_api="blas"):
        yield
