import numpy as np
import pytest
from operator_laws import check_linear_operator

from lensshift.forward.model import forward_model
from lensshift.forward.operator import diagonal, stack


def test_diagonal_obeys_the_laws(rng):
    check_linear_operator(diagonal(rng.standard_normal((3, 5))), rng, flat=None)
    check_linear_operator(diagonal(np.array([[1.0, 2j, 1 - 1j]])), rng, flat=None)


def test_the_transpose_obeys_the_laws(rng):
    check_linear_operator(forward_model((5, 7), 2, [[0.1, 0.3]]).operator.T, rng, flat=None)


def test_stacked_frames_equal_the_model_of_the_burst(rng):
    offset_px = [[0.25, 0.1], [-0.4, 0.3]]
    model = forward_model((5, 7), 3, offset_px)
    A = stack([model.frame(offset) for offset in offset_px])
    check_linear_operator(A, rng)
    x = rng.standard_normal(model.hr_shape)
    np.testing.assert_allclose(A(x), model.operator(x), atol=1e-13)


def test_wrong_shapes_are_refused():
    A = forward_model((5, 7), 2).operator
    with pytest.raises(ValueError, match=r"expects an array of shape \(10, 14\), got \(14, 10\)"):
        A(np.zeros((14, 10)))
    with pytest.raises(ValueError, match="same shapes"):
        stack([A, A.T])
    with pytest.raises(ValueError, match="at least one"):
        stack([])
