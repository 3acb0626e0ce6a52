"""Differences between HR neighbours against NumPy slices and a sparse matrix."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from lensshift.forward.differences import (
    add_laplacian_diagonal,
    add_weighted_laplacian,
    differences,
    half_plane,
    laplacian,
)

SHAPES = [(7, 5), (4, 9), (1, 6), (6, 1), (1, 1), (2, 2)]
TYPES = [np.float32, np.float64, np.complex64, np.complex128]


def difference_matrix(
    shape: tuple[int, int], directions: NDArray[np.int64]
) -> scipy.sparse.csr_array:
    """Return the matrix from the raveled image to the raveled [direction row col]."""
    rows, cols = shape
    matrix = scipy.sparse.lil_array((len(directions) * rows * cols, rows * cols))
    for d, (down, right) in enumerate(directions):
        for i in range(rows):
            for j in range(cols):
                if 0 <= i + down < rows and 0 <= j + right < cols:
                    entry = (d * rows + i) * cols + j
                    matrix[entry, (i + down) * cols + j + right] = 1
                    matrix[entry, i * cols + j] = -1
    return matrix.tocsr()


def draw(rng: np.random.Generator, shape: tuple[int, ...], dtype: type) -> NDArray:
    values = rng.standard_normal(shape)
    if np.issubdtype(dtype, np.complexfloating):
        values = values + 1j * rng.standard_normal(shape)
    return values.astype(dtype)


def close(dtype: type) -> dict[str, float]:
    return {"rtol": 0, "atol": 200 * np.finfo(dtype).eps}


@pytest.mark.parametrize("window", [1, 2, 3])
def test_half_plane_keeps_one_of_each_pair(window: int) -> None:
    kept = [tuple(d) for d in half_plane(window)]
    assert len(kept) == len(set(kept)) == ((2 * window + 1) ** 2 - 1) // 2
    assert not {(-row, -col) for row, col in kept} & set(kept)
    assert all(row >= 0 for row, _ in kept)


def test_half_plane_wants_a_window() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        half_plane(0)


def test_window_1_in_the_documented_order() -> None:
    np.testing.assert_array_equal(half_plane(1), [(0, 1), (1, 0), (1, 1), (1, -1)])


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("window", [1, 2, 3])
@pytest.mark.parametrize("shape", SHAPES)
def test_all_kernels_equal_a_sparse_matrix(
    shape: tuple[int, int], window: int, dtype: type
) -> None:
    rng = np.random.default_rng(0)
    directions = half_plane(window)
    stack = (len(directions), *shape)
    D = difference_matrix(shape, directions)
    x, start = draw(rng, shape, dtype), draw(rng, shape, dtype)
    a = rng.random(stack).astype(x.real.dtype)

    found = differences(x, directions)
    assert found.dtype == dtype
    np.testing.assert_allclose(found.ravel(), D @ x.ravel(), **close(dtype))

    out = start.copy()
    add_weighted_laplacian(x, a, directions, out)
    expected = D.T @ (a.ravel() * (D @ x.ravel()))
    np.testing.assert_allclose((out - start).ravel(), expected, **close(dtype))

    diagonal = np.zeros(shape, a.dtype)
    add_laplacian_diagonal(a, directions, diagonal)
    expected = (D.T @ scipy.sparse.diags_array(a.ravel()) @ D).diagonal()
    np.testing.assert_allclose(diagonal.ravel(), expected, **close(dtype))


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_laplacian_equals_a_sparse_matrix_whatever_the_level(
    shape: tuple[int, int], dtype: type
) -> None:
    directions = half_plane(1)
    D = difference_matrix(shape, directions)
    x = draw(np.random.default_rng(0), shape, dtype)
    length = np.repeat(np.hypot(*directions.T), x.size)
    expected = D.T @ ((D @ x.ravel()) / length)
    found = laplacian(x)
    assert found.dtype == dtype
    np.testing.assert_allclose(found.ravel(), expected, **close(dtype))
    hot = np.ones(shape, dtype) * dtype(290.0)
    np.testing.assert_array_equal(laplacian(hot), 0.0)
    # What is left is the rounding of x + 290 itself, in each of up to eight differences.
    rounding = 16 * 290.0 * np.finfo(dtype).eps
    np.testing.assert_allclose(laplacian(x + hot), found, rtol=0, atol=rounding)


def test_differences_are_the_numpy_slices() -> None:
    x = np.random.default_rng(1).standard_normal((6, 8))
    out = differences(x, half_plane(1))
    np.testing.assert_array_equal(out[0, :, :-1], x[:, 1:] - x[:, :-1])
    np.testing.assert_array_equal(out[1, :-1], x[1:] - x[:-1])
    np.testing.assert_array_equal(out[2, :-1, :-1], x[1:, 1:] - x[:-1, :-1])
    np.testing.assert_array_equal(out[3, :-1, 1:], x[1:, :-1] - x[:-1, 1:])
    assert not out[0, :, -1].any()
    assert not out[3, :, 0].any()
