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
    core_slopes,
    edge_response,
    edge_response_transform,
    far_slopes,
)


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
        return edge_response(
            normal_px - parts.place_px, self.angle_rad, parts.sigma_px, parts.side_px, parts.tail
        )

    def slopes(self, normal_px: Vector, parameters: Vector) -> Matrix:
        """Return [6 n]: how the ESF changes with the parameters."""
        sigma_px, side_px, tail, place_px = self._parts(parameters)
        there = normal_px - place_px
        core = core_slopes(there, self.angle_rad, sigma_px, side_px)
        slow, fast = far_slopes(there, self.angle_rad, side_px, float(tail.width_px))
        far, share = fast + tail.slow * (slow - fast), tail.share
        both = (1.0 - share) * core[2:] + share * far[2:]
        slopes = np.empty((6, normal_px.size))
        slopes[0] = (1.0 - share) * core[1]
        slopes[1] = -2.0 * parameters[1] * both[0]
        slopes[2] = 2.0 * abs(float(parameters[2])) * (far[0] - core[0])
        slopes[3] = share * far[1]
        slopes[4] = share * (slow[0] - fast[0])
        slopes[5] = -self.unit_px * both[1]
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
