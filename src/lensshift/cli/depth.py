"""`lensshift evaluate depth` and `stray-light`: errors of distances, and of the camera's light."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from lensshift.cli import images, outputs
from lensshift.cli.images import Measured
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import argument, option, verb
from lensshift.core.errors import warn_quality

if TYPE_CHECKING:
    from lensshift.core.arrays import Array


@dataclass(frozen=True, slots=True)
class _DepthOptions:
    image: Path = argument("Image, burst file or reconstruction.")
    truth: Path | None = argument("True distances in m, an image of the same shape.", default=None)
    pitch_mm: images.PitchOption = None
    scale: int | None = option(
        None, "Pixels of IMAGE per LR pixel; a reconstruction knows it.", min=1, max=16
    )
    edge_width_px: float = option(2.0, "Half width of edges, in LR pixels.")
    noise_m: float = option(0.0, "Standard deviation of the distances.")
    min_step_m: float | None = option(None, "Smallest step that is an edge; 5 % if not given.")
    edge: Literal["col", "row"] | None = option(
        None, "Compare the place of one edge that this axis crosses."
    )
    plane: str | None = option(None, "Fit a plane in row start,stop,col start,stop.")
    focal_length_mm: float | None = option(
        None, "Of the lens, to turn radial distances into points."
    )
    repeated: bool = option(False, "The frames repeat one view: give their noise.")
    frame: int = option(0, "Frame of IMAGE, if it holds several.", min=0)
    key: str | None = option(None, "Array of an NPZ file; distance for burst and reconstruction.")
    truth_key: str | None = option(None, "The same for TRUTH.")
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


@verb("measuring distances")
def depth(current: Session, asked: _DepthOptions) -> None:
    """Judge a distance image: errors against the truth, flying pixels, fill rate, planes, noise.

    \b
    Example:
      lensshift evaluate depth sharp.nc truth.npz --truth-key distance_m --plot depth.png
      lensshift evaluate depth frames.nc --plane 2,14,20,44 --focal-length-mm 42.7
      lensshift evaluate depth frames.nc --repeated
    """
    image, truth = asked.image, asked.truth
    place = images.parse_region(asked.plane)
    outputs.check([image, truth], asked.to.csv, plot=asked.to.plot)
    measured = _distance_image(image, asked.pitch_mm, asked.key, asked.frame)
    options: dict[str, Any] = {
        "scale": asked.scale or measured.scale, "noise_m": asked.noise_m,
        "edge_width_px": asked.edge_width_px, "min_step_m": asked.min_step_m,
    }  # fmt: skip
    current.result |= {"image": image, "truth": truth, **options}
    true_m = None if truth is None else _distance_image(truth, None, asked.truth_key, 0).values
    if true_m is not None:
        _errors(current, measured, true_m, options)
        if asked.edge is not None:
            _edge_place(current, measured, true_m, asked.edge, options)
    elif asked.edge is not None:
        raise typer.BadParameter("--edge needs the truth")
    _surfaces(current, measured, true_m, options)
    if place is not None:
        _plane(current, measured, place, asked.focal_length_mm)
    if asked.repeated:
        _noise(current, image)
    told = current.result.items()
    numbers = {k: v for k, v in told if isinstance(v, int | float) and not isinstance(v, bool)}
    columns = {"name": list(numbers), "value": list(numbers.values())}
    outputs.write_table(current, asked.to.csv, columns)
    shown = ("depth.depth_figure", measured.values, true_m)
    outputs.write_plot(current, asked.to.plot, *shown, valid=measured.valid, **options)


def _distance_image(path: Path, pitch_mm: str | None, key: str | None, frame: int) -> Measured:
    import numpy as np

    from lensshift.core.units import doubt_about_distance

    found = images.measured_image(path, pitch_mm, key=key, frame=frame, distances=True)
    known = found.values[np.isfinite(found.values)]
    if doubt := doubt_about_distance(float(np.median(known)) if known.size else None):
        warn_quality(f"{path}: {doubt}", 2)
    return found


def _errors(current: Session, measured: Measured, true_m: Array, options: dict[str, Any]) -> None:
    from lensshift.evaluation.depth import depth_error

    found = asdict(depth_error(measured.values, true_m, valid=measured.valid, **options))
    current.result |= found
    names = {"RMSE": "rmse_m", "mean absolute error": "mae_m", "bias": "bias_m"}
    names |= {"RMSE near edges": "edge_rmse_m", "RMSE elsewhere": "flat_rmse_m"}
    for label, name in names.items():
        value_m = found[name]
        told = f"{1e3 * value_m:.2f} mm" if value_m == value_m else "no such pixel"
        current.say(f"{label:<22}{told}")
    current.say(f"{'fill rate':<22}{100 * found['fill_rate']:.1f} % of the true pixels")


def _edge_place(
    current: Session, measured: Measured, true_m: Array, along: Any, options: dict[str, Any]
) -> None:
    from lensshift.evaluation.depth import edge_location_error

    kept = {name: options[name] for name in ("scale", "noise_m", "min_step_m")}
    found = edge_location_error(measured.values, true_m, valid=measured.valid, along=along, **kept)
    current.result["edge_location"] = asdict(found)
    current.say(
        f"{'place of the edge':<22}off by {found.mean_px:+.3f} LR px in the mean, "
        f"{found.rms_px:.3f} rms, in {found.lines} lines"
    )


def _surfaces(
    current: Session, measured: Measured, true_m: Array | None, options: dict[str, Any]
) -> None:
    from lensshift.evaluation.depth import fill_rate
    from lensshift.evaluation.surface import flying_pixel_fraction

    found = flying_pixel_fraction(measured.values, true_m, valid=measured.valid, **options)
    checked = int(found.checked.sum())
    current.result |= {"flying_fraction": found.fraction, "flying_checked": checked}
    share = f"{100 * found.fraction:.1f} % of {checked} pixels near edges"
    current.say(f"{'flying pixels':<22}{share if checked else 'no edge to check'}")
    if true_m is None:
        rate = fill_rate(measured.values, valid=measured.valid)
        current.result["fill_rate"] = rate
        current.say(f"{'fill rate':<22}{100 * rate:.1f} %")


def _plane(
    current: Session, measured: Measured, region: images.Region, focal_length_mm: float | None
) -> None:
    import numpy as np

    from lensshift.evaluation.surface import fit_plane

    rows, cols = measured.values.shape
    cut = images.slices_of(region, (rows, cols))
    if not focal_length_mm or not measured.has_pitch:
        raise typer.BadParameter(
            "--plane needs --focal-length-mm and the pitch, to turn distances into points"
        )
    row_mm = (np.arange(rows) - 0.5 * (rows - 1)) * measured.pitch_mm[0]
    col_mm = (np.arange(cols) - 0.5 * (cols - 1)) * measured.pitch_mm[1]
    sides_mm = np.meshgrid(row_mm, col_mm, [focal_length_mm], indexing="ij")
    rays = np.concatenate(sides_mm, axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    valid = None if measured.valid is None else measured.valid[cut]
    found = fit_plane(measured.values[cut], valid=valid, directions=rays[cut])
    told = "normal offset_m rms_m max_m count bias_rms_m noise_rms_m"
    current.result["plane"] = picked(found, told)
    current.say(
        f"{'plane':<22}rms {1e3 * found.rms_m:.2f} mm: bias {1e3 * found.bias_rms_m:.2f}, "
        f"noise {1e3 * found.noise_rms_m:.2f} mm, {found.count} pixels"
    )


def _noise(current: Session, path: Path) -> None:
    from lensshift.evaluation.noise import temporal_noise

    frames = images.measured_frames(path, "--repeated", key="distance")
    found = temporal_noise(frames.values, valid=frames.valid)
    current.result["temporal_noise_m"] = found.median
    current.say(
        f"{'noise over time':<22}{1e3 * found.median:.2f} mm, median over the pixels, "
        f"{len(frames.values)} frames"
    )


@dataclass(frozen=True, slots=True)
class _StrayLightOptions:
    with_object: Path = argument("Burst with a bright, near, small object in the scene.")
    without: Path = argument("The same without it.")
    calibration: Path | None = option(
        None, "Calibration of this rig, to keep it in; captures with it then tell it."
    )


@verb("measuring stray light")
def stray_light(current: Session, asked: _StrayLightOptions) -> None:
    """Measure which share of the light goes astray in the lens, and how far.

    Away from the object nothing changes but its stray light. `reconstruct` takes it out, so that a
    dark surface beside a bright one keeps its distance.

    \b
    Example:
      lensshift evaluate stray-light card.nc empty.nc
      lensshift reconstruct burst.nc --stray-light 0.0099 8.1 0.0003
    """
    from lensshift.evaluation.stray_light import measure_stray_light
    from lensshift.io import load_burst
    from lensshift.io.calibration_file import load_calibration, save_calibration

    target = asked.calibration
    known = None if target is None else load_calibration(target)
    found = measure_stray_light(load_burst(asked.with_object), load_burst(asked.without))
    current.tell(asked, "with_object without")
    current.result |= found.table
    share, error = 100 * found.share, 100 * found.share_std
    current.say(
        f"stray light {share:.3g} +- {error:.1g} % of the light, spread by {found.sigma_px:.3g} px"
    )
    if target is not None and known is not None:
        save_calibration(replace(known, notes={**known.notes, "stray_light": found.table}), target)
        current.wrote(target)
    else:
        told = f"{found.share:.4g} {found.sigma_px:.3g} {found.share_std:.2g}"
        current.say(f"lensshift reconstruct BURST --stray-light {told}")
