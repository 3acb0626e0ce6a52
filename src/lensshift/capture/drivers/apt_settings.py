"""How a pair of Z806 actuators is to be moved: units, speeds, limits, patience."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Direction = Literal["forward", "backward"]

# Z8 actuators: 512 counts per turn of the motor, a gear of 67.49:1, 1 mm per turn of the screw; so
# the APT protocol since 2022. Older papers round the gear to 67:1, which gives 34304 (0.73 % less).
Z8_COUNTS_PER_MM = 34554.96


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
    home: Literal["ask", "if_needed", "always", "never"] = "ask"
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
        names = ("velocity_mmps", "acceleration_mmps2", "home_velocity_mmps", "tolerance_mm")
        positive = {name: getattr(self, name) for name in (*names, "reply_timeout_s")}
        positive |= {f"counts_per_mm[{axis}]": self.scale(axis) for axis in (0, 1)}
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"expected a positive {name}, got {value}")
        for name in ("home_offset_mm", "approach_mm", "enable_wait_s", "timeout_margin_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"expected {name} of 0 or more, got {value}")
        if self.settle_polls < 2 or self.max_retries < 1:
            raise ValueError(
                "expected settle_polls >= 2 and max_retries >= 1, "
                f"got {self.settle_polls} and {self.max_retries}"
            )
        if self.home not in ("ask", "if_needed", "always", "never"):
            raise ValueError(
                f"expected home 'ask', 'if_needed', 'always' or 'never', got {self.home!r}"
            )
        if any(self.direction(axis) not in get_args(Direction) for axis in (0, 1)):
            raise ValueError(
                "expected approach_direction 'forward', 'backward' or two of them, got "
                f"{self.approach_direction!r}"
            )
        low, high = self.travel_mm
        if not (math.isfinite(low) and math.isfinite(high) and high - low > self.approach_mm):
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
