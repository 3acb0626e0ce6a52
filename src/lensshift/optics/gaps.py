"""The search for the gaps of a train of elements, many candidates in one trace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.optics.focus import scan_focus, spot_means
from lensshift.optics.goal import Goal
from lensshift.optics.lens import Element, Lens
from lensshift.optics.mtf import light_of
from lensshift.optics.paraxial import element_matrix, entrance_pupil, gains_of, gap_matrix
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.trace import Build, trace
from lensshift.optics.which import POSITIONS

_LONGEST_GAP = 1.2  # of the focal length
_COARSE = {0: 1, 1: 64, 2: 24, 3: 12}  # grid points along each free gap, by their number
MOST_ELEMENTS = max(_COARSE) + 2  # the sensor and the focal length take a gap each
_FINE, _ZOOM = 9, 4.0  # points of a refinement, and how much closer the next one is
_ASIDE_MM, _PLANE_MM, _PLANES = -0.6, 0.02, 51  # of the sensor from the paraxial image
_NEAR_ASIDE_MM, _NEAR_PLANE_MM = -0.125, 0.005  # of the sensor from the best one so far
_PITCH_MM, _F_NUMBER = 0.155, 2.135  # of these steps; others go with pitch and f-number
_LEAST_GAIN = 0.1  # image movement over element movement
_SHIFT_WEIGHT = 10.0  # MTF given up per px of shift error above the limit
_DIGITS = 4  # of a gap in mm
_IMPOSSIBLE = -1.0


@dataclass(frozen=True, slots=True)
class Effort:
    """How closely a train is looked at.

    Parameters
    ----------
    rings : of the pupil quadrature
    azimuths : of the MTF, over half a turn
    fields : [field] (row, col) shares of the half height and width of the sensor; the first is
        the centre
    rounds : of refinement of the gaps
    """

    rings: int = 4
    azimuths: int = 6
    fields: tuple[tuple[float, float], ...] = ((0, 0), (0, 0.6), (0, 1), (1, 0), (1, 1))
    rounds: int = 5


def best_gaps(
    train: tuple[Element, ...], goal: Goal, element: int | None, effort: Effort
) -> tuple[float, Floats] | None:
    """Return the best score and its gaps [element], or None if there are none that fit.

    Parameters
    ----------
    train : elements in their final orientations
    element : number of the one that moves, or None
    """
    if not goal.stop_behind < len(train):
        raise ValueError(
            f"expected the stop behind fewer than {len(train)} elements, got {goal.stop_behind}"
        )
    if goal.stop.diameter_mm > _widest_stop_mm(train, goal):
        return None
    search = _Search(train, goal, element, effort)
    free = len(train) - 2
    high_mm = np.full(free, _LONGEST_GAP * goal.focal_length_mm)
    low_mm = search.least_mm[:free]
    axes = [np.linspace(a, b, _COARSE[free]) for a, b in zip(low_mm, high_mm, strict=True)]
    best = search.best(np.array(list(product(*axes))), _ASIDE_MM * search.unit, _PLANE_MM)
    step_mm = (high_mm - low_mm) / max(_COARSE[free] - 1, 1)
    pattern = np.array(list(product(np.linspace(-1.0, 1.0, _FINE), repeat=free)))
    for _ in range(effort.rounds):
        if best.score <= _IMPOSSIBLE:
            return None
        near = np.clip(best.gaps_mm[:free] + step_mm * pattern, low_mm, high_mm)
        found = search.best(near, best.aside_mm + _NEAR_ASIDE_MM * search.unit, _NEAR_PLANE_MM)
        best = max(best, found, key=lambda one: one.score)
        step_mm = step_mm / _ZOOM
    return None if best.score <= _IMPOSSIBLE else (best.score, best.gaps_mm)


def none_reaches(trains: Sequence[tuple[Element, ...]], goal: Goal, what: str) -> ValueError:
    """Return what to say where `best_gaps` finds nothing for any of the trains."""
    widest_mm = max(_widest_stop_mm(train, goal) for train in trains)
    if goal.stop.diameter_mm > widest_mm:
        return ValueError(
            f"expected a stop no wider than the lens beside it, {widest_mm:g} mm, got "
            f"{goal.stop.diameter_mm:g} mm"
        )
    return ValueError(
        f"expected lenses that reach a focal length of {goal.focal_length_mm} mm with "
        f"{goal.back_focal_mm} mm in front of the sensor and {100 * goal.transmission:g} % of the "
        f"light through the stop of {goal.stop.diameter_mm:g} mm at every field, got none in "
        f"{len(trains)} {what}"
    )


def train_lens(train: tuple[Element, ...], gaps_mm: Floats, goal: Goal, name: str = "") -> Lens:
    """Return the lens of a train with these gaps, the last of them to the sensor, and the cover.

    The last gap is that without a cover; one takes as much of it as light needs.
    """
    gaps = [float(gap) for gap in np.round(gaps_mm, _DIGITS)]
    elements = train
    if goal.cover is not None:
        elements = (*train, goal.cover)
        gaps = [*gaps[:-1], round(gaps[-1] - goal.cover_path_mm, _DIGITS), goal.cover_mm]
    front = zip(train[: goal.stop_behind], gaps, strict=False)
    ends_mm = sum(one.length_mm + gap for one, gap in front)
    ends_mm -= gaps[goal.stop_behind - 1] if goal.stop_behind else 0.0
    return Lens(
        elements=elements,
        gaps_mm=tuple(gaps),
        stop=replace(goal.stop, position_mm=goal.stop.position_mm + ends_mm),
        object_mm=goal.object_mm,
        wavelength_nm=goal.wavelength_nm,
        temperature_c=goal.temperature_c,
        name=name,
    )


class _Found(NamedTuple):
    """The best of some candidates."""

    score: float
    gaps_mm: Floats
    aside_mm: float  # of the sensor, from the paraxial image


class _Trains(NamedTuple):
    """Candidates by the laws of paraxial optics."""

    gaps_mm: Floats  # [candidate element] the last one to the paraxial image
    magnification: Floats  # [candidate] as in `field_tan`
    gain: Floats  # [candidate] image movement over element movement; 1 if none moves


class _Search:
    """Scores candidates for the gaps of one train."""

    def __init__(
        self, train: tuple[Element, ...], goal: Goal, element: int | None, effort: Effort
    ) -> None:
        self.goal, self.element, self.effort = goal, element, effort
        self.least_mm = np.array(
            [_least_gap_mm(a, b, goal.clearance_mm) for a, b in pairwise(train)]
        )
        behind = goal.stop_behind
        if behind:
            room_mm = goal.stop.position_mm + goal.clearance_mm
            self.least_mm[behind - 1] = max(self.least_mm[behind - 1], room_mm)
        self.least_back_mm = _least_back_mm(train[-1], goal)
        lens = train_lens(train, np.append(self.least_mm, self.least_back_mm), goal)
        # Between elements the stop goes where the one in front of it goes.
        riding = replace(lens.stop, rides_on=behind - 1) if behind else lens.stop
        self.base = replace(lens, stop=riding)
        self.pupil_mm = entrance_pupil(self.base)[0]
        self.matrices = [
            element_matrix(one, n) for one, n in zip(train, self.base.indices(), strict=False)
        ]
        self.points, self.weight = pupil_quadrature(effort.rings)
        f_number = goal.focal_length_mm / goal.stop.diameter_mm
        self.unit = max(goal.grid.pitch_mm) / _PITCH_MM * f_number / _F_NUMBER

    def best(self, free_mm: Floats, aside_mm: float, plane_mm: float) -> _Found:
        """Return the best of candidates [candidate free gap], sensors in evenly spaced planes."""
        goal = self.goal
        trains = self._trains(free_mm)
        if not len(trains.gain):
            return _Found(_IMPOSSIBLE, np.empty(0), 0.0)
        image_mm, step_mm = trains.gaps_mm[:, -1], plane_mm * self.unit
        first_mm = np.maximum(aside_mm, self.least_back_mm - image_mm)
        positions = POSITIONS if self.element is not None else POSITIONS[:1]
        wanted_mm = goal.shift_px * np.asarray(goal.grid.pitch_mm) * positions
        moves = np.zeros((len(image_mm), len(positions), 1, len(self.base.elements), 2))
        if self.element is not None:
            moves[:, :, 0, self.element] = wanted_mm / trains.gain[:, None, None]
        gap_mm = np.zeros((len(image_mm), len(self.base.elements)))
        gap_mm[:, : len(self.matrices)] = trains.gaps_mm - [*self.least_mm, self.least_back_mm]
        fields = field_tan(goal, trains.magnification, self.effort.fields, self.pupil_mm)
        build = Build(decenter_mm=moves, gap_mm=gap_mm[:, None, None])
        azimuths_rad = np.linspace(0.0, np.pi, self.effort.azimuths, endpoint=False)
        mtf, rays = np.zeros(1), None
        # Without what colours beside each other take from the sum.
        for nm, share in light_of(goal.band, goal.wavelength_nm):
            rays = trace(self.base, fields[:, None], self.points, build=build, wavelength_nm=nm)
            mtf = mtf + share * scan_focus(
                rays, self.weight, self.effort.rings, goal.judged_lpmm, azimuths_rad,
                nm, first_mm=first_mm[:, None, None], step_mm=step_mm, planes=_PLANES,
            )  # fmt: skip
        if goal.band is not None or rays is None:
            rays = trace(self.base, fields[:, None], self.points, build=build)
        transmission, at_mm, slope = spot_means(rays, self.weight)
        score = mtf.min(axis=(1, 2, 3))
        score[transmission.min(axis=(1, 2)) < goal.transmission] = _IMPOSSIBLE
        behind_mm = first_mm + step_mm * score.argmax(axis=-1)
        centroid_mm = at_mm + behind_mm[:, None, None, None] * slope
        score = score.max(axis=-1) - self._penalty(centroid_mm, wanted_mm)
        one = int(np.nanargmax(np.where(np.isnan(score), _IMPOSSIBLE, score)))
        gaps_mm = trains.gaps_mm[one].copy()
        gaps_mm[-1] += behind_mm[one]
        return _Found(float(score[one]), gaps_mm, float(behind_mm[one]))

    def _penalty(self, centroid_mm: Floats, wanted_mm: Floats) -> Floats:
        """Return what the shift errors of [candidate position field] cost each candidate."""
        if self.element is None:
            return np.zeros(len(centroid_mm))
        shift_mm = centroid_mm[:, 1:] - centroid_mm[:, :1]
        evened = shift_mm * wanted_mm[1:, None] / shift_mm[:, :, :1]  # exact at the centre
        error_px = (evened - wanted_mm[1:, None]) / np.asarray(self.goal.grid.pitch_mm)
        largest = np.linalg.norm(error_px, axis=-1).max(axis=(1, 2))
        return np.asarray(_SHIFT_WEIGHT * np.maximum(largest - self.goal.shift_error_px, 0.0))

    def _trains(self, free_mm: Floats) -> _Trains:
        """Return the candidates that have the focal length and fit, by matrices [candidate 2 2]."""
        goal, last = self.goal, self.matrices[-1]
        front = np.broadcast_to(self.matrices[0], (len(free_mm), 2, 2))
        for number, gap_mm in enumerate(free_mm.T, start=1):
            front = self.matrices[number] @ gap_matrix(gap_mm) @ front
        # The power of the train is linear in its last gap.
        per_mm = last[1, 0] * front[:, 1, 0]
        with np.errstate(divide="ignore"):
            solved_mm = (-1.0 / goal.focal_length_mm - (last @ front)[:, 1, 0]) / per_mm
        longest_mm = _LONGEST_GAP * goal.focal_length_mm
        fits = (solved_mm >= self.least_mm[-1]) & (solved_mm <= longest_mm)
        free_mm, solved_mm, front = free_mm[fits], solved_mm[fits], front[fits]
        whole = last @ gap_matrix(solved_mm) @ front
        if math.isinf(goal.object_mm):
            image_mm = -whole[:, 0, 0] / whole[:, 1, 0]
            magnification = np.full(len(image_mm), goal.focal_length_mm)
        else:
            whole = whole @ np.array([[1.0, goal.object_mm], [0.0, 1.0]])
            image_mm = -whole[:, 0, 1] / whole[:, 1, 1]
            magnification = np.abs(whole[:, 0, 0] + image_mm * whole[:, 1, 0])
        gaps_mm = np.column_stack([free_mm, solved_mm, image_mm])
        gain = np.ones(len(gaps_mm))
        if self.element is not None:
            gain = gains_of(self.matrices, gaps_mm)[:, self.element]
        reach_mm = self.least_back_mm - self.unit * (_ASIDE_MM + _PLANE_MM * _PLANES)
        kept = (image_mm > max(reach_mm, 0.0)) & (np.abs(gain) > _LEAST_GAIN)
        return _Trains(gaps_mm[kept], magnification[kept], gain[kept])


def field_tan(
    goal: Goal, magnification: Floats, shares: Sequence[tuple[float, float]], pupil_mm: float
) -> Floats:
    """Return the fields [train field 2] whose paraxial images lie at shares of the half sensor.

    Parameters
    ----------
    magnification : [train] size of the image over that of the object, or image height over
        tangent of the angle in mm for an infinitely far object
    shares : [field] (row, col), 1 at the edge
    pupil_mm : place of the entrance pupil behind the first vertex
    """
    half_mm = 0.5 * np.asarray(goal.grid.shape) * np.asarray(goal.grid.pitch_mm)
    far = math.isinf(goal.object_mm)
    image_mm = magnification * (1.0 if far else goal.object_mm + pupil_mm)
    return np.asarray(np.asarray(shares) * half_mm / image_mm[:, None, None])


def _widest_stop_mm(train: tuple[Element, ...], goal: Goal) -> float:
    """Return the clear diameter of the surface beside the stop."""
    beside = train[max(goal.stop_behind - 1, 0)].surfaces[-1 if goal.stop_behind else 0]
    return 2.0 * beside.semi_diameter_mm


def _least_gap_mm(front: Element, back: Element, clearance_mm: float) -> float:
    """Return the shortest gap that leaves the clearance between two elements everywhere."""
    before, behind = front.surfaces[-1], back.surfaces[0]
    edge_mm = min(before.semi_diameter_mm, behind.semi_diameter_mm)
    heights_mm = np.linspace(0.0, edge_mm if math.isfinite(edge_mm) else 0.0, 65)
    room_mm = behind.sag_mm(heights_mm) - before.sag_mm(heights_mm)
    return float(np.ceil((clearance_mm - room_mm.min()) * 10**_DIGITS) / 10**_DIGITS)


def _least_back_mm(last: Element, goal: Goal) -> float:
    """Return the least distance from the last vertex to the sensor if there were no cover.

    The edge of a hollow last surface must not reach into the cover.
    """
    if goal.cover is None:
        return goal.back_focal_mm
    before_mm = goal.back_focal_mm - goal.cover.length_mm - goal.cover_mm
    room_mm = _least_gap_mm(last, goal.cover, goal.clearance_mm)
    return goal.cover_path_mm + max(room_mm, before_mm)
