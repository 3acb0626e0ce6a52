"""Two threads: one takes frames, one makes pictures of the latest; neither waits for a browser."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, suppress

from lensshift.core.errors import DataError
from lensshift.core.types import Burst
from lensshift.live.picture import Picture, Settings
from lensshift.live.recording import Recording
from lensshift.live.sources import Shot, Source
from lensshift.reconstruction.stream import Stream, stream

_RATE_OVER_S = 3.0  # long enough to be steady, short enough to follow
_WARNED_S = 5.0  # how long a warning stands
_LOOK_S = 0.2  # how soon the solver notices the end
# While the scene rests pictures follow their frames; computing them takes a fifth of the time.
_RESTS = 4.0
# What a device, a file or a setting can do to a thread.
FAILURES = (ValueError, TypeError, OSError, RuntimeError, MemoryError, ImportError)


class Mailbox:
    """The latest frame of each place: what is not fetched in time is replaced."""

    def __init__(self) -> None:
        self._shots: dict[int, Shot] = {}
        self._changed = threading.Condition()

    def put(self, shot: Shot) -> None:
        """Leave a frame; those of another plan go."""
        with self._changed:
            if any(one.plan is not shot.plan for one in self._shots.values()):
                self._shots.clear()
            self._shots.pop(shot.place, None)
            self._shots[shot.place] = shot
            self._changed.notify()

    def take(self, timeout_s: float) -> list[Shot]:
        """Return what there is, the latest last; nothing if nothing came in time."""
        with self._changed:
            if not self._shots:
                self._changed.wait(timeout_s)
            shots = list(self._shots.values())
            self._shots.clear()
            return shots


class Rate:
    """Events per second over the last seconds."""

    def __init__(self) -> None:
        self._at_s: deque[float] = deque(maxlen=1000)

    def tick(self) -> None:
        """Take note of an event."""
        self._at_s.append(time.monotonic())

    def per_s(self) -> float:
        """Return the rate; 0 before the second event."""
        now_s = time.monotonic()
        recent = [at_s for at_s in tuple(self._at_s) if at_s > now_s - _RATE_OVER_S]
        return (len(recent) - 1) / (now_s - recent[0]) if len(recent) > 1 else 0.0


class Live:
    """A source, a solver and its latest picture; use it in a `with` block."""

    def __init__(self, source: Source, settings: Settings | None = None) -> None:
        self.source = source
        self.settings = settings or Settings()  # of the pictures from now on
        self.picture: Picture | None = None
        self._failure = self._refusal = self._unkept = ""
        self._warning, self._warned_s = "", 0.0
        self.arrived, self.visited, self.solved = Rate(), Rate(), Rate()
        self.frame_count = 0
        self._refined_from_s = 0.0  # when a picture is to be computed again
        self._recording: Recording | None = None
        self._recording_lock = threading.Lock()
        self._mailbox = Mailbox()
        self._ending = False  # no Event: a signal that comes while it is set would hold its lock
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=name)
            for name, work in (("frames", self._receive), ("pictures", self._solve))
        ]

    def __enter__(self) -> Live:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End both threads; the lens is back at rest when this returns."""
        self._ending = True
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        self.record(None)

    @property
    def ended(self) -> bool:
        """Whether no frame comes any more."""
        return not self._threads[0].is_alive()

    @property
    def problem(self) -> str:
        """What ended the frames, or else what speaks against the settings; or nothing.

        What ended a recording stands there until the next one.
        """
        return self._failure or self._refusal or self._unkept

    @property
    def warning(self) -> str:
        """The latest warning, if it is a few seconds old; or nothing."""
        return self._warning if time.monotonic() < self._warned_s + _WARNED_S else ""

    def warn(self, text: str) -> None:
        """Take note of what speaks against a picture."""
        self._warning, self._warned_s = " ".join(text.split()), time.monotonic()

    @property
    def recording(self) -> Recording | None:
        """What the frames are written to, or None."""
        return self._recording

    def record(self, recording: Recording | None) -> None:
        """Write the frames from now on; end the one before, or a DataError if it cannot be."""
        with self._recording_lock:
            before, self._recording, self._unkept = self._recording, recording, ""
        if before is not None:
            before.close()

    def _guarded(self, work: Callable[[], None]) -> None:
        with ExitStack() as relaying:
            relaying.push(self._relay)
            work()

    def _relay(self, _: object, error: BaseException | None, __: object) -> bool:
        """Say whatever ends a thread, of which nobody would hear."""
        if error is not None:
            self._failure = _words(error)
        return isinstance(error, (*FAILURES, SystemExit))

    def _receive(self) -> None:
        with closing(self.source.shots()) as shots:  # type: ignore[type-var]
            last: Shot | None = None
            for shot in shots:
                if self._ending:
                    return
                if shot is None:
                    continue
                self.arrived.tick()
                if last is None or shot.place != last.place or shot.plan.frame_count == 1:
                    self.visited.tick()  # several frames at one place are one visit
                last = shot
                self.frame_count += 1
                self._mailbox.put(shot)
                self._write(shot)

    def _write(self, shot: Shot) -> None:
        try:
            with self._recording_lock:
                if self._recording is None or self._recording.append(shot):
                    return
            self.record(None)  # another plan is another burst
        except DataError as error:  # as of a full disk, which ends the recording and no frame
            with suppress(DataError):  # then the journal stays
                self.record(None)
            self._unkept = f"the recording has ended: {error}"

    def _solve(self) -> None:
        made: tuple[Burst, Settings] | None = None
        camera: Stream | None = None
        while not self._ending:
            shots = self._mailbox.take(_LOOK_S)
            if not shots:
                continue
            plan, settings = shots[-1].plan, self.settings
            try:
                if camera is None or made is None or made[0] is not plan or made[1] != settings:
                    blur = "auto" if settings.blur_px is None else settings.blur_px
                    camera = stream(
                        plan, settings.scale, settings.method, psf_sigma_px=blur, pace="live"
                    )
                    made = plan, settings
                self._step(camera, shots, settings)
            except FAILURES as error:  # a setting that does not go with these frames; others may
                camera, self._refusal = None, _words(error)
            else:
                self._refusal = ""

    def _step(self, camera: Stream, shots: Sequence[Shot], settings: Settings) -> None:
        for shot in shots:
            camera.take(shot.frame, place=shot.place)
        begun_s, last = time.monotonic(), shots[-1]
        result = camera.picture(refined=begun_s > self._refined_from_s)
        if result.settings["pace"] == "refined":
            ended_s = time.monotonic()
            self._refined_from_s = ended_s + _RESTS * (ended_s - begun_s)
        number = 1 if self.picture is None else self.picture.number + 1
        self.picture = Picture(number, result, last, camera.window, settings)
        self.solved.tick()


def _words(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
