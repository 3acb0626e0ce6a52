"""Rays in front of a lens that pass its stop at wanted points."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats
from lensshift.optics.lens import Lens
from lensshift.optics.paraxial import entrance_pupil

if TYPE_CHECKING:
    from lensshift.optics.trace import System

_FALLS = 0.3  # of an error in a step: where aberrations of the pupil leave more, Newton is faster
_CLOSE_MM = 1e-10  # a tenth of what positions are compared to
_MISSED_MM = 1e-6  # from the point of the stop: a ray that does not go there
_TURN_RAD = math.radians(5.0)  # from field to field, over which the pupil moves little
_NEWTON_STEPS = 6  # from the field before
_MISSED = 1  # of `RayBundle.status`
_NEARLY = 0.1  # of the radius of the stop off: Newton's method leads to the same ray from there
_PROBE = 1e-4  # of the radius of the stop, for differences


@dataclass(slots=True)
class Rays:
    """Rays on their way, changed in place by the kernel: [batch ray ...]."""

    origin: Floats
    direction: Floats
    path: Floats
    status: NDArray[np.uint8]
    failed_at: NDArray[np.int16]


def launch(lens: Lens, system: System, pupil: Floats) -> Rays:
    """Return rays in front of the lens that pass the stop at the points of the pupil.

    Rays that cannot be made to pass there are missed.
    """
    stop = lens.stop
    target = np.broadcast_to(
        pupil * (0.5 * stop.diameter_mm), (len(system.fields), *pupil.shape)
    ).copy()
    stop_mm = np.full(len(system.fields), stop.position_mm)
    if stop.rides_on is not None:
        target += system.decenter[:, stop.rides_on, None, :]
        stop_mm += system.vertices[:, stop.rides_on, 2] - lens.positions_mm()[stop.rides_on]
    before = lens.elements_before_stop()
    if before == 0:
        return _towards(lens, system.fields, target, stop_mm, stop.position_mm)
    aim = _Aim(lens, system, stop_mm, int(np.sum(system.element < before)))
    entering = target * aim.scale
    largest_mm, before_mm, off_mm = math.inf, math.inf, target[..., 0]
    while largest_mm > _CLOSE_MM and not largest_mm > _FALLS * before_mm:
        error = target - aim.landing(entering)
        entering = entering + np.nan_to_num(error) * aim.scale
        off_mm = np.abs(error).max(axis=-1)
        largest_mm, before_mm = float(np.nanmax(off_mm, initial=0.0)), largest_mm
    nearly_mm = _NEARLY * 0.5 * stop.diameter_mm
    for near in (True, False):  # Newton's method from where rays are, if that is near; or led there
        far = ~np.all(off_mm < _CLOSE_MM, axis=-1)
        rows = np.flatnonzero(far & np.all(off_mm < nearly_mm, axis=-1) if near else far)
        if not rows.size:
            continue
        some = aim.part(rows)
        if near:
            found, error = some.newton(entering[rows], target[rows])[:2]
        else:
            found, error = some.followed(target[rows])
        closer_mm = np.abs(error).max(axis=-1)
        there = ~(off_mm[rows] < closer_mm) & np.isfinite(closer_mm)
        entering[rows] = np.where(there[..., None], found, entering[rows])
        off_mm[rows] = np.where(there, closer_mm, off_mm[rows])
    missed = ~(off_mm < _MISSED_MM)
    rays = aim.rays(entering)
    rays.status[missed], rays.failed_at[missed] = _MISSED, aim.surfaces - 1
    return rays


class _Aim:
    """Rays through points of the plane where the paraxial entrance pupil is."""

    def __init__(self, lens: Lens, system: System, stop_mm: Floats, surfaces: int) -> None:
        self._lens, self._system, self._stop_mm = lens, system, stop_mm
        self.surfaces, self._fields = surfaces, system.fields
        self._pupil_mm, self.scale = entrance_pupil(lens)

    def part(self, rows: NDArray[np.intp]) -> _Aim:
        """Return the same for some of the fields."""
        some, system = copy(self), copy(self._system)
        system.vertices, system.rotations, system.index = (
            each[rows] for each in (system.vertices, system.rotations, system.index)
        )
        some._system, some._fields = system, self._fields[rows]
        some._stop_mm = self._stop_mm[rows]
        return some

    def rays(self, entering: Floats) -> Rays:
        """Return the rays through points [batch ray 2]."""
        plane_mm = np.full(len(self._fields), self._pupil_mm)
        return _towards(self._lens, self._fields, entering, plane_mm, self._pupil_mm)

    def landing(self, entering: Floats) -> Floats:
        """Return where in the plane of the stop [batch ray 2] they arrive, NaN if they do not."""
        rays = self.rays(entering)
        self._system.follow(rays, self.surfaces, self._stop_mm)
        return rays.origin[..., :2]

    def followed(self, target: Floats) -> tuple[Floats, Floats]:
        """Return entering points for those of the stop, and by how much they miss these.

        The field turns from the axis to where it is wanted in steps of 5 degrees; from each to the
        next Newton's method follows the middle of the pupil, which a wide field may move by many
        times its size. The other rays start from where the slopes there lead.
        """
        wanted = self._fields
        tangent = np.linalg.norm(wanted, axis=-1)[:, None]
        angle_rad = np.arctan(tangent)
        middle = target.mean(axis=1, keepdims=True)
        across = before = middle * self.scale  # the light
        slope: Floats = np.eye(2)
        for share in np.linspace(0.0, 1.0, 1 + max(1, math.ceil(angle_rad.max() / _TURN_RAD))):
            self._fields = wanted * (np.tan(share * angle_rad) / np.maximum(tangent, 1e-12))
            narrow = np.cos(share * angle_rad)[..., None]
            found, _, slope = self.newton((2.0 * across - before) / narrow, middle)
            across, before = found * narrow, across
        return self.newton(found + _solved(slope, target - middle), target)[:2]

    def newton(self, entering: Floats, target: Floats) -> tuple[Floats, Floats, Floats]:
        """Return better points, by how much they miss, and landing over entering [... 2 2]."""
        probe_mm = _PROBE * 0.5 * self._lens.stop.diameter_mm
        for _ in range(_NEWTON_STEPS):
            beside = [entering + probe_mm * np.array(to) for to in ((0, 0), (1, 0), (0, 1))]
            here, *moved = np.split(self.landing(np.concatenate(beside, axis=1)), 3, axis=1)
            error = target - here
            slope = np.stack([each - here for each in moved], axis=-1) / probe_mm
            entering = entering + _solved(slope, error)
            if np.nanmax(np.abs(error), initial=0.0) < _CLOSE_MM:
                break
        return entering, error, slope


def _solved(slope: Floats, error: Floats) -> Floats:
    """Return the steps [... 2] that undo errors, NaN where a slope [... 2 2] tells of none."""
    (a, b), (c, d) = np.moveaxis(slope, (-2, -1), (0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        row = (d * error[..., 0] - b * error[..., 1]) / (a * d - b * c)
        col = (a * error[..., 1] - c * error[..., 0]) / (a * d - b * c)
    return np.stack([row, col], axis=-1)


def _towards(lens: Lens, fields: Floats, target: Floats, plane_mm: Floats, pupil_mm: float) -> Rays:
    """Return rays from the object points through the points [batch ray 2] of a plane."""
    origin = np.empty((*target.shape[:-1], 3))
    origin[..., :2] = target
    origin[..., 2] = plane_mm[:, None]
    direction = np.empty_like(origin)
    if math.isinf(lens.object_mm):
        direction[..., :2] = fields[:, None, :]
        direction[..., 2] = 1.0
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        path = np.einsum("bri,bri->br", origin, direction) - pupil_mm * direction[..., 2]
    else:
        points = -fields * (lens.object_mm + pupil_mm)
        direction[..., :2] = target - points[:, None, :]
        direction[..., 2] = plane_mm[:, None] + lens.object_mm
        path = np.linalg.norm(direction, axis=-1)
        # The entrance pupil of a hypercentric lens lies in front of the object.
        path = np.copysign(path, direction[..., 2])
        direction /= path[..., None]
    return Rays(
        origin, direction, path, np.zeros(path.shape, np.uint8), np.full(path.shape, -1, np.int16)
    )
