"""Captures that are ended at any moment, again and again, by whatever ends processes."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_faults import Bench

from lensshift import load_burst
from lensshift.core.errors import DataError

pytestmark = pytest.mark.skipif(os.name == "nt", reason="no such signals there")
COMMAND = [sys.executable, "-c", "from lensshift.cli import main; main()", "capture"]
FRAMES = 4  # at each of nine positions
LONGEST_S = 5.0  # from the start of a process until it is killed
POSITION = re.compile(r"^position (\d+) of 9", re.MULTILINE)
SCAN_S = 1.0  # from its first position to its last, on a quiet machine


def frames_in(file: Path) -> int:
    try:
        return load_burst(file).frame_count
    except DataError as error:
        expected = ("no such file", "is empty", "no whole frame", "whole header")
        if not any(one in str(error) for one in expected):
            raise
        return 0


def killed(bench: Bench, number: int, after_s: float, *, under_way: bool) -> tuple[int, int, str]:
    """Resume the capture, kill it after a while; return its status, frames told of, and words.

    Parameters
    ----------
    under_way : count from the first finished position on, not from the start of the process
    """
    command = [*COMMAND, str(bench.file), "--plan", "3x3", "--frames", str(FRAMES), "--resume"]
    process = subprocess.Popen(
        [*command, "-o", str(bench.out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    assert process.stderr is not None
    said = ""
    while under_way and not POSITION.search(said):
        line = process.stderr.readline()
        assert line, f"it ended before its first position: {said}"
        said += line
    time.sleep(after_s)
    process.send_signal(number)
    with process:  # which may be read from: it writes to nothing else
        said += process.stderr.read()
    # Python reports, and swallows, what a signal raises while it cleans up an object.
    assert "Traceback" not in said or "Exception ignored" in said, said
    done = POSITION.findall(said)
    return process.returncode, FRAMES * len(done), said


def kill_often(bench: Bench, count: int, seed: int, *, under_way: bool = False) -> None:
    rng = random.Random(seed)
    longest_s = SCAN_S if under_way else LONGEST_S
    signals = [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP]
    whole = at_rest = 0
    bench.file.write_text(bench.file.read_text() + "reorder = false\n")
    for turn in range(count):
        number = signals[turn % 3] if under_way else rng.choice(signals)
        before = frames_in(bench.out)
        after_s = rng.uniform(0.0, longest_s)
        status, told, said = killed(bench, number, after_s, under_way=under_way)
        after = frames_in(bench.out)
        assert after >= before + told - FRAMES  # the first position told of may have been there
        assert after >= before, "a finished frame is lost"
        assert status in (0, -number, 128 + number), said
        if number != signal.SIGKILL:
            assert bench.still()
            if told:  # it had been homed, and under way
                np.testing.assert_allclose(bench.stages.lens_mm(), 3.0, atol=0.007)
                at_rest += 1
        if after == 9 * FRAMES:
            burst = load_burst(bench.out)
            steps = burst.meta["step"]
            assert sorted(steps) == sorted(list(range(9)) * FRAMES)
            bench.out.unlink()
            whole += 1
    assert [one.name for one in bench.out.parent.iterdir() if one.suffix == ".part"] == []
    if under_way or count >= 20:
        assert at_rest > 0
    if count >= 20:
        assert whole > 0


@pytest.fixture
def bench(tmp_path: Path):  # type: ignore[no-untyped-def]
    made = Bench(tmp_path)
    with made.stages, made.camera:
        made.start()
        yield made


def test_a_few_kills_at_random_moments(bench: Bench) -> None:
    kill_often(bench, 2, seed=1, under_way=True)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_two_hundred_kills_at_random_moments(bench: Bench) -> None:
    kill_often(bench, 200, seed=2)
