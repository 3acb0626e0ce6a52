"""An emulated TDC001 or KDC101 with a Z806: bytes in, bytes out, and a lens that has moved."""

from __future__ import annotations

import math
import random
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import Bits, Framer, Id, Message
from lensshift.capture.drivers.apt_settings import Z8_COUNTS_PER_MM
from lensshift.capture.drivers.receiver import counter_steps
from lensshift.capture.emulators.apt_messages import ADDRESSES, SIZES, More, records
from lensshift.capture.emulators.apt_motion import Motion

_ZERO_MM = 0.3  # from the backward switch to the zero of `lens_mm`
_TRAVEL_MM = 6.5  # from switch to switch
_START_MM = 2.0  # where the lens is at power on
_PER_S, _PER_S2 = apt.SAMPLE_S * 65536, apt.SAMPLE_S**2 * 65536  # units of the servo
_HISTORY_S = 20.0  # how long ago `lens_mm` still knows
_LOCKS_UP_S = 0.8  # home sooner after enabling, and the controller hangs
_KEPT_MESSAGES = 1000  # for who looks what came
_UPDATE_S = 0.1  # between two statuses that were asked for once


class AptController:
    """What sits at the other end of the cable.

    It keeps the rules of the devices: parameters are lost at power off, the zero is found anew,
    home right after enable hangs, backward moves overrun by the firmware's backlash until that is
    set to 0. Times of the caller are those of `time.monotonic()`.
    """

    def __init__(
        self,
        *,
        model: str = "KDC101",  # "TDC001" or "KDC101"
        serial_number: int = 27000001,
        stage_id: int = 11,  # 11 is the Z806
        play_mm: float = 0.0,  # how far the lens lags behind the encoder after going backward
        encoder_noise_mm: float = 0.0,  # standard deviation of the reported position
        loss: float = 0.0,  # probability that a message out loses a byte
        loss_in: float = 0.0,  # that a block of bytes in loses one
        speed: float = 1.0,  # how much faster than real time it runs
        seed: int = 0,  # of noise and losses
        counts_per_mm: float = Z8_COUNTS_PER_MM,  # true scale of the actuator
    ) -> None:
        if model not in ("TDC001", "KDC101"):
            raise ValueError(f"expected model 'TDC001' or 'KDC101', got {model!r}")
        if not speed > 0:
            raise ValueError(f"expected a positive speed, got {speed}")
        self.info = apt.Info(serial_number, model, "2.0.4", "lensshift emulator", stage_id)
        self.plugged = True
        self.received: deque[Message] = deque(maxlen=_KEPT_MESSAGES)
        self.motion_s = 0.0  # real time that its moves took by themselves
        self._noise_mm, self._loss, self._loss_in, self._speed = (
            encoder_noise_mm, loss, loss_in, speed,
        )  # fmt: skip
        self._counts_per_mm = counts_per_mm
        self._random = random.Random(seed)
        self._lock = threading.RLock()
        self._began_s = time.monotonic()
        self._motion = Motion(self._counts(_START_MM), self._counts(play_mm))
        self._flags: int = Bits.CONNECTED
        self._arrival: Id | None = None  # what to say when the motor stands
        self._answers: dict[int, Callable[[Message], bytes | None]] = {
            Id.REQUEST_INFO: lambda _: self._say(Id.INFO, self.info.pack()),
            Id.SET_ENABLED: self._set_enabled,
            Id.REQUEST_ENABLED: lambda _: self._say(
                Id.ENABLED, second=1 if self._flags & Bits.ENABLED else 2
            ),
            Id.REQUEST_BITS: lambda _: self._say(Id.BITS, struct.pack("<HL", 1, self._bits())),
            Id.REQUEST_STATUS: lambda _: self._say(Id.STATUS, self._status().pack()),
            Id.MOVE_ABSOLUTE: self._move,
            Id.MOVE_HOME: self._home,
            Id.MOVE_STOP: self._stop,
            Id.STOP_UPDATES: lambda _: self._update(every_s=math.inf),
            More.START_UPDATES: lambda _: self._update(every_s=_UPDATE_S),
            More.REQUEST_POSITION: lambda _: self._say(More.POSITION, self._place()),
            More.REQUEST_ENCODER: lambda _: self._say(More.ENCODER, self._place()),
            More.SET_POSITION: self._call_it,
            More.SET_ENCODER: self._call_it,
            More.MOVE_RELATIVE: self._move,
            More.MOVE_JOG: self._jog,
            More.MOVE_VELOCITY: self._jog,
        }
        self.reboot()

    # ---- for the bench ------------------------------------------------------------------------

    def lens_mm(self, now_s: float | None = None) -> float:
        """Return the true position of the lens, now or at `now_s`, from a zero of 0.3 mm offset."""
        with self._lock:
            return self._motion.lens(self._time(now_s)) / self._counts_per_mm

    def motor_mm(self, now_s: float | None = None) -> float:
        """Return where the encoder, without noise, is; else as `lens_mm`."""
        with self._lock:
            return self._motion.motor(self._time(now_s)) / self._counts_per_mm

    def unplug(self) -> None:
        """Pull the cable: the link drops, the motor goes on."""
        self.plugged = False

    def fail_motion(self) -> None:
        """Block the motor: it stands, and reports a motion error until it is enabled anew."""
        with self._lock:
            self._motion.halt(self._time())
            self._arrival = None
            self._flags = self._flags & ~Bits.HOMING | Bits.MOTION_ERROR

    def reboot(self) -> None:
        """Switch off and on: parameters, zero and everything under way are lost."""
        with self._lock:
            now_s = self._time()
            self._motion.halt(now_s)
            self._zero = self._motion.motor(now_s)  # counts that the encoder calls 0
            self._flags = Bits.CONNECTED
            self._enabled_s = 0.0
            self._hung = False
            self._arrival = None
            self._jogs = False
            self._update_due_s = self._update_every_s = math.inf
            self._framer = Framer(SIZES, destination=ADDRESSES, source=apt.HOST)
            slow = apt.servo_velocity(self._counts(1.0))
            acceleration = apt.servo_acceleration(self._counts(1.0))
            self._records: dict[int, Any] = {  # by the id of the answer
                Id.VELOCITY: apt.Velocity(0, acceleration, slow),
                Id.HOME: apt.Home(2, 1, slow, 0),
                Id.BACKLASH: apt.Target(self._counts(0.1)),
                Id.LIMITS: apt.Limits(3, 3, self._counts(6.0), 0, 3),
                **records(self._counts_per_mm),
            }

    # ---- for the link -------------------------------------------------------------------------

    def receive(self, data: bytes) -> bytes:
        """Return what it answers to bytes from the host."""
        with self._lock:
            answers = self.due()
            for message in self._framer.feed(self._damaged(data, self._loss_in), time.monotonic()):
                self.received.append(message)
                answers += self._handle(message)
            return answers

    def due(self) -> bytes:
        """Return what it says unasked by now: that a move has come to its end."""
        with self._lock:
            now_s = self._time()
            self._motion.forget(now_s - _HISTORY_S * self._speed)
            if time.monotonic() >= self._update_due_s:
                self._update_due_s = time.monotonic() + self._update_every_s
                return self._say(Id.STATUS, self._status().pack())
            if self._arrival is None or now_s < self._motion.end_s:
                return b""
            arrival, self._arrival = self._arrival, None
            if arrival == Id.HOMED:
                self._zero = self._motion.motor(now_s)
                self._flags = self._flags & ~Bits.HOMING | Bits.HOMED
                return self._say(Id.HOMED)
            return self._say_end(arrival)

    @property
    def quiet_s(self) -> float:
        """How long it will say nothing unasked."""
        with self._lock:
            left_s = min(1.0, max(self._update_due_s - time.monotonic(), 0.0))
            if self._arrival is None:
                return left_s
            return min(left_s, max(self._motion.end_s - self._time(), 0.0) / self._speed)

    # ---- messages -----------------------------------------------------------------------------

    def _handle(self, message: Message) -> bytes:
        if message.id in self._answers:
            return self._answers[message.id](message) or b""
        kept = message.id + 2  # SET, REQUEST and the answer follow each other
        if kept in self._records:
            with suppress(apt.DamagedMessage):
                self._records[kept] = type(self._records[kept]).unpack(message.data)
        elif kept - 1 in self._records:
            return self._say(kept - 1, self._records[kept - 1].pack())
        return b""

    def _set_enabled(self, message: Message) -> None:
        if message.parameters == (apt.CHANNEL, 1):
            self._flags = self._flags & ~Bits.MOTION_ERROR | Bits.ENABLED
            self._enabled_s = self._time()
        elif message.parameters == (apt.CHANNEL, 2):
            self._motion.halt(self._time())
            self._flags &= ~Bits.ENABLED

    def _update(self, *, every_s: float) -> None:
        self._update_every_s, self._update_due_s = every_s, time.monotonic() + every_s

    def _place(self) -> bytes:
        return apt.Target(self._status().counts).pack()

    def _call_it(self, message: Message) -> None:
        """Let the place where the motor stands bear another number."""
        with suppress(apt.DamagedMessage):
            self._zero = self._motion.motor(self._time()) - apt.Target.unpack(message.data).counts

    def _move(self, message: Message) -> None:
        """Go to a place, or by a length; without one in the message by that set before."""
        relative = message.id == More.MOVE_RELATIVE
        way = self._records[More.RELATIVE if relative else More.ABSOLUTE]
        with suppress(apt.DamagedMessage):
            if message.data:
                way = apt.Target.unpack(message.data)
            base = self._motion.motor(self._time()) if relative else self._zero
            velocity = self._records[Id.VELOCITY]
            self._go(base + way.counts, velocity.highest, velocity.acceleration)

    def _jog(self, message: Message) -> None:
        """Go a step, or until stopped, to lower (1, "forward") or higher counts (2)."""
        channel, way = message.parameters
        if channel != apt.CHANNEL or way not in (1, 2):
            return
        jog, jogs = self._records[More.JOG], message.id == More.MOVE_JOG
        here = self._motion.motor(self._time())
        step = jog.step if way == 2 else -jog.step
        velocity = jog if jogs else self._records[Id.VELOCITY]
        end = here + step if jogs and jog.mode != 1 else self._switches[way == 2]
        self._go(end, velocity.highest, velocity.acceleration)
        self._jogs = jogs

    def _go(self, goal: float, highest: int, rising: int) -> None:
        """Set out for a place, by speed and acceleration in units of the servo."""
        ready = self._flags & Bits.ENABLED and not self._flags & (Bits.MOTION_ERROR | Bits.HOMING)
        if not ready:
            return
        overrun = self._records[Id.BACKLASH].counts
        backward = overrun > 0 and goal < self._motion.motor(self._time())
        ends = [goal - overrun, goal] if backward else [goal]
        self._jogs = False
        self._set_out(ends, highest, rising, Id.COMPLETED)

    def _home(self, message: Message) -> None:
        ready = self._flags & Bits.ENABLED and not self._flags & Bits.MOTION_ERROR
        if not ready or message.parameters[0] != apt.CHANNEL or self._hung:
            return
        self._flags = self._flags & ~Bits.HOMED | Bits.HOMING
        if self._time() - self._enabled_s < _LOCKS_UP_S:
            self._hung = True
            return
        home, (switch, _) = self._records[Id.HOME], self._switches
        rising = self._records[Id.VELOCITY].acceleration
        self._set_out([switch, switch + home.offset], home.velocity, rising, Id.HOMED)

    def _set_out(self, ends: list[float], highest: int, rising: int, arrival: Id) -> None:
        """Go to one place after the other, or as far as the switches let it."""
        speed, acceleration = max(highest / _PER_S, 1.0), max(rising / _PER_S2, 1.0)
        now_s, (low, high) = self._time(), self._switches
        self._motion.brake(now_s, acceleration)
        for end in ends:
            stop = min(max(end, low), high)
            self._motion.go(max(now_s, self._motion.end_s), stop, speed, acceleration)
            if stop != end:
                break
        self._arrival = arrival
        self.motion_s += max(self._motion.end_s - now_s, 0.0) / self._speed

    def _stop(self, message: Message) -> bytes:
        if message.parameters[0] != apt.CHANNEL or self._hung:
            return b""
        self._flags &= ~Bits.HOMING
        if message.parameters[1] == apt.STOP_PROFILED:
            servo = self._records[Id.VELOCITY].acceleration
            self._motion.brake(self._time(), max(servo / _PER_S2, 1.0))
            self._arrival = Id.STOPPED
            return b""
        self._motion.halt(self._time())
        self._arrival = None
        return self._say_end(Id.STOPPED)

    # ---- small parts --------------------------------------------------------------------------

    def _say(self, message_id: int, data: bytes = b"", second: int = 0) -> bytes:
        message = Message(message_id, (0, 0) if data else (apt.CHANNEL, second), data)
        return self._damaged(message.to_bytes(apt.HOST, self._framer.called), self._loss)

    def _say_end(self, message_id: int) -> bytes:
        """Return the end of a move, with the status that thorlabs-apt-device looks for in it."""
        return self._say(message_id, self._status().pack())

    def _status(self) -> apt.Status:
        now_s = self._time()
        motor, velocity = self._motion.motor(now_s), self._motion.velocity(now_s)
        noise = self._random.gauss(0.0, self._noise_mm) * self._counts_per_mm
        per_cycle = min(max(round(velocity * apt.SAMPLE_S), -(2**15)), 2**15 - 1)
        counts = counter_steps(round(motor - self._zero + noise), 0)  # of 32 bits, which wrap
        return apt.Status(counts, per_cycle, 0, self._bits())

    def _bits(self) -> int:
        now_s = self._time()
        motor, velocity = self._motion.motor(now_s), self._motion.velocity(now_s)
        bits = self._flags
        if now_s < self._motion.end_s:
            # As thorlabs-apt-device and pylablib found it: these call lower counts forward.
            bits |= Bits.MOVING_BACKWARD if velocity >= 0 else Bits.MOVING_FORWARD
            if self._jogs:
                bits |= Bits.JOGGING_BACKWARD if velocity >= 0 else Bits.JOGGING_FORWARD
        else:
            bits |= Bits.SETTLED
        low, high = self._switches
        bits |= Bits.BACKWARD_LIMIT if motor <= low + 0.5 else 0
        bits |= Bits.FORWARD_LIMIT if motor >= high - 0.5 else 0
        return bits

    @property
    def _switches(self) -> tuple[float, float]:
        return -_ZERO_MM * self._counts_per_mm, (_TRAVEL_MM - _ZERO_MM) * self._counts_per_mm

    def _damaged(self, data: bytes, loss: float) -> bytes:
        """Return the bytes, sometimes without one of them."""
        if not data or self._random.random() >= loss:
            return data
        lost = self._random.randrange(len(data))
        return data[:lost] + data[lost + 1 :]

    def _counts(self, length_mm: float) -> int:
        return round(length_mm * self._counts_per_mm)

    def _time(self, now_s: float | None = None) -> float:
        """Return the controller's own time, which may run faster."""
        return ((time.monotonic() if now_s is None else now_s) - self._began_s) * self._speed
