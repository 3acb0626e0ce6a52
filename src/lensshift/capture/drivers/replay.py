"""A recording that plays as if it were the camera: O3M packets, or images of a ROS bag."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.capture.drivers.from_callable import frame_from
from lensshift.capture.drivers.o3m_layout import SHAPE
from lensshift.capture.drivers.o3m_stream import O3MStream
from lensshift.capture.drivers.receiver import ReceivingCamera
from lensshift.capture.rig import CameraFrame
from lensshift.core.errors import DataError, DeviceError
from lensshift.core.grid import Grid
from lensshift.core.types import Frame
from lensshift.core.units import MILLIMETRE_M
from lensshift.io.reading import BAG_SUFFIXES
from lensshift.io.recordings import BagImage, is_udp_recording, read_bag, read_udp

_TOGETHER_S = 0.005  # amplitude and distance of one exposure bear about the same stamp


class ReplayCamera(ReceivingCamera):
    """Plays a recording once, from `open` on: packets of an O3M (pcap), or else a ROS bag."""

    def __init__(
        self,
        path: str | Path,  # file, or folder of a ROS 2 bag
        *,
        pitch_mm: float | tuple[float, float],
        # 1: as fast as recorded; infinity: as fast as frames are fetched, and none is dropped
        speed: float = 1.0,
        modulation_hz: float | None = None,
        source: str | None = None,  # of an O3M recording: which of several, as in `O3MCamera`
        port: int | None = None,  # of an O3M recording: only datagrams to this port
        amplitude_topic: str = "",  # of a bag
        distance_topic: str | None = None,  # radial, floats in m, counts in mm
    ) -> None:
        if not speed > 0:
            raise ValueError(f"expected a positive speed, got {speed}")
        super().__init__(f"recording {path}", pitch_mm, modulation_hz)
        self._path = Path(path)
        self._is_o3m = is_udp_recording(path)
        if not (self._is_o3m or amplitude_topic):
            if not Path(path).exists():
                raise DataError("there is no such file", source=path)
            if Path(path).is_file() and Path(path).suffix not in BAG_SUFFIXES:
                raise DataError("expected a pcap, a pcapng or a ROS bag", source=path)
            raise ValueError(f"expected the topic of the amplitude for the bag {path}, got none")
        self._speed = speed
        self._port = port
        self._amplitude_topic = amplitude_topic
        self._distance_topic = distance_topic
        self._stream = O3MStream(source)
        self._cycle = -1
        self._fetched = -1
        self._unpaired = 0
        self._began_s: tuple[float, float] | None = None  # as recorded, and now

    @property
    def grid(self) -> Grid:
        """Shape and pitch of the frames; of a bag they are known once it is open."""
        if self._grid is None:
            shape = SHAPE if self._is_o3m else self._first_shape()
            self._grid = Grid(shape, self._pitch_mm)
        return self._grid

    def _first_shape(self) -> tuple[int, int]:
        first = next(iter(read_bag(self._path, [self._amplitude_topic])), None)
        if first is None:
            raise DataError(f"holds no images of topic {self._amplitude_topic}", source=self._path)
        return int(first.image.shape[0]), int(first.image.shape[1])

    def _topics(self) -> list[str]:
        distance = [] if self._distance_topic is None else [self._distance_topic]
        return [self._amplitude_topic, *distance]

    def open(self) -> None:
        """Begin to play. DeviceError if it is open already, or the recording cannot be read."""
        self._refuse_open()
        try:
            self.grid  # noqa: B018 - reads the shape out of the recording
        except DataError as error:
            raise self._error(str(error)) from error
        self._stream = O3MStream(self._stream.source)
        self._cycle, self._fetched, self._unpaired, self._began_s = -1, -1, 0, None
        self._start()

    def _receive(self, stop: threading.Event) -> None:
        receiver = self._receiver
        fast = math.isinf(self._speed)
        for one in self._o3m(stop) if self._is_o3m else self._bag(stop):
            if stop.is_set():
                return
            if isinstance(one, str):
                receiver.interrupt(one, wait=fast)
            else:
                self._cycle = one.cycle
                receiver.put(replace(one, arrived_s=time.monotonic()), wait=fast)
        ended = f"the recording has ended after {receiver.frames} frames"
        if self._is_o3m and not receiver.frames:
            heard, at = self._stream.heard, "" if self._port is None else f" to port {self._port}"
            none = f"it holds no UDP datagrams{at}, in which an O3M sends (others send by TCP)"
            ended += f": {self._stream.explain(O3MStream().snapshot()) if heard else none}"
        receiver.end(ended)

    def _o3m(self, stop: threading.Event) -> Iterator[CameraFrame | str]:
        """Yield frames, and in words what interrupted them."""
        for time_s, source, port, payload in read_udp(self._path):
            if self._port not in (None, port):
                continue
            self._wait(time_s, stop)
            try:
                frame = self._stream.push(payload, source, time_s)
            except DeviceError as error:
                yield error.problem
                continue
            if frame is not None:
                yield frame

    def _bag(self, stop: threading.Event) -> Iterator[CameraFrame]:
        """Yield frames of one amplitude image and the distance image of the same time."""
        amplitude_topic, distance_topic = self._amplitude_topic, self._distance_topic
        wanted = self._topics()
        waiting: dict[str, BagImage] = {}
        cycle = 0
        for image in read_bag(self._path, wanted):
            self._wait(image.time_s, stop)
            self._unpaired += image.topic in waiting
            waiting[image.topic] = image
            if len(waiting) < len(wanted):
                continue
            amplitude = waiting[amplitude_topic]
            distance = None if distance_topic is None else waiting[distance_topic]
            if distance is not None and abs(distance.time_s - amplitude.time_s) > _TOGETHER_S:
                older = min(amplitude, distance, key=lambda one: one.time_s)
                del waiting[older.topic]
                self._unpaired += 1
                continue
            waiting.clear()
            yield CameraFrame(_frame(amplitude, distance), cycle, 0.0)
            cycle += 1

    def _wait(self, recorded_s: float, stop: threading.Event) -> None:
        """Wait until recorded time has come, `speed` times as fast as it was."""
        if math.isinf(self._speed):
            return
        self._began_s = self._began_s or (recorded_s, time.monotonic())
        due_s = self._began_s[1] + (recorded_s - self._began_s[0]) / self._speed
        stop.wait(max(0.0, due_s - time.monotonic()))

    def newest_cycle(self) -> int:
        """Return the counter of the newest frame begun; at infinite speed, of the last fetched."""
        if math.isinf(self._speed):
            return self._fetched
        return self._stream.newest_cycle() if self._is_o3m else self._cycle

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the oldest frame not yet fetched; see `Camera.next_frame`."""
        frame = super().next_frame(timeout_s)
        self._fetched = frame.cycle
        return frame

    def _explaining(self) -> Callable[[], str]:
        return lambda: "the recording has a gap here"

    def _losses(self) -> dict[str, int]:
        return self._stream.totals() if self._is_o3m else {"unpaired_images": self._unpaired}

    def describe(self) -> Mapping[str, Any]:
        """Return what to keep beside the frames."""
        about = self._stream.describe() if self._is_o3m else {"topics": self._topics()}
        return {**about, "recording": self._path.name, "speed": f"{self._speed:g}"}


def _frame(amplitude: BagImage, distance: BagImage | None) -> Frame:
    seen: dict[str, Any] = {"amplitude": amplitude.image, "time_s": amplitude.time_s}
    if distance is not None:
        step_m = 1.0 if distance.image.dtype.kind == "f" else MILLIMETRE_M
        distance_m = distance.image.astype(np.float64) * step_m
        seen |= {"distance_m": distance_m, "valid": distance_m > 0}
    return frame_from(seen)[0]
