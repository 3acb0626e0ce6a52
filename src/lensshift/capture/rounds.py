"""Go round a plan until the caller stops: one burst after another, or one frame after another."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace
from itertools import cycle, islice
from pathlib import Path

from lensshift.capture.acquire import (
    Acquisition,
    at_position,
    check_travel,
    looking,
    returning,
    run_up_mm,
)
from lensshift.capture.journal import capture_header
from lensshift.capture.plan import shortest_order
from lensshift.capture.rig import Camera, Stage
from lensshift.core.calibration import Calibration
from lensshift.core.motion import ShiftPlan
from lensshift.core.types import Burst
from lensshift.io.capture_file import FrameRecord, burst_of_capture


def bursts(
    stage: Stage,
    camera: Camera,
    plan: ShiftPlan,
    calibration: Calibration,
    settings: Acquisition | None = None,
) -> Iterator[Burst]:
    """Yield one burst of the plan after another until the caller stops; then the lens returns.

    Raises
    ------
    ValueError, DeviceError
        As `acquire`.
    """
    settings = settings or Acquisition()
    positions = calibration.stage_mm(plan.target_px)
    header = capture_header(stage, camera, positions, calibration, asdict(settings), plan.name)
    each = len(positions) * (1 if settings.average else settings.frames)
    with closing(frames(stage, camera, plan, calibration, settings)) as rounds:  # type: ignore[type-var]
        while records := list(islice(rounds, each)):
            yield looking(burst_of_capture(header, records, Path(plan.name or "burst")), camera)


def frames(
    stage: Stage,
    camera: Camera,
    plan: ShiftPlan,
    calibration: Calibration,
    settings: Acquisition | None = None,
) -> Iterator[FrameRecord]:
    """Yield one frame after another, round after round of the plan, until the caller stops.

    Each is a record of a journal; its `step` is the place on the plan. Then the lens returns.

    Raises
    ------
    ValueError, DeviceError
        As `acquire`.
    """
    settings = settings or Acquisition()
    calibration.check_sensor(camera.grid.shape)
    positions = calibration.stage_mm(plan.target_px)
    check_travel(stage, positions)
    order = list(range(len(positions)))
    if settings.reorder:  # that of endless visits
        order = shortest_order(positions, run_up_mm(stage, settings), positions[-1])
    with returning(stage, calibration.rest_mm) as ending:
        for step in cycle(order):
            at = positions[step]
            for one in at_position(stage, camera, at, calibration, settings, settings.frames):
                ending.check()
                yield replace(one, step=step)
