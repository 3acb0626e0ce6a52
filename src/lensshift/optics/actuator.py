"""What an actuator's errors cost: from micrometres to pixels to lost resolution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensshift.core.errors import warn_quality
from lensshift.core.grid import Grid
from lensshift.optics.lens import Lens
from lensshift.optics.shift import decenter_for_shift, px_per_mm_over, px_per_um

PIXEL_NOISE = 0.005  # a share of full scale, the less noisy of those that were simulated
# Losses of a reconstruction with scale 2, method "auto", from four frames whose shifts are wrong by
# normal errors of this rms along each axis: PSNR of a target on 64 x 16 pixels, MTF50 of a Siemens
# star. Measured by `python benchmarks/shift_budget.py --draws 6`, standard errors behind each.
# (noise of a pixel as a share of full scale, shift error in px): (PSNR in dB, share of MTF50).
_MEASURED: dict[tuple[float, float], tuple[float, float]] = {
    (0.005, 0.0): (0.00, 0.000),
    (0.005, 0.01): (-0.04, 0.010),  # 0.02, 0.004
    (0.005, 0.02): (0.07, 0.014),  # 0.04, 0.005
    (0.005, 0.05): (1.08, 0.023),  # 0.15, 0.004
    (0.005, 0.1): (3.65, 0.059),  # 0.51, 0.007
    (0.02, 0.0): (0.00, 0.000),
    (0.02, 0.01): (-0.03, -0.005),  # 0.05, 0.004
    (0.02, 0.02): (0.05, -0.004),  # 0.05, 0.008
    (0.02, 0.05): (0.62, 0.016),  # 0.10, 0.011
    (0.02, 0.1): (2.57, 0.064),  # 0.52, 0.015
}


@dataclass(frozen=True, slots=True)
class Actuator:
    """The errors of one axis of an actuator.

    Parameters
    ----------
    repeatability_um : standard deviation of where it stops for one command
    backlash_um : between the stops of the two approaches to one position; 0 if it is always
        approached from one side
    encoder_um : one step of the encoder
    drift_um : from the first frame of a burst to the last

    Raises
    ------
    ValueError
        If a number is negative or not finite.
    """

    repeatability_um: float = 0.0
    backlash_um: float = 0.0
    encoder_um: float = 0.0
    drift_um: float = 0.0

    def __post_init__(self) -> None:
        errors = (self.repeatability_um, self.backlash_um, self.encoder_um, self.drift_um)
        if not all(math.isfinite(error) and error >= 0 for error in errors):
            raise ValueError(f"expected errors of at least 0 um, got {errors}")

    def rms_um(self) -> dict[str, float]:
        """Return the standard deviation that each error adds to the positions of a burst, by name.

        repeatability    as it is
        backlash         / 2: one side of the mean as often as the other
        encoder          / sqrt(12): even over one step
        drift            sqrt(5 / 27): four frames at even times, about their mean, by 3 not by 4
        """
        return {
            "repeatability": self.repeatability_um,
            "backlash": self.backlash_um / 2.0,
            "encoder": self.encoder_um / math.sqrt(12.0),
            "drift": self.drift_um * math.sqrt(5.0 / 27.0),
        }


@dataclass(frozen=True, slots=True)
class ActuatorBudget:
    """What an actuator does to the shifts and to the resolution.

    Parameters
    ----------
    element : number of the one that moves, from 0
    stroke_um : decentre for the wanted shift along one axis, negative if the image goes the
        other way
    sensitivity_px_per_um : of `px_per_um`, in the middle of the sensor
    largest_px_per_um : the same where it is largest over the sensor, which the errors feel
    parts_px : standard deviation of the shift from each error, by name
    shift_error_px : of all together, along each axis
    psnr_loss_db : of the reconstruction, against shifts that are known
    mtf50_loss : share of the frequency where its MTF is 1/2
    """

    element: int
    stroke_um: float
    sensitivity_px_per_um: float
    largest_px_per_um: float
    parts_px: dict[str, float]
    shift_error_px: float
    psnr_loss_db: float
    mtf50_loss: float


def actuator_budget(
    lens: Lens,
    element: int,
    grid: Grid,
    actuator: Actuator,
    *,
    noise: float = PIXEL_NOISE,
    shift_px: float = 0.25,
) -> ActuatorBudget:
    """Return the errors of the shifts that an actuator makes, and what they cost.

        shift error = sensitivity sqrt( sum of squares of the errors )

    with the largest sensitivity over the sensor. The errors are independent, so variances add. The
    losses are those of simulated bursts (`reconstruction_loss`).

    Parameters
    ----------
    element : number of the one that moves, from 0
    grid : of the sensor
    noise : of a pixel, standard deviation as a share of full scale
    shift_px : along each axis, for the stroke

    Raises
    ------
    ValueError
        If the noise is not positive, or as in `decenter_for_shift`.

    Warns
    -----
    QualityWarning
        If error or noise are outside what was simulated.
    """
    stroke_um = 1e3 * float(decenter_for_shift(lens, element, [0.0, shift_px], grid)[1])
    px_per_mm = px_per_mm_over(lens, element, grid)
    middle = px_per_um(lens, element, grid)
    largest = 1e-3 * float(np.linalg.norm(px_per_mm, axis=-2).max())
    parts = {name: largest * rms for name, rms in actuator.rms_um().items()}
    error_px = math.sqrt(sum(part**2 for part in parts.values()))
    psnr_loss_db, mtf50_loss = reconstruction_loss(error_px, noise)
    return ActuatorBudget(
        element, stroke_um, middle, largest, parts, error_px, psnr_loss_db, mtf50_loss
    )


def reconstruction_loss(shift_error_px: float, noise: float) -> tuple[float, float]:
    """Return the PSNR lost, in dB, and the share of MTF50 lost to errors of the shifts.

    Linear between the errors that were simulated, and between the logarithms of the noises; the
    ends beyond. Means of 18 (PSNR) and 6 (MTF50) bursts with standard errors of up to 0.52 dB and
    0.015. A gain is chance, and counts as no loss.

    Parameters
    ----------
    shift_error_px : standard deviation along each axis
    noise : of a pixel, standard deviation as a share of full scale

    Raises
    ------
    ValueError
        If the error is negative or the noise not positive.

    Warns
    -----
    QualityWarning
        If error or noise are outside what was simulated.
    """
    if not shift_error_px >= 0 or not noise > 0:
        raise ValueError(
            f"expected shift_error_px >= 0 and noise > 0, got {shift_error_px} and {noise}"
        )
    noises, errors_px = (np.unique(values) for values in zip(*_MEASURED, strict=True))
    if shift_error_px > errors_px[-1] or not noises[0] <= noise <= noises[-1]:
        warn_quality(
            f"a shift error of {shift_error_px:.3f} px at noise {noise:g} is outside what was "
            f"simulated: up to {errors_px[-1]} px, noise {noises[0]:g} to {noises[-1]:g}"
        )
    table = np.maximum([[_MEASURED[n, e] for e in errors_px] for n in noises], 0.0)
    at_noise = [[np.interp(shift_error_px, errors_px, row) for row in losses.T] for losses in table]
    losses = [np.interp(math.log(noise), np.log(noises), one) for one in np.transpose(at_noise)]
    return float(losses[0]), float(losses[1])


def format_budget(budget: ActuatorBudget) -> str:
    """Return a budget as lines of text, of an actuator without errors the travel alone."""
    beyond = budget.shift_error_px > max(error_px for _, error_px in _MEASURED)
    lines = [
        f"element {budget.element + 1}: stroke {budget.stroke_um:.1f} um, "
        f"{budget.sensitivity_px_per_um:.5f} px per um, over the sensor up to "
        f"{budget.largest_px_per_um:.5f}"
    ]
    if not budget.shift_error_px:
        return lines[0]
    lines += [f"{name:<14} {error_px:8.4f} px rms" for name, error_px in budget.parts_px.items()]
    lines += [
        f"{'all together':<14} {budget.shift_error_px:8.4f} px rms",
        f"costs {'at least ' if beyond else ''}{budget.psnr_loss_db:.2f} dB of PSNR and "
        f"{100 * budget.mtf50_loss:.1f} % of MTF50",
    ]
    return "\n".join(lines)
