"""`lensshift info`: what is in a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensshift.cli import inputs
from lensshift.cli.inputs import Kind, StackOptions
from lensshift.cli.points import view_of, view_text
from lensshift.cli.reconstruct import say_channels
from lensshift.cli.register import say_turns
from lensshift.cli.session import Session
from lensshift.cli.verbs import argument, option, verb
from lensshift.core.errors import DataError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lensshift.core.grid import Grid
    from lensshift.core.types import Burst, Reconstruction


@dataclass(frozen=True, slots=True)
class _InfoOptions:
    files: list[Path] | None = argument(
        "Burst, reconstruction, lens field, image stack, several images, scene, experiment or rig "
        "(.toml).",
        metavar="FILE",
        default=None,
    )
    stack: StackOptions = field(default_factory=StackOptions)
    devices: bool = option(False, "List the serial ports of this computer.")


@verb()
def info(current: Session, asked: _InfoOptions) -> None:
    """Say what is in a file, what a rig answers, or which devices there are.

    \b
    Examples:
      lensshift info burst.nc
      lensshift info rig.toml
      lensshift info --devices
    """
    from lensshift.io import load_reconstruction
    from lensshift.io.container_reader import is_ours, read_schema

    if asked.devices:
        from lensshift.cli.devices import say_ports

        say_ports(current)
    if not asked.files:
        if not asked.devices:
            raise typer.BadParameter("Missing argument: a file, or --devices")
        return
    file = inputs.source_of(asked.files)
    if len(asked.files) > 1:
        current.result |= {"file": file, "kind": Kind.STACK.value, "schema": None}
        _say_stack(current, asked.files, asked.stack, f"{file}: {len(asked.files)} images")
        return
    if file.suffix.lower() == ".toml":
        _say_toml(current, file)
        return
    schema = read_schema(file) if file.is_file() and is_ours(file) else None
    if (schema or "").startswith("lensshift-lens-field"):
        from lensshift.cli.lens_report import say_field
        from lensshift.io import load_lens_field

        current.result |= {"file": file, "kind": "lens field"}
        say_field(current, load_lens_field(file))
        return
    kind = inputs.kind_of(file)
    current.result |= {"file": file, "kind": kind.value, "schema": schema}
    heading = f"{file}: {kind.value}" + (f", schema {schema}" if schema else "")
    # Bursts and results are read before a word is said: they may be damaged.
    if kind is Kind.RECONSTRUCTION:
        _say_result(current, load_reconstruction(file), heading)
    elif kind is Kind.SEQUENCE:
        current.say(heading)
        _say_sequence(current, file)
    elif kind is Kind.STACK:
        _say_stack(current, [file], asked.stack, heading)
    else:
        _say_burst(current, inputs.load_input_burst([file], asked.stack), heading)


def _say_toml(current: Session, file: Path) -> None:
    """Say what a scene or an experiment is for, or what a rig answers."""
    from lensshift.cli.devices import say_rig
    from lensshift.core.settings import parse_toml, read_text
    from lensshift.pipeline.experiment_file import load_experiment
    from lensshift.scene import load_scene

    tables = parse_toml(read_text(file), file).keys()
    if tables & {"object", "background"}:
        kind, said = "scene", f"{len(load_scene(file).shapes)} shapes, for `lensshift simulate`"
    elif tables & {"scene", "burst", "reconstruction"}:
        kind, said = "experiment", f"{load_experiment(file).name}, for `lensshift run`"
    else:
        say_rig(current, file)
        return
    current.result |= {"file": file, "kind": kind}
    current.say(f"{file}: {kind}, {said}")


def _say_burst(current: Session, burst: Burst, heading: str) -> None:
    current.say(heading)
    current.tell(burst.grid, "pitch_mm")
    current.tell(burst, "modulation_hz offset_source offset_px offset_sigma_px")
    view = view_of(burst.intrinsics, burst.grid.shape)
    current.result |= {"view": view, "has_stage": burst.stage_mm is not None}
    current.result |= {"has_time": burst.time_s is not None, "meta": dict(burst.meta)}
    _say_frames(current, burst.amplitude, burst.distance_m, burst.valid)
    _say_pitch(current, burst.grid)
    modulation = ", ".join(f"{hz:g} Hz" for hz in burst.frequencies_hz) or "not known"
    current.say(f"modulation  {modulation}{', phasors of each' * (burst.phasors is not None)}")
    current.say(f"looks       {view_text(view)}")
    told = {"offsets": burst.offset_source != "unknown", "pitch_mm": burst.grid.tells_pitch()}
    current.result["missing"] = [name for name, known in told.items() if not known]
    if not told["offsets"]:
        current.say("shifts      not told: --offsets, or `lensshift reconstruct` finds them")
    else:
        _say_offsets(current, burst)
    for name, value in burst.meta.items():
        current.say(f"meta        {name}: {value!s:.100}")


def _say_offsets(current: Session, burst: Burst) -> None:
    current.say(f"offsets     {burst.offset_source}, (row, col) in px:")
    rows = [f"  {k:>4}  {row:+9.4f} {col:+9.4f}" for k, (row, col) in enumerate(burst.offset_px)]
    if burst.offset_sigma_px is not None:
        sigmas = ("  sigma {:.4f} {:.4f}".format(*one) for one in burst.offset_sigma_px)
        rows = [row + sigma for row, sigma in zip(rows, sigmas, strict=True)]
    current.say_rows(rows)
    say_turns(current, burst)


def _say_stack(current: Session, files: Sequence[Path], stack: StackOptions, heading: str) -> None:
    """Describe the images, also phasors of which nobody told the frequencies yet."""
    from lensshift.io.image_stack import load_stack_fields

    source = files[0] if len(files) == 1 else inputs.several(files)
    try:
        fields = load_stack_fields(
            source, key=stack.key, frame_axis=inputs.FRAME_AXES[stack.frame_axis]
        )
    except DataError as error:
        if stack.key is not None or error.field != "key":
            raise
        _say_arrays(current, files[0], error.problem)
        return
    frames = fields["amplitude"]
    if frames.ndim == 3 or stack.modulation_hz is not None or "modulation_hz" in fields:
        _say_burst(current, inputs.load_input_burst(files, stack), heading)
        return
    current.say(heading)
    _say_frames(current, frames, fields.get("distance_m"), fields.get("valid"))
    current.say("modulation  not told: --modulation-hz, once for each frequency")


def _say_arrays(current: Session, file: Path, problem: str) -> None:
    """List the arrays of a file that do not tell which of them are frames."""
    from lensshift.io.foreign_arrays import load_named_arrays

    arrays = load_named_arrays(file)
    current.result |= {"kind": "arrays", "arrays": {n: v.shape for n, v in arrays.items()}}
    current.say(f"{file}: {problem}")
    for name, values in arrays.items():
        shape, numbers = " x ".join(map(str, values.shape)), values.dtype.kind in "biuf"
        limits = _range_text(_finite_range(values, None)) if numbers else ""
        current.say(f"  {name:<20} {values.dtype!s:<8} {shape:<16} {limits}".rstrip())


def _say_frames(
    current: Session,
    frames: NDArray[Any],
    distance_m: NDArray[Any] | None,
    valid: NDArray[Any] | None,
) -> None:
    import numpy as np

    rows, cols = shape = frames.shape[-2:]
    count, dtype = frames.shape[-3], str(frames.dtype)
    inside = None if valid is None else np.broadcast_to(valid, frames.shape)  # of phasors: each
    light, far = _finite_range(frames, inside), _finite_range(distance_m, valid)
    share = 1.0 if valid is None else float(valid.mean())
    current.result |= {"frame_count": count, "shape": shape, "dtype": dtype, "valid_share": share}
    current.result |= {"amplitude_range": light, "distance_range_m": far}
    current.say(f"frames      {count} of {rows} x {cols} px, {dtype}")
    current.say(f"amplitude   {_range_text(light)}")
    current.say(f"distance    {_range_text(far, ' m')}")
    current.say(f"valid       {100 * share:.2f} % of the pixels")


def _say_sequence(current: Session, file: Path) -> None:
    from lensshift.io import load_window
    from lensshift.io.sequence_file import sequence_numbers

    known = sequence_numbers(file)
    there = known["written"] != 0
    written = [int(one) for one in there.nonzero()[0]]
    if not written:
        raise DataError("no picture was written before it was broken off", source=file)
    first, count = known["first_frame"][there], len(there)
    bad = int(known["contradicted"].sum())
    if len(written) < count:
        current.say(f"unfinished  {len(written)} of {count} windows; the same call goes on with it")
    current.say(f"windows     {len(written)}, of frames {first[0]} to {first[-1]} on")
    current.say(f"contradicted by their frames: {bad}; all stages: {int(known['refined'].sum())}")
    current.result |= {"windows": count, "written": len(written), "contradicted": bad}
    _say_result(current, load_window(file, written[0]))


def _say_result(current: Session, result: Reconstruction, heading: str = "") -> None:
    if heading:
        current.say(heading)
    rows, cols = result.grid.shape
    current.say(f"image       {rows} x {cols} px, x{result.scale} by {result.method}")
    _say_pitch(current, result.grid, result.scale)
    view = view_of(result.intrinsics, result.grid.shape)
    if view is not None or result.distance_m is not None:
        current.say(f"looks       {view_text(view)}")
    say_channels(current, result)
    current.tell(result.grid, "shape pitch_mm")
    current.tell(result, "scale method")
    current.result |= {"view": view, "settings": dict(result.settings)}


def _say_pitch(current: Session, grid: Grid, scale: int = 1) -> None:
    text = "{:g} x {:g} mm (row, col)".format(*grid.pitch_mm)
    cure = "not told: --pitch-mm beside images, if lengths matter"
    current.say(f"pitch       {text if grid.tells_pitch(scale) else cure}")


def _finite_range(values: NDArray[Any] | None, inside: Any) -> tuple[float, float] | None:
    from lensshift.io.export import finite_range

    if values is None:
        return None
    known = values if inside is None else values[inside]
    return finite_range(abs(known) if known.dtype.kind == "c" else known)


def _range_text(limits: tuple[float, float] | None, unit: str = "") -> str:
    return "none" if limits is None else f"{limits[0]:.6g} to {limits[1]:.6g}{unit}"
