"""How many threads the linear algebra has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from threading import Lock

from threadpoolctl import ThreadpoolController

_users, _limit, _counting = 0, ExitStack(), Lock()


@lru_cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Do linear algebra with one thread meanwhile, also in other threads of this process.

    Over matrices of some hundred numbers a side several threads only wait for one another.
    """
    global _users
    with _counting:  # the last to leave gives the threads back, whoever came first
        if not _users:
            _limit.enter_context(_libraries().limit(limits=1, user_api="blas"))
        _users += 1
    try:
        yield
    finally:
        with _counting:
            _users -= 1
            if not _users:
                _limit.close()
