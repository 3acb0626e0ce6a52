"""What the driver adds to a move: time per position minus the time of the emulator's own motion.

pytest benchmarks/bench_stage.py
"""

import time

import numpy as np
import pytest

from lensshift.capture.drivers.apt import AptSettings, open_apt_stage
from lensshift.capture.emulators.apt import EmulatedStagePair

MOVES = 30
STEP_MM = 0.089  # half a pixel of the first rig
MOST_S = 0.02


@pytest.mark.parametrize("link", ["tcp", "pty"])
def test_driver_adds_little_to_a_move(link: str, report: list[str]) -> None:
    settings = AptSettings(home_velocity_mmps=20.0, acceleration_mmps2=40.0, timeout_margin_s=30.0)
    added_s = []
    with (
        EmulatedStagePair(play_mm=0.006, encoder_noise_mm=3e-5, link=link) as pair,
        open_apt_stage(*pair.urls, settings) as stage,
    ):
        stage.move_to([3.0, 3.0])
        for move in range(MOVES):
            before_s = [one.motion_s for one in pair.controllers]
            began_s = time.monotonic()
            stage.move_to([3.0 + STEP_MM * (move % 2), 3.0 + STEP_MM * (move // 2 % 2)])
            took_s = time.monotonic() - began_s
            moving_s = [one.motion_s for one in pair.controllers]
            added_s.append(took_s - max(np.subtract(moving_s, before_s)))
    least, median = np.quantile(added_s, [0.0, 0.5])
    report.append(
        f"stage over {link}: {1e3 * least:.0f} ms added at least, {1e3 * median:.0f} in the median"
    )
    # The least: a busy machine adds its own.
    assert least < MOST_S
