"""`lensshift evaluate chart`: a lens from photographs of a chart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import parse_pitch_mm, refuse_overwriting
from lensshift.cli.measured import (
    BayerOption,
    ChannelOption,
    FocalOption,
    GammaOption,
    OecfOption,
    PhotoOptions,
    PitchOption,
    Unit,
    frequency_unit,
    interval_row,
    measured_photograph,
    write_plot,
    write_table,
)
from lensshift.cli.mtf import (
    ApertureOption,
    AtOption,
    EdgeMethod,
    MethodOption,
    OrderOption,
    TiltOption,
    WindowOption,
    method_options,
)
from lensshift.cli.session import DebugOption, JsonOption, Progress, Session, session

if TYPE_CHECKING:
    from lensshift.evaluation.chart import ChartEdge
    from lensshift.evaluation.chart_series import Photograph

ImagesArgument = Annotated[list[Path], typer.Argument(help="Photographs of one lens.")]
ReportOption = Annotated[Path | None, typer.Option("--report", help="Write an HTML page.")]
TableOption = Annotated[Path | None, typer.Option("--csv", help="Write a row for each edge.")]
AnnotateOption = Annotated[
    Path | None,
    typer.Option("--annotate", help="Folder for each photograph with what was measured in it."),
]
FocusOption = Annotated[
    str | None,
    typer.Option("--focus", help="Positions of the focus, one a photograph: 0,10,20."),
]
FocusUnitOption = Annotated[str, typer.Option("--focus-unit", help="Their unit, to be shown.")]
EyeOption = Annotated[
    float,
    typer.Option(
        "--eye-heights", min=0.1, help="For the acutance: distance of the eye in picture heights."
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes; one a core if it is worth it.")
]


def chart(
    images: ImagesArgument,
    pitch_mm: PitchOption = None,
    focus: FocusOption = None,
    focus_unit: FocusUnitOption = "",
    at: AtOption = None,
    method: MethodOption = EdgeMethod.ML,
    order: OrderOption = None,
    window: WindowOption = None,
    aperture_px: ApertureOption = None,
    tilt: TiltOption = None,
    channel: ChannelOption = None,
    gamma: GammaOption = None,
    oecf: OecfOption = None,
    bayer: BayerOption = None,
    focal_length_mm: FocalOption = None,
    eye_heights: EyeOption = 2.0,
    report: ReportOption = None,
    csv: TableOption = None,
    annotate: AnnotateOption = None,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Measure all slanted edges of photographs: field map, through focus, a page, a table.

    \b
    Examples:
      lensshift evaluate chart photo.jpg --gamma 2.2 --report lens.html --csv edges.csv
      lensshift evaluate chart f0.png f1.png f2.png --focus 0,10,20 --focus-unit um
      lensshift evaluate chart raw.tif --bayer RGGB --channel red --pitch-mm 0.0034 --at 60
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.evaluation.chart_series import focus_series, measure_chart

        outputs = [path for path in (report, csv) if path is not None]
        refuse_overwriting([*images, oecf], outputs)
        photo = PhotoOptions(channel, gamma, oecf, bayer)
        pictures, pitch = _pictures(images, pitch_mm, photo, focus)
        unit = frequency_unit(pitch, focal_length_mm)
        progress = Progress("measuring edges")
        edges = measure_chart(
            pictures,
            pitch.pitch_mm,
            workers=workers,
            on_edge=progress.count,
            method=method.value,
            **method_options(order=order, window=window, aperture_px=aperture_px, tilt=tilt),
        )
        progress.close()
        wanted = [one / unit.factor for one in at or []]
        series, fits = focus_series(edges) if focus is not None else ([], {})
        acutances = _acutances(pictures, edges, pitch.pitch_mm[0], eye_heights)
        _say(current, edges, unit, acutances)
        _say_focus(current, fits, focus_unit, unit)
        _tell(current, edges, unit, wanted)
        current.result |= {"acutance": acutances, "eye_heights": eye_heights}
        current.result["best_focus"] = {zone: _plain(one, unit) for zone, one in fits.items()}
        _write_rows(current, csv, edges, wanted, unit)
        _annotated(current, annotate, pictures, edges, unit)
        if report is not None:
            _write_page(current, report, edges, pictures, wanted, unit, acutances,
                        (series, fits, focus_unit))  # fmt: skip


def _write_page(
    current: Session,
    report: Path,
    edges: Sequence[ChartEdge],
    pictures: Sequence[Photograph],
    wanted: Sequence[float],
    unit: Unit,
    acutances: dict[str, float],
    through_focus: tuple[list[dict[str, Any]], dict[str, Any], str],
) -> None:
    from lensshift.report.chart import chart_page

    series, fits, focus_unit = through_focus
    chart_page(
        edges,
        [(one.name, one.first) for one in pictures],
        unit=unit.name,
        factor=unit.factor,
        at_lpmm=wanted,
        acutances=acutances,
        series=[row | {"mtf50": row["mtf50_lpmm"] * unit.factor} for row in series],
        fits={zone: one.scaled(unit.factor) for zone, one in fits.items()},
        focus_label=f"focus ({focus_unit})" if focus_unit else "focus",
    ).save(report)
    current.say(f"wrote {report}")


def _pictures(
    images: Sequence[Path], pitch_mm: str | None, photo: PhotoOptions, focus: str | None
) -> tuple[list[Photograph], Any]:
    """Return the photographs, and the first as it was read, with the pitch of all."""
    from lensshift.evaluation.chart_series import Photograph

    places = _focus(focus, len(images))
    if pitch_mm is not None:
        parse_pitch_mm(pitch_mm)
    read = [measured_photograph(path, pitch_mm, photo) for path in images]
    if len({one.pitch_mm for one in read}) > 1:
        raise ValueError("expected photographs with one pitch, got several")
    names = [path.name for path in images]
    if len(set(names)) < len(names):
        names = [str(path) for path in images]
    pictures = [
        Photograph(name, one.values, place, one.offset_px)
        for name, one, place in zip(names, read, places, strict=True)
    ]
    return pictures, read[0]


def _focus(text: str | None, count: int) -> list[float]:
    if text is None:
        return [float(number) for number in range(count)]
    from lensshift.cli.measured import parse_numbers

    return list(parse_numbers(text, count, f"a focus for each of {count} photographs, as 0,10,20"))


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


def _say(
    current: Session, edges: Sequence[ChartEdge], unit: Unit, acutances: dict[str, float]
) -> None:
    from lensshift.evaluation.chart import zone_rows

    for name in dict.fromkeys(one.image for one in edges):
        here = [one for one in edges if one.image == name]
        usable = sum(one.result.usable for one in here)
        sharp = f", acutance {acutances[name]:.3f}" if name in acutances else ""
        current.say(f"{name}: {usable} usable of {len(here)} edges{sharp}")
        for row in zone_rows(here):
            current.say(
                f"  {row['zone']:<9} {row['direction']:<11} {row['edges']:>3} edges  MTF50 "
                f"{row['mtf50_lpmm'].scaled(unit.factor)} {unit.name}"
            )


def _say_focus(current: Session, fits: dict[str, Any], focus_unit: str, unit: Unit) -> None:
    for zone, one in fits.items():
        ending = f" {focus_unit}" if focus_unit else ""
        current.say(
            f"best focus {zone:<9} {one.focus:.4g} +- {one.sigma:.2g}{ending}, "
            f"MTF50 {one.mtf50_lpmm * unit.factor:.4g} {unit.name}"
        )


def _plain(one: Any, unit: Unit) -> dict[str, float]:
    return {"focus": one.focus, "sigma": one.sigma, "mtf50": one.mtf50_lpmm * unit.factor}


def _tell(
    current: Session, edges: Sequence[ChartEdge], unit: Unit, wanted: Sequence[float]
) -> None:
    from lensshift.evaluation.chart import edge_rows, zone_rows

    current.result |= {"unit": unit.name, "edges": list(edge_rows(edges, wanted, unit.factor))}
    current.result["zones"] = [
        {"image": name}
        | row
        | {"mtf50_lpmm": interval_row(row["mtf50_lpmm"])}
        | {"mtf50": interval_row(row["mtf50_lpmm"], unit.factor)}
        for name in dict.fromkeys(one.image for one in edges)
        for row in zone_rows([one for one in edges if one.image == name])
    ]


def _write_rows(
    current: Session,
    csv: Path | None,
    edges: Sequence[ChartEdge],
    wanted: Sequence[float],
    unit: Unit,
) -> None:
    from lensshift.evaluation.chart import edge_rows

    rows = list(edge_rows(edges, wanted, unit.factor))
    told = {"mtf50", "mtf30", "mtf10"}
    suffix = unit.name.replace("/", "_per_").lower()
    columns = {}
    for name in rows[0]:
        shown = f"{name}_{suffix}" if name.partition("_")[0] in told else name
        columns[shown] = [row[name] for row in rows]
    write_table(current, csv, columns)


def _annotated(
    current: Session,
    folder: Path | None,
    pictures: Sequence[Photograph],
    edges: Sequence[ChartEdge],
    unit: Unit,
) -> None:
    if folder is None:
        return
    from lensshift.pipeline.run import made_folder, writable_folder
    from lensshift.report.chart import annotated_figure

    made_folder(writable_folder(folder))
    for one in pictures:
        here = [edge for edge in edges if edge.image == one.name]
        name = folder / f"{Path(one.name).stem}_edges.png"
        write_plot(current, name, lambda: annotated_figure(one.first, here, unit.name))  # noqa: B023
