"""Penalties on differences between neighbouring HR pixels, as values.

Every prior is a sum over directions d of a function of |D_d x|, homogeneous of some degree where
the differences are large, and knows the coefficients a(x) of the quadratic that touches it from
above at x:

    gradient(x) = 2 sum_d D_d^T a_d(x) D_d x

What a prior learns from the image (weights of its differences, how sharp it is) is in the prior
that `renewed` returns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.forward.differences import Directions, differences, half_plane
from lensshift.reconstruction.options import check_settings, option, positive, whole
from lensshift.reconstruction.quantiles import median_3x3, weighted_mad


class Prior:
    """What a solver asks of a prior."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def directions(self) -> Directions:
        """The directions [direction 2] of its differences: across, down and both diagonals."""
        return half_plane(1)

    @property
    def degree(self) -> float:
        """P(c x) ~ c^degree P(x)."""
        return 1.0

    def value(self, x: Array) -> float:
        """Return P(x)."""
        raise NotImplementedError

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col]."""
        raise NotImplementedError

    def renewed(self, x: Array, sigma: float) -> Prior:
        """Return the prior for the next step from x, where the noise of an LR pixel is sigma."""
        return self


def squared_differences(x: Array, directions: Directions) -> Array:
    """Return |D_d x|^2 [direction row col]."""
    steps = differences(x, directions)
    if x.dtype.kind == "c":
        return np.asarray((steps * steps.conj()).real)
    return np.square(steps, out=steps)


@dataclass(frozen=True, slots=True)
class TotalVariation(Prior):
    """Isotropic total variation, sum sqrt(|dx|^2 + |dy|^2 + s^2) - s.

    Source: Rudin, Osher and Fatemi 1992.
    """

    smoothing: float = option(1e-3, positive())

    @property
    def directions(self) -> Directions:
        """Across and down."""
        return half_plane(1)[:2]

    def value(self, x: Array) -> float:
        """Return P(x)."""
        return float(np.sum(self._root(x) - self.smoothing))

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col], 1 / (2 sqrt(...)) for both directions."""
        a = 0.5 / self._root(x)
        return np.stack([a, a])

    def _root(self, x: Array) -> Array:
        square = squared_differences(x, self.directions).sum(axis=0)
        return np.asarray(np.sqrt(square + self.smoothing**2))


@dataclass(frozen=True, slots=True)
class HuberDifferences(Prior):
    """Huber function of the differences to the eight neighbours.

    h(e) = e^2 / (2 t) if |e| <= t else |e| - t / 2
    """

    threshold: float = option(0.02, positive())

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
class BilateralTotalVariation(Prior):
    """Bilateral total variation, with weights of its own for every difference if it is sparse.

        sum over |l|, |m| <= P, (l, m) != 0 of alpha^(|l| + |m|) beta sqrt(|S_lm x - x|^2 + s^2)

    Each difference stands in the sum twice, once from either end. With a sparsity p < 1 the
    weights are found anew in each step,

        beta = (1 + |z| / c)^(p - 1),   z = alpha^(|l| + |m|) median3x3(D_lm x),   c = MAD(z; beta)

    the derivative of the concave penalty c ((1 + |z| / c)^p - 1) / p. The published weight is 1 up
    to 2 c, where it jumps to p and falls from there.

    Parameters
    ----------
    window : P in HR pixels
    alpha : decay of the weight with distance, in (0, 1]
    smoothing : s
    sparsity : p in (0, 1]; 1 is plain bilateral total variation
    beta : [direction row col] weights of the differences, or None for 1

    Source: Farsiu et al. 2004; with weights Koehler et al. 2016.
    """

    window: int = option(2, whole(1))
    alpha: float = option(0.7, positive(1.0))
    smoothing: float = option(1e-2, positive())
    sparsity: float = option(1.0, positive(1.0))
    beta: Array | None = None

    @property
    def directions(self) -> Directions:
        """One of each pair of opposite directions."""
        return half_plane(self.window)

    def value(self, x: Array) -> float:
        """Return P(x); what the smoothing adds to a flat image is taken off."""
        cost = self._root(x)
        cost -= self.smoothing
        cost *= self._weight(x)
        return float(2.0 * np.sum(cost))

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col], share beta / sqrt(...)."""
        root = self._root(x)
        return np.divide(self._weight(x), root, out=root)

    def renewed(self, x: Array, sigma: float) -> BilateralTotalVariation:
        """Return the prior with the weights of the differences of x."""
        if self.sparsity == 1.0:
            return self
        z = differences(x, self.directions)
        for step, share in zip(z, self._share(x)[:, 0, 0], strict=True):
            median_3x3(step.copy(), share, step)
        scale = weighted_mad(z, np.ones_like(z) if self.beta is None else self.beta)
        beta = (1.0 + np.abs(z) / max(scale, 1e-9)) ** (self.sparsity - 1.0)
        return replace(self, beta=beta.astype(x.real.dtype, copy=False))

    def _share(self, x: Array) -> Array:
        share = self.alpha ** np.abs(self.directions).sum(axis=1)[:, None, None]
        return np.asarray(share, x.real.dtype)

    def _weight(self, x: Array) -> Array:
        return self._share(x) if self.beta is None else self._share(x) * self.beta

    def _root(self, x: Array) -> Array:
        square = squared_differences(x, self.directions)
        square += self.smoothing**2
        return np.sqrt(square, out=square)


@dataclass(frozen=True, slots=True)
class SparseDifferences(Prior):
    """Differences to the eight neighbours to a power: 2 is Tikhonov, 1 total variation.

        sum_d share_d (|D_d x|^2 + s^2)^(p / 2)

    From step to step s shrinks (graduated non-convexity), to a fifth of the noise: what is smaller
    is noise in any case, and with less the steps of the solver would be many.

    Parameters
    ----------
    exponent : p
    smoothing : s to begin with, for images in 0 .. 1: larger than all but the strongest edges
    decay : of s in a step
    sigma : noise of an LR pixel, which `renewed` is told
    """

    exponent: float = 1.0
    smoothing: float = 0.1
    decay: float = 0.75
    sigma: float = 0.0

    @property
    def degree(self) -> float:
        """p."""
        return self.exponent

    def value(self, x: Array) -> float:
        """Return P(x) less what the smoothing adds to a flat image, but for its noise."""
        rest = self.smoothing**self.exponent - (0.3 * self.sigma) ** self.exponent
        total = np.sum(self._share * self._power(x, 0.0))
        return float(total - x.size * rest * self._share.sum())

    def coefficients(self, x: Array) -> Array:
        """Return a(x) [direction row col], p share / 2 (...)^(p / 2 - 1)."""
        return np.asarray(0.5 * self.exponent * self._share * self._power(x, 2.0))

    def renewed(self, x: Array, sigma: float) -> SparseDifferences:
        """Return the prior with a smaller s."""
        smoothing = max(0.2 * sigma, self.decay * self.smoothing)
        return replace(self, smoothing=smoothing, sigma=sigma)

    @property
    def _share(self) -> Floats:
        """Diagonal neighbours are farther away: their differences count 1 / length."""
        return np.asarray(1.0 / np.sqrt((self.directions**2).sum(axis=1)))[:, None, None]

    def _power(self, x: Array, less: float) -> Array:
        square = squared_differences(x, self.directions)
        return np.asarray((square + self.smoothing**2) ** (0.5 * (self.exponent - less)))


PRIORS: Mapping[str, Callable[..., Prior]] = {
    "tv": TotalVariation,
    "huber": HuberDifferences,
    "btv": BilateralTotalVariation,
}
