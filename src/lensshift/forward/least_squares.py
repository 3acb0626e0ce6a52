"""Weighted least squares with a penalty on neighbour differences, by conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lensshift.core.arrays import Array
from lensshift.forward import differences
from lensshift.forward.operator import LinearOperator

NEIGHBOURS = differences.half_plane(1)


def conjugate_gradient(
    apply: Callable[[Array], Array],
    b: Array,
    x0: Array,
    inverse_diagonal: Array,
    iterations: int,
    tolerance: float = 1e-4,
    *,
    residual: Array | None = None,  # b - H x0 if it is known already; it is overwritten
) -> Array:
    """Solve H x = b for a Hermitian positive definite H, preconditioned by its diagonal.

    Stops when the preconditioned residual has shrunk to `tolerance` times that of x = 0. Real and
    complex, single and double precision.

    Source: Hestenes and Stiefel 1952.
    """
    x = x0.copy()
    r = b - apply(x) if residual is None else residual
    z = inverse_diagonal * r
    p = z.copy()
    rz = np.vdot(r, z).real
    enough = tolerance**2 * np.vdot(b, inverse_diagonal * b).real
    for _ in range(iterations):
        if rz <= enough or rz == 0.0:
            break
        q = apply(p)
        step = rz / np.vdot(p, q).real
        x += np.multiply(p, step, out=z)
        r -= np.multiply(q, step, out=q)
        np.multiply(inverse_diagonal, r, out=z)
        rz, before = np.vdot(r, z).real, rz
        p *= rz / before
        p += z
    return x


def mean_column_square(A: LinearOperator, kind: Any = np.float64) -> float:
    """Return the mean of the diagonal of A^T A, estimated with one random vector of signs.

    Parameters
    ----------
    kind : type of number to compute with
    """
    signs = np.random.default_rng(0).choice(np.array([-1.0, 1.0], kind), A.in_shape)
    y = A.forward(signs)
    return float(np.vdot(y, y).real / signs.size)


def solve_penalised(
    A: LinearOperator,
    y: Array,
    weight: Array,
    coefficients: Array,
    x0: Array,
    iterations: int,
    *,
    directions: differences.Directions = NEIGHBOURS,
    column_square: float | None = None,
    tolerance: float = 1e-4,
    residual: Array | None = None,
) -> Array:
    """Minimise sum w |A x - y|^2 + sum_d a_d |D_d x|^2.

        (A^T W A + sum_d D_d^T a_d D_d) x = A^T W y

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col], rows that sum to about 1
    y, weight : [frame row col]
    coefficients : [direction row col] a
    x0 : [row col] start
    column_square : mean of the diagonal of A^T A if it is known, for the preconditioner
    residual : [frame row col] y - A x0 if it is known
    """
    square = mean_column_square(A) if column_square is None else column_square

    def apply(x: Array) -> Array:
        seen = A.forward(x)
        seen *= weight
        out = A.adjoint(seen)
        differences.add_weighted_laplacian(x, coefficients, directions, out)
        return out

    # Each HR pixel is seen with about the same kernel, so its share of A^T A goes with A^T w.
    diagonal = np.maximum(A.adjoint(weight), 0)  # skewed responses have taps below 0
    diagonal *= square * diagonal.size / weight.size
    diagonal += 1e-9 if diagonal.dtype == np.float64 else 1e-6  # where no LR pixel looks
    differences.add_laplacian_diagonal(coefficients, directions, diagonal)
    b = A.adjoint(weight * y)
    rest = None
    if residual is not None:
        rest = np.zeros_like(b)
        differences.add_weighted_laplacian(x0, coefficients, directions, rest)
        rest = A.adjoint(weight * residual) - rest
    return conjugate_gradient(apply, b, x0, 1.0 / diagonal, iterations, tolerance, residual=rest)


def smooth_fit(
    A: LinearOperator,
    y: Array,
    weight: Array,
    stiffness: float,
    iterations: int = 60,
    x0: Array | None = None,
) -> Array:
    """Fit a smooth image: minimise sum w |A x - y|^2 + stiffness |L x|^2, L the mean of D^T D.

    The penalty on second differences makes a soft low pass: what it leaves in the residual are
    the highest frequencies, where there is least of the scene. `x0` is where to start, by default
    at 0. Single precision stays single.
    """
    weight = weight.astype(y.real.dtype, copy=False)
    square = weight.dtype.type(stiffness / len(NEIGHBOURS) ** 2)

    def apply(x: Array) -> Array:
        rough = differences.laplacian(differences.laplacian(x))
        rough *= square
        rough += A.adjoint(weight * A.forward(x))
        return rough

    b = A.adjoint(weight * y)
    start = np.zeros_like(b) if x0 is None else x0
    return conjugate_gradient(apply, b, start, np.ones(A.in_shape, weight.dtype), iterations, 1e-3)
