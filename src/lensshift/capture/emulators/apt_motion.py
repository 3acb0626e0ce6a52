"""How an emulated actuator moves: pieces of constant acceleration, and play behind the encoder.

    motor(t) = counts + velocity (t - start) + acceleration (t - start)^2 / 2
    lens(t)  = motor(t) clipped so that  motor <= lens <= motor + play

The encoder sits on the motor. Going forward the lens is with it, going backward it lags by the
play. In one piece the motor does not turn round, so the lens at any time needs only the lens at the
start of the piece.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class _Piece:
    """Constant acceleration for a while, then rest; `lens` is where the lens is at the start."""

    start_s: float
    duration_s: float
    counts: float
    velocity: float
    acceleration: float
    lens: float

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s

    def motor(self, time_s: float) -> float:
        since_s = min(max(time_s - self.start_s, 0.0), self.duration_s)
        return self.counts + self.velocity * since_s + 0.5 * self.acceleration * since_s**2


class Motion:
    """Where motor (first at `counts`) and lens (up to `play` behind) are, now and some time ago."""

    def __init__(self, counts: float, play: float) -> None:
        self._play = play
        self._pieces = deque([_Piece(-math.inf, 0.0, counts, 0.0, 0.0, counts)])

    @property
    def end_s(self) -> float:
        """When the motor stands."""
        return self._pieces[-1].end_s

    def motor(self, time_s: float) -> float:
        """Return the true position of the motor in counts."""
        return self._piece(time_s).motor(time_s)

    def lens(self, time_s: float) -> float:
        """Return the true position of the lens in counts."""
        piece = self._piece(time_s)
        motor = piece.motor(time_s)
        return min(max(piece.lens, motor), motor + self._play)

    def velocity(self, time_s: float) -> float:
        """Return the speed of the motor in counts per second."""
        piece = self._piece(time_s)
        if not piece.start_s <= time_s < piece.end_s:
            return 0.0
        return piece.velocity + piece.acceleration * (time_s - piece.start_s)

    def halt(self, time_s: float) -> None:
        """Stand still from `time_s` on."""
        while self._pieces[-1].start_s >= time_s:
            self._pieces.pop()
        last = self._pieces[-1]
        if last.end_s > time_s:
            self._pieces[-1] = replace(last, duration_s=time_s - last.start_s)

    def brake(self, time_s: float, acceleration: float) -> None:
        """Slow down from `time_s` on."""
        velocity = self.velocity(time_s)
        self.halt(time_s)
        if velocity:
            slowing = -math.copysign(acceleration, velocity)
            self._append(time_s, abs(velocity) / acceleration, velocity, slowing)

    def go(self, start_s: float, goal: float, velocity: float, acceleration: float) -> None:
        """Move from rest to rest: speed up, go on, slow down."""
        way = goal - self.motor(math.inf)
        if way == 0.0:
            return
        top = min(velocity, math.sqrt(abs(way) * acceleration))
        ramp_s = top / acceleration
        even_s = max(abs(way) / top - ramp_s, 0.0)
        forward = math.copysign(1.0, way)
        self._append(start_s, ramp_s, 0.0, forward * acceleration)
        self._append(start_s + ramp_s, even_s, forward * top, 0.0)
        self._append(start_s + ramp_s + even_s, ramp_s, forward * top, -forward * acceleration)

    def forget(self, before_s: float) -> None:
        """Drop what ended before `before_s`; the last piece stays."""
        while len(self._pieces) > 1 and self._pieces[1].start_s < before_s:
            self._pieces.popleft()

    def _append(
        self, start_s: float, duration_s: float, velocity: float, acceleration: float
    ) -> None:
        counts, lens = self.motor(start_s), self.lens(start_s)
        self._pieces.append(_Piece(start_s, duration_s, counts, velocity, acceleration, lens))

    def _piece(self, time_s: float) -> _Piece:
        for piece in reversed(self._pieces):
            if piece.start_s <= time_s:
                return piece
        return self._pieces[0]
