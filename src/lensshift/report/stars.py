"""Figures of Siemens stars and zone plates: response, rings on the image, fits of single rings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.optical import MtfCurve
from lensshift.evaluation.limits import pitch_pair_mm
from lensshift.evaluation.siemens import SiemensResult
from lensshift.evaluation.zone_plate import ZonePlateResult
from lensshift.report import curves, images, style

Pair = tuple[float, float]
Pitch = float | Pair

_RINGS_SHOWN = 3  # named a, b, c
_WEDGE_RAD = np.pi / 12  # of the curves along rows and columns


@style.styled()
def star_figure(
    star: SiemensResult,
    image: ArrayLike,
    pitch_mm: Pitch,
    *,
    unit: str = "LP/mm",
    factor: float = 1.0,
    lr_pitch_mm: Pitch | None = None,
) -> Figure:
    """Draw the MTF of a Siemens star, rings on the image, and the waves fitted to these rings.

    Parameters
    ----------
    star : what was measured
    image : [row col] in which it was
    pitch_mm : of the image, one or (row, col)
    unit, factor : of the frequencies shown, and what those of the results are multiplied by
    lr_pitch_mm : side of an LR pixel for its limits; that of the image if None

    Raises
    ------
    ValueError
        If the image has not two axes, or a pitch is not positive.
    """
    picture, sides_mm = images.plain_image(image), pitch_pair_mm(pitch_mm)
    chosen = np.unique(np.linspace(0, star.radius_mm.size - 1, _RINGS_SHOWN).round().astype(int))
    named = [(star.mtf, "all directions" if star.sectors else "star")]
    turn_deg = 360 / max(1, len(star.sectors))
    named += [(curve, f"{round(turn_deg * k)} degrees") for k, curve in enumerate(star.sectors)]
    figure = style.new_figure(style.WIDTH_IN, 6.4)
    top, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.6, 1.0))[:, 0]
    left, right = top.subplots(1, 2, width_ratios=(1.45, 1.0))
    title = "MTF of the Siemens star, with 95 % band"
    _draw_curves(left, named, lr_pitch_mm or sides_mm, unit, factor, title)
    images.draw_image(right, picture, "rings fitted below")
    _draw_center(right, star.center_px, sides_mm)
    panels = below.subplots(1, chosen.size, squeeze=False, sharey=True)[0]
    panels[0].set_ylabel("pixel over mean")
    turn = np.linspace(-0.5, 0.5, 101)
    for letter, axes, ring in zip("abc", panels, chosen, strict=False):
        _draw_ring(right, star.center_px, sides_mm, float(star.radius_mm[ring]), letter)
        # Its pixels over the phase, freed of uneven light, and the fitted wave.
        phase, level, amplitude = ring_wave(star, int(ring), picture, sides_mm)
        axes.plot(phase, level, ".", color=style.GREY, markersize=2.5, alpha=0.6)
        axes.plot(turn, 1.0 + amplitude * np.cos(2.0 * np.pi * turn), color=style.RED)
        axes.set(xlim=(-0.5, 0.5), xlabel="phase (cycles)")
        place = star.mtf.frequency_lpmm[ring] * factor
        samples = f"{star.pixels_per_cycle[ring]:.1f} px per cycle"
        axes.set_title(f"{letter}: {place:.3g} {unit}, {samples}")
        modulation = float(star.mtf.modulation[ring])
        left.plot(place, modulation, "o", color=style.RED, markersize=4.5)
        _write(left, letter, place, modulation, (0.0, 7.0))
    return figure


@style.styled()
def zone_plate_figure(
    plate: ZonePlateResult,
    image: ArrayLike,
    pitch_mm: Pitch,
    *,
    unit: str = "LP/mm",
    factor: float = 1.0,
    lr_pitch_mm: Pitch | None = None,
) -> Figure:
    """Draw the response to a zone plate, what of it is folded, and where each curve looks.

    Parameters
    ----------
    plate : what was measured
    image, pitch_mm, unit, factor, lr_pitch_mm : as for `star_figure`

    Raises
    ------
    ValueError
        As in `star_figure`.
    """
    picture, sides_mm = images.plain_image(image), pitch_pair_mm(pitch_mm)
    named = [(plate.radial, "all directions"), (plate.row, "along rows (up, down)")]
    named += [(plate.col, "along columns (left, right)")]
    if plate.folded is not None:
        rows, cols = plate.folded
        named += [(rows, "folded, along rows"), (cols, "folded, along columns")]
    figure = style.new_figure(style.WIDTH_IN, 4.4)
    left, right = figure.subplots(1, 2, width_ratios=(1.45, 1.0))
    title = "response to the zone plate, with 95 % bands"
    _draw_curves(left, named, lr_pitch_mm or sides_mm, unit, factor, title)
    images.draw_image(right, picture, "centre and sectors of the curves")
    _draw_center(right, plate.center_px, sides_mm)
    for number, (row, col) in ((1, (1.0, 0.0)), (2, (0.0, 1.0))):
        _draw_wedge(right, plate.center_px, sides_mm, (row, col), style.colour_of(number))
    right.set(xlim=(-0.5, picture.shape[1] - 0.5), ylim=(picture.shape[0] - 0.5, -0.5))
    return figure


def _draw_curves(
    axes: Axes,
    named: Sequence[tuple[MtfCurve, str]],
    lr_pitch_mm: Pitch,
    unit: str,
    factor: float,
    title: str,
) -> None:
    shown = [(curve, label) for curve, label in named if curve.frequency_lpmm.size]
    for number, (curve, label) in enumerate(shown):
        curves.draw_curve(axes, curve, style.colour_of(number), label, factor=factor)
    highest_lpmm = max(float(curve.frequency_lpmm[-1]) for curve, _ in shown)
    curves.draw_pixel_limits(axes, lr_pitch_mm, None, highest_lpmm, factor)
    nyquist_lpmm = 0.5 / max(pitch_pair_mm(lr_pitch_mm))
    if nyquist_lpmm <= highest_lpmm:
        curves.mark_frequency(axes, nyquist_lpmm * factor, "Nyquist")
    curves.finish_mtf_axes(axes, 1.02 * highest_lpmm * factor, unit, title)


def _draw_center(axes: Axes, center_px: Pair, sides_mm: Pair) -> None:
    row, col = center_px
    axes.plot(col, row, "+", color=style.BLUE, markersize=9.0, markeredgewidth=1.4)
    axes.set_aspect(sides_mm[0] / sides_mm[1])


def _draw_ring(axes: Axes, center_px: Pair, sides_mm: Pair, radius_mm: float, letter: str) -> None:
    high_px, wide_px = (radius_mm / side for side in sides_mm)
    ring = Ellipse(
        center_px[::-1], 2.0 * wide_px, 2.0 * high_px, fill=False, edgecolor=style.RED,
        linewidth=1.3, path_effects=style.outlined(1.3),
    )  # fmt: skip
    axes.add_patch(ring)
    _write(axes, letter, center_px[1], center_px[0] - high_px, (0.0, -9.0))


def _write(axes: Axes, text: str, x: float, y: float, away_pt: Pair) -> None:
    how = {"ha": "center", "va": "center", "color": style.RED, "fontweight": "bold"}
    style.note(axes, text, (x, y), away_pt, fontsize=None, **how)


def _draw_wedge(axes: Axes, center_px: Pair, sides_mm: Pair, axis: Pair, colour: str) -> None:
    """Draw the two lines through the centre that bound the pixels about an axis (row, col)."""
    far_mm = 1e3 * max(sides_mm)  # cut by the axes
    for turn_rad in (-_WEDGE_RAD, _WEDGE_RAD):
        away = np.cos(turn_rad) * np.array(axis) + np.sin(turn_rad) * np.array(axis[::-1])
        by_px = far_mm * away / sides_mm
        rows, cols = np.transpose([center_px - by_px, center_px + by_px])
        axes.plot(cols, rows, color=colour, linewidth=1.1, path_effects=style.outlined(1.1))


def ring_wave(
    star: SiemensResult, ring: int, picture: Floats, sides_mm: Pair
) -> tuple[Floats, Floats, float]:
    """Return phase in cycles and value over mean of the pixels of a ring, and the modulation.

    The same least squares fit as in `siemens_star_mtf`, first harmonic only, of all pixels within
    half a pixel of the ring; phase 0 is where the fitted wave is brightest.

    Parameters
    ----------
    star : what was measured
    ring : its number
    picture : [row col]
    sides_mm : pitch (row, col)
    """
    radius_mm = float(star.radius_mm[ring])
    cycles = round(2.0 * np.pi * radius_mm * float(star.mtf.frequency_lpmm[ring]))
    place_px = np.moveaxis(np.indices(picture.shape), 0, -1) - star.center_px
    row_mm, col_mm = np.moveaxis(place_px * sides_mm, -1, 0)
    near = np.abs(np.hypot(row_mm, col_mm) - radius_mm) <= 0.5 * max(sides_mm)
    near &= np.isfinite(picture)
    angle_rad, values = np.arctan2(row_mm, col_mm)[near], picture[near]
    waves = [wave(k * angle_rad) for k in (cycles, 1, 2) for wave in (np.cos, np.sin)]
    design = np.column_stack([*waves, np.ones_like(angle_rad)])
    found = np.linalg.lstsq(design, values, rcond=None)[0]
    mean = float(found[-1])
    even = (values - design[:, 2:-1] @ found[2:-1]) / mean
    shift_rad = float(np.arctan2(found[1], found[0]))
    phase = (cycles * angle_rad - shift_rad) / (2.0 * np.pi)
    return np.mod(phase + 0.5, 1.0) - 0.5, even, float(np.hypot(found[0], found[1]) / mean)
