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


SWALLOWED = """
import signal, sys
from lensshift.core.ending import ended_by_signals

class Cleaned:
    def __del__(self):
        signal.raise_signal(signal.SIGTERM)

with ended_by_signals() as ending:
    one = Cleaned()
    del one
    print("goes on", flush=True)
    if len(sys.argv) > 1:
        ending.check()
    print("ends", flush=True)
"""


@pytest.mark.parametrize(
    ("arguments", "said"), [(["look"], ["goes on"]), ([], ["goes on", "ends"])]
)
def test_a_signal_that_python_swallows_is_not_lost(arguments: list[str], said: list[str]) -> None:
    """What a handler raises while an object is cleaned up goes nowhere; so it is looked for."""
    command = [sys.executable, "-c", SWALLOWED, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.split("\n")[:-1] == said
    assert done.returncode == 128 + signal.SIGTERM


HALF_DONE = """
import io, signal, zipfile
from lensshift.core.ending import ended_by_signals

with ended_by_signals():
    with zipfile.ZipFile(io.BytesIO(), "w") as file:  # a frame's arrays are packed so
        entry = file.open("frame", "w")
        signal.raise_signal(signal.SIGTERM)
"""


def test_what_a_signal_leaves_half_done_does_not_hide_it() -> None:
    """A ZIP file that is being written cannot be closed, and says so instead of the signal."""
    command = [sys.executable, "-c", HALF_DONE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGTERM
    assert done.stderr == ""


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
