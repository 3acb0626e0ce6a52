"""`lensshift evaluate gain`: how much finer one image of a target is than another."""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensshift.cli import images, outputs
from lensshift.cli.mtf import edge_row, edges_of
from lensshift.cli.session import Session
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lensshift.evaluation.gain import ResolutionGain

_RATIOS = (("mtf50", "MTF50"), ("mtf10", "MTF10"), ("width", "10-90 width"))


@dataclass(frozen=True, slots=True)
class _GainOptions:
    fine: Path = argument("The finer image, such as a reconstruction.")
    coarse: Path = argument("The coarser image, such as a burst file.")
    pitch_mm: str | None = option(None, "Pixel pitch of COARSE, if it is a plain image.")
    region: str | None = option(None, "Region in pixels of COARSE: row start,stop,col start,stop.")
    joint: bool = option(False, "Measure all frames of COARSE jointly.")
    frame: int = option(0, "Frame of COARSE, if it holds several.", min=0)
    key: images.KeyOption = None
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


@verb("measuring edges")
def gain(current: Session, asked: _GainOptions) -> None:
    """Compare the resolution of two images of one target, and their noise.

    Ratios above 1 mean that FINE resolves more; the noise is that of a pixel over the contrast of
    the edge. Both images show the whole scene, so their shapes tell the scale. Intervals are of the
    edges as they are drawn; a reconstruction may draw a lone edge steeper than it resolves, which
    `evaluate resolution` finds with a star or bars in the scene.

    \b
    Example:
      lensshift evaluate gain sharp.nc burst.nc --region 0,16,4,30
      lensshift evaluate gain sharp.tif frame.tif --pitch-mm 0.155 --plot gain.png
    """
    from lensshift.evaluation.gain import average_gain, pair_edges, resolution_gain

    fine, coarse, key = asked.fine, asked.coarse, asked.key
    place = images.parse_region(asked.region)
    outputs.check([fine, coarse], asked.to.csv, plot=asked.to.plot)
    of_fine, of_coarse = images.keys_of(key, fine, coarse)
    if asked.joint:
        below = images.measured_frames(coarse, "--joint", key=of_coarse)
    else:
        below = images.measured_image(coarse, asked.pitch_mm, key=of_coarse, frame=asked.frame)
        below = replace(below, offset_px=below.frame_px)
    above, scale = images.finer(images.measured_image(fine, None, key=of_fine), below)
    if scale == 1 and (above.values == below.values).all():
        raise ValueError(f"expected two images, got one twice: {fine} holds what {coarse} does")
    images.slices_of(place, below.values.shape[-2:])  # which refuses it in pixels of COARSE
    with _in_file(coarse):
        edges = edges_of(below, place)
    with _in_file(fine):
        finer_edges = edges_of(above, images.scaled(place, scale))
    pairs = pair_edges(finer_edges, edges, scale)
    if not pairs:
        raise ValueError("expected an edge that both images show, got none; give --region")
    gains = [resolution_gain(first, second) for first, second in pairs]
    for (_, second), one in zip(pairs, gains, strict=True):
        current.say(f"edge in {second.region} of {coarse}")
        _say(current, one)
    mean = average_gain(gains)
    if len(gains) > 1:
        current.say(f"mean of {len(gains)} edges")
        _say(current, mean)
    unit = images.Unit("LP/mm" if below.has_pitch else "cycles/px")
    current.result |= {"fine": fine, "coarse": coarse, "scale": scale, "unit": unit.name}
    rows = [
        {"gain": asdict(one), "fine": edge_row(first, unit), "coarse": edge_row(second, unit)}
        for (first, second), one in zip(pairs, gains, strict=True)
    ]
    current.result |= {"gain": asdict(mean), "edges": rows}
    outputs.write_table(current, asked.to.csv, _table(gains))
    shown = ("edges.gain_figure", *pairs[0], gains[0])
    outputs.write_plot(current, asked.to.plot, *shown, unit=unit.name)


@contextmanager
def _in_file(path: Path) -> Iterator[None]:
    """Let what is warned of and refused begin with the file: each has pixels of its own."""
    with warnings.catch_warnings(record=True) as caught:
        try:
            yield
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    for one in caught:
        warnings.warn_explicit(f"{path}: {one.message}", one.category, one.filename, one.lineno)


def _say(current: Session, found: ResolutionGain) -> None:
    for name, label in _RATIOS:
        current.say(f"  gain in {label:<15}{getattr(found, name)}")
    current.say(f"  {'gain in noise':<23}{found.noise:.4g}")


def _table(gains: Sequence[ResolutionGain]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {"edge": list(range(len(gains)))}
    for name, _ in _RATIOS:
        for end, column in (("value", name), ("low", f"{name}_low"), ("high", f"{name}_high")):
            columns[column] = [getattr(getattr(one, name), end) for one in gains]
    return columns | {"noise": [one.noise for one in gains]}
