"""What is known of an edge's response before a pixel is seen: normal distributions, and limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector
from lensshift.evaluation.slanted_edge.kernels import heights_covariance, heights_slopes

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
HYPER_PRIOR = np.array([
    _LOG_SIGMA, _ROOT_SHRINKAGE, _ROOT_TAIL, _LOG_TAIL_WIDTH, _SLOW, _PLACE,
    _LOG_AMPLITUDE, _LOG_LENGTH, _LOG_TAIL, _LOGIT_SYMMETRY,
])  # fmt: skip
BASE_HYPERS = 6  # the first are of the base model, the others of the splines
HYPERS = len(HYPER_PRIOR)
HYPER_BOUNDS = np.array([
    (-2.5, 2.0), (-1.1, 1.1), (-1.0, 1.0), (-1.0, 3.0), (-1.0, 2.0), (-1.0, 1.0),
    (-9.0, 0.5), (-1.4, 1.1), (-1.4, 3.5), (-8.0, 8.0),
])  # fmt: skip
# At shrinkage 0 and tail 0 the likelihood is level and would hold a descent: start beside it.
START = np.array([*HYPER_PRIOR[:1, 0], 0.2, 0.2, *HYPER_PRIOR[3:, 0]])
# Typical sizes of a step.
STEPS = np.array([0.1, 0.1, 0.1, 0.3, 0.2, 0.005, 0.5, 0.2, 0.3, 1.0])
_ROOT_HALF, _ROOT_2 = np.sqrt(0.5), np.sqrt(2.0)
PLACE = 5  # which of the parameters is the place of the base, in units of the width


class SplinePrior:
    """Covariance of the spline coefficients, a Gaussian process on the knots.

        K(x, x') = a^2 e(x) e(x') [k(x - x') + m k(x + x')]
        k(d) = exp(-d^2 / 2 l^2),  e(x) = 1 / (1 + (x / t)^2)

    with amplitude a, length l, tail t and symmetry m, given as log a, log l, log t, logit m.

    The fit knows it by heights: by how much the splines up to a knot raise the response,

        h_i = sum of (area times coefficient) of the splines j <= i

    for the pixels near a knot see neighbouring heights alone.

    basis : splines of the LSF
    unit_px : width by which the prior is scaled, 1 for an edge a pixel wide
    """

    def __init__(self, basis: SplineBasis, unit_px: float) -> None:
        self._number = np.concatenate([-basis.number[:0:-1], basis.number])
        self._place = self._number * basis.step_px / unit_px
        self._unit_px = unit_px
        self._middle = basis.number.size - 1
        half = basis.area_px[: basis.number.size]
        half[1:] *= _ROOT_HALF  # functions that are even hold two splines over the root of 2
        self._area_px = np.concatenate([half[:0:-1], half])
        self._lags = basis.step_px / unit_px * np.arange(2 * basis.number[-1] + 1)

    def covariance(self, shape: Vector) -> Matrix:
        """Return the covariance of the heights [j j] of a shape [4] (a, l, t, m as above)."""
        near, weight = self._near_and_weight(shape)
        heights = np.empty((self._number.size,) * 2)
        heights_covariance(self._number, weight, near, float(_symmetry(shape)), heights)
        return heights

    def gradient(self, shape: Vector, by_covariance: Matrix) -> Vector:
        """Return the gradient [4] of a value whose derivative by the covariance is given."""
        near, weight = self._near_and_weight(shape)
        length, tail = np.exp(shape[1:3])
        longer, shares = (self._lags / length) ** 2 * near, (self._place / tail) ** 2
        wider, m = 2.0 * shares / (1.0 + shares), float(_symmetry(shape))
        slopes = heights_slopes(by_covariance, self._number, weight, near, longer, wider, m)
        return np.asarray(np.array(slopes) * np.array([1.0, 1.0, 1.0, m * (1.0 - m)]))

    def white(self, count: int, rng: np.random.Generator) -> NDArray[np.complex128]:
        """Return white noise [count f] for `drawn`."""
        noise = rng.standard_normal((self._lags.size, count, 2)).view(complex)[..., 0]
        noise[[0, -1]] *= _ROOT_2  # they have no imaginary part
        return noise.T

    def drawn(self, shapes: Matrix, white: NDArray[np.complex128]) -> Matrix:
        """Return heights [j k] of the prior, one draw of each of the shapes [k 4].

        A process of covariance k on an even grid, drawn in Fourier space, and its mirror image:
        p g(x) + q g(-x) has the covariance k(x - x') + m k(x + x') where p^2 + q^2 = 1, 2 p q = m.

        Source: circulant embedding, Dietrich and Newsam, SIAM J. Sci. Comput. 18 (1997) 1088.
        """
        near, weight = self._near_and_weight(shapes)
        ring = np.hstack([near, near[:, -2:0:-1]])
        size = ring.shape[1]
        root = np.sqrt(0.5 * size * np.maximum(np.fft.rfft(ring).real, 0.0))
        process = np.fft.irfft(root * white, size)
        m = _symmetry(shapes)[:, None]
        both, apart = np.sqrt(1.0 + m), np.sqrt(1.0 - m)
        own = (both + apart) * process[:, self._number] + (both - apart) * process[:, -self._number]
        return np.cumsum(0.5 * weight * own, axis=1).T

    def coefficients(self, heights: Matrix) -> Matrix:
        """Return the coefficients of the even and odd functions [j ...] that make heights."""
        own = (np.diff(heights, axis=0, prepend=0.0).T / self._area_px).T
        right, left = own[self._middle + 1 :], own[: self._middle][::-1]
        middle = own[self._middle : self._middle + 1]
        return np.concatenate([middle, (right + left) * _ROOT_HALF, (right - left) * _ROOT_HALF])

    def by_heights(self, sums: Matrix) -> Matrix:
        """Return sums over splines [j ...] as those over what each height adds to the response."""
        even, odd = sums[: self._middle + 1], sums[self._middle + 1 :]
        right, left = (even[1:] + odd) * _ROOT_HALF, (even[1:] - odd) * _ROOT_HALF
        own: Matrix = (np.concatenate([left[::-1], even[:1], right]).T / self._area_px).T
        own[:-1] -= own[1:]
        return own

    def _near_and_weight(self, shape: Vector | Matrix) -> tuple[Matrix, Matrix]:
        """Return k [... l] at all lags, and a e times the area [... j] at all knots."""
        amplitude, length, tail = (np.exp(shape[..., k, None]) for k in range(3))
        near = np.exp(-0.5 * (self._lags / length) ** 2)
        weight = amplitude / self._unit_px * self._area_px / (1.0 + (self._place / tail) ** 2)
        return near, weight


def _symmetry(shape: Vector | Matrix) -> Vector:
    return np.asarray(1.0 / (1.0 + np.exp(-shape[..., 3])))
