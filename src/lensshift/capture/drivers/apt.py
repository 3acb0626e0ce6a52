"""Driver of two Z806 actuators on Thorlabs TDC001 or KDC101 controllers, as a stage.

Written against the protocol and an emulator of it, not yet run on the real devices.
"""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.capture.drivers.apt_axis import AptAxis
from lensshift.capture.drivers.apt_cube import find_port
from lensshift.capture.drivers.apt_settings import PLACING, AptSettings
from lensshift.capture.rig import OnHoming, goal_within
from lensshift.core.arrays import Floats
from lensshift.core.ending import Closing
from lensshift.core.errors import DeviceError

__all__ = ["AptAxis", "AptSettings", "AptStage", "open_apt_stage"]


def open_apt_stage(
    row: str,  # USB serial number ("83000001"), device path, or any URL of pyserial
    col: str,  # as of row
    settings: AptSettings | None = None,
    on_homing: OnHoming | None = None,  # hears how far each axis goes to be homed, gives leave
) -> AptStage:
    """Connect both controllers, write their parameters, enable them, and home them if allowed.

    ValueError if both axes are one device. DeviceError if a device cannot be found, opened, set up
    or homed, or must not be homed; nothing stays open.
    """
    settings = settings or AptSettings()
    ports = find_port(row), find_port(col)
    if os.path.realpath(ports[0]) == os.path.realpath(ports[1]):
        raise ValueError(f"expected two devices, got {row!r} and {col!r}, which are one")
    with ExitStack() as opened:
        axes = []
        for axis, port in enumerate(ports):
            axes.append(AptAxis(port, settings, axis))
            opened.callback(axes[-1].close)
        if axes[0].name == axes[1].name:
            raise DeviceError("both axes are this device", device=axes[0].name, command="open")
        stage = AptStage(axes[0], axes[1], settings)
        stage.prepare(on_homing)
        opened.pop_all()
    return stage


class AptStage(Closing):
    """Two axes that move at once, each in its one direction at last; see the protocol `Stage`.

    Whatever ends a move before it is done, an error or Ctrl-C, stops both.
    """

    def __init__(self, row: AptAxis, col: AptAxis, settings: AptSettings) -> None:
        self.settings = settings
        self.axes = row, col
        self.name = f"{row.name}, {col.name}"

    @property
    def travel_mm(self) -> Floats:
        """[2 2] (axis; lowest, highest) position that leaves room for the approach."""
        return np.array([self.settings.reachable_mm(axis) for axis in (0, 1)])

    @property
    def approach_mm(self) -> Floats:
        """[2] length of the run-up, negative where every move ends backward."""
        return np.array([self.settings.run_up_mm(axis) for axis in (0, 1)])

    def prepare(self, on_homing: OnHoming | None = None) -> None:
        """Write all parameters and read them back, enable, and home if the settings say so."""
        for axis in self.axes:
            axis.prepare()
        wanted = self.settings.home
        if wanted == "never" or (wanted != "always" and all(axis.homed for axis in self.axes)):
            return
        way = f"row: {self.axes[0].homing_way()}; col: {self.axes[1].homing_way()}"
        allowed = on_homing is not None and on_homing(way, wanted == "ask")
        if wanted == "ask" and not allowed:
            raise DeviceError(
                'nobody has allowed it: use --yes or home = "if_needed" in the rig file, or open '
                f'with home = "never". It would move them ({way})',
                device=self.name,
                command="home",
            )
        self.home()

    def home(self) -> Floats:
        """Let both axes look for their zero at once, return the position [2]; or stop both."""
        return self._together([axis.homing() for axis in self.axes])

    def position_mm(self) -> Floats:
        """Return the position [2] read back, also while it moves and from another thread."""
        return np.array([axis.position_mm() for axis in self.axes])

    def move_to(self, position_mm: ArrayLike, *, direct: bool = False) -> Floats:
        """Move both axes at once; see `Stage.move_to`."""
        goal_mm = goal_within(self.travel_mm, position_mm).tolist()
        pairs = zip(self.axes, goal_mm, strict=True)
        return self._together([axis.moves(goal, direct=direct) for axis, goal in pairs])

    def stop(self) -> None:
        """Stand still at once. Never raises for a stage that is gone."""
        self._halt()
        for axis in self.axes:
            axis.stop()

    def close(self) -> None:
        """Stop and let go of both ports; a second call does nothing."""
        self._halt()
        for axis in self.axes:
            axis.close()

    def _halt(self) -> None:
        # Both are told before one is waited for: it may not answer.
        for axis in self.axes:
            axis.halt()

    def describe(self) -> Mapping[str, Any]:
        """Return what each axis is, `settings` that decide where a position lies, and others."""
        row, col = (axis.describe() for axis in self.axes)
        motion = asdict(self.settings)
        settings = {name: motion.pop(name) for name in PLACING}
        about = {"name": self.name, "row": row, "col": col}
        return about | {"settings": settings, "motion": motion}

    def _together(self, moves: list[Generator[float, None, float]]) -> Floats:
        """Step all moves until each has its result; stop both axes if that is cut short."""
        reached_mm = np.full(len(moves), np.nan)
        under_way = dict(enumerate(moves))
        try:
            while under_way:
                waits_s = []
                for axis, move in list(under_way.items()):
                    try:
                        waits_s.append(next(move))
                    except StopIteration as done:
                        reached_mm[axis] = done.value
                        del under_way[axis]
                time.sleep(min(waits_s, default=0.0))
        finally:
            if under_way:
                self.stop()
        return reached_mm
