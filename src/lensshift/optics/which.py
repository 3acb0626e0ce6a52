"""What to move: the trade between stroke, evenness, sharpness and actuator."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lensshift.core.grid import Grid
from lensshift.optics.glass import refractive_index
from lensshift.optics.lens import Element, Lens, cover_glass
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import decenter_gains, focal_length_mm
from lensshift.optics.shift import decenter_for_shift, moving, shift_map, shift_uniformity
from lensshift.optics.spots import fields_for_image, spots
from lensshift.optics.trace import Build

Array = NDArray[np.float64]

_SIGNS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
_RINGS = 4  # of the pupil: centroids
_PROBE_RAD = 1e-3
_TILT_STEPS = 8
_CLOSE_PX = 1e-6
_MOST_TILT_RAD = math.radians(30.0)
_PLATE_GLASS, _PLATE_MM = "N-BK7", 1.0
_PLATE_ROOM_MM = 0.2  # on either side


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
    kind : "decentre", or of `which_mover`
    stroke_deg : tilt that moves the image along columns, 0 where something is decentred
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
        moves_mm = decenter_for_shift(lens, number, shift_px * _SIGNS, grid)
        even = shift_uniformity(shift_map(lens, number, moves_mm, grid), shift_px * _SIGNS)
        stroke_mm = float(decenter_for_shift(lens, number, [0.0, shift_px], grid)[1])
        along = shift_map(lens, number, stroke_mm * np.eye(2), grid).offset_px
        moved = np.stack(
            [_mtf_of(lens, fields, frequency, moving(lens, number, move)) for move in moves_mm]
        )
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
                cross_talk_px=_cross_talk_px(along.reshape(2, -1, 2)),
            )
        )
    return tuple(movers)


def which_mover(
    lens: Lens, grid: Grid, *, shift_px: float = 0.25, frequency_lpmm: float | None = None
) -> tuple[Mover, ...]:
    """Compare everything that can shift the image: elements, a plate, the sensor.

    To the rows of `which_element` this adds each element tilted about its first vertex ("tilt"), a
    tilted plane-parallel plate in front of the sensor ("plate": that of the lens, or 1 mm of N-BK7
    in the middle of the last gap with the sensor moved back by t (n - 1) / n, where there is room)
    and the sensor itself ("sensor": the same shift everywhere and no loss, by a stroke of
    -shift_px times the pitch). Error and cross-talk of the added rows are the largest at the
    centre, the ends of the axes and the corners. Tilts beyond 30 degrees are left out.

    Parameters
    ----------
    grid, shift_px, frequency_lpmm : as in `which_element`

    Raises
    ------
    ValueError
        As in `which_element`.
    """
    rows = list(which_element(lens, grid, shift_px=shift_px, frequency_lpmm=frequency_lpmm))
    frequency = 1.0 / max(grid.pitch_mm) if frequency_lpmm is None else frequency_lpmm
    plates = [number for number, one in enumerate(lens.elements) if _is_plate(one)]
    glazed = lens if plates else _with_plate(lens)
    for number, one in enumerate(lens.elements):
        if number not in plates:
            rows += _tilted(lens, number, one.name, "tilt", grid, shift_px, frequency)
    if glazed is not None:
        number = plates[-1] if plates else len(lens.elements)
        name = glazed.elements[number].name
        rows += _tilted(glazed, number, name, "plate", grid, shift_px, frequency)
    least = float(_mtf_of(lens, edge_fields(lens, grid), frequency).min())
    rows.append(
        Mover(
            element=len(lens.elements),
            name="sensor",
            stroke_mm=-shift_px * grid.pitch_mm[1],
            gain=-1.0,
            sensitivity_px_per_um=1e-3 / grid.pitch_mm[1],
            max_shift_error_px=0.0,
            mtf_centred=least,
            mtf_moved=least,
            mtf_loss=0.0,
            kind="sensor",
        )
    )
    return tuple(rows)


def _tilted(
    lens: Lens, number: int, name: str, kind: str, grid: Grid, shift_px: float, frequency: float
) -> list[Mover]:
    """Return the row of one tilted element, none if no tilt below 30 degrees makes the shift."""
    fields = edge_fields(lens, grid)
    pitch_mm = np.asarray(grid.pitch_mm)
    resting_mm = spots(lens, fields, rings=_RINGS).centroid_mm

    def build(tilt_rad: Array) -> Build:
        tilts = np.zeros((*tilt_rad.shape[:-1], 1, len(lens.elements), 2))
        tilts[..., 0, number, :] = tilt_rad
        return Build(tilt_rad=tilts)

    def shift_of(tilt_rad: Array) -> Array:
        moved_mm = spots(lens, fields, build=build(tilt_rad), rings=_RINGS).centroid_mm
        return np.asarray((moved_mm - resting_mm) / pitch_mm)

    wanted = shift_px * np.concatenate([_SIGNS, np.eye(2)])
    probes = _PROBE_RAD * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    at = shift_of(probes)[:, 0]
    slope = np.stack([at[0] - at[1], at[2] - at[3]], axis=-1) / (2.0 * _PROBE_RAD)
    if abs(np.linalg.det(slope)) < (shift_px / _MOST_TILT_RAD) ** 2:
        return []
    tilt_rad = wanted @ np.linalg.inv(slope).T
    try:
        for _ in range(_TILT_STEPS):
            missing = wanted - shift_of(tilt_rad)[:, 0]
            tilt_rad = tilt_rad + missing @ np.linalg.inv(slope).T
    except ValueError:  # no light gets through at such a tilt
        return []
    if np.abs(missing).max() > _CLOSE_PX or np.abs(tilt_rad).max() > _MOST_TILT_RAD:
        return []
    shift = shift_of(tilt_rad)
    centred = _mtf_of(lens, fields, frequency)
    builds = [Build(tilt_rad=build(one).tilt_rad[0]) for one in tilt_rad[:4]]  # type: ignore[index]
    moved = np.stack([_mtf_of(lens, fields, frequency, one) for one in builds])
    return [
        Mover(
            element=number,
            name=name,
            stroke_mm=0.0,
            gain=0.0,
            sensitivity_px_per_um=0.0,
            max_shift_error_px=float(np.linalg.norm(shift[:4] - wanted[:4, None], axis=-1).max()),
            mtf_centred=float(centred.min()),
            mtf_moved=float(moved.min()),
            mtf_loss=float((centred - moved).max()),
            kind=kind,
            stroke_deg=float(np.rad2deg(tilt_rad[5, 1])),
            cross_talk_px=_cross_talk_px(shift[4:]),
        )
    ]


def _cross_talk_px(along_px: Array) -> float:
    """Return the largest shift across of moves [axis point 2] along rows and along columns."""
    return float(max(np.abs(along_px[0, :, 1]).max(), np.abs(along_px[1, :, 0]).max()))


def _is_plate(element: Element) -> bool:
    return all(surface.curvature_per_mm == 0 for surface in element.surfaces) and not any(
        surface.asphere or surface.radial for surface in element.surfaces
    )


def _with_plate(lens: Lens) -> Lens | None:
    """Return the lens with a plate in the middle of its last gap, None if there is no room."""
    index = refractive_index(_PLATE_GLASS, lens.wavelength_nm, lens.temperature_c)
    longer_mm = lens.gaps_mm[-1] + _PLATE_MM * (index - 1.0) / index
    room_mm = 0.5 * (longer_mm - _PLATE_MM)
    if room_mm < _PLATE_ROOM_MM:
        return None
    plate = replace(cover_glass(_PLATE_GLASS, _PLATE_MM), name="plate")
    return replace(
        lens,
        elements=(*lens.elements, plate),
        gaps_mm=(*lens.gaps_mm[:-1], room_mm, room_mm),
    )


def edge_fields(lens: Lens, grid: Grid) -> Array:
    """Return the fields [9 2] at the centre, the ends of the axes and the corners of a sensor."""
    half_mm = 0.5 * np.asarray(grid.shape) * np.asarray(grid.pitch_mm)
    signs = np.stack(np.meshgrid([0.0, 1.0, -1.0], [0.0, 1.0, -1.0], indexing="ij"), axis=-1)
    return fields_for_image(lens, signs.reshape(-1, 2) * half_mm)


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
    if mover.kind == "sensor":
        return "sensor"
    return f"{mover.element + 1} {mover.name}" + (", tilted" if mover.stroke_deg else "")


def _mtf_of(lens: Lens, fields: Array, frequency_lpmm: float, build: Build | None = None) -> Array:
    """Return the exact MTF [field azimuth] at one frequency."""
    return np.abs([exact_otf(lens, field, frequency_lpmm, build=build)[:, 0] for field in fields])
