"""The published binning algorithms sfrmat3 and sfrmat5, number for number.

They are here to compare with; their silent failures are errors and warnings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from lensshift.core.errors import warn_quality
from lensshift.core.optical import MtfCurve
from lensshift.evaluation.slanted_edge import result as numbers
from lensshift.evaluation.slanted_edge import sfrmat_steps as steps
from lensshift.evaluation.slanted_edge.checks import doubted, largest_phase_gap_px
from lensshift.evaluation.slanted_edge.prepare import EdgeFrames
from lensshift.evaluation.slanted_edge.result import EdgeResult, Interval, Matrix, Profile, Vector

_CLIP_CPP = 0.495  # above it the original of sfrmat5 reports the clip
_LARGEST_ORDER = 5
_PLATEAU_SHARE = 0.2  # of the columns, on either side, for levels and noise
_REMEDY = "take more lines, a larger angle or a lower order, or use method='ml'"


@dataclass(frozen=True, slots=True)
class SfrmatResult:
    """What sfrmat3 or sfrmat5 finds."""

    # [n] cycles per pixel along the normal of the edge, from 0, as far as returned
    frequency_cpp: Vector
    modulation: Vector  # [n] 1 at 0
    # [m] mean pixel per bin, dark to bright or bright to dark as in the image; in sfrmat5 NaN where
    # bins at its start were empty and play no part
    esf: Vector
    # [m] half the difference of the ESF two bins apart, positive at the edge, before it is centred
    # and windowed
    lsf: Vector
    bin_px: float  # distance of two bins along the normal
    # [order+1] column = p(line), highest power first, both from 0, of the turned image
    edge_px: Vector
    slope: float  # of the straight line through the edge, columns per line
    angle_rad: float  # between the edge and the lines' normal, arctan of the slope
    lines_used: int  # lines that hold a whole number of pixel phases
    empty_bins: int  # bins of the ESF that no pixel fell into
    rotated: bool  # whether the image was turned by 90 degrees counterclockwise
    mtf50_cpp: float  # first crossing of 0.5 and 0.1 anywhere on the curve; NaN without one
    mtf10_cpp: float
    # `mtf10_cpp` over half the sampling frequency, 1 at most. sfrmat3 takes its last frequency
    # below 0.5 / cos(angle) for that, sfrmat5 takes 0.495.
    sampling_efficiency: float


def sfrmat3(image: ArrayLike) -> SfrmatResult:
    """Measure the MTF of one slanted edge as sfrmat3 does, in the manner of ISO 12233:2000.

        MTF(f) = | F[w LSF](f) | / | F[w LSF](0) | * D(f)

    A straight edge through the centroids of the lines, bins of 1/4 px, the LSF as a finite
    difference of the ESF centred on its centroid, a Hamming window w over all of it.

    `image` [row col] has one edge between two flat sides, within 45 degrees of a row or column.
    ValueError if it does not fit, or the original gives no curve: less than one whole pixel phase,
    bins without neighbours, or a brighter left side that it takes for the darker one. Warns of
    empty bins, where sfrmat3 sets the ESF to 0, and of lines that show no edge.

    Source: Burns, Proc. IS&T PICS (2000) 135.
    """
    upright, turned = steps.upright_edge(image, steps.LEAST_LINES)
    sign = steps.polarity(upright)
    edge, missing = steps.edge_of_sfrmat3(sign * upright)
    if missing:
        warn_quality(
            f"sfrmat3 finds no edge in {missing} of {len(upright)} lines and sets it to the left"
        )
    slope = float(edge[1])
    used = _lines_used(upright, edge, slope)
    displacement_px = slope * np.arange(used, dtype=np.float64)
    run_px = slope * (used - 1)
    esf, empty = steps.project(upright[:used], displacement_px, run_px, interpolate_sums=False)
    lsf = np.zeros(esf.size)
    lsf[2:] = sign * (esf[2:] - esf[:-2]) / 2
    lsf[1] = lsf[2]
    _refuse_undefined(lsf, empty)
    centred = _centred(lsf, steps.rounded(steps.bin_centroid_of_sfrmat3(lsf)), empty)
    if empty:
        warn_quality(
            f"{_empty(empty, esf, used, slope)}; sfrmat3 sets the ESF to 0 there, which bends the "
            "whole curve"
        )
    windowed = centred * steps.hamming(lsf.size, (lsf.size - 1) / 2)[0]
    half = (upright.shape[1] - 1) // 2
    return _result(esf, lsf, windowed, edge, slope, used, empty, turned, half)


def sfrmat5(image: ArrayLike, *, order: int = 5, window: steps.Window = "tukey") -> SfrmatResult:
    """Measure the MTF of one slanted edge as sfrmat5 does, in the manner of ISO 12233:2023.

        MTF(f) = | F[w LSF](f) | / | F[w LSF](0) | * D(f)

    As `sfrmat3`, with an edge that is a polynomial of an order from 1 to 5, the LSF centred on its
    maximum, and Tukey windows of centroids and LSF. Warns of empty bins, which it interpolates, and
    of an MTF50 above 0.495 cycles per pixel, where the original reports 0.495.

    Source: Burns and Williams, Electronic Imaging (2018), IQSP-171.
    """
    if isinstance(order, bool) or order not in range(1, _LARGEST_ORDER + 1):
        raise ValueError(f"expected an order from 1 to {_LARGEST_ORDER}, got {order!r}")
    if window not in ("tukey", "hamming"):
        raise ValueError(f"expected the window 'tukey' or 'hamming', got {window!r}")
    upright, turned = steps.upright_edge(image, max(steps.LEAST_LINES, order + 1))
    sign = steps.polarity(upright)
    edge, straight = steps.edge_of_sfrmat5(sign * upright, order, window)
    slope = float(straight[1])
    used = _lines_used(upright, edge, slope)
    displacement_px = polyval(np.arange(used, dtype=np.float64), edge) - edge[0]
    # The original takes the slope at line 0 for the slope of the edge.
    run_px = float(edge[1]) * (used - 1)
    esf, empty = steps.project(upright[:used], displacement_px, run_px, interpolate_sums=True)
    lsf = np.empty(esf.size)
    lsf[1:-1] = sign * (esf[2:] - esf[:-2]) / 2
    lsf[[0, -1]] = lsf[[1, -2]]
    peak = int(np.argmax(np.where(np.isnan(lsf), -np.inf, lsf)))
    centred = _centred(lsf, peak + 1, empty)
    _refuse_undefined(centred, empty)
    if empty:
        warn_quality(f"{_empty(empty, esf, used, slope)}; sfrmat5 interpolates the ESF there")
    middle_px = (lsf.size - 1) / 2
    shape, at_px = (
        (steps.hamming, middle_px) if window == "hamming" else (steps.hann, middle_px - 0.5)
    )
    windowed = centred * shape(lsf.size, at_px)[0]
    result = _result(esf, lsf, windowed, edge, slope, used, empty, turned)
    if result.mtf50_cpp > _CLIP_CPP:
        warn_quality(
            f"MTF50 is {result.mtf50_cpp:.3f} cycles per pixel; the original of sfrmat5 reports "
            f"its clip of {_CLIP_CPP}"
        )
    return result


def _lines_used(upright: Matrix, edge: Vector, slope: float) -> int:
    lines, columns = upright.shape
    bent_px = float(np.ptp(polyval(np.arange(lines, dtype=np.float64), edge)))
    run_px = max(bent_px, abs(slope) * (lines - 1))
    if run_px > columns:
        raise ValueError(
            f"expected an edge that stays within {columns} pixels, got one that runs over "
            f"{run_px:.0f}; cut out one edge between two flat sides, or use method='ml'"
        )
    return steps.whole_phases(lines, slope)


def _empty(empty: int, esf: Vector, lines: int, slope: float) -> str:
    angle_deg = np.rad2deg(np.arctan(abs(slope)))
    return f"{empty} of {esf.size} bins are empty at {angle_deg:.2f} degrees and {lines} lines"


def _refuse_undefined(lsf: Vector, empty: int) -> None:
    if bad := int(np.count_nonzero(~np.isfinite(lsf))):
        raise ValueError(
            f"expected pixels in all bins or beside them, got {empty} of {lsf.size} empty, which "
            f"leave {bad} samples of the LSF undefined; {_REMEDY}"
        )


def _centred(lsf: Vector, number: int, empty: int) -> Vector:
    """Move the bin of this number, counted from 1, to the middle."""
    moved = steps.shifted(lsf, number - steps.rounded((lsf.size + 1) / 2))
    if not moved.any():
        raise ValueError(
            f"expected the centre of the LSF within its {lsf.size} bins, got bin {number} "
            f"with {empty} bins empty; {_REMEDY}"
        )
    return moved


def _result(
    esf: Vector,
    lsf: Vector,
    windowed: Vector,
    edge: Vector,
    slope: float,
    used: int,
    empty: int,
    turned: bool,
    half: int | None = None,
) -> SfrmatResult:
    """Return the result; `half` is the number of the frequency that efficiency is taken over."""
    angle_rad, modulation = float(np.arctan(slope)), steps.modulation_of(windowed)
    bin_px = float(np.cos(angle_rad)) / steps.BINS_PER_PX
    frequency_cpp = np.arange(modulation.size) / (lsf.size * bin_px)
    half_cpp = _CLIP_CPP if half is None else float(frequency_cpp[half])
    mtf50_cpp, mtf10_cpp = (
        float(numbers.crossings(frequency_cpp, modulation[:, None], level)[0])
        for level in (0.5, 0.1)
    )
    return SfrmatResult(
        frequency_cpp, modulation, esf, lsf, bin_px, edge[::-1].copy(), slope, angle_rad,
        lines_used=used, empty_bins=empty, rotated=turned, mtf50_cpp=mtf50_cpp,
        mtf10_cpp=mtf10_cpp, sampling_efficiency=float(np.fmin(mtf10_cpp / half_cpp, 1.0)),
    )  # fmt: skip


def measure_binned(
    frames: EdgeFrames,
    region: numbers.Region,
    wanted_lpmm: Vector | None,
    method: str,
    options: dict[str, Any],
) -> EdgeResult:
    """Measure one region of one frame with sfrmat3 or sfrmat5.

    Without `wanted_lpmm` the curve is at the algorithm's own frequencies; else it is interpolated.
    Raises `ValueError` if there are several frames, invalid pixels, or no curve.
    """
    if len(frames.values) > 1:
        raise ValueError(f"expected one image for {method}, got {len(frames.values)} frames")
    if frames.pitch_mm[0] != frames.pitch_mm[1]:
        raise ValueError(f"expected square pixels for {method}, got pitch {frames.pitch_mm} mm")
    image = frames.first[region.slices]
    if missing := int(np.count_nonzero(np.isnan(image))):
        raise ValueError(f"expected valid pixels for {method}, got {missing} invalid in {region}")
    found = (sfrmat3 if method == "sfrmat3" else sfrmat5)(image, **options)
    frequency_lpmm, modulation = found.frequency_cpp / frames.pitch_mm[0], found.modulation
    if wanted_lpmm is not None:
        own, frequency_lpmm = (frequency_lpmm, modulation), frames.frequency_lpmm(wanted_lpmm)
        modulation = np.interp(frequency_lpmm, *own, right=np.nan)
    curve = MtfCurve(frequency_lpmm, modulation, None, method)
    upright = np.rot90(image) if found.rotated else image
    result = _as_edge(found, region, upright, frames, curve)
    gap_px = largest_phase_gap_px(np.arange(float(len(upright))), found.angle_rad)
    return doubted(result, len(upright), gap_px, image.ravel())


def _as_edge(
    found: SfrmatResult,
    region: numbers.Region,
    upright: Matrix,
    frames: EdgeFrames,
    curve: MtfCurve,
) -> EdgeResult:
    pitch_mm = frames.pitch_mm[0]
    aside = max(2, round(_PLATEAU_SHARE * upright.shape[1]))
    sides = [upright[:, :aside], upright[:, -aside:]]
    dark, bright = sorted(float(np.mean(side)) for side in sides)
    noise = float(np.sqrt(np.mean([np.var(side) for side in sides]))) / max(bright - dark, 1e-300)
    nyquist_cpp = 0.5 / frames.scale
    to_nyquist = np.interp(numbers.steps_to(nyquist_cpp), found.frequency_cpp, found.modulation)
    esf = (found.esf - np.min(sides)) / max(float(np.ptp(sides)), 1e-300)
    rising = bool(upright[:, -1].mean() > upright[:, 0].mean())
    esf = esf if rising else 1.0 - esf
    middle = int(np.nanargmin(np.abs(esf - 0.5)))
    normal_px: Vector = np.asarray((np.arange(esf.size) - middle) * found.bin_px, dtype=np.float64)
    unknown = Interval(float("nan"))
    curves = (found.frequency_cpp, found.modulation[:, None], to_nyquist[:, None])
    return EdgeResult(
        **numbers.numbers_of(*curves, normal_px, esf[:, None], pitch_mm),
        method=curve.label, region=region,
        orientation="horizontal" if found.rotated else "vertical",
        # The original's slope is that of the columns the edge passes, line by line: for an upright
        # edge the turn of the normal has the other sign.
        angle_rad=Interval(found.angle_rad if found.rotated else -found.angle_rad),
        position_px=unknown, rising=rising, bend_px=0.0, dark=dark, bright=bright, noise=noise,
        snr=1.0 / max(noise, float(np.finfo(float).tiny)), mtf=curve, low=None, high=None,
        nyquist_lpmm=nyquist_cpp / pitch_mm, esf=Profile(normal_px, esf),
        lsf=Profile(normal_px, np.gradient(esf, found.bin_px)), residual=None,
        aliasing_px=float("nan"), asymmetry=unknown, pitch_mm=pitch_mm,
    )  # fmt: skip
