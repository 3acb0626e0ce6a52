"""Figures of the reproduction of the paper, from plain arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from lensshift.report.style import COLOURS, GREY, INK, SMALL_PT, colour_of, new_figure, styled

_DASHES = ("-", "--", ":", "-.")
_MOST_GAIN = 6.0  # on the axis: twice the largest claim, unless a mean is larger


@styled()
def curves_figure(
    frequency_lpmm: ArrayLike,
    curves: Mapping[str, ArrayLike],
    limits: Mapping[str, ArrayLike],
    title: str,
    *,
    bands: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    paired: bool = False,
) -> Figure:
    """Draw MTF curves in colours and limits in grey dashes, all at the same frequencies.

    Parameters
    ----------
    frequency_lpmm : [f]
    curves, limits : label -> [f]
    title : above the figure
    bands : label -> lowest and highest [f]
    paired : whether every second curve belongs to the one before: same colour, dashed
    """
    frequency = np.asarray(frequency_lpmm, dtype=np.float64)
    figure = new_figure(8.2, 4.6)
    axes = figure.subplots()
    for number, (label, values) in enumerate(curves.items()):
        colour = colour_of(number // 2 if paired else number)
        again = number % 2 if paired else number >= len(COLOURS)
        style = "--" if again else "-"
        if bands and label in bands:
            axes.fill_between(frequency, *bands[label], color=colour, alpha=0.18, linewidth=0)
        axes.plot(frequency, np.asarray(values), style, color=colour, label=label)
    for number, (label, values) in enumerate(limits.items()):
        style = _DASHES[1 + number % 3]
        axes.plot(frequency, np.asarray(values), style, color=INK, linewidth=1.0, label=label)
    axes.set(xlim=(0.0, float(frequency[-1])), ylim=(0.0, None))
    axes.set(xlabel="spatial frequency on the sensor (LP/mm)", ylabel="modulation")
    axes.legend(ncols=2)
    axes.set_title(title)
    return figure


@styled()
def sampling_figure(pattern_px: ArrayLike) -> Figure:
    """Draw nine pixels, and the places of the scene at which the frames of a pattern see them.

    Parameters
    ----------
    pattern_px : [frame 2] where the content of each frame lies, (row, col) in LR pixels
    """
    pattern = np.asarray(pattern_px, dtype=np.float64)
    row, col = np.meshgrid(np.arange(3.0), np.arange(3.0), indexing="ij")
    figure = new_figure(8.2, 4.4)
    axes = figure.subplots()
    for number, (row_px, col_px) in enumerate(pattern.tolist()):
        # Content that moves right is seen by pixels that look further left.
        label = f"frame {number}: image at {row_px:+.2f}, {col_px:+.2f} px"
        places = (col - col_px).ravel(), (row - row_px).ravel()
        axes.plot(*places, "o", color=colour_of(number), label=label)
    for edge in np.arange(-0.5, 3.0):
        axes.plot([edge, edge], [-0.5, 2.5], color=GREY, linewidth=0.9)
        axes.plot([-0.5, 2.5], [edge, edge], color=GREY, linewidth=0.9)
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set(xlabel="column (LR px)", ylabel="row (LR px)")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    axes.set_title("Where four frames sample")
    return figure


@styled()
def profiles_figure(
    profiles: Mapping[str, Mapping[str, tuple[ArrayLike, ArrayLike]]], title: str
) -> Figure:
    """Draw line profiles: one panel per channel.

    Parameters
    ----------
    profiles : name of the axis -> label -> (place in LR pixels, values)
    title : above the figure
    """
    figure = new_figure(9.0, 3.8)
    panels = figure.subplots(1, len(profiles), squeeze=False)[0]
    for axes, (name, lines) in zip(panels, profiles.items(), strict=True):
        for number, (label, (place, values)) in enumerate(lines.items()):
            style, colour = ("--", GREY) if label == "truth" else ("-", colour_of(number))
            how: dict[str, Any] = {"marker": ".", "markersize": 5.0, "linewidth": 1.3}
            line = np.asarray(place), np.asarray(values)
            axes.plot(*line, style, color=colour, label=label, **how)
        axes.set(xlabel="column (LR px)", ylabel=name)
        axes.legend()
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
    return figure


@styled()
def gains_figure(rows: Sequence[Mapping[str, Any]], branches: Sequence[str], title: str) -> Figure:
    """Draw the gain of each branch for each strip: mean with interval, and all that one line shows.

    Parameters
    ----------
    rows : contrast, width_px, snr and, by branch, mean, interval, least and most
    branches : names in the rows
    title : above the figure
    """
    figure = new_figure(9.0, 1.6 + 0.34 * len(rows))
    axes = figure.subplots()
    for number, branch in enumerate(branches):
        _draw_gains(axes, rows, branch, number, len(branches))
    names = [f"{row['contrast']:g} : 1, {row['width_px']:g} px, SNR {row['snr']:g}" for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.invert_yaxis()
    axes.axvline(2.0, color=GREY, linewidth=0.9)
    axes.axvline(3.0, color=INK, linewidth=0.9, linestyle="--")
    largest = max(row[branch]["mean"] for row in rows for branch in branches)
    axes.set_xlim(0.0, max(_MOST_GAIN, 1.1 * largest))
    axes.set_xlabel("gradient against one frame (thick: 95 % of the mean; thin: single lines)")
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
    axes.legend(**place, ncols=len(branches), fontsize=SMALL_PT)
    axes.set_title(title)
    return figure


def _draw_gains(
    axes: Axes, rows: Sequence[Mapping[str, Any]], branch: str, number: int, count: int
) -> None:
    colour = colour_of(number)
    for place, row in enumerate(rows):
        gain = row[branch]
        at = place + 0.24 * (number - 0.5 * (count - 1))
        axes.plot([gain["least"], gain["most"]], [at, at], color=colour, linewidth=0.8, alpha=0.6)
        axes.plot(gain["interval"], [at, at], color=colour, linewidth=3.2, alpha=0.6)
        label = branch if place == 0 else None
        axes.plot(gain["mean"], at, "o", color=colour, markersize=4.5, label=label)
