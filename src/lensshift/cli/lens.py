"""`lensshift lens`: look at a lens, move an element, write what the image does."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.lens_design import budget, optimise, tolerance
from lensshift.cli.lens_field import field
from lensshift.cli.lens_refine import refine
from lensshift.cli.lens_report import report
from lensshift.cli.measured import CsvOption, PlotOption, check_outputs, write_plot, write_table
from lensshift.cli.optics import (
    PITCH_MM,
    SENSOR,
    SHIFT_PX,
    BandOption,
    ElementOption,
    LensArgument,
    MtfFigure,
    PitchOption,
    SensorOption,
    ShiftOption,
    ShowFigure,
    TemperatureOption,
    WavelengthOption,
    band_of,
    diagonal_mm,
    element_of,
    figure_of,
    mtf_figure,
    parse_fields_tan,
    read_lens,
    sensor_grid,
    show_figure,
)
from lensshift.cli.session import DebugOption, JsonOption, session
from lensshift.cli.verbs import verb_group

if TYPE_CHECKING:
    from lensshift.optics.lens import Lens

lens_verbs = verb_group()

lens_verbs.command()(field)
lens_verbs.command()(optimise)
lens_verbs.command()(refine)
lens_verbs.command()(tolerance)
lens_verbs.command()(budget)
lens_verbs.command()(report)


FieldOption = Annotated[
    list[str] | None,
    typer.Option("--field-deg", help="Field as row,col in degrees; repeatable. 0,0 and 1.6,6.5."),
]
HighestOption = Annotated[
    float | None,
    typer.Option("--highest-lpmm", min=0.1, help="End of the curves; 2.5 times LR Nyquist if not."),
]
FastOption = Annotated[
    bool, typer.Option("--fast", help="Geometric times diffraction MTF instead of the exact one.")
]
ShowOption = Annotated[ShowFigure, typer.Option("--figure", help="What --plot draws.")]
MtfFigureOption = Annotated[MtfFigure, typer.Option("--figure", help="What --plot draws.")]

_CURVE_STEPS, _CURVES_NYQUIST = 80, 2.5


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


@lens_verbs.command()
def show(
    lens: LensArgument,
    element: ElementOption = 1,
    shift_px: ShiftOption = SHIFT_PX,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    wavelength_nm: WavelengthOption = None,
    temperature_c: TemperatureOption = None,
    figure: ShowOption = ShowFigure.LAYOUT,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Show a lens: its elements, its paraxial data, the travel of one element for a shift.

    \b
    Example:
      lensshift lens show petzval_b --element 1 --plot lens.svg
      lensshift lens show petzval_b --figure spots --plot spots.png
      lensshift lens show petzval_b --figure fans --plot fans.png
    """
    with session(as_json=as_json, debug=debug, doing="tracing the lens") as current:
        from lensshift.optics.paraxial import decenter_gains, focal_length_mm, paraxial

        check_outputs([], None, plot)
        model = read_lens(lens, wavelength_nm, temperature_c)
        grid, moved = sensor_grid(sensor, pitch_mm), element_of(model, element)
        data = paraxial(model)
        gains = decenter_gains(model)
        current.say(f"{model.name or lens}, {model.wavelength_nm:g} nm, {model.temperature_c:g} C")
        rows = []
        for number, (part, indices) in enumerate(
            zip(model.elements, model.indices(), strict=True), start=1
        ):
            focal_mm, gain = focal_length_mm(part, indices), float(gains[number - 1])
            gap_mm = model.gaps_mm[number - 1]
            current.say(
                f"  {number} {part.name or 'element':<18.18} f {focal_mm:9.3f} mm, "
                f"{part.length_mm:6.3f} mm {' + '.join(part.glass):<12} "
                f"then {gap_mm:8.3f} mm air, image moves {gain:+.4f} mm per mm"
            )
            rows.append({"name": part.name, "focal_length_mm": focal_mm, "gap_mm": gap_mm})
            rows[-1] |= {"length_mm": part.length_mm, "glass": part.glass, "gain": gain}
        for name, value in asdict(data).items():
            unit = " mm" if name.endswith("_mm") else ""
            label = name.removesuffix("_mm").replace("_", " ")
            current.say(f"{label:<28}{value + 0.0:.6g}{unit}")
        travel_mm = diagonal_mm(model, moved, shift_px, grid)
        current.say(
            f"{f'travel for {shift_px:g} px':<28}{1e3 * travel_mm[1]:.2f} um of element {element} "
            f"along columns, {1e3 * travel_mm[0]:.2f} um along rows"
        )
        current.result |= {"lens": model.name or lens, "elements": rows, **asdict(data)}
        current.result |= {"element": element, "shift_px": shift_px, "travel_mm": travel_mm}
        write_plot(
            current,
            plot,
            lambda: show_figure(figure, model, moved, travel_mm, grid),
        )


@lens_verbs.command()
def mtf(
    lens: LensArgument,
    element: ElementOption = 1,
    shift_px: ShiftOption = SHIFT_PX,
    field_deg: FieldOption = None,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    highest_lpmm: HighestOption = None,
    band_nm: BandOption = 0.0,
    fast: FastOption = False,
    wavelength_nm: WavelengthOption = None,
    temperature_c: TemperatureOption = None,
    csv: CsvOption = None,
    figure: MtfFigureOption = MtfFigure.CURVES,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
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
    with session(as_json=as_json, debug=debug, doing="tracing the lens") as current:
        import numpy as np

        from lensshift.optics.mtf import diffraction_limit

        check_outputs([], csv, plot)
        model = read_lens(lens, wavelength_nm, temperature_c)
        grid, moved = sensor_grid(sensor, pitch_mm), element_of(model, element)
        fields_tan = parse_fields_tan(field_deg)
        travel_mm = diagonal_mm(model, moved, shift_px, grid)
        band = band_of(model, band_nm)
        nyquist_lpmm = 0.5 / max(grid.pitch_mm)
        highest = highest_lpmm or _CURVES_NYQUIST * nyquist_lpmm
        frequency = np.linspace(0.0, highest, _CURVE_STEPS + 1)
        frequency = np.unique([*frequency, nyquist_lpmm, 2 * nyquist_lpmm])
        curves = _curves(model, moved, travel_mm, fields_tan, frequency, band, fast)
        at = {
            label: np.interp([nyquist_lpmm, 2 * nyquist_lpmm], frequency, values)
            for label, values in curves.items()
        }
        current.say(f"{'':<42}{nyquist_lpmm:8.3f}  {2 * nyquist_lpmm:8.3f} LP/mm")
        for label, (low, high) in at.items():
            current.say(f"{label:<42}{low:8.4f}  {high:8.4f}")
        limit = diffraction_limit(model, frequency)
        low, high = np.interp([nyquist_lpmm, 2 * nyquist_lpmm], frequency, limit.modulation)
        current.say(f"{'diffraction limit':<42}{low:8.4f}  {high:8.4f}")
        current.result |= {"lens": model.name or lens, "nyquist_lpmm": nyquist_lpmm}
        current.result |= {"travel_mm": travel_mm, "frequency_lpmm": frequency}
        current.result |= {"mtf": curves, "diffraction_limit": limit.modulation}
        columns = {"frequency_lpmm": frequency, **curves, "diffraction limit": limit.modulation}
        write_table(current, csv, {name.replace(",", ";"): row for name, row in columns.items()})
        write_plot(
            current,
            plot,
            lambda: mtf_figure(figure, model, moved, travel_mm, grid, fields_tan, highest),
        )


def _curves(
    model: Lens,
    element: int,
    travel_mm: tuple[float, float],
    fields_tan: list[tuple[float, float]],
    frequency_lpmm: Any,
    band: Any,
    fast: bool,
) -> dict[str, Any]:
    """Return the MTF curves by field, direction and position of the element."""
    import numpy as np

    from lensshift.optics.mtf import AZIMUTHS_RAD, fast_mtf
    from lensshift.optics.otf import exact_otf
    from lensshift.optics.shift import moving

    curves = {}
    for row_tan, col_tan in fields_tan:
        row_deg, col_deg = np.rad2deg(np.arctan([row_tan, col_tan]))
        for name, build in (
            ("at rest", None),
            ("moved", moving(model, element, np.asarray(travel_mm))),
        ):
            if fast:
                found = fast_mtf(model, (row_tan, col_tan), frequency_lpmm, build=build, band=band)
            else:
                field = (row_tan, col_tan)
                found = np.abs(exact_otf(model, field, frequency_lpmm, build=build, band=band))
            for direction, values in zip(("columns", "rows"), found, strict=True):
                label = f"{row_deg:.1f}/{col_deg:.1f} deg, along {direction}, {name}"
                curves[label] = values
    if len(AZIMUTHS_RAD) != 2:  # the names above are those of two directions
        raise ValueError(f"expected two directions, got {len(AZIMUTHS_RAD)}")
    return curves


@lens_verbs.command()
def which(
    lens: LensArgument,
    shift_px: ShiftOption = SHIFT_PX,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    wavelength_nm: WavelengthOption = None,
    temperature_c: TemperatureOption = None,
    csv: CsvOption = None,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Compare what can move: each element decentred or tilted, a tilted plate, the sensor.

    Stroke, evenness of the shift, cross-talk between the axes, MTF. The least MTF is that over the
    centre, edges and corners, two directions and four diagonal moves, without refocus; px per um
    is shift over stroke at the centre of the sensor, gain the same in mm per mm for paraxial rays.

    \b
    Example:
      lensshift lens which petzval_a
    """
    with session(as_json=as_json, debug=debug, doing="tracing the lens") as current:
        from lensshift.optics.movers import which_mover
        from lensshift.optics.which import format_movers

        check_outputs([], csv, plot)
        model = read_lens(lens, wavelength_nm, temperature_c)
        movers = which_mover(model, sensor_grid(sensor, pitch_mm), shift_px=shift_px)
        current.say(format_movers(movers))
        rows = [asdict(mover) | {"element": mover.element + 1} for mover in movers]
        current.result |= {"lens": model.name or lens, "movers": rows}
        write_table(current, csv, {name: [row[name] for row in rows] for name in rows[0]})
        write_plot(current, plot, lambda: figure_of("lenses", "which_figure", movers))


@lens_verbs.command()
def convert(
    source: Annotated[str, typer.Argument(help="Lens file (.toml, .zmx) or built-in lens.")],
    target: Annotated[Path, typer.Argument(help="File to write, .toml or .zmx.")],
    glass_catalogue: Annotated[
        list[Path] | None,
        typer.Option("--glass-catalogue", help="Glasses of a maker (.agf); repeatable."),
    ] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Convert a lens between lens files (TOML) and sequential Zemax files.

    A TOML file brings the glasses of a catalogue with it, so that other commands need none.

    \b
    Example:
      lensshift lens convert petzval_a petzval_a.zmx
      lensshift lens convert bought.zmx bought.toml --glass-catalogue maker.agf
    """
    with session(as_json=as_json, debug=debug, doing="tracing the lens") as current:
        from lensshift.optics.agf import load_glass_catalogue
        from lensshift.optics.lens_file import save_lens
        from lensshift.optics.zmx_writer import save_zmx

        writers = {".toml": save_lens, ".zmx": save_zmx}
        writer = writers.get(target.suffix.lower())
        if writer is None:
            raise typer.BadParameter(f"expected {target} to end in {' or '.join(writers)}")
        check_outputs([Path(source)], target, None)
        for catalogue in glass_catalogue or []:
            load_glass_catalogue(catalogue)
        model = read_lens(source)
        writer(model, target)
        current.result |= {"source": source, "target": target, "elements": len(model.elements)}
        current.say(f"wrote {target}: {len(model.elements)} elements")
