"""`lensshift lens optimise`, `tolerance` and `budget`: find a lens, build it, drive it."""

from __future__ import annotations

import math
from dataclasses import MISSING, asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from lensshift.cli import optics, outputs
from lensshift.cli.inputs import parse_numbers
from lensshift.cli.ranges import in_range
from lensshift.cli.session import Progress, Session, picked
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from lensshift.optics.design import Design
    from lensshift.optics.goal import Goal
    from lensshift.optics.lens import Element, Lens
    from lensshift.optics.tolerance import ToleranceResult

BestOption = Annotated[
    Path | None, typer.Option("-o", "--out", help="Write the lens found (.toml or .zmx).")
]


@dataclass(frozen=True, slots=True)
class _OptimiseOptions:
    places: list[str] = argument(
        "The lens for each place, or several to choose from: al2550,eo33944."
    )
    focal_length_mm: float = option(MISSING, "Kept exactly.")
    object_mm: float = option(math.inf, "From the object to the first vertex.")
    stop_mm: float = option(20.0, "Diameter of the stop.")
    back_focal_mm: float = option(2.0, "Least distance from the last vertex to sensor.")
    element: int | None = option(None, "The element that moves, from 1; each if not given.", min=1)
    shift_px: float = option(optics.SHIFT_PX, "Shift of the image along both axes, in pixels.")
    shift_error_px: float = option(0.01, "Largest error of the shift over the sensor.")
    mtf: float = option(0.9, "Wanted at the corner, centred and moved.")
    wavelength_nm: float = option(850.0, "Of the light.")
    band_nm: optics.BandOption = None
    temperature_c: float = option(20.0, "Of glass and air.")
    cover: str = option("", "A plate before the sensor: glass, its mm, mm of air: N-BK7,1,0.5.")
    stop_behind: int = option(0, "Elements in front of the stop.", min=0)
    stop_at_mm: float = option(0.0, "The stop behind the vertex in front of it.")
    sensor: optics.SensorOptions = field(default_factory=optics.SensorOptions)
    keep: int = option(8, "Trains that are optimised after a first look.", min=1)
    goal: Literal["mtf", "picture"] = option("mtf", "What designs are ranked by.")
    actuator_um: float = option(1.0, "Standard deviation of where the element stops.")
    noise: float = option(0.005, "Of a pixel: standard deviation as a share of full scale.")
    out: BestOption = None


@verb()
def optimise(current: Session, asked: _OptimiseOptions) -> None:
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
    from lensshift.optics.goal import Goal
    from lensshift.optics.lens import Stop
    from lensshift.optics.stock import format_designs

    check_out(asked.out, *(Path(name) for place in asked.places for name in place.split(",")))
    plate, air_mm = _cover(asked.cover)
    wanted = Goal(
        optics.sensor_grid(asked.sensor), asked.focal_length_mm, asked.object_mm,
        Stop(asked.stop_mm, asked.stop_at_mm), asked.back_focal_mm, shift_px=asked.shift_px,
        shift_error_px=asked.shift_error_px, mtf=asked.mtf, wavelength_nm=asked.wavelength_nm,
        temperature_c=asked.temperature_c, stop_behind=asked.stop_behind,
        band=optics.band_of(asked.wavelength_nm, asked.band_nm),
        cover=plate, cover_mm=air_mm,
    )  # fmt: skip
    designs = _designs(asked.places, wanted, asked.element, asked.keep)
    if asked.goal == "picture":
        designs = _by_picture(current, designs, wanted, asked.actuator_um, asked.noise)
    current.say(format_designs(designs))
    met = sum(design.meets(wanted) for design in designs)
    current.say(f"{met} of {len(designs)} designs meet the goal")
    current.result |= {"met": met, "designs": [_row(design) for design in designs]}
    if asked.out is not None:
        write_lens(designs[0].lens, asked.out)
        current.say(f"wrote {asked.out}")


def _cover(text: str) -> tuple[Element | None, float]:
    """Return the plate of "glass,mm,mm" and the air behind it."""
    from lensshift.optics.lens import cover_glass

    if not text:
        return None, 0.0
    glass, _, lengths = text.partition(",")
    if "," not in lengths:
        raise typer.BadParameter(f"expected a plate like N-BK7,1,0.5, got {text!r}")
    thick_mm, air_mm = parse_numbers(lengths, 2, "a plate like N-BK7,1,0.5")
    return cover_glass(glass.strip(), in_range("cover", thick_mm)), in_range("cover", air_mm)


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

    stock = [[optics.read_lens(name.strip()) for name in place.split(",")] for place in places]
    if element is not None and element > len(stock):
        raise typer.BadParameter(f"expected an element from 1 to {len(stock)}, got {element}")
    with Progress("optimising") as progress:
        if element is not None and all(len(place) == 1 for place in stock):
            parts = [part for place in stock for part in place[0].elements]
            told: dict[str, Any] = {"name": " + ".join(part.name for part in parts)}
            told |= {"element": element - 1, "on_progress": progress.count}
            return (optimise_gaps(parts, goal, **told),)
        movers = None if element is None else [element - 1]
        return search_stock(stock, goal, movers=movers, keep=keep, on_progress=progress.count)


def check_out(out: Path | None, *sources: Path) -> None:
    """Complain before the work about a lens that cannot be written."""
    outputs.check(list(sources), out)
    if out is not None and out.suffix.lower() not in (".toml", ".zmx"):
        raise typer.BadParameter(f"expected {out} to end in .toml or .zmx")


def write_lens(lens: Lens, out: Path) -> None:
    """Write a lens as TOML or a Zemax file."""
    from lensshift.optics.lens_file import save_lens
    from lensshift.optics.zmx_writer import save_zmx

    (save_zmx if out.suffix.lower() == ".zmx" else save_lens)(lens, out)


def _row(design: Design) -> dict[str, Any]:
    row = picked(design, "mtf_centred mtf_moved shift_error_px stroke_mm transmission")
    row["element"] = None if design.element is None else design.element + 1
    row["train"] = [element.name for element in design.lens.elements]
    return row | {"turned": design.turned, "gaps_mm": design.lens.gaps_mm}


@dataclass(frozen=True, slots=True)
class _ToleranceOptions:
    of: optics.MovedLensOptions
    builds: int = option(1000, "Random builds.", min=1)
    limit: float = option(0.9, "MTF that a good build keeps.")
    decenter_mm: float = option(0.05, "Of each element.")
    tilt_deg: float = option(0.1, "Of each element.")
    gap_mm: float = option(0.05, "Of each gap.")
    focal_share: float = option(0.01, "Of the focal length of each element.")
    index: float = option(0.0005, "Of each refractive index.")
    seed: int = option(0, "Seed of the random numbers.", min=0)
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


@verb()
def tolerance(current: Session, asked: _ToleranceOptions) -> None:
    """Build a lens many times at random, and set each tolerance to its limit alone.

    The sensor is refocused in every build; MTF at twice LR Nyquist, at rest and for the four
    diagonal moves of the element.

    \b
    Example:
      lensshift lens tolerance petzval_search --element 2 --builds 1000 --plot tolerance.png
    """
    from lensshift.optics import tolerance as building

    outputs.check([Path(asked.of.lens)], asked.to.csv, plot=asked.to.plot)
    model, grid, moved = optics.opened_moving(asked.of)
    shift_px, builds = asked.of.shift_px, asked.builds
    limits = building.Tolerances(
        asked.decenter_mm, math.radians(asked.tilt_deg), asked.gap_mm, asked.focal_share,
        asked.index,
    )  # fmt: skip
    table = building.sensitivity_table(model, moved, grid, limits, shift_px=shift_px)
    with Progress("building") as progress:
        found = building.tolerance_analysis(
            model, moved, grid, limits, builds=builds, seed=asked.seed, shift_px=shift_px,
            on_progress=progress.count,
        )  # fmt: skip
    current.say(building.format_sensitivity(table))
    _say_builds(current, found, builds, asked.limit)
    current.result |= {"lens": model.name or asked.of.lens, "element": moved + 1}
    current.result["sensitivity"] = [asdict(row) | {"element": row.element + 1} for row in table]
    columns = {"build": list(range(builds)), "worst_mtf": found.worst_mtf}
    columns |= {"shift_error_px": found.shift_error_px, "refocus_mm": found.refocus_mm}
    outputs.write_table(current, asked.to.csv, columns)
    shown = ("lens_build.tolerance_figure", found, asked.limit)
    outputs.write_plot(current, asked.to.plot, *shown, table=table)


def _say_builds(current: Session, found: ToleranceResult, builds: int, limit: float) -> None:
    from lensshift.optics import tolerance as building

    low, median, high = found.percentiles()
    share = found.yield_at(limit)
    current.say(
        f"{builds} builds, MTF at {found.frequency_lpmm:.3g} LP/mm, worst of field, direction "
        f"and position: {low:.3f} / {median:.3f} / {high:.3f} (5, 50, 95 %), as drawn "
        f"{found.nominal_mtf.min():.3f}"
    )
    current.say(f"{100 * share:.1f} % of the builds keep {limit:g}")
    rough = bool(min(low, found.nominal_mtf.min(), limit) < building.ROUGH_BELOW)
    if rough:
        current.say(
            f"an MTF below {building.ROUGH_BELOW:g} is rough, by up to {building.ROUGH:g}: builds "
            "without contrast get few rays; `lens mtf` has the exact one of the lens as drawn"
        )
    current.result["rough"] = rough
    errors_px = found.shift_error_px[found.shift_error_px >= 0]  # NaN where a field is dark
    if len(errors_px) < builds:
        current.say(f"{builds - len(errors_px)} builds leave a field dark, without a shift")
    if len(errors_px):
        current.say(
            f"largest error of a shift: {errors_px.max():.4f} px, "
            f"refocus up to {float(abs(found.refocus_mm).max()):.3f} mm"
        )
    current.result |= {"builds": builds, "percentiles_5_50_95": (low, median, high)}
    current.result |= {"limit": limit, "yield": share, "frequency_lpmm": found.frequency_lpmm}


@dataclass(frozen=True, slots=True)
class _BudgetOptions:
    of: optics.MovedLensOptions
    repeatability_um: float = option(0.0, "Standard deviation of where it stops.")
    backlash_um: float = option(0.0, "Between approaches from the two sides.")
    encoder_um: float = option(0.0, "One step of the encoder.")
    drift_um: float = option(0.0, "From the first frame of a burst to the last.")
    noise: float = option(0.005, "Of a pixel: standard deviation as a share of full scale.")
    plot: outputs.PlotOption = None


@verb("computing the budget")
def budget(current: Session, asked: _BudgetOptions) -> None:
    """Tell what the errors of an actuator cost: micrometres, pixels, lost resolution.

    The losses are those of simulated bursts of four frames whose shifts were wrong by as much,
    against bursts whose shifts are known.

    \b
    Example:
      lensshift lens budget petzval_search --element 2 --repeatability-um 1 --backlash-um 5
    """
    from lensshift.optics.actuator import Actuator, actuator_budget, format_budget

    outputs.check([Path(asked.of.lens)], plot=asked.plot)
    model, grid, moved = optics.opened_moving(asked.of)
    errors = Actuator(asked.repeatability_um, asked.backlash_um, asked.encoder_um, asked.drift_um)
    told = {"noise": asked.noise, "shift_px": asked.of.shift_px}
    found = actuator_budget(model, moved, grid, errors, **told)
    current.say(format_budget(found))
    if not found.shift_error_px:
        current.say(
            "no error of the actuator is given, so nothing is lost; of its data sheet, in um: "
            "--repeatability-um, --backlash-um, --encoder-um, --drift-um"
        )
    current.result |= {"lens": model.name or asked.of.lens, "noise": asked.noise}
    current.result |= asdict(found) | {"element": moved + 1}
    outputs.write_plot(current, asked.plot, "lens_build.budget_figure", found)
