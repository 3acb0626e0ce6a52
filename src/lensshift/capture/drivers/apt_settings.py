"""How a pair of Z806 actuators is to be moved: units, speeds, limits, patience."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Direction = Literal["forward", "backward"]
Homing = Literal["ask", "if_needed", "always", "never"]

# Z8 actuators: 512 counts per turn of the motor, a gear of 67.49:1, 1 mm per turn of the screw; so
# the APT protocol since 2022. Older papers round the gear to 67:1, which gives 34304 (0.73 % less).
Z8_COUNTS_PER_MM = 34554.96

_MOST_MM = 300.0  # the longest stages that speak APT; Z8 actuators go 12 to 25 mm, MTS stages 50
# Beyond anything that a Z8 does, or anybody waits for: another unit, or a slip of the keys.
_BOUNDS: dict[str, tuple[float, float]] = {
    "counts_per_mm": (1.0, 1e6), "velocity_mmps": (1e-3, 100.0), "acceleration_mmps2": (1e-3, 1e3),
    "home_velocity_mmps": (1e-3, 100.0), "home_offset_mm": (0.0, _MOST_MM),
    "approach_mm": (0.0, _MOST_MM), "tolerance_mm": (0.0, 1.0), "settle_polls": (2, 1000),
    "max_retries": (1, 1000), "reply_timeout_s": (1e-3, 60.0), "enable_wait_s": (0.0, 60.0),
    "timeout_margin_s": (0.0, 3600.0),
}  # fmt: skip
# Of `AptSettings`, what a position in mm means; the others say how it is reached.
PLACING = ("counts_per_mm", "home_offset_mm", "approach_direction")


@dataclass(frozen=True, slots=True, kw_only=True)
class AptSettings:
    """What is written to both controllers, and when a position counts as reached."""

    counts_per_mm: float | tuple[float, float] = Z8_COUNTS_PER_MM  # of both axes or (row, col)
    velocity_mmps: float = 2.3  # of every move, as the acceleration
    acceleration_mmps2: float = 4.0
    home_velocity_mmps: float = 1.0  # while looking for the zero
    home_offset_mm: float = 0.3  # from the switch to the zero
    # Look for the zero on opening, which takes the lens to the end of its way: after asking if a
    # controller does not know it ("ask"), so without asking ("if_needed"), "always", "never".
    home: Homing = "ask"
    # Every position is reached by a move of at least this length in one direction, so that the play
    # behind the encoder always lies on one side; longer than the play.
    approach_mm: float = 0.02
    # For both axes or (row, col): against the weight of the lens where an axis lifts it, against
    # the spring of a mount.
    approach_direction: Direction | tuple[Direction, Direction] = "forward"
    travel_mm: tuple[float, float] = (0.0, 6.0)  # (lowest, highest) the motor may go to
    tolerance_mm: float = 0.001  # a position is reached within this
    settle_polls: int = 3  # replies in a row that must say so, or whatever else is acted on
    max_retries: int = 10  # of a message or a move that went wrong
    reply_timeout_s: float = 0.1
    enable_wait_s: float = 1.0  # the TDC001 locks up if it is sent home sooner after enabling
    timeout_margin_s: float = 2.0  # a move may last half as long again as it should, and this

    def __post_init__(self) -> None:
        if not isinstance(self.counts_per_mm, int | float) and len(self.counts_per_mm) != 2:
            raise ValueError(f"expected counts_per_mm or two of them, got {self.counts_per_mm}")
        told = {name: getattr(self, name) for name in _BOUNDS if name != "counts_per_mm"}
        told |= {f"counts_per_mm[{axis}]": self.scale(axis) for axis in (0, 1)}
        told |= {f"travel_mm[{end}]": place for end, place in enumerate(self.travel_mm)}
        for name, value in told.items():
            low, high = _BOUNDS.get(name.partition("[")[0], (-_MOST_MM, _MOST_MM))
            if not low <= value <= high:  # nor if it is no number
                raise ValueError(f"expected {name} of {low:g} to {high:g}, got {value}")
        if self.tolerance_mm * min(self.scale(0), self.scale(1)) < 1.0:
            raise ValueError(f"expected tolerance_mm of a count at least, got {self.tolerance_mm}")
        ways = [("approach_direction", self.direction(axis), Direction) for axis in (0, 1)]
        for name, value, known in [("home", self.home, Homing), *ways]:
            if value not in get_args(known):
                raise ValueError(f"expected {name} of {get_args(known)}, got {value!r}")
        low, high = self.travel_mm
        if not high - low > self.approach_mm:
            raise ValueError(f"expected travel_mm longer than the approach, got {self.travel_mm}")

    def scale(self, axis: int) -> float:
        """Return the counts per millimetre of axis 0 (row) or 1 (col)."""
        both = self.counts_per_mm
        return float(both) if isinstance(both, int | float) else both[axis]

    def direction(self, axis: int) -> str:
        """Return in which direction every move of axis 0 (row) or 1 (col) ends."""
        both = self.approach_direction
        return both if isinstance(both, str) else both[axis]

    def run_up_mm(self, axis: int) -> float:
        """Return how far before its goal a move of an axis turns round; negative: beyond it."""
        return self.approach_mm if self.direction(axis) == "forward" else -self.approach_mm

    def reachable_mm(self, axis: int) -> tuple[float, float]:
        """Return the lowest and highest position that leave room for the approach."""
        low, high = self.travel_mm
        run_up_mm = self.run_up_mm(axis)
        return low + max(run_up_mm, 0.0), high + min(run_up_mm, 0.0)


def travel_time_s(distance_mm: float, velocity_mmps: float, acceleration_mmps2: float) -> float:
    """Return how long a move from rest to rest takes.

    t = d / v + v / a        if it comes to full speed, d >= v^2 / a
    t = 2 sqrt(d / a)        else
    """
    if distance_mm >= velocity_mmps**2 / acceleration_mmps2:
        return distance_mm / velocity_mmps + velocity_mmps / acceleration_mmps2
    return 2.0 * math.sqrt(distance_mm / acceleration_mmps2)
