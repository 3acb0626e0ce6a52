"""`lensshift evaluate`: numbers that say how good an image is."""

from __future__ import annotations

import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from lensshift.cli.chart import chart
from lensshift.cli.depth import depth
from lensshift.cli.gain import gain
from lensshift.cli.gradient import gradient
from lensshift.cli.inputs import load_input_image
from lensshift.cli.mtf import mtf
from lensshift.cli.session import DebugOption, JsonOption, session
from lensshift.cli.star import frc, star, zone
from lensshift.cli.verbs import verb_group
from lensshift.core.errors import QualityWarning

evaluate = verb_group()

for verb in (mtf, chart, gain, gradient, star, zone, frc, depth):
    evaluate.command()(verb)

ImageArgument = Annotated[Path, typer.Argument(help="Image, burst file or reconstruction.")]
TruthArgument = Annotated[Path, typer.Argument(help="The truth, an image of the same shape.")]
BorderOption = Annotated[
    int, typer.Option("--border-px", min=0, help="Pixels left out along each edge.")
]
PeakOption = Annotated[float, typer.Option(help="Value of white.")]
FrameOption = Annotated[int, typer.Option(min=0, help="Frame of IMAGE, if it holds several.")]
ImageKeyOption = Annotated[
    str | None, typer.Option("--key", help="Array of an NPZ file, or channel of a reconstruction.")
]
TruthKeyOption = Annotated[str | None, typer.Option("--truth-key", help="The same for TRUTH.")]


@evaluate.callback()
def group() -> None:
    """Measure how good an image is.

    \b
    Example:
      lensshift evaluate fidelity sharp.nc truth.tif
      lensshift evaluate mtf edge.tif --pitch-mm 0.155
    """


@evaluate.command()
def fidelity(
    image: ImageArgument,
    truth: TruthArgument,
    border_px: BorderOption = 4,
    peak: PeakOption = 1.0,
    frame: FrameOption = 0,
    key: ImageKeyOption = None,
    truth_key: TruthKeyOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Compare an image with the truth: PSNR, SSIM (scikit-image) and RMSE of the interior.

    \b
    Example:
      lensshift evaluate fidelity sharp.nc truth.tif --border-px 4 --peak 1
    """
    with session(as_json=as_json, debug=debug, doing="comparing") as current:
        from lensshift.evaluation import fidelity as measure

        values = load_input_image(image, key=key, frame=frame)
        true_values = load_input_image(truth, key=truth_key)
        _warn_of_peak(true_values, peak)
        found = asdict(measure(values, true_values, peak=peak, border_px=border_px))
        current.result |= {"image": image, "truth": truth, "peak": peak, "border_px": border_px}
        current.result |= found
        current.say(f"PSNR  {found['psnr_db']:.3f} dB (peak {peak:g})")
        current.say(f"SSIM  {found['ssim']:.4f}")
        current.say(f"RMSE  {found['rmse']:.6g}")


def _warn_of_peak(truth: Any, peak: float) -> None:
    if truth.dtype.kind in "ui" and truth.max() > peak:
        warnings.warn(
            f"the truth has integers up to {truth.max()} but white is {peak:g}; set --peak",
            QualityWarning,
            stacklevel=1,
        )
