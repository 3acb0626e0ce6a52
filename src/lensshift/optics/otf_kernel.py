"""The inner loops of the OTF: sums over rays for the fast one, over the pupil for the exact one."""

from __future__ import annotations

import numpy as np
from numba import njit

from lensshift.core.arrays import Array


@njit(cache=True, nogil=True, error_model="numpy")
def overlap_square(shear: float, along: float) -> float:
    """Return the squared radius at which two unit discs cease to overlap along an arm.

    Parameters
    ----------
    shear : distance of the disc centres from the middle, 0 .. 1
    along : |cosine| of the angle between the arm and the line of the centres
    """
    root = 1.0 - shear * shear * (1.0 - along * along)
    return float(max(np.sqrt(root) - shear * along, 0.0) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def diffraction(v: float) -> float:
    """Return the MTF of a perfect lens at `v` times its cutoff, 0 <= v <= 1."""
    return float(2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


@njit(cache=True, nogil=True, error_model="numpy")
def _angle(cosine: float) -> float:
    """Return the angle of a cosine that rounding may put beyond 1."""
    return float(np.arccos(min(max(cosine, -1.0), 1.0)))


@njit(cache=True, nogil=True, error_model="numpy")
def annular(v: float, inner: float) -> float:
    """Return the MTF of a perfect lens whose pupil is a ring at `v` times its cutoff, 0 <= v <= 1.

        MTF = [A(1, 1) - 2 A(1, inner) + A(inner, inner)] / (pi (1 - inner^2))

    with A the common area of two circles, 2 v apart.

    Parameters
    ----------
    inner : radius of what is stopped in the middle, over that of the pupil

    Source: O'Neill, J. Opt. Soc. Am. 46 (1956) 285.
    """
    if inner == 0.0:
        return diffraction(v)
    apart = min(max(2.0 * v, 1.0 - inner), 1.0 + inner)  # nearer, one circle lies in the other
    wide = _angle((apart * apart + 1.0 - inner * inner) / (2.0 * apart))
    narrow = _angle((apart * apart + inner * inner - 1.0) / (2.0 * apart * inner))
    crossed = wide - 0.5 * np.sin(2.0 * wide)
    crossed += inner * inner * (narrow - 0.5 * np.sin(2.0 * narrow))
    own = diffraction(v) + inner * inner * diffraction(min(v / inner, 1.0))
    return float((own - 2.0 / np.pi * crossed) / (1.0 - inner * inner))


@njit(cache=True, nogil=True, error_model="numpy")
def hidden_squares(shear: float, along: float, inner: float) -> tuple[float, float]:
    """Return the squared radii between which an arm is dark in one of two sheared rings.

    Parameters
    ----------
    shear, along : as for `overlap_square`
    inner : radius of the dark middle of the discs
    """
    square = inner * inner - shear * shear * (1.0 - along * along)
    if square <= 0.0:
        return 0.0, 0.0
    root = np.sqrt(square)
    return max(shear * along - root, 0.0) ** 2, (shear * along + root) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def share_of(first: float, last: float, square: float, dark: tuple[float, float]) -> float:
    """Return the share of squared radii from `first` to `last` that is below `square` and light."""
    end = min(last, square)
    lit = end - first - max(min(end, dark[1]) - max(first, dark[0]), 0.0)
    return float(lit / (last - first))


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_rays(
    landing: Array, weight: Array, along: Array, edges: Array, inner: float, v: float, turn: float
) -> complex:
    """Return the OTF of one spot, azimuth and frequency."""
    rings, arms = edges.size - 1, along.size
    real, imaginary, total = 0.0, 0.0, 0.0
    for j in range(arms):
        square = overlap_square(v, along[j])
        dark = hidden_squares(v, along[j], inner)
        for k in range(rings):
            share = share_of(edges[k], edges[k + 1], square, dark)
            if share <= 0.0:
                continue
            r = k * arms + j
            part = share * weight[r]
            real += part * np.cos(turn * landing[r])
            imaginary += part * np.sin(turn * landing[r])
            total += part
    scale = annular(v, inner) / total if total > 0.0 else 0.0
    return complex(scale * real, scale * imaginary)


@njit(cache=True, nogil=True, error_model="numpy")
def spot_otf(
    landing: Array, weight: Array, along: Array, edges: Array, inner: float, shear: Array,
    frequency: Array, out: Array,
) -> None:  # fmt: skip
    """Write D sum w m exp(-2 pi i f e) / sum w m over the rays of each spot.

    m is the share of the ray's part of the pupil that stays in the overlap with the pupil
    sheared by f, and D the MTF of a perfect lens.

    Parameters
    ----------
    landing : [spot azimuth ray] e, in mm; rays ring by ring, as `pupil_quadrature` has them
    weight : [spot ray]
    along : [azimuth arm] |cosine| of the angle between arm and azimuth
    edges : [ring + 1] squared radii of the annuli that the rings stand for
    inner : radius of the dark middle of the pupil, 0 .. 1
    shear : [spot azimuth] 1 / cutoff, in mm
    frequency : [frequency] f, in line pairs per mm
    out : [spot azimuth frequency], complex
    """
    for s in range(out.shape[0]):
        for a in range(out.shape[1]):
            for f in range(out.shape[2]):
                turns = frequency[f]
                v = min(shear[s, a] * abs(turns), 1.0)
                out[s, a, f] = _sum_rays(
                    landing[s, a], weight[s], along[a], edges, inner, v, -2.0 * np.pi * turns
                )


@njit(cache=True, nogil=True, error_model="numpy")
def _soft_edge(square: float, step: float) -> float:
    """Return 1 inside the unit circle, 0 outside, over one step in between."""
    return float(min(max((1.0 - square) / (2.0 * step) + 0.5, 0.0), 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _aperture(quantities: Array, r: int, c: int, step: float) -> float:
    """Return how much of the light at a point of the pupil passes, 0 .. 1."""
    row, col = quantities[5, r, c], quantities[6, r, c]
    aperture = _soft_edge(row * row + col * col, step)
    for q in range(7, quantities.shape[0]):
        aperture = min(aperture, _soft_edge(quantities[q, r, c], step))
    return aperture


@njit(cache=True, nogil=True, error_model="numpy")
def _area(quantities: Array, r: int, c: int) -> float:
    """Return the area of the stop per area of direction cosines."""
    turned = quantities[2, r, c] * quantities[3, r, c]
    return float(abs(quantities[1, r, c] * quantities[4, r, c] - turned))


@njit(cache=True, nogil=True, error_model="numpy")
def overlap_sum(ahead: Array, behind: Array, step: float, wave: float) -> complex:
    """Return sum A_1 A_2 exp(i wave (W_1 - W_2)) over two pupils sheared against each other.

    Parameters
    ----------
    ahead, behind : [quantity row col] path W, derivatives of the two stop coordinates (row by
        row, row by col, col by row, col by col), the coordinates, squared relative heights
    step : from point to point, over which an edge of the pupil is soft
    wave : 2 pi / wavelength
    """
    real, imaginary = 0.0, 0.0
    for r in range(ahead.shape[1]):
        for c in range(ahead.shape[2]):
            both = _aperture(ahead, r, c, step)
            if both > 0.0:
                both = min(both, _aperture(behind, r, c, step))
            if both > 0.0:
                both *= np.sqrt(_area(ahead, r, c) * _area(behind, r, c))
                phase = wave * (ahead[0, r, c] - behind[0, r, c])
                real += both * np.cos(phase)
                imaginary += both * np.sin(phase)
    return complex(real, imaginary)


@njit(cache=True, nogil=True, error_model="numpy")
def pupil_wave(quantities: Array, step: float, wave: float, out: Array) -> float:
    """Write A exp(i wave W) at points of the pupil, and return the sum of A^2.

    At the edge A is the mean over the part around a point.

    Parameters
    ----------
    quantities, step, wave : as for `overlap_sum`
    out : [row col], complex
    """
    energy = 0.0
    for r in range(quantities.shape[1]):
        for c in range(quantities.shape[2]):
            passed = _aperture(quantities, r, c, step)
            area = _area(quantities, r, c) if passed > 0.0 else 0.0
            phase = wave * quantities[0, r, c]
            size = passed * np.sqrt(area)
            out[r, c] = complex(size * np.cos(phase), size * np.sin(phase))
            energy += passed * area
    return energy
