"""`lensshift lens optimise`, `tolerance` and `budget`: find a lens, build it, drive it."""

from __future__ import annotations

import math
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.measured import (
    CsvOption,
    PlotOption,
    check_outputs,
    parse_numbers,
    write_plot,
    write_table,
)
from lensshift.cli.optics import (
    PITCH_MM,
    SENSOR,
    SHIFT_PX,
    BandOption,
    ElementOption,
    LensArgument,
    PitchOption,
    SensorOption,
    ShiftOption,
    element_of,
    figure_of,
    read_lens,
    sensor_grid,
)
from lensshift.cli.session import DebugOption, JsonOption, Progress, Session, session

if TYPE_CHECKING:
    from lensshift.optics.design import Design
    from lensshift.optics.goal import Goal
    from lensshift.optics.lens import Element, Lens
    from lensshift.optics.tolerance import ToleranceResult

PlacesArgument = Annotated[
    list[str],
    typer.Argument(help="The lens for each place, or several to choose from: al2550,eo33944."),
]
FocalOption = Annotated[float, typer.Option("--focal-length-mm", help="Kept exactly.")]
ObjectOption = Annotated[
    float, typer.Option("--object-mm", help="From the object to the first vertex.")
]
StopOption = Annotated[float, typer.Option("--stop-mm", help="Diameter of the stop.")]
BackOption = Annotated[
    float, typer.Option("--back-focal-mm", help="Least distance from the last vertex to sensor.")
]
MtfOption = Annotated[float, typer.Option("--mtf", help="Wanted at the corner, centred and moved.")]
ErrorOption = Annotated[
    float, typer.Option("--shift-error-px", help="Largest error of the shift over the sensor.")
]
MoverOption = Annotated[
    int | None,
    typer.Option("--element", min=1, help="The element that moves, from 1; each if not given."),
]
KeepOption = Annotated[
    int, typer.Option("--keep", min=1, help="Trains that are optimised after a first look.")
]
BestOption = Annotated[
    Path | None, typer.Option("-o", "--out", help="Write the lens found (.toml or .zmx).")
]
BuildsOption = Annotated[int, typer.Option("--builds", min=1, help="Random builds.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]
LimitOption = Annotated[float, typer.Option("--limit", help="MTF that a good build keeps.")]
DecenterOption = Annotated[float, typer.Option("--decenter-mm", min=0.0, help="Of each element.")]
TiltOption = Annotated[float, typer.Option("--tilt-deg", min=0.0, help="Of each element.")]
GapOption = Annotated[float, typer.Option("--gap-mm", min=0.0, help="Of each gap.")]
ShareOption = Annotated[
    float, typer.Option("--focal-share", min=0.0, help="Of the focal length of each element.")
]
IndexOption = Annotated[float, typer.Option("--index", min=0.0, help="Of each refractive index.")]
RepeatabilityOption = Annotated[
    float, typer.Option("--repeatability-um", min=0.0, help="Standard deviation of where it stops.")
]
BacklashOption = Annotated[
    float, typer.Option("--backlash-um", min=0.0, help="Between approaches from the two sides.")
]
EncoderOption = Annotated[
    float, typer.Option("--encoder-um", min=0.0, help="One step of the encoder.")
]
DriftOption = Annotated[
    float, typer.Option("--drift-um", min=0.0, help="From the first frame of a burst to the last.")
]
NoiseOption = Annotated[
    float, typer.Option("--noise", help="Of a pixel: standard deviation as a share of full scale.")
]


WaveOption = Annotated[float, typer.Option("--wavelength-nm", help="Of the light.")]
HeatOption = Annotated[float, typer.Option("--temperature-c", help="Of glass and air.")]
CoverOption = Annotated[
    str,
    typer.Option(
        "--cover", help="A plate before the sensor: glass, its mm, mm of air: N-BK7,1,0.5."
    ),
]
BehindOption = Annotated[
    int, typer.Option("--stop-behind", min=0, help="Elements in front of the stop.")
]
PlaceOption = Annotated[
    float, typer.Option("--stop-at-mm", help="The stop behind the vertex in front of it.")
]


class GoalKind(StrEnum):
    """What a search of lenses ranks them by."""

    MTF = "mtf"
    PICTURE = "picture"


GoalOption = Annotated[GoalKind, typer.Option("--goal", help="What designs are ranked by.")]
ActuatorOption = Annotated[
    float,
    typer.Option("--actuator-um", min=0.0, help="Standard deviation of where the element stops."),
]


def optimise(
    places: PlacesArgument,
    focal_length_mm: FocalOption,
    object_mm: ObjectOption = math.inf,
    stop_mm: StopOption = 20.0,
    back_focal_mm: BackOption = 2.0,
    element: MoverOption = None,
    shift_px: ShiftOption = SHIFT_PX,
    shift_error_px: ErrorOption = 0.01,
    mtf: MtfOption = 0.9,
    wavelength_nm: WaveOption = 850.0,
    band_nm: BandOption = 0.0,
    temperature_c: HeatOption = 20.0,
    cover: CoverOption = "",
    stop_behind: BehindOption = 0,
    stop_at_mm: PlaceOption = 0.0,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    keep: KeepOption = 8,
    goal: GoalOption = GoalKind.MTF,
    actuator_um: ActuatorOption = 1.0,
    noise: NoiseOption = 0.005,
    out: BestOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Find gaps, orientations and the element to move for a train of stock lenses.

    Maximises the least MTF over the sensor at twice its Nyquist frequency, centred and moved, at
    the given focal length and least back focal distance. With --goal picture the designs found are
    ranked by the error that the best linear reconstruction leaves, for the square of four frames,
    for the same with the picture a quarter pixel aside, and for 3x3 with the same light in all.

    \b
    Example:
      lensshift lens optimise al2550 al2550 lc1054 --focal-length-mm 42.7 --object-mm 3500 \\
        --goal picture --actuator-um 2
      lensshift lens optimise al2550 eo33950 --focal-length-mm 42.7 --band-nm 40 --cover N-BK7,1,0.5
      lensshift lens optimise al2550 al2550 eo45030 --focal-length-mm 42.7 --object-mm 3500
      lensshift lens optimise al2550,eo33944 al2550,eo33944 lc4210,eo45030 --focal-length-mm 42.7 \\
        --object-mm 3500 --element 1 -o best.toml
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.optics.goal import Goal
        from lensshift.optics.lens import Stop
        from lensshift.optics.mtf import led_band
        from lensshift.optics.stock import format_designs

        check_out(out)
        plate, air_mm = _cover(cover)
        wanted = Goal(
            sensor_grid(sensor, pitch_mm), focal_length_mm, object_mm, Stop(stop_mm, stop_at_mm),
            back_focal_mm, shift_px=shift_px, shift_error_px=shift_error_px, mtf=mtf,
            wavelength_nm=wavelength_nm, temperature_c=temperature_c, stop_behind=stop_behind,
            band=led_band(wavelength_nm, band_nm) if band_nm > 0 else None,
            cover=plate, cover_mm=air_mm,
        )  # fmt: skip
        designs = _designs(places, wanted, element, keep)
        if goal is GoalKind.PICTURE:
            designs = _by_picture(current, designs, wanted, actuator_um, noise)
        current.say(format_designs(designs))
        met = sum(design.meets(wanted) for design in designs)
        current.say(f"{met} of {len(designs)} designs meet the goal")
        current.result |= {"met": met, "designs": [_row(design) for design in designs]}
        if out is not None:
            write_lens(designs[0].lens, out)
            current.say(f"wrote {out}")


def _cover(text: str) -> tuple[Element | None, float]:
    """Return the plate of "glass,mm,mm" and the air behind it."""
    from lensshift.optics.lens import cover_glass

    if not text:
        return None, 0.0
    glass, _, lengths = text.partition(",")
    thick_mm, air_mm = parse_numbers(lengths, 2, "a plate like N-BK7,1,0.5")
    return cover_glass(glass.strip(), thick_mm), air_mm


def _by_picture(
    current: Session, designs: tuple[Design, ...], goal: Goal, actuator_um: float, noise: float
) -> tuple[Design, ...]:
    """Return the designs with a mover, the one with the least error of the picture first."""
    from lensshift.optics.picture import PICTURES, format_scores, picture_score

    scored = [
        (design, picture_score(
            design.lens, design.element, goal.grid, pattern=pattern, place_px=place_px,
            actuator_um=actuator_um, noise=noise,
        ))
        for design in designs if design.element is not None
        for pattern, place_px in PICTURES
    ]  # fmt: skip
    scored.sort(key=lambda pair: pair[1].rmse)
    names = [design.lens.name for design, _ in scored]
    current.say(format_scores(names, [score for _, score in scored]))
    current.result["pictures"] = [
        {"lens": name} | asdict(score) | {"element": score.element + 1}
        for name, (_, score) in zip(names, scored, strict=True)
    ]
    return tuple({id(design): design for design, _ in scored}.values())


def _designs(places: list[str], goal: Goal, element: int | None, keep: int) -> tuple[Design, ...]:
    from lensshift.optics.design import optimise_gaps
    from lensshift.optics.stock import search_stock

    stock = [[read_lens(name.strip()) for name in place.split(",")] for place in places]
    if element is not None and element > len(stock):
        raise typer.BadParameter(f"expected an element from 1 to {len(stock)}, got {element}")
    progress = Progress("optimising")
    try:
        if element is not None and all(len(place) == 1 for place in stock):
            parts = [part for place in stock for part in place[0].elements]
            name = " + ".join(part.name for part in parts)
            best = optimise_gaps(
                parts, goal, element=element - 1, name=name, on_progress=progress.count
            )
            return (best,)
        movers = None if element is None else [element - 1]
        return search_stock(stock, goal, movers=movers, keep=keep, on_progress=progress.count)
    finally:
        progress.close()


def check_out(out: Path | None) -> None:
    """Complain before the work about a lens that cannot be written."""
    check_outputs([], out, None)
    if out is not None and out.suffix.lower() not in (".toml", ".zmx"):
        raise typer.BadParameter(f"expected {out} to end in .toml or .zmx")


def write_lens(lens: Lens, out: Path) -> None:
    """Write a lens as TOML or a Zemax file."""
    from lensshift.optics.lens_file import save_lens
    from lensshift.optics.zmx_writer import save_zmx

    (save_zmx if out.suffix.lower() == ".zmx" else save_lens)(lens, out)


def _row(design: Design) -> dict[str, Any]:
    numbers = ("mtf_centred", "mtf_moved", "shift_error_px", "stroke_mm", "transmission")
    row: dict[str, Any] = {name: getattr(design, name) for name in numbers}
    row["element"] = None if design.element is None else design.element + 1
    row["train"] = [element.name for element in design.lens.elements]
    return row | {"turned": design.turned, "gaps_mm": design.lens.gaps_mm}


def tolerance(
    lens: LensArgument,
    element: ElementOption = 1,
    builds: BuildsOption = 1000,
    limit: LimitOption = 0.9,
    decenter_mm: DecenterOption = 0.05,
    tilt_deg: TiltOption = 0.1,
    gap_mm: GapOption = 0.05,
    focal_share: ShareOption = 0.01,
    index: IndexOption = 0.0005,
    shift_px: ShiftOption = SHIFT_PX,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    seed: SeedOption = 0,
    csv: CsvOption = None,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Build a lens many times at random, and set each tolerance to its limit alone.

    The sensor is refocused in every build; MTF at twice LR Nyquist, at rest and for the four
    diagonal moves of the element.

    \b
    Example:
      lensshift lens tolerance petzval_search --element 2 --builds 1000 --plot tolerance.png
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.optics.tolerance import (
            Tolerances,
            format_sensitivity,
            sensitivity_table,
            tolerance_analysis,
        )

        check_outputs([], csv, plot)
        model, grid = read_lens(lens), sensor_grid(sensor, pitch_mm)
        moved = element_of(model, element)
        limits = Tolerances(decenter_mm, math.radians(tilt_deg), gap_mm, focal_share, index)
        table = sensitivity_table(model, moved, grid, limits, shift_px=shift_px)
        progress = Progress("building")
        try:
            found = tolerance_analysis(
                model, moved, grid, limits, builds=builds, seed=seed, shift_px=shift_px,
                on_progress=progress.count,
            )  # fmt: skip
        finally:
            progress.close()
        current.say(format_sensitivity(table))
        _say_builds(current, found, builds, limit)
        current.result |= {"lens": model.name or lens, "element": element}
        current.result["sensitivity"] = [
            asdict(row) | {"element": row.element + 1} for row in table
        ]
        columns = {"build": list(range(builds)), "worst_mtf": found.worst_mtf}
        columns |= {"shift_error_px": found.shift_error_px, "refocus_mm": found.refocus_mm}
        write_table(current, csv, columns)
        write_plot(
            current,
            plot,
            lambda: figure_of("lens_build", "tolerance_figure", found, limit, table=table),
        )


def _say_builds(current: Session, found: ToleranceResult, builds: int, limit: float) -> None:
    low, median, high = found.percentiles()
    share = found.yield_at(limit)
    current.say(
        f"{builds} builds, MTF at {found.frequency_lpmm:.3g} LP/mm, worst of field, direction "
        f"and position: {low:.3f} / {median:.3f} / {high:.3f} (5, 50, 95 %), as drawn "
        f"{found.nominal_mtf.min():.3f}"
    )
    current.say(f"{100 * share:.1f} % of the builds keep {limit:g}")
    current.say(
        f"largest error of a shift: {float(found.shift_error_px.max()):.4f} px, "
        f"refocus up to {float(abs(found.refocus_mm).max()):.3f} mm"
    )
    current.result |= {"builds": builds, "percentiles_5_50_95": (low, median, high)}
    current.result |= {"limit": limit, "yield": share, "frequency_lpmm": found.frequency_lpmm}


def budget(
    lens: LensArgument,
    element: ElementOption = 1,
    repeatability_um: RepeatabilityOption = 0.0,
    backlash_um: BacklashOption = 0.0,
    encoder_um: EncoderOption = 0.0,
    drift_um: DriftOption = 0.0,
    noise: NoiseOption = 0.005,
    shift_px: ShiftOption = SHIFT_PX,
    sensor: SensorOption = SENSOR,
    pitch_mm: PitchOption = PITCH_MM,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Tell what the errors of an actuator cost: micrometres, pixels, lost resolution.

    The losses are those of simulated bursts of four frames whose shifts were wrong by as much,
    against bursts whose shifts are known.

    \b
    Example:
      lensshift lens budget petzval_search --element 2 --repeatability-um 1 --backlash-um 5
    """
    with session(as_json=as_json, debug=debug, doing="computing the budget") as current:
        from lensshift.optics.actuator import Actuator, actuator_budget, format_budget

        check_outputs([], None, plot)
        model, grid = read_lens(lens), sensor_grid(sensor, pitch_mm)
        found = actuator_budget(
            model,
            element_of(model, element),
            grid,
            Actuator(repeatability_um, backlash_um, encoder_um, drift_um),
            noise=noise,
            shift_px=shift_px,
        )
        current.say(format_budget(found))
        current.result |= {"lens": model.name or lens, "noise": noise}
        current.result |= asdict(found) | {"element": element}
        write_plot(current, plot, lambda: figure_of("lens_build", "budget_figure", found))
