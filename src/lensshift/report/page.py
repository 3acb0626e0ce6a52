"""One self-contained HTML page: text, tables and figures in a single file."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensshift.core.atomic import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PAGE_DPI = 110  # a figure of 9 in fills the width of a page of 62 rem
_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.7rem; } h2 { margin-top: 2.4rem; border-bottom: 1px solid #ddd; }
p { max-width: 46rem; } figure { margin: 1.2rem 0; } img { max-width: 100%; height: auto; }
figcaption { color: #555; font-size: .9rem; max-width: 46rem; }
table { border-collapse: collapse; font-size: .92rem; } .wide { overflow-x: auto;
  margin: 1rem 0; }
th, td { text-align: left; padding: .3rem .8rem .3rem 0; border-bottom: 1px solid #eee;
  vertical-align: top; } td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
.confirmed, .qualified, .refuted { font-weight: 600; white-space: nowrap; }
@media (max-width: 600px) {
  body { margin: 1rem auto; overflow-wrap: anywhere; } h1 { font-size: 1.35rem; }
  figure { overflow-x: auto; } img { max-width: none; width: 44rem; }
  figcaption { max-width: 90vw; }
  table, tbody { display: block; } tr:first-child { display: none; }
  tr { display: block; padding: .5rem 0; border-bottom: 1px solid #ccc; }
  td { display: flex; gap: .6rem; border: 0; padding: .1rem 0; }
  td::before { content: attr(data-label); flex: 0 0 7.5rem; color: #777; } td.number
    { white-space: normal; }
}
.confirmed { color: #00694d; } .qualified { color: #8a5a00; } .refuted { color: #a33c00; }
"""


class Page:
    """A page that grows from top to bottom.

    Parameters
    ----------
    title : of the page
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts: list[str] = [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str) -> None:
        """Add a paragraph, unless it is empty."""
        if text:
            self._parts.append(f"<p>{html.escape(text)}</p>")

    def figure(self, figure: Figure, caption: str) -> None:
        """Add a figure as a picture in the page."""
        from lensshift.report.style import styled

        with styled():
            picture = embedded(figure, caption, _PAGE_DPI)
        words = html.escape(caption)
        self._parts.append(f"<figure>{picture}<figcaption>{words}</figcaption></figure>")

    def table(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add a table; the keys of the first row are its header."""
        if not rows:
            return
        head = "".join(f"<th>{html.escape(str(name))}</th>" for name in rows[0])
        body = "".join(f"<tr>{''.join(_cell(*cell) for cell in row.items())}</tr>" for row in rows)
        self._parts.append(f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>')

    def html(self) -> str:
        """Return the page."""
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width">'
            f"<title>{html.escape(self._title)}</title><style>{_STYLE}</style></head>"
            f"<body>\n{chr(10).join(self._parts)}\n</body></html>\n"
        )

    def save(self, path: str | Path) -> None:
        """Write the page whole or not at all.

        Raises
        ------
        DataError
            If the file cannot be written.
        """
        write_text(path, self.html())


def embedded(figure: Figure, words: str, dpi: int) -> str:
    """Return a figure as a picture in HTML that needs no other file."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=dpi)
    data = base64.b64encode(picture.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(words)}" src="data:image/png;base64,{data}">'


def _cell(name: str, value: Any) -> str:
    label = f'data-label="{html.escape(str(name))}"'
    if isinstance(value, float):
        text = "-" if not math.isfinite(value) else f"{value + 0.0:.3g}"
        return f'<td class="number" {label}>{text}</td>'
    if isinstance(value, tuple | list) and all(isinstance(one, float) for one in value):
        text = " to ".join(f"{one:.3g}" for one in value)
        if len(value) == 2 and value[1] == math.inf:
            text = f"{value[0]:.3g} or more"
        return f'<td class="number" {label}>{text}</td>'
    if value in ("confirmed", "qualified", "refuted"):
        return f'<td class="{value}" {label}>{value}</td>'
    return f"<td {label}>{html.escape(str(value))}</td>"
