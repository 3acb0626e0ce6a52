import numpy as np
import pytest

from lensshift.forward.model import forward_model


def test_wrong_shapes_are_refused():
    A = forward_model((5, 7), 2).operator
    with pytest.raises(ValueError, match=r"expects an array of shape \(10, 14\), got \(14, 10\)"):
        A(np.zeros((14, 10)))
