"""Damaged files of every kind are read or refused: no traceback, no hang, no swollen memory."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("fuzz_files.py")


def fuzz(folder: Path, count: int, seed: int) -> None:
    command = [sys.executable, str(SCRIPT), str(folder), str(count), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    outcomes = json.loads(done.stdout.splitlines()[-1])
    assert {name: set(seen) - {"read", "refused"} for name, seen in outcomes.items()} == {
        name: set() for name in outcomes
    }
    assert sum(sum(seen.values()) for seen in outcomes.values()) >= count
    assert all(seen["refused"] for seen in outcomes.values())  # the damage was felt


@pytest.mark.skipif(os.name == "nt", reason="no such alarm there")
def test_damaged_files_of_every_kind(tmp_path: Path) -> None:
    fuzz(tmp_path, 400, seed=11)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no such alarm there")
def test_ten_thousand_damaged_files(tmp_path: Path) -> None:
    fuzz(tmp_path, 10_000, seed=12)
