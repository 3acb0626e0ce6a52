"""`lensshift evaluate star`, `zone`, `frc` and `resolution`: what patterns show."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from lensshift.cli import images, outputs
from lensshift.cli.inputs import parse_numbers
from lensshift.cli.mtf import edges_of
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import argument, option, verb

Pair = tuple[float, float]
Profile = Literal["sine", "square"]  # that a pattern was printed with
CenterOption = Annotated[
    str | None, typer.Option("--center-px", help="Centre as row,col; found if not given.")
]
LevelsOption = Annotated[
    str | None, typer.Option(help="Values of large black and white areas, as black,white.")
]

_CENTER = "a centre like 7.5,31.5"
_LEVELS = (0.5, 0.3, 0.1)  # of contrast, where curves are read off by custom


@dataclass(frozen=True, slots=True, kw_only=True)
class _PatternOptions:
    of: images.ImageOptions
    center_px: CenterOption = None
    levels: LevelsOption = None
    photo: images.PhotoOptions = field(default_factory=images.PhotoOptions)
    focal_length_mm: images.FocalOption = None
    to: outputs.Outputs = field(default_factory=outputs.Outputs)


@dataclass(frozen=True, slots=True, kw_only=True)
class _StarOptions(_PatternOptions):
    cycles: int = option(MISSING, "Bright spokes of the star.", min=1)
    radius: str | None = option(None, "Rings used, from,to, in the unit of the pitch.")
    profile: Profile = option("sine", "How the star was printed.")
    sectors: int = option(0, "Directions measured apart.", min=0)


@verb("measuring the star")
def star(current: Session, asked: _StarOptions) -> None:
    """Measure the MTF with a Siemens star: a harmonic fit in every ring.

    \b
    Example:
      lensshift evaluate star star.tif --cycles 36 --profile square --pitch-mm 0.155
      lensshift evaluate star sharp.nc --cycles 12 --radius 0.4,1.2 --plot star.png
    """
    from lensshift.evaluation.siemens import siemens_star_mtf

    measured, unit = _to_measure(asked)
    found = siemens_star_mtf(
        measured.values, radius_range_mm=_pair(asked.radius, "radii like 0.4,1.2"),
        center_px=_pair(asked.center_px, _CENTER), **picked(asked, "cycles profile sectors"),
        **_told(asked.levels, measured),
    )  # fmt: skip
    _say_place(current, asked, found, f"star of {asked.cycles} cycles")
    current.result["cycles"] = asked.cycles
    _say_curve(current, found.mtf, unit, "over all directions")
    for k, curve in enumerate(found.sectors):
        _say_curve(current, curve, unit, f"sector {k}")
    columns = _columns(found.mtf, unit) | {"radius": found.radius_mm, "pixels": found.count}
    outputs.write_table(current, asked.to.csv, columns)
    _draw(current, asked, "stars.star_figure", found, measured, unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class _ZoneOptions(_PatternOptions):
    chirp: float = option(MISSING, "Growth of the frequency with the radius, in LP/mm per mm.")


@verb("measuring the zone plate")
def zone(current: Session, asked: _ZoneOptions) -> None:
    """Measure the response to a zone plate, cos(pi k r^2), along rows, columns and radii.

    \b
    Example:
      lensshift evaluate zone plate.tif --chirp 2.5 --pitch-mm 0.155 --csv zone.csv
    """
    from lensshift.evaluation.zone_plate import zone_plate_response

    measured, unit = _to_measure(asked)
    found = zone_plate_response(
        measured.values, chirp_lpmm_per_mm=asked.chirp, lr_pitch_mm=_lr_pitch_mm(measured),
        center_px=_pair(asked.center_px, _CENTER), **_told(asked.levels, measured),
    )  # fmt: skip
    _say_place(current, asked, found, "zone plate")
    for name in ("radial", "row", "col"):
        _say_curve(current, getattr(found, name), unit, name)
    outputs.write_table(current, asked.to.csv, _columns(found.radial, unit))
    _draw(current, asked, "stars.zone_plate_figure", found, measured, unit)


@dataclass(frozen=True, slots=True)
class _FrcOptions:
    first: Path = argument("One result.")
    second: Path = argument("One from other frames of the same scene.")
    pitch_mm: images.PitchOption = None
    key: images.KeyOption = None
    csv: outputs.CsvOption = None


@verb("correlating")
def frc(current: Session, asked: _FrcOptions) -> None:
    """Correlate two independent results ring by ring in frequency.

    \b
    Example:
      lensshift evaluate frc sharp_even.nc sharp_odd.nc --csv frc.csv
    """
    from lensshift.evaluation.ring_correlation import fourier_ring_correlation

    files = asked.first, asked.second
    outputs.check([*files], asked.csv)
    one, other = (
        images.measured_image(path, asked.pitch_mm, key=key)
        for path, key in zip(files, images.keys_of(asked.key, *files), strict=True)
    )
    images.refuse_other_pixels(one, other, "those of SECOND")
    one = one if one.has_pitch else replace(one, pitch_mm=other.pitch_mm, has_pitch=other.has_pitch)
    found = fourier_ring_correlation(one.values, other.values, pitch_mm=one.pitch_mm)
    unit, cutoffs = images.frequency_unit(one, None), (found.cutoff_lpmm, found.fixed_cutoff_lpmm)
    for label, cutoff in zip(("half-bit threshold", "threshold of 1/7"), cutoffs, strict=True):
        place = "never crossed" if cutoff is None else f"crossed at {cutoff:.4g} {unit.name}"
        current.say(f"{label:<20}{place}")
    columns = picked(found, "frequency_lpmm correlation half_bit")
    current.tell(found, "cutoff_lpmm fixed_cutoff_lpmm")
    current.result |= {"unit": unit.name, **columns}
    outputs.write_table(current, asked.csv, columns)


@dataclass(frozen=True, slots=True)
class _ResolutionOptions:
    of: images.ImageOptions
    edge: Path | None = option(None, "The image that holds the edges, if another one.")
    cycles: int | None = option(None, "Bright spokes of a Siemens star in IMAGE.", min=1)
    chirp: float | None = option(None, "Of a zone plate in IMAGE, in LP/mm per mm.")
    bars: list[str] | None = option(
        None,
        "A group of bars in IMAGE: its frequency, 2.5, or period, 8px, and its region if it is not "
        "to be found: 2.5@0,40,10,60 (row start,stop,col start,stop); again for each further one.",
    )
    profile: Profile | None = option(None, "How it was printed: stars as sine, bars as square.")
    levels: LevelsOption = None
    photo: images.PhotoOptions = field(default_factory=images.PhotoOptions)
    region: str | None = option(None, "Of the edge, in pixels: row start,stop,col start,stop.")
    csv: outputs.CsvOption = None


@verb("comparing edges with a pattern")
def resolution(current: Session, asked: _ResolutionOptions) -> None:
    """Ask a star, a zone plate or bars whether the edges beside them promise too much.

    A solver may draw edges sharper than it resolves. Of super-resolved images, trust the pattern.
    Unless --levels gives the contrast at frequency 0, the coarsest lines are taken for as high as
    the edge promises there, and finer ones are compared.

    \b
    Example:
      lensshift evaluate resolution sharp_star.nc --cycles 12 --edge sharp_edge.nc
      lensshift evaluate resolution plate.tif --chirp 2.5 --pitch-mm 0.155 --region 0,40,0,64
      lensshift evaluate resolution bars.tif --bars 8px --bars 5px@40,66,4,60 --levels 20,220
    """
    from lensshift.evaluation.agreement import edge_and_pattern
    from lensshift.evaluation.slanted_edge import average_curves

    if sum(bool(one) for one in (asked.cycles, asked.chirp is not None, asked.bars)) != 1:
        raise typer.BadParameter(
            "expected --cycles of a star or --chirp of a zone plate or --bars, one of them"
        )
    place = images.parse_region(asked.region)
    outputs.check([asked.of.image, asked.edge], asked.csv)
    shown = asked.edge or asked.of.image
    of_image, of_edge = images.keys_of(asked.of.key, asked.of.image, shown)
    seen = _one_image(replace(asked.of, key=of_image), asked.photo)
    unit = images.frequency_unit(seen, None)
    edge = replace(asked.of, image=shown, key=of_edge)
    beside = seen if asked.edge is None else images.measured_photograph(edge, asked.photo)
    images.refuse_other_pixels(seen, beside, "those of --edge")
    if seen.has_pitch != beside.has_pitch:
        raise ValueError(
            f"the pitch of {shown if seen.has_pitch else asked.of.image} is not known, so its "
            "frequencies are in cycles/px and those of the other image in LP/mm; take two files "
            "that tell it, or two images with --pitch-mm"
        )
    # The pattern first: what does not fit of it is told before edges take their time.
    pattern, unsure = _pattern(current, asked, seen)
    edges = edges_of(beside, place)
    average = average_curves(edges)
    found = edge_and_pattern(average, pattern, unsure=unsure)
    _say_curve(current, average, unit, "edges" if len(edges) > 1 else "edge")
    _say_curve(current, pattern, unit, "pattern")
    low, high = (found.frequency_lpmm[end] * unit.factor for end in (0, -1))
    current.say(
        f"{found.verdict}: from {low:.3g} to {high:.3g} {unit.name} the edge promises "
        f"{found.edge.mean():.3f} of the contrast, the pattern shows {found.pattern.mean():.3f} "
        f"(difference {found.difference:+.3f} +- {found.std:.3f})"
        + (", with the contrast that coarser lines tell" if unsure else "")
    )
    current.tell(found, "verdict difference std")
    current.result |= {"image": asked.of.image, "unit": unit.name}
    columns = {"frequency": found.frequency_lpmm * unit.factor}
    columns |= {"edge": found.edge, "pattern": found.pattern}
    outputs.write_table(current, asked.csv, columns)


def _pattern(
    current: Session, asked: _ResolutionOptions, seen: images.Measured
) -> tuple[Any, float]:
    """Return the curve of the star, zone plate or bars, and how far off its contrast may be."""
    common = _told(asked.levels, seen)
    found: Any
    if asked.bars:
        from lensshift.evaluation.gratings import gratings_mtf

        groups = [_group(text, seen) for text in asked.bars]
        printed: Any = asked.profile or "square"
        lines, regions = zip(*groups, strict=True)
        found = gratings_mtf(
            seen.values, lines, regions=regions, profile=printed, lr_pitch_mm=_lr_pitch_mm(seen),
            **common,
        )  # fmt: skip
        unit, mtf = images.frequency_unit(seen, None), found.mtf
        shown = zip(mtf.frequency_lpmm * unit.factor, mtf.modulation, found.regions, strict=True)
        for frequency, value, (top, bottom, left, right) in shown:
            current.say(
                f"bars of {frequency:.4g} {unit.name} in rows {top}:{bottom}, columns "
                f"{left}:{right}: contrast {value:.3f}"
            )
        current.result["regions"] = found.regions
    elif asked.cycles is not None:
        from lensshift.evaluation.siemens import siemens_star_mtf

        printed = asked.profile or "sine"
        found = siemens_star_mtf(seen.values, cycles=asked.cycles, profile=printed, **common)
    else:
        from lensshift.evaluation.zone_plate import zone_plate_response

        chirp = 0.0 if asked.chirp is None else asked.chirp
        found = zone_plate_response(seen.values, chirp_lpmm_per_mm=chirp, **common)
    _say_contrast(current, found)
    curve = found.radial if asked.chirp is not None else found.mtf
    return curve, found.contrast_std / found.contrast


def _lr_pitch_mm(seen: images.Measured) -> Pair | None:
    """Return the pitch of the frames a picture was made of, if it was made of coarser ones."""
    row_mm, col_mm = (seen.scale * pitch for pitch in seen.pitch_mm)
    return (row_mm, col_mm) if seen.scale > 1 else None


def _group(text: str, seen: images.Measured) -> tuple[float, images.Region | None]:
    """Return frequency and region of a group of bars, from "2.5", "8px" or "8px@0,40,10,60"."""
    lines, _, region = text.partition("@")
    expected = "bars like 2.5, 8px or 8px@0,40,10,60"
    period = lines.endswith("px")
    (number,) = parse_numbers(lines.removesuffix("px"), 1, expected)
    if not number > 0:
        raise typer.BadParameter(f"expected {expected}, got {text!r}")
    frequency = 1.0 / (number * max(seen.pitch_mm)) if period else number
    return frequency, images.parse_region(region or None)


def _told(levels: str | None, measured: images.Measured) -> dict[str, Any]:
    """Return what patterns are measured with alike."""
    known = {"levels": _pair(levels, "levels like 100,3000")}
    return picked(measured, "pitch_mm valid") | known


def _draw(
    current: Session, asked: _PatternOptions, name: str, found: Any,
    measured: images.Measured, unit: images.Unit,
) -> None:  # fmt: skip
    shown = (name, found, measured.values, measured.pitch_mm)
    told = unit.shown() | {"lr_pitch_mm": _lr_pitch_mm(measured)}
    outputs.write_plot(current, asked.to.plot, *shown, **told)


def _say_place(current: Session, asked: _PatternOptions, found: Any, pattern: str) -> None:
    row, col = found.center_px
    current.say(f"{pattern}, centre at row {row:.2f}, column {col:.2f}")
    current.result |= {"image": asked.of.image, "center_px": found.center_px}
    _say_contrast(current, found)


def _say_contrast(current: Session, found: Any) -> None:
    """Say by what the curves were divided, and how far that may be off."""
    current.tell(found, "contrast contrast_std")
    if found.contrast_std > 0.0:
        current.say(
            f"contrast at frequency 0: {found.contrast:.3f} +- {found.contrast_std:.3f}, "
            "extrapolated, as if nothing (a halo, sharpening) changed before the coarsest lines; "
            "--levels gives it"
        )


def _to_measure(asked: _PatternOptions) -> tuple[images.Measured, images.Unit]:
    outputs.check([asked.of.image], asked.to.csv, plot=asked.to.plot)
    measured = _one_image(asked.of, asked.photo)
    return measured, images.frequency_unit(measured, asked.focal_length_mm)


def _one_image(asked: images.ImageOptions, photo: images.PhotoOptions) -> images.Measured:
    """Read an image with a pattern; of a photograph one channel. NaN are left out."""
    import numpy as np

    measured = images.measured_photograph(asked, photo)
    if measured.values.ndim > 2:
        raise typer.BadParameter(
            "the green pixels of a mosaic are two images of a pattern; take --channel red or blue"
        )
    known = np.isfinite(measured.values)
    return replace(measured, valid=known if measured.valid is None else measured.valid & known)


def _pair(text: str | None, expected: str) -> Pair | None:
    if text is None:
        return None
    first, second = parse_numbers(text, 2, expected)
    return first, second


def _say_curve(current: Session, curve: Any, unit: images.Unit, name: str) -> None:
    from lensshift.evaluation.limits import first_crossing_lpmm

    places = {
        f"mtf{100 * level:.0f}": first_crossing_lpmm(curve, level) * unit.factor
        for level in _LEVELS
    }
    texts = (
        f"{label.upper()} {f'{place:.4g}' if place == place else 'not seen'}"
        for label, place in places.items()
    )
    current.say(f"  {name:<20}{', '.join(texts)} {unit.name}")
    row = {"name": name, "unit": unit.name} | places | _columns(curve, unit)
    current.result.setdefault("curves", []).append(row)


def _columns(curve: Any, unit: images.Unit) -> dict[str, Any]:
    columns = {"frequency": curve.frequency_lpmm * unit.factor, "modulation": curve.modulation}
    return columns if curve.std is None else columns | {"std": curve.std}
