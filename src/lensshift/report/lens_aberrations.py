"""Figures of aberrations: ray fans, curves over the field, both sections, images of points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.optics import aberrations
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import Band
from lensshift.optics.otf import diffraction_limit
from lensshift.optics.psf import point_spread
from lensshift.optics.spots import distortion, spots
from lensshift.report import curves, images, style
from lensshift.report.curves import field_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Pair = tuple[float, float]

_FIELD_STEPS, _MTF_FIELDS = 25, 13  # from centre to corner: smooth; every other for the slow MTF
_SIDES = 3 * 40 + 1  # of squares, up to 1.5 pixels or more: steps of an 80th of a pixel
_NEAR_AXIS = 1e-3  # of the corner: where the scale of the image is that of the middle
_PSF_PIXELS = 1.3  # that a picture of a point shows at least
_PSF_RADII, _PSF_RINGS = 1.6, 4  # rms radii of a spot that is wider, and rings to find it
_TINY = 1e-4  # of the peak: where the grey scale ends


@style.styled()
def fans_figure(
    lens: Lens, grid: Grid, fields_tan: Sequence[Pair], *, band: Band | None = None
) -> Figure:
    """Draw the ray fans of some fields, tangential and sagittal, for each wavelength of a band.

    The grey strip is half a pixel on either side, as wide as a pixel of twice the resolution.

    Parameters
    ----------
    grid : of the sensor
    fields_tan : tangents (row, col) of the fields
    band : of which the first, middle and last wavelengths are drawn; that of the lens if None
    """
    wavelengths_nm = [lens.wavelength_nm]
    if band is not None:
        ordered = np.sort(band.wavelength_nm)
        wavelengths_nm = list(dict.fromkeys(map(float, ordered[[0, len(ordered) // 2, -1]])))
    colours = (style.BLUE,) if len(wavelengths_nm) == 1 else (style.BLUE, style.INK, style.RED)
    quarter_um = 250.0 * min(grid.pitch_mm)
    figure = style.new_figure(style.WIDTH_IN, 0.8 + 1.9 * len(fields_tan))
    panels = figure.subplots(len(fields_tan), 2, squeeze=False, sharex=True, sharey=True)
    for line, field in zip(panels, fields_tan, strict=True):
        for axes in line:
            axes.axhspan(-quarter_um, quarter_um, color=style.FAINT, zorder=0.5, linewidth=0.0)
            axes.axhline(0.0, color=style.LIGHT, linewidth=0.9, zorder=1.0)
        for nm, colour in zip(wavelengths_nm, colours, strict=False):
            fan = aberrations.ray_fan(lens, field, wavelength_nm=nm)
            line[0].plot(fan.pupil, 1e3 * fan.tangential_mm, color=colour, label=f"{nm:.4g} nm")
            line[1].plot(fan.pupil, 1e3 * fan.sagittal_mm, color=colour)
        line[0].set_ylabel("ray error (um)")
        for axes, section in zip(line, ("tangential", "sagittal"), strict=True):
            axes.set(title=f"{field_name(field)}, {section}", xlim=(-1.0, 1.0))
            axes.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    for axes in panels[-1]:
        axes.set_xlabel("place in the stop (1 at its edge)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    labels[-1] += f"; strip: a pixel of half the size, {2.0 * quarter_um:.3g} um"
    figure.legend(handles, labels, loc="outside upper left", ncols=4)
    return figure


@style.styled()
def field_curves_figure(lens: Lens, grid: Grid) -> Figure:
    """Draw focus of both sections, distortion and illumination from the axis to the corner.

    Parameters
    ----------
    grid : of the sensor
    """
    shares = np.linspace(0.0, 1.0, _FIELD_STEPS)
    fields = aberrations.sensor_fields(lens, grid, shares)
    height_mm = _heights_mm(grid, shares)
    found = aberrations.focal_surfaces(lens, fields)
    petzval_mm = 0.5 * aberrations.petzval_curvature_per_mm(lens) * height_mm**2
    scale = 1.0 + distortion(lens, np.concatenate([_NEAR_AXIS * fields[-1:], fields[1:]]))
    percent = 100.0 * (scale / scale[0] - 1.0)
    light = 100.0 * aberrations.relative_illumination(lens, fields)
    figure = style.new_figure(style.WIDTH_IN, 4.4)
    focus, departure, bright = figure.subplots(1, 3, sharey=True)
    for place_mm, dashes, colour, label in (
        (found.tangential_mm, "-", style.BLUE, "tangential"),
        (found.sagittal_mm, "--", style.RED, "sagittal"),
        (found.sagittal_mm[0] + petzval_mm, ":", style.GREY, "Petzval surface"),
    ):
        focus.plot(place_mm, height_mm, dashes, color=colour, label=label)
    focus.axvline(0.0, color=style.LIGHT, linewidth=0.9, zorder=1.0)
    focus.set(xlabel="focus behind the sensor (mm)", ylabel="height of the image (mm)")
    departure.plot(percent, height_mm, color=style.BLUE)
    departure.axvline(0.0, color=style.LIGHT, linewidth=0.9, zorder=1.0)
    departure.locator_params(axis="x", nbins=4)
    departure.set_xlabel("distortion against the middle (%)")
    departure.set_title(f"{percent[-1]:+.2f} % in the corner")
    bright.plot(light, height_mm, color=style.BLUE)
    bright.set(xlim=(0.0, 105.0), xlabel="relative illumination (%)")
    bright.set_title(f"{light[-1]:.1f} % in the corner")
    focus.set_ylim(0.0, height_mm[-1])
    for axes in (departure, focus):  # zero stays in view, with room on both sides of flat curves
        low, high = axes.get_xlim()
        reach = max(abs(low), abs(high), 1e-3)
        axes.set_xlim(min(low, -0.15 * reach), max(high, 0.15 * reach))
    curves.legend_above(focus, "", 1)
    title = f"{lens.name or 'lens'}, centre to corner, {field_name(fields[-1])}"
    figure.suptitle(title, fontsize=style.TITLE_PT)
    return figure


@style.styled()
def sections_figure(
    lens: Lens,
    grid: Grid,
    fields_tan: Sequence[Pair],
    *,
    highest_lpmm: float | None = None,
    band: Band | None = None,
) -> Figure:
    """Draw the exact MTF, tangential and sagittal: over frequency, and from centre to corner.

    Parameters
    ----------
    grid : of the sensor
    fields_tan : tangents (row, col) of the fields of the curves over frequency
    highest_lpmm : where they end; a little beyond twice the Nyquist frequency if None
    band : the light; the wavelength of the lens alone if None
    """
    double_lpmm = 1.0 / max(grid.pitch_mm)
    end_lpmm = 1.25 * double_lpmm if highest_lpmm is None else highest_lpmm
    frequency_lpmm = np.linspace(0.0, end_lpmm, curves.STEPS)
    shares = np.linspace(0.0, 1.0, _MTF_FIELDS)
    fields = aberrations.sensor_fields(lens, grid, shares)
    chosen_lpmm = np.array([0.25, 0.5, 1.0]) * double_lpmm
    over_field = [aberrations.section_mtf(lens, one, chosen_lpmm, band=band) for one in fields]
    figure = style.new_figure(style.WIDTH_IN, 4.6)
    left, right = figure.subplots(1, 2, sharey=True)
    for number, field in enumerate(fields_tan):
        found = aberrations.section_mtf(lens, field, frequency_lpmm, band=band)
        for values, dashes, name in zip(found, ("-", "--"), ("T", "S"), strict=True):
            label = f"{field_name(field)} {name}"
            left.plot(frequency_lpmm, values, dashes, color=style.colour_of(number), label=label)
    curves.draw_limits(left, [diffraction_limit(lens, frequency_lpmm, band=band)], end_lpmm)
    curves.mark_frequency(left, 0.5 * double_lpmm, "LR Nyquist")
    curves.mark_frequency(left, double_lpmm, "twice that")
    curves.finish_mtf_axes(left, end_lpmm, "LP/mm", "", columns=2)
    height_mm = _heights_mm(grid, shares)
    for number, (lpmm, both) in enumerate(zip(chosen_lpmm, np.transpose(over_field), strict=True)):
        for values, dashes, name in zip(both, ("-", "--"), ("T", "S"), strict=True):
            label, colour = f"{lpmm:.3g} LP/mm {name}", style.COLOURS[-1 - number]
            right.plot(height_mm, values, dashes, color=colour, label=label)
    right.set(xlim=(0.0, height_mm[-1]), ylim=(0.0, 1.05))
    right.set_xlabel("height of the image, centre to corner (mm)")
    curves.legend_above(right, "", 3)
    title = f"{lens.name or 'lens'}: T tangential (pattern repeats along the field), S sagittal"
    figure.suptitle(title, fontsize=style.TITLE_PT)
    return figure


@style.styled()
def psf_figure(
    lens: Lens, grid: Grid, fields_tan: Sequence[Pair], *, band: Band | None = None
) -> Figure:
    """Draw images of points with the pixel around them, and the light in squares about them.

    Parameters
    ----------
    grid : of the sensor
    fields_tan : tangents (row, col) of the fields
    band : the light; the wavelength of the lens alone if None
    """
    pixel_um = 1e3 * np.asarray(grid.pitch_mm)
    largest_um = float(pixel_um.max())
    seen = [spots(lens, field, rings=_PSF_RINGS) for field in fields_tan]
    spot_um = _PSF_RADII * 1e3 * max(float(spot.rms_radius_mm) for spot in seen)
    reach_um = max(0.5 * _PSF_PIXELS * largest_um, spot_um)
    side_mm = np.linspace(0.0, 1e-3 * max(1.5 * largest_um, 2.0 * spot_um), _SIDES)
    found = [point_spread(lens, field, float(side_mm[-1]), band=band) for field in fields_tan]
    figure = style.new_figure(max(6.0, 0.8 + 2.8 * len(fields_tan)), 6.2)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.05, 1.0))[:, 0]
    panels = above.subplots(1, len(fields_tan), squeeze=False, sharey=True)[0]
    axes_below = below.subplots()
    for number, (axes, field, psf) in enumerate(zip(panels, fields_tan, found, strict=True)):
        decades = np.log10(np.maximum(psf.per_mm2 / psf.per_mm2.max(), _TINY))
        end_um = 1e3 * (psf.at_mm[-1] + 0.5 * psf.step_mm)
        shown = axes.imshow(
            decades, extent=(-end_um, end_um, end_um, -end_um), cmap="viridis", vmax=0.0,
            vmin=np.log10(_TINY),
        )  # fmt: skip
        border = images.pixel_outline(pixel_um, edgecolor="white", linewidth=1.0, linestyle="--")
        axes.add_patch(border)
        how = {"va": "top", "color": "white", "path_effects": None}
        style.note(axes, "pixel", border.get_xy(), (3.0, -3.0), **how)
        axes.set(xlim=(-reach_um, reach_um), ylim=(reach_um, -reach_um))
        axes.grid(visible=False)
        axes.set(title=field_name(field), xlabel="column (um)")
        inside = 100.0 * psf.ensquared(side_mm)
        how = {"color": style.colour_of(number), "label": field_name(field)}
        axes_below.plot(1e3 * side_mm, inside, **how)
    panels[0].set_ylabel("row (um)")
    above.colorbar(
        shown, ax=list(panels), label="irradiance over its peak", shrink=0.8,
        ticks=[-4, -3, -2, -1, 0], format=lambda power, _: f"$10^{{{power:.0f}}}$",
    )  # fmt: skip
    for um, name in ((largest_um, "pixel"), (0.5 * largest_um, "half a pixel")):
        curves.mark_frequency(axes_below, um, name)
    axes_below.set(xlim=(0.0, 1e3 * side_mm[-1]), ylim=(0.0, 102.0))
    axes_below.set_xlabel("side of a square about the centroid (um)")
    axes_below.set_ylabel("light in the square (%)")
    curves.legend_above(axes_below, "", 4)
    return figure


def _heights_mm(grid: Grid, shares: Floats) -> Floats:
    """Return how far from the middle places lie at shares of the way to the corner."""
    sides_mm = np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    return shares * float(np.hypot(*(0.5 * sides_mm)))
