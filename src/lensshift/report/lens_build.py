"""Figures of lenses as they are built and driven: spread, yield, what matters most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensshift.report.curves import legend_above
from lensshift.report.style import BLUE, GREY, INK, RED, SMALL_PT, new_figure, note, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lensshift.optics.actuator import ActuatorBudget
    from lensshift.optics.tolerance import Sensitivity, ToleranceResult

# A bin of 12 scatters by 30 %; more than 40 bins, or 10 rows of text, are too thin on a page.
_MOST_BINS, _BUILDS_A_BIN, _MOST_ROWS = 40, 12, 10


@styled()
def tolerance_figure(
    found: ToleranceResult, limit: float, *, table: Sequence[Sensitivity] = ()
) -> Figure:
    """Draw how builds of a lens spread: MTF with the yield, errors of the shift, refocus.

    Parameters
    ----------
    found : of many builds
    limit : MTF that a build must keep everywhere
    table : of `sensitivity_table`; its first rows are drawn as bars if given

    Raises
    ------
    ValueError
        If the limit is not from 0 to 1.
    """
    if not 0.0 <= limit <= 1.0:
        raise ValueError(f"expected a limit of the MTF from 0 to 1, got {limit}")
    rows = list(table)[:_MOST_ROWS]
    figure = new_figure(9.0, 5.6 + (0.6 + 0.24 * len(rows) if rows else 0.0))
    heights = (5.6, 0.6 + 0.24 * len(rows)) if rows else (1.0,)
    parts = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    (worst, share), (shift, focus) = parts[0].subplots(2, 2)
    _draw_worst(worst, found, limit)
    _draw_yield(share, found, limit)
    _draw_histogram(shift, found.shift_error_px, "largest error of the shift (px)")
    shift.set_title(f"against the lens as drawn, median {np.median(found.shift_error_px):.4f} px")
    _draw_histogram(focus, found.refocus_mm, "sensor moved away from the lens (mm)")
    focus.set_title(f"refocus, {np.std(found.refocus_mm):.3f} mm rms")
    if rows:
        _draw_table(parts[1].subplots(), rows)
    return figure


@styled()
def budget_figure(budget: ActuatorBudget) -> Figure:
    """Draw what each error of an actuator adds to the error of the shifts, and what they cost."""
    sizes_px = {**budget.parts_px, "all together": budget.shift_error_px}
    figure = new_figure(6.0, 2.8)
    axes = figure.subplots()
    colours = [BLUE] * len(budget.parts_px) + [INK]
    bars = axes.barh(list(sizes_px), list(sizes_px.values()), color=colours, height=0.65)
    axes.bar_label(bars, fmt="%.4f", padding=3.0, fontsize=SMALL_PT, color=GREY)
    axes.margins(x=0.2)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("error of the shift along each axis (px rms)")
    axes.set_title(
        f"element {budget.element + 1}: costs {budget.psnr_loss_db:.2f} dB of PSNR "
        f"and {100 * budget.mtf50_loss:.1f} % of MTF50"
    )
    return figure


def _draw_worst(axes: Axes, found: ToleranceResult, limit: float) -> None:
    nominal = float(found.nominal_mtf.min())
    label = f"least MTF of a build at {found.frequency_lpmm:.3g} LP/mm"
    _draw_histogram(axes, found.worst_mtf, label)
    axes.axvline(limit, color=RED, linewidth=1.4, label=f"limit {limit:g}")
    axes.axvline(nominal, color=INK, linestyle="--", linewidth=1.2, label=f"as drawn {nominal:.3f}")
    title = f"{100 * found.yield_at(limit):.1f} % of {len(found.worst_mtf)} builds keep {limit:g}"
    legend_above(axes, title)


def _draw_yield(axes: Axes, found: ToleranceResult, limit: float) -> None:
    """Draw the share of builds that keep an MTF, over that MTF."""
    ordered = np.sort(found.worst_mtf)
    keep = 100.0 * (1.0 - np.arange(ordered.size) / ordered.size)
    axes.step(ordered, keep, where="pre", color=BLUE)
    axes.axvline(limit, color=RED, linewidth=1.4)
    axes.plot(limit, 100.0 * found.yield_at(limit), "o", color=RED)
    axes.set(ylim=(0.0, 103.0), xlabel="MTF kept everywhere", ylabel="yield (% of builds)")
    low, median, high = found.percentiles()
    axes.set_title(f"5, 50, 95 %: {low:.3f}, {median:.3f}, {high:.3f}")


def _draw_histogram(axes: Axes, values: NDArray[np.float64], label: str) -> None:
    bins = int(np.clip(values.size // _BUILDS_A_BIN, 5, _MOST_BINS))
    axes.hist(values, bins=bins, color=BLUE, alpha=0.75, edgecolor="white", linewidth=0.4)
    axes.locator_params(axis="x", nbins=5)
    axes.set(xlabel=label, ylabel="builds")


def _draw_table(axes: Axes, rows: Sequence[Sensitivity]) -> None:
    names = [f"{row.kind}, {row.element + 1} {row.name}" for row in rows]
    axes.barh(range(len(rows)), [row.mtf_loss for row in rows], color=BLUE, height=0.65)
    axes.set_yticks(range(len(rows)), names)
    for place, row in enumerate(rows):
        text = f"{row.mtf_loss:.3g}, shift {row.shift_error_px:.2g} px"
        at = (max(row.mtf_loss, 0.0), place)
        note(axes, text, at, (3.0, 0.0), va="center", color=GREY, path_effects=None)
    axes.margins(x=0.25)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("loss of the least MTF, each tolerance at its limit alone")
