"""Figures of distance images: flying pixels, errors over the image, errors at edges and beside."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.evaluation.depth import depth_error, near_edges
from lensshift.evaluation.surface import flying_pixel_fraction
from lensshift.report import images
from lensshift.report.style import BLUE, INK, RED, WIDTH_IN, new_figure, styled

_LABELS_IN, _HISTOGRAM_IN = 0.9, 2.6  # heights
_WIDE = 2.6  # columns per row from which images lie above each other
_BINS = 61  # odd: one is centred on 0
_SHOWN_PERCENT = 98.0  # of the errors lie on the scale


@styled()
def depth_figure(
    distance_m: ArrayLike,
    truth_m: ArrayLike | None = None,
    *,
    valid: ArrayLike | None = None,
    scale: int = 1,
    edge_width_px: float = 2.0,
    noise_m: float = 0.0,
    min_step_m: float | None = None,
) -> Figure:
    """Draw a distance image with its flying pixels; with the truth also where it is wrong.

    The errors are drawn as a map, with the zone near edges outlined, and as histograms of that
    zone and of the rest.

    Parameters
    ----------
    distance_m, truth_m : [row col] of one shape; NaN is invalid
    valid : [row col], False for pixels left out
    scale, edge_width_px, noise_m, min_step_m : as in `depth_error`

    Raises
    ------
    ValueError
        As in `depth_error` and `flying_pixel_fraction`.
    """
    distance = images.plain_image(distance_m)
    shown = distance if valid is None else np.where(np.asarray(valid, dtype=bool), distance, np.nan)
    edges: dict[str, Any] = {
        "scale": scale, "edge_width_px": edge_width_px, "noise_m": noise_m,
        "min_step_m": min_step_m,
    }  # fmt: skip
    flying = flying_pixel_fraction(distance, truth_m, valid=valid, **edges)
    share = f"{100 * flying.fraction:.1f} % of the pixels at edges fly (crosses)"
    title = share if np.isfinite(flying.fraction) else "no edge was found"
    figure, panels = _panels(distance.shape, with_truth=truth_m is not None)
    drawn = images.draw_image(panels[0], shown, f"distance: {title}", colours="viridis")
    images.add_scale(panels[0], drawn, "distance (m)")
    row_px, col_px = np.nonzero(flying.flying)
    panels[0].plot(col_px, row_px, "x", color=RED, markersize=3.5, markeredgewidth=0.9)
    if truth_m is None:
        return figure
    found = depth_error(distance, truth_m, valid=valid, **edges)
    near = near_edges(truth_m, **edges)
    error_mm = 1e3 * (shown - np.asarray(truth_m, dtype=np.float64))
    known = np.isfinite(error_mm)
    reach_mm = np.percentile(np.abs(error_mm[known]), _SHOWN_PERCENT) if known.any() else 0.0
    reach_mm = float(reach_mm) or 1.0
    title = "measured minus true, edge zone outlined" if near.any() else "measured minus true"
    images.draw_map(panels[1], error_mm, title, "error (mm)", largest=reach_mm)
    images.outline(panels[1], near, INK)
    parts = (
        (error_mm[known & near], RED, f"near edges, RMSE {1e3 * found.edge_rmse_m:.3g} mm"),
        (error_mm[known & ~near], BLUE, f"elsewhere, RMSE {1e3 * found.flat_rmse_m:.3g} mm"),
    )
    _draw_histogram(panels[2], parts, reach_mm)
    panels[2].set_title(f"all: RMSE {1e3 * found.rmse_m:.3g} mm, bias {1e3 * found.bias_m:+.3g} mm")
    return figure


def _panels(shape: tuple[int, ...], *, with_truth: bool) -> tuple[Figure, list[Axes]]:
    rows, cols = shape
    stacked = not with_truth or cols > _WIDE * rows
    each_in = _LABELS_IN + min((0.8 if stacked else 0.38) * WIDTH_IN * rows / cols, 5.0)
    if not with_truth:
        figure = new_figure(WIDTH_IN, each_in)
        return figure, [figure.subplots()]
    images_in = 2 * each_in if stacked else each_in
    figure = new_figure(WIDTH_IN, images_in + _HISTOGRAM_IN)
    heights = (images_in, _HISTOGRAM_IN)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    grid = above.subplots(2, 1) if stacked else above.subplots(1, 2)
    return figure, [*grid, below.subplots()]


def _draw_histogram(
    axes: Axes, parts: tuple[tuple[Floats, str, str], ...], reach_mm: float
) -> None:
    """Draw shares of the pixels; those beyond the scale are counted in the outermost bins."""
    bins = np.linspace(-reach_mm, reach_mm, _BINS + 1)
    for errors_mm, colour, label in parts:
        if errors_mm.size:
            axes.hist(
                np.clip(errors_mm, -reach_mm, reach_mm), bins=bins.tolist(),
                weights=np.full(errors_mm.size, 100.0 / errors_mm.size), histtype="stepfilled",
                facecolor=f"{colour}40", edgecolor=colour, linewidth=1.2,
                label=f"{label}, {errors_mm.size} px",
            )  # fmt: skip
    axes.set(xlim=(-reach_mm, reach_mm), xlabel="error (mm), those beyond in the outermost bins")
    axes.set_ylabel("share of the pixels (%)")
    axes.legend(loc="upper right")
