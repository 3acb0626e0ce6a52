"""Starting costs little: `import lensshift` and `lensshift --help` load nothing heavy."""

import json
import os
import subprocess
import sys

import pytest

HEAVY = ("scipy", "matplotlib", "xarray", "numba", "h5py", "h5netcdf", "PIL", "skimage", "tifffile")
IMPORT_LIMIT_S = 0.3
HELP_LIMIT_S = 0.5

MODULES_AFTER_IMPORT = "import json, sys, lensshift; print(json.dumps(sorted(sys.modules)))"
HELP = "from lensshift.cli import main; main()"


def cpu_s(code: str, *arguments: str) -> float:
    """Return the least CPU time, user and system, of three fresh interpreters."""
    taken_s = []
    for _ in range(3):
        before = os.times()
        subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True)
        after = os.times()
        taken_s.append(
            after.children_user
            - before.children_user
            + after.children_system
            - before.children_system
        )
    return min(taken_s)


def test_import_loads_nothing_heavy() -> None:
    command = [sys.executable, "-c", MODULES_AFTER_IMPORT]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    loaded = set(json.loads(done.stdout))
    assert "lensshift" in loaded
    assert loaded & set(HEAVY) == set()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="CPU time of child processes needs POSIX")
def test_import_costs_little_more_than_numpy() -> None:
    numpy_s = cpu_s("import numpy")
    assert cpu_s("import lensshift") - numpy_s < IMPORT_LIMIT_S


@pytest.mark.skipif(not hasattr(os, "fork"), reason="CPU time of child processes needs POSIX")
def test_help_is_quick() -> None:
    assert cpu_s(HELP, "--help") < HELP_LIMIT_S
