"""Figures that gallery scripts leave in their variables, which no pyplot knows of."""

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

_DPI = 110


def scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save each new figure among the variables of the script; return the text that shows them."""
    taken = block_vars.setdefault("drawn_figures", set())
    paths = []
    for value in list(block_vars["example_globals"].values()):
        if isinstance(value, Figure) and id(value) not in taken:
            taken.add(id(value))
            path = next(block_vars["image_path_iterator"])
            value.savefig(path, format="png", dpi=_DPI)
            paths.append(path)
    return str(figure_rst(paths, gallery_conf["src_dir"]))
