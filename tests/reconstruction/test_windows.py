"""Means over windows against SciPy, which computes in double precision, and on several cores."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from lensshift.reconstruction import windows
from lensshift.reconstruction.phasor import pooling

KINDS = [(np.float32, 1e-6), (np.float64, 1e-14), (np.complex64, 1e-6), (np.complex128, 1e-14)]


def picture(kind, shape):
    rng = np.random.default_rng(4)
    x = rng.standard_normal(shape)
    return (x + 1j * rng.standard_normal(shape) if np.dtype(kind).kind == "c" else x).astype(kind)


@pytest.mark.parametrize(("kind", "tolerance"), KINDS)
@pytest.mark.parametrize("shape", [(2, 13, 22), (1, 3, 2), (1, 1, 30), (17, 5)])
def test_means_are_those_of_scipy(kind, tolerance, shape):
    x = picture(kind, shape)
    for size_px in (1, 3, 9):
        sizes = (*(1,) * (x.ndim - 2), size_px, size_px)
        for mirrored, mode in ((False, "constant"), (True, "reflect")):
            found = windows.mean_around(x, size_px, mirrored=mirrored)
            assert found.dtype == x.dtype
            expected = uniform_filter(x.astype(np.complex128), sizes, mode=mode)
            np.testing.assert_allclose(found, expected, atol=tolerance)
    expected = gaussian_filter(x.astype(np.complex128), 2.6, axes=(-2, -1))
    np.testing.assert_allclose(windows.gaussian_around(x, 2.6), expected, atol=tolerance)


def test_views_are_read_as_they_are():
    x = picture(np.float32, (9, 8, 14))[::2, :, ::3].mT
    expected = windows.mean_around(x.copy(), 3)
    np.testing.assert_array_equal(windows.mean_around(x, 3), expected)


@pytest.mark.parametrize("cores", [2, 3])
def test_pictures_do_not_depend_on_the_cores(monkeypatch, cores):
    x, z = picture(np.float32, (3, 23, 40)), picture(np.complex128, (23, 40))
    std, std_rad = 0.1 + np.abs(picture(np.float64, (2, 23, 40)))
    expected = windows.gaussian_around(x, 2.0), *pooling.pooled_phase(z, std, std_rad)
    for module in (windows, pooling):
        monkeypatch.setattr(module, "WORTH_THREADS", 1)
        monkeypatch.setattr(module, "core_count", lambda: cores)
    found = windows.gaussian_around(x, 2.0), *pooling.pooled_phase(z, std, std_rad)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
