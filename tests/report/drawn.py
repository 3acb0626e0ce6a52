"""What the tests of figures look for in them."""

from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image


def axes_titled(figure: Figure, start: str) -> Axes:
    """Return the axes whose title, or title of the legend, begins with these words."""
    for axes in figure.axes:
        legend = axes.get_legend()
        titles = [axes.get_title(loc="left"), legend.get_title().get_text() if legend else ""]
        if any(title.startswith(start) for title in titles):
            return axes
    raise AssertionError(f"no axes titled {start!r}")


def bands(axes: Axes) -> list[PolyCollection]:
    """Return the areas between two curves."""
    return [one for one in axes.collections if isinstance(one, PolyCollection)]


def line_labelled(axes: Axes, start: str) -> NDArray[np.float64]:
    """Return [2 n], x and y of the line whose label begins with these words."""
    for line in axes.get_lines():
        if str(line.get_label()).startswith(start):
            return np.array(line.get_data(), dtype=np.float64)
    raise AssertionError(f"no line labelled {start!r}")


def assert_well_drawn(figure: Figure) -> None:
    """Check that a figure is not blank, names its numbers, and that no text is cut off."""
    memory = BytesIO()
    figure.savefig(memory, format="png", dpi=figure.dpi)
    pixels = np.asarray(Image.open(memory).convert("RGB"))
    assert np.mean(np.any(pixels < 250, axis=-1)) > 0.02
    width, height = figure.bbox.x1, figure.bbox.y1
    for axes in (axes for axes in figure.axes if axes.axison):
        _assert_numbers_are_named(axes)
        labels = [axes.xaxis.label, axes.yaxis.label, axes._left_title]
        for text in (text for text in [*axes.texts, *labels] if text.get_text()):
            box = text.get_window_extent()
            inside = -1 < box.x0 < box.x1 < width + 1 and -1 < box.y0 < box.y1 < height + 1
            assert inside or not text.get_visible(), text.get_text()
        _assert_texts_are_apart(axes)


def _assert_texts_are_apart(axes: Axes) -> None:
    legend = axes.get_legend()
    texts = [*axes.texts, axes._left_title, *(legend.get_texts() if legend else ())]
    shown = [text for text in texts if text.get_text() and text.get_visible()]
    boxes = [Text.get_window_extent(text) for text in shown]  # of a note without its arrow
    for number, box in enumerate(boxes):
        for other, behind in zip(boxes[number + 1 :], shown[number + 1 :], strict=True):
            assert not box.padded(-1.0).overlaps(other), (shown[number].get_text(), behind)


def _assert_numbers_are_named(axes: Axes) -> None:
    for axis in (axes.xaxis, axes.yaxis):
        texts = [text.get_text() for text in axis.get_ticklabels() if text.get_visible()]
        numbers = [text for text in texts if not any(letter.isalpha() for letter in text)]
        if axis.get_visible() and numbers == texts != []:
            assert axis.get_label_text(), f"no label beside {texts}"
