"""Linear algebra of small matrices has one thread, and all of them again afterwards."""

import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from lensshift.core.linear_algebra import one_thread
from lensshift.evaluation.slanted_edge import measure_edges


def numbers() -> list[int]:
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]


def test_the_main_thread_has_one_meanwhile_also_twice() -> None:
    with threadpool_limits(2, "blas"):
        before = numbers()
        with one_thread():
            assert set(numbers()) == {1}
            with one_thread():
                assert set(numbers()) == {1}
            assert set(numbers()) == {1}
        assert numbers() == before


def test_another_thread_leaves_them_as_they_are() -> None:
    seen = []

    def work() -> None:
        with one_thread():
            seen.append(numbers())

    with threadpool_limits(2, "blas"):
        before = numbers()
        thread = threading.Thread(target=work)
        thread.start()
        thread.join(20)
        assert seen == [before]
        assert numbers() == before


def test_an_error_gives_them_back_as_well() -> None:
    with threadpool_limits(2, "blas"):
        before = numbers()
        with pytest.raises(ValueError, match="edge"):
            measure_edges(np.zeros((40, 40)))
        assert numbers() == before
