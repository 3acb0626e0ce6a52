"""The whole chain with a rig: calibrate, capture, reconstruct, compare; here an emulated one."""

from __future__ import annotations

import time
import tomllib
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from lensshift.capture.acquire import Progress
from lensshift.capture.emulators.listener import free_udp_port
from lensshift.capture.emulators.rig import EmulatedRig, RigSettings
from lensshift.capture.opening import nominal_calibration, open_rig, read_rig
from lensshift.capture.rig import OnHoming
from lensshift.core.arrays import Array
from lensshift.core.calibration import Calibration
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Reconstruction, ShiftField
from lensshift.evaluation import fidelity
from lensshift.io import save_reconstruction
from lensshift.io.calibration_file import save_calibration
from lensshift.io.capture_file import refuse_taken
from lensshift.pipeline.calibrate import calibrate_rig
from lensshift.pipeline.experiment import images_of
from lensshift.pipeline.run import made_folder, writable_folder
from lensshift.reconstruction.methods import find_method
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.registration import calibration_scan_mm
from lensshift.registration.scan import USUAL_STEPS

SCAN_SPAN_MM = 0.3  # 1.7 px: the longer, the better the map is known
_SCAN_FRAMES = 6  # averaged at a position of the scan
_FRAMES = 8  # and at one of the burst
_PLAN = "square"
_PATIENCE_S = 20.0  # for a frame: the emulated rig shares this computer
NOMINAL_BLUR_PX = 0.3  # of a square pixel behind a fair lens
# What the rig file of a run says: 5.63 px per mm and 10 %, turned by 5 degrees, mirrored.
# Calibration is what makes the run work.
NOMINAL_PX_PER_MM = ((6.17, 0.54), (0.54, -6.17))
EMULATED_SPEED = 10.0  # of the emulated stages: only waiting gets shorter


@dataclass(frozen=True, slots=True, eq=False)
class RigSummary:
    """What a run with an emulated rig gave."""

    files: tuple[Path, ...]  # what was written
    calibration: Calibration  # measured by the scan
    reconstruction: Reconstruction
    shift_rms_px: dict[str, float]  # by the map used, common offset left out
    fidelity: dict[str, dict[str, float]]  # name -> psnr_db, ssim, rmse of the amplitude
    loss_db: float  # PSNR with perfect shifts minus PSNR with calibrated ones
    counts: dict[str, int]  # what the camera got and lost
    seconds: float  # for everything


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """A burst, and where the image really was: [frame row col 2]."""

    burst: Burst
    calibration: Calibration
    true_px: Array
    counts: dict[str, int]


def run_emulated(
    out_dir: str | Path,
    settings: RigSettings | None = None,
    *,
    scale: int = 2,
    method: str = "auto",
    on_step: Callable[[str, Progress], None] | None = None,
) -> RigSummary:
    """Start an emulated rig, calibrate it, capture over the real protocols, reconstruct, compare.

    Drivers, protocols, acquisition and calibration are those of a real rig; only the emulator knows
    where the image really was. `on_step` hears what is being done ("scan", "burst"), and how far.
    """
    start_s = time.perf_counter()
    find_method(method)
    folder = made_folder(writable_folder(out_dir))
    settings = settings or RigSettings(speed=EMULATED_SPEED)
    with EmulatedRig(settings, camera_port=free_udp_port()) as emulated:
        taken = _take(emulated, folder, on_step)
        # The origin of the image is where the calibration says that the offset is zero.
        told, field = taken.calibration.applied_to(taken.burst)
        everywhere_px = np.broadcast_to(told.offset_px[:, None, None], taken.true_px.shape)
        assumed_px = everywhere_px if field is None else field.offset_px
        origin_px = (taken.true_px - assumed_px).mean(axis=(0, 1, 2))
        truth = emulated.world.running.truth(scale, origin_px)[0]
    results = _reconstructions(taken, assumed_px, origin_px, scale, method)
    fidelities = {
        name: asdict(fidelity(images_of(result)["amplitude"], truth))
        for name, result in results.items()
    }
    calibrated = results[f"{method}, calibrated shifts"]
    files = _write(folder, taken, results, truth)
    perfect_db = fidelities[f"{method}, perfect shifts"]["psnr_db"]
    return RigSummary(
        files=files, calibration=taken.calibration, reconstruction=calibrated,
        shift_rms_px=_shift_errors(taken, assumed_px), fidelity=fidelities,
        loss_db=perfect_db - fidelities[f"{method}, calibrated shifts"]["psnr_db"],
        counts=taken.counts, seconds=time.perf_counter() - start_s,
    )  # fmt: skip


def run_bench(
    rig_file: str | Path,  # TOML, see `lensshift.capture.opening.open_rig`
    out_dir: str | Path,  # folder for burst.nc, result.nc and preview.png
    *,
    scale: int = 2,
    method: str = "auto",
    on_step: Callable[[str, Progress], None] | None = None,  # called with "burst" and how far it is
    on_homing: OnHoming | None = None,  # see `open_rig`
) -> tuple[Reconstruction, tuple[Path, ...]]:
    """Capture a burst with a rig and reconstruct it; return the result and the files written."""
    from lensshift.report.preview import save_shots

    find_method(method)
    read_rig(rig_file)  # before a folder is made for nothing
    folder = made_folder(writable_folder(out_dir))
    names = ("burst.nc", "result.nc", "preview.png")
    burst_file, result_file, preview = files = tuple(folder / name for name in names)
    refuse_taken(burst_file)
    with open_rig(rig_file, on_homing=on_homing) as rig:
        burst = rig.capture(_PLAN, burst_file, on_step=on_step and partial(on_step, "burst"))
        burst, field = rig.calibration.applied_to(burst)
    width_px = _blur_px(rig.calibration)
    result = reconstruct(burst, scale, method, psf_sigma_px=width_px, shift_field=field)
    save_reconstruction(result, result_file)
    bicubic = reconstruct(burst, scale, "bicubic", std=False)
    shown = {"bicubic": images_of(bicubic), method: images_of(result)}
    save_shots(shown, f"{burst.frame_count} frames", preview)
    return result, files


def _take(
    emulated: EmulatedRig,
    folder: Path,
    on_step: Callable[[str, Progress], None] | None,
) -> _Taken:
    """Scan and calibrate with the nominal map, then take the burst with the measured one."""
    true: list[Array] = []

    def taken(progress: Progress) -> None:
        true.append(emulated.world.offset_px(emulated.stages.lens_mm(time.monotonic())))
        if on_step is not None:
            on_step("burst", progress)

    files = {name: folder / f"{name}.nc" for name in ("scan", "burst")}
    for file in files.values():
        file.unlink(missing_ok=True)
    told = tomllib.loads(emulated.rig_file())
    told["calibration"]["px_per_mm"] = NOMINAL_PX_PER_MM
    with open_rig(told) as rig:
        patient = replace(rig.acquisition, average=True, frame_timeout_s=_PATIENCE_S)
        rig.acquisition = replace(patient, frames=_SCAN_FRAMES)
        places = calibration_scan_mm(rig.calibration.rest_mm, SCAN_SPAN_MM, steps=USUAL_STEPS)
        scan = rig.scan(places, files["scan"], on_step=on_step and partial(on_step, "scan"))
        found = calibrate_rig(scan, report=folder / "calibration.html")
        rig.calibration = found.calibration
        rig.acquisition = replace(patient, frames=_FRAMES)
        burst = rig.capture(_PLAN, files["burst"], on_step=taken)
        return _Taken(burst, rig.calibration, np.stack(true), dict(rig.camera.counts()))


def _reconstructions(
    taken: _Taken, assumed_px: Array, origin_px: Array, scale: int, method: str
) -> dict[str, Reconstruction]:
    measured_px = _blur_px(taken.calibration)

    def with_shifts(offset_px: Array, width_px: float = measured_px) -> Reconstruction:
        burst = replace(taken.burst, offset_px=offset_px.mean(axis=(1, 2)))
        return reconstruct(
            burst, scale, method, "amplitude", width_px, shift_field=ShiftField(offset_px)
        )

    # That nobody measured it is what this one shows; the frames say so, too.
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        unmeasured = with_shifts(assumed_px, NOMINAL_BLUR_PX)
    return {
        "bicubic": reconstruct(taken.burst, scale, "bicubic", channel="amplitude", std=False),
        f"{method}, a blur of {NOMINAL_BLUR_PX} px": unmeasured,
        f"{method}, calibrated shifts": with_shifts(assumed_px),
        f"{method}, perfect shifts": with_shifts(taken.true_px - origin_px),
    }


def _blur_px(calibration: Calibration) -> float:
    """Return the width of the blur, measured if it was."""
    return NOMINAL_BLUR_PX if calibration.psf_sigma_px is None else calibration.psf_sigma_px


def _shift_errors(taken: _Taken, assumed_px: Array) -> dict[str, float]:
    """Return rms errors over frames (and pixels), the common offset left out."""
    rows, cols = taken.burst.grid.shape
    middle_px = taken.true_px[:, rows // 2, cols // 2]
    nominal = nominal_calibration(NOMINAL_PX_PER_MM, rest_mm=taken.calibration.rest_mm)
    read_mm = np.asarray(taken.burst.stage_mm)
    told = {
        "nominal": (nominal.offset_px(read_mm), middle_px),
        "calibrated": (taken.burst.offset_px, middle_px),
        "calibrated over the sensor": (assumed_px, taken.true_px),
    }
    errors = {}
    for name, (offset_px, true_px) in told.items():
        error = offset_px - true_px
        error = error - error.reshape(-1, 2).mean(axis=0)
        errors[name] = float(np.sqrt(np.mean(error**2)))
    return errors


def _write(
    folder: Path, taken: _Taken, results: dict[str, Reconstruction], truth: Array
) -> tuple[Path, ...]:
    from lensshift.report.preview import save_shots

    names = ("calibration.json", "result.nc", "preview.png")
    calibration, result, preview = written = tuple(folder / name for name in names)
    before = ("scan.nc", "burst.nc", "calibration.html")
    save_calibration(taken.calibration, calibration)
    calibrated = next(one for name, one in results.items() if "calibrated" in name)
    save_reconstruction(calibrated, result)
    shown = {name: images_of(one) for name, one in results.items()}
    shown["truth"] = {"amplitude": truth}
    title = f"emulated rig: {taken.burst.frame_count} frames"
    save_shots(shown, title, preview)
    return (*(folder / name for name in before), *written)
