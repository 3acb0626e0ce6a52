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
    edge_parts,
    edge_response_transform,
)


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
