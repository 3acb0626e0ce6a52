"""`lensshift evaluate mtf`: the resolution of an image with a slanted edge."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from lensshift.cli import images, outputs
from lensshift.cli.images import Measured, Region, Unit
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lensshift.core.optical import MtfCurve
    from lensshift.evaluation.slanted_edge import EdgeResult, Interval


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """How an edge is measured, and where its MTF is read off."""

    method: Literal["ml", "sfrmat3", "sfrmat5"] = option(
        "ml", "Maximum likelihood, or a published algorithm to compare with."
    )
    order: int | None = option(None, "Of sfrmat5: of the polynomial of the edge, 5.")
    window: Literal["tukey", "hamming"] | None = option(None, "Of sfrmat5: tukey or hamming.")
    aperture_px: float | None = option(None, "Of ml: side of the largest pixel that is thought of.")
    tilt: bool | None = option(
        None, "Of ml: light is uneven, or not; else it is found out.", "--tilt/--no-tilt"
    )
    at: list[float] | None = option(
        None, "Frequency at which the MTF is wanted; again for each further one.", min=0.0
    )

    def given(self, pitch_mm: images.Pitch, unit: Unit) -> dict[str, Any]:
        """Return the options of `measure_edges` that were given; `at` are in the unit."""
        told = {k: one for k, one in asdict(self).items() if one is not None and k != "at"}
        if self.at and self.method == "ml":
            import numpy as np

            # Between the steps of the curve, what a ghost makes wave would be cut short.
            highest, wanted = 1.0 / min(pitch_mm), np.array(self.at) / unit.factor
            steps = 0.01 * highest * np.arange(101)
            apart = np.abs(steps[:, None] - wanted).min(axis=1) > 1e-9 * highest
            told["frequency_lpmm"] = np.union1d(steps[apart], wanted[wanted <= highest])
        return told


@dataclass(frozen=True, slots=True)
class _MtfOptions:
    of: images.ImageOptions
    region: images.RegionOption = None
    joint: bool = option(False, "Fit all frames of a burst file together.")
    edges: EdgeOptions = EdgeOptions()
    photo: images.PhotoOptions = field(default_factory=images.PhotoOptions)
    focal_length_mm: images.FocalOption = None
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


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


@verb("measuring edges")
def mtf(current: Session, asked: _MtfOptions) -> None:
    """Measure the MTF of slanted edges, with 95 % intervals.

    Every edge of the image is found and measured, unless a region is given; numbers of several
    edges are averaged, those of edges that cannot be used left out. Where edges differ by more
    than their errors, the intervals of the mean are wider (`evaluate chart` maps the field).

    \b
    Example:
      lensshift evaluate mtf edge.tif --pitch-mm 0.155 --csv mtf.csv --plot mtf.png
      lensshift evaluate mtf burst.nc --joint --region 0,16,20,50
      lensshift evaluate mtf photo.jpg --gamma 2.2 --channel green --at 0.1 --at 0.25
      lensshift evaluate mtf edge.tif --pitch-mm 0.155 --focal-length-mm 42.7
    """
    place = images.parse_region(asked.region)
    outputs.check([asked.of.image], asked.to.csv, plot=asked.to.plot)
    if asked.joint:
        measured = images.measured_frames(asked.of.image, "--joint", key=asked.of.key)
    else:
        measured = images.measured_photograph(asked.of, asked.photo)
    unit = images.frequency_unit(measured, asked.focal_length_mm)
    results = edges_of(measured, place, **asked.edges.given(measured.pitch_mm, unit))
    curve, frequency = _tell(current, results, unit, measured.length, asked.edges.at or [])
    current.result["image"] = asked.of.image
    first = "frequency_lpmm" if asked.focal_length_mm is None else "frequency_cycles_per_mrad"
    columns = {first: frequency, "modulation": curve.modulation}
    columns |= {} if curve.std is None else {"std": curve.std}
    outputs.write_table(current, asked.to.csv, columns)
    shown = measured.values if measured.values.ndim == 2 else measured.values[0]
    outputs.write_plot(current, asked.to.plot, "edges.edge_figure", results, shown, **unit.shown())


def edges_of(measured: Measured, region: Region | None, **options: Any) -> list[EdgeResult]:
    """Measure the edges of an image, or of a region of it."""
    from lensshift.evaluation.slanted_edge import measure_edges

    options |= picked(measured, "offset_px valid scale jpeg_steps")
    return measure_edges(measured.values, measured.pitch_mm, region=region, **options)


def _tell(
    current: Session, results: Sequence[EdgeResult], unit: Unit, length: str, at: Sequence[float],
) -> tuple[MtfCurve, Any]:  # fmt: skip
    """Print and keep the numbers of edges and of their mean; return its curve and frequencies."""
    from lensshift.evaluation.chart import modulation_at
    from lensshift.evaluation.slanted_edge import average_curves, average_interval, usable_edges

    edges = []
    for result in results:
        current.say(
            f"edge in {result.region}: {result.orientation}, "
            f"{math.degrees(result.angle_rad.value):.2f} degrees, contrast "
            f"{100 * result.contrast:.0f} %, SNR {result.snr:.3g}"
        )
        numbers = {name: getattr(result, name) for name, _, _ in NUMBERS}
        _say_numbers(current, numbers, unit, length, result.sample_nyquist_lpmm)
        rows = [
            {"frequency": one} | images.interval_row(modulation_at(result.mtf, one / unit.factor))
            for one in at
        ]
        edges.append(edge_row(result, unit) | {"at": rows})
        for row in rows:
            shown = f"{row['value']:.4g} ({row['low']:.4g} to {row['high']:.4g})"
            text = shown if row["value"] == row["value"] else "beyond the curve"
            current.say(f"  MTF at {row['frequency']:<16g}{text}")
    used = usable_edges(results)
    mean = {name: average_interval([getattr(one, name) for one in used]) for name, _, _ in NUMBERS}
    if len(results) > 1:
        values = [one.mtf50_lpmm.value * unit.factor for one in used]
        known = [value for value in values if value == value]
        ends = f", MTF50 from {min(known):.4g} to {max(known):.4g} {unit.name}" if known[1:] else ""
        current.say(f"mean of {len(used)} usable of {len(results)} edges{ends}")
        _say_numbers(current, mean, unit, length)
    curve = average_curves(results)
    frequency = curve.frequency_lpmm * unit.factor
    current.result |= {"unit": unit.name, "length_unit": length, "edges": edges}
    current.result["mean"] = _rows(mean, unit)
    told = picked(curve, "frequency_lpmm modulation std")
    current.result["mtf"] = {"frequency": frequency} | told
    return curve, frequency


def _say_numbers(
    current: Session, numbers: dict[str, Interval], unit: Unit, length: str,
    nyquist_lpmm: float | None = None,
) -> None:  # fmt: skip
    for name, label, kind in NUMBERS:
        number, ending = numbers[name], {"frequency": f" {unit.name}", "length": f" {length}"}
        told = ending.get(kind, "")
        if kind == "frequency":
            beyond = nyquist_lpmm is not None and number.value > nyquist_lpmm
            told += ", beyond the Nyquist frequency of the pixels" if beyond else ""
            number = number.scaled(unit.factor)
        current.say(f"  {label:<23}{number}{told if number.value == number.value else ''}")


def _rows(numbers: dict[str, Interval], unit: Unit) -> dict[str, Any]:
    """Return numbers for JSON, frequencies also in the unit."""
    rows = {name: images.interval_row(number) for name, number in numbers.items()}
    for name in ("mtf50", "mtf30", "mtf10"):
        rows[name] = images.interval_row(numbers[f"{name}_lpmm"], unit.factor)
    return rows


def edge_row(result: EdgeResult, unit: Unit) -> dict[str, Any]:
    """Return an edge for JSON."""
    row: dict[str, Any] = {"region": str(result.region), "orientation": result.orientation}
    names = ("angle_rad", "position_px", *(name for name, _, _ in NUMBERS), "asymmetry")
    row |= _rows(picked(result, " ".join(names)), unit)
    row |= picked(result, "method dark bright contrast noise snr bend_px nyquist_lpmm")
    return row | picked(result, "beyond_nyquist usable") | {"notes": list(result.notes)}
