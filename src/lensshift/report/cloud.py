"""Points in space, seen from beside the camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lensshift.core.point_cloud import PointCloud
from lensshift.report.preview import OUTSIDE
from lensshift.report.style import new_figure, styled

_MOST_POINTS = 60_000  # more cover each other
_SIDE_IN = 6.4  # wide
_POINTS_PT2 = 1.6e5  # area of all points together: twice that of the drawing
_TICKS = 5  # on the longest side
_THINNEST = 0.25  # of the longest side: room for the numbers along it
_ABOVE_DEG, _BESIDE_DEG = 22.0, -62.0  # of the eye


@styled()
def cloud_figure(cloud: PointCloud, title: str = "") -> Figure:
    """Draw points from above and beside the camera, with equal metres on all axes.

    The colour is the amplitude, or the distance where there is none.

    Raises
    ------
    ValueError
        If there is no point.
    """
    if not len(cloud):
        raise ValueError("expected at least one point, got none")
    right, down, forward = cloud.point_m.T
    place_m = np.stack([right, forward, -down])
    # All points but those far from most.
    low_m, high_m = np.percentile(place_m, OUTSIDE, axis=1)
    far_m = np.max(high_m - low_m)
    low_m = np.maximum(low_m - far_m, place_m.min(axis=1))
    high_m = np.minimum(high_m + far_m, place_m.max(axis=1))
    inside = np.all((place_m >= low_m[:, None]) & (place_m <= high_m[:, None]), axis=0)
    shown = np.flatnonzero(inside)
    if len(shown) > _MOST_POINTS:  # every other one of a grid would make stripes
        shown = np.random.default_rng(0).choice(shown, _MOST_POINTS, replace=False)
    label, colour = "distance (m)", np.linalg.norm(cloud.point_m, axis=1)
    if cloud.amplitude is not None:
        label, colour = "amplitude", cloud.amplitude
    darkest, brightest = np.percentile(colour[shown], OUTSIDE)
    figure = new_figure(_SIDE_IN, 0.75 * _SIDE_IN)
    axes: Any = figure.add_subplot(projection="3d")
    drawn = axes.scatter(
        *place_m[:, shown], c=colour[shown], s=np.clip(_POINTS_PT2 / len(shown), 0.3, 8.0),
        cmap="viridis", vmin=darkest, vmax=brightest if brightest > darkest else darkest + 1.0,
        linewidths=0, depthshade=False, rasterized=True,
    )  # fmt: skip
    _lay_out(axes, low_m, high_m)
    axes.set_title(title)
    figure.colorbar(drawn, ax=axes, shrink=0.6, aspect=24, pad=0.12, label=label)
    return figure


def _lay_out(axes: Any, low_m: NDArray[np.float64], high_m: NDArray[np.float64]) -> None:
    """Give all axes the same scale, and none so short that its numbers lie on each other."""
    span_m = np.maximum(high_m - low_m, 1e-3)
    span_m = np.maximum(span_m, _THINNEST * span_m.max())
    middle_m = 0.5 * (low_m + high_m)
    for name, middle, span, label in zip(
        "xyz", middle_m, span_m, ("right (m)", "forward (m)", "up (m)"), strict=True
    ):
        getattr(axes, f"set_{name}lim")(middle - 0.5 * span, middle + 0.5 * span)
        getattr(axes, f"set_{name}label")(label, labelpad=8.0)
        ticks = max(1, round(_TICKS * span / span_m.max()))
        axes.locator_params(axis=name, nbins=ticks, min_n_ticks=1)
    axes.set_box_aspect(span_m, zoom=0.8)
    axes.view_init(elev=_ABOVE_DEG, azim=_BESIDE_DEG)


@styled()
def drawn_pixels(figure: Figure) -> NDArray[np.uint8]:
    """Return a figure as the colours [row col 3] of its pixels, without the white around it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    row, col = (np.flatnonzero((pixels < 255).any(axis=(axis, 2))) for axis in (1, 0))
    return pixels[row[0] : row[-1] + 1, col[0] : col[-1] + 1].copy()
