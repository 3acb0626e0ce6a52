"""Rays that sample the stop: points on the unit disc and their weights."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from lensshift.core.arrays import Floats


def pupil_quadrature(
    rings: int = 6, arms: int | None = None, inner: float = 0.0
) -> tuple[Floats, Floats]:
    """Return points [ray 2] (row, col) on the unit disc and weights [ray] that sum to 1.

        mean of f over the disc = sum w f,    exact for polynomials of degree up to 4 rings - 2

    Gauss-Legendre in the squared radius, evenly spread angles: `arms` of them, by default
    4 rings.

    Parameters
    ----------
    inner : radius within which the stop is dark; rays on both sides of it, so that those that are
        left stand for the ring that is

    Raises
    ------
    ValueError
        If there is no ring or there are fewer than three arms.

    Source: G. W. Forbes, J. Opt. Soc. Am. A 5 (1988) 1943.
    """
    count = 4 * rings if arms is None else arms
    if rings < 1 or count < 3:
        raise ValueError(f"expected at least 1 ring and 3 arms, got {rings} and {count}")
    square, weight = _squares(rings, inner)
    radius = np.sqrt(square)
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    points = radius[:, None, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    return points.reshape(-1, 2), np.repeat(weight / count, count)


def pupil_arms(rings: int) -> Floats:
    """Return the directions [arm 2] (row, col) along which `pupil_quadrature` puts its rays."""
    first = pupil_quadrature(rings)[0][: 4 * rings]
    return np.asarray(first / np.linalg.norm(first, axis=-1, keepdims=True))


def ring_edges(rings: int, inner: float = 0.0) -> Floats:
    """Return the squared radii [ring + 1] of annuli as large as the weights of the rings."""
    return np.concatenate([[0.0], np.cumsum(_squares(rings, inner)[1])])


def _squares(rings: int, inner: float) -> tuple[Floats, Floats]:
    """Return the squared radii [ring] of `pupil_quadrature` and their weights, of sum 1."""
    if not inner or rings == 1:
        node, weight = _gauss_legendre(rings)
        return 0.5 * (node + 1.0), 0.5 * weight
    edge = inner**2
    within = min(max(1, round(rings * edge)), rings - 1)
    (near, light), (far, rest) = _squares(within, 0.0), _squares(rings - within, 0.0)
    square = np.concatenate([edge * near, edge + (1.0 - edge) * far])
    return square, np.concatenate([edge * light, (1.0 - edge) * rest])


@lru_cache(maxsize=32)
def _gauss_legendre(count: int) -> tuple[Floats, Floats]:
    node, weight = np.polynomial.legendre.leggauss(count)
    return np.asarray(node), np.asarray(weight)


def midpoints(count: int) -> Floats:
    """Return the middles of as many equal parts of -1 .. 1."""
    return np.asarray((np.arange(count) + 0.5) * (2.0 / count) - 1.0)
