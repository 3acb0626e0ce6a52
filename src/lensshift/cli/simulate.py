"""`lensshift simulate`: a burst of a scene, with the truth beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensshift.cli import outputs
from lensshift.cli.inputs import PatternOption, check_netcdf
from lensshift.cli.optics import ELEMENT_HELP, element_of
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from lensshift.camera import LensOptics, PlainOptics, TofCamera

_PHASES = "difference electrons_per_count exposure gain saturated modulation_hz"


@dataclass(frozen=True, slots=True)
class _SimulateOptions:
    scene: str = argument(
        "four_boxes, slanted_edge, depth_step, siemens_star, zone_plate, or a TOML file.",
        default="four_boxes",
    )
    out: Path = option(
        Path("burst.nc"), "Burst file; the truth goes beside it as .truth.npz.", "-o"
    )
    camera: str = option("o3m151", "o3m151, pmd_176x132, vga, or an experiment file (TOML).")
    lens: str | None = option(None, "Trace this lens (a name or a file) for the image.")
    element: int | None = option(None, f"{ELEMENT_HELP} 0: the sensor moves.", min=0)
    pattern: PatternOption = "square"
    scale: int = option(2, "Truth pixels per pixel.", min=1, max=8)
    shift_error_px: float = option(0.02, "Rms error of each shift, unknown.", min=0.0, max=5.0)
    ambient_klx: float | None = option(None, "Sunlight on the scene.", min=0.0)
    ideal: bool = option(False, "No noise, no errors of the camera.")
    as_float: bool = option(
        False, "Distances as computed, not as the camera rounds them.", "--float"
    )
    phases: Path | None = option(None, "Also write the raw phase frames (.npz).")
    seed: int = option(0, "Seed of noise and errors.", min=0)


@verb("simulating")
def simulate(current: Session, asked: _SimulateOptions) -> None:
    """Simulate a burst of a time-of-flight camera whose lens moves.

    Writes the burst and, as NPZ beside it, what an experimenter never knows: among others what
    finer pixels would see through the lens (amplitude, distance_m) and without its blur
    (sharp_amplitude, sharp_distance_m).

    \b
    Examples:
      lensshift simulate four_boxes -o burst.nc
      lensshift simulate slanted_edge --lens petzval_a --element 1 --seed 3 -o edge.nc
      lensshift simulate my_scene.toml --camera vga --pattern 3x3 --scale 3 -o room.nc
    """
    out, phases = asked.out, asked.phases
    truth_file = out.parent / f"{out.stem}.truth.npz"
    check_netcdf(out, "a burst")
    if phases is not None and phases.suffix.lower() != ".npz":
        raise typer.BadParameter(f"expected phases that end in .npz, got {phases}")
    outputs.check((Path(asked.scene), Path(asked.camera)), out, truth_file, phases)
    from lensshift.camera import named_pattern_px, simulate_tof
    from lensshift.io import save_burst
    from lensshift.pipeline.experiment_file import named_scene
    from lensshift.pipeline.run import save_truth

    settings = _camera(asked)
    told = picked(asked, "scale shift_error_px seed") | {"on_progress": current.count}
    pattern_px = named_pattern_px(asked.pattern)
    capture = simulate_tof(named_scene(asked.scene), settings, pattern_px, **told)
    save_burst(capture.burst, out)
    save_truth(capture.truth, truth_file)
    if phases is not None:
        from lensshift.io.point_cloud_file import write_npz

        raw = picked(capture.raw, _PHASES)
        write_npz(phases, raw | {"offset_px": capture.burst.offset_px})
    lens, light_nm = getattr(settings.optics, "lens", None), settings.illumination.wavelength_nm
    if lens is not None and round(lens.wavelength_nm) != round(light_nm):
        current.say(
            f"the lens is traced at its {lens.wavelength_nm:g} nm, in focus; the camera lights at "
            f"{light_nm:g} nm"
        )
    burst = capture.burst
    rows, cols = burst.grid.shape
    valid = float(burst.valid.mean())
    files = [out, truth_file, *([phases] if phases is not None else [])]
    current.say(f"{burst.frame_count} frames of {rows} x {cols} px, {100 * valid:.1f} % valid")
    current.wrote(*files)
    current.tell(burst, "frame_count offset_px")
    current.result |= {"shape": burst.grid.shape, "valid_share": valid}


def _camera(asked: _SimulateOptions) -> TofCamera:
    from lensshift.camera import Ambient, camera_preset
    from lensshift.pipeline.experiment_file import load_experiment

    name = asked.camera
    camera = load_experiment(name).camera if name.endswith(".toml") else camera_preset(name)
    changes: dict[str, Any] = {}
    if asked.lens is not None or asked.element is not None:
        changes["optics"] = _optics(asked, camera.optics)
    if asked.ambient_klx is not None:
        if asked.ideal:
            raise typer.BadParameter("--ideal leaves out sunlight: --ambient-klx would do nothing")
        changes["ambient"] = Ambient(asked.ambient_klx)
    if asked.as_float:
        changes["output"] = "float"
    camera = replace(camera, **changes)
    return camera.ideal() if asked.ideal else camera


def _optics(asked: _SimulateOptions, of_camera: PlainOptics | LensOptics) -> LensOptics:
    """Return the traced lens, asked for or of the camera, with the element that is to move."""
    from lensshift.camera import LensOptics
    from lensshift.cli.optics import read_lens

    if asked.lens is not None:
        traced = LensOptics(read_lens(asked.lens))
    elif isinstance(of_camera, LensOptics):
        traced = of_camera
    else:
        raise typer.BadParameter("--element is of a traced lens: expected --lens with it")
    moved = None if asked.element == 0 else element_of(traced.lens, asked.element)
    return replace(traced, element=moved)
