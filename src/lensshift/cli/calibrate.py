"""`lensshift calibrate`: from a scan to what the stage does to the image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lensshift.cli.inputs import check_files
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from lensshift.pipeline.calibrate import RigCalibration


@dataclass(frozen=True, slots=True)
class _CalibrateOptions:
    scan: Path = argument("Burst file of a scan, with stage positions.", metavar="SCAN")
    out: Path | None = option(None, "Calibration; default: SCAN_calibration.json beside it.", "-o")
    lens_field: Path | None = option(
        None, "From `lens field`: what the scan adds to it goes to SCAN_lens_field.nc beside OUT."
    )
    report: Path | None = option(None, "Also write an HTML page.")
    photometric: bool | None = option(
        None, "Allow frames to differ by a factor and a constant, or not; else if they show it.",
        "--photometric/--no-photometric",
    )  # fmt: skip
    no_psf: bool = option(False, "Do not measure the blur.")
    noise: float = option(0.005, "Noise of a pixel / full scale, for the loss in dB.", min=1e-6)


@verb("calibrating")
def calibrate(current: Session, asked: _CalibrateOptions) -> None:
    """Find image shift per stage travel, play, drift and blur from a scan.

    \b
    Examples:
      lensshift calibrate scan.nc -o calibration.json
      lensshift calibrate scan.nc -o calibration.json --report calibration.html
      lensshift calibrate scan.nc --lens-field field.nc
      lensshift reconstruct burst.nc --calibration scan_calibration.json \\
        --lens-field scan_lens_field.nc
    """
    scan, lens_field, report = asked.scan, asked.lens_field, asked.report
    target = asked.out or scan.with_name(f"{scan.stem}_calibration.json")
    refined = target.with_name(f"{scan.stem}_lens_field.nc")
    files = [target] if report is None else [target, report]
    files += [] if lens_field is None else [refined]
    check_files((scan, lens_field), files)
    from lensshift.io import load_burst, load_lens_field, save_lens_field
    from lensshift.io.calibration_file import save_calibration
    from lensshift.pipeline.calibrate import calibrate_rig

    done = calibrate_rig(
        load_burst(scan), lens_field=None if lens_field is None else load_lens_field(lens_field),
        psf=not asked.no_psf, **picked(asked, "photometric noise report"),
    )  # fmt: skip
    save_calibration(done.calibration, target)
    if done.fit.lens_field is not None:
        save_lens_field(done.fit.lens_field, refined)
    current.result["input"] = scan
    _say(current, done, told=lens_field is not None)
    if not asked.no_psf and done.calibration.psf_sigma_px is None:
        current.say("blur       not measured: no straight edge between even areas")
    current.wrote(*files)


def _say(current: Session, done: RigCalibration, *, told: bool) -> None:
    found = done.calibration
    current.tell(found.stage_map, "px_per_mm sigma_px")
    current.tell(found, "px_per_mm_sigma rest_mm play_mm play_sigma_mm drift_px_per_s psf_sigma_px")
    current.tell(done.fit, "field_order")
    current.tell(done, "psnr_loss_db mtf50_loss")
    matrix = found.stage_map.px_per_mm
    current.say(f"image row  {matrix[0, 0]:9.4f} {matrix[0, 1]:9.4f} px per mm of stage row, col")
    current.say(f"image col  {matrix[1, 0]:9.4f} {matrix[1, 1]:9.4f}")
    current.say(f"play       {1e3 * found.play_mm[0]:9.2f} {1e3 * found.play_mm[1]:9.2f} um")
    drift = 60.0 * found.drift_px_per_s
    current.say(f"drift      {drift[0]:9.4f} {drift[1]:9.4f} px per minute")
    if found.psf_sigma_px is not None:
        current.say(f"blur       {found.psf_sigma_px:9.3f} px, at straight edges of the scene")
    order = done.fit.field_order
    same = "as the lens field says" if told else "the same"
    more = f"{'the lens field and a ' if told else ''}polynomial of order {order}"
    current.say(f"over the sensor: {same if order == 0 else more}")
    current.say(
        f"residual   {found.stage_map.sigma_px:9.4f} px rms, costs {done.psnr_loss_db:.2f} dB PSNR"
    )
