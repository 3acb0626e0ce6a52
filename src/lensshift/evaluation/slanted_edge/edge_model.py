"""The response of an edge: a Gaussian seen by a square pixel, and a spline that corrects it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge.kernels import sensitivities, spline_products, trapezium_edge

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_TABLE_STEPS = 2000  # per knot; linear interpolation in it errs by less than 1e-7
_SMALLEST_SIDE = 0.01  # of the aperture: below it, a trapezium counts as a box


def edge_response(
    normal_px: Vector, angle_rad: float, sigma_px: float, aperture_px: float
) -> Vector:
    """Return the share of a pixel's light that comes from the bright side of a straight edge.

    A step, blurred by a Gaussian, seen by a square pixel whose axes are turned by `angle_rad`
    against the edge: the second antiderivative G of the normal distribution at the four corners,

        E(d) = (G(d+p+q) - G(d+p-q) - G(d-p+q) + G(d-p-q)) / (4 p q)

    with p, q = a/2 |cos t|, a/2 |sin t|.

    Parameters
    ----------
    normal_px : [n] signed distance from the edge, positive on the bright side
    angle_rad : angle between the edge and the columns (or rows)
    sigma_px : standard deviation of the Gaussian
    aperture_px : side of the square pixel; 0 for a point
    """
    if aperture_px <= 0.0:
        return np.asarray(ndtr(normal_px / sigma_px))
    p = 0.5 * aperture_px * abs(np.cos(angle_rad))
    q = max(0.5 * aperture_px * abs(np.sin(angle_rad)), _SMALLEST_SIDE * aperture_px)
    response = np.empty(normal_px.shape)
    trapezium_edge(np.ascontiguousarray(normal_px), p, q, sigma_px, response)
    return response


def edge_response_transform(
    frequency_cpp: Vector, angle_rad: float, sigma_px: float, aperture_px: float
) -> Vector:
    """Return the Fourier transform of the derivative of `edge_response`, 1 at frequency 0.

        T(f) = exp(-2 pi^2 s^2 f^2) sinc(a f cos t) sinc(a f sin t)

    Parameters
    ----------
    frequency_cpp : [n] cycles per pixel along the edge normal
    angle_rad, sigma_px, aperture_px : as in `edge_response`
    """
    optics = np.exp(-2.0 * (np.pi * sigma_px * frequency_cpp) ** 2)
    side = aperture_px * frequency_cpp
    transform: Vector = (
        optics * np.sinc(side * np.cos(angle_rad)) * np.sinc(side * np.sin(angle_rad))
    )
    return transform


def tail_response(normal_px: Vector, width_px: float, steepness: float) -> Vector:
    """Return the edge response of a tail, between a heavy one and an exponential one.

        E(d) = (1 - c) (1/2 + atan(d / w) / pi) + c (1 + sgn(d) (1 - exp(-|d| / w))) / 2

    The LSF of the first falls as w / (pi d^2), as that of diffraction does; light that is scattered
    mostly falls faster.

    Parameters
    ----------
    normal_px : [n] signed distance from the edge
    width_px, steepness : w and c, 0 to 1
    """
    heavy = 0.5 + np.arctan(normal_px / width_px) / np.pi
    light = 0.5 - 0.5 * np.sign(normal_px) * np.expm1(-np.abs(normal_px) / width_px)
    return np.asarray((1.0 - steepness) * heavy + steepness * light)


def tail_transform(frequency_cpp: Vector, width_px: float, steepness: float) -> Vector:
    """Return the Fourier transform of the derivative of `tail_response`."""
    turns = 2.0 * np.pi * width_px * np.abs(frequency_cpp)
    return np.asarray((1.0 - steepness) * np.exp(-turns) + steepness / (1.0 + turns**2))


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


@dataclass(frozen=True, slots=True)
class SplineBasis:
    """Cubic B-splines of the LSF, and their integrals, which correct the ESF.

    Parameters
    ----------
    step_px : distance between the knots
    knot_px : [j] centres of the splines
    """

    step_px: float
    knot_px: Vector

    @classmethod
    def covering(cls, half_width_px: float, step_px: float) -> SplineBasis:
        """Return splines with knots from -`half_width_px` to `half_width_px`."""
        count = round(half_width_px / step_px)
        return cls(step_px, np.asarray(np.arange(-count, count + 1) * step_px, dtype=np.float64))

    @property
    def reach_px(self) -> float:
        """Distance from which on every integrated spline is constant."""
        return float(self.knot_px[-1] + 2.0 * self.step_px)

    def integrals(self, normal_px: Vector) -> Matrix:
        """Return [n j]: the integral of spline j from minus infinity to each distance."""
        place = (normal_px[:, None] - self.knot_px) * (_TABLE_STEPS / self.step_px)
        place += 2.0 * _TABLE_STEPS
        np.clip(place, 0.0, 4.0 * _TABLE_STEPS - 1e-9, out=place)
        low = place.astype(np.intp)
        place -= low
        place *= _TABLE_RISE[low]
        place += _TABLE[low]
        return place * self.step_px

    def products(self, normal_px: Vector, columns: Matrix, values: Vector) -> SplineProducts:
        """Return the cross products of `integrals` with themselves, with columns and values."""
        knots, levels = self.knot_px.size, columns.shape[1]
        zz, zx, zy = np.zeros((knots, knots)), np.zeros((knots, levels)), np.zeros(knots)
        place = (normal_px - self.knot_px[0]) / self.step_px
        spline_products(place, columns, values, zz, zx, zy)
        return SplineProducts(self.step_px**2 * zz, self.step_px * zx, self.step_px * zy)

    def sensitivities(
        self, normal_px: Vector, columns: Matrix, values: Vector, quadratic: Matrix, linear: Vector
    ) -> tuple[Vector, Matrix]:
        """Return how the sum of D B D^T / 2 - y D g changes with distances [n] and columns [n p].

        Parameters
        ----------
        normal_px, columns, values : [n], [n p], [n]; D is [integrals, columns]
        quadratic, linear : B [j+p j+p], symmetric, and g [j+p]
        """
        knots = self.knot_px.size
        quadratic, linear = quadratic.copy(), linear.copy()
        np.cumsum(quadratic[:knots], axis=0, out=quadratic[:knots])
        np.cumsum(quadratic[:, :knots], axis=1, out=quadratic[:, :knots])
        np.cumsum(linear[:knots], out=linear[:knots])
        quadratic[:knots] *= self.step_px
        quadratic[:, :knots] *= self.step_px
        linear[:knots] *= self.step_px
        to_place, to_columns = np.empty(normal_px.size), np.empty(columns.shape)
        place = (normal_px - self.knot_px[0]) / self.step_px
        sensitivities(place, columns, values, quadratic, linear, to_place, to_columns)
        return to_place / self.step_px, to_columns

    def values(self, normal_px: Vector) -> Matrix:
        """Return [n j]: the splines themselves."""
        v = np.abs(normal_px[:, None] - self.knot_px) / self.step_px
        inner = 2.0 / 3.0 - v**2 + 0.5 * v**3
        outer = np.clip(2.0 - v, 0.0, None) ** 3 / 6.0
        return np.where(v < 1.0, inner, outer)

    def transforms(self, frequency_cpp: Vector) -> NDArray[np.complex128]:
        """Return [f j]: the Fourier transforms of the splines."""
        shape = self.step_px * np.sinc(frequency_cpp * self.step_px) ** 4
        wave = np.exp(-2j * np.pi * np.outer(frequency_cpp, self.knot_px))
        return np.asarray(shape[:, None] * wave)


def _integrated_spline(u: Vector) -> Vector:
    """Return the integral of the centred cubic B-spline (support -2 to 2) up to u."""
    v = np.clip(np.abs(u), 0.0, 2.0)
    inner = (2.0 / 3.0) * v - v**3 / 3.0 + v**4 / 8.0
    outer = 0.5 - (2.0 - v) ** 4 / 24.0
    integral: Vector = 0.5 + np.sign(u) * np.where(v < 1.0, inner, outer)
    return integral


_TABLE = _integrated_spline(np.arange(-2 * _TABLE_STEPS, 2 * _TABLE_STEPS + 2) / _TABLE_STEPS)
_TABLE_RISE = np.diff(_TABLE)
