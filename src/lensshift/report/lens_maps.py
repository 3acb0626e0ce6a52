"""Figures of what a lens does over the sensor: MTF, focus, shift, distortion, spots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Circle
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.optics.layout import distortion_grid
from lensshift.optics.mtf import fast_mtf, sensor_mtf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.shift import moving
from lensshift.optics.spots import spots
from lensshift.report import images, style
from lensshift.report.curves import field_name, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lensshift.core.grid import Grid
    from lensshift.core.motion import ShiftField
    from lensshift.optics.lens import Lens

Pair = tuple[float, float]

_LABELS_IN = 0.75  # a title and two rows of text
_ARROWS = (5, 14)  # most rows and columns of arrows
_ARROW_PX = 0.06  # length of the longest, as a share of the columns
_DEPARTURE_PX = 0.03  # the same for the distortion grid
_AIRY = 1.22  # radius of the first dark ring over wavelength x f-number
_SPOT_RINGS = 10  # some 300 rays, which still are seen one by one
_MOST, _ROOM = 0.98, 1.15  # quantile of the rays that an enlarged spot shows, and room around
_FOCUS, _FOCUS_STEPS = 1.2, 80  # f-numbers over the frequency that the sensor moves either way
_LEAST_CHANGE = 1e-6  # of the MTF: less is rounding


@style.styled()
def field_figure(
    lens: Lens, element: int, travel_mm: Pair, grid: Grid, frequency_lpmm: float
) -> Figure:
    """Draw the MTF at one frequency over the sensor, at rest and moved, and the difference.

    Of the two directions, along columns and along rows, each pixel shows the worse.

    Parameters
    ----------
    lens : at rest
    element, travel_mm : which element moves, counted from 0, and its decentre (row, col)
    grid : of the sensor
    frequency_lpmm : of the MTF
    """
    rest, moved = (
        sensor_mtf(lens, grid, frequency_lpmm, build=build).min(axis=(-2, -1))
        for build in (None, moving(lens, element, np.asarray(travel_mm)))
    )
    low, high = float(min(rest.min(), moved.min())), float(max(rest.max(), moved.max()))
    change = moved - rest
    figure = style.new_figure(style.WIDTH_IN, 3 * _map_in(grid, 0.8 * style.WIDTH_IN))
    panels = figure.subplots(3, 1)
    for axes, values, state in zip(panels[:2], (rest, moved), ("at rest", "moved"), strict=True):
        title = (
            f"element {element + 1} {state}: MTF at {frequency_lpmm:.3g} LP/mm, "
            f"worse direction, {values.min():.3f} to {values.max():.3f}"
        )
        shown = images.draw_image(axes, values, title, colours="viridis")
        shown.set_clim(low, high)
        images.add_scale(axes, shown, "modulation")
    largest = max(float(np.abs(change).max()), _LEAST_CHANGE)
    images.draw_map(panels[2], change, "moved minus rest", "change", largest=largest)
    for axes in panels:
        axes.set_aspect(grid.pitch_mm[0] / grid.pitch_mm[1])
    return figure


@style.styled()
def focus_figure(lens: Lens, fields_tan: Sequence[Pair], frequency_lpmm: float) -> Figure:
    """Draw the MTF at one frequency, lens at rest, over the distance of the sensor.

    Parameters
    ----------
    fields_tan : tangents (row, col) of the fields
    frequency_lpmm : of the MTF
    """
    most_mm = _FOCUS * paraxial(lens).working_f_number / frequency_lpmm
    away_mm = np.linspace(-most_mm, most_mm, _FOCUS_STEPS + 1)
    found = fast_mtf(lens, fields_tan, frequency_lpmm, defocus_mm=away_mm[:, None])[..., 0]
    figure = style.new_figure(style.WIDTH_IN, 4.2)
    axes = figure.subplots()
    for number, field in enumerate(fields_tan):
        both = zip(found[:, number].T, ("-", "--"), ("columns", "rows"), strict=True)
        for values, dashes, along in both:
            label = f"{field_name(field)} along {along}"
            axes.plot(away_mm, values, dashes, color=style.colour_of(number), label=label)
    axes.axvline(0.0, color=style.GREY, linewidth=0.9, zorder=1.0)
    axes.set_xlabel("sensor moved away from the lens (mm)")
    axes.set_ylabel(f"modulation at {frequency_lpmm:.3g} LP/mm")
    legend_above(axes, f"{lens.name or 'lens'} through focus")
    return figure


@style.styled()
def shift_map_figure(field: ShiftField, grid: Grid, wanted_px: ArrayLike | None = None) -> Figure:
    """Draw for each frame how the shift of the pixels departs from an even one.

    Parameters
    ----------
    field : shift of every pixel
    grid : of the sensor
    wanted_px : [frame 2] (row, col) the departure is from; the mean over the sensor if None

    Raises
    ------
    ValueError
        If the number of frames differs.
    """
    mean = field.offset_px.mean(axis=(1, 2))
    even = mean if wanted_px is None else np.asarray(wanted_px, dtype=np.float64)
    if even.shape != mean.shape:
        raise ValueError(f"expected wanted_px {mean.shape}, got {even.shape}")
    error = field.offset_px - even[:, None, None, :]
    longest = float(np.max(np.linalg.norm(error, axis=-1)))
    times = style.round_number(_ARROW_PX * grid.shape[1] / longest) if longest > 0 else 1.0
    across = min(len(even), 2)
    down = -(-len(even) // across)
    width_in = (0.84 if across == 1 else 0.4) * style.WIDTH_IN
    figure = style.new_figure(style.WIDTH_IN, 0.4 + down * _map_in(grid, width_in))
    panels = list(figure.subplots(down, across, squeeze=False).ravel())
    for axes, wish, here in zip(panels, even, error, strict=False):
        length = np.linalg.norm(here, axis=-1)
        title = f"({wish[0]:+.3f}, {wish[1]:+.3f}) px: up to {length.max():.4f}"
        shown = images.draw_image(axes, length, title, colours="Blues")
        shown.set_clim(0.0, longest if longest > 0 else 1.0)
        _draw_arrows(axes, here, times)
        axes.set_aspect(grid.pitch_mm[0] / grid.pitch_mm[1])
    for axes in panels[len(even) :]:
        axes.set_axis_off()
    figure.colorbar(shown, ax=panels, label="departure (px)")
    base = "mean" if wanted_px is None else "wanted"
    figure.suptitle(
        f"departure of the shift from the {base} one (row, column), arrows {times:g} times as long",
        fontsize=style.TITLE_PT,
    )
    return figure


@style.styled()
def distortion_figure(lens: Lens, grid: Grid) -> Figure:
    """Draw real against paraxial image points over the sensor, the difference enlarged.

    Parameters
    ----------
    lens, grid : whose image falls on the sensor
    """
    found = distortion_grid(lens, grid)
    longest = float(np.max(np.linalg.norm(found.error_px, axis=-1)))
    times = style.round_number(_DEPARTURE_PX * grid.shape[1] / longest) if longest > 0 else 1.0
    centre_px = 0.5 * (np.asarray(grid.shape) - 1.0)
    ideal = found.paraxial_mm / np.asarray(grid.pitch_mm) + centre_px
    real = ideal + times * found.error_px
    figure = style.new_figure(style.WIDTH_IN, 0.4 + _map_in(grid, 0.9 * style.WIDTH_IN))
    axes = figure.subplots()
    for points, colour, label in (
        (ideal, style.LIGHT, "paraxial"),
        (real, style.BLUE, "real" if times == 1.0 else f"real, departure {times:g} times as large"),
    ):
        axes.plot(points[..., 1].T, points[..., 0].T, color=colour, linewidth=1.1)
        axes.plot(points[..., 1], points[..., 0], color=colour, linewidth=1.1)
        axes.plot([], [], color=colour, label=label)
    axes.grid(visible=False)
    axes.set_aspect(grid.pitch_mm[0] / grid.pitch_mm[1])
    axes.invert_yaxis()
    axes.set(xlabel="column (px)", ylabel="row (px)")
    legend_above(axes, f"{lens.name or 'lens'}: departs by up to {longest:.3g} px")
    return figure


@style.styled()
def spots_figure(
    lens: Lens, element: int, travel_mm: Pair, grid: Grid, fields_tan: Sequence[Pair]
) -> Figure:
    """Draw the spots of some fields at rest and moved: in a pixel, and enlarged each by itself.

    Each spot lies about its centroid; enlarged is what holds most of its rays. The circle is the
    first dark ring of the Airy pattern.

    Parameters
    ----------
    lens : at rest
    element, travel_mm : which element moves, counted from 0, and its decentre (row, col)
    grid : of the sensor
    fields_tan : tangents (row, col) of the fields
    """
    airy_um = _AIRY * 1e-3 * lens.wavelength_nm * paraxial(lens).working_f_number
    builds = (None, moving(lens, element, np.asarray(travel_mm)))
    found = [
        [spots(lens, field, build=build, rings=_SPOT_RINGS) for build in builds]
        for field in fields_tan
    ]
    # The landing points [n 2] of the rays that arrive, from the centroid.
    rays_um = [[1e3 * spot.ray_mm[spot.weight > 0] for spot in both] for both in found]
    pixel_um = 1e3 * np.asarray(grid.pitch_mm)
    ring = f"Airy ring, {airy_um:.2g} um, at {lens.wavelength_nm:g} nm"
    figure = style.new_figure(max(5.0, 0.8 + 2.4 * len(fields_tan)), 5.8)
    panels = figure.subplots(2, len(fields_tan), squeeze=False, gridspec_kw={"hspace": 0.1})
    shown = zip(panels.T, fields_tan, rays_um, found, strict=True)
    for (wide, close), field, both, (rest, moved) in shown:
        for axes in (wide, close):
            _draw_spots(axes, both, airy_um, pixel_um, ring)
            axes.set(xlabel="column (um)", ylabel="row (um)")
        together_um = np.concatenate(both)
        wide_um = max(0.6 * float(pixel_um.max()), float(np.abs(together_um).max()))
        low_um, high_um = np.quantile(together_um, (1.0 - _MOST, _MOST), axis=0)
        close_um = min(wide_um, _ROOM * max(0.5 * float((high_um - low_um).max()), airy_um))
        for axes, (row_um, col_um), reach_um in (
            (wide, (0.0, 0.0), wide_um),
            (close, 0.5 * (low_um + high_um), close_um),
        ):
            axes.set_xlim(col_um - reach_um, col_um + reach_um)
            axes.set_ylim(row_um + reach_um, row_um - reach_um)
            axes.locator_params(nbins=5)
        radii = f"{1e3 * rest.rms_radius_mm:.1f}, {1e3 * moved.rms_radius_mm:.1f} um rms"
        wide.set_title(f"{field_name(field)}\n{radii}")
        close.set_title(f"{wide_um / close_um:.2g} times as large")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4, markerscale=4.0)
    return figure


def _map_in(grid: Grid, width_in: float) -> float:
    """Return the height of a map of the sensor with its labels."""
    shape = np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    return _LABELS_IN + float(width_in * shape[0] / shape[1])


def _draw_arrows(axes: Axes, error_px: Floats, times: float) -> None:
    """Draw the departures of some pixels, spread over the sensor from border to border."""
    row, col = (
        np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
        for count, most in zip(error_px.shape[:2], _ARROWS, strict=True)
    )
    part = times * error_px[np.ix_(row, col)]
    arrows = axes.quiver(
        *np.meshgrid(col, row), part[..., 1], part[..., 0], angles="xy", scale_units="xy",
        scale=1.0, color=style.INK, units="inches", width=0.014, minlength=0.5, clip_on=False,
    )  # fmt: skip
    arrows.set_in_layout(False)  # else the layout makes room for arrows of any length


def _draw_spots(
    axes: Axes, both_um: Sequence[Floats], airy_um: float, pixel_um: Floats, ring: str
) -> None:
    outline = images.pixel_outline(pixel_um, edgecolor=style.GREY, linewidth=1.2, label="pixel")
    axes.add_patch(outline)
    for rays_um, colour, label, size in zip(
        both_um, (style.BLUE, style.RED), ("at rest", "moved"), (3.0, 1.2), strict=True
    ):
        axes.plot(rays_um[:, 1], rays_um[:, 0], ".", color=colour, markersize=size, label=label)
    how = {"fill": False, "edgecolor": style.INK, "zorder": 3.0, "label": ring}
    axes.add_patch(Circle((0.0, 0.0), airy_um, **how))
    axes.set_aspect("equal")
