"""One edge by the published binning algorithms, as the same kind of result."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensshift.core.optical import MtfCurve
from lensshift.evaluation.slanted_edge.checks import doubted, largest_phase_gap_px
from lensshift.evaluation.slanted_edge.edge_model import Vector
from lensshift.evaluation.slanted_edge.frames import EdgeFrames
from lensshift.evaluation.slanted_edge.result import (
    EdgeResult,
    Interval,
    Profile,
    Region,
    numbers_of,
    steps_to,
)
from lensshift.evaluation.slanted_edge.sfrmat import SfrmatResult, sfrmat3, sfrmat5

_PLATEAU_SHARE = 0.2  # of the columns, on either side, for levels and noise


def measure_binned(
    frames: EdgeFrames,
    region: Region,
    wanted_lpmm: Vector | None,
    method: str,
    options: dict[str, Any],
) -> EdgeResult:
    """Measure one region of one frame with sfrmat3 or sfrmat5.

    Without `wanted_lpmm` the curve is at the algorithm's own frequencies; else it is interpolated.

    Raises
    ------
    ValueError
        If there are several frames, invalid pixels, or the algorithm gives no curve.
    """
    if len(frames.values) > 1:
        raise ValueError(f"expected one image for {method}, got {len(frames.values)} frames")
    if frames.pitch_mm[0] != frames.pitch_mm[1]:
        raise ValueError(f"expected square pixels for {method}, got pitch {frames.pitch_mm} mm")
    image = frames.first[region.slices]
    missing = int(np.count_nonzero(np.isnan(image)))
    if missing:
        raise ValueError(f"expected valid pixels for {method}, got {missing} invalid in {region}")
    found = (sfrmat3 if method == "sfrmat3" else sfrmat5)(image, **options)
    pitch_mm = frames.pitch_mm[0]
    own_lpmm = found.frequency_cpp / pitch_mm
    if wanted_lpmm is None:
        curve = MtfCurve(own_lpmm, found.modulation, None, method)
    else:
        frequency_lpmm = frames.frequency_lpmm(wanted_lpmm)
        inside = np.interp(frequency_lpmm, own_lpmm, found.modulation, right=np.nan)
        curve = MtfCurve(frequency_lpmm, inside, None, method)
    result = _result(found, region, frames, curve, method)
    lines = np.arange(min(image.shape) if found.rotated else image.shape[0], dtype=np.float64)
    gap_px = largest_phase_gap_px(lines, found.angle_rad)
    return doubted(result, lines.size, gap_px, image.ravel())


def _result(
    found: SfrmatResult, region: Region, frames: EdgeFrames, curve: MtfCurve, method: str
) -> EdgeResult:
    image = frames.first[region.slices]
    upright = np.rot90(image) if found.rotated else image
    pitch_mm = frames.pitch_mm[0]
    aside = max(2, round(_PLATEAU_SHARE * upright.shape[1]))
    sides = [upright[:, :aside], upright[:, -aside:]]
    dark, bright = sorted(float(np.mean(side)) for side in sides)
    noise = float(np.sqrt(np.mean([np.var(side) for side in sides]))) / max(bright - dark, 1e-300)
    nyquist_cpp = 0.5 / frames.scale
    to_nyquist = np.interp(steps_to(nyquist_cpp), found.frequency_cpp, found.modulation)
    esf = (found.esf - np.min(sides)) / max(float(np.ptp(sides)), 1e-300)
    esf = esf if upright[:, -1].mean() > upright[:, 0].mean() else 1.0 - esf
    middle = int(np.nanargmin(np.abs(esf - 0.5)))
    normal_px: Vector = np.asarray((np.arange(esf.size) - middle) * found.bin_px, dtype=np.float64)
    unknown = Interval(float("nan"))
    curves = (found.frequency_cpp, found.modulation[:, None], to_nyquist[:, None])
    return EdgeResult(
        **numbers_of(*curves, normal_px, esf[:, None], pitch_mm),
        method=method,
        region=region,
        orientation="horizontal" if found.rotated else "vertical",
        # The original's slope is that of the columns the edge passes, line by line: for an upright
        # edge the turn of the normal has the other sign.
        angle_rad=Interval(found.angle_rad if found.rotated else -found.angle_rad),
        position_px=unknown,
        bend_px=0.0,
        dark=dark,
        bright=bright,
        noise=noise,
        snr=1.0 / max(noise, float(np.finfo(float).tiny)),
        mtf=curve,
        low=None,
        high=None,
        nyquist_lpmm=nyquist_cpp / pitch_mm,
        esf=Profile(normal_px, esf),
        lsf=Profile(normal_px, np.gradient(esf, found.bin_px)),
        residual=None,
        aliasing_px=float("nan"),
        asymmetry=unknown,
        pitch_mm=pitch_mm,
    )
