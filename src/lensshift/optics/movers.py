"""Everything that can shift the image: elements, a plate, wedges, the sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.optics.glass import glass_data, refractive_index
from lensshift.optics.lens import Element, Lens, Surface, cover_glass
from lensshift.optics.paraxial import paraxial
from lensshift.optics.shift import central_slope, moving
from lensshift.optics.spots import image_per_field_mm, spots
from lensshift.optics.trace import Build
from lensshift.optics.variables import is_plate
from lensshift.optics.which import (
    DIAGONALS,
    Mover,
    cross_talk_px,
    diagonals_that_differ,
    edge_fields,
    edge_mtf,
    judged_lpmm,
    which_element,
)

_RINGS = 4  # of the pupil: centroids
_PROBE_RAD, _PROBE_TURN = 1e-3, 0.02  # where shifts are linear
_STEPS = 8  # of Newton, from the linear guess
_CLOSE_PX = 1e-6  # far below any error of a shift
_MOST_TILT_RAD = math.radians(30.0)  # no mount turns farther
_PLATE_GLASS, _PLATE_MM = "N-BK7", 1.0
_PLATE_ROOM_MM = 0.2  # on either side
_WEDGE_MM, _WEDGE_ROOM_MM = 1.0, 1.0
_HEIGHTS = 33  # of a surface, where it is asked how far it reaches
_WEDGE_USE = 0.5  # sine of the turn of each wedge for the wanted diagonal shift


def which_mover(
    lens: Lens, grid: Grid, *, shift_px: float = 0.25, frequency_lpmm: float | None = None
) -> tuple[Mover, ...]:
    """Compare everything that can shift the image: elements, a plate, a pair of wedges, the sensor.

    To the rows of `which_element` this adds

    - "tilt": each element but mirrors tilted about its first vertex;
    - "plate": a tilted plane-parallel plate in front of the sensor: that of the lens, or 1 mm of
      N-BK7, or of the first glass of the lens where N-BK7 is dark, in the middle of the last gap
      with the sensor moved back by t (n - 1) / n, where there is room;
    - "wedges": two equal wedges in front of the lens that turn about the axis (Risley), so strong
      that each turns by 30 degrees for the diagonal shift, where the object leaves room;
    - "sensor": the same shift everywhere and no loss, by a stroke of -shift_px times the pitch.

    Error and cross-talk of the added rows are the largest at the centre, the ends of the axes and
    the corners. Tilts beyond 30 degrees are left out.

    Parameters
    ----------
    grid, shift_px, frequency_lpmm : as in `which_element`

    Raises
    ------
    ValueError
        As in `which_element`.
    """
    paraxial(lens)  # refuses a lens without power before the work
    rows = list(which_element(lens, grid, shift_px=shift_px, frequency_lpmm=frequency_lpmm))
    frequency = judged_lpmm(grid, frequency_lpmm)
    plates = [number for number, one in enumerate(lens.elements) if is_plate(one)]
    turning = [
        _tilted(lens, number, "tilt")
        for number, element in enumerate(lens.elements)
        if not (number in plates or element.folds)
    ]
    glazed = lens if plates else _with_plate(lens)
    if glazed is not None:
        turning.append(_tilted(glazed, plates[-1] if plates else len(lens.elements), "plate"))
    if _clear_glass(lens) and _before_lens_mm(lens) < lens.object_mm:
        turning.append(_wedges(lens, grid, shift_px))
    found = (_row(one, grid, shift_px, frequency) for one in turning)
    rows += [row for row in found if row is not None]
    least = float(edge_mtf(lens, edge_fields(lens, grid), frequency).min())
    rows.append(
        Mover(
            element=len(lens.elements),
            name="sensor",
            stroke_mm=-shift_px * grid.pitch_mm[1],
            gain=-1.0,
            sensitivity_px_per_um=1e-3 / min(grid.pitch_mm),
            max_shift_error_px=0.0,
            mtf_centred=least,
            mtf_moved=least,
            mtf_loss=0.0,
            kind="sensor",
        )
    )
    return tuple(rows)


def wedge(glass: str, thickness_mm: float, wedge_rad: float, towards_rad: float) -> Element:
    """Return a plate whose back leans, so that light turns by (n - 1) wedge_rad.

    Parameters
    ----------
    thickness_mm : on the axis
    wedge_rad : between front and back
    towards_rad : where the glass is thickest and where light turns to, from the columns to the rows
    """
    x = -math.sin(wedge_rad) * math.cos(towards_rad)
    y = -math.sin(wedge_rad) * math.sin(towards_rad)
    back = Surface(math.inf, tilt_rad=(math.atan2(y, math.cos(wedge_rad)), math.asin(x)))
    return Element((Surface(math.inf), back), (glass,), (thickness_mm,), name="wedge")


def with_wedges(
    lens: Lens, wedge_rad: float, turn_rad: tuple[float, float], glass: str = _PLATE_GLASS
) -> Lens:
    """Return the lens behind two equal wedges, 1 mm thick and 1 mm apart, in front of the stop.

    Parameters
    ----------
    wedge_rad : between the sides of each
    turn_rad : where each is thickest, from the columns to the rows; opposite ones do nothing
    """
    longer_mm = _before_lens_mm(lens)
    ahead_mm = longer_mm - 2.0 * _WEDGE_MM - _WEDGE_ROOM_MM
    carrier, behind = lens.stop.rides_on, lens.stop.behind
    return replace(
        lens,
        elements=(*(wedge(glass, _WEDGE_MM, wedge_rad, at) for at in turn_rad), *lens.elements),
        gaps_mm=(_WEDGE_ROOM_MM, ahead_mm, *lens.gaps_mm),
        stop=replace(
            lens.stop,
            position_mm=lens.stop.position_mm + longer_mm,
            rides_on=None if carrier is None else carrier + 2,
            behind=None if behind is None else behind + 2,
        ),
        object_mm=lens.object_mm - longer_mm,
    )


def _before_lens_mm(lens: Lens) -> float:
    """Return how much room two wedges take in front of a lens, a hollow one too, and its stop."""
    front = lens.elements[0].surfaces[0]
    edge_mm = front.semi_diameter_mm if math.isfinite(front.semi_diameter_mm) else 0.0
    hollow_mm = -float(np.nanmin(front.sag_mm(np.linspace(0.0, edge_mm, _HEIGHTS))))
    ahead_mm = 0.0 if lens.elements_before_stop() else -lens.stop.position_mm
    return 2.0 * (_WEDGE_MM + _WEDGE_ROOM_MM) + max(hollow_mm, ahead_mm, 0.0)


class _Turning(NamedTuple):
    """Something whose state is a pair of angles or sines, about 0 at rest."""

    element: int
    name: str
    kind: str
    look: Callable[[Floats], tuple[Lens, Build]]  # in a state [2]
    probe: float  # a small state
    most: float  # the largest
    degrees: Callable[[float], float]  # of a state along columns


def _tilted(lens: Lens, number: int, kind: str) -> _Turning:
    def look(tilt_rad: Floats) -> tuple[Lens, Build]:
        return lens, moving(lens, number, tilt_rad, tilt=True)

    name = lens.elements[number].name
    return _Turning(number, name, kind, look, _PROBE_RAD, _MOST_TILT_RAD, math.degrees)


def _wedges(lens: Lens, grid: Grid, shift_px: float) -> _Turning:
    """Return a pair whose state s turns both wedges to the bisector at s, by arcsin |s|."""
    glass = _clear_glass(lens)
    index = refractive_index(glass, lens.wavelength_nm, lens.temperature_c)
    diagonal_mm = shift_px * float(np.hypot(*grid.pitch_mm))
    turned_rad = diagonal_mm / abs(image_per_field_mm(lens))
    wedge_rad = turned_rad / (2.0 * _WEDGE_USE * (index - 1.0))

    def look(state: Floats) -> tuple[Lens, Build]:
        middle_rad = math.atan2(state[0], state[1])
        aside_rad = math.acos(min(1.0, math.hypot(*state)))
        turn_rad = (middle_rad + aside_rad, middle_rad - aside_rad)
        return with_wedges(lens, wedge_rad, turn_rad, glass), Build()

    name = f"wedge pair of {math.degrees(wedge_rad):.2g} deg"
    return _Turning(
        -1, name, "wedges", look, _PROBE_TURN, 1.0, lambda s: math.degrees(math.asin(s))
    )


def _row(one: _Turning, grid: Grid, shift_px: float, frequency_lpmm: float) -> Mover | None:
    """Return the row of something that turns, None if no state that it has makes the shift."""
    pitch_mm = np.asarray(grid.pitch_mm)
    lens, still = one.look(np.zeros(2))
    fields = edge_fields(lens, grid)
    resting_mm = spots(lens, fields, build=still, rings=_RINGS).centroid_mm

    def shifts(states: Floats) -> Floats:
        looks = [one.look(state) for state in states]
        moved_mm = [spots(a, fields, build=b, rings=_RINGS).centroid_mm for a, b in looks]
        return np.asarray((np.array(moved_mm) - resting_mm) / pitch_mm)

    states = _states(one, shifts, shift_px)
    if states is None:
        return None
    wanted = shift_px * DIAGONALS
    shift = shifts(states)
    centred = edge_mtf(lens, fields, frequency_lpmm, still)
    # Wedges that turn as the mirror image would are not the mirror image: one is before the other.
    different = 4 if one.kind == "wedges" else diagonals_that_differ(lens)
    looks = map(one.look, states[:different])
    moved = np.stack([edge_mtf(a, fields, frequency_lpmm, b) for a, b in looks])
    return Mover(
        element=one.element,
        name=one.name,
        stroke_mm=0.0,
        gain=0.0,
        sensitivity_px_per_um=0.0,
        max_shift_error_px=float(np.linalg.norm(shift[:4] - wanted[:, None], axis=-1).max()),
        mtf_centred=float(centred.min()),
        mtf_moved=float(moved.min()),
        mtf_loss=float((centred - moved).max()),
        kind=one.kind,
        stroke_deg=one.degrees(float(states[5, 1])),
        cross_talk_px=cross_talk_px(shift[4:]),
    )


def _states(one: _Turning, shifts: Callable[[Floats], Floats], shift_px: float) -> Floats | None:
    """Return the states [6 2] of the four diagonal shifts, and along rows and columns alone."""
    wanted = shift_px * np.concatenate([DIAGONALS, np.eye(2)])
    slope = central_slope(lambda states: shifts(states)[:, 0], one.probe)
    if abs(np.linalg.det(slope)) < (shift_px / one.most) ** 2:
        return None
    states = wanted @ np.linalg.inv(slope).T
    missing = wanted
    try:
        for _ in range(_STEPS):
            missing = wanted - shifts(states)[:, 0]
            states = states + missing @ np.linalg.inv(slope).T
            if np.abs(missing).max() < _CLOSE_PX:
                break
    except ValueError:  # no light gets through in such a state
        return None
    if np.abs(missing).max() > _CLOSE_PX or np.abs(states).max() > one.most:
        return None
    return states


def _clear_glass(lens: Lens) -> str:
    """Return a glass that the light of a lens passes: N-BK7, one of the lens, or none."""
    low_nm, high_nm = glass_data(_PLATE_GLASS).range_nm
    if low_nm <= lens.wavelength_nm <= high_nm:
        return _PLATE_GLASS
    return next((glass for element in lens.elements for glass in element.glass), "")


def _with_plate(lens: Lens) -> Lens | None:
    """Return the lens with a plate in the middle of its last gap, None if there is no room."""
    glass = _clear_glass(lens)
    if not glass:
        return None
    index = refractive_index(glass, lens.wavelength_nm, lens.temperature_c)
    longer_mm = lens.gaps_mm[-1] + _PLATE_MM * (index - 1.0) / index
    room_mm = 0.5 * (longer_mm - _PLATE_MM)
    if room_mm < _PLATE_ROOM_MM:
        return None
    plate = replace(cover_glass(glass, _PLATE_MM), name="plate")
    gaps_mm = (*lens.gaps_mm[:-1], room_mm, room_mm)
    return replace(lens, elements=(*lens.elements, plate), gaps_mm=gaps_mm)
