"""Pages of a lens from photographs of a chart: over the field, through focus, edge by edge."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.evaluation.chart import (
    DIRECTIONS,
    ChartEdge,
    Direction,
    FocusFit,
    edge_rows,
    zone_rows,
)
from lensshift.report import images
from lensshift.report.page import Page
from lensshift.report.style import BLUE, GREY, RED, SMALL_PT, WIDTH_IN, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MOST_HIGH_IN = 8.0  # of a screen
_COLOURS = dict(zip(DIRECTIONS, (BLUE, RED), strict=True))
_STYLES: dict[str, str] = dict(zip(DIRECTIONS, ("-", "--"), strict=True))
_MARKERS: dict[str, str] = dict(zip(DIRECTIONS, "os", strict=True))
_WIDE = 2.0  # columns per row: two maps of such images lie above each other
_ROOM = 1.1  # above the highest point
_BINS = 6  # of the image height, for the line through the points
_BAR = 0.03  # half the length of an edge's bar over the diagonal


@styled()
def annotated_figure(image: ArrayLike, edges: Sequence[ChartEdge], unit: str = "") -> Figure:
    """Draw a photograph with what was measured in it: the edges, and MTF50 on each.

    Parameters
    ----------
    edges : of this photograph; grey ones are not usable
    unit : of MTF50, for the title
    """
    picture = images.plain_image(image)
    figure = new_figure(WIDTH_IN, _height_in(picture.shape))
    axes = figure.subplots()
    usable = sum(one.result.usable for one in edges)
    title = f"{usable} usable of {len(edges)} edges, MTF50" + (f" in {unit}" if unit else "")
    images.draw_image(axes, picture, title)
    for one in edges:
        colour = _COLOURS[one.direction] if one.result.usable else GREY
        length_px = max(one.result.residual.shape) if one.result.residual is not None else 20
        col_px, row_px = np.transpose(_bar(one, 0.4 * length_px))
        axes.plot(col_px, row_px, color=colour, linewidth=2.4)
        value = one.result.mtf50_lpmm.value
        axes.text(
            one.col_px, one.row_px, f"{value:.3g}" if np.isfinite(value) else "-",
            color=colour, fontsize=SMALL_PT, ha="center", va="center",
            bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.8},
        )  # fmt: skip
    return figure


@styled()
def field_figure(
    edges: Sequence[ChartEdge], shape: tuple[int, int], unit: str, factor: float = 1.0
) -> Figure:
    """Draw MTF50 where the edges lie: a bar along each edge, its colour the MTF50.

    One map for the sagittal and one for the tangential edges, with the same colours.
    """
    from matplotlib.collections import LineCollection

    rows, cols = shape
    known = [one for one in edges if one.result.usable]
    values = np.array([one.result.mtf50_lpmm.value * factor for one in known])
    low, high = (float(one) for one in np.nanpercentile(values, (0, 100)))
    beside = cols < _WIDE * rows
    high_in = _height_in((rows, 2 * cols) if beside else (2 * rows, cols))
    figure = new_figure(WIDTH_IN, high_in)
    panels = figure.subplots(1 if beside else 2, 2 if beside else 1, squeeze=False).ravel()
    for axes, direction in zip(panels, DIRECTIONS, strict=True):
        here = [k for k, one in enumerate(known) if one.direction == direction]
        bars = [_bar(known[k], _BAR * float(np.hypot(rows, cols))) for k in here]
        shown = LineCollection(bars, linewidths=5.0, cmap="viridis")
        shown.set_array(values[here])
        shown.set_clim(low, high if high > low else low + 1e-6)
        axes.add_collection(shown)
        axes.set(xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5), aspect="equal")
        axes.set(xlabel="col (px)", ylabel="row (px)")
        axes.set_title(f"MTF50 of {direction} lines, {len(here)} edges")
        figure.colorbar(shown, ax=axes, label=unit, fraction=0.03, pad=0.02)
    return figure


@styled()
def height_figure(edges: Sequence[ChartEdge], unit: str, factor: float = 1.0) -> Figure:
    """Draw MTF50 over the image height, sagittal and tangential, with the 95 % intervals."""
    figure = new_figure(WIDTH_IN, 3.4)
    axes = figure.subplots()
    for direction in DIRECTIONS:
        here = [one for one in edges if one.direction == direction and one.result.usable]
        if here:
            _draw_heights(axes, here, direction, factor)
    axes.set(xlim=(0.0, 1.0), xlabel="distance from the middle over half the diagonal")
    axes.set(ylabel=f"MTF50 ({unit})", ylim=(0.0, _ROOM * axes.get_ylim()[1]))
    axes.legend(loc="lower left")
    return figure


@styled()
def focus_figure(
    series: Sequence[dict[str, Any]],
    fits: dict[str, FocusFit],
    unit: str,
    label: str,
    factor: float = 1.0,
) -> Figure:
    """Draw MTF50 of the zones over the position of the focus, and where each is sharpest.

    Parameters
    ----------
    series, fits : of `focus_series`
    unit, factor : of MTF50, and what that of the series is multiplied by
    label : of the focus, with its unit
    """
    figure = new_figure(WIDTH_IN, 3.4)
    axes = figure.subplots()
    colours: dict[str, str] = {}
    for zone in dict.fromkeys(str(row["zone"]) for row in series):
        place, _, direction = zone.rpartition(" ")
        colour = colours.setdefault(place, f"C{len(colours)}")
        here = [(row["focus"], row["mtf50_lpmm"] * factor) for row in series if row["zone"] == zone]
        how: dict[str, Any] = {"color": colour, "marker": _MARKERS[direction], "markersize": 4.5}
        axes.plot(*np.transpose(here), ls=_STYLES[direction], label=zone, **how)
        if zone in fits:
            axes.axvline(fits[zone].focus, color=colour, linewidth=0.9, ls=":")
    axes.set(xlabel=label, ylabel=f"MTF50 ({unit})")
    axes.set_ylim(0.0, _ROOM * axes.get_ylim()[1])
    axes.legend(loc="lower left")
    return figure


def chart_page(
    edges: Sequence[ChartEdge],
    pictures: Sequence[tuple[str, ArrayLike]],
    *,
    unit: str,
    factor: float = 1.0,
    at_lpmm: Sequence[float] = (),
    acutances: dict[str, float] | None = None,
    series: Sequence[dict[str, Any]] = (),
    fits: dict[str, FocusFit] | None = None,
    focus_label: str = "focus",
) -> Page:
    """Return the page of a lens.

    Parameters
    ----------
    edges : of all photographs; the field map shows those of the sharpest one
    pictures : name and image of each photograph
    unit, factor : of the frequencies, and what those of the results are multiplied by
    at_lpmm : frequencies at which the table tells the modulation
    acutances : photograph -> acutance
    series, fits, focus_label : through focus, see `focus_figure`
    """
    page = Page("Resolution of a lens")
    best = sharpest(edges)
    name, picture = next(one for one in pictures if one[0] == best)
    shape = images.plain_image(picture).shape
    here = [one for one in edges if one.image == best]
    usable = sum(one.result.usable for one in edges)
    page.text(
        f"{usable} usable of {len(edges)} edges in {len(pictures)} photographs. "
        f"Maps and summary are of {name}" + (", the sharpest." if len(pictures) > 1 else ".")
    )
    page.heading("Summary")
    page.text(
        "Mean over the places of a zone, with the interval of their scatter. Zones by distance "
        "from the middle over half the diagonal: below 0.3, to 0.7, beyond."
    )
    page.table(_zone_table(here, unit, factor))
    if acutances:
        page.table([{"photograph": one, "acutance": value} for one, value in acutances.items()])
    page.heading("Over the field")
    caption = "A bar along each edge; its colour says how fine the lines across it are resolved."
    page.figure(field_figure(here, shape, unit, factor), caption)
    caption = "Every edge with its 95 % interval, and medians; sagittal lines point to the middle."
    page.figure(height_figure(here, unit, factor), caption)
    if series:
        page.heading("Through focus")
        caption = "MTF50 of the zones in each photograph; dotted: best focus."
        page.figure(focus_figure(series, fits or {}, unit, focus_label, factor), caption)
        page.table(_focus_table(fits or {}, unit, factor))
    page.heading("What was measured")
    caption = f"Edges and MTF50 ({unit}) in {name}; blue: sagittal lines, grey: not used."
    page.figure(annotated_figure(picture, here, unit), caption)
    page.heading("Edges")
    page.table([_short(row) for row in edge_rows(edges, at_lpmm, factor)])
    return page


def sharpest(edges: Sequence[ChartEdge]) -> str:
    """Return the photograph with the largest median MTF50 of its usable edges."""
    by_image: dict[str, list[float]] = {}
    for one in edges:
        if one.result.usable and np.isfinite(one.result.mtf50_lpmm.value):
            by_image.setdefault(one.image, []).append(one.result.mtf50_lpmm.value)
    if not by_image:
        raise ValueError("expected at least one usable edge")
    return max(by_image, key=lambda name: float(np.median(by_image[name])))


def _height_in(shape: tuple[int, ...]) -> float:
    return min(WIDTH_IN * shape[0] / shape[1] + 0.9, _MOST_HIGH_IN)


def _bar(one: ChartEdge, half_px: float) -> list[tuple[float, float]]:
    """Return the ends (col, row) of a bar along an edge."""
    turn = one.result.angle_rad.value
    row, col = np.cos(turn) * half_px, -np.sin(turn) * half_px
    if one.result.orientation == "horizontal":
        row, col = col, row
    return [(one.col_px - col, one.row_px - row), (one.col_px + col, one.row_px + row)]


def _draw_heights(axes: Axes, here: list[ChartEdge], direction: Direction, factor: float) -> None:
    height = np.array([one.field for one in here])
    numbers = [one.result.mtf50_lpmm.scaled(factor) for one in here]
    value = np.array([one.value for one in numbers])
    reach = np.array([[one.value - one.low, one.high - one.value] for one in numbers]).T
    reach = np.where(np.isfinite(reach), np.maximum(reach, 0.0), 0.0)
    colour = _COLOURS[direction]
    how: dict[str, Any] = {"color": colour, "markersize": 3.5, "elinewidth": 0.8, "alpha": 0.55}
    axes.errorbar(height, value, reach, fmt="o", **how)
    middle = [
        (np.median(height[inside]), np.nanmedian(value[inside]))
        for low, high in pairwise(np.linspace(0.0, 1.0, _BINS + 1))
        if (inside := (height >= low) & (height < high)).any()
    ]
    axes.plot(*np.transpose(middle), _STYLES[direction], color=colour, label=direction)


def _zone_table(edges: Sequence[ChartEdge], unit: str, factor: float) -> list[dict[str, Any]]:
    return [
        {"zone": row["zone"], "lines": row["direction"], "edges": row["edges"],
         f"MTF50 ({unit})": str(row["mtf50_lpmm"].scaled(factor)),
         "worst": float(row["worst_mtf50_lpmm"] * factor)}
        for row in zone_rows(edges)
    ]  # fmt: skip


def _focus_table(fits: dict[str, FocusFit], unit: str, factor: float) -> list[dict[str, Any]]:
    return [
        {"zone": zone, "best focus": str(one), f"MTF50 ({unit})": one.mtf50_lpmm * factor}
        for zone, one in fits.items()
    ]


def _short(row: dict[str, Any]) -> dict[str, Any]:
    """Return what of a row fits on a page; files have all of it."""
    shown = {"photograph": row["image"], "row": f"{row['row_px']:.0f}"}
    shown |= {"col": f"{row['col_px']:.0f}", "lines": row["direction"]}
    shown |= {"angle": f"{row['angle_deg']:.1f}"}
    shown["MTF50"] = float(row["mtf50_low"]), float(row["mtf50_high"])
    at = [one for one in row if one.startswith("mtf_at_") and not one.endswith(("_low", "_high"))]
    shown |= {name.replace("_", " "): float(row[name]) for name in at}
    return shown | {"notes": row["notes"] if row["usable"] else f"not used: {row['notes']}"}
