"""Between the thread that receives and the one that asks: a bounded queue of frames."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack

import numpy as np

from lensshift.capture.rig import CameraFrame
from lensshift.core.errors import DeviceError, DeviceTimeout
from lensshift.core.grid import Grid

QUEUE_FRAMES = 64  # more than a second at 50 Hz
LOOK_S = 0.2  # how often a silent loop looks whether it shall stop
_JOIN_S = 10.0  # loops look at their stop event several times a second


def counter_steps(newer: int, older: int) -> int:
    """Return how far a 32-bit counter has gone from one reading to another.

    Negative: it has gone back. Right for distances up to 2^31 either way, wrapped or not.
    """
    return ((newer - older + 0x80000000) & 0xFFFFFFFF) - 0x80000000


class Receiver:
    """Runs a camera's receiving loop in a thread; holds `depth` frames, then drops the oldest."""

    def __init__(self, device: str, *, depth: int = QUEUE_FRAMES) -> None:
        self.device = device
        self.frames = 0
        self.dropped = 0
        self._held: deque[CameraFrame] = deque()
        self._depth = depth
        # What is interrupted while it enters a Condition holds its lock for ever; a lock cannot be.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._notice = ""
        self._ended = ""

    @property
    def running(self) -> bool:
        """Whether it was started and not closed."""
        return self._thread is not None

    def start(self, loop: Callable[[threading.Event], None]) -> None:
        """Run `loop` in a thread until `close`; it must return soon after its event is set."""
        self._thread = threading.Thread(target=self._run, args=(loop,), daemon=True)
        self._thread.start()

    def _run(self, loop: Callable[[threading.Event], None]) -> None:
        with ExitStack() as relaying:
            relaying.push(self._relay)
            loop(self._stop)

    def _relay(self, kind: object, error: BaseException | None, trace: object) -> bool:
        """Hand whatever stops the thread over to the one that asks for frames."""
        if error is None:
            return False
        problem = error.problem if isinstance(error, DeviceError) else repr(error)
        self.end(f"receiving has stopped: {problem}")
        return isinstance(error, Exception)

    def put(self, frame: CameraFrame, *, wait: bool = False) -> None:
        """Add a frame; if the queue is full drop the oldest, or wait for room."""
        with self._lock:
            if wait:
                self._changed.wait_for(lambda: len(self._held) < self._depth or self._stop.is_set())
            if len(self._held) >= self._depth:
                self._held.popleft()
                self.dropped += 1
            self._held.append(frame)
            self.frames += 1
            self._changed.notify_all()

    def interrupt(self, problem: str, *, wait: bool = False) -> None:
        """Forget the frames held, or wait until they are fetched; raise `problem` once."""
        with self._lock:
            if wait:
                self._changed.wait_for(lambda: not self._held or self._stop.is_set())
            self.dropped += len(self._held)
            self._held.clear()
            self._notice = problem
            self._changed.notify_all()

    def end(self, problem: str) -> None:
        """Let `take` hand out what is held, then raise `problem` for ever."""
        with self._lock:
            self._ended = problem
            self._changed.notify_all()

    def take(self, timeout_s: float, explain: Callable[[], str]) -> CameraFrame:
        """Return the oldest frame, or wait for one; DeviceTimeout if none came, or DeviceError."""
        if not (math.isfinite(timeout_s) and timeout_s >= 0):
            raise ValueError(f"expected a time to wait of at least 0 s, got {timeout_s}")
        with self._lock:
            if self._thread is None:
                raise DeviceError("not open: call open() first", device=self.device)
            self._changed.wait_for(
                lambda: bool(self._held or self._notice or self._ended), timeout=timeout_s
            )
            if self._notice:
                problem, self._notice = self._notice, ""
                raise DeviceError(problem, device=self.device)
            if self._held:
                self._changed.notify_all()
                return self._held.popleft()
            if self._ended:
                raise DeviceError(self._ended, device=self.device)
        raise DeviceTimeout(f"no frame in {timeout_s:g} s: {explain()}", device=self.device)

    def close(self) -> None:
        """Stop the loop and wait for its thread; a second call does nothing."""
        self._stop.set()
        with self._lock:
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            self._thread = None


class ReceivingCamera(ABC):
    """What cameras have in common that receive in a thread; drivers do the rest of `Camera`."""

    def __init__(
        self, name: str, pitch_mm: float | tuple[float, float], modulation_hz: float | None
    ) -> None:
        row_mm, col_mm = np.broadcast_to(pitch_mm, (2,)).tolist()
        self.name = name
        self.modulation_hz = modulation_hz
        self._pitch_mm = Grid((1, 1), (row_mm, col_mm)).pitch_mm
        self._grid: Grid | None = None
        self._receiver = Receiver(name)

    @property
    def grid(self) -> Grid:
        """Shape and pitch of the frames; known once it is open."""
        if self._grid is None:
            raise self._error("the shape is not known before open()")
        return self._grid

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the oldest whole frame not yet fetched; see `Camera.next_frame`."""
        return self._receiver.take(timeout_s, self._explaining())

    def counts(self) -> Mapping[str, int]:
        """Return what came and what was lost since `open`."""
        received = {"frames": self._receiver.frames, "dropped_frames": self._receiver.dropped}
        return received | self._losses()

    def close(self) -> None:
        """Stop receiving; a second call does nothing."""
        self._receiver.close()

    def _error(
        self, problem: str, command: str = "", kind: type[DeviceError] = DeviceError
    ) -> DeviceError:
        return kind(problem, device=self.name, command=command)

    def _refuse_open(self) -> None:
        if self._receiver.running:
            raise self._error("is open already")

    def _start(self) -> None:
        self._receiver = Receiver(self.name)
        self._receiver.start(self._receive)

    @abstractmethod
    def _receive(self, stop: threading.Event) -> None:
        """Put frames into the receiver until it is to stop."""

    @abstractmethod
    def _explaining(self) -> Callable[[], str]:
        """Return what tells why no frame has come since now."""

    def _losses(self) -> dict[str, int]:
        """Return what was lost, by its name."""
        return {}
