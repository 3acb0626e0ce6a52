"""A reconstruction of 640 x 480 x 4 frames x2 stays below its promised peak of memory."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "memory.py"
LIMIT_MB = 800


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "irwsr"])
def test_peak_memory(method: str) -> None:
    command = [sys.executable, str(SCRIPT), method]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = re.search(r"peak (\d+) MB", done.stdout)
    assert found is not None
    assert 100 < int(found[1]) < LIMIT_MB


STREAM = """
import warnings, numpy as np, lensshift
warnings.simplefilter("ignore")
square = [(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)]
camera, rng = lensshift.stream(square, shape=(6, 9), modulation_hz=15e6), np.random.default_rng(0)
for step in range(6001):
    light = (1.5 if step % 500 > 250 else 1.0) + 0.01 * rng.standard_normal((6, 9))
    camera.step(light * np.exp(1j + 0.01j * rng.standard_normal((6, 9))))
    if step and step % 1000 == 0:
        with open("/proc/self/statm") as file:
            print(int(file.read().split()[1]) * 4096)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc to read memory from")
def test_a_stream_does_not_grow() -> None:
    """A scene that changes each 250 steps: asked are 2 MB in 4.3 million steps.

    A leak grows in each of the five spans of 1000 steps; the allocator takes a step in one.
    """
    done = subprocess.run(
        [sys.executable, "-c", STREAM], capture_output=True, text=True, check=True
    )
    growth = np.diff([int(line) for line in done.stdout.split()])
    assert len(growth) == 5
    assert np.median(growth) < 33_000
