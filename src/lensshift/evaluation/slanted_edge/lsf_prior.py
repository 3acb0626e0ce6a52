"""What is known of an edge's response before a pixel is seen: normal distributions, and limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector
from lensshift.evaluation.slanted_edge.prior_kernels import process_factor, process_slopes

# Mean and standard deviation; lengths in units of `unit_px`. The Gaussian of the optics may be
# anything from far below a pixel to well above it. The pixel may be smaller than its pitch (its
# side is exp(-r^2) of it), though most fill it. What these two leave is smooth: a few per cent of
# the LSF, about as long as a pixel, and mostly symmetric.
_LOG_SIGMA = (np.log(0.4), 1.0)
_ROOT_SHRINKAGE = (0.0, 0.25)
# Light far from the edge: a share v |v| of `Tail`, whose widths and speed of fall are free.
# A halo is positive, sharpening negative, and most lenses have little of either.
_ROOT_TAIL = (0.0, 0.35)
_LOG_TAIL_WIDTH = (np.log(1.5), 0.8)
# Both ways of falling lie well inside: at a limit, errors would go to one side only and no interval
# would hold the truth.
_SLOW = (0.5, 0.5)
_PLACE = (0.0, np.inf)  # of the base, against the splines
_LOG_AMPLITUDE = (np.log(0.05), 0.7)
_LOG_LENGTH = (np.log(1.1), 0.35)
_LOG_TAIL = (np.log(1.0), 0.6)
_LOGIT_SYMMETRY = (2.0, 2.0)
HYPER_PRIOR = np.array(
    [
        *(_LOG_SIGMA, _ROOT_SHRINKAGE, _ROOT_TAIL, _LOG_TAIL_WIDTH, _SLOW, _PLACE),
        *(_LOG_AMPLITUDE, _LOG_LENGTH, _LOG_TAIL, _LOGIT_SYMMETRY),
    ]
)
BASE_HYPERS = 6  # the first are of the base model, the others of the splines
HYPERS = len(HYPER_PRIOR)
HYPER_BOUNDS = np.array(
    [
        *((-2.5, 2.0), (-1.1, 1.1), (-1.0, 1.0), (-1.0, 3.0), (-1.0, 2.0), (-1.0, 1.0)),
        *((-9.0, 0.5), (-1.4, 1.1), (-1.4, 3.5), (-8.0, 8.0)),
    ]
)
# At shrinkage 0 and tail 0 the likelihood is level and would hold a descent: start beside it.
START = np.array([*HYPER_PRIOR[:1, 0], 0.2, 0.2, *HYPER_PRIOR[3:, 0]])
# Typical sizes of a step.
STEPS = np.array([0.1, 0.1, 0.1, 0.3, 0.2, 0.005, 0.5, 0.2, 0.3, 1.0])
PLACE = 5  # which of the parameters is the place of the base, in units of the width


class Factor(NamedTuple):
    """A factor L of the covariance of the spline coefficients, even and odd ones apart.

    Parameters
    ----------
    even, odd : [j r], [i q]
    """

    even: Matrix
    odd: Matrix

    def over(self, right: NDArray[np.float64]) -> Matrix:
        """Return L^T times [j+i ...]."""
        evens = len(self.even)
        return np.concatenate([self.even.T @ right[:evens], self.odd.T @ right[evens:]])

    def times(self, weights: NDArray[np.float64]) -> Matrix:
        """Return L times [r+q ...]."""
        rank = self.even.shape[1]
        return np.concatenate([self.even @ weights[:rank], self.odd @ weights[rank:]])


class SplinePrior:
    """Covariance of the spline coefficients, a Gaussian process on the knots.

        K(x, x') = a^2 e(x) e(x') [k(x - x') + m k(x + x')]
        k(d) = exp(-d^2 / 2 l^2),  e(x) = 1 / (1 + (x / t)^2)

    with amplitude a, length l, tail t and symmetry m, given as log a, log l, log t, logit m. Of
    the even functions, it is (1 + m) [k(x - x') + k(x + x')], of the odd ones (1 - m) [k - k].

    Parameters
    ----------
    basis : splines of the LSF
    unit_px : width by which the prior is scaled, 1 for an edge a pixel wide
    """

    def __init__(self, basis: SplineBasis, unit_px: float) -> None:
        self._place = basis.number * basis.step_px / unit_px
        self._unit_px = unit_px
        self._number = basis.number
        self._lags = basis.step_px / unit_px * np.arange(2 * basis.number[-1] + 1)

    def factor(self, shape: Vector, information: Vector, tolerance: float) -> Factor:
        """Return L with L L^T = K but for directions of which neither prior nor pixels tell.

        Parameters
        ----------
        shape : [4] log amplitude, log length, log tail, logit symmetry
        information : [j] what the pixels tell of each coefficient, an inverse variance
        tolerance : what the prior variances left out times this add up to at most
        """
        parts = self._parts(shape)
        found, start = [], 0
        for numbers, envelope, sign, _ in self._halves(parts):
            own = information[start : start + numbers.size]
            rows = np.empty((numbers.size,) * 2)
            rank = process_factor(numbers, envelope, parts.near, sign, own, 0.5 * tolerance, rows)
            found.append(rows[:rank].T)
            start += numbers.size
        return Factor(*found)

    def gradient(self, shape: Vector, even: Matrix, odd: Matrix) -> Vector:
        """Return the gradient [4] of a value whose derivatives by even and odd K are given."""
        parts = self._parts(shape)
        m, slopes = parts.symmetry, np.zeros(shape.size)
        for given, (numbers, envelope, sign, wider) in zip(
            (even, odd), self._halves(parts), strict=True
        ):
            by_factor, by_length, by_tail = process_slopes(
                given, numbers, envelope, parts.near, parts.longer, wider, sign
            )
            slopes[:3] += 2.0 * by_factor, by_length, by_tail
            slopes[3] += by_factor * (m * (1.0 - m) / (1.0 + m) if sign > 0 else -m)
        return slopes

    def _parts(self, shape: Vector) -> _Parts:
        amplitude, length, tail = np.exp(shape[:3])
        symmetry = float(1.0 / (1.0 + np.exp(-shape[3])))
        lags = (self._lags / length) ** 2
        near = np.exp(-0.5 * lags)
        shares = (self._place / tail) ** 2
        envelope = amplitude / self._unit_px / (1.0 + shares)
        return _Parts(near, lags * near, envelope, 2.0 * shares / (1.0 + shares), symmetry)

    def _halves(self, parts: _Parts) -> Iterator[tuple[NDArray[np.intp], Vector, float, Vector]]:
        """Yield knots, envelope, sign and slope of the log envelope, even ones first."""
        even = np.sqrt(1.0 + parts.symmetry) * parts.envelope
        even[0] *= np.sqrt(0.5)  # the middle is its own mirror
        yield self._number, even, 1.0, parts.wider
        odd = np.sqrt(1.0 - parts.symmetry) * parts.envelope[1:]
        yield self._number[1:], odd, -1.0, parts.wider[1:]


class _Parts(NamedTuple):
    """k and its slope by log l at all lags, a e and its relative slope by log t, m."""

    near: Vector
    longer: Vector
    envelope: Vector
    wider: Vector
    symmetry: float
