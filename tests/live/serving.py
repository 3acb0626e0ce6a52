"""Sources that need no device, and the page of a running server."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensshift import Burst
from lensshift.camera import Sensor, simulate_burst
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Pinhole
from lensshift.live.picture import Settings
from lensshift.live.sources import BurstSource, Source
from lensshift.live.worker import Live
from lensshift.scene import demo_target

SQUARE_PX = ((-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25))
SHAPE = (12, 16)


def taken() -> Burst:
    """Return four small frames with distances, which say where they look."""
    grid = Grid(SHAPE, (0.155, 0.155))
    size_mm = (SHAPE[0] * 0.155, SHAPE[1] * 0.155)
    seen, _ = simulate_burst(demo_target(size_mm), Sensor(grid), SQUARE_PX, seed=1)
    return Burst.from_arrays(
        seen.amplitude,
        3.0 + 0.2 * seen.amplitude,
        offset_px=seen.offset_px,
        pitch_mm=0.155,
        intrinsics=Pinhole.of_field(grid, 0.5),
    )


def unpacked(data: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the head of a message and its layers [row col], NaN where nothing is known."""
    length = int.from_bytes(data[:4], "little")
    head, start, layers = json.loads(data[4 : 4 + length]), 4 + length, {}
    for one in head.get("layers", []):
        count = one["rows"] * one["cols"]
        codes = np.frombuffer(data, "<u2", count, start).reshape(one["rows"], one["cols"])
        values = one["low"] + (codes.astype(np.float64) - 1.0) * one["step"]
        layers[one["name"]] = np.where(codes > 0, values, np.nan)
        start += 2 * count
    return head, layers


def until(what: Callable[[], object], seconds: float = 60.0) -> None:
    end_s = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end_s, "nothing came"
        time.sleep(0.01)


def source_of(burst: Burst, rate_hz: float = 20.0) -> BurstSource:
    return BurstSource(burst, "frames", rate_hz=rate_hz)


def measures_for_ever(*_: object) -> None:
    time.sleep(1e4)


QUICK = Settings(2, "bicubic")


@contextmanager
def served(source: Source, folder: Path, settings: Settings = QUICK) -> Iterator[tuple[str, Live]]:
    """Serve in a thread; yield the address and the worker."""
    pytest.importorskip("uvicorn", reason="the extra live is not installed")
    from lensshift.live.serve import listening, serve

    address: list[str] = []
    ending: list[Callable[[], None]] = []
    with Live(source, settings) as live, listening("127.0.0.1", 0) as listener:
        thread = threading.Thread(
            target=serve,
            args=(live, listener, folder),
            kwargs={"on_ready": address.append, "on_start": ending.append},
        )
        thread.start()
        try:
            until(lambda: address)
            yield address[0], live
        finally:
            ending[0]()
            thread.join()
