"""One quiet style for all figures: colours for every kind of eye, nothing of the user's changed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

# Okabe and Ito's colours, which stay apart for colour-blind eyes and in grey.
BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#E69F00", "#009E73", "#CC79A7"
SKY, RED = "#56B4E9", "#D55E00"
COLOURS = (BLUE, RED, GREEN, ORANGE, SKY, PURPLE)
INK, GREY, LIGHT, FAINT = "#222222", "#6E6E6E", "#A8A8A8", "#E2E2E2"
WIDTH_IN = 9.0  # of a page
SMALL_PT, TITLE_PT = 8.0, 9.5  # as in print
BAND_ALPHA = 0.22  # two bands and what lies below stay visible

# Settings of the user that would show in a figure; they are put back to the defaults first.
_FAMILIES = (
    "axes.", "errorbar.", "figure.", "font.", "grid.", "hatch.", "hist.", "image.", "legend.",
    "lines.", "markers.", "mathtext.", "patch.", "path.", "pdf.", "savefig.", "scatter.", "svg.",
    "text.", "xtick.", "ytick.",
)  # fmt: skip
_STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": TITLE_PT,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.formatter.useoffset": False,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": True,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "legend.fontsize": SMALL_PT,
    "legend.borderpad": 0.2,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": SMALL_PT,
    "ytick.labelsize": SMALL_PT,
    "text.color": INK,
    "image.interpolation": "nearest",
    "image.cmap": "gray",
    "savefig.dpi": 150.0,
    "svg.hashsalt": "lensshift",  # the same figure gives the same file
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in this style, whatever the user has set; the user's settings come back afterwards."""
    settings: dict[Any, Any] = {
        name: value for name, value in mpl.rcParamsDefault.items() if name.startswith(_FAMILIES)
    }
    with mpl.rc_context(settings | _STYLE):
        yield


def new_figure(wide_in: float, high_in: float) -> Figure:
    """Return an empty figure, of so many inches, that finds room for its labels by itself."""
    return Figure(figsize=(wide_in, high_in), layout="constrained")


def colour_of(number: int) -> str:
    """Return the colour of the curve with this number."""
    return COLOURS[number % len(COLOURS)]


def outlined(line_pt: float) -> list[withStroke]:
    """Return effects that keep a line so many points wide, or a text, visible on any image."""
    return [withStroke(linewidth=line_pt + 1.8, foreground="white", alpha=0.8)]


def note(
    axes: Axes, text: str, at: tuple[float, float], away_pt: tuple[float, float], **how: Any
) -> None:
    """Write small words so many points away from `at`, visible on any image.

    Parameters
    ----------
    how : what `Axes.annotate` takes besides
    """
    usual: dict[str, Any] = {"fontsize": SMALL_PT, "path_effects": outlined(1.0)}
    axes.annotate(text, at, xytext=away_pt, textcoords="offset points", **(usual | how))


def round_number(value: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))
