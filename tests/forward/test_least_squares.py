"""Conjugate gradients and the penalised fits against direct solvers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from lensshift.forward.blur import GaussianBlur
from lensshift.forward.least_squares import (
    NEIGHBOURS,
    conjugate_gradient,
    mean_column_square,
    smooth_fit,
    solve_penalised,
)
from lensshift.forward.model import forward_model
from lensshift.forward.operator import LinearOperator

SHAPE, SCALE = (6, 7), 2
SQUARE_PX = np.array([[-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25], [0.25, 0.25]])


@pytest.fixture
def A() -> LinearOperator:
    return forward_model(SHAPE, SCALE, SQUARE_PX, blur=GaussianBlur(0.3)).operator


def _dense(A: LinearOperator) -> np.ndarray:
    unit = np.eye(A.in_shape[0] * A.in_shape[1]).reshape(-1, *A.in_shape)
    return np.stack([A.forward(x).ravel() for x in unit], axis=1)


def _difference(shape: tuple[int, int], step: np.ndarray) -> sparse.csr_array:
    """Rows x[i + step] - x[i], empty where the neighbour lies outside the image."""
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    D = sparse.lil_array((number.size, number.size))
    for (i, j), here in np.ndenumerate(number):
        other = i + step[0], j + step[1]
        if 0 <= other[0] < shape[0] and 0 <= other[1] < shape[1]:
            D[here, here], D[here, number[other]] = -1.0, 1.0
    return D.tocsr()


@pytest.mark.parametrize("imaginary", [0.0, 1j])
def test_conjugate_gradient_solves_a_random_definite_system(imaginary: complex) -> None:
    rng = np.random.default_rng(1)
    half = rng.standard_normal((30, 30)) + imaginary * rng.standard_normal((30, 30))
    H = half @ half.conj().T + 5.0 * np.eye(30)
    x = rng.standard_normal(30) + imaginary * rng.standard_normal(30)
    x0 = np.zeros_like(x)
    found = conjugate_gradient(lambda v: H @ v, H @ x, x0, 1 / np.diag(H).real, 200, 1e-12)
    np.testing.assert_allclose(found, x, atol=1e-9)
    assert not x0.any(), "the start is not overwritten"


def test_conjugate_gradient_stays_at_the_solution_and_at_zero() -> None:
    def double(v: np.ndarray) -> np.ndarray:
        return 2.0 * v

    x = np.arange(4.0)
    np.testing.assert_array_equal(conjugate_gradient(double, 2 * x, x, np.ones(4), 10), x)
    zero = np.zeros(4)
    np.testing.assert_array_equal(conjugate_gradient(double, zero, zero, np.ones(4), 10), zero)


def test_penalised_fit_equals_a_direct_sparse_solve(A: LinearOperator) -> None:
    rng = np.random.default_rng(2)
    y, weight = rng.random(A.out_shape), rng.random(A.out_shape)
    weight[0, 2:4] = 0.0
    coefficients = rng.uniform(0.01, 0.2, (len(NEIGHBOURS), *A.in_shape))
    matrix = _dense(A)
    H = sparse.csc_array(matrix.T @ (weight.ravel()[:, None] * matrix))
    for step, a in zip(NEIGHBOURS, coefficients, strict=True):
        D = _difference(A.in_shape, step)
        H = H + D.T @ sparse.diags_array(a.ravel()) @ D
    expected = spsolve(H.tocsc(), matrix.T @ (weight * y).ravel()).reshape(A.in_shape)
    found = solve_penalised(
        A, y, weight, coefficients, np.zeros(A.in_shape), 500, tolerance=1e-12
    )  # fmt: skip
    np.testing.assert_allclose(found, expected, atol=1e-8)
    start = rng.standard_normal(A.in_shape)
    for residual in (None, y - A.forward(start)):  # what it leaves, told or found
        found = solve_penalised(
            A, y, weight, coefficients, start, 500, tolerance=1e-12, residual=residual
        )
        np.testing.assert_allclose(found, expected, atol=1e-8)


def test_mean_column_square_is_near_the_mean_of_the_diagonal() -> None:
    A = forward_model((20, 24), SCALE, SQUARE_PX, blur=GaussianBlur(0.3)).operator
    exact = np.mean((_dense(A) ** 2).sum(axis=0))
    assert mean_column_square(A) == pytest.approx(exact, rel=0.1)


def test_smooth_fit_keeps_a_linear_ramp() -> None:
    shape = (12, 15)
    A = forward_model(shape, SCALE, SQUARE_PX, blur=GaussianBlur(0.3)).operator
    row, col = np.indices(A.in_shape)
    ramp = 0.3 + 0.01 * row + 0.02 * col
    found = smooth_fit(A, A.forward(ramp), np.ones(A.out_shape), 0.1, 400)
    # A ramp has no second differences away from the border.
    np.testing.assert_allclose(found[6:-6, 6:-6], ramp[6:-6, 6:-6], atol=2e-3)


def test_smooth_fit_keeps_a_flat_scene_despite_gaps() -> None:
    A = forward_model((12, 15), SCALE, SQUARE_PX, blur=GaussianBlur(0.3)).operator
    weight = np.ones(A.out_shape)
    weight[:, 5, 5:8] = 0.0
    found = smooth_fit(A, np.where(weight > 0, 0.7, 0.0), weight, 0.1, 400)
    np.testing.assert_allclose(found, 0.7, atol=0.01)
