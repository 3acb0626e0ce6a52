"""The base model of the response as a function of its parameters, the first of `lsf_prior`."""

from __future__ import annotations

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

    def parts(self, normal_px: Vector, parameters: Vector) -> NDArray[np.float64]:
        """Return `edge_parts` at distances [n]."""
        sigma_px, side_px, tail, place_px = self._meaning(parameters)
        there = normal_px - place_px
        width_px = float(tail.width_px)
        return edge_parts(there, self.angle_rad, float(sigma_px), float(side_px), width_px)

    def response(self, normal_px: Vector, parameters: Vector) -> Vector:
        """Return the ESF at distances [n]."""
        return self.mixed(self.parts(normal_px, parameters), parameters)

    def mixed(self, parts: NDArray[np.float64], parameters: Vector) -> Vector:
        """Return the ESF [n] of `parts`."""
        return np.asarray(self._meaning(parameters).tail.shares @ parts[:, 0])

    def slopes(self, parts: NDArray[np.float64], parameters: Vector) -> Matrix:
        """Return [6 n]: how the ESF of `parts` changes with the parameters."""
        tail = self._meaning(parameters).tail
        core, slow, fast = parts
        shares = tail.shares
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
        sigma_px, side_px, tail, place_px = self._meaning(parameters)
        f = frequency_cpp[:, None]
        there = edge_response_transform(f, self.angle_rad, sigma_px, side_px, tail)
        return np.asarray(there * np.exp(-2j * np.pi * place_px * f))

    def _meaning(self, parameters: NDArray[np.float64]) -> _Meaning:
        log_sigma, root, root_share, log_tail, slow, place = parameters[:6]
        return _Meaning(
            np.exp(log_sigma) * self.unit_px,
            np.exp(-(root**2)) * self.aperture_px,
            Tail(root_share * np.abs(root_share), np.exp(log_tail) * self.unit_px, slow),
            place * self.unit_px,
        )


class _Meaning(NamedTuple):
    """What the parameters, or each of several, mean."""

    sigma_px: Vector
    side_px: Vector
    tail: Tail
    place_px: Vector
