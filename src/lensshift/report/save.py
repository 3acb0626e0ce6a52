"""Write figures that appear whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lensshift.core.atomic import writable_target, written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENDINGS = (".png", ".svg", ".pdf")

# A date in the file would make each run differ.
_WITHOUT_DATE = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def check_ending(path: str | Path) -> None:
    """Complain before the work about a name that no figure can be written to.

    Raises
    ------
    ValueError
        If the ending is none of .png, .svg and .pdf.
    DataError
        If the file cannot be written.
    """
    if Path(path).suffix.lower() not in ENDINGS:
        raise ValueError(f"expected a figure that ends in {', '.join(ENDINGS)}, got {path}")
    writable_target(path)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, SVG or PDF, by the ending of the name.

    The file appears whole or not at all, and the same figure gives the same file.

    Raises
    ------
    ValueError, DataError
        As in `check_ending`.
    """
    from lensshift.report.style import styled

    check_ending(path)
    ending = Path(path).suffix.lower()
    with written_whole(path) as part, styled():
        for _ in range(2 * any(axes.child_axes for axes in figure.axes)):
            figure.draw_without_rendering()  # scales beside images find their room in three passes
        figure.savefig(part, format=ending[1:], metadata=_WITHOUT_DATE[ending])
