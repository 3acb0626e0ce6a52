"""`lensshift lens refine`: make a starting form sharp."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from lensshift.cli.lens_design import BestOption, check_out, write_lens
from lensshift.cli.measured import parse_numbers
from lensshift.cli.optics import (
    PITCH_MM,
    SENSOR,
    BandOption,
    LensArgument,
    PitchOption,
    SensorOption,
    TemperatureOption,
    WavelengthOption,
    band_of,
    element_of,
    read_lens,
    sensor_grid,
)
from lensshift.cli.session import DebugOption, JsonOption, Progress, Session, session

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
    from lensshift.optics.lens import Lens
    from lensshift.optics.refine import Task

FocalOption = Annotated[float, typer.Option("--focal-length-mm", help="Kept.")]
FNumberOption = Annotated[float, typer.Option("--f-number", help="Kept, by the stop.")]
MadeOption = Annotated[
    str,
    typer.Option(
        "--made", help="Elements made to order, from 1: 1,3. All but plates if not given."
    ),
]
AspheresOption = Annotated[
    int, typer.Option("--aspheres", min=0, help="Terms A4, A6, ... of aspheric elements.")
]
AsphericOption = Annotated[
    str, typer.Option("--aspheric", help="Elements with aspheres, from 1. All that are made.")
]
ConicsOption = Annotated[bool, typer.Option("--conics", help="Conics of aspheric elements too.")]
ThicknessesOption = Annotated[
    bool, typer.Option("--thicknesses/--radii-only", help="Also thicknesses of glass.")
]
StopOption = Annotated[
    bool, typer.Option("--move-stop/--keep-stop", help="The place of a stop between elements.")
]
GrowOption = Annotated[
    str,
    typer.Option("--grow", help="Shares of aperture and field to go through: 0.4,0.7,1."),
]
StepsOption = Annotated[int, typer.Option("--steps", min=1, help="Of the solver, each time.")]
GlassOption = Annotated[
    str, typer.Option("--glass-mm", help="Least and most thickness of glass: 0.8,5.")
]
EdgeOption = Annotated[float, typer.Option("--edge-mm", min=0.0, help="Least at its edge.")]
AirOption = Annotated[float, typer.Option("--air-mm", min=0.0, help="Least between elements.")]
BackOption = Annotated[
    float, typer.Option("--back-focal-mm", min=0.0, help="Least in front of the sensor.")
]
TrackOption = Annotated[
    float, typer.Option("--track-mm", min=0.0, help="Most from first vertex to sensor.")
]
DistortionOption = Annotated[
    float, typer.Option("--distortion", min=0.0, help="Most in the corner, as a share.")
]
HeatOption = Annotated[
    str, typer.Option("--temperatures-c", help="Sharp at each of these with one focus: -10,60.")
]


def refine(
    lens: LensArgument,
    focal_length_mm: FocalOption,
    f_number: FNumberOption,
    made: MadeOption = "",
    thicknesses: ThicknessesOption = True,
    aspheres: AspheresOption = 0,
    aspheric: AsphericOption = "",
    conics: ConicsOption = False,
    move_stop: StopOption = True,
    grow: GrowOption = "1",
    steps: StepsOption = 60,
    glass_mm: GlassOption = "0.8,inf",
    edge_mm: EdgeOption = 0.4,
    air_mm: AirOption = 0.05,
    back_focal_mm: BackOption = 0.3,
    track_mm: TrackOption = math.inf,
    distortion: DistortionOption = math.inf,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    wavelength_nm: WavelengthOption = None,
    band_nm: BandOption = 0.0,
    temperature_c: TemperatureOption = None,
    temperatures_c: HeatOption = "",
    out: BestOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Find curvatures, thicknesses, gaps and aspheres of a lens from a starting form.

    Least squares of ray errors over the sensor, the light and the temperatures. Elements that are
    not made to order are stock lenses and stay whole; plates in front of the sensor stay, too.
    A rough form needs --grow, and spheres before aspheres. The least MTF is that of `lens which`.

    \b
    Example:
      lensshift lens refine form.toml --focal-length-mm 5.2 --f-number 1.2 --sensor 320x240 \\
        --pitch-mm 0.015 --track-mm 25 --grow 0.4,0.5,0.6,0.7,0.8,0.9,1 -o spheres.toml
      lensshift lens refine petzval_a.toml --focal-length-mm 42.7 --f-number 2.1 --made 3
    """
    with session(as_json=as_json, debug=debug, doing="refining the lens") as current:
        from lensshift.optics.refine import Limits, Task
        from lensshift.optics.refine import refine as found_by
        from lensshift.optics.variables import Freedom

        check_out(out)
        start = read_lens(lens, wavelength_nm, temperature_c)
        low_mm, high_mm = parse_numbers(glass_mm, 2, "two thicknesses like 0.8,5")
        limits = Limits((low_mm, high_mm), edge_mm, air_mm, back_focal_mm, track_mm, distortion)
        grid, heat_c = sensor_grid(sensor, pitch_mm), _numbers(temperatures_c)
        task = Task(grid, focal_length_mm, f_number, limits, band_of(start, band_nm), heat_c)
        numbers, of_aspheres = _elements(start, made), _elements(start, aspheric)
        freedom = Freedom(
            numbers, thicknesses=thicknesses, conics=conics, aspheres=aspheres,
            aspheric=of_aspheres, stop=move_stop,
        )  # fmt: skip
        progress = Progress("refining", preparing=True)
        try:
            found = found_by(
                start, task, freedom, grow=_numbers(grow), steps=steps, on_progress=progress.count
            )
        finally:
            progress.close()
        _say(current, start, found, task)
        if out is not None:
            write_lens(found, out)
            current.say(f"wrote {out}")


def _say(current: Session, start: Lens, found: Lens, task: Task) -> None:
    from lensshift.optics.paraxial import paraxial
    from lensshift.optics.refine import ray_error_um

    data, errors = paraxial(found), {}
    shares = ", ".join(f"{share:g}" for share in task.shares)
    current.say(f"rms of rays in um, from the centre to the corner ({shares} of the way)")
    for name, lens in (("start", start), ("found", found)):
        errors[name] = ray_error_um(lens, task)
        current.say(f"  {name:<8}" + " ".join(f"{value:8.2f}" for value in errors[name]))
    length_mm = float(found.positions_mm()[-1])
    current.say(
        f"focal length {data.focal_length_mm:.4g} mm, f/{data.f_number:.3g}, "
        f"{length_mm:.4g} mm from the first vertex to the sensor"
    )
    least = _least_mtf(found, task.grid, task)
    current.say(
        "least MTF over the sensor: "
        + ", ".join(f"{value:.3f} at {lpmm:.4g} LP/mm" for lpmm, value in least.items())
    )
    current.result |= {"ray_error_um": errors, "focal_length_mm": data.focal_length_mm}
    current.result |= {"f_number": data.f_number, "track_mm": length_mm}
    current.result["least_mtf"] = [{"lpmm": lpmm, "mtf": mtf} for lpmm, mtf in least.items()]


def _least_mtf(lens: Lens, grid: Grid, task: Task) -> dict[float, float]:
    """Return the least MTF at the Nyquist frequencies of the pixels and of twice as many."""
    from lensshift.optics.which import judged_lpmm, least_mtf

    highest_lpmm = judged_lpmm(grid)
    return {
        lpmm: least_mtf(lens, grid, frequency_lpmm=lpmm, band=task.band)[0]
        for lpmm in (0.5 * highest_lpmm, highest_lpmm)
    }


def _numbers(text: str) -> tuple[float, ...]:
    return parse_numbers(text, text.count(",") + 1, "numbers like 0.4,1") if text else ()


def _elements(lens: Lens, text: str) -> tuple[int, ...] | None:
    """Return numbers from 0, None if there are none."""
    return tuple(element_of(lens, int(number)) for number in _numbers(text)) or None
