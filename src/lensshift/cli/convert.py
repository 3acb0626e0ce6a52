"""`lensshift convert`: image stacks to burst files, bursts and results to images."""

from __future__ import annotations

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
from lensshift.cli.session import DebugOption, JsonOption, Session, session

BURST_SUFFIXES = (".nc", ".nc4", ".h5", ".hdf5")


class Bits(StrEnum):
    """Depth of a PNG pixel."""

    EIGHT = "8"
    SIXTEEN = "16"


InArgument = Annotated[
    Path, typer.Argument(metavar="IN", help="Image stack, burst file or reconstruction.")
]
OutArgument = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", help="A burst to .nc, .npz or .tif; a result to .tif, .png or .npz."
    ),
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
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Convert between burst files, image stacks, results and images.

    \b
    Examples:
      lensshift convert frames/ burst.nc --offsets shifts.csv --pitch-mm 0.015
      lensshift convert sharp.nc sharp.png --bits 16
    """
    stack = StackOptions(offsets, pitch_mm, key, frame_axis, modulation_hz)
    with session(as_json=as_json, debug=debug) as current:
        refuse_overwriting((source, offsets), (target,))
        current.result |= {"input": source, "files": [target]}
        if kind_of(source) is Kind.RECONSTRUCTION:
            current.result["range"] = _convert_result(current, source, target, bits)
        else:
            _convert_burst(source, target, stack)
        current.say(f"wrote {target}")


def _convert_burst(source: Path, target: Path, stack: StackOptions) -> None:
    from lensshift.io import export_burst, save_burst

    suffix = target.suffix.lower()
    if suffix not in (*BURST_SUFFIXES, ".npz", ".tif", ".tiff"):
        raise typer.BadParameter(
            f"{target}: a burst becomes a burst file ({', '.join(BURST_SUFFIXES)}), .npz or .tif"
        )
    burst = load_input_burst(source, stack)
    if suffix in BURST_SUFFIXES:
        save_burst(burst, target)
    else:
        export_burst(burst, target)


def _convert_result(
    current: Session, source: Path, target: Path, bits: Bits
) -> tuple[float, float] | None:
    from lensshift.io import export_reconstruction, load_reconstruction

    if target.suffix.lower() not in (".tif", ".tiff", ".png", ".npz"):
        raise typer.BadParameter(f"{target}: a reconstruction becomes .tif, .png or .npz")
    limits = export_reconstruction(
        load_reconstruction(source), target, bits=16 if bits is Bits.SIXTEEN else 8
    )
    if limits is not None:
        current.say(f"grey values from {limits[0]:.6g} to {limits[1]:.6g}")
    return limits
