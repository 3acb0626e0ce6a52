"""`lensshift evaluate gradient`: the slope of an edge between two limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensshift.cli.measured import (
    CsvOption,
    FrameOption,
    ImageArgument,
    KeyOption,
    Measured,
    PitchOption,
    PlotOption,
    RegionOption,
    check_outputs,
    finer,
    measured_image,
    parse_region,
    slices_of,
    write_plot,
    write_table,
)
from lensshift.cli.session import Session
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lensshift.evaluation.edge_gradient import EdgeGradient, GradientRatio


class LimitKind(StrEnum):
    """How the limits are reckoned."""

    RANGE = "range"
    LITERAL = "literal"


class PlateauKind(StrEnum):
    """How the plateaus are found."""

    MEDIAN = "median"
    EXTREMES = "extremes"


class Axis(StrEnum):
    """The axis of the lines, which cross the edge."""

    COL = "col"
    ROW = "row"


_DISTANCE_SHARE, _SHARE = 0.05, 0.10  # limits of the paper


@dataclass(frozen=True, slots=True)
class GradientOptions:
    """Options of `lensshift evaluate gradient`."""

    image: ImageArgument
    against: Path | None = option(None, "A coarser image of the same scene; gives the ratio.")
    pitch_mm: PitchOption = None
    region: RegionOption = None
    line: int | None = option(None, "One line of the region; all of them if not.", min=0)
    along: Axis = option(
        Axis.COL, "Axis of the lines: col crosses an upright edge, row a level one."
    )
    share: float | None = option(
        None, "Share cut off at both ends; 0.10, for distances 0.05 unless given."
    )
    limits: LimitKind = option(
        LimitKind.RANGE, "Share of the step, or of the plateaus as the paper words it."
    )
    plateaus: PlateauKind = option(
        PlateauKind.MEDIAN, "Medians beside the edge, or the extremes as the paper takes."
    )
    frame: FrameOption = 0
    key: KeyOption = None
    csv: CsvOption = None
    plot: PlotOption = None


@verb("measuring gradients")
def gradient(current: Session, asked: GradientOptions) -> None:
    """Measure the gradient of an edge, line by line and averaged over the phases.

    The number to trust is that of the averaged profile: the slope of one line depends on where
    the edge falls within a pixel. Regions and lines are in pixels of IMAGE, with --against in
    pixels of the coarser image.

    \b
    Example:
      lensshift evaluate gradient edge.tif --pitch-mm 0.155 --region 0,16,20,44
      lensshift evaluate gradient sharp.nc --against burst.nc --key distance --region 2,14,20,44
    """
    image, against, pitch_mm, key = asked.image, asked.against, asked.pitch_mm, asked.key
    place = parse_region(asked.region)
    check_outputs([image, against], asked.csv, asked.plot)
    fine = measured_image(image, None if against else pitch_mm, key=key, frame=asked.frame)
    coarse = None if against is None else measured_image(against, pitch_mm, key=key)
    fine, scale = (fine, 1) if coarse is None else finer(fine, coarse)
    cut = asked.share or (_DISTANCE_SHARE if key == "distance" else _SHARE)
    options: dict[str, Any] = {"share": cut, "limits": asked.limits.value}
    options |= {"plateaus": asked.plateaus.value}
    lines, step_mm = _lines(fine, place, asked, scale)
    found = _gradient(lines, step_mm, options)
    _say(current, found, fine.length)
    current.result |= {"image": image, "length_unit": fine.length, **options}
    current.result["gradient"] = _row(found)
    if coarse is not None:
        _compare(current, found, _gradient(*_lines(coarse, place, asked, 1), options))
    columns = {"line": list(range(len(found.lines))), "slope": found.slope_per_mm}
    columns |= {"normalised": found.normalised_per_mm, "width": found.width_mm}
    write_table(current, asked.csv, columns)
    write_plot(current, asked.plot, lambda: _figure(found, lines, step_mm, fine.length))


def _lines(
    measured: Measured,
    region: tuple[int, int, int, int] | None,
    asked: GradientOptions,
    scale: int,
) -> tuple[NDArray[Any], float]:
    """Return the lines [line n] and the distance of their samples."""
    import numpy as np

    place = region
    if region is not None:
        place = (scale * region[0], scale * region[1], scale * region[2], scale * region[3])
    part = np.asarray(measured.values[slices_of(place, measured.values.shape)])
    upright, line = asked.along is Axis.COL, asked.line
    lines = part if upright else part.T
    if line is not None:
        first = line * scale
        if first + scale > len(lines):
            raise ValueError(f"expected a line from 0 to {len(lines) // scale - 1}, got {line}")
        lines = lines[first : first + scale]
    return lines, measured.pitch_mm[1 if upright else 0]


def _gradient(lines: NDArray[Any], step_mm: float, options: dict[str, Any]) -> EdgeGradient:
    from lensshift.evaluation.edge_gradient import edge_gradient

    return edge_gradient(lines, step_mm=step_mm, **options)


def _say(current: Session, found: EdgeGradient, length: str) -> None:
    interval = found.interval_per_mm
    ends = "" if interval is None else f" ({interval[0]:.4g} to {interval[1]:.4g})"
    count = len(found.lines)
    current.say(f"{count} line{'s' if count > 1 else ''}")
    current.say(f"  mean gradient      {found.mean_per_mm:.4g}{ends} of the step per {length}")
    current.say(f"  median gradient    {found.median_per_mm:.4g} of the step per {length}")
    if found.averaged is not None:
        averaged = found.averaged
        current.say(
            f"  averaged profile   {averaged.normalised_per_mm:.4g} of the step per {length}, "
            f"width {averaged.width_mm:.4g} {length}"
        )


def _compare(current: Session, fine: EdgeGradient, coarse: EdgeGradient) -> None:
    from lensshift.evaluation.edge_gradient import gradient_ratio

    ratio: GradientRatio = gradient_ratio(fine, coarse)
    ends = (
        ""
        if ratio.interval is None
        else f" ({ratio.interval[0]:.4g} to {ratio.interval[1]:.4g}) from the means of the lines"
    )
    current.say(f"  ratio              {ratio.ratio:.4g}{ends}")
    if ratio.averaged is not None:
        current.say(f"  ratio to trust     {ratio.averaged:.4g} from the averaged profiles")
    current.result["against"] = _row(coarse)
    current.result["ratio"] = {
        "mean": ratio.ratio,
        "interval": ratio.interval,
        "averaged": ratio.averaged,
    }


def _row(found: EdgeGradient) -> dict[str, Any]:
    averaged = found.averaged
    return {
        "lines": len(found.lines),
        "mean_per_mm": found.mean_per_mm,
        "median_per_mm": found.median_per_mm,
        "interval_per_mm": found.interval_per_mm,
        "slope_per_mm": found.slope_per_mm,
        "averaged_per_mm": None if averaged is None else averaged.normalised_per_mm,
        "averaged_width_mm": None if averaged is None else averaged.width_mm,
    }


def _figure(found: EdgeGradient, lines: NDArray[Any], step_mm: float, length: str) -> Any:
    from lensshift.report.gradient import gradient_figure

    return gradient_figure(found, lines, step_mm=step_mm, length=length)
