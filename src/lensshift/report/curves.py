"""MTF curves with bands, limits and marks, as all figures draw them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from lensshift.core.optical import MtfCurve
from lensshift.evaluation.limits import pitch_pair_mm, pixel_aperture_mtf
from lensshift.evaluation.slanted_edge.result import Interval
from lensshift.report.style import BAND_ALPHA, FAINT, GREY, INK, LIGHT, TITLE_PT, note

INTERVAL_SIGMAS = 1.96  # half a 95 % interval of a normal distribution
_LIMIT_POINTS = 301  # smooth in print
STEPS = 41  # of the slow curves of lenses: a 40th of the axis, which still looks smooth
_DIRECTIONS_RAD = np.linspace(0.0, 0.5 * np.pi, 46)
_MOST = 1.9  # sharpened curves are shown up to here
_DASHES = ("--", ":", "-.", (0, (4, 1.2, 1, 1.2, 1, 1.2)))


def draw_curve(
    axes: Axes,
    curve: MtfCurve,
    colour: str,
    label: str,
    *,
    factor: float = 1.0,
    low: ArrayLike | None = None,
    high: ArrayLike | None = None,
) -> None:
    """Draw a curve and its 95 % band: the one given, else 1.96 standard deviations, else none.

    Parameters
    ----------
    curve : frequency and modulation
    colour, label : of the line
    factor : what the frequencies are multiplied by
    low, high : [f] ends of the band
    """
    frequency = curve.frequency_lpmm * factor
    if low is None and high is None and curve.std is not None:
        low = np.maximum(curve.modulation - INTERVAL_SIGMAS * curve.std, 0.0)
        high = curve.modulation + INTERVAL_SIGMAS * curve.std
    if low is not None and high is not None:
        draw_band(axes, frequency, low, high, colour)
    axes.plot(frequency, curve.modulation, color=colour, label=label)


def draw_band(axes: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str) -> None:
    """Shade what lies between two curves."""
    axes.fill_between(x, low, high, color=colour, alpha=BAND_ALPHA, linewidth=0.0)


def draw_pixel_limits(
    axes: Axes,
    pitch_mm: float | tuple[float, float],
    angle_rad: float | None,
    highest_lpmm: float,
    factor: float = 1.0,
) -> None:
    """Draw what a full and a half pixel let through along the normal of an edge.

    Parameters
    ----------
    pitch_mm : side of an LR pixel, or its sides as (row, col)
    angle_rad : of the normal from the col axis; None for the mean over all directions
    highest_lpmm : where the curves end
    factor : what the frequencies are multiplied by
    """
    frequency_lpmm = np.linspace(0.0, highest_lpmm, _LIMIT_POINTS)
    angles_rad = _DIRECTIONS_RAD if angle_rad is None else [angle_rad]
    row_mm, col_mm = pitch_pair_mm(pitch_mm)
    for share, style, name in ((1.0, "--", "pixel"), (0.5, ":", "half a pixel")):
        sides_mm = (share * row_mm, share * col_mm)
        limits = [pixel_aperture_mtf(frequency_lpmm, sides_mm, angle_rad=one) for one in angles_rad]
        shown = frequency_lpmm * factor, np.mean(limits, axis=0)
        axes.plot(*shown, style, color=INK, linewidth=1.0, label=f"|sinc| of {name}")


def draw_limits(
    axes: Axes, limits: Sequence[MtfCurve], highest_lpmm: float, factor: float = 1.0
) -> None:
    """Draw further limits in grey, each with its own dashes and its label."""
    for number, limit in enumerate(limits):
        inside = limit.frequency_lpmm <= highest_lpmm
        shown = limit.frequency_lpmm[inside] * factor, limit.modulation[inside]
        dashes, label = _DASHES[-1 - number % len(_DASHES)], limit.label or "limit"
        axes.plot(*shown, linestyle=dashes, color=GREY, linewidth=1.0, label=label)


def field_name(field_tan: ArrayLike) -> str:
    """Return the angles of a field whose tangents (row, col) are given."""
    row_deg, col_deg = np.round(np.rad2deg(np.arctan(np.asarray(field_tan))), 1) + 0.0
    return f"{row_deg:.1f}/{col_deg:.1f} degrees"


def mark_frequency(axes: Axes, at: float, text: str) -> None:
    """Draw a vertical line at a frequency in the unit of the axes, with its name along it."""
    axes.axvline(at, color=LIGHT, linewidth=1.2, zorder=1.0)
    note(
        axes, text, (at, 0.0), (-2.0, 3.0), xycoords=("data", "axes fraction"), rotation=90,
        ha="right", va="bottom", color=GREY,
    )  # fmt: skip


def mark_crossing(
    axes: Axes, place: Interval, level: float, colour: str, *, filled: bool = True
) -> None:
    """Mark where a curve falls below a level, with the interval if there is one."""
    if not np.isfinite(place.value):
        return
    if np.isfinite(place.low) and np.isfinite(place.high):
        axes.plot([place.low, place.high], [level, level], color=colour, linewidth=3.2, alpha=0.55)
    face = colour if filled else "white"
    axes.plot(place.value, level, "o", color=colour, markerfacecolor=face, markersize=5.0)


def finish_mtf_axes(axes: Axes, highest: float, unit: str, title: str, *, columns: int = 2) -> None:
    """Set limits and labels of axes with MTF curves, and their title with the legend below it.

    Parameters
    ----------
    highest : frequency where they end
    unit : of the frequency
    title : above the legend
    columns : of the legend
    """
    axes.axhline(0.5, color=FAINT, linewidth=1.4, zorder=0.5)
    heights = [np.asarray(line.get_ydata(), dtype=np.float64) for line in axes.get_lines()]
    peak = max((float(np.nanmax(one, initial=0.0)) for one in heights), default=1.0)
    axes.set(xlim=(0.0, highest), ylim=(0.0, min(max(1.05, 1.05 * peak), _MOST)))
    axes.set(xlabel=f"spatial frequency ({unit})", ylabel="modulation")
    legend_above(axes, title, columns)


def legend_above(axes: Axes, title: str, columns: int = 2) -> None:
    """Put the legend between title and axes, where it hides no curve."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, title=title,
        title_fontsize=TITLE_PT, alignment="left", borderaxespad=0.2, borderpad=0.0,
    )  # fmt: skip
