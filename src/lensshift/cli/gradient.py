"""`lensshift evaluate gradient`: the slope of an edge between two limits."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lensshift.cli import images, outputs
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lensshift.evaluation.edge_gradient import EdgeGradient


_DISTANCE_SHARE, _SHARE = 0.05, 0.10  # limits of the paper


@dataclass(frozen=True, slots=True)
class _GradientOptions:
    of: images.ImageOptions
    against: Path | None = option(None, "A coarser image of the same scene; gives the ratio.")
    region: images.RegionOption = None
    line: int | None = option(None, "One line of the region; all of them if not.", min=0)
    along: Literal["col", "row"] = option(
        "col", "Axis of the lines: col crosses an upright edge, row a level one."
    )
    share: float | None = option(
        None, "Share cut off at both ends; 0.10, for distances 0.05 unless given."
    )
    limits: Literal["range", "literal"] = option(
        "range", "Share of the step, or of the plateaus as the paper words it."
    )
    plateaus: Literal["median", "extremes"] = option(
        "median", "Medians beside the edge, or the extremes as the paper takes."
    )
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


@verb("measuring gradients")
def gradient(current: Session, asked: _GradientOptions) -> None:
    """Measure the gradient of an edge, line by line and averaged over the phases.

    The number to trust is that of the averaged profile: the slope of one line depends on where
    the edge falls within a pixel. Regions and lines are in pixels of IMAGE, with --against in
    pixels of the coarser image.

    \b
    Example:
      lensshift evaluate gradient edge.tif --pitch-mm 0.155 --region 0,16,20,44
      lensshift evaluate gradient sharp.nc --against burst.nc --key distance --region 2,14,20,44
    """
    from lensshift.evaluation.edge_gradient import edge_gradient

    against, key = asked.against, asked.of.key
    place = images.parse_region(asked.region)
    outputs.check([asked.of.image, against], asked.to.csv, plot=asked.to.plot)
    if against is None:
        fine, coarse = images.measured_of(asked.of), None
    else:
        of_fine, of_coarse = images.keys_of(key, asked.of.image, against)
        fine = images.measured_of(replace(asked.of, pitch_mm=None, key=of_fine))
        coarse = images.measured_image(against, asked.of.pitch_mm, key=of_coarse)
    fine, scale = (fine, 1) if coarse is None else images.finer(fine, coarse)
    options = picked(asked, "share limits plateaus")
    if asked.share is None:
        options["share"] = _DISTANCE_SHARE if key == "distance" else _SHARE
    lines, step_mm = _lines(fine, place, asked, scale)
    found = edge_gradient(lines, step_mm=step_mm, **options)
    _say(current, found, fine.length)
    current.result |= {"image": asked.of.image, "length_unit": fine.length, **options}
    current.result["gradient"] = _row(found)
    other: tuple[EdgeGradient, NDArray[Any], float] | None = None
    if coarse is not None:
        coarse_lines, coarse_mm = _lines(coarse, place, asked, 1)
        other = edge_gradient(coarse_lines, step_mm=coarse_mm, **options), coarse_lines, coarse_mm
        _compare(current, found, other[0])
    columns = {"line": list(range(len(found.lines))), "slope": found.slope_per_mm}
    columns |= {"normalised": found.normalised_per_mm, "width": found.width_mm}
    outputs.write_table(current, asked.to.csv, columns)
    told = {"step_mm": step_mm, "length": fine.length, "against": other}
    outputs.write_plot(current, asked.to.plot, "gradient.gradient_figure", found, lines, **told)


def _lines(
    measured: images.Measured, region: images.Region | None, asked: _GradientOptions, scale: int
) -> tuple[NDArray[Any], float]:
    """Return the lines [line n] and the distance of their samples."""
    values = measured.values
    part = values[images.slices_of(images.scaled(region, scale), values.shape)]
    upright, line = asked.along == "col", asked.line
    lines = part if upright else part.T
    if line is not None:
        first = line * scale
        if first + scale > len(lines):
            raise ValueError(f"expected a line from 0 to {len(lines) // scale - 1}, got {line}")
        lines = lines[first : first + scale]
    return lines, measured.pitch_mm[1 if upright else 0]


def _say(current: Session, found: EdgeGradient, length: str) -> None:
    count, ends = len(found.lines), _ends(found.interval_per_mm)
    current.say(f"{count} line{'s' if count > 1 else ''}")
    current.say(f"  mean gradient      {found.mean_per_mm:.4g}{ends} of the step per {length}")
    current.say(f"  median gradient    {found.median_per_mm:.4g} of the step per {length}")
    if found.averaged is not None:
        averaged = found.averaged
        current.say(
            f"  averaged profile   {averaged.normalised_per_mm:.4g} of the step per {length}, "
            f"width {averaged.width_mm:.4g} {length}"
        )


def _ends(interval: tuple[float, float] | None) -> str:
    return "" if interval is None else f" ({interval[0]:.4g} to {interval[1]:.4g})"


def _compare(current: Session, fine: EdgeGradient, coarse: EdgeGradient) -> None:
    from lensshift.evaluation.edge_gradient import gradient_ratio

    ratio = gradient_ratio(fine, coarse)
    ends = _ends(ratio.interval)
    ends += " from the means of the lines" if ends else ""
    current.say(f"  ratio              {ratio.ratio:.4g}{ends}")
    if ratio.averaged is not None:
        current.say(f"  ratio to trust     {ratio.averaged:.4g} from the averaged profiles")
    current.result["against"] = _row(coarse)
    current.result["ratio"] = {"mean": ratio.ratio} | picked(ratio, "interval averaged")


def _row(found: EdgeGradient) -> dict[str, Any]:
    row = picked(found, "mean_per_mm median_per_mm interval_per_mm slope_per_mm")
    row["lines"] = len(found.lines)
    row["averaged_per_mm"] = found.averaged and found.averaged.normalised_per_mm
    return row | {"averaged_width_mm": found.averaged and found.averaged.width_mm}
