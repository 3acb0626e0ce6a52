"""Priors: gradient, majoriser, and the bilateral sum over its full window."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lensshift.forward.differences import add_weighted_laplacian
from lensshift.reconstruction.priors import (
    PRIORS,
    BilateralTotalVariation,
    HuberDifferences,
    Prior,
    TotalVariation,
    squared_differences,
)

SHAPE = (6, 7)
BETA = np.random.default_rng(5).random((4, *SHAPE))
CHOICES: list[Prior] = [
    TotalVariation(0.05),
    HuberDifferences(0.3),
    BilateralTotalVariation(1, 0.5, 0.05),
    BilateralTotalVariation(2, 0.7, 0.05),
    BilateralTotalVariation(1, 0.5, 0.05, beta=BETA),
]


def draw(seed: int, shape: tuple[int, int] = SHAPE, *, phasor: bool = False) -> NDArray:
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(shape)
    return values + 1j * rng.standard_normal(shape) if phasor else values


def gradient(prior: Prior, x: NDArray) -> NDArray:
    """Return the slope that the coefficients say, of a complex x with respect to both parts."""
    out = np.zeros_like(x)
    add_weighted_laplacian(x, 2.0 * prior.coefficients(x), prior.directions, out)
    return out


@pytest.mark.parametrize("prior", CHOICES)
@pytest.mark.parametrize("phasor", [False, True])
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_gradient_is_the_slope_of_the_value(prior: Prior, phasor: bool, seed: int) -> None:
    x, d = draw(seed, phasor=phasor), draw(seed + 1, phasor=phasor)
    h = 1e-6
    slope = (prior.value(x + h * d) - prior.value(x - h * d)) / (2 * h)
    expected = np.vdot(gradient(prior, x), d).real
    assert slope == pytest.approx(expected, abs=1e-6 * (1 + np.linalg.norm(gradient(prior, x))))


@pytest.mark.parametrize("prior", CHOICES)
@pytest.mark.parametrize("phasor", [False, True])
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_quadratic_lies_above_and_touches(prior: Prior, phasor: bool, seed: int) -> None:
    x, z = draw(seed, phasor=phasor), draw(seed + 1, phasor=phasor)
    a = prior.coefficients(x)
    assert a.shape == (len(prior.directions), *SHAPE)
    rise = np.sum(
        a * (squared_differences(z, prior.directions) - squared_differences(x, prior.directions))
    )
    assert prior.value(z) <= prior.value(x) + rise + 1e-9


@pytest.mark.parametrize("prior", CHOICES)
def test_flat_image_costs_nothing(prior: Prior) -> None:
    flat = np.full(SHAPE, 0.7)
    assert prior.value(flat) == pytest.approx(0, abs=1e-12)
    np.testing.assert_array_equal(gradient(prior, flat), 0)


@pytest.mark.parametrize(("window", "alpha"), [(1, 0.5), (2, 0.7), (3, 0.9)])
def test_bilateral_prior_is_the_sum_over_the_full_window(window: int, alpha: float) -> None:
    x, smoothing, total = draw(0), 0.05, 0.0
    reach = range(-window, window + 1)
    for i, j in np.ndindex(*SHAPE):
        for down, right in itertools.product(reach, reach):
            if (down, right) != (0, 0) and 0 <= i + down < SHAPE[0] and 0 <= j + right < SHAPE[1]:
                e = x[i + down, j + right] - x[i, j]
                total += alpha ** (abs(down) + abs(right)) * (np.hypot(e, smoothing) - smoothing)
    prior = BilateralTotalVariation(window, alpha, smoothing)
    assert prior.value(x) == pytest.approx(total, rel=1e-12)


def test_weights_of_one_change_nothing() -> None:
    x, plain = draw(1), BilateralTotalVariation(1, 0.5)
    weighted = BilateralTotalVariation(1, 0.5, beta=np.ones((4, *SHAPE)))
    assert weighted.value(x) == pytest.approx(plain.value(x))
    np.testing.assert_allclose(weighted.coefficients(x), plain.coefficients(x))


def test_registered_by_name() -> None:
    assert {"tv", "huber", "btv"} <= set(PRIORS)
    assert all(make().value(draw(0)) > 0 for make in PRIORS.values())


@pytest.mark.parametrize(("window", "alpha"), [(0, 0.5), (1, 0.0), (1, 1.5)])
def test_bilateral_prior_wants_sense(window: int, alpha: float) -> None:
    with pytest.raises(ValueError, match=r"window|alpha"):
        BilateralTotalVariation(window, alpha)
