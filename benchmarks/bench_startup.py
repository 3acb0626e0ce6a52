"""CPU time of starting: `import lensshift` (limit 0.3 s), `lensshift --help` (limit 0.5 s).

pytest benchmarks/bench_startup.py
"""

import os
import subprocess
import sys

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
