"""The options of `lensshift reconstruct`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Channel(StrEnum):
    """What is reconstructed."""

    AUTO = "auto"
    AMPLITUDE = "amplitude"
    DISTANCE = "distance"
    PHASOR = "phasor"


BurstArgument = Annotated[
    Path, typer.Argument(help="A burst file, or an image stack (TIFF, NPY, NPZ, folder of images).")
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Result file; default: BURST_xSCALE.nc beside it."),
]
ScaleOption = Annotated[int, typer.Option(min=1, max=8, help="Upscaling factor.")]
ChannelOption = Annotated[Channel, typer.Option(help="What to reconstruct.")]


def width_px(text: str) -> float | None:
    """Return the width that an option tells, None for auto."""
    if text == "auto":
        return None
    try:
        told_px = float(text)
    except ValueError:
        told_px = -1.0
    if not told_px >= 0.0:
        raise typer.BadParameter(f"expected auto or a number of LR px from 0, got {text!r}")
    return told_px


PsfOption = Annotated[
    float | None,
    typer.Option(
        "--psf-sigma-px", parser=width_px, metavar="PX|auto",
        help="Gaussian width of optics and pixel (with --fill-factor: of the optics alone) in LR "
        "px; auto, the default: from --calibration or the burst, or a square pixel (with "
        "--fill-factor: 0).",
    ),
]  # fmt: skip
FramesOption = Annotated[
    str | None, typer.Option(help="Frames to use, as in 0,2,8,10; default: all.")
]
NoiseOption = Annotated[
    float | None, typer.Option(min=0.0, help="Noise of one LR pixel; default: estimated.")
]
FillOption = Annotated[
    float | None, typer.Option(min=0.0, max=1.0, help="Light-sensitive linear share of a pixel.")
]
NonNegativeOption = Annotated[bool, typer.Option("--non-negative", help="Forbid negative values.")]
PhotometricOption = Annotated[
    bool, typer.Option("--photometric", help="Estimate gain and offset of each frame.")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of whatever is random.")]
LensFieldOption = Annotated[
    Path | None,
    typer.Option(
        "--lens-field",
        help="From `lensshift lens field`: how shift and blur vary over the sensor.",
    ),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option("--calibration", help="From `lensshift calibrate`: shifts from stage positions."),
]
DeviceOption = Annotated[
    str | None,
    typer.Option(
        metavar="cpu|cuda|cuda:N|numpy",
        help="Where the method auto is computed, by PyTorch; default: compiled for this processor.",
    ),
]
ExportOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--export", help="Also write .tif, .ome.tif, .fits, .png, .npz, .ply or .pcd; repeatable."
    ),
]
