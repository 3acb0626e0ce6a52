"""`lensshift simulate`: a burst of a scene, with the truth beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import Pattern, PatternOption, refuse_overwriting
from lensshift.cli.session import DebugOption, JsonOption, session

if TYPE_CHECKING:
    from lensshift.camera import TofCamera, TofCapture


SceneArgument = Annotated[
    str,
    typer.Argument(
        help="four_boxes, slanted_edge, depth_step, siemens_star, zone_plate, or a TOML file."
    ),
]
OutOption = Annotated[
    Path, typer.Option("--out", "-o", help="Burst file; the truth goes beside it as .truth.npz.")
]
CameraOption = Annotated[
    str, typer.Option("--camera", help="o3m151, pmd_176x132, vga, or an experiment file (TOML).")
]
LensOption = Annotated[
    str | None, typer.Option("--lens", help="Trace this lens (a name or a file) for the image.")
]
ElementOption = Annotated[
    int, typer.Option("--element", min=0, help="Element that moves, from 1; 0: the sensor moves.")
]
ScaleOption = Annotated[int, typer.Option(min=1, max=8, help="Truth pixels per pixel.")]
ErrorOption = Annotated[
    float, typer.Option("--shift-error-px", min=0.0, help="Rms error of each shift, unknown.")
]
AmbientOption = Annotated[
    float | None, typer.Option("--ambient-klx", min=0.0, help="Sunlight on the scene.")
]
IdealOption = Annotated[bool, typer.Option("--ideal", help="No noise, no errors of the camera.")]
FloatOption = Annotated[
    bool, typer.Option("--float", help="Distances as computed, not as the camera rounds them.")
]
PhasesOption = Annotated[
    Path | None, typer.Option("--phases", help="Also write the raw phase frames (.npz).")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of noise and errors.")]


def simulate(
    scene: SceneArgument = "four_boxes",
    out: OutOption = Path("burst.nc"),
    camera: CameraOption = "o3m151",
    lens: LensOption = None,
    element: ElementOption = 1,
    pattern: PatternOption = Pattern.SQUARE,
    scale: ScaleOption = 2,
    shift_error_px: ErrorOption = 0.02,
    ambient_klx: AmbientOption = None,
    ideal: IdealOption = False,
    as_float: FloatOption = False,
    phases: PhasesOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Simulate a burst of a time-of-flight camera whose lens moves.

    Writes the burst and, as NPZ beside it, what an experimenter never knows.

    \b
    Examples:
      lensshift simulate four_boxes -o burst.nc
      lensshift simulate slanted_edge --lens petzval_a --element 1 --seed 3 -o edge.nc
      lensshift simulate my_scene.toml --camera vga --pattern 3x3 --scale 3 -o room.nc
    """
    with session(as_json=as_json, debug=debug, doing="simulating") as current:
        truth_file = out.with_suffix(".truth.npz")
        _check_outputs(scene, camera, out, truth_file, phases)
        from lensshift.camera import named_pattern_px, simulate_tof
        from lensshift.io import save_burst
        from lensshift.pipeline.experiment_file import named_scene
        from lensshift.pipeline.run import save_truth

        settings = _camera(camera, lens, element, ambient_klx, ideal=ideal, as_float=as_float)
        capture = simulate_tof(
            named_scene(scene),
            settings,
            named_pattern_px(pattern.value),
            scale=scale,
            shift_error_px=shift_error_px,
            seed=seed,
        )
        save_burst(capture.burst, out)
        save_truth(capture.truth, truth_file)
        if phases is not None:
            _save_phases(capture, phases)
        burst = capture.burst
        rows, cols = burst.grid.shape
        valid = float(burst.valid.mean()) if burst.valid is not None else 1.0
        files = [out, truth_file, *([phases] if phases is not None else [])]
        current.say(f"{burst.frame_count} frames of {rows} x {cols} px, {100 * valid:.1f} % valid")
        current.say("wrote " + ", ".join(str(path) for path in files))
        current.result |= {
            "frame_count": burst.frame_count,
            "shape": burst.grid.shape,
            "valid_share": valid,
            "offset_px": burst.offset_px,
            "files": files,
        }


def _check_outputs(
    scene: str, camera: str, out: Path, truth_file: Path, phases: Path | None
) -> None:
    """Complain before the work about names that cannot be written."""
    from lensshift.io.atomic import writable_target

    if out.suffix.lower() != ".nc":
        raise typer.BadParameter(f"expected a burst file that ends in .nc, got {out}")
    if phases is not None and phases.suffix.lower() != ".npz":
        raise typer.BadParameter(f"expected phases that end in .npz, got {phases}")
    files = [path for path in (out, truth_file, phases) if path is not None]
    refuse_overwriting((Path(scene), Path(camera)), files)
    for path in files:
        writable_target(path)


def _camera(
    name: str,
    lens: str | None,
    element: int,
    ambient_klx: float | None,
    *,
    ideal: bool,
    as_float: bool,
) -> TofCamera:
    from dataclasses import replace

    from lensshift.camera import Ambient, camera_preset
    from lensshift.pipeline.experiment_file import load_experiment, named_optics

    camera = load_experiment(name).camera if name.endswith(".toml") else camera_preset(name)
    changes: dict[str, Any] = {}
    if lens is not None:
        changes["optics"] = named_optics(lens, element)
    if ambient_klx is not None:
        changes["ambient"] = Ambient(ambient_klx)
    if as_float:
        changes["output"] = "float"
    camera = replace(camera, **changes)
    return camera.ideal() if ideal else camera


def _save_phases(capture: TofCapture, path: Path) -> None:
    import numpy as np

    from lensshift.io.atomic import written_whole

    raw = capture.raw
    with written_whole(path) as part:
        np.savez_compressed(
            part,
            difference=raw.difference,
            electrons_per_count=raw.electrons_per_count,
            exposure=raw.exposure,
            gain=raw.gain,
            saturated=raw.saturated,
            modulation_hz=np.asarray(raw.modulation_hz),
            offset_px=capture.burst.offset_px,
        )
