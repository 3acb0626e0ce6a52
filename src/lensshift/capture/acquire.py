"""Take a burst: move, settle, prove that a frame began afterwards, keep it, come back."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.capture.journal import capture_header, finished, opened
from lensshift.capture.plan import shortest_order
from lensshift.capture.rig import Camera, CameraFrame, Stage
from lensshift.core.arrays import Array, Floats
from lensshift.core.calibration import Calibration
from lensshift.core.ending import Ending, ended_by_signals
from lensshift.core.errors import DeviceError, DeviceTimeout
from lensshift.core.motion import ShiftPlan
from lensshift.core.types import Burst
from lensshift.io import save_burst
from lensshift.io.capture_file import FrameRecord, burst_of_capture

MOST_FRAMES = 100_000  # an hour at 30 Hz, at each position
_MOST_PATIENCE = 1e6  # seconds, or mm: beyond any rig; a system waits for 1e9 s at most


@dataclass(frozen=True, slots=True)
class Acquisition:
    """How frames are taken at a position.

    Parameters
    ----------
    frames : that are kept at each position
    average : keep their mean instead, as one frame
    discard : frames after the one that arrives as the stage settles which may have begun before:
        those that are being exposed or wait to be sent
    frame_timeout_s : how long to wait for a frame
    hold_mm : how far the stage may stray from its place while frames are taken
    reorder : visit the positions so that the stage moves least
    approach_mm : how far the stage overruns when it goes back, for the order, if it does not tell
    """

    frames: int = 1
    average: bool = False
    discard: int = 2
    frame_timeout_s: float = 3.0
    hold_mm: float = 0.005
    reorder: bool = True
    approach_mm: float = 0.02

    def __post_init__(self) -> None:
        for name, least in (("frames", 1), ("discard", 0)):
            if not least <= getattr(self, name) <= MOST_FRAMES:
                told = f"{least} to {MOST_FRAMES} at a position, got {getattr(self, name)}"
                raise ValueError(f"expected {name} of {told}")
        for name in ("frame_timeout_s", "hold_mm"):
            if not 0 < getattr(self, name) <= _MOST_PATIENCE:
                told = f"up to {_MOST_PATIENCE:g}, got {getattr(self, name)}"
                raise ValueError(f"expected a positive {name} {told}")
        if not abs(self.approach_mm) < math.inf:
            raise ValueError(f"expected a finite approach_mm, got {self.approach_mm}")


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """Where an acquisition is.

    Parameters
    ----------
    step, steps : positions done, and all of them
    position_mm : [2] of the stage, read back
    rate_hz : frames per second that the camera gives, 0 before the second one
    counts : what the camera got and lost
    """

    step: int
    steps: int
    position_mm: Floats
    rate_hz: float
    counts: Mapping[str, int]


_MEANWHILE = "the lens is on its way back to rest; Ctrl-C once more leaves it where it is"
_RATE_FRAMES = 16  # two that come in one gulp tell no rate
OnStep = Callable[[Progress], None]


def acquire(
    stage: Stage,
    camera: Camera,
    plan: ShiftPlan,
    calibration: Calibration,
    path: str | Path,
    settings: Acquisition | None = None,
    *,
    resume: bool = False,
    on_step: OnStep | None = None,
) -> Burst:
    """Take the burst of a plan; every frame is in the file as soon as it is taken.

    The lens returns to its rest position however this ends; after a fault of the stage itself it
    stands still where it is.

    Parameters
    ----------
    calibration : from image offsets to stage positions and back
    path : burst file; until the plan is done a journal of the same name, which `load_burst`
        reads as well
    resume : go on with an unfinished capture of the same plan and calibration; one that is
        complete is returned as it is, if it was taken so

    Raises
    ------
    ValueError
        If the plan leads out of the travel of the stage, or the calibration is of another sensor.
    DataError
        If the file cannot be written, exists already, or was begun otherwise: with another plan,
        another calibration, and so on.
    DeviceError
        If stage or camera fail; all frames until then are in the file.
    """
    position_mm = calibration.stage_mm(plan.target_px)
    return acquire_at(
        stage, camera, position_mm, calibration, path, settings,
        plan_name=plan.name, resume=resume, on_step=on_step,
    )  # fmt: skip


def acquire_at(
    stage: Stage,
    camera: Camera,
    position_mm: ArrayLike,
    calibration: Calibration,
    path: str | Path,
    settings: Acquisition | None = None,
    *,
    direct: bool = False,
    plan_name: str = "",
    resume: bool = False,
    on_step: OnStep | None = None,
) -> Burst:
    """Take frames at stage positions [step 2]; otherwise as `acquire`.

    Parameters
    ----------
    direct : go straight from one position to the next, see `Stage.move_to`; then the order stays
    """
    settings = settings or Acquisition()
    asked = {"frames": settings.frames, "average": settings.average}
    done = finished(path, plan_name, asked) if resume else None
    if done is not None:
        return done
    calibration.check_sensor(camera.grid.shape)
    positions = np.atleast_2d(np.asarray(position_mm, dtype=np.float64))
    check_travel(stage, positions)
    if settings.reorder and not direct:
        order = shortest_order(positions, run_up_mm(stage, settings), stage.position_mm())
        positions = positions[order]
    header = capture_header(stage, camera, positions, calibration, asdict(settings), plan_name)
    with (
        opened(path, header, resume=resume) as file,
        returning(stage, calibration.rest_mm) as ending,
    ):
        positions = np.asarray(file.header["position_mm"])
        each = 1 if settings.average else settings.frames
        taken = [one.step for one in file.frames]
        here = -1
        for step, target in enumerate(positions):
            missing = each - taken.count(step)
            if missing <= 0:
                continue
            if direct and here != step - 1 and step > 0:  # come from where the scan comes from
                stage.move_to(positions[step - 1], direct=True)
            here = step
            for record in at_position(
                stage, camera, target, calibration, settings, missing, direct=direct
            ):
                file.append(replace(record, step=step))
                ending.check()
            if on_step is not None:
                fresh = file.frames[len(taken) :]  # clocks of another process do not compare
                on_step(_progress(step + 1, len(positions), stage, camera, fresh))
    burst = looking(burst_of_capture(file.header, file.frames, file.path), camera)
    save_burst(burst, file.path)
    return burst


def run_up_mm(stage: Stage, settings: Acquisition) -> Any:
    """Return how far, and which way, the stage overruns; a stage of its own kind may tell."""
    return getattr(stage, "approach_mm", settings.approach_mm)


def looking(burst: Burst, camera: Camera) -> Burst:
    """Return the burst with where the pixels look, if the camera has told it with its frames.

    Few cameras do, so `Camera` does not ask for it.
    """
    return replace(burst, intrinsics=getattr(camera, "intrinsics", None))


@contextmanager
def returning(stage: Stage, rest_mm: ArrayLike) -> Iterator[Ending]:
    """Bring the lens back to rest when the block ends, or stop it where the stage has failed.

    SIGTERM and a closed terminal end the block as Ctrl-C does, and wait until the lens is back; a
    second Ctrl-C waits too, and only a third one leaves the lens where it is.
    """
    finished = failed = False
    with ended_by_signals(ctrl_c=True) as ending:
        try:
            yield ending
            finished = True
        except DeviceError as error:
            failed = bool(error.device) and error.device in stage.name  # or one of its axes
            raise
        finally:
            with ended_by_signals(at_once=False, ctrl_c=True, meanwhile=_MEANWHILE):
                _return(stage, np.asarray(rest_mm), finished=finished, failed=failed)


def _return(stage: Stage, rest_mm: Array, *, finished: bool, failed: bool) -> None:
    if not finished:
        with suppress(DeviceError):  # what has ended the capture says more
            stage.stop()
    if not failed:
        try:
            stage.move_to(rest_mm)
        except DeviceError:
            stage.stop()
            if finished:
                raise
        except KeyboardInterrupt as error:
            stage.stop()
            both = (stage.position_mm(), rest_mm)
            here, rest = (", ".join(f"{x:.4f}" for x in one) for one in both)
            raise KeyboardInterrupt(f"the lens stands at {here} mm, rest is {rest} mm") from error


def check_travel(stage: Stage, position_mm: ArrayLike) -> None:
    """Refuse positions [frame 2] out of the reach of the stage before anything moves.

    Raises
    ------
    ValueError
        With the first one that is out of reach.
    """
    low, high = np.asarray(stage.travel_mm).T
    for number, place in enumerate(np.atleast_2d(np.asarray(position_mm, dtype=np.float64))):
        if not np.all((place >= low) & (place <= high)):
            reach = " and ".join(f"{a:g} to {b:g}" for a, b in zip(low, high, strict=True))
            at = ", ".join(f"{x:.4f}" for x in place)
            raise ValueError(f"position {number} at {at} mm is out of travel ({reach} mm)")


def at_position(
    stage: Stage,
    camera: Camera,
    target_mm: Array,
    calibration: Calibration,
    settings: Acquisition,
    count: int,
    *,
    direct: bool = False,
) -> Iterator[FrameRecord]:
    """Go there and yield the records of the frames that are kept."""
    stage.move_to(target_mm, direct=direct)
    settled_cycle = camera.newest_cycle()
    if settled_cycle < 0:  # nothing to go by: the first frame may have begun before
        settled_cycle = camera.next_frame(settings.frame_timeout_s).cycle
    shots: list[CameraFrame] = []
    places_mm: list[Array] = []
    for _ in range(settings.frames if settings.average else count):
        shot = _begun_after(camera, settled_cycle + settings.discard, settings.frame_timeout_s)
        here_mm = stage.position_mm()
        strayed_mm = float(np.max(np.abs(here_mm - target_mm)))
        if strayed_mm > settings.hold_mm:
            raise DeviceError(
                f"strayed {1e3 * strayed_mm:.1f} um from its place while a frame was taken",
                device=stage.name,
                command="hold",
                position_mm=tuple(here_mm),
            )
        settled_cycle = max(settled_cycle, shot.cycle - settings.discard)
        shots.append(shot)
        places_mm.append(here_mm)
        if not settings.average:
            yield _record(shot, here_mm, target_mm, calibration)
    if settings.average:
        yield _record(_mean(shots), np.mean(places_mm, axis=0), target_mm, calibration)


def _begun_after(camera: Camera, cycle: int, timeout_s: float) -> CameraFrame:
    """Return the next frame with a later cycle: it began after the stage had settled."""
    end_s = time.monotonic() + timeout_s
    while True:
        frame = camera.next_frame(max(end_s - time.monotonic(), 0.0))
        if frame.cycle > cycle:
            return frame
        if time.monotonic() > end_s:
            raise DeviceTimeout(
                f"frames come, but none after cycle {cycle} within {timeout_s:g} s",
                device=camera.name,
                command="wait for a frame",
            )


def _record(
    shot: CameraFrame, here_mm: Array, target_mm: Array, calibration: Calibration
) -> FrameRecord:
    """Return what is kept of a frame; where its image lies follows from the position read back."""
    frame, known = shot.frame, calibration.stage_map.sigma_px > 0  # 0: nobody knows
    return FrameRecord(
        amplitude=frame.amplitude,
        valid=frame.valid,
        distance_m=frame.distance_m,
        time_s=frame.time_s,
        arrived_s=shot.arrived_s,
        stage_mm=here_mm,
        stage_commanded_mm=target_mm,
        offset_px=calibration.offset_px(here_mm),
        offset_sigma_px=calibration.offset_sigma_px(here_mm) if known else None,
        raw={**shot.raw, "cycle": np.asarray(shot.cycle)},
    )


def _mean(shots: list[CameraFrame]) -> CameraFrame:
    """Return the mean of frames: of each pixel over those in which it is valid."""
    first, last = shots[0], shots[-1]
    valid = np.stack([shot.frame.valid for shot in shots])
    count = np.maximum(valid.sum(axis=0), 1)

    def mean(frames: list[Array]) -> Array:
        total = np.where(valid, np.stack(frames), 0.0).sum(axis=0)
        return np.asarray(np.where(valid.any(axis=0), total / count, frames[0]))

    distances = [shot.frame.distance_m for shot in shots if shot.frame.distance_m is not None]
    frame = replace(
        first.frame,
        amplitude=mean([shot.frame.amplitude for shot in shots]),
        distance_m=mean(distances) if len(distances) == len(shots) else None,
        valid=np.asarray(valid.any(axis=0)),
        time_s=0.5 * (first.frame.time_s + last.frame.time_s),
    )
    return CameraFrame(frame, last.cycle, last.arrived_s)


def _progress(
    step: int, steps: int, stage: Stage, camera: Camera, frames: list[FrameRecord]
) -> Progress:
    recent = frames[-_RATE_FRAMES:]
    rate_hz = 0.0
    if len(recent) > 1 and recent[-1].arrived_s > recent[0].arrived_s:
        cycles = float(recent[-1].raw["cycle"]) - float(recent[0].raw["cycle"])
        rate_hz = cycles / (recent[-1].arrived_s - recent[0].arrived_s)
    return Progress(step, steps, stage.position_mm(), rate_hz, camera.counts())
