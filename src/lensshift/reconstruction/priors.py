"""Penalties on differences between neighbouring HR pixels, each with value and gradient.

Every prior is a sum over directions d of a function of |D_d x|, and knows the coefficients a(x)
of the quadratic that touches it from above at x:

    gradient(x) = 2 sum_d D_d^T a_d(x) D_d x
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lensshift.reconstruction.differences import (
    Directions,
    add_weighted_laplacian,
    differences,
    half_plane,
)
from lensshift.reconstruction.options import check_settings

Array = NDArray[Any]


class Prior(Protocol):
    """What a solver asks of a prior."""

    @property
    def directions(self) -> Directions:
        """The directions [direction 2] of its differences."""
        ...

    def value(self, x: Array) -> float:
        """Return P(x)."""
        ...

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col]."""
        ...


def gradient(prior: Prior, x: Array) -> Array:
    """Return the gradient [row col] of a prior; of a complex x with respect to both parts."""
    out = np.zeros_like(x)
    add_weighted_laplacian(x, 2.0 * prior.coefficients(x), prior.directions, out)
    return out


def squared_differences(x: Array, directions: Directions) -> Array:
    """Return |D_d x|^2 [direction row col]."""
    steps = np.empty((len(directions), *x.shape), x.dtype)
    differences(x, directions, steps)
    return np.asarray((steps * steps.conj()).real)


@dataclass(frozen=True, slots=True)
class TotalVariation:
    """Isotropic total variation, sum sqrt(|dx|^2 + |dy|^2 + s^2) - s.

    Source: Rudin, Osher and Fatemi 1992.
    """

    smoothing: float = 1e-3

    @property
    def directions(self) -> Directions:
        """Across and down."""
        return half_plane(1)[:2]

    def value(self, x: Array) -> float:
        """Return P(x)."""
        root = np.sqrt(squared_differences(x, self.directions).sum(axis=0) + self.smoothing**2)
        return float(np.sum(root - self.smoothing))

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col], 1 / (2 sqrt(...)) for both directions."""
        square = squared_differences(x, self.directions)
        a = 0.5 / np.sqrt(square.sum(axis=0) + self.smoothing**2)
        return np.stack([a, a])


@dataclass(frozen=True, slots=True)
class Huber:
    """Huber function of the differences to the eight neighbours.

    h(e) = e^2 / (2 t) if |e| <= t else |e| - t / 2
    """

    threshold: float = 0.02

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def directions(self) -> Directions:
        """Across, down and both diagonals."""
        return half_plane(1)

    def value(self, x: Array) -> float:
        """Return P(x)."""
        size = np.sqrt(squared_differences(x, self.directions))
        t = self.threshold
        return float(np.sum(np.where(size <= t, size**2 / (2 * t), size - t / 2)))

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col], 1 / (2 max(|e|, t))."""
        size = np.sqrt(squared_differences(x, self.directions))
        return np.asarray(0.5 / np.maximum(size, self.threshold))


@dataclass(frozen=True, slots=True, eq=False)
class BilateralTotalVariation:
    """Bilateral total variation, with weights of its own for every difference if given.

        sum over |l|, |m| <= P, (l, m) != 0 of alpha^(|l| + |m|) beta sqrt(|S_lm x - x|^2 + s^2)

    Each difference stands in the sum twice, once from either end.

    Parameters
    ----------
    window : P in HR pixels
    alpha : decay of the weight with distance, in (0, 1]
    smoothing : s
    beta : [direction row col] weights of the differences, or None for 1

    Source: Farsiu et al. 2004; with weights Koehler et al. 2016.
    """

    window: int = 2
    alpha: float = 0.7
    smoothing: float = 1e-2
    beta: Array | None = None

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def directions(self) -> Directions:
        """One of each pair of opposite directions."""
        return half_plane(self.window)

    @property
    def share(self) -> NDArray[np.float64]:
        """alpha^(|l| + |m|) [direction]."""
        return np.asarray(self.alpha ** np.abs(self.directions).sum(axis=1).astype(np.float64))

    def value(self, x: Array) -> float:
        """Return P(x); what the smoothing adds to a flat image is taken off."""
        root = np.sqrt(squared_differences(x, self.directions) + self.smoothing**2)
        weight = self.share[:, None, None] * (1.0 if self.beta is None else self.beta)
        return float(2.0 * np.sum(weight * (root - self.smoothing)))

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col], share beta / sqrt(...)."""
        root = np.sqrt(squared_differences(x, self.directions) + self.smoothing**2)
        return np.asarray(
            self.share[:, None, None] * (1.0 if self.beta is None else self.beta) / root
        )


PRIORS: Mapping[str, Callable[..., Prior]] = {
    "tv": TotalVariation,
    "huber": Huber,
    "btv": BilateralTotalVariation,
}
