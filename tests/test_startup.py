"""Starting costs little: `import lensshift` and `lensshift --help` load next to nothing.

What is loaded decides the time and, unlike the time, is the same on every machine; seconds are
measured by benchmarks/bench_startup.py.
"""

import json
import subprocess
import sys

LOADED = """
import json, sys
files = ((name.partition(".")[0], getattr(module, "__file__", None) or "")
         for name, module in list(sys.modules.items()))
print(json.dumps(sorted({name for name, file in files if "site-packages" in file})))
print(len(sys.modules))
"""
IMPORT = "import lensshift\n"
HELP = """
import sys
from lensshift.cli import main
sys.argv = ["lensshift", "--help"]
try:
    main()
except SystemExit:
    pass
"""
# Typer and what it needs. An editable install and the test run's own coverage add the rest.
LIGHT = {"typer", "click", "annotated_doc", "shellingham", "typing_extensions", "colorama"}
OF_THE_TEST_RUN = {"_distutils_hack", "coverage", "sitecustomize", "a1_coverage", "lensshift"}
# The two take 70 and 170 modules, nearly all of the standard library; NumPy alone has 150.
MOST_AFTER_IMPORT, MOST_AFTER_HELP = 150, 300


def loaded(code: str) -> tuple[set[str], int]:
    """Return the packages outside the standard library, and the count of modules, after code."""
    command = [sys.executable, "-c", code + LOADED]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    packages, count = done.stdout.splitlines()[-2:]
    return set(json.loads(packages)), int(count)


def test_import_loads_nothing_of_others() -> None:
    packages, count = loaded(IMPORT)
    assert packages <= OF_THE_TEST_RUN
    assert count < MOST_AFTER_IMPORT


def test_help_loads_typer_alone() -> None:
    packages, count = loaded(HELP)
    assert "typer" in packages
    assert packages <= LIGHT | OF_THE_TEST_RUN
    assert count < MOST_AFTER_HELP


def test_folders_are_there_without_another_import() -> None:
    told = "import lensshift\nprint(lensshift.io.napari_layers.__name__, lensshift.report.__name__)"
    done = subprocess.run([sys.executable, "-c", told], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["napari_layers", "lensshift.report"]
