"""Go round a plan until the caller stops: one burst after another, or one frame after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from itertools import islice
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
from lensshift.core.arrays import Array
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
    order, positions = _in_order(stage, camera, plan, calibration, settings)
    header = capture_header(stage, camera, positions, calibration, asdict(settings), plan.name)
    each = len(order) * (1 if settings.average else settings.frames)
    with returning(stage, calibration.rest_mm) as ending:
        rounds = _rounds(stage, camera, positions, calibration, settings)
        while True:
            records = list(islice(rounds, each))
            ending.check()
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
    order, positions = _in_order(stage, camera, plan, calibration, settings)
    with returning(stage, calibration.rest_mm) as ending:
        for record in _rounds(stage, camera, positions, calibration, settings):
            ending.check()
            yield replace(record, step=order[record.step])


def _in_order(
    stage: Stage, camera: Camera, plan: ShiftPlan, calibration: Calibration, settings: Acquisition
) -> tuple[list[int], Array]:
    """Return the places of a plan in the order of endless visits, and where they are."""
    calibration.check_sensor(camera.grid.shape)
    positions = calibration.stage_mm(plan.target_px)
    check_travel(stage, positions)
    order = list(range(len(positions)))
    if settings.reorder:
        order = shortest_order(positions, run_up_mm(stage, settings), positions[-1])
    return order, positions[order]


def _rounds(
    stage: Stage, camera: Camera, positions: Array, calibration: Calibration, settings: Acquisition
) -> Iterator[FrameRecord]:
    while True:
        for step, target in enumerate(positions):
            for one in at_position(stage, camera, target, calibration, settings, settings.frames):
                yield replace(one, step=step)
