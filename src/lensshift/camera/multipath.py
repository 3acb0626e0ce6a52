"""Light that meets two surfaces: from the camera to a patch, to a point, and back."""

from __future__ import annotations

import numpy as np

from lensshift.camera.channels import Tones
from lensshift.camera.settings import Multipath
from lensshift.camera.view import View
from lensshift.core.arrays import Array
from lensshift.core.grid import Grid
from lensshift.scene import Scene, cast, visible

_PAIRS_AT_ONCE = 200_000  # some 20 MB of work


class IndirectLight:
    """What patches of the scene throw on points, in the same units as direct light.

        irradiance(p) = sum_q rho_q solid_q / pi * cos_q cos_p / (r^2 + area_q / pi)
        distance = (d_q + r + d_p) / 2

    A patch q that covers the solid angle solid_q receives cos / d^2 on solid_q d^2 / cos and
    scatters rho_q / pi of it per solid angle. The area of the patch keeps the sum finite where
    patch and point touch: a disc throws light on a point in front of it like this.
    """

    def __init__(
        self, scene: Scene, settings: Multipath, grid: Grid, view: View, tones: Tones
    ) -> None:
        rows, cols = (
            (np.arange(count) + 0.5) / count * pixels - 0.5
            for count, pixels in zip(settings.patches, grid.shape, strict=True)
        )
        down, right = view.lattice(rows, cols)
        across = [
            per_px * pixels / count
            for per_px, pixels, count in zip(view.per_px, grid.shape, settings.patches, strict=True)
        ]
        hits = cast(scene, np.stack([right, down, np.ones_like(down)], axis=-1))
        lit = hits.hit & (hits.cos_incidence > 0)
        solid = (across[0] * across[1] / (1.0 + down**2 + right**2) ** 1.5)[lit]
        self._scene, self._tones, self._shadows = scene, tones, settings.shadows
        self._point_m, self._normal = hits.point_m[lit], hits.normal[lit]
        self._distance_m = hits.distance_m[lit]
        self._power = hits.reflectance[lit] * solid / np.pi
        self._disc_m2 = solid * self._distance_m**2 / hits.cos_incidence[lit] / np.pi

    def at(self, point_m: Array, normal: Array) -> Array:
        """Return light and phasors [point 1 + 2 tone] that arrive at points [point 3]."""
        arriving = np.zeros((len(point_m), 1 + 2 * self._tones.count))
        known = np.flatnonzero(np.isfinite(point_m).all(axis=-1))
        at_once = max(1, _PAIRS_AT_ONCE // max(1, len(self._power)))
        for first in range(0, len(known), at_once):
            some = known[first : first + at_once]
            arriving[some] = self._sum(point_m[some], normal[some])
        return arriving

    def _sum(self, point_m: Array, normal: Array) -> Array:
        away = self._point_m - point_m[:, None, :]
        between_m = np.linalg.norm(away, axis=-1)
        safe_m = np.maximum(between_m, 1e-9)
        cos_point = np.einsum("pqi,pi->pq", away, normal) / safe_m
        cos_patch = -np.einsum("pqi,qi->pq", away, self._normal) / safe_m
        facing = np.maximum(cos_point, 0.0) * np.maximum(cos_patch, 0.0)
        light = self._power * facing / (between_m**2 + self._disc_m2)
        if self._shadows:
            pairs = np.nonzero(light > 0)
            clear = visible(self._scene, point_m[pairs[0]], self._point_m[pairs[1]])
            light[pairs] *= clear
        path_m = between_m + self._distance_m + np.linalg.norm(point_m, axis=-1)[:, None]
        phase = self._tones.phases(0.5 * path_m)
        sums = [light.sum(axis=1, keepdims=True)]
        sums += [np.einsum("pq,pqt->pt", light, wave(phase)) for wave in (np.cos, np.sin)]
        return np.concatenate(sums, axis=-1)
