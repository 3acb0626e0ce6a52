"""What the verbs of `lens` share: the lens, the sensor, the element that moves."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import parse_numbers, parse_pitch_mm
from lensshift.cli.ranges import in_range
from lensshift.cli.verbs import option
from lensshift.core.errors import warn_quality

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
    from lensshift.optics.lens import Lens
    from lensshift.optics.mtf import Band

LensArgument = Annotated[
    str,
    typer.Argument(help="Lens file (.toml or .zmx), or the name of a built-in lens: petzval_a."),
]
BandOption = Annotated[
    float | None,
    typer.Option(
        "--band-nm", help="Full width at half maximum of the light; one wavelength if not given."
    ),
]

SENSOR, PITCH_MM = "64x16", "0.155"  # of the camera of the paper
SHIFT_PX = 0.25  # of the square of four frames
ELEMENT_HELP = "Element that moves, from 1; if not given the first that moves the image."


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
class LensOptions:
    """A lens in its light, before its sensor."""

    lens: LensArgument
    light: LightOptions = field(default_factory=LightOptions)
    sensor: SensorOptions = field(default_factory=SensorOptions)


def read_lens(name: str, light: LightOptions | None = None) -> Lens:
    """Read a lens file or a built-in lens."""
    from lensshift.optics.glass_called import glass_in_light
    from lensshift.optics.lens_file import load_lens

    lens = load_lens(name)
    given = {} if light is None else asdict(light)
    if light is not None and light.wavelength_nm is not None:
        names = {name for one in lens.elements for name in one.glass}
        taken = {name: glass_in_light(name, light.wavelength_nm) for name in sorted(names)}
        given["elements"] = tuple(
            replace(one, glass=tuple(taken[name][0] for name in one.glass)) for one in lens.elements
        )
        if notes := [note for _, note in taken.values() if note is not None]:
            warn_quality("; ".join(notes), 2)
    return replace(lens, **{name: one for name, one in given.items() if one is not None})


@dataclass(frozen=True, slots=True)
class MovedLensOptions(LensOptions):
    """A lens of which an element moves."""

    element: int | None = option(None, ELEMENT_HELP, min=1)
    shift_px: float = option(SHIFT_PX, "Shift of the image along both axes, in pixels.")


def opened(asked: LensOptions) -> tuple[Lens, Grid]:
    """Return the lens and the grid of its sensor."""
    from lensshift.optics.field import out_of_focus

    lens, grid = read_lens(asked.lens, asked.light), sensor_grid(asked.sensor)
    with suppress(ValueError):  # without power or light, which verbs tell that need it
        if told := out_of_focus(lens, grid):
            warn_quality(f"the lens is out of focus, with {told}", 2)
    return lens, grid


def opened_moving(asked: MovedLensOptions) -> tuple[Lens, Grid, int]:
    """Return the lens, the grid of its sensor, and the index of the element that moves."""
    lens, grid = opened(asked)
    return lens, grid, element_of(lens, asked.element)


def sensor_grid(asked: SensorOptions) -> Grid:
    """Return the grid of "64x16" pixels (columns x rows)."""
    from lensshift.core.grid import Grid

    cols, times, rows = asked.sensor.lower().partition("x")
    if not (times and rows.strip().isdigit() and cols.strip().isdigit()):
        raise typer.BadParameter(f"expected a sensor like 64x16, got {asked.sensor!r}")
    pitch_mm = parse_pitch_mm(asked.pitch_mm)
    for one in pitch_mm:
        in_range("pitch_mm", one)
    return Grid((int(rows), int(cols)), pitch_mm)


def element_of(lens: Lens, number: int | None) -> int:
    """Return the index of an element that is counted from 1; of the first that moves the image."""
    if number is None:
        from lensshift.optics.shift import first_moving

        return first_moving(lens)
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
    angles = ([math.radians(in_range("field_deg", one)) for one in pair] for pair in fields_deg)
    return [(math.tan(row_rad), math.tan(col_rad)) for row_rad, col_rad in angles]


def band_of(wavelength_nm: float, band_nm: float | None) -> Band | None:
    """Return the light about a wavelength, None for that wavelength alone."""
    from lensshift.optics.mtf import led_band

    return None if band_nm is None else led_band(wavelength_nm, band_nm)


def diagonal_mm(lens: Lens, element: int, shift_px: float, grid: Grid) -> tuple[float, float]:
    """Return the decentre (row, col) that shifts the image by `shift_px` along both axes."""
    from lensshift.optics.shift import decenter_for_shift

    row_mm, col_mm = decenter_for_shift(lens, element, [shift_px, shift_px], grid)
    return float(row_mm), float(col_mm)


def lens_figures(
    model: Lens,
    moved: int,
    travel_mm: tuple[float, float],
    grid: Grid,
    fields_tan: list[tuple[float, float]],
    *,
    band: Band | None = None,
    highest_lpmm: float = 0.0,
) -> dict[str, tuple[str, tuple[Any, ...], dict[str, Any]]]:
    """Return the figures of a lens by name: which of the report's, of what, with which options."""
    element, sections = (model, moved, travel_mm), (model, grid, fields_tan)
    double_lpmm, light = 1.0 / max(grid.pitch_mm), {"band": band}
    fields_deg = (0.0, abs(math.degrees(math.atan(fields_tan[-1][1]))))
    return {
        "layout": ("lenses.layout_figure", element, {"fields_deg": fields_deg}),
        "spots": ("lens_maps.spots_figure", (*element, grid, fields_tan), {}),
        "distortion": ("lens_maps.distortion_figure", (model, grid), {}),
        "fans": ("lens_aberrations.fans_figure", sections, light),
        "psf": ("lens_aberrations.psf_figure", sections, light),
        "field": ("lens_aberrations.field_curves_figure", (model, grid), {}),
        "curves": (
            "lenses.mtf_figure", (*element, grid, fields_tan), {"highest_lpmm": highest_lpmm},
        ),
        "map": ("lens_maps.field_figure", (*element, grid, double_lpmm), {}),
        "focus": ("lens_maps.focus_figure", (model, fields_tan, double_lpmm), {}),
        "sections": ("lens_aberrations.sections_figure", sections, light),
    }  # fmt: skip


def spread_fields_tan(
    lens: Lens, grid: Grid, shares: tuple[float, ...]
) -> list[tuple[float, float]]:
    """Return tangents (row, col) of fields at shares of the way from the centre to the corner."""
    from lensshift.optics.aberrations import sensor_fields

    return [(float(row), float(col)) for row, col in sensor_fields(lens, grid, shares)]
