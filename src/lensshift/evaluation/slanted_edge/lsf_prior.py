"""What is known of an edge's response before a pixel is seen: normal distributions, and limits."""

from __future__ import annotations

import numpy as np

from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector
from lensshift.evaluation.slanted_edge.prior_kernels import process_covariance, process_slopes

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
_LOGIT_SLOW = (0.0, 1.5)
_LOG_AMPLITUDE = (np.log(0.05), 1.5)
_LOG_LENGTH = (np.log(1.1), 0.35)
_LOG_TAIL = (np.log(1.0), 0.6)
_LOGIT_SYMMETRY = (2.0, 2.0)
HYPER_PRIOR = np.array(
    [
        *(_LOG_SIGMA, _ROOT_SHRINKAGE, _ROOT_TAIL, _LOG_TAIL_WIDTH, _LOGIT_SLOW),
        *(_LOG_AMPLITUDE, _LOG_LENGTH, _LOG_TAIL, _LOGIT_SYMMETRY),
    ]
)
BASE_HYPERS = 5  # the first are of the base model, the others of the splines
HYPERS = len(HYPER_PRIOR)
HYPER_BOUNDS = np.array(
    [
        *((-2.5, 2.0), (-1.1, 1.1), (-1.0, 1.0), (-1.0, 3.0), (-5.0, 5.0)),
        *((-9.0, 0.5), (-1.4, 1.1), (-1.4, 3.5), (-8.0, 8.0)),
    ]
)
# At shrinkage 0 and tail 0 the likelihood is level and would hold a descent: start beside it.
START = np.array([*HYPER_PRIOR[:1, 0], 0.2, 0.2, *HYPER_PRIOR[3:, 0]])
# Typical sizes of a step.
STEPS = np.array([0.1, 0.1, 0.1, 0.3, 1.0, 0.5, 0.2, 0.3, 1.0])
_JITTER = 1e-10
_RELATIVE_JITTER = 1e-8


class SplinePrior:
    """Covariance of the spline coefficients, a Gaussian process on the knots.

        K(x, x') = a^2 e(x) e(x') [k(x - x') + m k(x + x')] + jitter
        k(d) = exp(-d^2 / 2 l^2),  e(x) = 1 / (1 + (x / t)^2)

    with amplitude a, length l, tail t and symmetry m, given as log a, log l, log t, logit m.

    Parameters
    ----------
    basis : splines of the LSF
    unit_px : width by which the prior is scaled, 1 for an edge a pixel wide
    """

    def __init__(self, basis: SplineBasis, unit_px: float) -> None:
        self._place = basis.knot_px / unit_px
        self._unit_px = unit_px
        self._number = basis.number
        self._lags = basis.step_px / unit_px * np.arange(2 * basis.number[-1] + 1)

    def covariance(self, shape: Vector) -> Matrix:
        """Return K [j j] for `shape` [4]: log amplitude, log length, log tail, logit symmetry."""
        amplitude, near, _, envelope, _, symmetry = self._parts(shape)
        covariance = np.empty((envelope.size,) * 2)
        jitter = _JITTER / self._unit_px**2 + _RELATIVE_JITTER * amplitude**2
        process_covariance(self._number, envelope, near, symmetry, jitter, covariance)
        return covariance

    def gradient(self, shape: Vector, sensitivity: Matrix) -> Vector:
        """Return the gradient [4] of a value whose derivative by K is `sensitivity` [j j]."""
        amplitude, near, longer, envelope, wider, symmetry = self._parts(shape)
        slopes = np.zeros(shape.size)
        process_slopes(sensitivity, self._number, envelope, near, longer, wider, symmetry, slopes)
        slopes[0] += 2.0 * _RELATIVE_JITTER * amplitude**2 * np.trace(sensitivity)
        return slopes

    def _parts(self, shape: Vector) -> tuple[float, Vector, Vector, Vector, Vector, float]:
        """Return a, k and its slope by log l at all lags, a e and its relative slope, m."""
        amplitude, length, tail = np.exp(shape[:3])
        amplitude /= self._unit_px
        symmetry = float(1.0 / (1.0 + np.exp(-shape[3])))
        lags = (self._lags / length) ** 2
        near = np.exp(-0.5 * lags)
        shares = (self._place / tail) ** 2
        envelope = amplitude / (1.0 + shares)
        return amplitude, near, lags * near, envelope, 2.0 * shares / (1.0 + shares), symmetry
