"""Previews of results: as a figure where matplotlib is installed, else as plain images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.atomic import written_whole

Shots = Mapping[str, Mapping[str, NDArray[Any]]]

_WIDE_PX, _LINE_PX, _GAP_PX = 520, 16, 6  # of an image, a line of text, between them
OUTSIDE = (0.5, 99.5)  # percentiles: stray pixels shall not set a scale
_UNITS = {"amplitude": "", "distance": " m"}
_INK, _PAPER = (34, 34, 34), (255, 255, 255)  # as in `style`
# Matplotlib's viridis (CC0) at places equally far apart.
_VIRIDIS = np.array(
    [
        [68, 1, 84], [72, 31, 112], [68, 57, 131], [59, 82, 139], [49, 104, 142], [40, 124, 142],
        [33, 145, 140], [32, 164, 134], [53, 183, 121], [94, 201, 98], [144, 215, 67],
        [200, 224, 32], [253, 231, 37],
    ],
    np.float64,
)  # fmt: skip


def save_shots(shown: Shots, title: str, path: str | Path) -> None:
    """Write images of one scene on one scale per channel, the last of which sets the scales.

    Parameters
    ----------
    shown : label -> channel ("amplitude", "distance") -> [row col]
    title : above all
    path : a PNG

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    try:
        from lensshift.report.shots import shots_figure
    except ImportError:
        _save_plain(shown, title, path)
        return
    from lensshift.report.save import save_figure

    save_figure(shots_figure(shown, title), path)


def _save_plain(shown: Shots, title: str, path: str | Path) -> None:
    """Write the images below each other, channels side by side, with a line of text over each."""
    from PIL import Image, ImageDraw

    channels = [name for name in _UNITS if any(name in images for images in shown.values())]
    limits = {name: channel_range(shown, name) for name in channels}
    rows, cols = next(iter(shown.values()))[channels[0]].shape
    high_px = max(1, round(_WIDE_PX * rows / cols))

    def corner_px(number: int, place: int) -> tuple[int, int]:
        down_px = _LINE_PX + 2 * _GAP_PX + number * (high_px + _LINE_PX + _GAP_PX)
        return _GAP_PX + place * (_WIDE_PX + _GAP_PX), down_px

    page = Image.new("RGB", corner_px(len(shown), len(channels)), _PAPER)
    pen = ImageDraw.Draw(page)
    pen.text((_GAP_PX, _GAP_PX), title, fill=_INK)
    for number, (label, images) in enumerate(shown.items()):
        for place, name in enumerate(channels):
            if name not in images:
                continue
            (left, top), (low, high) = corner_px(number, place), limits[name]
            text = f"{label}: {name}, {low:.3g} to {high:.3g}{_UNITS[name]}"
            pen.text((left, top), text, fill=_INK)
            picture = Image.fromarray(_coloured(np.abs(images[name]), low, high, name))
            picture = picture.resize((_WIDE_PX, high_px), Image.Resampling.NEAREST)
            page.paste(picture, (left, top + _LINE_PX))
    with written_whole(path) as part:
        page.save(part, format="PNG")


def shown_range(image: NDArray[Any]) -> tuple[float, float]:
    """Return the values that a scale begins and ends with; 0 and 1 where nothing is finite."""
    finite = image[np.isfinite(image)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, OUTSIDE).tolist()
    return low, high if high > low else low + 1.0


def channel_range(shown: Shots, channel: str) -> tuple[float, float]:
    """Return the scale of a channel, which the last image that has it sets."""
    known = [images[channel] for images in shown.values() if channel in images]
    return shown_range(np.abs(known[-1]))


def _coloured(image: NDArray[Any], low: float, high: float, channel: str) -> NDArray[np.uint8]:
    level = (np.nan_to_num(image, nan=low) - low) / (high - low)
    share: NDArray[np.float64] = np.clip(level, 0.0, 1.0)
    if channel == "amplitude":
        parts = [255 * share] * 3
    else:
        places = np.linspace(0.0, 1.0, len(_VIRIDIS))
        parts = [np.interp(share, places, _VIRIDIS[:, k]) for k in range(3)]
    return np.asarray(np.rint(np.stack(parts, axis=-1)), np.uint8)
