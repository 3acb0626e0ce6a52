"""Ctrl-C, once and again, while the lens is on its way back."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="no such signals there")

PROGRAM = """
import signal, sys, time
import numpy as np
import typer
from lensshift.capture.acquire import returning
from lensshift.cli.session import session

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under nohup

class Stage:
    name = "slow"
    at = 0.0
    def move_to(self, position_mm, *, direct=False):
        print("returning", flush=True)
        for step in range(10):
            time.sleep(0.1)
            self.at = step
        print("at rest", flush=True)
    def position_mm(self):
        return np.array([self.at, self.at])
    def stop(self):
        print("stop", flush=True)

try:
    with session(as_json=False, debug=False), returning(Stage(), [9.0, 9.0]):
        print("capturing", flush=True)
        if len(sys.argv) > 1:
            time.sleep(60.0)
except typer.Exit as end:
    sys.exit(end.exit_code)
"""


def run(steps: list[tuple[str, str]], *arguments: str) -> tuple[int, list[str], str]:
    """Run the program; send each signal when its line is said; return status, lines, stderr."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        lines = list(_with_signals(process, steps))
        said = process.stderr.read()
    return process.returncode, lines, said


def _with_signals(process: "subprocess.Popen[str]", steps: list[tuple[str, str]]) -> Iterator[str]:
    assert process.stdout is not None
    assert process.stderr is not None
    for line in process.stdout:
        yield line.strip()
        while steps and steps[0][0] == line.strip():
            process.send_signal(getattr(signal, steps.pop(0)[1]))
            if steps and steps[0][0] == "told":
                assert "Ctrl-C once more leaves it" in process.stderr.readline()
                process.send_signal(getattr(signal, steps.pop(0)[1]))


@pytest.mark.parametrize("first", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_second_signal_waits_until_the_lens_is_back(first: str) -> None:
    code, lines, said = run([("capturing", first), ("returning", first)], "wait")
    assert lines == ["capturing", "stop", "returning", "at rest"]
    assert code == (130 if first == "SIGINT" else 128 + getattr(signal, first))
    assert "on its way back to rest" in said
    assert "Traceback" not in said


def test_ctrl_c_during_the_return_of_a_capture_that_is_done() -> None:
    code, lines, said = run([("returning", "SIGINT")])
    assert lines == ["capturing", "returning", "at rest"]
    assert code == 130
    assert "Traceback" not in said


def test_a_third_ctrl_c_leaves_the_lens_and_says_where() -> None:
    steps = [("capturing", "SIGINT"), ("returning", "SIGINT"), ("told", "SIGINT")]
    code, lines, said = run(steps, "wait")
    assert lines == ["capturing", "stop", "returning", "stop"]
    assert code == 130
    assert "interrupted: the lens stands at" in said
    assert "rest is 9.0000, 9.0000 mm" in said
