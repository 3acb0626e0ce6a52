"""What to move: the trade between stroke, evenness, sharpness and actuator."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import Band
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import focal_length_mm
from lensshift.optics.shift import (
    ENOUGH_PIXELS,
    decenter_for_shift,
    largest_error_px,
    moving,
    px_per_um,
    shift_map,
)
from lensshift.optics.spots import fields_for_image
from lensshift.optics.trace import Build

DIAGONALS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
POSITIONS = np.concatenate([np.zeros((1, 2)), DIAGONALS])  # at rest, and moved
# Directions in which a pattern may repeat, where the least MTF is looked for.
AZIMUTHS_RAD = np.linspace(0.0, np.pi, 4, endpoint=False)


@dataclass(frozen=True, slots=True)
class Mover:
    """What it means to shift the image with one element.

    Parameters
    ----------
    element : its number, counted from 0; -1 in front of all, one more than there are for the sensor
    name : of the element
    stroke_mm : decentre along columns for the wanted shift, negative if the image goes the other
        way
    gain : image movement over element movement, both in mm, at the centre of the sensor
    sensitivity_px_per_um : of `px_per_um`, 0 where something turns
    max_shift_error_px : largest departure from the wanted diagonal shift over the sensor
    mtf_centred : least MTF (`least_mtf`) with the element at rest
    mtf_moved : the same over the four diagonal moves
    mtf_loss : largest fall of a field and direction from rest to moved
    kind : "decentre", or of `which_mover`
    stroke_deg : tilt or turn that moves the image along columns, 0 where something is decentred
    cross_talk_px : largest shift across the direction in which one axis moves the image
    """

    element: int
    name: str
    stroke_mm: float
    gain: float
    sensitivity_px_per_um: float
    max_shift_error_px: float
    mtf_centred: float
    mtf_moved: float
    mtf_loss: float
    kind: str = "decentre"
    stroke_deg: float = 0.0
    cross_talk_px: float = 0.0

    @property
    def stroke_text(self) -> str:
        """The stroke with its unit."""
        return f"{self.stroke_deg:.3g} deg" if self.stroke_deg else f"{1e3 * self.stroke_mm:.1f} um"


def which_element(
    lens: Lens, grid: Grid, *, shift_px: float = 0.25, frequency_lpmm: float | None = None
) -> tuple[Mover, ...]:
    """Compare the elements as movers, for diagonal shifts of `shift_px` along both axes.

    Plane-parallel plates are left out, as moving them does nothing, and elements so weak that they
    cannot make the shift. The MTF is that of `least_mtf`.

    Parameters
    ----------
    grid : of the sensor
    shift_px : along each axis
    frequency_lpmm : of the MTF; by default the Nyquist frequency of twice as many pixels

    Raises
    ------
    ValueError
        If the shift is not positive, or as in `exact_otf`.
    """
    if not shift_px > 0:
        raise ValueError(f"expected a positive shift_px, got {shift_px}")
    fields = edge_fields(lens, grid)
    frequency = judged_lpmm(grid, frequency_lpmm)
    centred = edge_mtf(lens, fields, frequency)
    movers = []
    for number, (element, indices) in enumerate(zip(lens.elements, lens.indices(), strict=True)):
        if np.isinf(focal_length_mm(element, indices)):
            continue
        try:
            moves_mm = decenter_for_shift(lens, number, shift_px * DIAGONALS, grid)
        except ValueError:  # so weak that no light gets through where it would have to be
            continue
        error_px = largest_error_px(lens, number, moves_mm, grid, shift_px * DIAGONALS)
        stroke_mm = float(decenter_for_shift(lens, number, [0.0, shift_px], grid)[1])
        along = shift_map(lens, number, stroke_mm * np.eye(2), grid, most=ENOUGH_PIXELS).offset_px
        moved = moved_mtf(lens, fields, frequency, number, moves_mm)
        movers.append(
            Mover(
                element=number,
                name=element.name,
                stroke_mm=stroke_mm,
                gain=shift_px * grid.pitch_mm[1] / stroke_mm,
                sensitivity_px_per_um=px_per_um(lens, number, grid),
                max_shift_error_px=error_px,
                mtf_centred=float(centred.min()),
                mtf_moved=float(moved.min()),
                mtf_loss=float((centred - moved).max()),
                cross_talk_px=cross_talk_px(along.reshape(2, -1, 2)),
            )
        )
    return tuple(movers)


def judged_lpmm(grid: Grid, frequency_lpmm: float | None = None) -> float:
    """Return the frequency at which a lens is judged: Nyquist's of twice as many pixels, or given.

    Parameters
    ----------
    grid : of the sensor
    frequency_lpmm : if another one is wanted
    """
    return 1.0 / max(grid.pitch_mm) if frequency_lpmm is None else frequency_lpmm


def edge_fields(lens: Lens, grid: Grid) -> Floats:
    """Return the fields [9 2] at the centre, the ends of the axes and the corners of a sensor."""
    half_mm = 0.5 * np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    return fields_for_image(lens, np.array(list(product((0.0, 1.0, -1.0), repeat=2))) * half_mm)


def edge_mtf(
    lens: Lens,
    fields_tan: Floats,
    frequency_lpmm: float,
    build: Build | None = None,
    band: Band | None = None,
) -> Floats:
    """Return the exact MTF [field azimuth] at one frequency and 0, 45, 90, 135 degrees.

    Parameters
    ----------
    fields_tan : [field 2] of `edge_fields`
    build, band : as for `exact_otf`
    """
    otf = [
        exact_otf(lens, field, frequency_lpmm, AZIMUTHS_RAD, build=build, band=band)
        for field in fields_tan
    ]
    return np.abs(otf)[..., 0]


def moved_mtf(
    lens: Lens,
    fields_tan: Floats,
    frequency_lpmm: float,
    element: int,
    moves_mm: Floats,
    band: Band | None = None,
) -> Floats:
    """Return `edge_mtf` [move field azimuth] with one element at each of the diagonal moves.

    One of them stands for all where the lens at rest is symmetric, because the fields are, too.

    Parameters
    ----------
    moves_mm : [move 2] (row, col), in the order of `DIAGONALS`
    """
    builds = (moving(lens, element, move) for move in moves_mm[: diagonals_that_differ(lens)])
    return np.stack([edge_mtf(lens, fields_tan, frequency_lpmm, one, band) for one in builds])


def diagonals_that_differ(lens: Lens) -> int:
    """Return 4, or 1 for a symmetric lens: it does for each diagonal what it does for the first."""
    return 1 if lens.is_symmetric() else 4


def least_mtf(
    lens: Lens,
    grid: Grid,
    element: int | None = None,
    *,
    shift_px: float = 0.25,
    frequency_lpmm: float | None = None,
    band: Band | None = None,
) -> tuple[float, float]:
    """Return the least MTF at rest, and over the four diagonal moves of an element.

    The smallest of the exact MTF over centre, ends of the axes and corners of the sensor and the
    directions 0, 45, 90 and 135 degrees, at the sensor plane of the lens. This is what every
    command means by it.

    Parameters
    ----------
    grid : of the sensor
    element : number of the one that moves, from 0; None: none, both numbers are the same
    shift_px : of the image along both axes
    frequency_lpmm : by default the Nyquist frequency of twice as many pixels
    band : the light; the wavelength of the lens alone if None

    Raises
    ------
    ValueError
        As in `decenter_for_shift` and `exact_otf`.
    """
    fields, frequency = edge_fields(lens, grid), judged_lpmm(grid, frequency_lpmm)
    rest = float(edge_mtf(lens, fields, frequency, band=band).min())
    if element is None:
        return rest, rest
    moves_mm = decenter_for_shift(lens, element, shift_px * DIAGONALS, grid)
    return rest, float(moved_mtf(lens, fields, frequency, element, moves_mm, band).min())


def cross_talk_px(along_px: Floats) -> float:
    """Return the largest shift across of moves [axis point 2] along rows and along columns."""
    return float(max(np.abs(along_px[0, :, 1]).max(), np.abs(along_px[1, :, 0]).max()))


def format_movers(movers: tuple[Mover, ...]) -> str:
    """Return the table of `which_element` or `which_mover` as lines of text."""
    lines = [
        "what moves                       stroke   gain  px per um  max shift error  cross-talk  "
        "MTF rest  moved   loss"
    ]
    for m in movers:
        stroke = f"{m.stroke_deg:6.3f} deg" if m.stroke_deg else f"{1e3 * m.stroke_mm:6.1f} um "
        numbers = f"{m.gain:6.3f} {m.sensitivity_px_per_um:10.5f}"
        lines.append(
            f"{label_of(m):<28.28} {stroke:>10} {numbers if not m.stroke_deg else '':17} "
            f"{m.max_shift_error_px:13.4f} px {m.cross_talk_px:8.4f} px "
            f"{m.mtf_centred:9.3f} {m.mtf_moved:6.3f} {m.mtf_loss:6.3f}"
        )
    return "\n".join(lines)


def label_of(mover: Mover) -> str:
    """Return how tables and figures name what moves."""
    if mover.kind in ("sensor", "wedges"):
        return mover.name
    return f"{mover.element + 1} {mover.name}" + (", tilted" if mover.stroke_deg else "")
