"""The options of `lensshift reconstruct`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import typer

from lensshift.cli.inputs import BurstArgument, StackOptions
from lensshift.cli.method_options import MethodOption, WeightOption
from lensshift.cli.points import PointOptions
from lensshift.cli.recording import Split
from lensshift.cli.verbs import option


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


@dataclass(frozen=True, slots=True)
class ReconstructOptions:
    """Options of `lensshift reconstruct`."""

    burst: BurstArgument
    out: Path | None = option(None, "Result file; default: BURST_xSCALE.nc beside it.", "-o")
    scale: int = option(2, "Upscaling factor.", min=1, max=8)
    method: MethodOption = "auto"
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
    prior_weight: WeightOption = "auto"
    method_options: list[str] | None = option(
        None,
        "Option of the method, as in iterations=30; repeatable; see `lensshift methods`.",
        "--option",
        metavar="NAME=VALUE",
    )
    frames: str | None = option(None, "Frames to use, as in 0,2,8,10; default: all.")
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
    device: str | None = option(
        None,
        "Where the method auto is computed, by PyTorch; default: compiled for this processor.",
        metavar="cpu|cuda|cuda:N|numpy",
    )
    export: list[Path] | None = option(
        None, "Also write .tif, .ome.tif, .fits, .png, .npz, .ply or .pcd; repeatable."
    )
    points: PointOptions = field(default_factory=PointOptions)
    stack: StackOptions = field(default_factory=StackOptions)
    split: Split = field(default_factory=Split)
