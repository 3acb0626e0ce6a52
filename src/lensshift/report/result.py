"""A result as one picture: each channel, how sure it is, what the frames say, its points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lensshift.core.point_cloud import PointCloud
from lensshift.core.types import Estimate, Reconstruction
from lensshift.io.picture_layers import COLOURS
from lensshift.report.preview import OUTSIDE, shown_range
from lensshift.report.style import SMALL_PT, new_figure, styled

_MOST_POINTS = 60_000  # more cover each other
_SIDE_IN = 6.4  # wide
_POINTS_PT2 = 1.6e5  # area of all points together: twice that of the drawing
_TICKS = 5  # on the longest side
_THINNEST = 0.25  # of the longest side: room for the numbers along it
_ABOVE_DEG, _BESIDE_DEG = 22.0, -62.0  # of the eye
_UNITS = {"amplitude": "", "distance": " (m)"}
_MOST_MISFIT = 10.0  # ten times the variance that was expected
_TITLE_IN, _CLOUD_IN, _PAGE_IN = 0.32, 6.0, 9.0  # heights
_KINDS = ("image", "reference", "std", "misfit")  # of panels, in the order that they are shown


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


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    label: str
    image: NDArray[Any]
    colours: str
    scale: Normalize
    measured: str


@styled()
def result_figure(
    result: Reconstruction,
    reference: Mapping[str, NDArray[Any]] | None = None,
    *,
    title: str = "",
    cloud: PointCloud | None = None,
    wide_in: float = 11.0,
) -> Figure:
    """Draw each channel of a result, its standard deviation and the misfit of the frames.

    Parameters
    ----------
    result : what to draw; complex pictures by their modulus
    reference : channel -> [row col], to compare with on the same scale, such as a bicubic
    title : above all
    cloud : its points, drawn below
    wide_in : width of the figure
    """
    lists = [_panels(name, one, reference) for name, one in result.channels.items()]
    if not lists:
        raise ValueError("expected a channel to draw, this result has none")
    lists[0] |= _misfit(result)
    kinds = [kind for kind in _KINDS if any(kind in panels for panels in lists)]
    rows, cols = result.grid.shape
    beside = 2 * rows > cols  # else wide images, below each other
    most = len(kinds)
    down, across = (len(lists), most) if beside else (most, len(lists))
    if beside and len(lists) == 1 and most > 2 and rows < 2 * cols:  # large enough to see something
        down, across = -(-most // 2), 2
    high_in = down * _panel_in(wide_in / across, rows / cols)
    below = None if cloud is None else drawn_pixels(cloud_figure(cloud))
    heights_in = [high_in]
    if below is not None:
        heights_in.append(_CLOUD_IN * below.shape[0] / below.shape[1] + _TITLE_IN)
    figure = new_figure(wide_in, sum(heights_in) + 0.4)
    parts: Any = figure.subfigures(len(heights_in), 1, squeeze=False, height_ratios=heights_in)
    axes = parts[0, 0].subplots(down, across, squeeze=False)
    for spare in axes.flat:
        spare.set_axis_off()
    for number, panels in enumerate(lists):
        for kind, panel in panels.items():  # one kind below or beside the other, gaps or none
            place = kinds.index(kind)
            at = divmod(number * most + place, across) if beside else (place, number)
            _draw(axes[at], panel)
    if cloud is not None:
        one = parts[1, 0].subplots()
        one.imshow(below, interpolation="antialiased")
        said = f"{len(cloud)} points, those between surfaces left out"
        one.set_title(said, fontsize=SMALL_PT)
        one.set_axis_off()
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
    return figure


@styled()
def estimate_figure(estimate: Estimate, *, wide_in: float = 11.0) -> Figure:
    """Draw one channel and its standard deviation below each other or side by side."""
    panels = list(_panels("image", estimate, None).values())
    rows, cols = estimate.image.shape
    across = len(panels) if 2 * rows > cols else 1
    high_in = _panel_in(wide_in / across, rows / cols)
    figure = new_figure(wide_in, high_in * len(panels) / across + 0.2)
    places = figure.subplots(len(panels) // across, across, squeeze=False).flat
    for axes, panel in zip(places, panels, strict=True):
        axes.set_axis_off()
        _draw(axes, panel)
    return figure


def _panel_in(wide_in: float, high_to_wide: float) -> float:
    """Return the height of a panel of this width; that of a tall image is as high as a page."""
    return min(wide_in * high_to_wide * 0.85, _PAGE_IN) + _TITLE_IN


def _panels(
    name: str, estimate: Estimate, reference: Mapping[str, NDArray[Any]] | None
) -> dict[str, _Panel]:
    unit, colours = _UNITS.get(name, ""), COLOURS.get(name, "gray")
    image = np.abs(estimate.image) if np.iscomplexobj(estimate.image) else estimate.image
    scale, measured = Normalize(*shown_range(image)), name + unit
    found = {"image": _Panel(name, image, colours, scale, measured)}
    if reference is not None and name in reference:
        other = reference[name]
        other = np.abs(other) if np.iscomplexobj(other) else other
        label = f"{name}, one frame, bicubic"
        found["reference"] = _Panel(label, other, colours, scale, measured)
    if estimate.std is not None:
        std, label = np.asarray(estimate.std), f"standard deviation of {name}"
        zero_to_most = Normalize(0.0, shown_range(std)[1])
        found["std"] = _Panel(label, std, "magma", zero_to_most, f"std{unit}")
    return found


def _misfit(result: Reconstruction) -> dict[str, _Panel]:
    """Return the misfit of the frames, which phasors have in common, or none."""
    known = [one.misfit for one in result.channels.values() if one.misfit is not None]
    if not known:
        return {}
    clipped, scale = np.clip(known[0], 1.0, _MOST_MISFIT), LogNorm(1.0, _MOST_MISFIT)
    return {"misfit": _Panel("misfit, 1: noise alone", clipped, "gray", scale, "chi-square")}


def _draw(axes: Any, panel: _Panel) -> None:
    drawn = axes.imshow(panel.image, cmap=panel.colours, norm=panel.scale)
    axes.set_title(panel.label, fontsize=SMALL_PT)
    bar = axes.figure.colorbar(drawn, ax=axes, fraction=0.04, pad=0.01, aspect=14)
    if isinstance(panel.scale, LogNorm):
        bar.set_ticks([1, 2, 5, 10], labels=["1", "2", "5", "10"])
        bar.minorticks_off()
    else:
        bar.locator = MaxNLocator(4)
        bar.update_ticks()
    bar.set_label(panel.measured, fontsize=SMALL_PT)
