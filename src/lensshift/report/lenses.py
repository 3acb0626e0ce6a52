"""Figures of lenses: the section with the moved element, MTF curves, the choice of the mover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.evaluation.limits import paper_sensor_limit, pixel_aperture_mtf
from lensshift.optics.layout import layout
from lensshift.optics.otf import diffraction_limit, exact_otf
from lensshift.optics.shift import moving
from lensshift.optics.which import label_of
from lensshift.report import curves, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lensshift.core.grid import Grid
    from lensshift.optics.layout import Layout, Polyline
    from lensshift.optics.lens import Lens
    from lensshift.optics.which import Mover

Pair = tuple[float, float]

_GLASS = "#E3EDF6"
_FIELDS_DEG = (0.0, 6.5)  # centre and edge of the sensor of the paper, behind 42.7 mm
_VISIBLE = 0.03  # of the height of the lens: a smaller travel is drawn enlarged
_WIDE_IN = 10.0  # of four panels with names beside them
_DRAWN, _HIGH_IN, _AROUND_IN = 0.85, (1.5, 7.0), 1.9  # of a section: share of the width, heights
_LEVEL_PT = 1.4 * style.SMALL_PT  # from one row of names to the next
_FIRST_PT = 6.0
_LETTER_PT = 0.62 * style.SMALL_PT
_STATES = ((0.0, "-", "at rest"), (1.0, "--", "moved"), (-1.0, ":", "moved the other way"))


@style.styled()
def layout_figure(
    lens: Lens, element: int, travel_mm: Pair, *, fields_deg: Sequence[float] = _FIELDS_DEG
) -> Figure:
    """Draw the section of a lens along columns with rays, one element also where it moves to.

    Parameters
    ----------
    lens : at rest
    element : that moves, counted from 0
    travel_mm : its decentre (row, col); drawn enlarged where it would not be seen
    fields_deg : of the rays, along columns
    """
    tangents = np.tan(np.deg2rad(fields_deg))
    rest = layout(lens, field_tan=tangents)
    height_mm = max(float(np.max(line.height_mm)) for line in rest.outlines)
    times, travel = 1.0, abs(travel_mm[1])
    if 0.0 < travel < _VISIBLE * height_mm:
        times = style.round_number(3.0 * _VISIBLE * height_mm / travel)
    outline = rest.outlines[element]
    dashed = replace(outline, height_mm=outline.height_mm + times * travel_mm[1])
    ending = "" if times == 1.0 else f", drawn {times:g} times as far"
    figure, mm_per_pt = _section_figure(rest, dashed)
    axes = figure.subplots()
    _draw_rays(axes, rest, fields_deg)
    _draw_parts(axes, rest, element)
    _draw_names(axes, rest, dashed, mm_per_pt)
    label = f"element {element + 1} moved by {1e3 * travel_mm[1]:.1f} um{ending}"
    axes.plot(dashed.z_mm, dashed.height_mm, "--", color=style.RED, linewidth=1.3, label=label)
    axes.set(aspect="equal", xlabel="along the axis (mm)", ylabel="along columns (mm)")
    title = f"{lens.name or 'lens'}, stop {lens.stop.diameter_mm:.4g} mm"
    curves.legend_above(axes, title, columns=3)
    return figure


def _section_figure(section: Layout, moved: Polyline) -> tuple[Figure, float]:
    """Return a figure as high as the lens is at its width, and how many mm a point stands for."""
    parts = [*section.outlines, *section.stop, moved, section.sensor]  # rays in front are cut
    lines = [*parts, *(ray.line for ray in section.rays)]
    long_mm = max(line.z_mm.max() for line in lines) - min(line.z_mm.min() for line in lines)
    high_mm = 2.0 * max(float(np.abs(line.height_mm).max()) for line in parts)
    drawn_in = _DRAWN * style.WIDTH_IN
    high_in = float(np.clip(drawn_in * high_mm / long_mm, *_HIGH_IN))
    mm_per_pt = max(long_mm / drawn_in, high_mm / high_in) / 72.0
    return style.new_figure(style.WIDTH_IN, high_in + _AROUND_IN), mm_per_pt


@style.styled()
def mtf_figure(
    lens: Lens,
    element: int,
    travel_mm: Pair,
    grid: Grid,
    fields_tan: Sequence[Pair],
    *,
    highest_lpmm: float = 8.0,
    azimuth_rad: float = 0.0,
) -> Figure:
    """Draw the exact MTF at rest and moved to both sides, with the limits of lens and sensor.

    Below, what moving changes.

    Parameters
    ----------
    lens : at rest
    element, travel_mm : which element moves, counted from 0, and its decentre (row, col)
    grid : of the sensor
    fields_tan : tangents (row, col) of the fields
    highest_lpmm : where the curves end
    azimuth_rad : direction in which the pattern repeats, from the columns towards the rows
    """
    frequency_lpmm = np.linspace(0.0, highest_lpmm, curves.STEPS)
    figure = style.new_figure(9.0, 6.2)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
    for number, field in enumerate(fields_tan):
        name, colour = curves.field_name(field), style.colour_of(number)
        builds = (moving(lens, element, sign * np.asarray(travel_mm)) for sign, _, _ in _STATES)
        found = [
            np.abs(exact_otf(lens, field, frequency_lpmm, azimuth_rad, build=build)[0])
            for build in builds
        ]
        for values, (_, dashes, state) in zip(found, _STATES, strict=True):
            label = f"{name} {state}"
            above.plot(frequency_lpmm, values, dashes, color=colour, label=label)
        for values, (_, dashes, _) in zip(found[1:], _STATES[1:], strict=True):
            below.plot(frequency_lpmm, values - found[0], dashes, color=colour)
    _draw_sensor(above, grid, frequency_lpmm, azimuth_rad)
    curves.draw_limits(above, [diffraction_limit(lens, frequency_lpmm)], highest_lpmm)
    um = ", ".join(f"{1e3 * travel:.1f}" for travel in travel_mm)
    title = f"{lens.name or 'lens'}, element {element + 1} moved by ({um}) um (row, column)"
    turn_deg = round(np.rad2deg(azimuth_rad))
    along = {0: "along columns", 90: "along rows"}.get(turn_deg, f"at {turn_deg} degrees")
    curves.finish_mtf_axes(above, highest_lpmm, "LP/mm", title, columns=3)
    above.set(xlabel="", ylabel=f"modulation {along}")
    below.axhline(0.0, color=style.GREY, linewidth=0.9, zorder=1.0)
    below.set(xlabel="spatial frequency on the sensor (LP/mm)", ylabel="moved minus rest")
    return figure


@style.styled()
def which_figure(movers: Sequence[Mover]) -> Figure:
    """Draw what shifting the image with each element takes and costs.

    Parameters
    ----------
    movers : of `which_element`

    Raises
    ------
    ValueError
        If there is none.
    """
    if not movers:
        raise ValueError("expected at least one element that moves the image, got none")
    names = [label_of(mover) for mover in movers]
    strokes = [mover.stroke_text.removeprefix("-") for mover in movers]
    panels = (
        ("stroke (um)", [1e3 * abs(one.stroke_mm) for one in movers], strokes),
        ("error of the shift (px)", [one.max_shift_error_px for one in movers], None),
        ("loss of MTF", [one.mtf_loss for one in movers], None),
    )
    figure = style.new_figure(_WIDE_IN, 1.2 + 0.5 * len(movers))
    grid = figure.subplots(1, len(panels) + 1, sharey=True, width_ratios=(1.1, 1.0, 1.0, 1.1))
    for axes, (label, values, texts) in zip(grid, panels, strict=False):
        _draw_bars(axes, names, values, style.BLUE, texts=texts)
        axes.set_xlabel(label)
    for away, label, values in (
        (-0.19, "rest", [one.mtf_centred for one in movers]),
        (0.19, "moved", [one.mtf_moved for one in movers]),
    ):
        colour = style.LIGHT if label == "rest" else style.BLUE
        _draw_bars(grid[-1], names, values, colour, away=away, label=label)
    grid[-1].set_xlabel("least MTF")
    curves.legend_above(grid[-1], "")
    grid[0].set_ylim(len(movers) - 0.4, -0.6)
    return figure


def _draw_bars(
    axes: Axes, names: list[str], values: list[float], colour: str, *, away: float = 0.0,
    label: str = "", texts: Sequence[str] | None = None,
) -> None:  # fmt: skip
    places = np.arange(len(values)) + away
    bars = axes.barh(places, values, color=colour, height=0.36 if away else 0.6, label=label)
    shown = texts or [f"{value:.3g}" for value in values]
    axes.bar_label(bars, shown, padding=3.0, fontsize=style.SMALL_PT)
    axes.set_yticks(range(len(names)), names)
    axes.set_xlim(0.0, 1.5 * max(max(values), axes.get_xlim()[1] / 1.5 if away > 0 else 0.0))
    axes.locator_params(axis="x", nbins=3)
    axes.grid(visible=False, axis="y")


def _draw_rays(axes: Axes, section: Layout, fields_deg: Sequence[float]) -> None:
    colours, named = (style.BLUE, style.GREEN, style.ORANGE), set()
    for ray in section.rays:
        colour = colours[ray.field % len(colours)]
        label = "_" if ray.field in named else f"field {fields_deg[ray.field]:.3g} degrees"
        named.add(ray.field)
        line, dashes = (ray.line.z_mm, ray.line.height_mm), "-" if ray.arrived else ":"
        axes.plot(*line, dashes, color=colour, linewidth=0.8, label=label)


def _draw_parts(axes: Axes, section: Layout, element: int) -> None:
    """Draw glass, stop and sensor."""
    for number, line in enumerate(section.outlines):
        colour = style.RED if number == element else style.INK
        how: dict[str, Any] = {"facecolor": _GLASS, "edgecolor": colour, "alpha": 0.8}
        axes.fill(line.z_mm, line.height_mm, linewidth=1.1, **how)
    for part in (*section.stop, section.sensor):
        axes.plot(part.z_mm, part.height_mm, color=style.INK, linewidth=2.2)
    place = (float(section.sensor.z_mm[0]), 0.0)
    style.note(axes, "sensor", place, (4.0, 0.0), rotation=90, va="center", path_effects=None)


def _draw_names(axes: Axes, section: Layout, moved: Polyline, mm_per_pt: float) -> None:
    """Name elements above and below everything drawn, in rows in which no two names meet."""
    lines = [*section.outlines, *section.stop, moved]
    top_mm = max(float(line.height_mm.max()) for line in lines)
    low_mm = min(float(line.height_mm.min()) for line in lines)
    names = [("virtual stop" if section.virtual_stop else "stop", section.stop[0], -1)]
    names += [
        (f"{number + 1} {name}", line, -1 if number % 2 else 1)
        for number, (name, line) in enumerate(zip(section.names, section.outlines, strict=True))
    ]
    names.sort(key=lambda one: float(one[1].z_mm.min() + one[1].z_mm.max()))
    taken_mm: dict[tuple[int, int], float] = {}
    for text, line, side in names:
        middle_mm = 0.5 * float(line.z_mm.min() + line.z_mm.max())
        half_mm = 0.5 * _LETTER_PT * len(text) * mm_per_pt
        level = 0
        while middle_mm - half_mm < taken_mm.get((side, level), -np.inf):
            level += 1
        taken_mm[side, level] = middle_mm + half_mm + _LETTER_PT * mm_per_pt
        edge_mm = float(line.height_mm.max() if side > 0 else line.height_mm.min())
        away_mm = (_FIRST_PT + level * _LEVEL_PT) * mm_per_pt
        at_mm = top_mm + away_mm if side > 0 else low_mm - away_mm
        axes.annotate(
            text, (middle_mm, edge_mm), xytext=(middle_mm, at_mm), ha="center",
            va="bottom" if side > 0 else "top", fontsize=style.SMALL_PT,
            path_effects=style.outlined(2.5),
            zorder=5.0 - 0.1 * level,  # lines to lower rows pass below the names
            arrowprops={"arrowstyle": "-", "color": style.LIGHT, "linewidth": 0.6, "shrinkB": 0.0},
        )  # fmt: skip
    rows = {side: max((n for at, n in taken_mm if at == side), default=-1) for side in (-1, 1)}
    room_mm = {n: (_FIRST_PT + (row + 1.3) * _LEVEL_PT) * mm_per_pt for n, row in rows.items()}
    axes.set_ylim(low_mm - room_mm[-1], top_mm + room_mm[1])


def _draw_sensor(axes: Axes, grid: Grid, frequency_lpmm: Floats, azimuth_rad: float) -> None:
    aperture = pixel_aperture_mtf(frequency_lpmm, grid.pitch_mm, angle_rad=azimuth_rad)
    row_mm, col_mm = grid.pitch_mm
    along_mm = float(np.hypot(row_mm * np.sin(azimuth_rad), col_mm * np.cos(azimuth_rad)))
    published = paper_sensor_limit(frequency_lpmm, along_mm)
    how: dict[str, Any] = {"color": style.INK, "linewidth": 1.0}
    axes.plot(frequency_lpmm, aperture, "--", label="pixel |sinc|", **how)
    axes.plot(frequency_lpmm, published, ":", label="pixel sinc$^2$", **how)
    if 0.5 / along_mm < frequency_lpmm[-1]:
        curves.mark_frequency(axes, 0.5 / along_mm, "LR Nyquist")
