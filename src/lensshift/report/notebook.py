"""What notebooks ask of the core values: a figure, a page of HTML, a dataset, a table."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from lensshift.core.errors import of_extra
from lensshift.core.optical import MtfCurve
from lensshift.core.point_cloud import PointCloud
from lensshift.core.showing import Shown, described
from lensshift.core.types import Burst, Estimate, Reconstruction
from lensshift.evaluation.slanted_edge.result import EdgeResult, Interval
from lensshift.io import save_burst, save_reconstruction
from lensshift.report.page import embedded

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

_WIDE_IN, _HIGH_IN = 9.0, 4.0  # as `style.WIDTH_IN`, which would load matplotlib
_SCREEN_DPI = 80  # a page of 9 in is 720 px wide
_PAIRS = ("offset_px", "offset_sigma_px", "stage_mm", "stage_commanded_mm")


def figure_of(value: Any) -> Figure:
    """Draw a burst, a result, one of its channels, points, an edge or an MTF curve.

    Raises
    ------
    TypeError
        If nothing is known about how to draw it.
    """
    from lensshift.report.edges import edge_figure
    from lensshift.report.result import cloud_figure, estimate_figure, result_figure

    if isinstance(value, Burst):
        return _burst_figure(value)
    if isinstance(value, Reconstruction):
        return result_figure(value, title=f"{value.method} x{value.scale}", wide_in=_WIDE_IN)
    if isinstance(value, Estimate):
        return estimate_figure(value, wide_in=_WIDE_IN)
    if isinstance(value, EdgeResult):
        return edge_figure([value])
    if isinstance(value, MtfCurve):
        return _curve_figure(value)
    if isinstance(value, PointCloud):
        return cloud_figure(value, f"{len(value)} points")
    raise TypeError(f"expected something that can be drawn, got {type(value).__name__}")


def page_of(value: Shown) -> str:
    """Return a table of the fields and a picture as HTML that needs no other file."""
    rows = "".join(
        f'<tr><td style="text-align:left">{html.escape(name)}</td>'
        f'<td style="text-align:left"><code>{html.escape(text)}</code></td></tr>'
        for name, text in described(value).items()
    )
    name, picture = f"<b>{type(value).__name__}</b>", _picture(value)
    state = "" if picture else " open"
    return f"<details{state}><summary>{name}</summary><table>{rows}</table></details>{picture}"


def dataset_of(value: Burst | Reconstruction) -> Dataset:
    """Return the dataset that xarray reads from the file of a burst or a result.

    Raises
    ------
    ImportError
        If xarray is not installed.
    """
    xarray = of_extra("xarray", "to_xarray needs xarray: pip install 'lensshift[notebook]'")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "value.nc"
        if isinstance(value, Burst):
            save_burst(value, file)
        else:
            save_reconstruction(value, file)
        dataset: Dataset = xarray.load_dataset(file, engine="h5netcdf")
        return dataset


def table_of(value: Burst | EdgeResult | MtfCurve) -> DataFrame:
    """Return the frames of a burst, the numbers of an edge or the points of a curve as a table.

    Raises
    ------
    ImportError
        If pandas is not installed.
    """
    pd = of_extra("pandas", "to_pandas needs pandas: pip install 'lensshift[notebook]'")
    if isinstance(value, Burst):
        table = pd.DataFrame(_frame_columns(value))
        return table.rename_axis(index="frame")
    if isinstance(value, MtfCurve):
        columns = {"frequency_lpmm": value.frequency_lpmm, "modulation": value.modulation}
        return pd.DataFrame(columns | ({} if value.std is None else {"std": value.std}))
    rows = {}
    for name in value.__dataclass_fields__:
        number = getattr(value, name)
        if isinstance(number, float | Interval):
            whole = number if isinstance(number, Interval) else Interval(number)
            rows[name] = (whole.value, whole.low, whole.high)
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["value", "low", "high"])
    return table.rename_axis("quantity")


def _frame_columns(burst: Burst) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    for name in _PAIRS:
        pairs = getattr(burst, name)
        stem, unit = name.rsplit("_", 1)
        for index, axis in enumerate(("row", "col") if pairs is not None else ()):
            columns[f"{stem}_{axis}_{unit}"] = pairs[:, index]
    if burst.time_s is not None:
        columns["time_s"] = burst.time_s
    return columns | {"valid_share": burst.valid.mean(axis=(1, 2))}


def _picture(value: Shown) -> str:
    # What takes long to compute is left out of what shows itself unasked.
    if isinstance(value, Estimate):
        value = _quick(value)
    elif isinstance(value, Reconstruction):
        both = (value.amplitude, value.distance_m)
        amplitude, distance_m = (one and _quick(one) for one in both)
        value = replace(value, amplitude=amplitude, distance_m=distance_m)
    try:
        figure = value.plot()
    except (ImportError, ValueError):  # no matplotlib, or nothing to draw: the table alone
        return ""
    return embedded(figure, f"Picture of this {type(value).__name__}", _SCREEN_DPI)


def _quick(estimate: Estimate) -> Estimate:
    return replace(estimate, uncertainty=None) if callable(estimate.uncertainty) else estimate


def _burst_figure(burst: Burst) -> Figure:
    """Draw the first frame, its distances, and where the content moved in each frame."""
    from lensshift.report.curves import INTERVAL_SIGMAS
    from lensshift.report.images import add_scale, draw_image
    from lensshift.report.style import BLUE, new_figure, note, styled

    images = {"amplitude": np.abs(burst.amplitude[0])}
    if burst.distance_m is not None:
        images["distance (m)"] = burst.distance_m[0]
    rows, cols = burst.grid.shape
    wide = cols > 2 * rows
    with styled():
        figure = new_figure(_WIDE_IN, _HIGH_IN)
        left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(2.0, 1.0))[0]
        shape = (len(images), 1) if wide else (1, len(images))
        panels = left.subplots(*shape, squeeze=False).flat
        for axes, (label, image) in zip(panels, images.items(), strict=True):
            colours = "gray" if label == "amplitude" else "viridis"
            known = np.where(burst.valid[0], image, np.nan)
            title = f"frame 0 of {burst.frame_count}: {label}"
            add_scale(axes, draw_image(axes, known, title, colours=colours), "")
        place = right.subplots()
        down, across = burst.offset_px.T
        sigma = burst.offset_sigma_px
        row_px, col_px = (None, None) if sigma is None else INTERVAL_SIGMAS * sigma.T
        place.errorbar(across, down, yerr=row_px, xerr=col_px, fmt="o", color=BLUE, markersize=4)
        for number, at in enumerate(zip(across, down, strict=True)):
            note(place, str(number), at, (3.0, 3.0))
        place.set(title=f"offsets, {burst.offset_source}", xlabel="content moved right (px)")
        place.set_ylabel("content moved down (px)")
        place.invert_yaxis()
        place.set_aspect("equal", adjustable="datalim")
        place.margins(0.2)
    return figure


def _curve_figure(curve: MtfCurve) -> Figure:
    from lensshift.report.curves import draw_curve, finish_mtf_axes
    from lensshift.report.style import BLUE, new_figure, styled

    with styled():
        figure = new_figure(_WIDE_IN / 2, _HIGH_IN)
        axes = figure.subplots()
        draw_curve(axes, curve, BLUE, curve.label or "modulation")
        title = "MTF" if curve.std is None else "MTF with 95 % band"
        finish_mtf_axes(axes, float(curve.frequency_lpmm[-1]) or 1.0, "LP/mm", title)
    return figure
