"""What a device must do to be part of a rig: two protocols, no base classes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats
from lensshift.core.grid import Grid
from lensshift.core.types import Frame

# Called before axes look for their zero, with how far each will go and whether leave is asked for:
# then they stay where they are unless it returns True.
OnHoming = Callable[[str, bool], bool]


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """A frame as it came from a camera.

    Parameters
    ----------
    frame : amplitude (normalised), distance, validity; `time_s` is the camera's clock where it
        has one, else the host's
    cycle : number of the frame by the camera's own counter, unwrapped, so that it only grows
    arrived_s : `time.monotonic()` when its last byte had come
    raw : name -> [row col] or other arrays, as the camera sent them
    """

    frame: Frame
    cycle: int
    arrived_s: float
    raw: Mapping[str, Array] = field(default_factory=dict)


def goal_within(travel_mm: Floats, position_mm: ArrayLike) -> Floats:
    """Return where a stage is sent [2]; raise a ValueError if that is out of its travel [2 2]."""
    goal_mm = np.asarray(position_mm, dtype=np.float64)
    low_mm, high_mm = travel_mm.T
    if goal_mm.shape != (2,) or not np.all((goal_mm >= low_mm) & (goal_mm <= high_mm)):
        reach = " and ".join(f"{a:g} .. {b:g}" for a, b in travel_mm)
        raise ValueError(f"expected a position [2] within {reach} mm, got {goal_mm.tolist()}")
    return goal_mm


class Stage(Protocol):
    """Two axes that move the lens; positions are (row, col) in millimetres.

    Axis `row` is the one that moves the image mostly along rows (up and down).
    """

    @property
    def name(self) -> str:
        """What the stage is called in messages."""

    @property
    def travel_mm(self) -> Floats:
        """[2 2] (axis; lowest, highest) position that it goes to."""

    def position_mm(self) -> Floats:
        """Return the position [2] read back from the device, also while it moves."""

    def move_to(self, position_mm: ArrayLike, *, direct: bool = False) -> Floats:
        """Move both axes at once, wait until settled, return the position read back.

        Every move ends in the same direction, so that play lies on one side; with `direct` it goes
        straight there, as a calibration that measures the play needs it.

        Raises
        ------
        ValueError
            If the position lies outside `travel_mm`.
        DeviceError
            If the stage fails; it has been stopped. `DeviceTimeout` if it takes too long.
        """

    def stop(self) -> None:
        """Stand still at once. Never raises for a stage that is gone."""

    def close(self) -> None:
        """Stop and let go of the device; a second call does nothing."""

    def describe(self) -> Mapping[str, Any]:
        """Return what to keep beside the frames: model, serial, firmware, settings."""


class Camera(Protocol):
    """A source of frames that runs by itself, at its own rate.

    Receiving goes on in the background from `open` to `close`; frames that nobody fetches are
    dropped, oldest first, and counted.
    """

    @property
    def name(self) -> str:
        """What the camera is called in messages."""

    @property
    def grid(self) -> Grid:
        """Shape and pitch of the frames."""

    @property
    def modulation_hz(self) -> float | None:
        """Modulation frequency of the distance, if it is known."""

    def open(self) -> None:
        """Begin to receive.

        Raises
        ------
        DeviceError
            If the device or its port cannot be had.
        """

    def newest_cycle(self) -> int:
        """Return the counter of the newest frame that has begun to arrive, -1 before the first."""

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the oldest whole frame not yet fetched; wait for one if there is none.

        Raises
        ------
        DeviceTimeout
            If none came in time; the message says why (nothing arrives, only parts of frames,
            another mode or version).
        DeviceError
            If the camera has gone or has started anew.
        """

    def counts(self) -> Mapping[str, int]:
        """Return what came and what was lost since `open`: frames, lost_packets, and so on."""

    def close(self) -> None:
        """Stop receiving and let go of the device; a second call does nothing."""

    def describe(self) -> Mapping[str, Any]:
        """Return what to keep beside the frames: model, firmware, settings, factors."""
