"""Lenses whose light goes far: the exact transform, and edges made from it."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge import measure_edge
from lensshift.evaluation.slanted_edge.edge_model import (
    SplineBasis,
    Tail,
    edge_parts,
    edge_response_transform,
)

Vector = NDArray[np.float64]
pytestmark = pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
ANGLE = np.deg2rad(7.0)


def gaussian(f: Vector, sigma_px: float) -> Vector:
    return np.exp(-2.0 * (np.pi * sigma_px * f) ** 2)


def diffraction(f: Vector) -> Vector:
    u = np.clip(np.abs(f) / 0.8, 0.0, 1.0)
    return 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u * u))


def ghost(f: Vector) -> Vector:
    return gaussian(f, 0.45) * (0.9 + 0.1 * np.exp(-2j * np.pi * f * 9.0))


def halo(f: Vector) -> Vector:
    return 0.88 * gaussian(f, 0.5) + 0.12 / (1.0 + (2.0 * np.pi * 4.0 * f) ** 2)


def seen(optics: Callable[[Vector], Vector], f: Vector) -> Vector:
    return optics(f) * np.sinc(f * np.cos(ANGLE)) * np.sinc(f * np.sin(ANGLE))


def edge(optics: Callable[[Vector], Vector], place_px: float) -> Vector:
    """Return 41 x 63 pixels, from the Fourier series of a square wave of period 2048 px."""
    order = np.arange(1, 2048 * 16, 2)
    wave = seen(optics, order / 2048.0) * 2.0 / (1j * np.pi * order)
    row, col = (np.arange(n) - (n - 1) / 2 for n in (41, 63))
    normal = (col * np.cos(ANGLE) + row[:, None] * np.sin(ANGLE) - place_px).ravel()
    grid = np.arange(2048 * 64) / 64.0
    spectrum = np.zeros(2048 * 32 + 1, dtype=complex)
    spectrum[order] = 0.5 * wave * grid.size
    response = 0.5 + np.fft.irfft(spectrum, grid.size)
    return np.interp(normal % 2048.0, grid, response).reshape(41, 63)


@pytest.mark.parametrize("optics", [diffraction, halo, ghost])
def test_light_far_from_the_edge_is_not_taken_for_plateau(
    optics: Callable[[Vector], Vector],
) -> None:
    """A spline that ended 6 px from the edge was 3, 4 and 14 % high here, and never covered."""
    frequency = np.linspace(0.0, 1.0, 10_001)
    truth = np.abs(seen(optics, frequency))
    half = frequency[np.argmax(truth < 0.5)]
    rng = np.random.default_rng(11)
    errors, covered = [], 0
    for place_px in (-0.7, -0.3, 0.1, 0.4, 0.8):
        image = edge(optics, place_px) + 0.004 * rng.standard_normal((41, 63))
        found = measure_edge(image, region=(0, 41, 0, 63))
        errors.append(found.mtf50_lpmm.value / half - 1.0)
        covered += found.mtf50_lpmm.low <= half <= found.mtf50_lpmm.high
    assert np.max(np.abs(errors)) < 0.015
    assert covered >= 3  # of 5: at 95 %, three misses are one in a thousand


def test_a_far_ghost_waves_between_the_steps_of_the_curve() -> None:
    """A straight line over 0.01 cycles a pixel put MTF50 1.2 % too high."""

    def far(f: Vector) -> Vector:
        return gaussian(f, 0.83) * (0.88 + 0.12 * np.exp(-2j * np.pi * f * 14.9))

    frequency = np.linspace(0.0, 1.0, 10_001)
    half = frequency[np.argmax(np.abs(seen(far, frequency)) < 0.5)]
    rng = np.random.default_rng(12)
    for place_px in (-0.4, 0.3):
        image = edge(far, place_px) + 0.001 * rng.standard_normal((41, 63))
        found = measure_edge(image, region=(0, 41, 0, 63)).mtf50_lpmm
        assert found.value == pytest.approx(half, rel=0.003)


def test_the_tail_of_the_base_is_its_transform() -> None:
    """The response of a step is the transform of the LSF over 2 pi i f."""
    normal = np.linspace(-30.0, 30.0, 6001)
    tail = Tail(0.3, 1.7, 0.6)
    parts = edge_parts(normal, ANGLE, 0.4, 0.8, tail.width_px)
    rise = np.gradient(tail.shares @ parts[:, 0], normal)
    for f in (0.05, 0.2, 0.45):
        # What the window leaves out of the Lorentzian: 2 w / (pi) int_30^inf cos(2 pi f x) / x^2.
        x = np.arange(30.0, 3000.0, 0.01)
        rest = 2.0 * 0.3 * 0.6 * 1.7 / np.pi * np.trapezoid(np.cos(2.0 * np.pi * f * x) / x**2, x)
        found = np.trapezoid(rise * np.cos(2.0 * np.pi * f * normal), normal) + rest
        expected = edge_response_transform(np.array([f]), ANGLE, 0.4, 0.8, tail)[0]
        assert found == pytest.approx(expected, abs=2e-4)


def test_wide_splines_are_sums_of_narrow_ones() -> None:
    basis = SplineBasis.covering(30.0, 0.25, 1.0)
    assert basis.number.size < 0.6 * basis.narrow_px.size
    evens = basis.number.size  # the middle one, and pairs over the root of two
    even = basis.parts[:, :evens] @ np.append(1.0, np.full(evens - 1, np.sqrt(2.0)))
    inside = np.abs(basis.narrow_px) < 28.0
    np.testing.assert_allclose(even[inside], 1.0, atol=1e-12)
    # A ghost as narrow as a pixel, 10 px away, is followed.
    place = np.linspace(-20.0, 20.0, 2001)
    wanted = np.exp(-0.5 * ((place - 10.0) / 0.5) ** 2)
    values = basis.values(place)
    rest = wanted - values @ np.linalg.lstsq(values, wanted)[0]
    assert np.max(np.abs(rest)) < 0.02
