"""Which element to move: the trade between stroke, evenness, sharpness and actuator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.grid import Grid
from lensshift.optics.lens import Lens
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import decenter_gains, focal_length_mm
from lensshift.optics.shift import decenter_for_shift, moving, shift_map, shift_uniformity
from lensshift.optics.spots import fields_for_image

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Mover:
    """What it means to shift the image with one element.

    Parameters
    ----------
    element : its number, counted from 0
    name : of the element
    stroke_mm : decentre along columns for the wanted shift, negative if the image goes the other
        way
    gain : image movement over element movement, both in mm
    sensitivity_px_per_um : error of the shift per micrometre of the actuator
    max_shift_error_px : largest departure from the wanted diagonal shift over the sensor
    mtf_centred : lowest MTF over fields and directions with the element at rest
    mtf_moved : the same over the four diagonal moves
    mtf_loss : largest fall of a field and direction from rest to moved
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


def which_element(
    lens: Lens, grid: Grid, *, shift_px: float = 0.25, frequency_lpmm: float | None = None
) -> tuple[Mover, ...]:
    """Compare the elements as movers, for diagonal shifts of `shift_px` along both axes.

    Plane-parallel plates are left out: moving them does nothing. The MTF is exact, at the centre,
    the ends of the axes and the corners of the sensor, along rows and columns.

    Parameters
    ----------
    grid : of the sensor
    shift_px : along each axis
    frequency_lpmm : of the MTF; by default the Nyquist frequency of twice as many pixels

    Raises
    ------
    ValueError
        If the shift is not positive, or as in `decenter_for_shift`.
    """
    if not shift_px > 0:
        raise ValueError(f"expected a positive shift_px, got {shift_px}")
    frequency = 1.0 / max(grid.pitch_mm) if frequency_lpmm is None else frequency_lpmm
    fields = edge_fields(lens, grid)
    centred = _mtf_of(lens, fields, frequency)
    gains = decenter_gains(lens)
    movers = []
    for number, (element, indices) in enumerate(zip(lens.elements, lens.indices(), strict=True)):
        if np.isinf(focal_length_mm(element, indices)):
            continue
        signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
        moves_mm = decenter_for_shift(lens, number, shift_px * signs, grid)
        even = shift_uniformity(shift_map(lens, number, moves_mm, grid), shift_px * signs)
        stroke_mm = float(decenter_for_shift(lens, number, [0.0, shift_px], grid)[1])
        moved = np.stack([_mtf_of(lens, fields, frequency, number, move) for move in moves_mm])
        movers.append(
            Mover(
                element=number,
                name=element.name,
                stroke_mm=stroke_mm,
                gain=float(gains[number]),
                sensitivity_px_per_um=1e-3 * shift_px / abs(stroke_mm),
                max_shift_error_px=max(one.max_error_px for one in even),
                mtf_centred=float(centred.min()),
                mtf_moved=float(moved.min()),
                mtf_loss=float((centred - moved).max()),
            )
        )
    return tuple(movers)


def edge_fields(lens: Lens, grid: Grid) -> Array:
    """Return the fields [9 2] at the centre, the ends of the axes and the corners of a sensor."""
    half_mm = 0.5 * np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    signs = np.stack(np.meshgrid([0.0, 1.0, -1.0], [0.0, 1.0, -1.0], indexing="ij"), axis=-1)
    return fields_for_image(lens, signs.reshape(-1, 2) * half_mm)


def format_movers(movers: tuple[Mover, ...]) -> str:
    """Return the table of `which_element` as lines of text."""
    lines = [
        "element                stroke   gain  px per um  max shift error  MTF rest  moved   loss"
    ]
    lines += [
        f"{m.element + 1} {m.name:<18.18} {1e3 * m.stroke_mm:6.1f} um {m.gain:6.3f} "
        f"{m.sensitivity_px_per_um:10.5f} {m.max_shift_error_px:13.4f} px "
        f"{m.mtf_centred:9.3f} {m.mtf_moved:6.3f} {m.mtf_loss:6.3f}"
        for m in movers
    ]
    return "\n".join(lines)


def _mtf_of(
    lens: Lens,
    fields: Array,
    frequency_lpmm: float,
    element: int | None = None,
    decenter_mm: ArrayLike = (0.0, 0.0),
) -> Array:
    """Return the exact MTF [field azimuth] at one frequency."""
    build = None if element is None else moving(lens, element, np.asarray(decenter_mm))
    return np.abs([exact_otf(lens, field, frequency_lpmm, build=build)[:, 0] for field in fields])
