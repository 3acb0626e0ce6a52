"""CPU time of starting: `import lensshift` (limit 0.3 s), `lensshift --help` (limit 0.5 s).

And of a first reconstruction after an installation, which compiles, beside a second process.

pytest benchmarks/bench_startup.py
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CASES = {
    "python": "pass",
    "import numpy": "import numpy",
    "import lensshift": "import lensshift",
    "lensshift --help": (
        "import sys; sys.argv = ['lensshift', '--help']; from lensshift.cli import main; main()"
    ),
}


def cpu_s(code: str) -> float:
    """Return the least CPU time, user and system, of seven fresh interpreters."""
    taken_s = []
    for _ in range(7):
        before = os.times()
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        after = os.times()
        user_s = after.children_user - before.children_user
        taken_s.append(user_s + after.children_system - before.children_system)
    return min(taken_s)


def test_startup(report: list[str]) -> None:
    taken_s = {name: cpu_s(code) for name, code in CASES.items()}
    report.extend(f"{name:<18s} {value:6.3f} s CPU, least of 7" for name, value in taken_s.items())
    assert taken_s["import lensshift"] < taken_s["import numpy"]


FIRST = """
import sys, numpy as np, lensshift
rng = np.random.default_rng(0)
y = rng.random((4, 16, 64))
shifts = [(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)]
more = dict(distance_m=3 + 0.01 * y, modulation_hz=15e6) if sys.argv[1] == "phasor" else {}
lensshift.reconstruct(lensshift.Burst.from_arrays(y, offset_px=shifts, pitch_mm=0.1, **more))
"""


@pytest.mark.parametrize("kind", ["amplitude", "phasor"])
def test_first_reconstruction(report: list[str], tmp_path: Path, kind: str) -> None:
    taken_s = []
    for _ in range(2):
        before = os.times()
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", FIRST, kind], check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        after = os.times()
        user_s = after.children_user - before.children_user
        taken_s.append(user_s + after.children_system - before.children_system)
    report.append(
        f"{kind}, a burst of 16 x 64: {taken_s[0]:.1f} s CPU with an empty cache of compiled "
        f"code, {taken_s[1]:.1f} s in a second process"
    )
    assert taken_s[1] < taken_s[0]
