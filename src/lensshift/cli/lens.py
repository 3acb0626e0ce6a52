"""`lensshift lens`: look at a lens, move an element, write what the image does."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import product
from pathlib import Path
from typing import Literal

from lensshift.cli import optics, outputs
from lensshift.cli.lens_design import budget, check_out, optimise, tolerance, write_lens
from lensshift.cli.lens_refine import refine
from lensshift.cli.lens_report import field as lens_field
from lensshift.cli.lens_report import report
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import argument, option, verb, verb_group

lens_verbs = verb_group()

for one in (lens_field, optimise, refine, tolerance, budget, report):
    lens_verbs.command()(one)


_CURVE_STEPS, _CURVES_NYQUIST = 80, 2.5  # as on the axis of the figure: beyond twice Nyquist


@lens_verbs.callback()
def group() -> None:
    """Design a lens with a moving element, and see what moving it does.

    Built-in lenses: petzval_a and petzval_b (two reconstructions of a published Petzval lens from
    stock parts), petzval_search, wide_940 (320 x 240 pixels, f/1.2), and single stock lenses such
    as al2550.

    \b
    Example:
      lensshift lens show petzval_a --plot lens.png
      lensshift lens field petzval_a --element 1 -o field.nc
    """


@dataclass(frozen=True, slots=True)
class _ShowOptions:
    of: optics.MovedLensOptions
    figure: Literal["layout", "spots", "distortion", "fans", "psf", "field"] = option(
        "layout", "What --plot draws."
    )
    plot: outputs.PlotOption = None


@lens_verbs.command()
@verb("tracing the lens")
def show(current: Session, asked: _ShowOptions) -> None:
    """Show a lens: its elements, its paraxial data, the travel of one element for a shift.

    \b
    Example:
      lensshift lens show petzval_b --element 1 --plot lens.svg
      lensshift lens show petzval_b --figure spots --plot spots.png
      lensshift lens show petzval_b --figure fans --plot fans.png
    """
    from lensshift.optics.paraxial import decenter_gains, focal_length_mm, paraxial

    outputs.check([Path(asked.of.lens)], plot=asked.plot)
    model, grid, moved = optics.opened_moving(asked.of)
    element, shift_px = moved + 1, asked.of.shift_px
    data = paraxial(model)
    gains = decenter_gains(model)
    current.say(
        f"{model.name or asked.of.lens}, {model.wavelength_nm:g} nm, {model.temperature_c:g} C"
    )
    rows = []
    parts = zip(model.elements, model.indices(), model.gaps_mm, gains.tolist(), strict=True)
    for number, (part, indices, gap_mm, gain) in enumerate(parts, start=1):
        focal_mm = focal_length_mm(part, indices)
        current.say(
            f"  {number} {part.name or 'element':<18.18} f {focal_mm:9.3f} mm, "
            f"{part.length_mm:6.3f} mm {' + '.join(part.glass):<12} "
            f"then {gap_mm:8.3f} mm air, image moves {gain:+.4f} mm per mm"
        )
        row = picked(part, "name length_mm glass") | {"focal_length_mm": focal_mm}
        rows.append(row | {"gap_mm": gap_mm, "gain": gain})
    for name, value in asdict(data).items():
        unit = " mm" if name.endswith("_mm") else ""
        label = name.removesuffix("_mm").replace("_", " ")
        current.say(f"{label:<28}{value + 0.0:.6g}{unit}")
    away_mm = model.gaps_mm[-1] - data.image_mm
    current.say(f"{'sensor':<28}{model.gaps_mm[-1]:.6g} mm, {away_mm:+.4g} mm from the image")
    heading = f"{f'travel for {shift_px:g} px':<28}"
    try:
        travel_mm = optics.diagonal_mm(model, moved, shift_px, grid)
    except ValueError as error:  # as where the pixels are not those of this lens
        if asked.plot is not None:
            raise
        current.say(f"{heading}none, with pixels of {grid.pitch_mm[1]:g} mm (--pitch-mm): {error}")
        current.result["travel_mm"] = None
    else:
        current.say(
            f"{heading}{1e3 * travel_mm[1]:.2f} um of element {element} along columns, "
            f"{1e3 * travel_mm[0]:.2f} um along rows"
        )
        current.result["travel_mm"] = travel_mm
    current.result |= {"lens": model.name or asked.of.lens, "elements": rows, **asdict(data)}
    current.result |= {"element": element, "shift_px": shift_px}
    if asked.plot is not None:
        fields_tan = optics.spread_fields_tan(model, grid, (0.0, 0.5, 1.0))
        figures = optics.lens_figures(model, moved, travel_mm, grid, fields_tan)
        name, of, options = figures[asked.figure]
        outputs.write_plot(current, asked.plot, name, *of, **options)


@dataclass(frozen=True, slots=True)
class _MtfOptions:
    of: optics.MovedLensOptions
    field_deg: list[str] | None = option(
        None, "Field as row,col in degrees; repeatable. 0,0 and 1.6,6.5."
    )
    highest_lpmm: float | None = option(None, "End of the curves; 2.5 times LR Nyquist if not.")
    band_nm: optics.BandOption = None
    fast: bool = option(False, "Geometric times diffraction MTF instead of the exact one.")
    csv: outputs.CsvOption = None
    figure: Literal["curves", "field", "focus", "sections"] = option("curves", "What --plot draws.")
    plot: outputs.PlotOption = None


@lens_verbs.command()
@verb("tracing the lens")
def mtf(current: Session, asked: _MtfOptions) -> None:
    """Compute the MTF of a lens, at rest and with one element moved.

    Along columns and along rows at every field; the moved element shifts the image by --shift-px
    along both axes. The table gives LR Nyquist and twice that; the CSV file the whole curves.

    \b
    Example:
      lensshift lens mtf petzval_a --element 1 --plot mtf.png
      lensshift lens mtf petzval_b --field-deg 0,0 --field-deg 0,6.5 --band-nm 40
      lensshift lens mtf petzval_b --figure focus --plot focus.png
      lensshift lens mtf petzval_b --figure sections --plot sections.png
    """
    import numpy as np

    from lensshift.optics.mtf import fast_mtf
    from lensshift.optics.otf import diffraction_limit, exact_otf
    from lensshift.optics.shift import moving

    outputs.check([Path(asked.of.lens)], asked.csv, plot=asked.plot)
    model, grid, moved = optics.opened_moving(asked.of)
    fields_tan = optics.parse_fields_tan(asked.field_deg)
    travel_mm = optics.diagonal_mm(model, moved, asked.of.shift_px, grid)
    band = optics.band_of(model.wavelength_nm, asked.band_nm)
    nyquist_lpmm = 0.5 / max(grid.pitch_mm)
    highest = asked.highest_lpmm or _CURVES_NYQUIST * nyquist_lpmm
    frequency = np.linspace(0.0, highest, _CURVE_STEPS + 1)
    frequency = np.unique([*frequency, nyquist_lpmm, 2 * nyquist_lpmm])
    mtf_of, curves = (fast_mtf if asked.fast else exact_otf), {}
    states = {"at rest": None, "moved": moving(model, moved, np.asarray(travel_mm))}
    for field_tan, (name, build) in product(fields_tan, states.items()):
        row_deg, col_deg = np.rad2deg(np.arctan(field_tan))
        found = np.abs(mtf_of(model, field_tan, frequency, build=build, band=band))
        for direction, values in zip(("columns", "rows"), found, strict=True):
            curves[f"{row_deg:.1f}/{col_deg:.1f} deg, along {direction}, {name}"] = values
    limit = diffraction_limit(model, frequency, band=band).modulation
    current.say(f"{'':<42}{nyquist_lpmm:8.3f}  {2 * nyquist_lpmm:8.3f} LP/mm")
    for label, values in (curves | {"diffraction limit": limit}).items():
        low, high = np.interp([nyquist_lpmm, 2 * nyquist_lpmm], frequency, values)
        current.say(f"{label:<42}{low:8.4f}  {high:8.4f}")
    current.result |= {"lens": model.name or asked.of.lens, "nyquist_lpmm": nyquist_lpmm}
    current.result |= {"travel_mm": travel_mm, "frequency_lpmm": frequency}
    current.result |= {"mtf": curves, "diffraction_limit": limit}
    table = {"frequency_lpmm": frequency, **curves, "diffraction limit": limit}
    columns = {name.replace(",", ";"): values for name, values in table.items()}
    outputs.write_table(current, asked.csv, columns)
    figures = optics.lens_figures(model, moved, travel_mm, grid, fields_tan, highest_lpmm=highest)
    drawn, of, options = figures["map" if asked.figure == "field" else asked.figure]
    outputs.write_plot(current, asked.plot, drawn, *of, **options)


@dataclass(frozen=True, slots=True)
class _WhichOptions:
    of: optics.LensOptions
    shift_px: float = option(optics.SHIFT_PX, "Shift of the image along both axes, in pixels.")
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


@lens_verbs.command()
@verb("tracing the lens")
def which(current: Session, asked: _WhichOptions) -> None:
    """Compare what can move: each element decentred or tilted, a tilted plate, the sensor.

    Stroke, evenness of the shift, cross-talk between the axes, MTF. The least MTF is that over the
    centre, edges and corners, four directions and four diagonal moves, without refocus; px per um
    is shift over stroke at the centre of the sensor, gain the same in mm per mm.

    \b
    Example:
      lensshift lens which petzval_a
    """
    from lensshift.optics.movers import which_mover
    from lensshift.optics.which import format_movers

    outputs.check([Path(asked.of.lens)], asked.to.csv, plot=asked.to.plot)
    model, grid = optics.opened(asked.of)
    movers = which_mover(model, grid, shift_px=asked.shift_px)
    current.say(format_movers(movers))
    rows = [asdict(mover) | {"element": mover.element + 1} for mover in movers]
    current.result |= {"lens": model.name or asked.of.lens, "movers": rows}
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    outputs.write_table(current, asked.to.csv, columns)
    outputs.write_plot(current, asked.to.plot, "lenses.which_figure", movers)


@dataclass(frozen=True, slots=True)
class _ConvertOptions:
    source: str = argument("Lens file (.toml, .zmx) or built-in lens.")
    target: Path = argument("File to write, .toml or .zmx.")
    glass_catalogue: list[Path] | None = option(None, "Glasses of a maker (.agf); repeatable.")


@lens_verbs.command()
@verb("tracing the lens")
def convert(current: Session, asked: _ConvertOptions) -> None:
    """Convert a lens between lens files (TOML) and sequential Zemax files.

    A TOML file brings the glasses of a catalogue with it, so that other commands need none.

    \b
    Example:
      lensshift lens convert petzval_a petzval_a.zmx
      lensshift lens convert bought.zmx bought.toml --glass-catalogue maker.agf
    """
    from lensshift.optics.agf import load_glass_catalogue

    source, target = asked.source, asked.target
    check_out(target, Path(source))
    for catalogue in asked.glass_catalogue or []:
        load_glass_catalogue(catalogue)
    model = optics.read_lens(source)
    write_lens(model, target)
    current.result |= {"source": source, "target": target, "elements": len(model.elements)}
    current.say(f"wrote {target}: {len(model.elements)} elements")
