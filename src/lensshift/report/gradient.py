"""Figures of edge gradients: profiles with the limits they were measured between, every slope."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from lensshift.evaluation.edge_gradient import EdgeGradient, ProfileEdge
from lensshift.report.curves import legend_above
from lensshift.report.style import BAND_ALPHA, GREY, LIGHT, colour_of, new_figure, note, styled

_SHOWN_WIDTHS = 3.0  # on either side of the edge


class MeasuredLines(NamedTuple):
    """Lines across an edge and what was measured on them.

    Parameters
    ----------
    gradient : of these lines
    values : [n] or [line n]
    step_mm : spacing of the samples
    name : in the legend
    """

    gradient: EdgeGradient
    values: ArrayLike
    step_mm: float
    name: str = "coarser image"

    @property
    def lines(self) -> NDArray[np.float64]:
        """Return the lines [line n], also of a single one."""
        return np.atleast_2d(np.asarray(self.values, dtype=np.float64))


@styled()
def gradient_figure(
    gradient: EdgeGradient,
    values: ArrayLike,
    *,
    step_mm: float,
    length: str = "mm",
    name: str = "image",
    against: tuple[Any, ...] | None = None,
    unit: str = "",
) -> Figure:
    """Draw lines across an edge with limits and gradient, and the gradient of every line.

    The lines are laid onto one another where each crosses the middle between its limits.

    Parameters
    ----------
    gradient, values, step_mm, name : as in `MeasuredLines`
    length : unit of `step_mm` as it is to be called
    against : `MeasuredLines` of the same edge in another image, or what makes them
    unit : of the values

    Raises
    ------
    ValueError
        If the number of lines is not that of the gradient.
    """
    measured = [MeasuredLines(gradient, values, step_mm, name)]
    measured += [] if against is None else [MeasuredLines(*against)]
    for one in measured:
        if len(one.lines) != len(one.gradient.lines):
            raise ValueError(
                f"expected {len(one.gradient.lines)} lines as measured, got {len(one.lines)}"
            )
    figure = new_figure(9.0, 3.9)
    profiles, slopes = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for number, one in enumerate(measured):
        limits = _draw_profiles(profiles, one, colour_of(number), length)
        _draw_limits(profiles, limits, named=number == 0)
        _draw_slopes(slopes, one, colour_of(number))
    reach_mm = _SHOWN_WIDTHS * max(float(one.gradient.width_mm.max()) for one in measured)
    profiles.set_xlim(-reach_mm, reach_mm)
    profiles.set_xlabel(f"distance from the edge along the line ({length})")
    profiles.set_ylabel(f"value ({unit})" if unit else "value")
    legend_above(profiles, "lines across the edge: limits and gradient", columns=1)
    slopes.set_xlim(-0.7, max(len(one.lines) for one in measured) - 0.3)
    slopes.set_ylim(0.0, 1.1 * slopes.dataLim.y1)
    slopes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    slopes.set(xlabel="line", ylabel=f"gradient (share of the step per {length})")
    legend_above(slopes, "gradient of every line", columns=1)
    return figure


def _draw_profiles(axes: Axes, measured: MeasuredLines, colour: str, length: str) -> ProfileEdge:
    """Draw all lines in a pale colour, the middle one strongly; return its edge."""
    lines, edges = measured.lines, measured.gradient.lines
    place_mm = np.arange(lines.shape[1]) * measured.step_mm
    for values, edge in zip(lines, edges, strict=True):
        axes.plot(place_mm - edge.position_mm, values, color=colour, linewidth=0.7, alpha=0.25)
    middle = len(lines) // 2
    edge = edges[middle]
    shown = place_mm - edge.position_mm, lines[middle]
    axes.plot(*shown, ".-", color=colour, linewidth=1.2, markersize=5)
    ends_mm = np.array([edge.low_position_mm, edge.high_position_mm]) - edge.position_mm
    label = f"{measured.name}, line {middle} of {len(lines)}: {edge.slope_per_mm:.3g} per {length} "
    label += f"over {edge.width_mm:.3g} {length}"
    how: dict[str, Any] = {"linewidth": 3.0, "markersize": 6.0, "markeredgecolor": "white"}
    limits = [edge.low_limit, edge.high_limit]
    axes.plot(ends_mm, limits, "o-", color=colour, label=label, **how)
    return edge


def _draw_limits(axes: Axes, edge: ProfileEdge, *, named: bool) -> None:
    step = edge.high - edge.low
    for limit, plateau in ((edge.low_limit, edge.low), (edge.high_limit, edge.high)):
        axes.axhline(plateau, color=LIGHT, linewidth=0.9, zorder=1.0)
        axes.axhline(limit, color=GREY, linewidth=0.9, linestyle="--", zorder=1.0)
        if not named:  # the same shares for all, at levels that may be alike
            continue
        share = 100.0 * (limit - edge.low) / step
        away_pt, va = (2.0, "bottom") if plateau == edge.low else (-2.0, "top")
        note(
            axes, f"{share:.3g} % of the step", (1.0, limit), (-2.0, away_pt),
            xycoords=("axes fraction", "data"), ha="right", va=va, color=GREY,
        )  # fmt: skip


def _draw_slopes(axes: Axes, measured: MeasuredLines, colour: str) -> None:
    gradient = measured.gradient
    mean, interval = gradient.mean_per_mm, gradient.interval_per_mm
    axes.plot(gradient.normalised_per_mm, "o", color=colour, markersize=3.5)
    ending = ""
    if interval is not None:
        axes.axhspan(*interval, color=colour, alpha=BAND_ALPHA, linewidth=0.0)
        ending = f" ({interval[0]:.3g} to {interval[1]:.3g}, 95 %)"
    label = f"{measured.name}, mean {mean:.3g}{ending}"
    axes.axhline(mean, color=colour, linewidth=1.2, label=label)
    if gradient.averaged is not None:
        averaged = gradient.averaged.normalised_per_mm
        label = f"{measured.name}, averaged profile {averaged:.3g}"
        axes.axhline(averaged, color=colour, linewidth=1.2, linestyle="--", label=label)
