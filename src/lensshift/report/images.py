"""Images and maps with pixel axes, regions drawn on them and scales beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats
from lensshift.report.preview import shown_range
from lensshift.report.style import INK

_WITHOUT_VALUE = "#EADCC2"


def draw_image(
    axes: Axes,
    values: ArrayLike,
    title: str,
    *,
    colours: str = "gray",
    corner_px: tuple[int, int] = (0, 0),
) -> AxesImage:
    """Draw an image from its 0.5th to its 99.5th percentile; pixel centres lie at integers.

    Parameters
    ----------
    values : [row col]; NaN is shaded
    title : above it
    colours : name of the colour map
    corner_px : row and column of the first pixel

    Raises
    ------
    ValueError
        If the values are no image.
    """
    return _draw(axes, plain_image(values), title, corner_px, colours)


def draw_map(
    axes: Axes,
    values: ArrayLike,
    title: str,
    label: str,
    *,
    largest: float,
    corner_px: tuple[int, int] = (0, 0),
) -> AxesImage:
    """Draw signed values, white at 0, with a scale that is the same on both sides.

    Parameters
    ----------
    values : [row col]; NaN is shaded
    title, label : above it, and of the scale with its unit
    largest : where the scale ends; values beyond it are told by arrows
    corner_px : row and column of the first pixel
    """
    shown = _draw(axes, plain_image(values), title, corner_px, "RdBu_r")
    shown.set_clim(-largest, largest)
    add_scale(axes, shown, label)
    return shown


def add_scale(axes: Axes, shown: AxesImage, label: str) -> None:
    """Put a colour scale of the image's own height beside it."""
    low, high = shown.get_clim()
    values: Floats = np.ma.compressed(np.ma.asarray(shown.get_array()))
    under, over = bool(np.any(values < low)), bool(np.any(values > high))
    extend = ("neither", "min", "max", "both")[under + 2 * over]
    rows, cols = shown.get_size()
    place = axes.inset_axes((1.02, 0.0, max(0.02, min(0.05, 0.05 * rows / cols)), 1.0))
    figure = axes.get_figure(root=True)
    if figure is not None:
        figure.colorbar(shown, cax=place, extend=extend, label=label)
    place.grid(visible=False)


def outline(axes: Axes, mask: NDArray[np.bool_], colour: str) -> None:
    """Draw a line along the borders between pixels inside and outside a mask [row col]."""
    inside = np.pad(mask, 1).astype(np.int8)
    upright, level = (np.argwhere(np.diff(inside, axis=axis)) for axis in (1, 0))
    lines = [((c - 0.5, r - 1.5), (c - 0.5, r - 0.5)) for r, c in upright]
    lines += [((c - 1.5, r - 0.5), (c - 0.5, r - 0.5)) for r, c in level]
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.8), autolim=False)


def pixel_outline(pixel_um: Floats, **how: Any) -> Rectangle:
    """Return the border of a pixel of sides (row, col) about the origin."""
    row_um, col_um = pixel_um
    return Rectangle((-0.5 * col_um, -0.5 * row_um), col_um, row_um, fill=False, **how)


def plain_image(values: ArrayLike) -> Floats:
    """Return the values as floats [row col]; `ValueError` if they are no image."""
    image = np.asarray(values, dtype=np.float64)
    if image.ndim != 2 or image.size == 0:
        raise ValueError(f"expected an image [row col], got shape {image.shape}")
    return image


def _draw(
    axes: Axes, image: Floats, title: str, corner_px: tuple[int, int], colours: str
) -> AxesImage:
    (rows, cols), (low, high) = image.shape, shown_range(image)
    top, left = corner_px[0] - 0.5, corner_px[1] - 0.5
    shown = axes.imshow(
        np.ma.masked_invalid(image), cmap=colours, vmin=low, vmax=high,
        extent=(left, left + cols, top + rows, top), interpolation="nearest",
    )  # fmt: skip
    axes.set_facecolor(_WITHOUT_VALUE)
    axes.grid(visible=False)
    axes.set_title(title)
    axes.set_xlabel("column (px)" if np.all(np.isfinite(image)) else "column (px); tan: no value")
    axes.set_ylabel("row (px)")
    axes.locator_params(integer=True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
        axes.spines[side].set_color(INK)
    return shown
