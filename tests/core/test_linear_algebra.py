"""Linear algebra of small matrices has one thread, and all of them again afterwards."""

import os
import subprocess
import sys
from textwrap import dedent

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from lensshift.evaluation.slanted_edge import measure_edges


def test_the_last_to_leave_gives_the_threads_back() -> None:
    """Whoever came first leaves first: what the second saw must not stay.

    In a process of its own, since OpenBLAS does not heed other threads once the main one has asked.
    """
    script = """
        import threading
        import numpy, scipy.linalg
        from threadpoolctl import threadpool_info
        from lensshift.core.linear_algebra import one_thread

        def numbers():
            return [one["num_threads"] for one in threadpool_info()]

        before, seen = numbers(), []
        first_in, second_in, first_out = (threading.Event() for _ in range(3))

        def first():
            with one_thread():
                first_in.set()
                second_in.wait(10)
            seen.append(numbers())
            first_out.set()

        def second():
            first_in.wait(10)
            with one_thread():
                second_in.set()
                first_out.wait(10)
            seen.append(numbers())

        threads = [threading.Thread(target=work) for work in (first, second)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(20)
        assert seen == [[1] * len(before), before], (before, seen)
        """
    run = subprocess.run(
        [sys.executable, "-c", dedent(script)],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2"}, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr


def test_an_error_gives_them_back_as_well() -> None:
    def numbers() -> list[int]:
        return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]

    with threadpool_limits(2, "blas"):
        before = numbers()
        with pytest.raises(ValueError, match="edge"):
            measure_edges(np.zeros((40, 40)))
        assert numbers() == before
