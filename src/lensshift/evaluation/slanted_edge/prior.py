"""What is expected of the spline that corrects the line spread function: a Gaussian process."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector

_JITTER = 1e-10
_RELATIVE_JITTER = 1e-8


class SplinePrior:
    """Normal distribution of the spline coefficients: smooth, largest at the edge, about even.

        K_ij = a^2 e_i e_j (n(x_i - x_j) + m n(x_i + x_j)),   e = 1 / (1 + (x / tail)^2)

    with n a Gaussian of the length and m between 0 and 1, more for a more symmetric correction.

    Parameters
    ----------
    basis : the splines
    unit_px : length in which amplitude (per unit), length and tail are counted
    """

    def __init__(self, basis: SplineBasis, unit_px: float) -> None:
        self._knots, self._unit_px = basis.knot_px / unit_px, unit_px
        knots = np.arange(self._knots.size)
        self._apart = np.abs(np.subtract.outer(knots, knots))
        self._lags = basis.step_px / unit_px * knots

    def factor(self, shape: Vector) -> Matrix | None:
        """Return the lower Cholesky factor of K, None if K is not positive definite.

        Parameters
        ----------
        shape : [4] log amplitude, log length, log tail, logit of m
        """
        near, envelope, mirrored = self._terms(shape)
        covariance = near + mirrored * near[:, ::-1]
        covariance *= np.outer(envelope, envelope)
        covariance.flat[:: covariance.shape[0] + 1] += self._jitter(shape)
        return cholesky(covariance)

    def slopes(self, shape: Vector, pull: Matrix) -> Vector:
        """Return the sums [4] of `pull` times the derivatives of K by the shape.

        Parameters
        ----------
        shape : as in `factor`
        pull : [j j], symmetric
        """
        near, envelope, mirrored = self._terms(shape)
        weighted = pull * np.outer(envelope, envelope)
        even = weighted * near[:, ::-1]
        product = weighted * near + mirrored * even
        stretched = (np.exp(-shape[1]) * self._lags) ** 2 * near[0]
        longer = stretched[self._apart]
        beyond = 1.0 - envelope * self._unit_px * np.exp(-shape[0])
        relative = self._jitter(shape) - _JITTER / self._unit_px**2
        return np.array(
            [
                2.0 * product.sum() + 2.0 * relative * np.trace(pull),
                np.sum(weighted * (longer + mirrored * longer[:, ::-1])),
                4.0 * np.sum(product.sum(axis=1) * beyond),
                mirrored * (1.0 - mirrored) * even.sum(),
            ]
        )

    def _terms(self, shape: Vector) -> tuple[Matrix, Vector, float]:
        near = np.exp(-0.5 * (np.exp(-shape[1]) * self._lags) ** 2)[self._apart]
        envelope = np.exp(shape[0]) / self._unit_px
        envelope = envelope / (1.0 + (self._knots * np.exp(-shape[2])) ** 2)
        return near, envelope, float(1.0 / (1.0 + np.exp(-shape[3])))

    def _jitter(self, shape: Vector) -> float:
        """Return what keeps K positive definite, on its diagonal."""
        return float(_JITTER + _RELATIVE_JITTER * np.exp(2.0 * shape[0])) / self._unit_px**2


def cholesky(matrix: Matrix) -> Matrix | None:
    """Return the lower Cholesky factor, None if the matrix is not positive definite."""
    lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
    return None if info else lower
