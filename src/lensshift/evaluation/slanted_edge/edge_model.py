"""The response of an edge: a Gaussian seen by a square pixel, and a spline that corrects it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge.kernels import edge_slopes, tail_slopes

_SQRT2 = math.sqrt(2.0)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Numbers = NDArray[np.intp]

_SMALLEST_SIDE = 0.01  # of the aperture: below it, a trapezium counts as a box
_SMALLEST_HALF_PX = 0.02  # of a side, to a tail: below it, differences lose their digits
_POINT_PX = 1e-3  # an aperture below counts as a point
_FINE_UNITS, _MIDDLE_UNITS = 6.0, 16.0  # of the splines: beyond, their steps double


class Tail(NamedTuple):
    """Light far from the edge: part Lorentzian, part Laplacian.

        R(x) = k w / (pi (x^2 + w^2)) + (1 - k) exp(-|x| / w) / 2 w

    Diffraction and rough surfaces fall as slowly as the first, light scattered in glass and
    between pixels as fast as the second; k below 0 falls faster still.
    """

    share: float | Vector  # of all light; negative for sharpening
    width_px: float | Vector  # w
    slow: float | Vector  # k

    @property
    def shares(self) -> Vector:
        """Shares of the Gaussian, the Lorentzian and the Laplacian in all light."""
        slow = self.share * self.slow
        return np.array([1.0 - self.share, slow, self.share - slow])


def core_slopes(
    normal_px: Vector, angle_rad: float, sigma_px: float, aperture_px: float,
    out: Matrix | None = None,
) -> Matrix:  # fmt: skip
    """Return [4 n]: a straight edge blurred by a Gaussian, as a square pixel sees it; its slopes.

    The pixel's axes are turned by `angle_rad` against the edge. The second antiderivative G of the
    normal distribution at its four corners tells the share of its light from the bright side,

        E(d) = (G(d+p+q) - G(d+p-q) - G(d-p+q) + G(d-p-q)) / (4 p q)

    with p, q = a/2 |cos t|, a/2 |sin t|, a the side of the pixel, 0 for a point. The slopes are by
    log sigma, log aperture and distance.
    """
    out = np.empty((4, normal_px.size)) if out is None else out
    if aperture_px <= _POINT_PX:
        place = normal_px / sigma_px
        out[0], out[2] = ndtr(place), 0.0
        out[3] = np.exp(-0.5 * place**2) / (math.sqrt(2.0 * math.pi) * sigma_px)
        out[1] = -normal_px * out[3]
        return out
    p, q = _half_sides(angle_rad, aperture_px)
    edge_slopes(normal_px, p, max(q, _SMALLEST_SIDE * aperture_px), sigma_px, out)
    return out


def edge_parts(
    normal_px: Vector, angle_rad: float, sigma_px: float, aperture_px: float, width_px: float
) -> NDArray[np.float64]:
    """Return [3 4 n]: `core_slopes` of a Gaussian, a Lorentzian, a Laplacian alone."""
    p, q = _half_sides(angle_rad, aperture_px)
    grows = float(p > _SMALLEST_HALF_PX), float(q > _SMALLEST_HALF_PX)
    p, q = max(p, _SMALLEST_HALF_PX), max(q, _SMALLEST_HALF_PX)
    out = np.empty((3, 4, normal_px.size))
    core_slopes(normal_px, angle_rad, sigma_px, aperture_px, out[0])
    tail_slopes(normal_px, p, q, grows, width_px, out[1:])
    return out


def _half_sides(angle_rad: float, aperture_px: float) -> tuple[float, float]:
    half_px = 0.5 * aperture_px
    return half_px * abs(math.cos(angle_rad)), half_px * abs(math.sin(angle_rad))


def edge_response_transform(
    frequency_cpp: Vector, angle_rad: float, sigma_px: float | Vector, aperture_px: float | Vector,
    tail: Tail,
) -> Vector:  # fmt: skip
    """Return the Fourier transform of the line spread function of an edge, 1 at frequency 0.

    T(f) = [(1 - v) exp(-2 pi^2 s^2 f^2) + v R(f)] sinc(a f cos t) sinc(a f sin t)
    R(f) = k exp(-2 pi w |f|) + (1 - k) / (1 + (2 pi w f)^2)
    """
    optics = (1.0 - tail.share) * np.exp(-2.0 * (np.pi * sigma_px * frequency_cpp) ** 2)
    turn = 2.0 * np.pi * tail.width_px * np.abs(frequency_cpp)
    optics += tail.share * (tail.slow * np.exp(-turn) + (1.0 - tail.slow) / (1.0 + turn**2))
    along, across = np.cos(angle_rad) * aperture_px, np.sin(angle_rad) * aperture_px
    transform: Vector = optics * np.sinc(along * frequency_cpp) * np.sinc(across * frequency_cpp)
    return transform


@dataclass(frozen=True, slots=True, eq=False)
class SplineBasis:
    """Cubic B-splines of the LSF, and their integrals, which correct the ESF.

    Wide splines far from the edge are sums of narrow ones, so that all pixels see narrow ones on
    an even grid. Two that stand opposite each other are taken as (right + left) / sqrt(2) and
    (right - left) / sqrt(2): first all even functions, the middle before, then all odd ones.
    """

    step_px: float  # distance between the narrow splines
    # [h+1] centres of the splines on one side, in steps from the middle, 0 first
    number: Numbers
    narrow_px: Vector  # [i] centres of the narrow ones
    parts: Matrix  # [i 2h+1] of which narrow ones an even or odd function is made

    @classmethod
    def covering(cls, half_width_px: float, step_px: float, unit_px: float) -> SplineBasis:
        """Return splines on both sides of 0, `step_px` apart for a few `unit_px`; see `_spread`."""
        reaches_px = half_width_px, _FINE_UNITS * unit_px, _MIDDLE_UNITS * unit_px
        last, *limits = (4 * round(reach_px / step_px / 4) for reach_px in reaches_px)
        number, narrow, parts = _spread(last, (limits[0], limits[1]))
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
        rows, sums = self.rising(normal_px)
        return np.asarray(rows @ sums[:, 1:])

    def rising(self, normal_px: Vector) -> tuple[sparse.csr_array, Matrix]:
        """Return [n m], of which few are not 0, and [m 1+j]: factors of 1 and `integrals`.

        The integrals of two neighbours differ by a spline of the next degree, and all these splines
        add up to 1.
        """
        sums = np.cumsum(np.pad(self.parts, ((4, 3), (0, 0))), axis=0) * self.step_px
        return self._narrow(normal_px, 4), np.hstack([np.ones((len(sums), 1)), sums])

    def values(self, normal_px: Vector) -> Matrix:
        """Return [n j]: the splines themselves."""
        return np.asarray(self._narrow(normal_px, 3) @ np.pad(self.parts, ((3, 3), (0, 0))))

    def _narrow(self, normal_px: Vector, degree: int) -> sparse.csr_array:
        """Return [n m]: splines of a degree on the narrow knots, some more at either end."""
        last = self.narrow_px.size + 1.0
        place = np.clip((normal_px - self.narrow_px[0]) / self.step_px, -2.0, last)
        knots = np.arange(-2.0 - degree, last + degree + 1.0)
        return BSpline.design_matrix(place, knots, degree)

    def transforms(self, frequency_cpp: Vector) -> tuple[Matrix, Matrix]:
        """Return the Fourier transforms of even functions [f h+1], and of odd ones over i [f h]."""
        middle = self.narrow_px.size // 2
        right, evens = 2.0 * self.parts[middle:], self.number.size
        right[0] *= 0.5  # the middle has no mirror image
        turn = 2.0 * np.pi * np.outer(frequency_cpp, self.narrow_px[middle:])
        shape = self.step_px * np.sinc(frequency_cpp * self.step_px)[:, None] ** 4
        even, odd = shape * np.cos(turn), -shape * np.sin(turn)
        return even @ right[:, :evens], odd @ right[:, evens:]


@lru_cache(maxsize=64)
def _spread(last: int, limits: tuple[int, int]) -> tuple[Numbers, Numbers, Matrix]:
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
    return narrow[kept][middle:], narrow, folded


class BaseModel(NamedTuple):
    """A Gaussian with a tail, seen by a square pixel.

    Its parameters are log sigma, the root r of the pixel's shrinkage (its side is exp(-r^2) of the
    aperture, the side of the largest pixel), the root v of the tail's share v |v|, log width and
    speed of the tail, and the place of it all; lengths in units of `unit_px`, the edge's width.
    """

    angle_rad: float
    aperture_px: float
    unit_px: float

    def seen(self, normal_px: Vector, parameters: Vector) -> SeenBase:
        """Return what distances [n] see of the model."""
        log_sigma, root, root_share, log_tail, slow, place = parameters[:6].tolist()
        tail = Tail(root_share * abs(root_share), math.exp(log_tail) * self.unit_px, slow)
        sigma_px, side_px = math.exp(log_sigma) * self.unit_px, math.exp(-(root**2))
        there = normal_px - place * self.unit_px
        widths_px = sigma_px, side_px * self.aperture_px, float(tail.width_px)
        return SeenBase(edge_parts(there, self.angle_rad, *widths_px), tail)

    def response(self, normal_px: Vector, parameters: Vector) -> Vector:
        """Return the ESF at distances [n]."""
        return self.seen(normal_px, parameters).response

    def slopes(self, seen: SeenBase, parameters: Vector) -> Matrix:
        """Return [6 n]: how the ESF changes with the parameters."""
        parts, tail, shares = seen.parts, seen.tail, seen.tail.shares
        core, slow, fast = parts
        slopes = np.empty((6, parts.shape[2]))
        slopes[0] = shares[0] * core[1]
        slopes[1] = -2.0 * parameters[1] * (shares @ parts[:, 2])
        far = fast[0] + tail.slow * (slow[0] - fast[0])
        slopes[2] = 2.0 * abs(parameters[2]) * (far - core[0])
        slopes[3] = shares[1:] @ parts[1:, 1]
        slopes[4] = tail.share * (slow[0] - fast[0])
        slopes[5] = -self.unit_px * (shares @ parts[:, 3])
        return slopes

    def transforms(self, frequency_cpp: Vector, parameters: Matrix) -> NDArray[np.complex128]:
        """Return the Fourier transforms of the LSFs [f k] of several parameters [p k]."""
        log_sigma, root, root_share, log_tail, slow, place = parameters[:6]
        tail = Tail(root_share * np.abs(root_share), np.exp(log_tail) * self.unit_px, slow)
        f, sigma_px = frequency_cpp[:, None], np.exp(log_sigma) * self.unit_px
        side_px = np.exp(-(root**2)) * self.aperture_px
        there = edge_response_transform(f, self.angle_rad, sigma_px, side_px, tail)
        return np.asarray(there * np.exp(-2j * np.pi * self.unit_px * place * f))


class SeenBase(NamedTuple):
    """`edge_parts` [3 4 n] of the base model, and its tail."""

    parts: NDArray[np.float64]
    tail: Tail

    @property
    def response(self) -> Vector:
        """The ESF [n]."""
        return np.asarray(self.tail.shares @ self.parts[:, 0])
