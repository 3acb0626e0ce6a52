"""`lensshift lens field`: what a trace knows of shift and blur, as a file for `reconstruct`."""

from __future__ import annotations

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
    from lensshift.core.lens_field import LensField, Motion


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
    motion: Motion | None = "tilt" if asked.tilt else None
    grid = _grid(asked)
    with Progress("tracing") as progress:
        told: dict[str, Any] = {"motion": motion, "reach_px": reach_px}
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
    what = "shift of the sensor"
    if found.element is not None:
        what = f"{found.motion} of element {found.element + 1}"
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
    current.result["element"] = None if found.element is None else found.element + 1
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
