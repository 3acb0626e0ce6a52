"""The response of an edge: a Gaussian seen by a square pixel, and a spline that corrects it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge.kernels import (
    edge_slopes,
    spline_integrals,
    spline_products,
    spline_values,
    tail_slopes,
    trapezium_edge,
    trapezium_tail,
)

_SQRT2 = math.sqrt(2.0)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_SMALLEST_SIDE = 0.01  # of the aperture: below it, a trapezium counts as a box
_SMALLEST_HALF_PX = 0.02  # of a side, to a tail: below it, differences lose their digits
_POINT_PX = 1e-3  # an aperture below counts as a point
_FINE_UNITS, _MIDDLE_UNITS = 6.0, 16.0  # of the splines: beyond, their steps double


class Tail(NamedTuple):
    """Light far from the edge: part Lorentzian, part Laplacian.

        R(x) = k w / (pi (x^2 + w^2)) + (1 - k) exp(-|x| / w) / 2 w

    Diffraction and rough surfaces fall as slowly as the first, light scattered in glass and
    between pixels as fast as the second; k below 0 falls faster still.

    Parameters
    ----------
    share : of all light; negative for sharpening
    width_px : w
    slow : k
    """

    share: float | Vector
    width_px: float | Vector
    slow: float | Vector


NO_TAIL = Tail(0.0, 1.0, 1.0)


def edge_response(
    normal_px: Vector,
    angle_rad: float,
    sigma_px: float,
    aperture_px: float,
    tail: Tail = NO_TAIL,
) -> Vector:
    """Return the share of a pixel's light that comes from the bright side of a straight edge.

    A step, blurred by a Gaussian, seen by a square pixel whose axes are turned by `angle_rad`
    against the edge: the second antiderivative G of the normal distribution at the four corners,

        E(d) = (G(d+p+q) - G(d+p-q) - G(d-p+q) + G(d-p-q)) / (4 p q)

    with p, q = a/2 |cos t|, a/2 |sin t|. A share of the light may be blurred by a tail instead.

    Parameters
    ----------
    normal_px : [n] signed distance from the edge, positive on the bright side
    angle_rad : angle between the edge and the columns (or rows)
    sigma_px : standard deviation of the Gaussian
    aperture_px : side of the square pixel; 0 for a point
    tail : light far from the edge
    """
    core = edge_core(normal_px, angle_rad, sigma_px, aperture_px)
    if tail.share == 0.0:
        return core
    far = edge_tail(normal_px, angle_rad, aperture_px, float(tail.width_px), float(tail.slow))
    return np.asarray((1.0 - tail.share) * core + tail.share * far)


def edge_core(normal_px: Vector, angle_rad: float, sigma_px: float, aperture_px: float) -> Vector:
    """Return the response of an edge without a tail; see `edge_response`."""
    if aperture_px <= _POINT_PX:
        return np.asarray(ndtr(normal_px / sigma_px))
    core = np.empty(normal_px.shape)
    sides = _half_sides(angle_rad, aperture_px)
    trapezium_edge(np.ascontiguousarray(normal_px), *sides, sigma_px, core)
    return core


def edge_tail(
    normal_px: Vector, angle_rad: float, aperture_px: float, width_px: float, slow: float
) -> Vector:
    """Return the response of an edge that is blurred by a tail alone; see `edge_response`."""
    p = max(0.5 * aperture_px * abs(math.cos(angle_rad)), _SMALLEST_HALF_PX)
    q = max(0.5 * aperture_px * abs(math.sin(angle_rad)), _SMALLEST_HALF_PX)
    far = np.empty(normal_px.shape)
    trapezium_tail(np.ascontiguousarray(normal_px), p, q, width_px, slow, far)
    return far


def core_slopes(normal_px: Vector, angle_rad: float, sigma_px: float, aperture_px: float) -> Matrix:
    """Return [4 n]: `edge_core`; its slopes by log sigma, log aperture and the distance."""
    out = np.zeros((4, normal_px.size))
    if aperture_px <= _POINT_PX:
        place = normal_px / sigma_px
        out[0], out[3] = (
            ndtr(place),
            np.exp(-0.5 * place**2) / (math.sqrt(2.0 * math.pi) * sigma_px),
        )
        out[1] = -normal_px * out[3]
        return out
    edge_slopes(normal_px, *_half_sides(angle_rad, aperture_px), sigma_px, out)
    return out


def far_slopes(
    normal_px: Vector, angle_rad: float, aperture_px: float, width_px: float
) -> NDArray[np.float64]:
    """Return [2 4 n]: the response of `edge_tail` of either law alone, and its slopes.

    The slopes are by log width, log aperture and the distance.
    """
    sides = 0.5 * aperture_px * np.abs([math.cos(angle_rad), math.sin(angle_rad)])
    p, q = np.maximum(sides, _SMALLEST_HALF_PX).tolist()
    grows = tuple((sides > _SMALLEST_HALF_PX).astype(float).tolist())
    out = np.empty((2, 4, normal_px.size))
    tail_slopes(normal_px, p, q, grows, width_px, out)
    return out


def _half_sides(angle_rad: float, aperture_px: float) -> tuple[float, float]:
    p = 0.5 * aperture_px * abs(math.cos(angle_rad))
    return p, max(0.5 * aperture_px * abs(math.sin(angle_rad)), _SMALLEST_SIDE * aperture_px)


def edge_response_transform(
    frequency_cpp: Vector,
    angle_rad: float,
    sigma_px: float,
    aperture_px: float,
    tail: Tail = NO_TAIL,
) -> Vector:
    """Return the Fourier transform of the derivative of `edge_response`, 1 at frequency 0.

        T(f) = [(1 - v) exp(-2 pi^2 s^2 f^2) + v R(f)] sinc(a f cos t) sinc(a f sin t)
        R(f) = k exp(-2 pi w |f|) + (1 - k) / (1 + (2 pi w f)^2)

    Parameters
    ----------
    frequency_cpp : [n] cycles per pixel along the edge normal
    angle_rad, sigma_px, aperture_px, tail : as in `edge_response`
    """
    optics = (1.0 - tail.share) * np.exp(-2.0 * (np.pi * sigma_px * frequency_cpp) ** 2)
    turn = 2.0 * np.pi * tail.width_px * np.abs(frequency_cpp)
    optics += tail.share * (tail.slow * np.exp(-turn) + (1.0 - tail.slow) / (1.0 + turn**2))
    side = aperture_px * frequency_cpp
    transform: Vector = (
        optics * np.sinc(side * np.cos(angle_rad)) * np.sinc(side * np.sin(angle_rad))
    )
    return transform


@dataclass(frozen=True, slots=True, eq=False)
class SplineProducts:
    """Sums over pixels of products of the integrated splines z, level columns x and values y.

    Parameters
    ----------
    zz, zx, zy : [j j], [j p], [j]
    """

    zz: Matrix
    zx: Matrix
    zy: Vector


@dataclass(frozen=True, slots=True, eq=False)
class SplineBasis:
    """Cubic B-splines of the LSF, and their integrals, which correct the ESF.

    Wide splines far from the edge are sums of narrow ones, so that all pixels see narrow ones on
    an even grid. Two that stand opposite each other are taken as (right + left) / sqrt(2) and
    (right - left) / sqrt(2): first all even functions, the middle before, then all odd ones.

    Parameters
    ----------
    step_px : distance between the narrow splines
    number : [h+1] centres of the splines on one side, in steps from the middle, 0 first
    narrow_px : [i] centres of the narrow ones
    parts : [i 2h+1] of which narrow ones an even or odd function is made
    """

    step_px: float
    number: NDArray[np.intp]
    narrow_px: Vector
    parts: sparse.csr_array

    @classmethod
    def covering(cls, half_width_px: float, step_px: float, unit_px: float) -> SplineBasis:
        """Return splines over -`half_width_px` to `half_width_px`; see `_spread`.

        Parameters
        ----------
        half_width_px : where the last spline stands
        step_px : between the splines near the edge
        unit_px : width of the edge, which says how far near reaches
        """
        limits = [
            4 * round(units * unit_px / step_px / 4) for units in (_FINE_UNITS, _MIDDLE_UNITS)
        ]
        number, narrow, parts = _spread(4 * round(half_width_px / step_px / 4), tuple(limits))
        return cls(step_px, number, np.asarray(narrow * step_px, dtype=np.float64), parts)

    @property
    def size(self) -> int:
        """Number of even and odd functions."""
        return 2 * self.number.size - 1

    @property
    def area_px(self) -> Vector:
        """Integrals of the whole splines [j]."""
        return np.asarray(self.parts.sum(axis=0) * self.step_px, dtype=np.float64)

    @property
    def reach_px(self) -> float:
        """Distance from which on every integrated spline is constant."""
        return float(self.narrow_px[-1] + 2.0 * self.step_px)

    def integrals(self, normal_px: Vector) -> Matrix:
        """Return [n j]: the integral of spline j from minus infinity to each distance."""
        narrow = np.empty((normal_px.size, self.narrow_px.size))
        spline_integrals(self._knots(normal_px), narrow)
        return np.asarray((narrow @ self.parts) * self.step_px)

    def products(self, normal_px: Vector, columns: Matrix, values: Vector) -> SplineProducts:
        """Return the cross products of `integrals` with themselves, with columns and values."""
        knots, levels = self.narrow_px.size, columns.shape[1]
        zz, zx, zy = np.zeros((knots, knots)), np.zeros((knots, levels)), np.zeros(knots)
        spline_products(self._knots(normal_px), columns, values, zz, zx, zy)
        over = self.parts.T.tocsr()
        zz = np.ascontiguousarray((over @ (over @ zz).T).T)
        return SplineProducts(
            self.step_px**2 * zz, self.step_px * (over @ zx), self.step_px * (over @ zy)
        )

    def values(self, normal_px: Vector) -> Matrix:
        """Return [n j]: the splines themselves."""
        narrow = np.zeros((normal_px.size, self.narrow_px.size))
        spline_values(self._knots(normal_px), narrow)
        return np.asarray(narrow @ self.parts)

    def transforms(self, frequency_cpp: Vector) -> tuple[Matrix, Matrix]:
        """Return the Fourier transforms of even functions [f h+1], and of odd ones over i [f h]."""
        middle = self.narrow_px.size // 2
        right = 2.0 * self.parts[middle:]
        turn = 2.0 * np.pi * np.outer(frequency_cpp, self.narrow_px[middle:])
        shape = self.step_px * np.sinc(frequency_cpp * self.step_px)[:, None] ** 4
        even, odd = shape * np.cos(turn), -shape * np.sin(turn)
        even[:, 0] *= 0.5  # the middle has no mirror image
        evens = self.number.size
        return np.asarray(even @ right[:, :evens]), np.asarray(odd @ right[:, evens:])

    def _knots(self, normal_px: Vector) -> Vector:
        """Return distances [n] from the first narrow spline, in steps."""
        return np.asarray((normal_px - self.narrow_px[0]) / self.step_px)


@lru_cache(maxsize=64)
def _spread(
    last: int, limits: tuple[int, int]
) -> tuple[NDArray[np.intp], NDArray[np.intp], sparse.csr_array]:
    """Return centres of splines and of narrow ones, in steps, and what makes up which [i j].

    Centres lie at every step up to the first limit, at every second up to the next, then at
    every fourth. Between wider centres the narrow coefficients are those of the same spline,

        c_i = (c_(i-s) + 6 c_i + c_(i+s)) / 8,  or  (c_(i-s/2) + c_(i+s/2)) / 2  where none stands

    so that even coefficients everywhere are an even function.

    Source: refinement of B-splines, Lane and Riesenfeld, IEEE PAMI 2 (1980) 35.
    """
    margin = 8
    narrow = np.arange(-last - margin, last + margin + 1)
    place = np.abs(narrow)
    kept = (place <= limits[0]) | ((place <= limits[1]) & (place % 2 == 0)) | (place % 4 == 0)
    kept &= place <= last
    rows = np.zeros((narrow.size, int(kept.sum())))
    rows[kept, np.arange(rows.shape[1])] = 1.0
    for step, limit in ((4, limits[1]), (2, limits[0])):
        finer = rows.copy()
        for i in range(4, narrow.size - 4):
            if place[i] <= limit:
                continue
            if place[i] % step == 0:
                finer[i] = (rows[i - step] + 6.0 * rows[i] + rows[i + step]) / 8.0
            elif place[i] % step == step // 2:
                finer[i] = (rows[i - step // 2] + rows[i + step // 2]) / 2.0
        rows = finer
    middle = rows.shape[1] // 2
    right, left = rows[:, middle + 1 :], rows[:, :middle][:, ::-1]
    folded = np.hstack([rows[:, [middle]], (right + left) / _SQRT2, (right - left) / _SQRT2])
    return narrow[kept][middle:], narrow, sparse.csr_array(folded)
