"""`lensshift evaluate chart`: a lens from photographs of a chart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lensshift.cli import images, outputs
from lensshift.cli.images import FocalOption, ImageOptions, PhotoOptions, PitchOption
from lensshift.cli.inputs import parse_numbers, parse_pitch_mm, refuse_overwriting
from lensshift.cli.mtf import EdgeOptions
from lensshift.cli.session import Progress, Session, picked
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from lensshift.evaluation.chart import ChartEdge
    from lensshift.evaluation.chart_series import Photograph


@dataclass(frozen=True, slots=True)
class _ChartOptions:
    images: list[Path] = argument("Photographs of one lens.")
    pitch_mm: PitchOption = None
    focus: str | None = option(None, "Positions of the focus, one a photograph: 0,10,20.")
    focus_unit: str = option("", "Their unit, to be shown.")
    edges: EdgeOptions = field(default_factory=EdgeOptions)
    photo: PhotoOptions = field(default_factory=PhotoOptions)
    focal_length_mm: FocalOption = None
    eye_heights: float = option(2.0, "For the acutance: distance of the eye in picture heights.")
    report: Path | None = option(None, "Write an HTML page.")
    csv: Path | None = option(None, "Write a row for each edge.")
    annotate: Path | None = option(None, "Folder for each photograph with what was measured in it.")
    workers: int | None = option(None, "Processes; one a core if it is worth it.", min=1)


@verb()
def chart(current: Session, asked: _ChartOptions) -> None:
    """Measure all slanted edges of photographs: field map, through focus, a page, a table.

    \b
    Examples:
      lensshift evaluate chart photo.jpg --gamma 2.2 --report lens.html --csv edges.csv
      lensshift evaluate chart f0.png f1.png f2.png --focus 0,10,20 --focus-unit um
      lensshift evaluate chart raw.tif --bayer RGGB --channel red --pitch-mm 0.0034 --at 60
    """
    from lensshift.core.processes import ready_with

    read, seen = [*asked.images, asked.photo.oecf], _annotated_files(asked)
    outputs.check(read, asked.report, asked.csv)
    refuse_overwriting(read, seen)
    # Processes get ready while this one imports what it measures with.
    context = None if asked.workers == 1 else ready_with("lensshift.evaluation.chart_series")

    from lensshift.evaluation.chart import edge_rows
    from lensshift.evaluation.chart_series import focus_series, measure_chart

    pictures, pitch = _pictures(asked)
    unit = images.frequency_unit(pitch, asked.focal_length_mm)
    told = asked.edges.given(pitch.pitch_mm, unit) | {"workers": asked.workers, "context": context}
    with Progress("measuring edges") as progress:
        edges = measure_chart(pictures, pitch.pitch_mm, on_edge=progress.count, **told)
    wanted = [one / unit.factor for one in asked.edges.at or []]
    series, fits = focus_series(edges) if asked.focus is not None else ([], {})
    acutances = _acutances(pictures, edges, pitch.pitch_mm[0], asked.eye_heights)
    rows = list(edge_rows(edges, wanted, unit.factor))
    current.result |= {"unit": unit.name, "edges": rows}
    _tell(current, edges, unit, acutances)
    ending = f" {asked.focus_unit}" if asked.focus_unit else ""
    current.result |= {"acutance": acutances, "eye_heights": asked.eye_heights}
    current.result["best_focus"] = found = {}
    for zone, one in fits.items():
        half = one.mtf50_lpmm * unit.factor
        found[zone] = picked(one, "focus sigma low high") | {"mtf50": half}
        current.say(f"best focus {zone:<20} {one}{ending}, MTF50 {half:.4g} {unit.name}")
    suffix = f"_{unit.name.replace('/', '_per_').lower()}"
    endings = {name: suffix for name in rows[0] if name.startswith(("mtf50", "mtf30", "mtf10"))}
    columns = {name + endings.get(name, ""): [row[name] for row in rows] for name in rows[0]}
    outputs.write_table(current, asked.csv, columns)
    if asked.annotate is not None:
        from lensshift.pipeline.run import made_folder

        made_folder(asked.annotate)
    for file, photo in zip(seen, pictures, strict=False):  # none, or one of each
        here = [edge for edge in edges if edge.image == photo.name]
        outputs.write_plot(current, file, "chart.annotated_figure", photo.first, here, unit.name)
    if asked.report is not None:
        from lensshift.report.chart import chart_page

        chart_page(
            edges,
            [(one.name, one.first) for one in pictures],
            **unit.shown(),
            at_lpmm=wanted,
            acutances=acutances,
            series=series,
            fits=fits,
            focus_label=f"focus ({asked.focus_unit})" if asked.focus_unit else "focus",
        ).save(asked.report)
        current.say(f"wrote {asked.report}")


def _pictures(asked: _ChartOptions) -> tuple[list[Photograph], images.Measured]:
    """Return the photographs, and the first as it was read, with the pitch of all."""
    from lensshift.evaluation.chart_series import Photograph

    paths, focus, count = asked.images, asked.focus, len(asked.images)
    expected = f"a focus for each of {count} photographs, as 0,10,20"
    places = range(count) if focus is None else parse_numbers(focus, count, expected)
    if asked.pitch_mm is not None:
        parse_pitch_mm(asked.pitch_mm)
    wanted = [ImageOptions(path, asked.pitch_mm) for path in paths]
    read = [images.measured_photograph(one, asked.photo) for one in wanted]
    if len({one.pitch_mm for one in read}) > 1:
        raise ValueError("expected photographs with one pitch, got several")
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    pictures = [
        Photograph(name, one.values, float(place), one.offset_px, one.jpeg_steps)
        for name, one, place in zip(names, read, places, strict=True)
    ]
    return pictures, read[0]


def _acutances(
    pictures: Sequence[Photograph], edges: Sequence[ChartEdge], pitch_mm: float, heights: float
) -> dict[str, float]:
    """Return the acutance of each photograph, of the mean curve of its usable edges."""
    from lensshift.evaluation.chart import acutance
    from lensshift.evaluation.slanted_edge import average_curves

    found = {}
    for one in pictures:
        here = [edge.result for edge in edges if edge.image == one.name and edge.result.usable]
        if here:
            height_mm = one.first.shape[0] * pitch_mm
            found[one.name] = acutance(average_curves(here), height_mm, heights)
    return found


def _tell(
    current: Session, edges: Sequence[ChartEdge], unit: images.Unit, acutances: dict[str, float]
) -> None:
    """Print and keep the zones of each photograph."""
    from lensshift.evaluation.chart import zone_rows

    zones = []
    for name in dict.fromkeys(one.image for one in edges):
        here = [one for one in edges if one.image == name]
        usable = sum(one.result.usable for one in here)
        sharp = f", acutance {acutances[name]:.3f}" if name in acutances else ""
        current.say(f"{name}: {usable} usable of {len(here)} edges{sharp}")
        for row in zone_rows(here):
            half = row["mtf50_lpmm"]
            current.say(
                f"  {row['zone']:<9} {row['direction']:<11} {row['edges']:>3} edges  MTF50 "
                f"{half.scaled(unit.factor)} {unit.name}"
            )
            told = {"mtf50_lpmm": images.interval_row(half)}
            told["mtf50"] = images.interval_row(half, unit.factor)
            zones.append({"image": name} | row | told)
    current.result["zones"] = zones


def _annotated_files(asked: _ChartOptions) -> list[Path]:
    """Return where each photograph is written with what was measured; numbered where names meet."""
    if asked.annotate is None:
        return []
    from lensshift.pipeline.run import writable_folder

    writable_folder(asked.annotate)
    stems = [path.stem for path in asked.images]
    if len(set(stems)) < len(stems):
        stems = [f"{stem}_{number}" for number, stem in enumerate(stems)]
    return [asked.annotate / f"{stem}_edges.png" for stem in stems]
