"""What residuals cost, and the weights of the quadratics that touch the losses from above."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.options import check_settings, option, positive
from lensshift.reconstruction.quantiles import weighted_mad, weighted_median

# Where Huber's function leaves the square; the published toolbox takes 2 as well.
HUBER_SIGMAS = 2.0
# Frames in 0 .. 1 went through a converter: no residual is known better than this.
LEAST_SIGMA = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """How much each LR pixel counts at the present image.

    Parameters
    ----------
    weight : [frame row col] of the touching quadratic, the caller's weight included
    confidence : [frame row col] 0 .. 1, for people
    sigma : scale of the residual
    """

    weight: Array
    confidence: Array
    sigma: float = 0.0


class Loss:
    """What the loop asks of a data loss: sum w rho(r)."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_settings(self)

    def believe(self, residual: Array, weight: Array, before: Array) -> Belief:
        """Return the quadratic that touches from above at residuals [frame row col].

        Parameters
        ----------
        weight : the caller's, 0 for pixels that must not be used
        before : the confidence of the step before
        """
        raise NotImplementedError

    def cost(self, residual: Array, weight: Array, belief: Belief) -> float:
        """Return sum w rho(r)."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Squares(Loss):
    """rho(r) = |r|^2, as the noise wants it that has no outliers."""

    def believe(self, residual: Array, weight: Array, before: Array) -> Belief:
        """Return the caller's weights."""
        return Belief(weight, np.clip(weight, 0.0, 1.0), _scale(residual, weight))

    def cost(self, residual: Array, weight: Array, belief: Belief) -> float:
        """Return sum w |r|^2."""
        return float(np.sum(weight * (residual * residual.conj()).real))


@dataclass(frozen=True, slots=True)
class Absolute(Loss):
    """rho(r) = sqrt(|r|^2 + s^2): Farsiu's L1, quadratic below s, so that its weights stay finite.

    s is about a step of an 8-bit converter. Source: Farsiu et al. 2004.
    """

    smoothing: float = option(5e-3, positive())

    def believe(self, residual: Array, weight: Array, before: Array) -> Belief:
        """Return w / (2 rho)."""
        share = self.smoothing / np.sqrt(np.abs(residual) ** 2 + self.smoothing**2)
        trust = share * np.clip(weight, 0.0, 1.0)
        return Belief(weight * share / (2 * self.smoothing), trust, _scale(residual, weight))

    def cost(self, residual: Array, weight: Array, belief: Belief) -> float:
        """Return sum w rho."""
        return float(np.sum(weight * np.sqrt(np.abs(residual) ** 2 + self.smoothing**2)))


@dataclass(frozen=True, slots=True)
class Huber(Loss):
    """rho(r) = |r|^2 up to two robust standard deviations of the residual, linear beyond."""

    def believe(self, residual: Array, weight: Array, before: Array) -> Belief:
        """Return w min(1, 2 sigma / |r|)."""
        sigma = _scale(residual, weight)
        share = _huber(residual, sigma)
        return Belief(weight * share, share * np.clip(weight, 0.0, 1.0), sigma)

    def cost(self, residual: Array, weight: Array, belief: Belief) -> float:
        """Return sum w rho."""
        size, limit = np.abs(residual), HUBER_SIGMAS * belief.sigma
        rho = np.where(size <= limit, size**2, 2 * limit * size - limit**2)
        return float(np.sum(weight * rho))


@dataclass(frozen=True, slots=True)
class Confidences(Loss):
    """sum w beta |r|^2 with the confidences beta of Koehler's iteratively reweighted fit.

        sigma = 1.4826 MAD(r; beta before),   beta = [|median r_k| < bias] min(1, 2 sigma / |r|)

    Parameters
    ----------
    bias_limit : median residual beyond which a whole frame is left out; 0.02 in the toolbox

    Source: Koehler et al. 2016, doi 10.1109/TCI.2016.2516909; toolbox of 2017.
    """

    bias_limit: float = option(0.02, positive())

    def believe(self, residual: Array, weight: Array, before: Array) -> Belief:
        """Return w beta."""
        bias = [abs(weighted_median(r, w)) for r, w in zip(residual, weight, strict=True)]
        even = (np.array(bias) < self.bias_limit).astype(weight.dtype)[:, None, None]
        sigma = max(MAD_TO_SIGMA * weighted_mad(residual, even * before), LEAST_SIGMA)
        beta = even * weight * _huber(residual, sigma)
        return Belief(beta, beta, sigma)

    def cost(self, residual: Array, weight: Array, belief: Belief) -> float:
        """Return sum w beta |r|^2 at the confidences of this step."""
        return float(np.vdot(belief.weight * residual, residual).real)


LOSSES: Mapping[str, Callable[[], Loss]] = {"l2": Squares, "l1": Absolute, "huber": Huber}


def _scale(residual: Array, weight: Array) -> float:
    return max(robust_scale(residual[weight > 0]), LEAST_SIGMA)


def _huber(residual: Array, sigma: float) -> Array:
    size = np.abs(residual)
    limit = size.dtype.type(HUBER_SIGMAS * sigma)
    return np.asarray(limit / np.maximum(size, limit))
