"""From a scan to a calibration: stage map, play, drift, field, blur, and a page about them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lensshift.core.calibration import Calibration
from lensshift.core.types import Burst
from lensshift.registration.calibrate import ScanFit, fit_scan

if TYPE_CHECKING:
    from lensshift.report.page import Page

PSF_TRIALS_PX = (0.18, 0.24, 0.30, 0.36, 0.42, 0.50)
LEAST_ERROR_PX = 0.05
_BORDER_PX = 2
# So fine that the grid of the reconstruction blurs little: a coarser one asks for a wider blur.
_SCALE = 4


@dataclass(frozen=True, slots=True, eq=False)
class RigCalibration:
    """What a scan says of a rig, and what its rest costs.

    Parameters
    ----------
    fit : of shifts, with the calibration
    psnr_loss_db, mtf50_loss : of reconstructions whose shifts are wrong by the rest
    """

    fit: ScanFit
    psnr_loss_db: float
    mtf50_loss: float

    @property
    def calibration(self) -> Calibration:
        """The calibration."""
        return self.fit.calibration

    def page(self) -> Page:
        """Return a page that shows the calibration."""
        from lensshift.report.calibration import calibration_page

        return calibration_page(
            self.fit, psnr_loss_db=self.psnr_loss_db, mtf50_loss=self.mtf50_loss
        )


def calibrate_rig(
    burst: Burst,
    *,
    photometric: bool = False,
    over_sensor: bool = True,
    psf: bool = True,
    noise: float = 0.005,
    report: str | Path | None = None,
) -> RigCalibration:
    """Calibrate a rig from a scan, and write the page if asked for.

    Parameters
    ----------
    burst : the scan, see `fit_scan`
    photometric, over_sensor : see `fit_scan`
    psf : whether the width of the blur is measured
    noise : of a pixel as a share of full scale, for what the rest costs
    report : HTML file for the page, or None

    Raises
    ------
    ValueError, DataError
        As in `fit_scan`; if the page cannot be written.

    Warns
    -----
    QualityWarning
        As in `fit_scan`.
    """
    from lensshift.optics.actuator import reconstruction_loss

    fit = fit_scan(burst, photometric=photometric, over_sensor=over_sensor)
    if psf:
        width_px, error_px = psf_width_px(fit.burst)
        found = replace(fit.calibration, psf_sigma_px=width_px, psf_sigma_sigma_px=error_px)
        fit = replace(fit, calibration=found)
    losses = reconstruction_loss(fit.calibration.stage_map.sigma_px, noise)
    done = RigCalibration(fit, *losses)
    if report is not None:
        done.page().save(report)
    return done


def psf_width_px(burst: Burst) -> tuple[float, float]:
    """Return the Gaussian width of the blur that predicts held-out frames best, and its error.

    Every second frame is reconstructed with some widths, the others are predicted; and the other
    way round. A parabola through the three best gives the width. The error is the difference of the
    two halves, and no less than 0.05 px: it is the width that suits the reconstruction, and wrong
    shifts widen it.

    Parameters
    ----------
    burst : many frames with registered offsets
    """
    numbers = np.arange(burst.frame_count)
    best = []
    for first in (0, 1):
        used, held = numbers[first::2], numbers[1 - first :: 2]
        misses = [_miss(burst, used, held, width_px) for width_px in PSF_TRIALS_PX]
        best.append(_lowest(np.array(PSF_TRIALS_PX), np.array(misses)))
    return float(np.mean(best)), max(LEAST_ERROR_PX, abs(best[0] - best[1]))


def _miss(burst: Burst, used: np.ndarray, held: np.ndarray, width_px: float) -> float:
    """Return the mean squared error of the prediction of frames that were not used."""
    from lensshift.reconstruction.reconstruct import reconstruct

    estimate = reconstruct(
        burst, _SCALE, "tikhonov", "amplitude", width_px, frames=list(map(int, used)), std=False
    ).amplitude
    if estimate is None:
        raise ValueError("expected a reconstruction of the amplitude")
    cut = (slice(_BORDER_PX, -_BORDER_PX),) * 2
    square = []
    for k in map(int, held):
        valid = np.ones(burst.grid.shape, np.bool_) if burst.valid is None else burst.valid[k]
        miss = np.abs(burst.amplitude[k] - estimate.predict(k))[cut] ** 2
        square.append(miss[valid[cut]])
    return float(np.mean(np.concatenate(square)))


def _lowest(width_px: np.ndarray, miss: np.ndarray) -> float:
    """Return where a parabola through the lowest value and its neighbours is lowest."""
    k = int(np.clip(np.argmin(miss), 1, len(miss) - 2))
    bend, slope, _ = np.polyfit(width_px[k - 1 : k + 2] - width_px[k], miss[k - 1 : k + 2], 2)
    if bend <= 0:
        return float(width_px[np.argmin(miss)])
    lowest = width_px[k] - 0.5 * slope / bend
    return float(np.clip(lowest, width_px[0], width_px[-1]))
