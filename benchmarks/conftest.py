"""One thread for every library, so that ratios compare work and not cores; ratios at the end."""

import os

# Before NumPy is imported: its BLAS reads them once.
for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import pytest

LINES: list[str] = []


@pytest.fixture
def report() -> list[str]:
    """Return the lines that are printed after the benchmarks."""
    return LINES


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if LINES:
        terminalreporter.section("compared in this run, one thread, median times")
        for line in LINES:
            terminalreporter.write_line(line)
