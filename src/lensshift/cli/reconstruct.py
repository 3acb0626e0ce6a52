"""`lensshift reconstruct`: from a burst to a super-resolved image, a preview and numbers."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from lensshift.cli import inputs, methods
from lensshift.cli.points import CLOUD_SUFFIXES, PointOptions, refuse_points
from lensshift.cli.recording import Split, is_recording, reconstruct_windows
from lensshift.cli.register import with_shifts
from lensshift.cli.session import Progress, Session, picked
from lensshift.cli.verbs import option, verb
from lensshift.core.errors import QualityWarning, naming

if TYPE_CHECKING:
    from lensshift.core.types import Burst, Reconstruction

_WIDTH_SOURCES = {
    "given": "as told",
    "burst": "as the burst says",
    "frames": "read from the frames",
    "assumed": "assumed: --psf-sigma-px or --calibration may know better",
}
EXPORT_SUFFIXES = (".tif", ".tiff", ".fits", ".fit", ".fts", ".png", ".npz", *CLOUD_SUFFIXES)


def width_px(text: str) -> float | None:
    """Return the width that an option tells, None for auto."""
    if text == "auto":
        return None
    from lensshift.reconstruction.problem import MOST_BLUR_PX

    try:
        told_px = float(text)
    except ValueError:
        told_px = -1.0
    if not 0.0 <= told_px <= MOST_BLUR_PX:
        expected = f"auto or a number of LR px from 0 to {MOST_BLUR_PX:g}"
        raise typer.BadParameter(f"expected {expected}, got {text!r}")
    return told_px


@dataclass(frozen=True, slots=True)
class ReconstructOptions:
    """Options of `lensshift reconstruct`."""

    burst: inputs.BurstArgument
    out: Path | None = option(None, "Result file; default: BURST_xSCALE.nc beside it.", "-o")
    scale: int = option(2, "Upscaling factor.", min=1, max=8)
    method: methods.MethodOption = "auto"
    channel: Literal["auto", "amplitude", "distance", "phasor"] = option(
        "auto", "What to reconstruct."
    )
    psf_sigma_px: float | None = option(
        None,
        "Gaussian width of optics and pixel (with --fill-factor: of the optics alone) in LR "
        "px; auto, the default: from --calibration or the burst, else read from the frames, "
        "or a square pixel (with --fill-factor: 0).",
        parser=width_px,
        metavar="PX|auto",
    )
    prior_weight: methods.WeightOption = "auto"
    method_options: list[str] | None = option(
        None,
        "Option of the method, as in iterations=30; repeatable; see `lensshift methods`.",
        "--option",
        metavar="NAME=VALUE",
    )
    frames: methods.FramesOption = None
    noise_sigma: float | None = option(None, "Noise of one LR pixel; default: estimated.", min=0.0)
    fill_factor: float | None = option(
        None, "Light-sensitive linear share of a pixel.", min=0.0, max=1.0
    )
    non_negative: bool = option(False, "Forbid negative values.")
    photometric: bool = option(False, "Estimate gain and offset of each frame.")
    seed: int = option(0, "Seed of whatever is random.", min=0)
    motion: Literal["auto", "shift", "affine"] = option(
        "auto",
        "Of frames whose shifts are not known; affine: they also turn and grow; auto: if they "
        "show it; shift: never.",
    )
    lens_field: Path | None = option(
        None, "From `lensshift lens field`: how shift and blur vary over the sensor."
    )
    calibration: Path | None = option(
        None, "From `lensshift calibrate`: shifts from stage positions."
    )
    stray_light: tuple[float, float, float] | None = option(
        None,
        "Share of the light that goes astray, its width in LR px and the standard deviation of the "
        "share, as `lensshift evaluate stray-light` measures them; default: as the burst says.",
        metavar="SHARE PX STD",
    )
    device: str | None = option(
        None,
        "Where the method auto is computed, by PyTorch; default: compiled for this processor.",
        metavar="cpu|cuda|cuda:N|numpy",
    )
    export: list[Path] | None = option(
        None, "Also write .tif, .ome.tif, .fits, .png, .npz, .ply or .pcd; repeatable."
    )
    points: PointOptions = field(default_factory=PointOptions)
    stack: inputs.StackOptions = field(default_factory=inputs.StackOptions)
    split: Split = field(default_factory=Split)


@verb()
def reconstruct(current: Session, asked: ReconstructOptions) -> None:
    """Reconstruct a super-resolved image from a burst.

    Writes the result file and a PNG preview beside a bicubic of the same burst, with the points in
    space where it is known how the pixels look. With --window: a picture of each window of frames
    of a recording of any length, without previews; called again, it goes on after a break.

    \b
    Examples:
      lensshift reconstruct burst.nc --scale 2 -o sharp.nc
      lensshift reconstruct stack.tif                       # finds the shifts itself
      lensshift reconstruct frames/*.png -o sharp.nc
      lensshift reconstruct frames/ --offsets shifts.csv --pitch-mm 0.015 --export sharp.tif
      lensshift reconstruct burst.nc --lens-field field.nc  # of `lensshift lens field`
      lensshift reconstruct burst.nc --fov-deg 60x45 --export cloud.ply --export cloud.pcd
      lensshift reconstruct recording.nc --window 4 --every 1 --workers 2 -o sr.nc
    """
    settings = picked(
        asked, "scale method channel noise_sigma fill_factor non_negative photometric seed device"
    )
    settings |= {"prior_weight": methods.parse_weight(asked.prior_weight)}
    settings |= {"frames": methods.parse_frames(asked.frames)}
    methods.check_method(asked.method)
    settings |= methods.parse_options(asked.method, asked.method_options or [])
    if asked.stray_light is not None:
        from lensshift.core.stray_light import StrayLight

        settings["stray_light"] = StrayLight(*asked.stray_light)
    if is_recording(asked):
        reconstruct_windows(current, asked, settings)
        return
    files = _plan(asked)
    burst = inputs.load_input_burst(asked.burst, asked.stack)
    burst = _looking(burst, asked)
    burst, known = _located(current, burst, asked, settings["frames"])
    if asked.psf_sigma_px is not None or asked.fill_factor is not None:
        # That of a calibration would hold the pixel as well.
        known["psf_sigma_px"] = asked.psf_sigma_px
    _reconstruct(current, asked, burst, settings | known, files)


def _looking(burst: Burst, asked: ReconstructOptions) -> Burst:
    """Return the burst with where its pixels look, as far as it is told or known."""
    from lensshift.io.export import is_ome

    intrinsics = asked.points.intrinsics(burst.grid, burst.intrinsics)
    waves = burst.amplitude.dtype.kind == "c"
    phasors = waves and burst.modulation_hz is not None
    for path in asked.export or () if waves and not phasors else ():
        if path.suffix.lower() in (".tif", ".tiff", ".png") and not is_ome(path):
            raise ValueError(f"{path}: the frames are complex; take .npz, .ome.tif or .fits")
    distances = phasors or burst.phasors is not None or burst.distance_m is not None
    distances = distances and asked.channel != "amplitude"
    refuse_points(asked.export or (), intrinsics, with_distance=distances)
    return replace(burst, intrinsics=intrinsics)


def _located(
    current: Session, burst: Burst, asked: ReconstructOptions, frames: Sequence[int] | None
) -> tuple[Burst, dict[str, Any]]:
    """Return the burst and settings with what is known of its shifts, its lens and the rig."""
    known: dict[str, Any] = {}
    lens_field, calibration = asked.lens_field, asked.calibration
    if burst.offset_source == "unknown" and calibration is None and len(frames or "all") > 1:
        told = {"motion": asked.motion, "photometric": asked.photometric or None, "frames": frames}
        burst = with_shifts(current, burst, **told)
    elif asked.motion != "auto":
        raise ValueError("--motion is for unknown shifts; lensshift register finds others anew")
    if calibration is not None:
        from lensshift.io.calibration_file import load_calibration

        measured = load_calibration(calibration)
        burst, field = measured.applied_to(burst)
        width = measured.psf_sigma_px
        known = {} if width is None else {"psf_sigma_px": width}
        known |= {} if lens_field is not None else {"shift_field": field}
    if lens_field is not None:
        from lensshift.io import load_lens_field

        found = load_lens_field(lens_field)
        with naming(lens_field):
            found.of(burst)
        known["lens_field"] = found
    return burst, known


def say_channels(current: Session, result: Reconstruction) -> None:
    """Print and hand back what is worth knowing about each channel."""
    channels = current.result["channels"] = {}
    for name, estimate in result.channels.items():
        numbers = picked(estimate, "prior_weight noise_sigma noise_gain")
        status, count = estimate.status.value, len(estimate.objective)
        channels[name] = {"status": status, "iterations": count, **numbers}
        current.say(f"{name}: {status}" + (f", {count} iterations" if count else ""))
        for label, number in numbers.items():
            if number is not None:
                unit = " m" if (name, label) == ("distance", "noise_sigma") else ""
                current.say(f"  {label.replace('_', ' '):<13}{number:.4g}{unit}")
        if of_frames := estimate.notes.get("noise_of_frames"):
            channels[name]["noise_of_frames"] = of_frames
            current.say(f"  {'of frames':<13}{', '.join(f'{sigma:.3g}' for sigma in of_frames)}")
        if unseen := estimate.notes.get("unseen"):
            channels[name]["unseen"] = unseen
            share = f"{100 * unseen:.2g} % of the pixels, drawn as what is beside them"
            current.say(f"  {'hardly seen':<13}{share}")


def _reconstruct(
    current: Session,
    asked: ReconstructOptions,
    burst: Burst,
    settings: dict[str, Any],
    files: Sequence[Path],
) -> None:
    import lensshift
    from lensshift.io import export_reconstruction, save_reconstruction
    from lensshift.reconstruction.problem import blur_width_px

    rows, cols = burst.grid.shape
    source, points, count = inputs.source_of(asked.burst), asked.points, burst.frame_count
    told = f"{count} frames of {rows} x {cols} px, offsets {burst.offset_source}"
    current.say(f"{source}: {told if count > 1 else f'one frame of {rows} x {cols} px'}")
    used = burst.select(settings["frames"] or range(count))
    if (little := _adds_little(used)) and not settings.keys() & {"shift_field", "lens_field"}:
        current.warn(little)
    start_s = time.perf_counter()
    progress = Progress(f"reconstructing with {settings['method']}", preparing=True)
    with progress, naming(source):
        result = lensshift.reconstruct(burst, **settings, on_iteration=progress)
    seconds = time.perf_counter() - start_s
    target, preview, *exports = files
    save_reconstruction(result, target)
    for path in exports:
        export_reconstruction(result, path, bits=16, **picked(points, "keep_flying normals"))
    _preview(burst, result, settings, preview)
    rows, cols = shape = result.grid.shape
    current.say(f"{result.method} x{result.scale}: {rows} x {cols} px in {seconds:.2f} s")
    if "psf_source" in result.settings:
        width_px, told_by = (result.settings[name] for name in ("psf_sigma_px", "psf_source"))
        undone_px = blur_width_px(result.settings["blur"])
        undone = "" if undone_px == width_px else f"; undone: {undone_px:.3g} px"
        undone += " and the spots of the lens field" if settings.get("lens_field") else ""
        error_px = result.settings.get("psf_std_px")
        spread = "" if error_px is None else f" +- {error_px:.2g}"
        current.say(f"blur {width_px:.3g}{spread} px, {_WIDTH_SOURCES[told_by]}{undone}")
    if stray := result.settings.get("stray_light"):
        told_by = "given" if asked.stray_light else "burst"
        share = f"{100 * stray['share']:.2g} % over {stray['sigma_px']:.3g} px"
        current.say(f"stray light {share}, {_WIDTH_SOURCES[told_by]}: taken out")
    say_channels(current, result)
    current.wrote(*files)
    current.result |= {"input": source, "frame_count": count}
    current.result |= picked(result, "method scale") | {"shape": shape, "seconds": seconds}
    flying = None if result.flying is None else float(result.flying.mean())
    current.result |= {"flying_share": flying, "settings": dict(result.settings)}


def _adds_little(burst: Burst) -> str:
    """Say why frames tell no more than one of them; nothing if they do."""
    if burst.frame_count == 1:
        return "one frame tells no more than its pixels: frames at other shifts do"
    import numpy as np

    from lensshift.registration.register import POOR_SIGMA_PX

    moved_px = burst.offset_px - burst.offset_px[0]
    apart_px = float(np.abs(moved_px - np.round(moved_px)).max())  # whole pixels show the same
    if apart_px > POOR_SIGMA_PX or burst.shift_field is not None:
        return ""
    return (
        f"the {burst.frame_count} frames lie within {apart_px:.2g} px of whole pixels: they tell "
        "no more than one of them with less noise; frames at other shifts do"
    )


def _preview(burst: Burst, result: Reconstruction, settings: dict[str, Any], path: Path) -> None:
    import lensshift

    same = {name: settings[name] for name in ("scale", "channel", "frames", "seed")}
    if same["channel"] == "phasor":  # bicubic takes each of its channels on its own
        same["channel"] = "auto"
    # of the burst all was said
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        bicubic = lensshift.reconstruct(burst, method="bicubic", std=False, **same)
    reference = {name: one.image for name, one in bicubic.channels.items()}
    title = f"{result.method} x{result.scale}"
    try:
        from lensshift.report.result import result_figure
    except ImportError:  # no matplotlib: the images alone
        from lensshift.report.preview import save_shots

        images = {name: one.image for name, one in result.channels.items()}
        save_shots({"one frame, bicubic": reference, title: images}, "", path)
        return
    from lensshift.report.save import save_figure

    placed = result.intrinsics is not None and result.distance_m is not None
    cloud = result.point_cloud() if placed else None
    figure = result_figure(result, reference, title=title, cloud=cloud or None)
    save_figure(figure, path)


def _plan(asked: ReconstructOptions) -> list[Path]:
    """Decide all names, and complain before the work rather than after it."""
    from lensshift.io.export import is_fits
    from lensshift.io.fits_file import astropy_fits

    result = asked.out or inputs.beside(inputs.source_of(asked.burst), f"_x{asked.scale}.nc")
    other, exports = result.suffix.lower() in EXPORT_SUFFIXES, asked.export or []
    cure = f"; use --export for {result.suffix}" if other else ""
    inputs.check_netcdf(result, "the result", cure)
    for path in exports:
        if path.suffix.lower() not in EXPORT_SUFFIXES:
            raise typer.BadParameter(
                f"{path}: expected a name that ends in {', '.join(EXPORT_SUFFIXES)}"
            )
        if is_fits(path):
            astropy_fits()  # or say what to install
    files = [result, result.with_name(f"{result.stem}_preview.png"), *exports]
    inputs.check_files((*asked.burst, asked.stack.offsets), files)
    return files
