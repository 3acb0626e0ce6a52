"""Quantiles as NumPy's, of any shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from lensshift.core.order import median, median_of_known, quantile

values = arrays(
    np.float64, array_shapes(min_dims=1, max_dims=3, max_side=7), elements=st.floats(-1e6, 1e6)
)


@given(values=values, share=st.floats(0.0, 1.0))
def test_quantiles_are_those_of_numpy(values: np.ndarray, share: float) -> None:
    found = quantile(np.sort(values), share)
    np.testing.assert_allclose(found, np.quantile(values, share, axis=-1), rtol=1e-9, atol=1e-6)


@given(values=values)
def test_medians_are_those_of_numpy(values: np.ndarray) -> None:
    assert median(values) == pytest.approx(float(np.median(values)), rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_medians_of_what_is_known_are_those_of_numpy(axis: int) -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((5, 7, 6))
    values[rng.random(values.shape) < 0.4] = np.nan
    values[0], values[:, 0], values[:, :, 0] = 1.0, 2.0, 3.0  # something is known everywhere
    np.testing.assert_array_equal(median_of_known(values, axis), np.nanmedian(values, axis=axis))
