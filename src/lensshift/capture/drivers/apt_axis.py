"""One axis: a TDC001 or KDC101 with a Z806, in millimetres.

Where the motor stands is judged against where it was sent: a damaged command is seen as a motor
that goes astray, is stopped and sent again. Nothing is done because of a single reply.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from enum import Enum, auto
from statistics import median
from typing import Any

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import CHANNEL, Bits, Id, Message, Status
from lensshift.capture.drivers.apt_cube import AptCube
from lensshift.capture.drivers.apt_settings import AptSettings, travel_time_s
from lensshift.core.errors import DeviceError, DeviceTimeout

_POLL_S = 0.004  # between two looks at a motor under way
_START_S = 0.1  # a controller that stands still for longer has not taken the command
_ASTRAY_MM = 0.02  # leaving the way between start and goal by this is no overshoot
_BEYOND_MM = 1.0  # from the lowest position to the switch, at most

_FAULT_NAMES = {
    Bits.MOTION_ERROR: "motion error",
    Bits.CURRENT_LIMIT: "motor current limit",
    Bits.ENCODER_FAULT: "encoder fault",
    Bits.FORWARD_LIMIT: "forward limit switch",
    Bits.BACKWARD_LIMIT: "backward limit switch",
}


class _Verdict(Enum):
    """What one status says of a move under way."""

    UNDER_WAY = auto()
    ARRIVED = auto()
    SHORT = auto()  # stands elsewhere
    ASTRAY = auto()  # off the way from start to goal
    FAULT = auto()


@dataclass(frozen=True, slots=True)
class _Leg:
    """A move in one direction, in counts; faults are judged against the status before it."""

    start: float
    goal: int
    bits: int


class AptAxis:
    """One controller with its actuator; `prepare` it before its first move. Or a DeviceError.

    `homing` and `moves` are generators, so that one thread can move several axes at once: each step
    looks once, yields how long (s) to wait before the next, and returns the result at last.
    """

    def __init__(self, port: str, settings: AptSettings, axis: int = 0) -> None:
        self.settings = settings
        self.port = port
        self.repeated_moves = 0
        self._counts_per_mm = settings.scale(axis)
        self._run_up_mm = settings.run_up_mm(axis)
        # No Event: a signal that ends a move may come while it holds its lock, for ever.
        self._halted = False
        self._command = ""
        self._cube = AptCube(
            port,
            tolerance=self._counts(settings.tolerance_mm),
            reply_timeout_s=settings.reply_timeout_s,
            attempts=settings.max_retries,
        )
        self.info = self._cube.info

    @property
    def name(self) -> str:
        """Model and serial number."""
        return self._cube.link.device

    @property
    def homed(self) -> bool:
        """Whether the controller knows its zero."""
        return bool(self._cube.status().bits & Bits.HOMED)

    def position_mm(self) -> float:
        """Return the confirmed position, also while the motor moves."""
        return self._cube.status().counts / self._counts_per_mm

    def describe(self) -> Mapping[str, Any]:
        """Return model, serial number, firmware and scale, and how good the line has been."""
        return {
            "port": self.port,
            **asdict(self.info),
            "counts_per_mm": self._counts_per_mm,
            "homed": self.homed,
            "resyncs": self._cube.link.resyncs,
            "repeated_requests": self._cube.link.repeated,
            "repeated_moves": self.repeated_moves,
        }

    def prepare(self) -> None:
        """Write all parameters and read them back (DeviceError names a wrong one); then enable."""
        wanted, scale = self.settings, self._counts_per_mm
        acceleration = apt.servo_acceleration(wanted.acceleration_mmps2 * scale)
        velocity = apt.Velocity(0, acceleration, apt.servo_velocity(wanted.velocity_mmps * scale))
        self._cube.write("velocity", Id.SET_VELOCITY, velocity)
        speed = apt.servo_velocity(wanted.home_velocity_mmps * scale)
        home = apt.Home(2, 1, speed, self._counts(wanted.home_offset_mm))
        self._cube.write("home", Id.SET_HOME, home)
        # The firmware's own overrun would move the lens a second time.
        self._cube.write("backlash", Id.SET_BACKLASH, apt.Target(0))
        # Which way its switches close belongs to the actuator, so it stays. The soft limits are
        # for other programs: firmware differs in what it does at them, so the driver keeps its own.
        found = self._cube.confirmed(Id.REQUEST_LIMITS, apt.Limits)
        low, high = (self._counts(end_mm) for end_mm in wanted.travel_mm)
        limits = apt.Limits(found.forward_switch, found.backward_switch, high, low, 1)
        self._cube.write("limit", Id.SET_LIMITS, limits)
        self._enable()

    def _enable(self) -> None:
        """Enable the motor unless it is; that also clears an old motion error."""
        request = Message(Id.REQUEST_ENABLED, (CHANNEL, 0))
        for _ in range(self.settings.max_retries):
            kept = self._cube.link.ask(request, answer=Id.ENABLED, read=lambda it: it.parameters)
            if kept == (CHANNEL, 1) and not self._cube.status().bits & apt.FAULTS:
                return
            self._cube.link.send(Message(Id.SET_ENABLED, (CHANNEL, 1)))
            time.sleep(self.settings.enable_wait_s)
        bits = self._cube.status().bits
        why = f" ({_why(bits)})" if bits & apt.FAULTS else ""
        raise self._error(f"cannot be enabled{why}")

    def homing_way(self) -> str:
        """Tell in words how far homing takes it."""
        offset_mm = self.settings.home_offset_mm
        if self.homed:
            at_mm = self.position_mm()
            way = f"goes from {at_mm:.3f} mm back {at_mm + offset_mm:.3f} mm to its switch"
        else:
            way = f"is anywhere and goes back until its switch, {self._farthest_mm:g} mm at most"
        return f"{self.name} {way}, then {offset_mm:g} mm forward to its zero"

    @property
    def _farthest_mm(self) -> float:
        far_mm = max(abs(end_mm) for end_mm in self.settings.travel_mm)
        return far_mm + self.settings.home_offset_mm + _BEYOND_MM

    def homing(self) -> Generator[float, None, float]:
        """Look for the zero step by step; the result is the position (mm)."""
        wanted = self.settings
        limit_s = self._limit_s(self._farthest_mm, wanted.home_velocity_mmps)
        with self._doing("home"):
            for _ in range(wanted.max_retries):
                if (yield from self._home_once(time.monotonic() + limit_s)):
                    return self.position_mm()
                self.repeated_moves += 1
            raise self._error("it does not take the command")

    def _home_once(self, deadline_s: float) -> Generator[float, None, bool]:
        """Send home; tell whether the controller went, and came, home."""
        was_homed = self.homed
        heard = self._cube.link.heard[Id.HOMED]
        self._cube.link.send(Message(Id.MOVE_HOME, (CHANNEL, 0)))
        sent_s = time.monotonic()
        went = still = late = 0
        while still < self.settings.settle_polls or time.monotonic() < sent_s + _START_S:
            yield _POLL_S
            late += time.monotonic() > deadline_s
            self._check(late)
            status = self._cube.poll()
            homed = bool(status.bits & Bits.HOMED)
            still = 0 if status.moving else still + 1
            went += status.moving or homed != was_homed
            if status.bits & apt.FAULTS and (bits := self._cube.status().bits) & apt.FAULTS:
                raise self._error(_why(bits))
        came = self._cube.link.heard[Id.HOMED] > heard
        return self.homed and (came or went >= 2)

    def moves(self, goal_mm: float, *, direct: bool = False) -> Generator[float, None, float]:
        """Go to a position (mm) step by step, ending in the one direction unless `direct`."""
        with self._doing(f"move to {goal_mm:.4f} mm"):
            for _ in range(self.settings.max_retries):
                arrived = yield from self._approach(self._counts(goal_mm), direct=direct)
                if arrived is not None:
                    return arrived / self._counts_per_mm
                self.repeated_moves += 1
            raise self._error(f"stands elsewhere after {self.settings.max_retries} attempts")

    def _approach(self, goal: int, *, direct: bool) -> Generator[float, None, float | None]:
        """Go to `goal`, with a run-up if need be; return where it stands, None if not there."""
        run_up = self._counts(self._run_up_mm)
        start = self._cube.status()
        if not start.bits & Bits.HOMED:
            raise self._error("it does not know its zero; home it first")
        far_enough = abs(goal - start.counts) >= abs(run_up)
        ends_well = far_enough and (goal - start.counts) * run_up >= 0
        legs = [goal] if direct or ends_well else [goal - run_up, goal]
        at: float | None = start.counts
        for end in legs:
            if at is not None:
                at = yield from self._go(_Leg(at, end, start.bits))
        return at

    def _go(self, leg: _Leg) -> Generator[float, None, float | None]:
        """Send to the end of `leg` and watch; return where it stands, None if not there."""
        way_mm = abs(leg.goal - leg.start) / self._counts_per_mm
        self._cube.link.send(Message(Id.MOVE_ABSOLUTE, data=apt.Target(leg.goal).pack()))
        sent_s = time.monotonic()
        deadline_s = sent_s + self._limit_s(way_mm, self.settings.velocity_mmps)
        agreeing: list[tuple[_Verdict, Status]] = []
        verdict, late = _Verdict.UNDER_WAY, 0
        while True:
            yield _POLL_S if verdict is _Verdict.UNDER_WAY else 0.0
            self._check(late)
            early = time.monotonic() < sent_s + _START_S
            late += time.monotonic() > deadline_s
            status = self._cube.poll()
            verdict = self._judge(status, leg)
            if early and verdict is _Verdict.SHORT:
                verdict = _Verdict.UNDER_WAY
            agreeing = [one for one in agreeing if one[0] is verdict] + [(verdict, status)]
            if len(agreeing) < self.settings.settle_polls:
                continue
            if verdict is _Verdict.ARRIVED:
                return float(median(one.counts for _, one in agreeing))
            if verdict is _Verdict.FAULT:
                raise self._error(_why(status.bits))
            if verdict is _Verdict.ASTRAY:
                self._cube.stand_still()
                return None
            if verdict is _Verdict.SHORT:
                return None

    def _judge(self, status: Status, leg: _Leg) -> _Verdict:
        """Return what `status` says of a move along `leg`."""
        tolerance = self._counts(self.settings.tolerance_mm)
        lost = leg.bits & ~status.bits & (Bits.HOMED | Bits.ENABLED)
        limit = status.bits & ~leg.bits & apt.LIMITS
        if limit or lost or status.bits & apt.FAULTS:
            return _Verdict.FAULT
        if not status.moving and abs(status.counts - leg.goal) <= tolerance:
            return _Verdict.ARRIVED
        margin = self._counts(_ASTRAY_MM)
        low, high = sorted((leg.start, leg.goal))
        if not low - margin <= status.counts <= high + margin:
            return _Verdict.ASTRAY
        return _Verdict.UNDER_WAY if status.moving else _Verdict.SHORT

    def halt(self) -> None:
        """Say stop and do not wait for it. Never raises."""
        self._halted = True
        with suppress(DeviceError):
            self._cube.link.send(Message(Id.MOVE_STOP, (CHANNEL, apt.STOP_AT_ONCE)))

    def stop(self) -> None:
        """Stand still at once, and end a move that another thread waits for. Never raises."""
        self._halted = True
        with suppress(DeviceError):
            self._cube.stand_still()

    def close(self) -> None:
        """Stop and let go of the port; a second call does nothing."""
        if self._cube.link.alive:
            self.stop()
        self._cube.link.close()

    def _counts(self, length_mm: float) -> int:
        return round(length_mm * self._counts_per_mm)

    def _limit_s(self, way_mm: float, velocity_mmps: float) -> float:
        """Return how long a move may take."""
        due_s = travel_time_s(way_mm, velocity_mmps, self.settings.acceleration_mmps2)
        return 1.5 * due_s + self.settings.timeout_margin_s

    def _check(self, late: int) -> None:
        """Raise if somebody stopped the motor, or too many polls came after the deadline.

        Polls, since it may be this program that was kept from looking, not the motor from moving.
        """
        if self._halted:
            raise self._error("stopped before it arrived")
        if late > self.settings.settle_polls:
            raise self._error(
                "it takes longer than its speed and acceleration allow", DeviceTimeout
            )

    @contextmanager
    def _doing(self, command: str) -> Iterator[None]:
        """Name the command and the last position in every error of the device meanwhile."""
        self._halted = False
        self._command = command
        try:
            yield
        except DeviceError as error:
            if error.position_mm is not None:
                raise
            raise self._error(error.problem, type(error)) from error
        finally:
            self._command = ""

    def _error(self, problem: str, kind: type[DeviceError] = DeviceError) -> DeviceError:
        last = self._cube.last_counts
        return kind(
            problem,
            device=self.name,
            command=self._command,
            position_mm=None if last is None else (last / self._counts_per_mm,),
        )


def _why(bits: int) -> str:
    """Return what `bits` say went wrong."""
    named = [name for bit, name in _FAULT_NAMES.items() if bits & bit]
    if named:
        return ", ".join(named)
    if not bits & Bits.HOMED:
        return "its zero is lost, it has been restarted: open it anew"
    return "the motor is disabled: open it anew"
