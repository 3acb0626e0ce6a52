"""`lensshift lens field`: what a trace knows of shift and blur, as a file for `reconstruct`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import Pattern, PatternOption, refuse_overwriting
from lensshift.cli.measured import CsvOption, PlotOption, check_outputs, write_plot, write_table
from lensshift.cli.optics import (
    PITCH_MM,
    SENSOR,
    LensArgument,
    TemperatureOption,
    WavelengthOption,
    element_of,
    figure_of,
    read_lens,
    sensor_grid,
)
from lensshift.cli.session import DebugOption, JsonOption, Session, session

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
    from lensshift.core.lens_field import LensField, Motion

MovingOption = Annotated[
    int, typer.Option("--element", min=0, help="Element that moves, from 1; 0: the sensor moves.")
]
TiltOption = Annotated[bool, typer.Option("--tilt", help="The element tilts, as a plate does.")]
BurstOption = Annotated[
    Path | None, typer.Option("--burst", help="Take sensor and pitch from this burst.")
]
SensorOption = Annotated[
    str | None, typer.Option("--sensor", help=f"Pixels as columns x rows; default: {SENSOR}.")
]
PitchOption = Annotated[
    str | None,
    typer.Option("--pitch-mm", help=f"Pixel pitch: one number, or row,col; default: {PITCH_MM}."),
]
ReachOption = Annotated[
    float | None,
    typer.Option("--reach-px", min=0.0, help="Largest shift that it has to hold for; default: 1."),
]
OutOption = Annotated[Path | None, typer.Option("-o", "--out", help="Lens field to write (.nc).")]


def field(
    lens: LensArgument,
    element: MovingOption = 1,
    tilt: TiltOption = False,
    sensor: SensorOption = None,
    pitch_mm: PitchOption = None,
    burst: BurstOption = None,
    reach_px: ReachOption = None,
    out: OutOption = None,
    pattern: PatternOption = Pattern.SQUARE,
    wavelength_nm: WavelengthOption = None,
    temperature_c: TemperatureOption = None,
    csv: CsvOption = None,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
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
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.core.pattern import named_pattern_px
        from lensshift.io import save_lens_field
        from lensshift.optics.field import lens_field

        _check_out(out, burst, lens)
        check_outputs([], csv, plot)
        wanted_px = named_pattern_px(pattern.value)
        if reach_px is not None and reach_px < abs(wanted_px).max():
            raise typer.BadParameter(
                f"--reach-px {reach_px:g} is less than the {abs(wanted_px).max():.3g} px of the "
                f"pattern {pattern.value}"
            )
        model = read_lens(lens, wavelength_nm, temperature_c)
        if tilt and not element:
            raise typer.BadParameter("--tilt is of an element, counted from 1, not of the sensor")
        moved = element_of(model, element) if element else None
        motion: Motion | None = "tilt" if tilt else None
        grid = _grid(sensor, pitch_mm, burst)
        found = lens_field(model, grid, moved, motion=motion, reach_px=reach_px)
        if not found.lens:
            found = _named(found, Path(lens).stem)
        if out is not None:
            save_lens_field(found, out)
        _say(current, found, wanted_px, csv, plot)
        if out is not None:
            current.say(f"wrote {out}")
            current.result["files"] = [out]


def _named(field: LensField, name: str) -> LensField:
    from dataclasses import replace

    return replace(field, lens=name)


def _grid(sensor: str | None, pitch_mm: str | None, burst: Path | None) -> Grid:
    if burst is None:
        return sensor_grid(sensor or SENSOR, pitch_mm or PITCH_MM)
    if sensor is not None or pitch_mm is not None:
        raise typer.BadParameter("--burst says what --sensor and --pitch-mm say; give one of both")
    from lensshift.io import load_burst

    return load_burst(burst).grid


def _check_out(out: Path | None, burst: Path | None, lens: str) -> None:
    """Complain before the work about a name that cannot be written."""
    if out is None:
        return
    from lensshift.io.atomic import writable_target

    if out.suffix.lower() != ".nc":
        raise typer.BadParameter(f"expected a lens field that ends in .nc, got {out}")
    refuse_overwriting((burst, Path(lens)), [out])
    writable_target(out)


def say_field(current: Session, found: LensField) -> None:
    """Print what a lens field is of and how well it is fitted."""
    rows, cols = found.grid.shape
    pitch_mm, scale = found.grid.pitch_mm, (1e3 if found.unit == "mm" else 1.0)
    unit = "um" if found.unit == "mm" else found.unit
    what = "the sensor" if found.element is None else f"element {found.element + 1}"
    current.say(
        f"{found.lens}, {found.motion} of {what}, {cols} x {rows} pixels of "
        f"{pitch_mm[0]:g} x {pitch_mm[1]:g} mm"
    )
    current.say(
        f"holds to {scale * found.reach[0]:.4g} {unit} along rows, "
        f"{scale * found.reach[1]:.4g} {unit} along columns"
    )
    current.say(
        f"fit: shift {found.shift_error_px:.1e} px, width of the spot {found.spot_error_px:.1e} "
        f"px, contrast of a Gaussian spot {found.contrast_error:.3f} (largest errors)"
    )
    current.result |= {
        "lens": found.lens,
        "element": None if found.element is None else found.element + 1,
        "motion": found.motion,
        "shape": found.grid.shape,
        "pitch_mm": found.grid.pitch_mm,
        "reach": found.reach,
        "unit": found.unit,
        "shift_error_px": found.shift_error_px,
        "spot_error_px": found.spot_error_px,
        "contrast_error": found.contrast_error,
    }


def _say(
    current: Session, found: LensField, wanted_px: Any, csv: Path | None, plot: Path | None
) -> None:
    import numpy as np

    from lensshift.optics.shift import shift_uniformity

    say_field(current, found)
    state = found.states(wanted_px)
    shown = found.at(state)
    spot_px = np.sqrt(np.asarray(shown.spot_px2))
    even = shift_uniformity(shown, wanted_px)
    scale, unit = (1e3, "um") if found.unit == "mm" else (1e3, "mrad")
    for number, (wish, moved, one) in enumerate(zip(wanted_px, scale * state, even, strict=True)):
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
    write_table(current, csv, columns)
    write_plot(
        current,
        plot,
        lambda: figure_of("lens_maps", "shift_map_figure", shown, found.grid, wanted_px),
    )
