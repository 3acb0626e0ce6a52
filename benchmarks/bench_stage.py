"""What the driver adds to a move: time per position minus the time of the emulator's own motion.

pytest benchmarks/bench_stage.py

A shared machine may stand still for longer than a move takes. A thread that does nothing but look
at the clock tells in which moves it did; the others are reported beside all.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from lensshift.capture.drivers.apt import AptSettings, open_apt_stage
from lensshift.capture.emulators.apt import EmulatedStagePair

MOVES = 30
STEP_MM = 0.089  # half a pixel of the first rig
MOST_S = 0.02
STILL_S = 0.02  # between two looks at the clock, 1 ms apart: the machine stood still


@contextmanager
def watching() -> Iterator[list[float]]:
    """Collect the instants at which the machine had stood still."""
    over, seen = threading.Event(), []

    def watch() -> None:
        last_s = time.monotonic()
        while not over.wait(0.001):
            now_s = time.monotonic()
            if now_s - last_s > STILL_S:
                seen.append(now_s)
            last_s = now_s

    thread = threading.Thread(target=watch)
    thread.start()
    yield seen
    over.set()
    thread.join()


@pytest.mark.parametrize("link", ["tcp", "pty"])
def test_driver_adds_little_to_a_move(link: str, report: list[str]) -> None:
    settings = AptSettings(
        home="if_needed", home_velocity_mmps=20.0, acceleration_mmps2=40.0, timeout_margin_s=30.0
    )
    added_s, still = [], []
    with (
        watching() as stood_s,
        EmulatedStagePair(play_mm=0.006, encoder_noise_mm=3e-5, link=link) as pair,
        open_apt_stage(*pair.urls, settings) as stage,
    ):
        stage.move_to([3.0, 3.0])
        for move in range(MOVES):
            before_s = [one.motion_s for one in pair.controllers]
            began_s = time.monotonic()
            stage.move_to([3.0 + STEP_MM * (move % 2), 3.0 + STEP_MM * (move // 2 % 2)])
            took_s = time.monotonic() - began_s
            time.sleep(0.002)  # let the watcher look
            still.append(any(instant > began_s for instant in stood_s))
            moving_s = [one.motion_s for one in pair.controllers]
            added_s.append(took_s - max(np.subtract(moving_s, before_s)))
    smooth_s = np.array(added_s)[~np.array(still)]
    told = f"{1e3 * np.median(added_s):.0f} ms in the median of all {MOVES} moves"
    if smooth_s.size:
        told += f", {1e3 * np.median(smooth_s):.0f} ms in the {smooth_s.size} undisturbed ones"
    report.append(f"stage over {link}: adds {told}")
    # The least: a busy machine adds its own.
    assert min(added_s) < MOST_S
