"""`lensshift convert`: image stacks to burst files, bursts and results to images."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from lensshift.cli import inputs
from lensshift.cli.inputs import Kind, StackOptions
from lensshift.cli.points import CLOUD_SUFFIXES, PointOptions, refuse_points
from lensshift.cli.session import Progress, Session, picked
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from lensshift.core.types import Reconstruction

STREAM_SUFFIXES = (".mcap", ".rrd")
IMAGE_SUFFIXES = (".npz", ".tif", ".tiff", ".fits", ".fit")


@dataclass(frozen=True, slots=True)
class _ConvertOptions:
    sources: list[Path] = argument(
        "Image stack, several images, burst file, reconstruction or sequence.", metavar="IN"
    )
    target: Path = argument(
        "A burst to .nc, .npz, .tif, .ome.tif, .fits; a result to .tif, .ome.tif, .fits, "
        ".png, .npz, .ply, .pcd, .mcap, .rrd.",
        metavar="OUT",
    )
    stack: StackOptions = field(default_factory=StackOptions)
    bits: Literal["8", "16"] = option("8", "Depth of a PNG pixel.")
    points: PointOptions = field(default_factory=PointOptions)
    window: int | None = option(None, "Number of the picture of a sequence.", min=0)

    @property
    def source(self) -> Path:
        """The only input, or the folder of several images."""
        return inputs.source_of(self.sources)


@verb()
def convert(current: Session, asked: _ConvertOptions) -> None:
    """Convert between burst files, image stacks, results, images, point clouds and streams.

    \b
    Examples:
      lensshift convert frames/ burst.nc --offsets shifts.csv --pitch-mm 0.015
      lensshift convert sharp.nc sharp.png --bits 16
      lensshift convert sharp.nc cloud.ply --normals
      lensshift convert sharp.nc cloud.pcd --focal-length-mm 42.7
      lensshift convert sr.nc cloud.ply --window 17
      lensshift convert sr.nc sr.mcap --fov-deg 60x45
    """
    source, target = asked.source, asked.target
    inputs.refuse_overwriting((*asked.sources, asked.stack.offsets), (target,))
    current.result |= {"input": source, "files": [target]}
    kind = inputs.kind_of(source) if len(asked.sources) == 1 else Kind.STACK
    pictures = kind in (Kind.RECONSTRUCTION, Kind.SEQUENCE)
    if pictures and target.suffix.lower() in STREAM_SUFFIXES:
        _convert_stream(current, asked)
        return
    if (kind is Kind.SEQUENCE) is (asked.window is None):
        raise typer.BadParameter("--window says which picture of a sequence is meant")
    if pictures:
        current.result["range"] = _convert_result(current, asked)
    else:
        _convert_burst(asked)
    current.say(f"wrote {target}")


def _convert_stream(current: Session, asked: _ConvertOptions) -> None:
    """Write all pictures of a sequence, one of them, or a result, as a stream."""
    from lensshift.io import load_reconstruction, load_window
    from lensshift.io.sequence_file import sequence_numbers
    from lensshift.io.stream_export import export_stream

    source, target, window = asked.source, asked.target, asked.window
    if inputs.kind_of(source) is Kind.RECONSTRUCTION:
        export_stream([(0.0, _looking(load_reconstruction(source), asked))], target)
    else:
        known = sequence_numbers(source)
        time_s, written = known["time"], known["written"].nonzero()[0]
        numbers = written.tolist() if window is None else [window]
        if window is None and len(written) < len(time_s):
            text = f"{source} was broken off: {len(written)} of {len(time_s)} pictures are there"
            current.warn(text)
        with Progress(f"writing {target.name}") as progress:
            windows = ((k, load_window(source, k)) for k in numbers)
            pictures = ((float(time_s[k]), _looking(one, asked)) for k, one in windows)
            export_stream(progress.counted(pictures, len(numbers)), target)
    current.say(f"wrote {target}")


def _looking(result: Reconstruction, asked: _ConvertOptions) -> Reconstruction:
    """Return the result with where its pixels look, if that is told."""
    from lensshift.core.grid import Grid

    rows, cols = (count // result.scale for count in result.grid.shape)
    row_mm, col_mm = (pitch_mm * result.scale for pitch_mm in result.grid.pitch_mm)
    told = asked.points.intrinsics(Grid((rows, cols), (row_mm, col_mm)), None)
    return result if told is None else replace(result, intrinsics=told.refine(result.scale))


def _convert_burst(asked: _ConvertOptions) -> None:
    from lensshift.io import export_burst, save_burst
    from lensshift.io.reading import CONTAINER_SUFFIXES

    target = asked.target
    suffix = target.suffix.lower()
    if suffix not in (*CONTAINER_SUFFIXES, *IMAGE_SUFFIXES):
        raise typer.BadParameter(
            f"{target}: a burst becomes a burst file ({', '.join(CONTAINER_SUFFIXES)}), .npz, "
            ".tif, .ome.tif or .fits"
        )
    burst = inputs.load_input_burst(asked.sources, asked.stack)
    burst = replace(burst, intrinsics=asked.points.intrinsics(burst.grid, burst.intrinsics))
    if suffix in CONTAINER_SUFFIXES:
        save_burst(burst, target)
    else:
        export_burst(burst, target)


def _convert_result(current: Session, asked: _ConvertOptions) -> tuple[float, float] | None:
    from lensshift.io import export_reconstruction, load_reconstruction, load_window

    source, target, window = asked.source, asked.target, asked.window
    if target.suffix.lower() not in (*IMAGE_SUFFIXES, ".png", *CLOUD_SUFFIXES):
        raise typer.BadParameter(
            f"{target}: a reconstruction becomes .tif, .ome.tif, .fits, .png, .npz, "
            ".ply, .pcd, .mcap or .rrd"
        )
    result = load_reconstruction(source) if window is None else load_window(source, window)
    result = _looking(result, asked)
    refuse_points([target], result.intrinsics, with_distance=result.distance_m is not None)
    chosen = picked(asked.points, "keep_flying normals")
    bits: Literal[8, 16] = 16 if asked.bits == "16" else 8
    limits = export_reconstruction(result, target, bits=bits, **chosen)
    if limits is not None:
        current.say(f"grey values from {limits[0]:.6g} to {limits[1]:.6g}")
    return limits
