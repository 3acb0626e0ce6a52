"""The base model of the response as a function of its parameters, the first of `lsf_prior`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge.edge_model import (
    Matrix,
    Tail,
    Vector,
    edge_core,
    edge_response_transform,
    edge_tail,
)

_DIFFERENCE = 1e-6


class _Parts(NamedTuple):
    """What the parameters mean."""

    sigma_px: float
    side_px: float
    tail: Tail
    place_px: float


class BaseModel(NamedTuple):
    """A Gaussian with a tail, seen by a square pixel.

    Its parameters are log sigma, the root r of the pixel's shrinkage (its side is exp(-r^2) of the
    aperture), the root v of the tail's share v |v|, log width and speed of the tail, and the place
    of it all; lengths in units of `unit_px`.

    Parameters
    ----------
    angle_rad : of the edge
    aperture_px : side of the largest pixel
    unit_px : width of the edge
    """

    angle_rad: float
    aperture_px: float
    unit_px: float

    def response(self, normal_px: Vector, parameters: Vector) -> Vector:
        """Return the ESF at distances [n]."""
        parts = self._parts(parameters)
        core, far = self._both(normal_px - parts.place_px, parts)
        return core + parts.tail.share * (far - core)

    def slopes(self, normal_px: Vector, parameters: Vector) -> Matrix:
        """Return [6 n]: how the ESF changes with the parameters."""
        parts = self._parts(parameters)
        sigma_px, side_px, tail, place_px = parts
        there = normal_px - place_px
        core, far = self._both(there, parts)
        share, apart = tail.share, far - core
        h = _DIFFERENCE
        slopes = np.empty((6, normal_px.size))
        wider = edge_core(there, self.angle_rad, sigma_px * (1.0 + h), side_px)
        slopes[0] = (1.0 - share) / h * (wider - core)
        root = float(parameters[1])
        smaller = parts._replace(side_px=math.exp(-((root + h) ** 2)) * self.aperture_px)
        farther = there - h * self.unit_px
        for k, changed in ((1, self._both(there, smaller)), (5, self._both(farther, parts))):
            slopes[k] = (1.0 - share) / h * (changed[0] - core) + share / h * (changed[1] - far)
        slopes[2] = 2.0 * abs(float(parameters[2])) * apart
        stretched = self._far(there, side_px, tail._replace(width_px=tail.width_px * (1.0 + h)))
        slopes[3] = share / h * (stretched - far)
        # The tail is linear in its speed: any difference will do.
        other = 0.0 if tail.slow > 0.5 else 1.0
        other_far = self._far(there, side_px, tail._replace(slow=other))
        by_slow = (other_far - far) / (other - tail.slow)
        slopes[4] = share * by_slow
        return slopes

    def transforms(self, frequency_cpp: Vector, parameters: Matrix) -> NDArray[np.complex128]:
        """Return the Fourier transforms of the LSFs [f k] of several parameters [p k]."""
        log_sigma, root, root_share, log_tail, slow, place = parameters[:6]
        tail = Tail(root_share * np.abs(root_share), np.exp(log_tail) * self.unit_px, slow)
        f, sigma_px = frequency_cpp[:, None], np.exp(log_sigma) * self.unit_px
        side_px = np.exp(-(root**2)) * self.aperture_px
        there = edge_response_transform(f, self.angle_rad, sigma_px, side_px, tail)
        return np.asarray(there * np.exp(-2j * np.pi * self.unit_px * place * f))

    def _parts(self, parameters: Vector) -> _Parts:
        log_sigma, root, root_share, log_tail, slow, place = parameters[:6].tolist()
        return _Parts(
            math.exp(log_sigma) * self.unit_px,
            math.exp(-(root**2)) * self.aperture_px,
            Tail(root_share * abs(root_share), math.exp(log_tail) * self.unit_px, slow),
            place * self.unit_px,
        )

    def _both(self, normal_px: Vector, parts: _Parts) -> tuple[Vector, Vector]:
        core = edge_core(normal_px, self.angle_rad, parts.sigma_px, parts.side_px)
        return core, self._far(normal_px, parts.side_px, parts.tail)

    def _far(self, normal_px: Vector, side_px: float, tail: Tail) -> Vector:
        return edge_tail(normal_px, self.angle_rad, side_px, float(tail.width_px), float(tail.slow))
