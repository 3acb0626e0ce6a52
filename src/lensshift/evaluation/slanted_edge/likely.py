"""One edge by maximum likelihood: fit, numbers, intervals, doubts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lensshift.core.optical import MtfCurve
from lensshift.evaluation.slanted_edge import result as numbers
from lensshift.evaluation.slanted_edge.bending import rms_bend_px
from lensshift.evaluation.slanted_edge.checks import displacement_px, doubted, largest_phase_gap_px
from lensshift.evaluation.slanted_edge.compression import lost_std, with_losses
from lensshift.evaluation.slanted_edge.edge_model import Vector
from lensshift.evaluation.slanted_edge.fit import EdgeFit, LikelySettings, fit_edge
from lensshift.evaluation.slanted_edge.prepare import EdgeFrames, UprightEdge
from lensshift.evaluation.slanted_edge.result import EdgeResult, Interval, Profile, Region
from lensshift.evaluation.slanted_edge.screening import screened

# Cycles per unit width, for the crossings: a cubic finds what a ghost 32 units away makes wave.
_GRID: Vector = np.asarray(np.arange(301) * 0.005)
_FINER = 4
_FEWEST_ASIDE = 20  # pixels on either side of the edge


def measure_likely(
    frames: EdgeFrames, region: Region, wanted_lpmm: Vector | None, settings: LikelySettings
) -> EdgeResult:
    """Measure one region by maximum likelihood; `ValueError` if there is no edge in it."""
    pixels = frames.pixels(region)
    edge, out = screened(pixels, settings.aperture_px, settings.most_bends)
    if min(int(np.sum(edge.normal_px < 0)), int(np.sum(edge.normal_px > 0))) < _FEWEST_ASIDE:
        raise ValueError(f"expected {_FEWEST_ASIDE} pixels on both sides of the edge in {region}")
    pitch_mm = frames.normal_pitch_mm(float(edge.geometry[0]), edge.vertical)
    frequency_lpmm = frames.frequency_lpmm(wanted_lpmm)
    nyquist_cpp = 0.5 * pitch_mm / (frames.scale * max(frames.pitch_mm))
    blocks = _GRID / edge.unit_px, numbers.steps_to(nyquist_cpp), frequency_lpmm * pitch_mm
    fit = fit_edge(edge, np.concatenate(blocks), settings)
    if settings.jpeg_steps is not None:
        fit = _with_losses(fit, np.concatenate(blocks), settings)
    result = _result(fit, region, frames, blocks, frequency_lpmm, pitch_mm)
    lines = _lines(edge)
    gap_px = largest_phase_gap_px(lines, float(edge.geometry[0]))
    count = np.unique(np.round(lines, 6)).size
    apart_px = _moves_px(fit, edge.pixels.places[:, 0])
    return doubted(result, count, gap_px, edge.pixels.values, out, apart_px, fit.whole)


def _with_losses(fit: EdgeFit, frequency_cpp: Vector, settings: LikelySettings) -> EdgeFit:
    """Return the fit with what a JPEG may have cut off among its draws."""
    line, contrast = fit.edge.line, fit.contrast
    across, along = np.cos(fit.geometry[0, 0]), np.sin(fit.geometry[0, 0])
    std = lost_std(
        frequency_cpp,
        np.abs(fit.transform[:, 0]),
        np.asarray(settings.jpeg_steps) / ((line.high - line.low) * contrast),
        np.array([along, across] if fit.edge.vertical else [across, along]),
        fit.noise.dark_sigma / contrast,
    )
    return replace(fit, transform=with_losses(fit.transform, frequency_cpp, std, settings.seed))


def _result(
    fit: EdgeFit, region: Region, frames: EdgeFrames, blocks: tuple[Vector, ...],
    frequency_lpmm: Vector, pitch_mm: float,
) -> EdgeResult:  # fmt: skip
    edge, ends = fit.edge, np.cumsum([block.size for block in blocks])
    _, to_nyquist, wanted = np.split(np.abs(fit.transform), ends[:-1])
    grid_cpp = np.linspace(0.0, blocks[0][-1], _FINER * (ends[0] - 1) + 1)
    grid = np.abs(CubicSpline(blocks[0], fit.transform[: ends[0]])(grid_cpp))
    low, high = np.quantile(wanted[:, 1:], (0.025, 0.975), axis=1)
    # Moduli scatter above 0: where their transforms lie on both sides of it, it may be 0.
    phased = fit.transform * np.exp(-1j * np.angle(fit.transform[:, :1]))
    low[np.quantile(phased[ends[1] :, 1:].real, 0.025, axis=1) < 0.0] = 0.0
    level_noise = 0.5 * (fit.noise.dark_sigma + fit.noise.bright_sigma)
    noise = max(level_noise / fit.contrast, float(np.finfo(float).tiny))
    span = edge.line.high - edge.line.low
    dark, bright = edge.line.low + span * np.array([fit.dark, fit.dark + fit.contrast])
    residual = np.full(region.shape, np.nan)  # of the first frame
    frame, row, col = edge.pixels.places.T
    residual[row[frame == 0], col[frame == 0]] = fit.residual[frame == 0]
    phases = max(frames.scale, 2)  # rows may be interlaced, and pixels repeated
    aliasing_px = _moves_px(fit, (row % phases) * phases + col % phases)
    return EdgeResult(
        **numbers.numbers_of(grid_cpp, grid, to_nyquist, fit.normal_px, fit.esf, pitch_mm),
        method="ml", region=region, orientation="vertical" if edge.vertical else "horizontal",
        angle_rad=numbers.interval_of(edge.sign * fit.geometry[0]),
        position_px=_position(fit, region), rising=edge.sign > 0.0,
        bend_px=rms_bend_px(fit.geometry[:, 0]),
        dark=float(dark), bright=float(bright), noise=noise, snr=1.0 / noise,
        mtf=MtfCurve(frequency_lpmm, wanted[:, 0], wanted[:, 1:].std(axis=1), "slanted edge"),
        low=low, high=high, nyquist_lpmm=0.5 / (frames.scale * max(frames.pitch_mm)),
        esf=Profile(fit.normal_px, fit.esf[:, 0], fit.esf[:, 1:].std(axis=1)),
        lsf=Profile(fit.normal_px, fit.lsf[:, 0], fit.lsf[:, 1:].std(axis=1)),
        residual=residual, aliasing_px=aliasing_px, asymmetry=_asymmetry(fit), pitch_mm=pitch_mm,
    )  # fmt: skip


def _position(fit: EdgeFit, region: Region) -> Interval:
    """Return where the edge crosses the middle of the region, along the axis across it."""
    edge = fit.edge
    middle_px = region.middle_px[1 if edge.vertical else 0]
    origin_px = edge.line.position_px / np.cos(edge.start_angle_rad)
    angle_rad, rho_px, *bends_px = fit.geometry
    bends = np.polynomial.legendre.legval(0.0, [0.0, 0.0, *(bend[0] for bend in bends_px)])
    across_px = (rho_px + bends) / np.cos(angle_rad) + origin_px
    return numbers.interval_of(middle_px + edge.sign * across_px)


def _moves_px(fit: EdgeFit, group: NDArray[np.intp]) -> float:
    slope = np.interp(fit.edge.normal_px, fit.normal_px, fit.lsf[:, 0], left=0.0, right=0.0)
    return displacement_px(fit.residual, slope, group, fit.noise.dark_sigma)


def _asymmetry(fit: EdgeFit) -> Interval:
    """Return the largest departure of the ESF from symmetry about its point of half height."""
    values, place = fit.esf.T, fit.normal_px
    middle = place[np.argmin(np.abs(values - 0.5), axis=1)]
    step_px = place[1] - place[0]  # mirrored places lie half-way between at most
    at = np.clip((2.0 * middle[:, None] - place - place[0]) / step_px, 0.0, place.size - 1.0)
    mirrored = np.take_along_axis(values, np.rint(at).astype(np.intp), axis=1)
    odd = 0.5 * np.max(np.abs(values + mirrored - 1.0), axis=1)
    return numbers.interval_of(odd)


def _lines(edge: UprightEdge) -> Vector:
    """Return the places of the lines along the edge, those of shifted frames beside each other."""
    frame, row, col = edge.pixels.places.T
    steps = (row, col) if edge.vertical else (col, row)
    first = np.zeros(frame.max() + 1)
    first[frame] = edge.sign * edge.across_px - steps[1]
    slope = np.tan(edge.geometry[0])
    shifted: Vector = edge.along_px
    if abs(slope) > 1e-6:
        shifted = shifted + edge.sign * (first[frame] - first[0]) / slope
    return np.unique(np.round(shifted, 9))
