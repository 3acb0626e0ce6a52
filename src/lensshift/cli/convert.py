"""`lensshift convert`: image stacks to burst files, bursts and results to images."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from lensshift.cli.inputs import (
    FrameAxis,
    FrameAxisOption,
    KeyOption,
    Kind,
    ModulationOption,
    OffsetsOption,
    PitchOption,
    StackOptions,
    kind_of,
    load_input_burst,
    refuse_overwriting,
)
from lensshift.cli.points import (
    CLOUD_SUFFIXES,
    FieldOption,
    FlyingOption,
    FocalMmOption,
    FocalPxOption,
    LensOption,
    NormalsOption,
    PointOptions,
    refuse_points,
)
from lensshift.cli.session import DebugOption, JsonOption, Progress, Session, session

STREAM_SUFFIXES = (".mcap", ".rrd")
BURST_SUFFIXES = (".nc", ".nc4", ".h5", ".hdf5")
IMAGE_SUFFIXES = (".npz", ".tif", ".tiff", ".fits", ".fit")


class Bits(StrEnum):
    """Depth of a PNG pixel."""

    EIGHT = "8"
    SIXTEEN = "16"


InArgument = Annotated[
    Path, typer.Argument(metavar="IN", help="Image stack, burst file, reconstruction or sequence.")
]
OutArgument = Annotated[
    Path,
    typer.Argument(
        metavar="OUT",
        help="A burst to .nc, .npz, .tif, .ome.tif, .fits; a result to .tif, .ome.tif, .fits, "
        ".png, .npz, .ply, .pcd, .mcap, .rrd.",
    ),
]
WindowOption = Annotated[
    int | None, typer.Option(min=0, help="Number of the picture of a sequence.")
]
BitsOption = Annotated[Bits, typer.Option(help="Depth of a PNG pixel.")]


def convert(
    source: InArgument,
    target: OutArgument,
    offsets: OffsetsOption = None,
    pitch_mm: PitchOption = None,
    key: KeyOption = None,
    frame_axis: FrameAxisOption = FrameAxis.FIRST,
    modulation_hz: ModulationOption = None,
    bits: BitsOption = Bits.EIGHT,
    fov_deg: FieldOption = None,
    focal_length_px: FocalPxOption = None,
    focal_length_mm: FocalMmOption = None,
    lens: LensOption = None,
    normals: NormalsOption = False,
    keep_flying: FlyingOption = False,
    window: WindowOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Convert between burst files, image stacks, results, images, point clouds and streams.

    \b
    Examples:
      lensshift convert frames/ burst.nc --offsets shifts.csv --pitch-mm 0.015
      lensshift convert sharp.nc sharp.png --bits 16
      lensshift convert sharp.nc cloud.ply --normals
      lensshift convert sharp.nc cloud.pcd --focal-length-mm 42.7
      lensshift convert sr.nc cloud.ply --window 17
      lensshift convert sr.nc sr.mcap
    """
    stack = StackOptions(offsets, pitch_mm, key, frame_axis, modulation_hz)
    points = PointOptions(fov_deg, focal_length_px, focal_length_mm, lens, normals, keep_flying)
    with session(as_json=as_json, debug=debug) as current:
        refuse_overwriting((source, offsets), (target,))
        current.result |= {"input": source, "files": [target]}
        kind = kind_of(source)
        pictures = kind in (Kind.RECONSTRUCTION, Kind.SEQUENCE)
        if pictures and target.suffix.lower() in STREAM_SUFFIXES:
            _convert_stream(current, source, target, window)
            return
        if (kind is Kind.SEQUENCE) is (window is None):
            raise typer.BadParameter("--window says which picture of a sequence is meant")
        if pictures:
            current.result["range"] = _convert_result(current, source, target, bits, points, window)
        else:
            _convert_burst(source, target, stack, points)
        current.say(f"wrote {target}")


def _convert_stream(current: Session, source: Path, target: Path, window: int | None) -> None:
    """Write all pictures of a sequence, one of them, or a result, as a stream."""
    from lensshift.io import load_reconstruction, load_window
    from lensshift.io.sequence_file import sequence_numbers
    from lensshift.io.stream_export import export_stream

    if kind_of(source) is Kind.RECONSTRUCTION:
        export_stream([(0.0, load_reconstruction(source))], target)
    else:
        time_s = sequence_numbers(source)["time"]
        numbers = range(len(time_s)) if window is None else (window,)
        progress = Progress(f"writing {target.name}")
        try:
            pictures = ((float(time_s[k]), load_window(source, k)) for k in numbers)
            export_stream(progress.counted(pictures, len(numbers)), target)
        finally:
            progress.close()
    current.say(f"wrote {target}")


def _convert_burst(source: Path, target: Path, stack: StackOptions, points: PointOptions) -> None:
    from lensshift.io import export_burst, save_burst

    suffix = target.suffix.lower()
    if suffix not in (*BURST_SUFFIXES, *IMAGE_SUFFIXES):
        raise typer.BadParameter(
            f"{target}: a burst becomes a burst file ({', '.join(BURST_SUFFIXES)}), .npz, .tif, "
            ".ome.tif or .fits"
        )
    burst = load_input_burst(source, stack)
    burst = replace(burst, intrinsics=points.intrinsics(burst.grid, burst.intrinsics))
    if suffix in BURST_SUFFIXES:
        save_burst(burst, target)
    else:
        export_burst(burst, target)


def _convert_result(
    current: Session,
    source: Path,
    target: Path,
    bits: Bits,
    points: PointOptions,
    window: int | None,
) -> tuple[float, float] | None:
    from lensshift.core.grid import Grid
    from lensshift.io import export_reconstruction, load_reconstruction, load_window

    if target.suffix.lower() not in (*IMAGE_SUFFIXES, ".png", *CLOUD_SUFFIXES):
        raise typer.BadParameter(
            f"{target}: a reconstruction becomes .tif, .ome.tif, .fits, .png, .npz, "
            ".ply, .pcd, .mcap or .rrd"
        )
    result = load_reconstruction(source) if window is None else load_window(source, window)
    rows, cols = (count // result.scale for count in result.grid.shape)
    row_mm, col_mm = (pitch_mm * result.scale for pitch_mm in result.grid.pitch_mm)
    told = points.intrinsics(Grid((rows, cols), (row_mm, col_mm)), None)
    if told is not None:
        result = replace(result, intrinsics=told.refine(result.scale))
    refuse_points([target], result.intrinsics, with_distance=result.distance_m is not None)
    limits = export_reconstruction(
        result,
        target,
        bits=16 if bits is Bits.SIXTEEN else 8,
        keep_flying=points.keep_flying,
        normals=points.normals,
    )
    if limits is not None:
        current.say(f"grey values from {limits[0]:.6g} to {limits[1]:.6g}")
    return limits
