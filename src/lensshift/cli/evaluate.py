"""`lensshift evaluate`: numbers that say how good an image is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lensshift.cli.chart import chart
from lensshift.cli.depth import depth, stray_light
from lensshift.cli.gain import gain
from lensshift.cli.gradient import gradient
from lensshift.cli.images import measured_image
from lensshift.cli.mtf import mtf
from lensshift.cli.session import Session
from lensshift.cli.star import frc, resolution, star, zone
from lensshift.cli.verbs import argument, option, verb, verb_group
from lensshift.core.errors import DataError, warn_quality

if TYPE_CHECKING:
    from lensshift.core.arrays import Array

evaluate = verb_group()

_AT_HOME = 0.8  # of the error, 2 dB: a place of which the picture speaks, not chance

for one in (mtf, chart, gain, gradient, star, zone, frc, resolution, depth, stray_light):
    evaluate.command(one.__name__.replace("_", "-"))(one)


@evaluate.callback()
def group() -> None:
    """Measure how good an image is.

    \b
    Example:
      lensshift evaluate fidelity sharp.nc truth.tif
      lensshift evaluate mtf edge.tif --pitch-mm 0.155
    """


@dataclass(frozen=True, slots=True)
class _FidelityOptions:
    image: Path = argument("Image, burst file or reconstruction.")
    truth: Path = argument("The truth, an image of the same shape.")
    border_px: int = option(4, "Pixels left out along each edge.", min=0)
    peak: float = option(1.0, "Value of white.")
    frame: int = option(0, "Frame of IMAGE, if it holds several.", min=0)
    key: str | None = option(None, "Array of an NPZ file, or channel of a reconstruction.")
    truth_key: str | None = option(None, "The same for TRUTH.")


@evaluate.command()
@verb("comparing")
def fidelity(current: Session, asked: _FidelityOptions) -> None:
    """Compare an image with the truth: PSNR, SSIM (scikit-image) and RMSE of the interior.

    \b
    Example:
      lensshift evaluate fidelity sharp.nc truth.tif --border-px 4 --peak 1
      lensshift evaluate fidelity sharp.nc burst.truth.npz --truth-key sharp_amplitude
    """
    import numpy as np

    from lensshift.evaluation import fidelity as measure

    peak = asked.peak
    values = measured_image(asked.image, None, key=asked.key, frame=asked.frame).values
    truth = measured_image(asked.truth, None, key=asked.truth_key).values
    if values.shape != truth.shape:
        both = " and ".join("{} x {} px".format(*one.shape) for one in (values, truth))
        raise DataError(
            f"expected as many pixels as the truth, got {both}; compare the result of "
            "`lensshift reconstruct` at the scale of the truth",
            source=asked.image,
        )
    # A few pixels may be brighter than white, and noise; not most of them.
    if (truth.dtype.kind in "ui" and truth.max() > peak) or np.nanmedian(truth) > peak:
        told = f"the truth goes up to {np.nanmax(truth):.5g} but white is {peak:g}; set --peak"
        warn_quality(told, 1)
    found = asdict(measure(values, truth, peak=peak, border_px=asked.border_px))
    _warn_if_apart(values, truth, asked.border_px)
    current.tell(asked, "image truth peak border_px")
    current.result |= found
    current.say(f"PSNR  {found['psnr_db']:.3f} dB (peak {peak:g})")
    current.say(f"SSIM  {found['ssim']:.4f}")
    current.say(f"RMSE  {found['rmse']:.6g}")


def _warn_if_apart(values: Array, truth: Array, border_px: int) -> None:
    """Warn of an image that lies beside the truth, as where shifts were found from nothing."""
    import numpy as np
    from scipy.ndimage import shift

    from lensshift.evaluation.fidelity import rmse
    from lensshift.registration import phase_correlation

    row, col = away_px = phase_correlation(truth, values)
    inside = border_px + int(np.ceil(np.abs(away_px).max()))
    if 2 * inside >= min(values.shape):
        return  # of nothing alike
    there = rmse(shift(values.astype(np.float64), -away_px), truth, border_px=inside)
    if there < _AT_HOME * rmse(values, truth, border_px=inside):
        said = (
            f"the image lies ({row:+.2f}, {col:+.2f}) of its pixels (row, col) from the truth: "
            f"brought back its RMSE is {there:.6g}. Shifts that are found without any that were "
            "told have a mean of 0: give --offsets, or the truth at their mean"
        )
        warn_quality(said, 1)
