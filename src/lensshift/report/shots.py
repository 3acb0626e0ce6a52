"""Images of one scene below each other, amplitude beside distance."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lensshift.io.picture_layers import COLOURS
from lensshift.report.preview import Shots, channel_range
from lensshift.report.style import SMALL_PT, new_figure, styled

_PAD_IN = 0.1  # between the images and the bar
_UNITS = {"amplitude": "amplitude", "distance": "distance (m)"}


@styled()
def shots_figure(shown: Shots, title: str = "", *, wide_in: float = 11.0) -> Figure:
    """Draw images of one scene on one scale per channel.

    Parameters
    ----------
    shown : label -> channel ("amplitude", "distance") -> [row col]; the last sets the scales
    title : above all
    wide_in : width of the figure

    Raises
    ------
    ValueError
        If there is no image.
    """
    channels = [name for name in _UNITS if any(name in images for images in shown.values())]
    if not channels:
        raise ValueError("expected at least one image, got none")
    rows, cols = next(iter(next(iter(shown.values())).values())).shape
    beside = rows > cols  # tall images stand side by side
    count = (len(channels), len(shown)) if beside else (len(shown), len(channels))
    side_in = wide_in / count[1]
    figure = new_figure(wide_in, count[0] * (side_in * rows / cols + 0.3) + 0.7)
    panels = figure.subplots(*count, squeeze=False)
    panels = panels.T if beside else panels
    for number, channel in enumerate(channels):
        low, high = channel_range(shown, channel)
        drawn = None
        for axes, (label, images) in zip(panels[:, number], shown.items(), strict=True):
            axes.set_axis_off()
            if channel not in images:
                continue
            drawn = axes.imshow(np.abs(images[channel]), cmap=COLOURS[channel], vmin=low, vmax=high)
            axes.set_title(label, fontsize=SMALL_PT)
        if drawn is not None:
            where, column = "right" if beside else "bottom", list(panels[:, number])
            pad = _PAD_IN / figure.get_size_inches()[0 if beside else 1]  # else of the whole height
            how: dict[str, Any] = {"location": where, "shrink": 0.6, "aspect": 40, "pad": pad}
            bar = figure.colorbar(drawn, ax=column, **how)
            bar.set_label(_UNITS[channel])
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
    return figure
