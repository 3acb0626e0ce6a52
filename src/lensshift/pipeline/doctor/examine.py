"""From a rig file to a calibrated rig, or to the one thing that is wrong with it."""

from __future__ import annotations

import errno
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.capture.acquire import Progress, acquire_at, check_travel
from lensshift.capture.opening import RigFile, read_rig
from lensshift.capture.rig import Camera, OnHoming, Stage
from lensshift.core.arrays import Floats
from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError, DeviceError, QualityWarning
from lensshift.core.motion import StageMap
from lensshift.io.calibration_file import save_calibration
from lensshift.io.capture_file import refuse_taken
from lensshift.pipeline.calibrate import RigCalibration, calibrate_rig
from lensshift.pipeline.doctor.axes import (
    Axes,
    map_findings,
    nudge,
    nudge_findings,
    reading_noise_mm,
)
from lensshift.pipeline.doctor.budget import ErrorBudget, error_budget
from lensshift.pipeline.doctor.findings import Finding, Level, disk_fault, stage_fault
from lensshift.pipeline.doctor.network import camera_fault, holder_of_file
from lensshift.pipeline.doctor.page import doctor_page
from lensshift.pipeline.doctor.view import (
    LEAST_AVERAGES,
    MOST_AVERAGES,
    WANTED_PX,
    View,
    look,
    view_findings,
)
from lensshift.pipeline.run import made_folder, writable_folder
from lensshift.registration import calibration_scan_mm
from lensshift.registration.robust_fit import BUDGET_PX
from lensshift.registration.scan import USUAL_STEPS

_SCAN_PX = 1.7  # as `pipeline.rig`
_BURST_PX = 0.5  # from one end of a burst to the other: a travel of less is of no use
_BYTES_PER_PIXEL = 64  # of a record of a journal, raw data of the camera and all; rather more
_WARM_CELSIUS = 0.5  # worth a word
_TOLD_DRIFT_SIGMAS = 4.0  # drift by less may be chance
# Of a calibration, beside its map, for programs.
_TOLD = ("px_per_mm_sigma", "play_mm", "play_sigma_mm", "drift_px_per_s", "psf_sigma_px")
OnStep = Callable[[str, Progress | None], None]


@dataclass(slots=True, eq=False)
class Diagnosis:
    """What the doctor found, as far as it came; `devices`: "stage", "camera" -> of themselves."""

    source: str  # the rig file
    began: str = field(default_factory=lambda: datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"))
    findings: list[Finding] = field(default_factory=list)
    devices: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)  # of the camera
    averages: int = 0  # frames at each position, 0 before they are chosen
    view: View | None = None
    axes: Axes | None = None
    calibration: RigCalibration | None = None
    budget: ErrorBudget | None = None
    files: list[Path] = field(default_factory=list)  # written

    @property
    def level(self) -> Level:
        """That of the worst finding."""
        return max((one.level for one in self.findings), default=Level.NOTE)

    @property
    def verdict(self) -> str:
        """One line: the worst finding, or that the rig is well, with numbers."""
        if self.level > Level.NOTE:
            return max(self.findings, key=lambda one: one.level).line
        if self.budget is None:
            return "NOT EXAMINED"
        return (
            f"HEALTHY: the shift of a frame is known to {self.budget.shift_px:.4f} px rms, with "
            f"{self.averages} frames at each position"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain values, for JSON."""
        told: dict[str, Any] = {"verdict": self.verdict, "level": self.level.name.lower()}
        told |= {"rig": self.source, "began": self.began, "devices": self.devices}
        each = [asdict(one) | {"level": one.level.name.lower()} for one in self.findings]
        told["findings"] = each
        told |= {"averages": self.averages, "counts": self.counts, "files": self.files}
        for name, part in (("view", self.view), ("axes", self.axes)):
            told[name] = None if part is None else part.numbers
        if self.budget is not None and self.calibration is not None:
            found = self.calibration.calibration
            told["error_budget_px"] = self.budget.parts | {"shift": self.budget.shift_px}
            of_map = {name: getattr(found.stage_map, name) for name in ("px_per_mm", "sigma_px")}
            told["calibration"] = of_map | {name: getattr(found, name) for name in _TOLD}
        return told


def examine_rig(
    config: str | Path | Mapping[str, Any],
    out_dir: str | Path,
    *,
    on_homing: OnHoming | None = None,
    on_step: OnStep | None = None,
) -> Diagnosis:
    """Look at everything between the rig file and a calibration, and calibrate if all is well.

    The camera first, then the stage; what is needed by the next step is looked at before it. With
    a fault nothing moves any more, and the lens is brought back to rest.

    Parameters
    ----------
    config : rig file (TOML), or what is in one
    out_dir : folder for scan.nc, calibration.json and doctor.html
    on_homing : hears how far each axis will go before it is homed, and gives leave, see `open_rig`
    on_step : called with what is done now, and how far the scan is

    Raises
    ------
    DataError
        If the rig file describes no rig, or the folder holds an earlier scan or cannot be written.
    """
    told = read_rig(config)
    done = Diagnosis(told.source)
    folder = made_folder(writable_folder(out_dir))
    files = [folder / name for name in ("scan.nc", "calibration.json")]
    for path in files:
        refuse_taken(path)
    say = on_step or (lambda what, now: None)
    with ExitStack() as opened:
        camera = _camera(done, told, opened, say)
        stage = _stage(done, told, opened, on_homing, say)
        if camera is not None and stage is not None and done.level < Level.FAULT:
            with _found(done, stage.name):
                _calibrated(done, told, stage, camera, files, say)
        if camera is not None:
            _last_words(done, camera)
    page = folder / "doctor.html"
    with _found(done):
        doctor_page(done).save(page)
        done.files.append(page)
    return done


def _camera(done: Diagnosis, told: RigFile, opened: ExitStack, say: OnStep) -> Camera | None:
    """Open the camera, look what comes."""
    say("listening for the camera", None)
    kind = told.camera.get("kind", "o3m")
    port = told.camera.get("port", 42000) if kind == "o3m" else None
    camera: Camera | None = None
    patience_s = told.acquisition.frame_timeout_s
    try:
        camera = told.open_camera()
        opened.callback(camera.close)
        done.view = look(camera, patience_s)
    except DeviceError as error:
        done.findings.append(camera_fault(error, camera, port, lambda what: say(what, None)))
    if camera is None:
        return None
    done.devices["camera"] = {"name": camera.name, **camera.describe()}
    done.counts = dict(camera.counts())
    if done.view is not None:
        done.findings += view_findings(done.view, done.counts, done.devices["camera"])
    return camera


def _stage(
    done: Diagnosis, told: RigFile, opened: ExitStack, on_homing: OnHoming | None, say: OnStep
) -> Stage | None:
    """Open the stage; with a fault of the camera it is asked who it is, and stays where it is."""
    say("asking the stage", None)
    home = "never" if done.level == Level.FAULT else None
    try:
        stage = told.open_stage(home, on_homing)
    except DeviceError as error:
        fault = stage_fault(error)
        if fault.name == "second process" and (holder := holder_of_file(error.device)):
            fault = replace(fault, said=f"{fault.said} ({holder})")
        done.findings.append(fault)
        return None
    opened.callback(stage.close)
    done.devices["stage"] = stage.describe()
    return stage


@contextmanager
def _found(done: Diagnosis, stage: str = "") -> Iterator[None]:
    """Turn what ends the block into a finding, if it is about the rig."""
    try:
        yield
    except (DeviceError, DataError, OSError, ValueError) as error:
        full = disk_fault(error)
        if full is not None:
            done.findings.append(full)
        elif isinstance(error, DeviceError) and error.device not in stage:
            done.findings.append(Finding(Level.FAULT, "camera", str(error)))
        elif isinstance(error, DeviceError) or "out of travel" in str(error):
            done.findings.append(stage_fault(error))
        else:
            raise


def _calibrated(
    done: Diagnosis, told: RigFile, stage: Stage, camera: Camera, files: list[Path], say: OnStep
) -> None:
    """Nudge, scan, calibrate; write what came of it."""
    if done.view is None:
        return
    scan_file, calibration_file = files
    reading_mm = reading_noise_mm(stage)
    per_mm = told.calibration.stage_map.px_per_mm
    encoder_px = float(np.sqrt(np.max((per_mm**2) @ reading_mm**2)))
    needed = max(done.view.averages_needed, (encoder_px / WANTED_PX) ** 2)
    done.averages = averages = int(np.clip(np.ceil(needed), LEAST_AVERAGES, MOST_AVERAGES))
    _room_for(scan_file, averages, camera)
    settings = replace(told.acquisition, frames=averages, average=True)
    _scan_mm(stage, told.calibration)  # a rest that is too near to a limit shows before it moves
    say("nudging each axis by 50 um", None)
    done.axes = nudge(stage, camera, told.calibration, settings)
    done.findings += nudge_findings(done.axes, done.view.sigma_px / np.sqrt(averages))
    if done.level == Level.FAULT:
        return
    rough = Calibration(StageMap(done.axes.px_per_mm), told.calibration.rest_mm)
    scan = acquire_at(
        stage, camera, _scan_mm(stage, rough), rough, scan_file, settings, direct=True,
        plan_name="scan", on_step=lambda now: say("scan", now),
    )  # fmt: skip
    done.files.append(scan_file)
    say("calibrating", None)
    with warnings.catch_warnings(record=True, action="always", category=QualityWarning) as doubts:
        done.calibration = calibrate_rig(scan, photometric=done.view.jumps or None)
    said = dict.fromkeys(str(one.message) for one in doubts)
    done.findings += [Finding(Level.DOUBT, "calibration", one) for one in said]
    done.axes = Axes.calibrated(done.calibration.calibration)
    done.budget = error_budget(done.calibration, reading_mm / np.sqrt(averages))
    done.findings += _budget_findings(done.calibration, done.budget)
    if done.level < Level.FAULT:
        save_calibration(done.calibration.calibration, calibration_file)
        done.files.append(calibration_file)
        done.findings += map_findings(done.axes, told.calibration)


def _scan_mm(stage: Stage, rough: Calibration) -> Floats:
    """Return the positions of a scan about rest, as far as the travel goes.

    ValueError with the first one out of travel if that is not as far as the positions of a burst.
    """
    rest_mm = np.asarray(rough.rest_mm)
    low_mm, high_mm = np.asarray(stage.travel_mm).T
    gain = np.linalg.norm(rough.stage_map.px_per_mm, axis=0)
    room_mm = 2.0 * np.minimum(rest_mm - low_mm, high_mm - rest_mm)
    row_mm, col_mm = np.maximum(np.minimum(_SCAN_PX / gain, room_mm), _BURST_PX / gain)
    places = calibration_scan_mm(rest_mm, (row_mm, col_mm), steps=USUAL_STEPS)
    # By rounding alone an end may lie beyond.
    nearby = np.clip(places, low_mm, high_mm)
    places = np.where(np.abs(places - nearby) < 1e-9 * (high_mm - low_mm), nearby, places)
    check_travel(stage, places)
    return places


def _room_for(path: Path, averages: int, camera: Camera) -> None:
    """Refuse a disk that is too full for a scan, before anything moves."""
    rows, cols = camera.grid.shape
    wanted = _BYTES_PER_PIXEL * rows * cols * len(calibration_scan_mm((0, 0), 1, steps=USUAL_STEPS))
    wanted *= 2  # the journal, and the burst that takes its place
    free = shutil.disk_usage(path.parent).free
    if free < wanted:
        said = f"{path.parent} has {free / 2**20:.1f} MiB left, a scan takes {wanted / 2**20:.1f}"
        raise OSError(errno.ENOSPC, said)


def _budget_findings(done: RigCalibration, budget: ErrorBudget) -> Iterator[Finding]:
    found = done.calibration
    if budget.map > BUDGET_PX:  # of a quarter of a pixel: worse than none
        said = f"the scan does not tell the map: a shift by a quarter pixel to {budget.map:.3f} px"
        name = "no texture" if budget.registration > budget.model else "calibration"
        yield Finding(Level.FAULT, name, f"{said}; no calibration is filed", budget.cure)
    elif not budget.good:
        parts = ", ".join(f"{name} {value:.4f}" for name, value in budget.parts.items())
        said = f"the shift of a frame is known to {budget.shift_px:.4f} px only ({parts})"
        yield Finding(Level.DOUBT, "calibration", said, budget.cure)
    time_s = done.fit.burst.time_s
    scan_s = 0.0 if time_s is None else float(np.ptp(time_s))
    way, error = (
        scan_s * float(np.linalg.norm(one))
        for one in (found.drift_px_per_s, found.drift_sigma_px_per_s)
    )
    if way > max(BUDGET_PX, _TOLD_DRIFT_SIGMAS * error) and not done.fit.jump:
        said = f"the image drifted by {way:.3f} +- {error:.3f} px in the {scan_s:.0f} s of the scan"
        cure = "let camera and bench warm up; clamp both"
        yield Finding(Level.DOUBT, "drift", said, cure)


def _last_words(done: Diagnosis, camera: Camera) -> None:
    """Keep the last counts; tell whether the camera warmed up meanwhile."""
    done.counts = dict(camera.counts())
    first, last = done.devices.get("camera", {}), camera.describe()
    for name, value in last.items():
        if name.endswith("_celsius") and isinstance(first.get(name), int | float):
            change, cure = value - first[name], "wait until it stands still"
            if abs(change) > _WARM_CELSIUS:
                said = f"{name.removesuffix('_celsius')} went by {change:+.1f} degrees meanwhile"
                done.findings.append(Finding(Level.NOTE, "warming up", said, cure))
    done.devices["camera"] = {"name": camera.name, **last}
