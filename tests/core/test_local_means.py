"""Means around each pixel are those of SciPy, of all kinds of values and at all borders."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from lensshift.core.local_means import gaussian_around, mean_around


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (7, 3), (3, 16, 21), (2, 2, 8, 5)])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.complex64, np.complex128])
@pytest.mark.parametrize("side_px", [1, 3, 9])
def test_means_are_those_of_scipy(shape, kind, side_px):
    rng = np.random.default_rng(1)
    values = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex128)
    values = (values if np.dtype(kind).kind == "c" else values.real).astype(kind)
    size = (1,) * (len(shape) - 2) + (side_px, side_px)
    tolerance = 1e-6 if np.finfo(kind).precision < 10 else 1e-14
    for zeros, mode in ((True, "constant"), (False, "reflect")):
        found = mean_around(values, side_px, zeros=zeros)
        assert found.dtype == kind
        np.testing.assert_allclose(found, uniform_filter(values, size, mode=mode), atol=tolerance)
    sigma = (0,) * (len(shape) - 2) + (side_px / 2, side_px / 2)
    found = gaussian_around(values, side_px / 2)
    np.testing.assert_allclose(found, gaussian_filter(values, sigma), atol=tolerance)


def test_what_is_no_float_is_double_and_nothing_changes_what_came_in():
    values = np.arange(30).reshape(5, 6).T
    before = values.copy()
    found = mean_around(values, 3)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, uniform_filter(values.astype(float), 3))
    np.testing.assert_array_equal(values, before)


def test_what_is_not_a_number_stays_within_its_window():
    values = np.ones((9, 12))
    values[4, 5] = np.nan
    hit = np.isnan(mean_around(values, 3, zeros=True))
    assert hit[3:6, 4:7].all()
    assert hit.sum() == 9
