"""Where frames come from: a rig, a recording or a simulated camera, all alike."""

from __future__ import annotations

import itertools
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lensshift.camera import PlainOptics, RunningCamera, TofCamera
from lensshift.camera.simulate import told_stray_light
from lensshift.camera.view import intrinsics_of
from lensshift.capture.acquire import check_travel
from lensshift.capture.drivers.replay import ReplayCamera
from lensshift.capture.opening import Rig
from lensshift.capture.plan import named_plan
from lensshift.core.arrays import Array
from lensshift.core.errors import DataError, DeviceTimeout
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Intrinsics
from lensshift.core.motion import ShiftPlan
from lensshift.core.types import Burst, Frame
from lensshift.io.capture_file import FrameRecord
from lensshift.scene import Scene

_WAIT_S = 1.0  # for a frame of a recording with gaps


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A frame as it arrives."""

    frame: Frame  # what the camera saw
    place: int  # where on the plan
    taken_s: float  # `time.monotonic()` when its last byte had come
    plan: Burst  # empty frames with the shifts of the plan, the grid, and what else is known
    offset_px: Array  # [2] where the image lies by what the stage reads back, or as planned
    stage_mm: Array | None = None  # [2] where the lens was, None without a stage
    commanded_mm: Array | None = None  # [2] and where it was sent


class Source(ABC):
    """What gives frames until nobody asks for more; its plan may change between two frames."""

    def __init__(self, name: str, pattern: str) -> None:
        self.name = name  # in messages
        self._plan = self._checked(pattern)

    @property
    def pattern(self) -> str:
        """Name of the plan that the lens goes round."""
        return self._plan.name

    def choose(self, pattern: str) -> None:
        """Go round another plan from the next frame on.

        ValueError if there is no such plan, the stage cannot go there, or the plan is fixed.
        """
        self._plan = self._checked(pattern)

    @abstractmethod
    def shots(self) -> Iterator[Shot | None]:
        """Yield frames as they arrive, None now and then while none comes.

        Closing the iterator brings the lens back to rest.
        """

    def _checked(self, pattern: str) -> ShiftPlan:
        return named_plan(pattern)

    def _template(self, plan: ShiftPlan, camera: Any, told: Mapping[str, Any]) -> Burst:
        known = getattr(camera, "intrinsics", None)
        return template_of(
            plan.target_px, camera.grid, camera.modulation_hz, known, plan.name, told
        )


class RigSource(Source):
    """Frames of an open rig; each began after the stage had settled."""

    def __init__(self, rig: Rig, pattern: str = "square") -> None:
        self._rig = rig
        super().__init__(f"{rig.stage.name}, {rig.camera.name}", pattern)

    def _checked(self, pattern: str) -> ShiftPlan:
        plan = super()._checked(pattern)
        check_travel(self._rig.stage, self._rig.calibration.stage_mm(plan.target_px))
        return plan

    def shots(self) -> Iterator[Shot]:
        """Yield frames until the iterator is closed; the lens rests between two plans."""
        while True:
            plan, template = self._plan, None
            with closing(self._rig.frames(plan)) as records:  # type: ignore[type-var]
                for record in records:
                    if template is None:  # where the pixels look comes with the frames
                        known = self._rig.calibration
                        told = {"psf_sigma_px": known.psf_sigma_px} | known.of_camera
                        template = self._template(plan, self._rig.camera, told)
                    yield _of_record(record, template)
                    if self._plan is not plan:
                        break


class SimulatedSource(Source):
    """Frames of a simulated camera whose image moves by the plan, and a little beside it."""

    def __init__(
        self,
        scene: Scene,
        camera: TofCamera,
        pattern: str = "square",
        *,
        rate_hz: float = 25.0,
        shift_error_px: float = 0.02,  # rms along each axis, which nobody is told
        seed: int = 0,
    ) -> None:
        self._running = RunningCamera(scene, camera)
        self._camera, self._rate_hz = camera, rate_hz
        self._error_px, self._rng = shift_error_px, np.random.default_rng(seed)
        self._stray_light = told_stray_light(camera, seed)
        super().__init__("simulated camera", pattern)

    def shots(self) -> Iterator[Shot]:
        """Yield frames at their rate; what is late is not caught up with."""
        plan, template = self._plan, self._simulated(self._plan)
        while True:
            if self._plan is not plan:  # one template as long as it holds: a picture is of one
                plan, template = self._plan, self._simulated(self._plan)
            for place, offset_px in enumerate(plan.target_px):
                due_s = time.monotonic() + 1.0 / self._rate_hz
                moved_px = offset_px + self._error_px * self._rng.standard_normal(2)
                image = self._running.frame(moved_px[None], self._rng)
                time.sleep(max(0.0, due_s - time.monotonic()))
                now_s = time.monotonic()
                frame = Frame(image.amplitude, image.distance_m, image.valid, now_s)
                yield Shot(frame, place, now_s, template, offset_px)
                if self._plan is not plan:
                    break

    def _simulated(self, plan: ShiftPlan) -> Burst:
        camera, optics = self._camera, self._camera.optics
        lens_px = optics.blur_sigma_px if isinstance(optics, PlainOptics) else 0.0
        blur_px = math.hypot(math.sqrt(camera.pixels.fill_factor / 12.0), lens_px)
        hz, known = camera.illumination.modulation_hz[0], intrinsics_of(camera)
        told = {"psf_sigma_px": blur_px} | self._stray_light
        return template_of(plan.target_px, camera.grid, hz, known, plan.name, told)


class BurstSource(Source):
    """Frames of a burst file or of the journal of a capture, over and over unless not `again`.

    At an infinite rate they come as fast as they are fetched.
    """

    def __init__(
        self, burst: Burst, name: str, *, rate_hz: float = 20.0, again: bool = True
    ) -> None:
        self._burst, self._rate_hz, self._again = burst, rate_hz, again
        pattern = str(burst.meta.get("plan") or "recorded")
        steps = burst.meta.get("step")
        fits = isinstance(steps, list | tuple) and len(steps) == burst.frame_count
        given = np.asarray(steps if fits else _visited(burst.offset_px), dtype=np.intp)
        places, self._place = np.unique(given, return_inverse=True)
        offset_px = [burst.offset_px[self._place == n].mean(axis=0) for n in range(len(places))]
        self.plan = template_of(
            np.stack(offset_px),
            burst.grid,
            burst.frequencies_hz[0] if len(burst.frequencies_hz) == 1 else None,
            burst.intrinsics,
            pattern,
            {name: burst.meta.get(name) for name in ("psf_sigma_px", "stray_light")},
        )
        super().__init__(f"recording {name}", pattern)

    def _checked(self, pattern: str) -> ShiftPlan:
        own = self.plan.meta["plan"]
        if pattern != own:
            raise ValueError(f"a recording has its own plan ({own}); it cannot become {pattern!r}")
        return ShiftPlan(self.plan.offset_px, name=pattern)

    def shots(self) -> Iterator[Shot]:
        """Yield the frames in the order in which they were taken."""
        burst = self._burst
        for count in itertools.count():
            if count >= burst.frame_count and not self._again:
                return
            number = count % burst.frame_count
            if math.isfinite(self._rate_hz):
                time.sleep(1.0 / self._rate_hz)
            now_s = time.monotonic()
            distance_m = None if burst.distance_m is None else burst.distance_m[number]
            frame = Frame(burst.amplitude[number], distance_m, burst.valid[number], now_s)
            stage, sent = (
                None if places_mm is None else places_mm[number]
                for places_mm in (burst.stage_mm, burst.stage_commanded_mm)
            )
            place = int(self._place[number])
            yield Shot(frame, place, now_s, self.plan, burst.offset_px[number], stage, sent)


def _visited(offset_px: Array) -> Array:
    """Return where on its plan each frame was taken: the same offset is the same place.

    Places are numbered as they are first visited.
    """
    _, first, kinds = np.unique(offset_px, axis=0, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[kinds.ravel()])


class CameraSource(Source):
    """Frames of a recording of a camera, which says nothing of the lens: it went round a plan."""

    def __init__(self, camera: ReplayCamera, pattern: str = "square") -> None:
        self._camera = camera
        super().__init__(camera.name, pattern)

    def shots(self) -> Iterator[Shot | None]:
        """Yield frames as recorded; a lost frame still counts as a place of the plan."""
        self._camera.open()
        plan, template, first = self._plan, None, 0
        try:
            while True:
                try:
                    one = self._camera.next_frame(_WAIT_S)
                except DeviceTimeout:  # a gap, which may be long
                    yield None
                    continue
                if template is None or self._plan is not plan:
                    plan, first = self._plan, one.cycle
                    template = self._template(plan, self._camera, {})
                place = (one.cycle - first) % template.frame_count
                offset_px = plan.target_px[place]
                yield Shot(one.frame, place, one.arrived_s, template, offset_px)
        finally:
            self._camera.close()


def template_of(
    offset_px: Array,
    grid: Grid,
    modulation_hz: float | None,
    intrinsics: Intrinsics | None,
    name: str,
    told: Mapping[str, Any],  # of `Burst.meta`: psf_sigma_px, stray_light
) -> Burst:
    """Return a burst of empty frames: a plan, with what is known of the camera."""
    meta = {"plan": name} | {key: one for key, one in told.items() if one is not None}
    empty = Burst(np.zeros((len(offset_px), *grid.shape)), offset_px, grid, meta=meta)
    try:
        return replace(empty, modulation_hz=modulation_hz, intrinsics=intrinsics)
    except DataError as error:
        raise ValueError(f"the camera contradicts itself: {error}") from error


def _of_record(record: FrameRecord, template: Burst) -> Shot:
    frame = Frame(record.amplitude, record.distance_m, record.valid, record.time_s)
    places = (record.offset_px, record.stage_mm, record.stage_commanded_mm)
    return Shot(frame, record.step, record.arrived_s, template, *places)
