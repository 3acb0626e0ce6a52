"""`lensshift evaluate star`, `zone` and `frc`: resolution in every direction at once."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

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
    Unit,
    check_outputs,
    frequency_unit,
    measured_image,
    parse_numbers,
    write_plot,
    write_table,
)
from lensshift.cli.session import Session
from lensshift.cli.verbs import argument, option, verb


class StarProfile(StrEnum):
    """How a star was printed."""

    SINE = "sine"
    SQUARE = "square"


CenterOption = Annotated[
    str | None, typer.Option("--center-px", help="Centre as row,col; found if not given.")
]
LevelsOption = Annotated[
    str | None, typer.Option(help="Values of large black and white areas, as black,white.")
]

_LEVELS = (0.5, 0.3, 0.1)  # of contrast, where curves are read off by custom


@dataclass(frozen=True, slots=True)
class StarOptions:
    """Options of `lensshift evaluate star`."""

    image: ImageArgument
    cycles: int = option(MISSING, "Bright spokes of the star.", min=1)
    pitch_mm: PitchOption = None
    center_px: CenterOption = None
    radius: str | None = option(None, "Rings used, from,to, in the unit of the pitch.")
    profile: StarProfile = option(StarProfile.SINE, "How the star was printed.")
    levels: LevelsOption = None
    sectors: int = option(0, "Directions measured apart.", min=0)
    focal_length_mm: FocalOption = None
    frame: FrameOption = 0
    key: KeyOption = None
    csv: CsvOption = None
    plot: PlotOption = None


@verb("measuring the star")
def star(current: Session, asked: StarOptions) -> None:
    """Measure the MTF with a Siemens star: a harmonic fit in every ring.

    \b
    Example:
      lensshift evaluate star star.tif --cycles 36 --profile square --pitch-mm 0.155
      lensshift evaluate star sharp.nc --cycles 12 --radius 0.4,1.2 --plot star.png
    """
    from lensshift.evaluation.siemens import siemens_star_mtf

    measured, unit = _to_measure(asked)
    found = siemens_star_mtf(
        measured.values,
        cycles=asked.cycles,
        pitch_mm=measured.pitch_mm,
        center_px=_pair(asked.center_px, "a centre like 7.5,31.5"),
        radius_range_mm=_pair(asked.radius, "radii like 0.4,1.2"),
        profile=asked.profile.value,
        levels=_pair(asked.levels, "levels like 100,3000"),
        sectors=asked.sectors,
        valid=measured.valid,
    )
    row, col = found.center_px
    current.say(f"star of {asked.cycles} cycles, centre at row {row:.2f}, column {col:.2f}")
    current.result |= {"image": asked.image, "center_px": found.center_px}
    current.result["cycles"] = asked.cycles
    _say_curve(current, found.mtf, unit, "over all directions")
    for k, curve in enumerate(found.sectors):
        _say_curve(current, curve, unit, f"sector {k}")
    columns = _columns(found.mtf, unit) | {"radius": found.radius_mm, "pixels": found.count}
    write_table(current, asked.csv, columns)
    write_plot(current, asked.plot, lambda: _figure("star_figure", found, measured, unit))


@dataclass(frozen=True, slots=True)
class ZoneOptions:
    """Options of `lensshift evaluate zone`."""

    image: ImageArgument
    chirp: float = option(MISSING, "Growth of the frequency with the radius, in LP/mm per mm.")
    pitch_mm: PitchOption = None
    center_px: CenterOption = None
    levels: LevelsOption = None
    focal_length_mm: FocalOption = None
    frame: FrameOption = 0
    key: KeyOption = None
    csv: CsvOption = None
    plot: PlotOption = None


@verb("measuring the zone plate")
def zone(current: Session, asked: ZoneOptions) -> None:
    """Measure the response to a zone plate, cos(pi k r^2), along rows, columns and radii.

    \b
    Example:
      lensshift evaluate zone plate.tif --chirp 2.5 --pitch-mm 0.155 --csv zone.csv
    """
    from lensshift.evaluation.zone_plate import zone_plate_response

    measured, unit = _to_measure(asked)
    lr_pitch = tuple(measured.scale * pitch for pitch in measured.pitch_mm)
    found = zone_plate_response(
        measured.values,
        pitch_mm=measured.pitch_mm,
        chirp_lpmm_per_mm=asked.chirp,
        center_px=_pair(asked.center_px, "a centre like 7.5,31.5"),
        lr_pitch_mm=(lr_pitch[0], lr_pitch[1]) if measured.scale > 1 else None,
        levels=_pair(asked.levels, "levels like 100,3000"),
        valid=measured.valid,
    )
    row, col = found.center_px
    current.say(f"zone plate, centre at row {row:.2f}, column {col:.2f}")
    current.result |= {"image": asked.image, "center_px": found.center_px}
    for name in ("radial", "row", "col"):
        _say_curve(current, getattr(found, name), unit, name)
    write_table(current, asked.csv, _columns(found.radial, unit))
    write_plot(current, asked.plot, lambda: _figure("zone_plate_figure", found, measured, unit))


@dataclass(frozen=True, slots=True)
class FrcOptions:
    """Options of `lensshift evaluate frc`."""

    first: Path = argument("One result.")
    second: Path = argument("One from other frames of the same scene.")
    pitch_mm: PitchOption = None
    key: KeyOption = None
    csv: CsvOption = None


@verb("correlating")
def frc(current: Session, asked: FrcOptions) -> None:
    """Correlate two independent results ring by ring in frequency.

    \b
    Example:
      lensshift evaluate frc sharp_even.nc sharp_odd.nc --csv frc.csv
    """
    from lensshift.evaluation.ring_correlation import fourier_ring_correlation

    check_outputs([asked.first, asked.second], asked.csv, None)
    one = measured_image(asked.first, asked.pitch_mm, key=asked.key)
    other = measured_image(asked.second, asked.pitch_mm, key=asked.key)
    found = fourier_ring_correlation(one.values, other.values, pitch_mm=one.pitch_mm)
    unit = frequency_unit(one, None)
    for label, cutoff in (
        ("half-bit threshold", found.cutoff_lpmm),
        ("threshold of 1/7", found.fixed_cutoff_lpmm),
    ):
        place = "never crossed" if cutoff is None else f"crossed at {cutoff:.4g} {unit.name}"
        current.say(f"{label:<20}{place}")
    columns = {
        "frequency_lpmm": found.frequency_lpmm,
        "correlation": found.correlation,
        "half_bit": found.half_bit,
    }
    current.result |= {"unit": unit.name, "cutoff_lpmm": found.cutoff_lpmm}
    current.result |= {"fixed_cutoff_lpmm": found.fixed_cutoff_lpmm, **columns}
    write_table(current, asked.csv, columns)


def _to_measure(asked: StarOptions | ZoneOptions) -> tuple[Measured, Unit]:
    check_outputs([asked.image], asked.csv, asked.plot)
    measured = measured_image(asked.image, asked.pitch_mm, key=asked.key, frame=asked.frame)
    return measured, frequency_unit(measured, asked.focal_length_mm)


def _pair(text: str | None, expected: str) -> tuple[float, float] | None:
    if text is None:
        return None
    first, second = parse_numbers(text, 2, expected)
    return first, second


def _say_curve(current: Session, curve: Any, unit: Unit, name: str) -> None:
    from lensshift.evaluation.limits import first_crossing_lpmm

    crossings = {level: first_crossing_lpmm(curve, level) * unit.factor for level in _LEVELS}
    texts = [
        f"MTF{100 * level:.0f} {place:.4g}" if place == place else f"MTF{100 * level:.0f} not seen"
        for level, place in crossings.items()
    ]
    current.say(f"  {name:<20}{', '.join(texts)} {unit.name}")
    rows: list[dict[str, Any]] = current.result.setdefault("curves", [])
    row: dict[str, Any] = {"name": name, "unit": unit.name}
    row |= {f"mtf{100 * level:.0f}": place for level, place in crossings.items()}
    rows.append(row | _columns(curve, unit))


def _columns(curve: Any, unit: Unit) -> dict[str, Any]:
    columns = {"frequency": curve.frequency_lpmm * unit.factor, "modulation": curve.modulation}
    return columns if curve.std is None else columns | {"std": curve.std}


def _figure(name: str, found: Any, measured: Measured, unit: Unit) -> Any:
    from lensshift.report import stars

    draw = getattr(stars, name)
    return draw(found, measured.values, measured.pitch_mm, unit=unit.name, factor=unit.factor)
