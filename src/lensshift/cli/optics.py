"""What the verbs of `lens` share: the lens, the sensor, the element that moves."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import parse_pitch_mm
from lensshift.cli.measured import parse_numbers
from lensshift.cli.verbs import option

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
    from lensshift.optics.lens import Lens
    from lensshift.optics.mtf import Band

LensArgument = Annotated[
    str,
    typer.Argument(help="Lens file (.toml or .zmx), or the name of a built-in lens: petzval_a."),
]
BandOption = Annotated[
    float, typer.Option("--band-nm", min=0.0, help="Full width at half maximum of the light.")
]

SENSOR, PITCH_MM, SHIFT_PX = "64x16", "0.155", 0.25


@dataclass(frozen=True, slots=True)
class SensorOptions:
    """The sensor behind a lens."""

    sensor: str = option(SENSOR, "Pixels as columns x rows.")
    pitch_mm: str = option(PITCH_MM, "Pixel pitch: one number, or row,col.")


@dataclass(frozen=True, slots=True)
class LightOptions:
    """What a lens is looked at in."""

    wavelength_nm: float | None = option(None, "Of the light; that of the lens if not.")
    temperature_c: float | None = option(None, "Of glass and air.")


@dataclass(frozen=True, slots=True)
class MoveOptions:
    """What moves, and how far."""

    element: int = option(1, "The element that moves, counted from 1.", min=1)
    shift_px: float = option(SHIFT_PX, "Shift of the image along both axes, in pixels.")


@dataclass(frozen=True, slots=True)
class LensOptions:
    """A lens in its light, before its sensor."""

    lens: LensArgument
    light: LightOptions = field(default_factory=LightOptions)
    sensor: SensorOptions = field(default_factory=SensorOptions)


class ShowFigure(StrEnum):
    """Pictures of a lens."""

    LAYOUT = "layout"
    SPOTS = "spots"
    DISTORTION = "distortion"
    FANS = "fans"
    PSF = "psf"
    FIELD = "field"


class MtfFigure(StrEnum):
    """Pictures of its MTF."""

    CURVES = "curves"
    FIELD = "field"
    FOCUS = "focus"
    SECTIONS = "sections"


def read_lens(name: str, light: LightOptions | None = None) -> Lens:
    """Read a lens file or a built-in lens."""
    from lensshift.optics.glass import glass_in_light
    from lensshift.optics.lens_file import load_lens

    lens = load_lens(name)
    given = {} if light is None else asdict(light)
    if light is not None and light.wavelength_nm is not None:
        nm = light.wavelength_nm
        given["elements"] = tuple(
            replace(one, glass=tuple(glass_in_light(glass, nm) for glass in one.glass))
            for one in lens.elements
        )
    return replace(lens, **{name: one for name, one in given.items() if one is not None})


def opened(asked: LensOptions) -> tuple[Lens, Grid]:
    """Return the lens and the grid of its sensor."""
    return read_lens(asked.lens, asked.light), sensor_grid(asked.sensor)


def sensor_grid(asked: SensorOptions) -> Grid:
    """Return the grid of "64x16" pixels (columns x rows)."""
    from lensshift.core.grid import Grid

    cols, times, rows = asked.sensor.lower().partition("x")
    if not (times and rows.strip().isdigit() and cols.strip().isdigit()):
        raise typer.BadParameter(f"expected a sensor like 64x16, got {asked.sensor!r}")
    return Grid((int(rows), int(cols)), parse_pitch_mm(asked.pitch_mm))


def element_of(lens: Lens, number: int) -> int:
    """Return the index of an element that is counted from 1."""
    if number > len(lens.elements):
        raise typer.BadParameter(
            f"expected an element from 1 to {len(lens.elements)}, got {number}"
        )
    return number - 1


def parse_fields_tan(texts: list[str] | None) -> list[tuple[float, float]]:
    """Return tangents (row, col) of fields given as "row,col" in degrees."""
    fields_deg = [
        parse_numbers(text, 2, "a field like 1.6,6.5 (row,col in degrees)")
        for text in texts or ("0,0", "1.6,6.5")
    ]
    return [
        (math.tan(math.radians(row_deg)), math.tan(math.radians(col_deg)))
        for row_deg, col_deg in fields_deg
    ]


def band_of(lens: Lens, band_nm: float) -> Band | None:
    """Return the light about the wavelength of a lens, None for that wavelength alone."""
    from lensshift.optics.mtf import led_band

    return led_band(lens.wavelength_nm, band_nm) if band_nm > 0 else None


def diagonal_mm(lens: Lens, element: int, shift_px: float, grid: Grid) -> tuple[float, float]:
    """Return the decentre (row, col) that shifts the image by `shift_px` along both axes."""
    from lensshift.optics.shift import decenter_for_shift

    row_mm, col_mm = decenter_for_shift(lens, element, [shift_px, shift_px], grid)
    return float(row_mm), float(col_mm)


def figure_of(module: str, name: str, *arguments: Any, **options: Any) -> Any:
    """Draw one of the figures of `lensshift.report`."""
    from importlib import import_module

    return getattr(import_module(f"lensshift.report.{module}"), name)(*arguments, **options)


def show_figure(
    kind: ShowFigure, model: Lens, moved: int, travel_mm: tuple[float, float], grid: Grid
) -> Any:
    """Draw a lens."""
    from lensshift.optics.aberrations import sensor_fields

    fields = sensor_fields(model, grid, (0.0, 0.5, 1.0))
    fields_tan = [(float(row), float(col)) for row, col in fields]
    if kind is ShowFigure.LAYOUT:
        fields_deg = (0.0, abs(math.degrees(math.atan(fields_tan[-1][1]))))
        return figure_of("lenses", "layout_figure", model, moved, travel_mm, fields_deg=fields_deg)
    if kind is ShowFigure.DISTORTION:
        return figure_of("lens_maps", "distortion_figure", model, grid)
    if kind is ShowFigure.SPOTS:
        return figure_of("lens_maps", "spots_figure", model, moved, travel_mm, grid, fields_tan)
    if kind is ShowFigure.FIELD:
        return figure_of("lens_aberrations", "field_curves_figure", model, grid)
    name = "fans_figure" if kind is ShowFigure.FANS else "psf_figure"
    return figure_of("lens_aberrations", name, model, grid, fields_tan)


def mtf_figure(
    kind: MtfFigure,
    model: Lens,
    moved: int,
    travel_mm: tuple[float, float],
    grid: Grid,
    fields_tan: list[tuple[float, float]],
    highest_lpmm: float,
) -> Any:
    """Draw the MTF of a lens."""
    if kind is MtfFigure.CURVES:
        return figure_of(
            "lenses", "mtf_figure", model, moved, travel_mm, grid, fields_tan,
            highest_lpmm=highest_lpmm,
        )  # fmt: skip
    if kind is MtfFigure.SECTIONS:
        return figure_of("lens_aberrations", "sections_figure", model, grid, fields_tan)
    frequency_lpmm = 1.0 / max(grid.pitch_mm)
    if kind is MtfFigure.FOCUS:
        return figure_of("lens_maps", "focus_figure", model, fields_tan, frequency_lpmm)
    return figure_of("lens_maps", "field_figure", model, moved, travel_mm, grid, frequency_lpmm)
