"""`lensshift evaluate mtf`: the resolution of an image with a slanted edge."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import Kind, kind_of, load_input_image, parse_pitch_mm
from lensshift.cli.session import DebugOption, JsonOption, Session, session

if TYPE_CHECKING:
    from lensshift.evaluation.slanted_edge import EdgeResult

ImageArgument = Annotated[Path, typer.Argument(help="Image, burst file or reconstruction.")]
PitchOption = Annotated[
    str | None,
    typer.Option(
        "--pitch-mm",
        help="Pixel pitch of an image: one number, or row,col. Without it: cycles per pixel.",
    ),
]
RegionOption = Annotated[
    str | None,
    typer.Option("--region", help="Region of the edge: row start,row stop,col start,col stop."),
]
JointOption = Annotated[
    bool, typer.Option("--joint", help="Fit all frames of a burst file together.")
]
FrameOption = Annotated[int, typer.Option(min=0, help="Frame of IMAGE, if it holds several.")]
KeyOption = Annotated[
    str | None, typer.Option("--key", help="Array of an NPZ file, or channel of a reconstruction.")
]
CsvOption = Annotated[Path | None, typer.Option("--csv", help="Write the mean curve there.")]

# Name in the result, name for people, unit.
_NUMBERS = (
    ("mtf50_lpmm", "MTF50", True),
    ("mtf30_lpmm", "MTF30", True),
    ("mtf10_lpmm", "MTF10", True),
    ("mtf_at_nyquist", "MTF at LR Nyquist", False),
    ("area_to_nyquist", "mean MTF to LR Nyquist", False),
    ("peak", "peak", False),
)


def mtf(
    image: ImageArgument,
    pitch_mm: PitchOption = None,
    region: RegionOption = None,
    joint: JointOption = False,
    frame: FrameOption = 0,
    key: KeyOption = None,
    csv: CsvOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Measure the MTF of slanted edges, with 95 % intervals.

    \b
    Example:
      lensshift evaluate mtf edge.tif --pitch-mm 0.155 --csv mtf.csv
      lensshift evaluate mtf burst.nc --joint --region 0,16,20,50
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.evaluation.slanted_edge import average_curves, measure_edges

        place = None if region is None else _region(region)
        values, options = _input(image, pitch_mm, joint, frame, key)
        results = measure_edges(values, options.pop("pitch_mm"), region=place, **options)
        unit = "LP/mm" if _has_pitch(image, pitch_mm) else "cycles/px"
        for result in results:
            _say(current, result, unit)
        curve = average_curves(results)
        current.result |= {"image": image, "unit": unit, "edges": [_row(r) for r in results]}
        current.result["mtf"] = {
            "frequency_lpmm": curve.frequency_lpmm.tolist(),
            "modulation": curve.modulation.tolist(),
            "std": None if curve.std is None else curve.std.tolist(),
        }
        if csv is not None:
            from lensshift.io.atomic import written_whole

            columns = [curve.frequency_lpmm, curve.modulation]
            columns += [] if curve.std is None else [curve.std]
            names = ("frequency_lpmm", "modulation", "std")[: len(columns)]
            rows = zip(*columns, strict=True)
            with written_whole(csv) as part:
                lines = [",".join(f"{number:.8g}" for number in row) for row in rows]
                part.write_text("\n".join([",".join(names), *lines]) + "\n")
            current.say(f"wrote {csv}")


def _input(
    path: Path, pitch_mm: str | None, joint: bool, frame: int, key: str | None
) -> tuple[Any, dict[str, Any]]:
    from lensshift.io import load_burst, load_reconstruction

    kind = kind_of(path)
    if joint:
        if kind is not Kind.BURST:
            raise typer.BadParameter(f"--joint needs a burst file, got {path}")
        burst = load_burst(path)
        options = {"pitch_mm": burst.grid.pitch_mm, "offset_px": burst.offset_px}
        return burst.amplitude, options | {"valid": burst.valid}
    values = load_input_image(path, key=key, frame=frame)
    if kind is Kind.BURST:
        return values, {"pitch_mm": load_burst(path).grid.pitch_mm}
    if kind is Kind.RECONSTRUCTION:
        result = load_reconstruction(path)
        return values, {"pitch_mm": result.grid.pitch_mm, "scale": result.scale}
    return values, {"pitch_mm": (1.0, 1.0) if pitch_mm is None else parse_pitch_mm(pitch_mm)}


def _has_pitch(path: Path, pitch_mm: str | None) -> bool:
    return pitch_mm is not None or kind_of(path) is not Kind.STACK


def _region(text: str) -> tuple[int, int, int, int]:
    try:
        ends = [int(part) for part in text.split(",")]
    except ValueError as error:
        raise typer.BadParameter(f"expected a region like 0,16,20,50, got {text!r}") from error
    if len(ends) != 4:
        raise typer.BadParameter(f"expected a region like 0,16,20,50, got {text!r}")
    return ends[0], ends[1], ends[2], ends[3]


def _say(current: Session, result: EdgeResult, unit: str) -> None:
    import numpy as np

    current.say(
        f"edge in {result.region}: {result.orientation}, "
        f"{np.rad2deg(result.angle_rad.value):.2f} degrees, contrast "
        f"{100 * result.contrast:.0f} %, SNR {result.snr:.3g}"
    )
    for name, label, is_frequency in _NUMBERS:
        current.say(f"  {label:<23}{getattr(result, name)}{' ' + unit if is_frequency else ''}")
    length = "mm" if unit == "LP/mm" else "px"
    current.say(f"  {'effective pixel':<23}{result.effective_pixel_mm} {length}")
    current.say(f"  {'10-90 width':<23}{result.rise_mm} {length}")


def _row(result: EdgeResult) -> dict[str, Any]:
    names = ["angle_rad", "position_px", *(n for n, _, _ in _NUMBERS)]
    names += ["effective_pixel_mm", "rise_mm", "asymmetry"]
    row: dict[str, Any] = {"region": str(result.region), "orientation": result.orientation}
    for name in names:
        number = getattr(result, name)
        row[name] = {"value": number.value, "low": number.low, "high": number.high}
    for name in ("dark", "bright", "noise", "snr", "bend_px", "nyquist_lpmm"):
        row[name] = getattr(result, name)
    return row
