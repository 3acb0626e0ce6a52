"""Fixtures that several test folders share."""

import os
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial.urlhandler.protocol_socket
import typer.testing
from hypothesis import settings

# Each core has a worker already. The threads of their linear algebra would wait for one another
# over matrices far too small to share: four times the processor time. Read when numpy is imported,
# and by all processes that tests start.
for library in ("OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Whoever starts the tests may ignore the end of a terminal (nohup), and so would all they start.
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Times mean nothing on a shared machine, and the first call of a kernel compiles it.
settings.register_profile("lensshift", deadline=None, max_examples=20)
settings.load_profile("lensshift")

REFERENCE_VARIABLE = "LENSSHIFT_REFERENCE"


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    """Return the folder of reference data; skip the test where there is none."""
    beside_the_repository = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get(REFERENCE_VARIABLE, beside_the_repository))
    if not folder.is_dir():
        pytest.skip(f"no reference data; set {REFERENCE_VARIABLE} to the folder that holds them")
    return folder


@pytest.fixture(autouse=True, scope="session")
def sockets_close_at_once() -> Iterator[None]:
    """After it has closed a socket, pyserial sleeps 0.3 s for servers that are slow to listen.

    An emulated stage has two sockets, it listens all the time, and many tests open one.
    """
    with pytest.MonkeyPatch.context() as patch:
        at_once = SimpleNamespace(sleep=lambda seconds: None)
        patch.setattr(serial.urlhandler.protocol_socket, "time", at_once)
        yield


@pytest.fixture(autouse=True, scope="session")
def commands_are_built_once() -> Iterator[None]:
    """Typer makes all commands anew for each call, which takes longer than many of them do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.testing, "_get_command", cache(typer.testing._get_command))
        yield
