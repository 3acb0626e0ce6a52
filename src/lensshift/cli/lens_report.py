"""`lensshift lens report`: everything that is known of a lens on one page."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensshift.cli import optics, outputs
from lensshift.cli.session import Session
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
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
