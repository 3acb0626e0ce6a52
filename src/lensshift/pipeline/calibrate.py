"""From a scan to a calibration: stage map, play, drift, field, blur, and a page about them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lensshift.core.calibration import Calibration
from lensshift.core.errors import QualityWarning
from lensshift.core.lens_field import LensField
from lensshift.core.optical import gaussian_width
from lensshift.core.types import Burst
from lensshift.optics.actuator import PIXEL_NOISE, reconstruction_loss
from lensshift.registration.calibrate import ScanFit, fit_scan

_FINER = 3  # times the pixels of a frame: of the picture in which edges are looked for
_MOST_FRAMES = 12  # that measure an edge jointly; time goes with them
_LEAST_ERROR_PX = 0.005  # errors of the shifts, edges of few pixels: 0.007 px on the emulated rig
_LEAST_PX = 4  # lines and columns of an edge
_MOST_ASYMMETRY = 0.05  # over the contrast; what stands beside an edge makes it asymmetric


@dataclass(frozen=True, slots=True, eq=False)
class RigCalibration:
    """What a scan says of a rig, and what its rest costs."""

    fit: ScanFit  # of shifts, with the calibration
    psnr_loss_db: float  # of reconstructions whose shifts are wrong by the rest
    mtf50_loss: float

    @property
    def calibration(self) -> Calibration:
        """The calibration."""
        return self.fit.calibration


def calibrate_rig(
    burst: Burst,
    *,
    photometric: bool | None = None,
    over_sensor: bool = True,
    lens_field: LensField | None = None,
    psf: bool = True,
    noise: float = PIXEL_NOISE,
    report: str | Path | None = None,
) -> RigCalibration:
    """Calibrate a rig from a scan, and write the page if asked for.

    ValueError, DataError as in `fit_scan`; if the page cannot be written.

    Parameters
    ----------
    burst : the scan, see `fit_scan`
    photometric, over_sensor, lens_field : see `fit_scan`
    psf : whether the width of the blur is measured, at straight edges if there are any
    noise : of a pixel as a share of full scale, for what the rest costs
    report : HTML file for the page, or None

    Warns
    -----
    QualityWarning
        As in `fit_scan`.
    """
    fit = fit_scan(burst, photometric=photometric, over_sensor=over_sensor, lens_field=lens_field)
    if psf:
        width = psf_width_px(fit.burst)
        if width is not None:
            found = replace(fit.calibration, psf_sigma_px=width[0], psf_sigma_sigma_px=width[1])
            fit = replace(fit, calibration=found)
    psnr_loss_db, mtf50_loss = reconstruction_loss(fit.calibration.stage_map.sigma_px, noise)
    if report is not None:
        from lensshift.report.calibration import calibration_page

        page = calibration_page(fit, psnr_loss_db=psnr_loss_db, mtf50_loss=mtf50_loss)
        page.save(report)
    return RigCalibration(fit, psnr_loss_db, mtf50_loss)


def psf_width_px(burst: Burst) -> tuple[float, float] | None:
    """Return the Gaussian width of the blur at straight edges of the scene, and its error.

    sigma = sqrt(ln 2 / 2) / (pi MTF50), of optics and pixel together; None if the scene has no
    straight edge with even areas on both sides. Up to 12 frames measure an edge jointly. An edge
    can look wider than the blur, because it is soft or something stands beside it, but not sharper:
    the mean is over the sharpest edge and those that agree with it.
    """
    from lensshift.evaluation.slanted_edge import measure_edge

    every = -(-burst.frame_count // _MOST_FRAMES)
    frames, offset_px = burst.amplitude[::every], burst.offset_px[::every]
    valid = burst.valid[::every]
    widths = []
    for region in _edges(burst):
        with warnings.catch_warnings(action="ignore", category=QualityWarning):
            # Doubts are about one frame: many frames leave no pixel phase out.
            edge = measure_edge(frames, offset_px=offset_px, valid=valid, region=region)
        half = edge.mtf50_lpmm
        told = np.all(np.isfinite([half.value, half.low, half.high])) and half.low > 0.0
        if told and edge.asymmetry.value < _MOST_ASYMMETRY:
            widths.append([gaussian_width(f) for f in (half.high, half.value, half.low)])
    if not widths:
        return None
    low, value, high = np.array(widths).T
    agree = low <= high[np.argmin(value)]
    sigma = (high - low)[agree] / (2 * 1.96)
    weight = sigma**-2.0 / np.sum(sigma**-2.0)
    mean = float(weight @ value[agree])
    scatter = float(np.sqrt(weight @ (value[agree] - mean) ** 2 / agree.sum()))
    return mean, max(float(np.sum(sigma**-2.0) ** -0.5), scatter, _LEAST_ERROR_PX)


def _edges(burst: Burst) -> list[tuple[int, int, int, int]]:
    """Return regions of the frames that hold an edge, found where all frames are put together."""
    from lensshift.evaluation.slanted_edge import find_regions
    from lensshift.reconstruction.reconstruct import reconstruct

    together = reconstruct(burst, _FINER, "shift-and-add", "amplitude", std=False)["amplitude"]
    try:
        found = find_regions(together.image)
    except ValueError:
        return []
    inside = []
    for region in found:
        first = [-(-n // _FINER) for n in (region.row_start, region.col_start)]
        last = [n // _FINER for n in (region.row_stop, region.col_stop)]
        if min(last[0] - first[0], last[1] - first[1]) >= _LEAST_PX:
            inside.append((first[0], last[0], first[1], last[1]))
    return inside
