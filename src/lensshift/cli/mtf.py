"""`lensshift evaluate mtf`: the resolution of an image with a slanted edge."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.measured import (
    CsvOption,
    FocalOption,
    FrameOption,
    ImageArgument,
    KeyOption,
    Measured,
    PitchOption,
    PlotOption,
    RegionOption,
    Unit,
    check_outputs,
    frequency_unit,
    interval_row,
    measured_frames,
    measured_image,
    parse_region,
    write_plot,
    write_table,
)
from lensshift.cli.session import DebugOption, JsonOption, Session, session

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lensshift.evaluation.slanted_edge import EdgeResult, Interval


class EdgeMethod(StrEnum):
    """How an edge is measured."""

    ML = "ml"
    SFRMAT3 = "sfrmat3"
    SFRMAT5 = "sfrmat5"


JointOption = Annotated[
    bool, typer.Option("--joint", help="Fit all frames of a burst file together.")
]
MethodOption = Annotated[
    EdgeMethod,
    typer.Option("--method", help="Maximum likelihood, or a published algorithm to compare with."),
]

# Name in the result, name for people, what it is.
NUMBERS = (
    ("mtf50_lpmm", "MTF50", "frequency"),
    ("mtf30_lpmm", "MTF30", "frequency"),
    ("mtf10_lpmm", "MTF10", "frequency"),
    ("mtf_at_nyquist", "MTF at LR Nyquist", "share"),
    ("area_to_nyquist", "mean MTF to LR Nyquist", "share"),
    ("peak", "peak", "share"),
    ("effective_pixel_mm", "effective pixel", "length"),
    ("rise_mm", "10-90 width", "length"),
)


def mtf(
    image: ImageArgument,
    pitch_mm: PitchOption = None,
    region: RegionOption = None,
    joint: JointOption = False,
    method: MethodOption = EdgeMethod.ML,
    focal_length_mm: FocalOption = None,
    frame: FrameOption = 0,
    key: KeyOption = None,
    csv: CsvOption = None,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Measure the MTF of slanted edges, with 95 % intervals.

    Every edge of the image is found and measured, unless a region is given; numbers of several
    edges are averaged with their variances, those of edges that cannot be used left out.

    \b
    Example:
      lensshift evaluate mtf edge.tif --pitch-mm 0.155 --csv mtf.csv --plot mtf.png
      lensshift evaluate mtf burst.nc --joint --region 0,16,20,50
      lensshift evaluate mtf edge.tif --pitch-mm 0.155 --focal-length-mm 42.7
    """
    with session(as_json=as_json, debug=debug, doing="measuring edges") as current:
        from lensshift.evaluation.slanted_edge import average_curves, measure_edges, usable_edges

        place = parse_region(region)
        check_outputs([image], csv, plot)
        measured = (
            measured_frames(image, key=key)
            if joint
            else measured_image(image, pitch_mm, key=key, frame=frame)
        )
        unit = frequency_unit(measured, focal_length_mm)
        results = measure_edges(
            measured.values,
            measured.pitch_mm,
            region=place,
            method=method.value,
            offset_px=measured.offset_px,
            valid=measured.valid,
            scale=measured.scale,
        )
        for result in results:
            say_edge(current, result, unit, measured.length)
        used = usable_edges(results)
        mean = _mean(used)
        if len(results) > 1:
            current.say(f"mean of {len(used)} usable of {len(results)} edges")
            _say_numbers(current, mean, unit, measured.length)
        curve = average_curves(results)
        frequency = curve.frequency_lpmm * unit.factor
        current.result |= {"image": image, "unit": unit.name, "length_unit": measured.length}
        current.result["edges"] = [edge_row(result, unit) for result in results]
        current.result["mean"] = _mean_row(mean, unit)
        current.result["mtf"] = {"frequency": frequency, "frequency_lpmm": curve.frequency_lpmm}
        current.result["mtf"] |= {"modulation": curve.modulation, "std": curve.std}
        first = "frequency_lpmm" if focal_length_mm is None else "frequency_cycles_per_mrad"
        columns = {first: frequency, "modulation": curve.modulation}
        columns |= {} if curve.std is None else {"std": curve.std}
        write_table(current, csv, columns)
        write_plot(current, plot, lambda: _figure(results, measured, unit))


def _figure(results: Sequence[EdgeResult], measured: Measured, unit: Unit) -> Any:
    from lensshift.report.edges import edge_figure

    shown = measured.values if measured.values.ndim == 2 else measured.values[0]
    return edge_figure(results, shown, unit=unit.name, factor=unit.factor)


def say_edge(current: Session, result: EdgeResult, unit: Unit, length: str) -> None:
    """Print an edge and its numbers."""
    import numpy as np

    current.say(
        f"edge in {result.region}: {result.orientation}, "
        f"{np.rad2deg(result.angle_rad.value):.2f} degrees, contrast "
        f"{100 * result.contrast:.0f} %, SNR {result.snr:.3g}"
    )
    _say_numbers(current, {name: getattr(result, name) for name, _, _ in NUMBERS}, unit, length)


def _say_numbers(current: Session, numbers: dict[str, Interval], unit: Unit, length: str) -> None:
    for name, label, kind in NUMBERS:
        number, ending = numbers[name], ""
        if kind == "frequency":
            number, ending = number.scaled(unit.factor), f" {unit.name}"
        elif kind == "length":
            ending = f" {length}"
        known = number.value == number.value
        current.say(f"  {label:<23}{number}{ending if known else ''}")


def _mean(results: Sequence[EdgeResult]) -> dict[str, Interval]:
    from lensshift.evaluation.slanted_edge import average_interval

    return {
        name: average_interval([getattr(result, name) for result in results])
        for name, _, _ in NUMBERS
    }


def _mean_row(mean: dict[str, Interval], unit: Unit) -> dict[str, Any]:
    row: dict[str, Any] = {name: interval_row(number) for name, number in mean.items()}
    for name in ("mtf50", "mtf30", "mtf10"):
        row[name] = interval_row(mean[f"{name}_lpmm"], unit.factor)
    return row


def edge_row(result: EdgeResult, unit: Unit) -> dict[str, Any]:
    """Return an edge for JSON."""
    row: dict[str, Any] = {"region": str(result.region), "orientation": result.orientation}
    for name in ("angle_rad", "position_px", *(name for name, _, _ in NUMBERS), "asymmetry"):
        row[name] = interval_row(getattr(result, name))
    for name in ("mtf50", "mtf30", "mtf10"):
        row[name] = interval_row(getattr(result, f"{name}_lpmm"), unit.factor)
    for name in ("method", "dark", "bright", "contrast", "noise", "snr", "bend_px", "nyquist_lpmm"):
        row[name] = getattr(result, name)
    row |= {"notes": list(result.notes), "usable": result.usable}
    return row
