"""A reconstruction of 640 x 480 x 4 frames x2 stays below its promised peak of memory."""

import re
import subprocess
import sys
from pathlib import Path

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
