import numpy as np
import pytest

from lensshift.forward.model import forward_model
from lensshift.forward.operator import LinearOperator, mean_seen


def test_wrong_shapes_are_refused():
    A = forward_model((5, 7), 2).operator
    with pytest.raises(ValueError, match=r"expects an array of shape \(10, 14\), got \(14, 10\)"):
        A(np.zeros((14, 10)))


@pytest.mark.parametrize("seed", range(4))
def test_means_over_what_sees_a_pixel_stay_among_what_they_are_of(seed: int) -> None:
    """Also where taps are below 0; where none is, they are the plain ratio."""
    rng = np.random.default_rng(seed)
    taps = rng.random((30, 20)) - 0.3 * (seed % 2)
    A = LinearOperator((20,), (30,), lambda x: taps @ x, lambda y: taps.T @ y)
    values, weight = rng.random(30), rng.random(30) * (rng.random(30) < 0.5)
    found = mean_seen(A, values, weight)
    assert found.min() >= 0
    assert found.max() <= values[weight > 0].max()
    if seed % 2 == 0:
        np.testing.assert_allclose(found, (taps.T @ (weight * values)) / (taps.T @ weight))
