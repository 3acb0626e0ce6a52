"""Aspheres in the polynomials of Forbes, as powers of the distance from the axis."""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from lensshift.core.arrays import Floats

_MOST_POWERS = 24  # of r^2: beyond, rounding takes what more of them bring
_CLOSE_MM = 1e-9  # a tenth of what rays are compared to, over the slopes of a fast asphere
_LOOKED_AT = 400  # heights


def forbes_terms(
    conic_like: bool,
    coefficients: list[float],
    unit_mm: float,
    base: tuple[float, float],
    edge_mm: float,
) -> tuple[float, ...]:
    """Return the coefficients of r^2, r^4, ... that are added to a conic.

        Qcon:  u^4 sum_m a_m P_m(2 u^2 - 1),     P_m Jacobi polynomials (0, 4),   u = r / unit
        Qbfs:  u^2 (1 - u^2) sum_m a_m Q_m(u^2) sqrt[(1 - k c^2 r^2) / (1 - (1 + k) c^2 r^2)]

    The root, one over the cosine of the normal of the conic, is no polynomial: it is fitted up to
    the edge, to 1e-9 mm.

    Parameters
    ----------
    conic_like : Qcon, otherwise Qbfs
    coefficients : a_0, a_1, ... in mm
    unit_mm : the radius that u is measured in
    base : curvature c in 1/mm and conic constant k
    edge_mm : as far as the surface reaches

    Raises
    ------
    ValueError
        If there is no such polynomial, as where the conic ends before the edge.

    Source: G. W. Forbes, Opt. Express 15 (2007) 5218; recurrences 18 (2010) 19700.
    """
    square = Polynomial([0.0, 1.0])
    terms = (_jacobi if conic_like else _bfs)(len(coefficients))
    parts = (a * term for a, term in zip(coefficients, terms, strict=True))
    series = sum(parts, start=Polynomial([0.0]))
    if conic_like:
        total = square**2 * series
    else:
        total = square * _fitted((1.0 - square) * series, unit_mm, base, edge_mm)
    return tuple(float(a) / unit_mm ** (2 * i) for i, a in enumerate(total.coef[1:], start=1))


def _fitted(
    series: Polynomial, unit_mm: float, base: tuple[float, float], edge_mm: float
) -> Polynomial:
    """Return a polynomial of u^2 that is the series over the cosine, up to the edge."""
    curvature, conic = base
    scale = (curvature * unit_mm) ** 2

    def wanted(square: Floats) -> Floats:
        cosine = (1.0 - (1.0 + conic) * scale * square) / (1.0 - conic * scale * square)
        return np.asarray(series(square) / np.sqrt(cosine))

    last = (edge_mm / unit_mm) ** 2
    if not (1.0 + conic) * scale * last < 1.0:
        raise ValueError(f"expected a conic up to the edge at {edge_mm:g} mm")
    seen = np.linspace(0.0, last, _LOOKED_AT)
    for degree in range(len(series.coef), _MOST_POWERS):
        fit = Chebyshev.interpolate(wanted, degree, domain=[0.0, last]).convert(kind=Polynomial)
        if np.abs(seen * (fit(seen) - wanted(seen))).max() < _CLOSE_MM:
            return Polynomial(fit.coef)
    raise ValueError(f"expected a shape that {_MOST_POWERS} powers follow to {_CLOSE_MM:g} mm")


def _jacobi(count: int) -> list[Polynomial]:
    """Return P_0, P_1, ... of u^2 with the weight u^8."""
    from scipy.special import jacobi

    return [Polynomial(jacobi(m, 0, 4).coef[::-1])(Polynomial([-1.0, 2.0])) for m in range(count)]


def _bfs(count: int) -> list[Polynomial]:
    """Return Q_0, Q_1, ... of u^2: the slopes of u^2 (1 - u^2) Q_m are orthonormal."""
    helpers = [Polynomial([2.0]), Polynomial([6.0, -8.0])]
    found = [Polynomial([1.0]), Polynomial([13.0, -16.0]) / math.sqrt(19.0)]
    f, g = [2.0, 0.5 * math.sqrt(19.0)], [-0.5]
    for m in range(2, count):
        helpers.append(Polynomial([2.0, -4.0]) * helpers[-1] - helpers[-2])
        h = -m * (m - 1) / (2.0 * f[m - 2])
        g.append(-(1.0 + g[m - 2] * h) / f[m - 1])
        f.append(math.sqrt(m * (m + 1) + 3.0 - g[m - 1] ** 2 - h**2))
        found.append((helpers[m] - g[m - 1] * found[m - 1] - h * found[m - 2]) / f[m])
    return found[:count]
