"""What every linear operator has to obey."""

import numpy as np

from lensshift.forward.operator import LinearOperator


def check_linear_operator(
    A: LinearOperator, rng: np.random.Generator, *, flat: float | None = 1.0
) -> None:
    """Shapes, adjoint (real and complex), linearity, and a flat scene gives `flat` times itself."""
    for imaginary in (0.0, 1j):
        x, z = _draw(rng, (2, *A.in_shape), imaginary)
        y = _draw(rng, A.out_shape, imaginary)
        # The flattened dot product alone would not notice swapped rows and columns.
        assert A(x).shape == y.shape
        assert A.adjoint(y).shape == x.shape
        size = np.linalg.norm(A(x)) * np.linalg.norm(y) + 1.0
        seen, spread = np.vdot(A(x), y), np.vdot(x, A.adjoint(y))
        np.testing.assert_allclose(seen, spread, rtol=0, atol=1e-13 * size)
        np.testing.assert_allclose(
            A((2 + imaginary) * x - z), (2 + imaginary) * A(x) - A(z), atol=1e-12
        )
    if flat is not None:
        np.testing.assert_allclose(A(np.full(A.in_shape, 3.0)), 3.0 * flat, atol=1e-12)


def _draw(rng: np.random.Generator, shape: tuple[int, ...], imaginary: complex) -> np.ndarray:
    if imaginary == 0:
        return rng.standard_normal(shape)
    return rng.standard_normal(shape) + imaginary * rng.standard_normal(shape)
