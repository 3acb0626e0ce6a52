"""Where a sensor has to be for the least MTF of all spots of a lens to be largest."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lensshift.core.arrays import Floats, Mask
from lensshift.optics.focus import scan_focus, spot_means
from lensshift.optics.trace import RayBundle
from lensshift.optics.which import AZIMUTHS_RAD

# Half a step off costs a sharp image 1e-4 of its MTF, which falls with the blur by
# (pi / 2 away / depth)^2 / 2, depth = f-number / frequency.
_FINER = 24  # fine steps in a coarse one, half of which costs 0.06: less than to a side lobe
COARSE = _FINER * math.sqrt(32e-4) / math.pi  # step over depth
_MOST = 80  # coarse steps to either side: 35 depths, where nothing is left
# Of what a spot at its smallest would be from defocus: the paraxial focus of a lens with spherical
# aberration, towards which the focus of coarse patterns lies, is 2.8 away.
_BEYOND = 3.0
_OF_RAYS = ("position_mm", "direction", "path_mm", "status", "failed_at")


@dataclass(frozen=True, slots=True, eq=False)
class FocusScan:
    """Rays of builds of a lens, [build position field ray], and how they are looked at.

    Parameters
    ----------
    rays, weight, rings, inner : as of `scan_focus`
    frequency_lpmm, wavelength_nm : of the MTF
    coarse_mm : step of a first search: `COARSE` of f-number / frequency
    """

    rays: RayBundle
    weight: Floats
    rings: int
    frequency_lpmm: float
    wavelength_nm: float
    coarse_mm: float
    inner: float

    def part(self, chosen: Mask) -> FocusScan:
        """Return some of the builds."""
        rays = RayBundle(*(getattr(self.rays, name)[chosen] for name in _OF_RAYS))
        return replace(self, rays=rays)

    def at(self, away_mm: Floats) -> tuple[Floats, Floats]:
        """Return MTF [build position field azimuth] and centroids [... 2] with a moved sensor."""
        behind_mm = away_mm[:, None, None]
        _, centroid_mm, slope = spot_means(self.rays, self.weight)
        return self._scan(behind_mm, 0.0, 1)[..., 0], centroid_mm + behind_mm[..., None] * slope

    def sharpest_mm(self, most_mm: float) -> Floats:
        """Return where the least MTF over positions and fields [build ...] is largest, [build]."""
        first_mm, last_mm = self._sharp_between(most_mm)
        middle_mm = 0.5 * (first_mm + last_mm)
        coarse = np.ceil((last_mm - middle_mm) / self.coarse_mm).clip(0, _MOST)
        best_mm = middle_mm
        for step_mm, steps in (
            (self.coarse_mm, coarse), (self.coarse_mm / _FINER, np.full_like(coarse, _FINER))
        ):  # fmt: skip
            most = int(steps.max())
            from_mm = best_mm - step_mm * most
            mtf = self._scan(from_mm[:, None, None], step_mm, 1 + 2 * most)
            least = mtf.min(axis=(1, 2, 3))
            # What one build is moved does not depend on the others.
            least[np.abs(np.arange(-most, most + 1)) > steps[:, None]] = -1.0
            best_mm = from_mm + step_mm * least.argmax(axis=-1)
        return np.asarray(best_mm.clip(-most_mm, most_mm))

    def _sharp_between(self, most_mm: float) -> tuple[Floats, Floats]:
        """Return the first and last place [build] of the sensor where any spot may be sharp.

        A spot is smallest at -cov(x, u) / var(u) of its rays at x with the slopes u.
        """
        _, centroid_mm, mean = spot_means(self.rays, self.weight)
        alive = np.where(self.rays.passed, self.weight, 0.0)
        slope = self.rays.direction[..., :2] / self.rays.direction[..., 2:] - mean[..., None, :]
        from_centre_mm = self.rays.position_mm - centroid_mm[..., None, :]

        def sum_of(one: Floats, other: Floats) -> Floats:
            product_of = np.where(self.rays.passed[..., None], one * other, 0.0)
            return np.asarray(np.einsum("...r,...ri->...", alive, product_of))

        spread = sum_of(slope, slope)
        spread[~(spread > 0.0)] = np.nan  # no light, or a single ray
        at_mm = -sum_of(from_centre_mm, slope) / spread
        left = np.maximum(sum_of(from_centre_mm, from_centre_mm) / spread - at_mm**2, 0.0)
        room_mm = _BEYOND * np.sqrt(left)
        limits = (
            np.fmin.reduce(at_mm - room_mm, axis=(1, 2)),
            np.fmax.reduce(at_mm + room_mm, axis=(1, 2)),
        )
        first_mm, last_mm = np.nan_to_num(limits).clip(-most_mm, most_mm)
        return first_mm, last_mm

    def _scan(self, first_mm: Floats, step_mm: float, planes: int) -> Floats:
        return scan_focus(
            self.rays, self.weight, self.rings, self.frequency_lpmm, AZIMUTHS_RAD,
            self.wavelength_nm, first_mm=first_mm, step_mm=step_mm, planes=planes, inner=self.inner,
        )  # fmt: skip
