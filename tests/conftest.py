"""Fixtures that several test folders share."""

import gc
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import serial.urlhandler.protocol_socket
import typer.testing
from hypothesis import settings

from lensshift.core.threads import core_count

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


# Workers begin at even distances in this order: two take as long for what stands before the tests
# of the top folder as for the rest (tests that need long are not among the last, where they would
# be waited for), and kernels, which a new clone compiles, that few tests of other parts need too.
ORDER = (
    "camera", "optics", "evaluation", "report", "capture", "cli", "core", "scene", "tests",
    "reconstruction", "registration", "pipeline", "live", "io", "forward",
)  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    """Keep byte code beside the results of earlier runs, where Python shall write none.

    Else every worker, and each of the many processes that tests start, would make anew that of
    all that it imports: two thirds of the time of a command.
    """
    if not (sys.dont_write_bytecode and hasattr(config, "cache")):
        return
    with suppress(OSError):  # nothing may be written there: then as ever
        folder = str(config.cache.mkdir("bytecode"))
        sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = folder
        sys.dont_write_bytecode = False
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the folders into their order."""
    places = {folder: place for place, folder in enumerate(ORDER)}
    items.sort(key=lambda item: places.get(item.path.parent.name, len(ORDER)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return one worker more than cores: a fifth of the time tests wait for stages and cameras."""
    return core_count() + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Leave the tests of a file to one worker: what they compute once is computed once."""
    if config.getoption("dist") != "load":  # which -n alone means
        return None
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


def pytest_collection_finish() -> None:
    """Look for garbage less often, and not among what has come so far, which stays to the end."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(5_000, 20, 10)  # of 700, 10 and 10: a tenth of all time went into it


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
