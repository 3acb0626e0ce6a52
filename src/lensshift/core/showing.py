"""How values show themselves: one screen of text; pictures and tables from the layers above.

Nothing here draws. What does is looked up by name when it is asked for, as the names of the
package are, so that the core needs no figure and no table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from lensshift.core.errors import of_extra
from lensshift.core.grid import Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

_ABOVE = "lensshift.report.notebook"
_MOST_CHARACTERS = 76  # of a line on a terminal of 80


class Shown:
    """A frozen dataclass that fits on a screen, with a picture where pictures can be shown."""

    __slots__ = ()

    def __repr__(self) -> str:
        known = described(self)
        width = max(map(len, known), default=0)
        lines = [f"  {name:<{width}}  {text}" for name, text in known.items()]
        return "\n".join([type(self).__name__, *lines])

    def _repr_html_(self) -> str:
        return str(_above("page_of")(self))

    def plot(self) -> Figure:
        """Return a matplotlib figure of this value; `figure.savefig` writes it.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        """
        of_extra("matplotlib", "plot needs matplotlib: pip install 'lensshift[plot]'")
        figure: Figure = _above("figure_of")(self)
        return figure


class AsDataset:
    """What has images: as xarray has them."""

    __slots__ = ()

    def to_xarray(self) -> Dataset:
        """Return the `xarray.Dataset` that `xarray.open_dataset` reads from its file.

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        dataset: Dataset = _above("dataset_of")(self)
        return dataset


class AsTable:
    """What has numbers: as pandas has them."""

    __slots__ = ()

    def to_pandas(self) -> DataFrame:
        """Return its numbers as a `pandas.DataFrame`.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        table: DataFrame = _above("table_of")(self)
        return table


def described(value: Any) -> dict[str, str]:
    """Return what the fields of a dataclass hold, one line each; empty ones are left out."""
    found = {one.name: brief(getattr(value, one.name)) for one in fields(value)}
    grid = getattr(value, "grid", None)
    if isinstance(grid, Grid) and not grid.tells_pitch(getattr(value, "scale", 1)):
        found["grid"] = f"shape {brief(grid.shape)}, pitch not told"
    return {name: text for name, text in found.items() if text}


def brief(value: Any) -> str:
    """Return a value on one line, "" if there is none."""
    if value is None or callable(value) or (isinstance(value, float) and np.isnan(value)):
        return ""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, Shown):  # one line of it: its first array, and how it ended
        text = next(iter(described(value).values()), "")
        ending = getattr(value, "status", None)
        return text if ending is None else f"{text}; {ending.value}"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        parts = [f"{name} {text}" for name, one in value.items() if (text := brief(one))]
        return _shortened(", ".join(parts))
    if isinstance(value, tuple | list):
        if len(value) > 4 and all(isinstance(one, float) for one in value):
            return f"{len(value)} numbers, {value[0]:.6g} to {value[-1]:.6g}"
        return _shortened(", ".join(brief(one) for one in value))
    if is_dataclass(value) and type(value).__str__ is object.__str__:
        parts = [f"{name} {text}" for name, text in described(value).items()]
        return _shortened(", ".join(parts))
    return _shortened(str(value))


def _array(values: np.ndarray[Any, Any]) -> str:
    shape = " x ".join(map(str, values.shape))
    if values.dtype == np.bool_:
        return f"[{shape}] {values.mean():.1%} True" if values.size else f"[{shape}]"
    known = np.abs(values) if values.dtype.kind == "c" else values
    known = known[np.isfinite(known)] if known.dtype.kind in "uif" else known[:0]
    label = "modulus " if values.dtype.kind == "c" else ""
    spread = f", {label}{known.min():.4g} to {known.max():.4g}" if known.size else ""
    return f"[{shape}] {values.dtype}{spread}"


def _shortened(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _MOST_CHARACTERS else text[: _MOST_CHARACTERS - 3] + "..."


def _above(name: str) -> Any:
    return getattr(import_module(_ABOVE), name)
