"""The inner loop of a focus scan: the rays turn by the same phase from plane to plane."""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array
from lensshift.optics.otf_kernel import annular, hidden_squares, overlap_square, share_of


@njit(cache=True, nogil=True, error_model="numpy")
def _pupil_width(direction: Array, status: Array, weight: Array, row: float, col: float) -> float:
    """Return four standard deviations of the direction cosines along an azimuth."""
    total, mean, square = 0.0, 0.0, 0.0
    for r in range(status.size):
        if status[r] == 0:
            cosine = row * direction[r, 0] + col * direction[r, 1]
            total += weight[r]
            mean += weight[r] * cosine
            square += weight[r] * cosine * cosine
    mean /= total
    return float(4.0 * np.sqrt(max(square / total - mean * mean, 0.0)))


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _sum_planes(x: Array, y: Array, c: Array, d: Array, scale: float, out: Array) -> None:
    """Write |sum (x + i y)| for each plane, turning by (c + i d) from one to the next."""
    for p in range(out.size):
        real, imaginary = 0.0, 0.0
        for r in range(x.size):
            real += x[r]
            imaginary += y[r]
            x[r], y[r] = c[r] * x[r] - d[r] * y[r], d[r] * x[r] + c[r] * y[r]
        out[p] = scale * np.sqrt(real * real + imaginary * imaginary)


@njit(cache=True, nogil=True, error_model="numpy")
def focus_mtf(
    position: Array, direction: Array, status: Array, weight: Array, axes: Array, along: Array,
    edges: Array, inner: float, turns: float, wavelength_mm: float, first: Array, step: float,
    out: Array,
) -> None:  # fmt: skip
    """Write the fast MTF of spots in evenly spaced planes, 0 for dark spots.

    Parameters
    ----------
    position, direction : [spot ray 2] in mm and [spot ray 3], ring by ring
    status, weight : [spot ray] 0 for rays that arrive, and [ray] that sums to 1
    axes : [azimuth 2] (row, col) directions in which the pattern repeats
    along : [azimuth arm] |cosine| of the angle between arm and azimuth
    edges : [ring + 1] squared radii of the annuli that the rings stand for
    inner : radius of the dark middle of the pupil, 0 .. 1
    turns : line pairs per mm
    wavelength_mm : of the light
    first : [spot] the first plane, step : from plane to plane, in mm behind the sensor
    out : [spot azimuth plane]
    """
    rings, arms = edges.size - 1, along.shape[1]
    x, y = np.empty(weight.size), np.empty(weight.size)
    c, d = np.empty(weight.size), np.empty(weight.size)
    omega = 2.0 * np.pi * turns
    middle = inner * inner * (1.0 + 1e-9)
    for s in range(out.shape[0]):
        for a in range(out.shape[1]):
            row, col = axes[a, 0], axes[a, 1]
            width = _pupil_width(direction[s], status[s], weight, row, col)
            width /= np.sqrt(1.0 + inner * inner)
            v = min(turns * wavelength_mm / width, 1.0)
            total, used = 0.0, 0
            for j in range(arms):
                square = overlap_square(v, along[a, j])
                dark = hidden_squares(v, along[a, j], inner)
                for k in range(rings):
                    share = share_of(edges[k], edges[k + 1], square, dark)
                    r = k * arms + j
                    hidden = status[s, r] == 3 and edges[k + 1] <= middle  # lit when sheared
                    if share <= 0.0 or (status[s, r] != 0 and not hidden):
                        continue
                    part = share * weight[r]
                    slope = row * direction[s, r, 0] + col * direction[s, r, 1]
                    slope /= direction[s, r, 2]
                    at = row * position[s, r, 0] + col * position[s, r, 1] + first[s] * slope
                    x[used] = part * np.cos(omega * at)
                    y[used] = part * np.sin(omega * at)
                    c[used] = np.cos(omega * step * slope)
                    d[used] = np.sin(omega * step * slope)
                    total += part
                    used += 1
            scale = annular(v, inner) / total if total > 0.0 else 0.0
            _sum_planes(x[:used], y[:used], c[:used], d[:used], scale, out[s, a])
