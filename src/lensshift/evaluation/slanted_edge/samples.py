"""The pixels of a region as samples of an edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector

# Prior standard deviation of the bending terms, as a share of the half length of the edge.
_BENDING_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class EdgeSamples:
    """Pixels of one or several frames, in units of the contrast, the bright side at positive x."""

    across_px: Vector  # [n] coordinates of the pixels, from the edge's middle
    along_px: Vector
    half_length_px: float  # half the length of the edge along `along_px`
    light: int  # order of the uneven illumination: 0 even, 1 a plane, 2 a bowl
    values: Vector  # [n] the pixels
    whitener: sparse.csr_array | None  # [m n] what makes their noise white, None for nothing
    unlike: float = 1.0  # share of the pixels that tell something of their own, see `Rounding`

    def normal_px(self, geometry: Vector) -> Vector:
        """Return the signed distance of each pixel from the edge."""
        return distance_px(self.across_px, self.along_px, geometry, self.half_length_px)

    def turn_px(self, angle_rad: float) -> Vector:
        """Return the slope of that distance by the angle of the edge."""
        return np.asarray(self.along_px * np.cos(angle_rad) - self.across_px * np.sin(angle_rad))

    def powers(self, highest: int) -> Matrix:
        """Return [n k]: Legendre polynomials 0 to `highest` of the place along the edge."""
        place = self.along_px / self.half_length_px
        return np.asarray(np.polynomial.legendre.legvander(place, highest))

    @property
    def bend_spread_px(self) -> float:
        """Prior standard deviation of the bending terms."""
        return _BENDING_SHARE * self.half_length_px


def distance_px(
    across_px: Vector, along_px: Vector, geometry: Vector, half_length_px: float
) -> Vector:
    """Return the signed distance from an edge of geometry t, rho, g_2, g_3, ...

        d = x cos t + y sin t - rho - sum_k g_k P_k(y / half length)

    with Legendre polynomials P_k.
    """
    normal_px: Vector = across_px * np.cos(geometry[0]) + along_px * np.sin(geometry[0])
    normal_px -= geometry[1]
    if geometry.size > 2:
        bending = np.concatenate([[0.0, 0.0], geometry[2:]])
        normal_px -= np.polynomial.legendre.legval(along_px / half_length_px, bending)
    return normal_px
