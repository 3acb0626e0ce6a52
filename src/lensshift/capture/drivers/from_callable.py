"""Any camera that Python can read: a function that returns a picture becomes a `Camera`."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from lensshift.capture.drivers.receiver import ReceivingCamera
from lensshift.capture.rig import CameraFrame
from lensshift.core.arrays import Array
from lensshift.core.burst_checks import unmasked
from lensshift.core.errors import DeviceError
from lensshift.core.grid import Grid
from lensshift.core.types import Frame

_OWN_KEYS = ("amplitude", "distance_m", "valid", "time_s")


def frame_from(grabbed: Any) -> tuple[Frame, Mapping[str, Array]]:
    """Turn what a function returned into a frame and the arrays to keep beside it.

    TypeError, ValueError if it is nothing of this kind. Pixels that are not finite, or that
    `numpy.ma` masks, are marked invalid.

    grabbed : amplitude [row col]; or (amplitude, distance_m); or a mapping with `amplitude` and
        as you like `distance_m`, `valid`, `time_s`; its other entries, numbers of the same shape
        in each frame, are kept as they are
    """
    fields: dict[str, Any]
    if isinstance(grabbed, Mapping):
        fields = dict(grabbed)
    elif isinstance(grabbed, tuple) and len(grabbed) == 2:
        fields = {"amplitude": grabbed[0], "distance_m": grabbed[1]}
    else:
        fields = {"amplitude": grabbed}
    if fields.get("amplitude") is None:
        got = sorted(map(str, fields)) if isinstance(grabbed, Mapping) else grabbed
        raise ValueError(f"expected a picture, or an entry 'amplitude', got {got!r:.80}")
    amplitude = np.array(fields["amplitude"])  # a copy: the function may use its buffer again
    if amplitude.dtype.kind not in "uif" or amplitude.ndim != 2 or amplitude.size == 0:
        raise TypeError(
            f"expected an amplitude [row col] of numbers, got {amplitude.dtype} of shape "
            f"{amplitude.shape}"
        )
    distance_m = fields.get("distance_m")
    valid = unmasked(fields.get("valid"), fields["amplitude"], distance_m)
    if distance_m is not None:
        distance_m = np.array(distance_m, dtype=np.float64)
    time_s = fields.get("time_s")
    time_s = time.time() if time_s is None else float(time_s)
    if not math.isfinite(time_s):
        raise ValueError(f"expected a finite time_s, or none, got {time_s}")
    told = np.ones(amplitude.shape) if valid is None else np.asarray(valid)
    frame = Frame(amplitude, distance_m, told.astype(np.bool_), time_s)  # of one shape, all three
    seen = frame.valid & np.isfinite(amplitude if distance_m is None else amplitude + distance_m)
    raw = {str(name): np.array(one) for name, one in fields.items() if name not in _OWN_KEYS}
    return replace(frame, valid=seen), raw


class CallableCamera(ReceivingCamera):
    """Makes a camera of a function that waits for a picture and returns it.

    The function runs in a thread of its own. The exposure must begin after the call: a function
    that returns the last picture of a running camera may return one from before the lens moved.

    Parameters
    ----------
    grab : returns one picture, see `frame_from`; whatever it raises ends the camera
    pitch_mm : pixel pitch, one number or (row, col)
    name : for messages and for the file
    rate_hz : how often it is called at most
    modulation_hz : modulation frequency, if known
    about : what to keep beside the frames: model, settings
    """

    def __init__(
        self,
        grab: Callable[[], Any],
        *,
        pitch_mm: float | tuple[float, float],
        name: str = "camera",
        rate_hz: float = 50.0,
        modulation_hz: float | None = None,
        about: Mapping[str, Any] | None = None,
    ) -> None:
        if not callable(grab):
            raise TypeError(f"expected a function that returns a picture, got {grab!r}")
        if not rate_hz > 0:
            raise ValueError(f"expected a positive rate, got {rate_hz}")
        super().__init__(name, pitch_mm, modulation_hz)
        self._grab = grab
        self._period_s = 1.0 / rate_hz
        self._about = dict(about or {})
        self._cycle = -1

    def open(self) -> None:
        """Grab one picture, which tells the shape, and go on grabbing in the background.

        Raises
        ------
        DeviceError
            If it is open already. What the function raises comes through as it is.
        """
        self._refuse_open()
        frame, _ = frame_from(self._grab())
        rows, cols = frame.amplitude.shape
        self._grid = Grid((int(rows), int(cols)), self._pitch_mm)
        self._cycle = -1
        self._start()

    def _receive(self, stop: threading.Event) -> None:
        receiver = self._receiver
        while not stop.is_set():
            begin_s = time.monotonic()
            self._cycle += 1
            frame, raw = frame_from(self._grab())
            if frame.amplitude.shape != self.grid.shape:
                raise DeviceError(
                    f"the picture has become {frame.amplitude.shape}, was {self.grid.shape}"
                )
            receiver.put(CameraFrame(frame, self._cycle, time.monotonic(), raw))
            stop.wait(max(0.0, begin_s + self._period_s - time.monotonic()))

    def newest_cycle(self) -> int:
        """Return the number of the newest call that has begun, -1 before the first."""
        return self._cycle

    def _explaining(self) -> Callable[[], str]:
        return lambda: "the function has not returned a picture"

    def describe(self) -> Mapping[str, Any]:
        """Return what to keep beside the frames."""
        return {"model": self.name, **self._about}
