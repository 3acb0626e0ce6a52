"""`lensshift lens field` and `report`: what a trace knows, for `reconstruct` and on one page."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from dataclasses import field as group
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensshift.cli import optics, outputs
from lensshift.cli.inputs import PatternOption, check_netcdf
from lensshift.cli.session import Progress, Session
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
    from lensshift.core.lens_field import LensField
    from lensshift.optics.lens import Lens
    from lensshift.optics.mtf import Band
    from lensshift.report.page import Page

_SHARES = (0.0, 0.7, 1.0)  # of the way from the centre to the corner
_FIGURES = {
    "layout": "The section along columns, to scale.",
    "sections": "MTF with diffraction, without the pixels.",
    "fans": "Where rays land against the chief ray, over their place in the stop.",
    "field": "Where both sections focus, distortion, and light on the sensor.",
    "psf": "Images of points with diffraction, and how much of their light squares hold.",
    "spots": "Spots of rays at rest and moved.",
    "map": "MTF of every pixel at rest and moved.",
    "distortion": "Distortion.",
}


@dataclass(frozen=True, slots=True)
class _ReportOptions:
    of: optics.MovedLensOptions
    out: Path | None = option(None, "Page to write (.html).", "-o")
    band_nm: optics.BandOption = None


@verb("examining the lens")
def report(current: Session, asked: _ReportOptions) -> None:
    """Examine a lens: sharpness, focus, light and distortion over the field, with all figures.

    For each field: MTF along it (T) and across (S), where both focus, the light in a pixel and in
    half of one, illumination, distortion, the spot. The page adds the figures and a comparison of
    what can move.

    \b
    Example:
      lensshift lens report petzval_a -o petzval_a.html
      lensshift lens report petzval_b --band-nm 40 --json
    """
    out, shift_px = asked.out, asked.of.shift_px
    outputs.check([Path(asked.of.lens)], out)
    if out is not None and out.suffix.lower() != ".html":
        raise typer.BadParameter(f"expected a page that ends in .html, got {out}")
    model, grid, moved = optics.opened_moving(asked.of)
    band = optics.band_of(model.wavelength_nm, asked.band_nm)
    fields_tan = optics.spread_fields_tan(model, grid, _SHARES)
    rows = [_row(model, grid, field, band) for field in fields_tan]
    for name in rows[0]:
        values = [row[name] if isinstance(row[name], str) else f"{row[name]:.4g}" for row in rows]
        current.say(f"{name:<32}" + "".join(f"{value:>12}" for value in values))
    current.result |= {"lens": model.name or asked.of.lens, "fields": rows}
    if out is not None:
        page = _page(model, asked.of.lens, shift_px, grid, band)
        page.heading("Over the field")
        page.table(rows)
        page.heading("Figures")
        travel_mm = optics.diagonal_mm(model, moved, shift_px, grid)
        figures = optics.lens_figures(model, moved, travel_mm, grid, fields_tan, band=band)
        for kind, caption in _FIGURES.items():
            name, of, options = figures[kind]
            page.figure(outputs.drawn(name, *of, **options), caption)
        page.save(out)
        current.wrote(out)


def _row(lens: Lens, grid: Grid, field_tan: Any, band: Band | None) -> dict[str, Any]:
    """Return the numbers of one field."""
    import numpy as np

    from lensshift.optics.aberrations import focal_surfaces, relative_illumination, section_mtf
    from lensshift.optics.psf import ensquared_energy
    from lensshift.optics.spots import spots

    row_deg, col_deg = (math.degrees(math.atan(tangent)) for tangent in field_tan)
    at_lpmm = np.array([0.5, 1.0]) / max(grid.pitch_mm)
    focus = focal_surfaces(lens, field_tan)
    sides_mm = np.array([0.5, 1.0]) * min(grid.pitch_mm)
    half, whole = ensquared_energy(lens, field_tan, sides_mm, band=band)
    both = zip(at_lpmm, section_mtf(lens, field_tan, at_lpmm, band=band).T, strict=True)
    modulation = {
        f"MTF {section} at {lpmm:.3g} LP/mm": float(value)
        for lpmm, found in both
        for section, value in zip("TS", found, strict=True)
    }
    return {
        "field, row/column (degrees)": f"{abs(row_deg):.2f}/{abs(col_deg):.2f}",
        **modulation,
        "focus T behind the sensor (mm)": float(focus.tangential_mm),
        "focus S behind the sensor (mm)": float(focus.sagittal_mm),
        "light in half a pixel (%)": 100.0 * float(half),
        "light in a pixel (%)": 100.0 * float(whole),
        "illumination (%)": 100.0 * float(relative_illumination(lens, field_tan)),
        "spot (um rms)": 1e3 * float(spots(lens, field_tan).rms_radius_mm),
    }


def _page(model: Lens, name: str, shift_px: float, grid: Grid, band: Band | None) -> Page:
    """Return the page with the first-order data, the elements and what can move."""
    from lensshift.optics.aberrations import petzval_curvature_per_mm
    from lensshift.optics.movers import which_mover
    from lensshift.optics.paraxial import focal_length_mm, paraxial
    from lensshift.optics.which import label_of
    from lensshift.report.page import Page

    page = Page(f"Lens: {model.name or name}")
    rows, cols = grid.shape
    light = f"{model.wavelength_nm:g} nm" + ("" if band is None else " with the band given")
    page.text(
        f"{light}, {model.temperature_c:g} C, sensor of {cols} x {rows} pixels of "
        f"{grid.pitch_mm[0]:g} x {grid.pitch_mm[1]:g} mm, object at {model.object_mm:g} mm."
    )
    data = asdict(paraxial(model))
    data["petzval_radius_mm"] = 1.0 / (petzval_curvature_per_mm(model) or math.inf)
    page.table([
        {"first order": key.removesuffix("_mm").replace("_", " "), "value": float(value),
         "unit": "mm" if key.endswith("_mm") else ""}
        for key, value in data.items()
    ])  # fmt: skip
    page.heading("Elements")
    parts = zip(model.elements, model.indices(), model.gaps_mm, strict=True)
    page.table([
        {"element": number, "name": part.name, "glass": " + ".join(part.glass),
         "focal length (mm)": focal_length_mm(part, indices), "thickness (mm)": part.length_mm,
         "air behind it (mm)": gap_mm}
        for number, (part, indices, gap_mm) in enumerate(parts, start=1)
    ])  # fmt: skip
    page.heading(f"What can move the image by {shift_px:g} px along both axes")
    page.table([
        {"what moves": label_of(mover), "stroke": mover.stroke_text,
         "error of the shift (px)": mover.max_shift_error_px,
         "cross-talk (px)": mover.cross_talk_px, "least MTF at rest": mover.mtf_centred,
         "moved": mover.mtf_moved, "loss": mover.mtf_loss}
        for mover in which_mover(model, grid, shift_px=shift_px)
    ])  # fmt: skip
    return page


@dataclass(frozen=True, slots=True)
class _FieldOptions:
    lens: optics.LensArgument
    element: int | None = option(None, f"{optics.ELEMENT_HELP} 0: the sensor moves.", min=0)
    tilt: bool = option(False, "The element tilts, as a plate does.", "--tilt")
    sensor: str | None = option(None, f"Pixels as columns x rows; default: {optics.SENSOR}.")
    pitch_mm: str | None = option(
        None, f"Pixel pitch: one number, or row,col; default: {optics.PITCH_MM}."
    )
    burst: Path | None = option(None, "Take sensor and pitch from this burst.")
    reach_px: float | None = option(None, "Largest shift that it has to hold for; default: 1.")
    out: Path | None = option(None, "Lens field to write (.nc).", "-o")
    pattern: PatternOption = "square"
    light: optics.LightOptions = group(default_factory=optics.LightOptions)
    to: outputs.Outputs = group(default_factory=outputs.Outputs)


@verb()
def field(current: Session, asked: _FieldOptions) -> None:
    """Fit how shift and blur vary over the sensor while an element moves.

    The file holds polynomials over the sensor and the place of the element; `reconstruct
    --lens-field` evaluates them for the frames of any burst of this lens, whatever its pattern, and
    refuses a burst that it is not of. What is printed, drawn and tabled is for --pattern.

    \b
    Examples:
      lensshift lens field petzval_b --element 1 -o field.nc
      lensshift reconstruct burst.nc --lens-field field.nc
      lensshift lens field plate.toml --element 4 --tilt --burst burst.nc -o field.nc
    """
    from lensshift.core.pattern import named_pattern_px
    from lensshift.io import save_lens_field
    from lensshift.optics.field import lens_field

    out, reach_px = asked.out, asked.reach_px
    if out is not None:
        check_netcdf(out, "a lens field")
    outputs.check([asked.burst, Path(asked.lens)], out, asked.to.csv, plot=asked.to.plot)
    wanted_px = named_pattern_px(asked.pattern)
    if reach_px is not None and reach_px < abs(wanted_px).max():
        raise typer.BadParameter(
            f"--reach-px {reach_px:g} is less than the {abs(wanted_px).max():.3g} px of the "
            f"pattern {asked.pattern}"
        )
    model = optics.read_lens(asked.lens, asked.light)
    if asked.tilt and asked.element == 0:
        raise typer.BadParameter("--tilt is of an element, counted from 1, not of the sensor")
    moved = None if asked.element == 0 else optics.element_of(model, asked.element)
    grid = _grid(asked)
    with Progress("tracing") as progress:
        told: dict[str, Any] = {"motion": "tilt" if asked.tilt else None, "reach_px": reach_px}
        found = lens_field(model, grid, moved, on_progress=progress.count, **told)
    found = replace(found, lens=found.lens or Path(asked.lens).stem)
    if out is not None:
        save_lens_field(found, out)
    _say(current, found, wanted_px, asked.to.csv, asked.to.plot)
    if out is not None:
        current.wrote(out)


def _grid(asked: _FieldOptions) -> Grid:
    if asked.burst is None:
        return optics.sensor_grid(
            optics.SensorOptions(asked.sensor or optics.SENSOR, asked.pitch_mm or optics.PITCH_MM)
        )
    if asked.sensor is not None or asked.pitch_mm is not None:
        raise typer.BadParameter("--burst says what --sensor and --pitch-mm say; give one of both")
    from lensshift.io import load_burst

    return load_burst(asked.burst).grid


def say_field(current: Session, found: LensField) -> None:
    """Print what a lens field is of and how well it is fitted."""
    rows, cols = found.grid.shape
    pitch_mm, scale = found.grid.pitch_mm, (1e3 if found.unit == "mm" else 1.0)
    unit = "um" if found.unit == "mm" else found.unit
    number = None if found.element is None else found.element + 1
    what = f"{found.motion} of element {number}" if number else "shift of the sensor"
    current.say(
        f"{found.lens}, {what}, {cols} x {rows} pixels of {pitch_mm[0]:g} x {pitch_mm[1]:g} mm"
    )
    current.say(
        f"holds to {scale * found.reach[0]:.4g} {unit} along rows, "
        f"{scale * found.reach[1]:.4g} {unit} along columns"
    )
    current.say(
        f"fit: shift {found.shift_error_px:.1e} px, width of the spot {found.spot_error_px:.1e} "
        f"px, contrast of a spot of such moments {found.contrast_error:.3f} (largest errors)"
    )
    current.result["element"] = number
    current.tell(found.grid, "shape pitch_mm")
    current.tell(found, "lens motion reach unit shift_error_px spot_error_px contrast_error")


def _say(
    current: Session, found: LensField, wanted_px: Any, csv: Path | None, plot: Path | None
) -> None:
    import numpy as np

    from lensshift.optics.shift import shift_uniformity

    say_field(current, found)
    state = found.states(wanted_px)
    shown = found.at(state)
    spot_px2 = np.asarray(shown.spot_px2)
    spot_px = np.sqrt(spot_px2[..., :2])
    even = shift_uniformity(shown, wanted_px)
    unit = "um" if found.unit == "mm" else "mrad"
    for number, (wish, moved, one) in enumerate(zip(wanted_px, 1e3 * state, even, strict=True)):
        corner = spot_px[number, 0, 0]
        middle = spot_px[number, spot_px.shape[1] // 2, spot_px.shape[2] // 2]
        current.say(
            f"shift ({wish[0]:+.3f}, {wish[1]:+.3f}) px: travel ({moved[0]:+.2f}, {moved[1]:+.2f}) "
            f"{unit}, error over the sensor at most {one.max_error_px:.4f} px, "
            f"{one.rms_error_px:.4f} px rms; spot {middle[0]:.3f} x {middle[1]:.3f} px in the "
            f"middle, {corner[0]:.3f} x {corner[1]:.3f} px in the first corner"
        )
    current.result |= {"wanted_px": wanted_px, "travel": state}
    current.result["uniformity"] = [asdict(one) for one in even]
    frame, row, col = np.indices(shown.offset_px.shape[:3]).reshape(3, -1)
    columns: dict[str, Any] = {"frame": frame, "row": row, "col": col}
    for name, values in (("offset", shown.offset_px), ("spot", spot_px)):
        columns |= {f"{name}_row_px": values[..., 0].ravel()}
        columns |= {f"{name}_col_px": values[..., 1].ravel()}
    if spot_px2.shape[-1] == 3:
        columns["spot_covariance_px2"] = spot_px2[..., 2].ravel()
    outputs.write_table(current, csv, columns)
    outputs.write_plot(current, plot, "lens_maps.shift_map_figure", shown, found.grid, wanted_px)
