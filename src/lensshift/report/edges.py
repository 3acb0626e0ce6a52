"""Figures of slanted edges: the curve with its limits, where it was measured, what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.optical import MtfCurve
from lensshift.evaluation.gain import ResolutionGain, ratio_of
from lensshift.evaluation.slanted_edge.result import EdgeResult, Interval, average_curves
from lensshift.report import curves, images, style

_CURVES_IN, _IMAGE_IN, _LABELS_IN = 3.6, 4.0, 0.8  # heights
_CURVE_WIDTHS = (1.9, 1.0)  # of the curve and of the edge beside it
_WIDE, _TALL = 2.6, 2.0  # columns per row, rows per column
_RESIDUAL_SIGMAS = 4.0  # at the ends of the colour scale
_MOST_NYQUISTS = 4.0  # where half a pixel lets nothing through
_PROFILE_PX = 4.0  # shown on either side of an edge, at least
_PROFILE_WIDTHS = 2.0  # or so many 10-90 widths
_LEAST_MODULATION = 0.05  # below it a ratio of two curves says nothing
_MOST_RATIO = 6.0  # on the axis
_MOST_NAMED = 6  # edges in a legend
_SAME_NYQUIST = 1.2  # of the pixels over that of LR pixels; the slant alone makes up to 1.1


@style.styled()
def edge_figure(
    results: Sequence[EdgeResult],
    image: ArrayLike | None = None,
    *,
    unit: str = "LP/mm",
    factor: float = 1.0,
    pitch_mm: float | tuple[float, float] | None = None,
    limits: Sequence[MtfCurve] = (),
) -> Figure:
    """Draw slanted edges: MTF with 95 % band and limits, profiles, regions, residuals.

    Parameters
    ----------
    results : at least one edge
    image : [row col] in which they were measured, drawn with regions and edges if given
    unit, factor : of the frequencies shown, and what those of the results are multiplied by
    pitch_mm : side of an LR pixel for its limits, one or (row, col); a square of the LR Nyquist
        frequency if None
    limits : further curves to compare with, such as the diffraction limit, with their labels

    Raises
    ------
    ValueError
        If there is no edge, or the image has not two axes.
    """
    if not results:
        raise ValueError("expected at least one edge, got none")
    picture = None if image is None else images.plain_image(image)
    residual = _residual_map(results)
    shapes = [] if picture is None else [picture.shape]
    shapes += [] if residual is None else [residual[0].shape]
    figure, panels = _panels(shapes)
    _draw_curves(panels[0], results, unit, factor, pitch_mm, limits)
    _draw_profiles(panels[1], results)
    if picture is not None:
        _draw_places(panels[2], picture, results)
    if residual is not None:
        values, corner_px = residual
        words = ("pixels minus model", "standard deviations of the noise")
        images.draw_map(panels[-1], values, *words, largest=_RESIDUAL_SIGMAS, corner_px=corner_px)
    return figure


@style.styled()
def gain_figure(
    fine: EdgeResult,
    coarse: EdgeResult,
    gain: ResolutionGain,
    *,
    unit: str = "LP/mm",
    names: tuple[str, str] = ("fine", "coarse"),
) -> Figure:
    """Draw two measurements of one edge, the ratio of their MTF, and the gains.

    Parameters
    ----------
    fine, coarse : the measurements
    gain : of the first over the second
    unit : of the frequencies
    names : of the two
    """
    figure = style.new_figure(style.WIDTH_IN, 5.2)
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=_CURVE_WIDTHS)[0]
    above, below = left.subplots(2, 1, height_ratios=(2.0, 1.0), sharex=True)
    for result, name, colour in zip((fine, coarse), names, (style.BLUE, style.RED), strict=True):
        _draw_result(above, result, colour, f"{name}: {_mtf50(result, unit, 1.0)}", 1.0)
    highest_lpmm = _highest_lpmm([fine, coarse])
    _draw_limits(above, coarse, highest_lpmm, 1.0, None)
    title = "MTF along the normal of the edge, with 95 % bands"
    curves.finish_mtf_axes(above, highest_lpmm, unit, title)
    above.set_xlabel("")
    _draw_ratio(below, fine, coarse)
    below.set(xlabel=f"spatial frequency ({unit})", ylabel=f"{names[0]} / {names[1]}")
    _draw_gains(right.subplots(), gain)
    return figure


def edge_line_px(result: EdgeResult) -> tuple[Floats, Floats]:
    """Return rows and columns of the two ends of a straight edge, cut at its region.

        across = position - (along - middle) tan(angle)

    Parameters
    ----------
    result : whose position is that of the edge at the middle of the region
    """
    vertical = result.orientation == "vertical"
    place = result.region.slices[0 if vertical else 1]
    along = np.array([place.start - 0.5, place.stop - 0.5])
    across = result.position_px.value - np.tan(result.angle_rad.value) * (along - along.mean())
    return (along, across) if vertical else (across, along)


def _panels(shapes: list[tuple[int, ...]]) -> tuple[Figure, list[Axes]]:
    """Return the figure and axes for curves, profiles and images of these shapes.

    Wide images lie above each other, others side by side, tall ones right of the curves.
    """
    if not shapes:
        figure = style.new_figure(style.WIDTH_IN, _CURVES_IN)
        return figure, list(figure.subplots(1, 2, width_ratios=_CURVE_WIDTHS))
    rows, cols = shapes[0]
    if rows > _TALL * cols:
        figure = style.new_figure(style.WIDTH_IN, 2.0 * _CURVES_IN)
        left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.25, 1.0))[0]
        below = right.subplots(1, len(shapes), squeeze=False)
        return figure, [*left.subplots(2, 1), *below.ravel()]
    stacked = len(shapes) == 1 or cols > _WIDE * rows
    each_in = (0.84 if stacked else 0.4) * style.WIDTH_IN
    heights_in = [_LABELS_IN + min(each_in * rows / cols, _IMAGE_IN) for rows, cols in shapes]
    below_in = sum(heights_in) if stacked else max(heights_in)
    figure = style.new_figure(style.WIDTH_IN, _CURVES_IN + below_in)
    heights = (_CURVES_IN, below_in)
    top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    count = (len(shapes), 1) if stacked else (1, len(shapes))
    below = bottom.subplots(*count, squeeze=False, height_ratios=heights_in if stacked else None)
    return figure, [*top.subplots(1, 2, width_ratios=_CURVE_WIDTHS), *below.ravel()]


def _draw_curves(
    axes: Axes,
    results: Sequence[EdgeResult],
    unit: str,
    factor: float,
    pitch_mm: float | tuple[float, float] | None,
    limits: Sequence[MtfCurve],
) -> None:
    if len(results) > _MOST_NAMED:
        _draw_crowd(axes, results, factor)
    else:
        for number, result in enumerate(results):
            name = _mtf50(result, unit, factor)
            label = f"edge, {name}" if len(results) == 1 else f"edge {number + 1}, {name}"
            _draw_result(axes, result, style.colour_of(number), label, factor)
    highest_lpmm = _highest_lpmm(results)
    _draw_limits(axes, results[0], highest_lpmm, factor, pitch_mm)
    curves.draw_limits(axes, limits, highest_lpmm, factor)
    band = any(result.low is not None or result.mtf.std is not None for result in results)
    ending = ", with 95 % band" if band else f" ({results[0].method})"
    title = f"MTF along the normal of the edge{ending}"
    curves.finish_mtf_axes(axes, highest_lpmm * factor, unit, title)


def _draw_crowd(axes: Axes, results: Sequence[EdgeResult], factor: float) -> None:
    """Draw so many edges that no legend names them as thin lines about their mean."""
    for number, result in enumerate(results):
        curve = result.mtf
        frequency, colour = curve.frequency_lpmm * factor, style.colour_of(number)
        axes.plot(frequency, curve.modulation, color=colour, linewidth=0.6, alpha=0.6)
    mean = average_curves(results)
    curves.draw_curve(axes, mean, style.INK, mean.label, factor=factor)


def _draw_result(axes: Axes, result: EdgeResult, colour: str, label: str, factor: float) -> None:
    band = {"low": result.low, "high": result.high}
    curves.draw_curve(axes, result.mtf, colour, label, factor=factor, **band)
    curves.mark_crossing(axes, result.mtf50_lpmm.scaled(factor), 0.5, colour)


def _draw_limits(
    axes: Axes,
    result: EdgeResult,
    highest_lpmm: float,
    factor: float,
    pitch_mm: float | tuple[float, float] | None,
) -> None:
    """Draw the limits of a pixel along the normal of an edge, and both Nyquist frequencies.

    Shaded: beyond that of the pixels of the image, where all but a slanted edge is an alias.
    """
    turn_rad = result.angle_rad.value
    normal_rad = turn_rad if result.orientation == "vertical" else 0.5 * np.pi - turn_rad
    pixel_mm = 0.5 / result.nyquist_lpmm if pitch_mm is None else pitch_mm
    curves.draw_pixel_limits(axes, pixel_mm, normal_rad, highest_lpmm, factor)
    curves.mark_frequency(axes, result.nyquist_lpmm * factor, "LR Nyquist")
    samples_lpmm = result.sample_nyquist_lpmm
    if highest_lpmm > samples_lpmm:
        ends = samples_lpmm * factor, highest_lpmm * factor
        axes.axvspan(*ends, color=style.FAINT, alpha=0.45, lw=0)
    if samples_lpmm > _SAME_NYQUIST * result.nyquist_lpmm:
        curves.mark_frequency(axes, samples_lpmm * factor, "Nyquist of the pixels")


def _draw_profiles(axes: Axes, results: Sequence[EdgeResult]) -> None:
    reach_px = _PROFILE_PX
    for number, result in enumerate(results):
        place_px, value, std = result.esf.normal_px, result.esf.value, result.esf.std
        colour = style.colour_of(number)
        if std is not None and len(results) <= _MOST_NAMED:
            half = curves.INTERVAL_SIGMAS * std
            curves.draw_band(axes, place_px, value - half, value + half, colour)
        axes.plot(place_px, value, color=colour, linewidth=1.4)
        width_px = result.rise_mm.value / result.pitch_mm
        if np.isfinite(width_px):
            reach_px = max(reach_px, _PROFILE_WIDTHS * width_px)
    for level in (0.0, 1.0):
        axes.axhline(level, color=style.FAINT, linewidth=1.4, zorder=0.5)
    axes.set(xlim=(-reach_px, reach_px), title="edge spread function")
    axes.set(xlabel="distance from the edge (px)", ylabel="level (dark 0, bright 1)")


def _draw_places(axes: Axes, picture: Floats, results: Sequence[EdgeResult]) -> None:
    many = len(results) > 1
    fitted = any(np.isfinite(result.position_px.value) for result in results)
    title = "regions" if many else "region"
    images.draw_image(axes, picture, f"{title} and fitted edge{'s' * many}" if fitted else title)
    for number, result in enumerate(results):
        colour = style.colour_of(number)
        top, stop, left, right = astuple(result.region)
        corner, sides = (left - 0.5, top - 0.5), (right - left, stop - top)
        borders = Rectangle(
            corner, *sides, fill=False, edgecolor=colour, linewidth=1.3,
            path_effects=style.outlined(1.3), clip_on=False,  # an image that it fills cuts it not
        )  # fmt: skip
        axes.add_patch(borders)
        row_px, col_px = edge_line_px(result)
        axes.plot(col_px, row_px, color=colour, linewidth=1.3, path_effects=style.outlined(1.3))
        if many:
            how = {"color": colour, "va": "top", "fontweight": "bold"}
            style.note(axes, str(number + 1), corner, (3.0, -3.0), **how)
    axes.set(xlim=(-0.5, picture.shape[1] - 0.5), ylim=(picture.shape[0] - 0.5, -0.5))


def _residual_map(results: Sequence[EdgeResult]) -> tuple[Floats, tuple[int, int]] | None:
    """Return the residuals of all edges over their noise, and where they begin; None without."""
    known = [result for result in results if result.residual is not None]
    if not known:
        return None
    ends = np.array([astuple(result.region) for result in known])
    top, left = int(ends[:, 0].min()), int(ends[:, 2].min())
    residual = np.full((int(ends[:, 1].max()) - top, int(ends[:, 3].max()) - left), np.nan)
    for result in known:
        rows, cols = result.region.slices
        inside = residual[rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        own = np.asarray(result.residual) / result.noise
        inside[np.isfinite(own)] = own[np.isfinite(own)]
    return residual, (top, left)


def _highest_lpmm(results: Sequence[EdgeResult]) -> float:
    """Return where the figure ends: with the longest curve, or where half a pixel is blind."""
    longest_lpmm = max(float(result.mtf.frequency_lpmm[-1]) for result in results)
    return min(longest_lpmm, _MOST_NYQUISTS * results[0].nyquist_lpmm)


def _mtf50(result: EdgeResult, unit: str, factor: float) -> str:
    half = result.mtf50_lpmm.scaled(factor)
    return f"MTF50 {_three_digits(half)} {unit}" if np.isfinite(half.value) else "MTF50 not reached"


def _three_digits(number: Interval) -> str:
    if not (np.isfinite(number.low) and np.isfinite(number.high)):
        return f"{number.value:#.3g}"
    return f"{number.value:#.3g} ({number.low:#.3g} to {number.high:#.3g})"


def _draw_ratio(axes: Axes, fine: EdgeResult, coarse: EdgeResult) -> None:
    """Draw fine over coarse, up to where the coarse curve says nothing any more."""
    frequency_lpmm = fine.mtf.frequency_lpmm
    weak = coarse.mtf.frequency_lpmm[coarse.mtf.modulation < _LEAST_MODULATION]
    end_lpmm = min([coarse.mtf.frequency_lpmm[-1], *weak[:1]])
    frequency_lpmm = frequency_lpmm[frequency_lpmm <= end_lpmm]
    above, below = (_curve_at(result, frequency_lpmm) for result in (fine, coarse))
    ratios = [ratio_of(one, other) for one, other in zip(above, below, strict=True)]
    low, value, high = np.array([(one.low, one.value, one.high) for one in ratios]).T
    curves.draw_band(axes, frequency_lpmm, low, high, style.PURPLE)
    axes.plot(frequency_lpmm, value, color=style.PURPLE)
    axes.axhline(1.0, color=style.GREY, linewidth=0.9, zorder=1.0)
    curves.mark_frequency(axes, coarse.nyquist_lpmm, "")
    highest = float(np.nanmax(value, initial=1.0))
    axes.set(ylim=(0.0, min(max(2.0, 1.3 * highest), _MOST_RATIO)), title="ratio of the curves")


def _curve_at(result: EdgeResult, frequency_lpmm: Floats) -> list[Interval]:
    known = [one for one in (result.mtf.modulation, result.low, result.high) if one is not None]
    at = [np.interp(frequency_lpmm, result.mtf.frequency_lpmm, one).tolist() for one in known]
    return [Interval(*one) for one in zip(*at, strict=True)]


def _draw_gains(axes: Axes, gain: ResolutionGain) -> None:
    """Draw the ratios with their intervals, one below the other."""
    rows = {"MTF50": gain.mtf50, "MTF10": gain.mtf10, "10-90 width": gain.width}
    for place, (name, ratio) in enumerate((rows | {"noise": Interval(gain.noise)}).items()):
        if not np.isfinite(ratio.value):
            words = axes.text(1.0, place, " not reached", va="center", color=style.GREY)
            words.set_fontsize(style.SMALL_PT)
            continue
        colour = style.GREY if name == "noise" else style.BLUE
        if np.isfinite(ratio.low) and np.isfinite(ratio.high):
            axes.plot([ratio.low, ratio.high], [place, place], color=colour, linewidth=1.4)
        axes.plot(ratio.value, place, "o", color=colour, markersize=5.5)
        style.note(axes, _three_digits(ratio), (ratio.value, place), (0.0, 7.0), ha="center")
    axes.axvline(1.0, color=style.GREY, linewidth=0.9, zorder=1.0)
    axes.set_yticks(range(len(rows) + 1), [*rows, "noise"])
    axes.set_ylim(len(rows) + 0.6, -0.6)
    axes.margins(x=0.25)
    axes.grid(visible=False, axis="y")
    axes.set(xlabel="ratio, with 95 % interval", title="gain in resolution and in noise")
