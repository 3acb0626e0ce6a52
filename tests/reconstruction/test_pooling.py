"""Pixels of one surface share what they know of its distance; those of two do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lensshift.reconstruction.learned import pooling
from lensshift.reconstruction.learned.pooling import pooled_phase

Picture = NDArray[np.float64]
SHAPE = (17, 24)


def drawn(seed: int, phase: Picture, amplitude: Picture, noise: Picture) -> NDArray[np.complex128]:
    """Return phasors of that noise in each component."""
    rng = np.random.default_rng(seed)
    error = rng.standard_normal((2, *SHAPE))
    return amplitude * np.exp(1j * phase) + noise * (error[0] + 1j * error[1])


def pooled(image: NDArray[np.complex128], noise: Picture) -> tuple[Picture, Picture]:
    return pooled_phase(image, noise, noise / np.maximum(np.abs(image), 1e-9))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_surface_gains_and_a_slope_stays(seed: int) -> None:
    rows, cols = np.meshgrid(*map(np.arange, SHAPE), indexing="ij")
    plane, noise = 0.3 + 0.001 * rows - 0.002 * cols, np.full(SHAPE, 0.02)
    image = drawn(seed, plane, np.full(SHAPE, 0.5), noise)
    phase, std = pooled(image, noise)
    inside = np.s_[2:-2, 2:-2]
    own, error = np.angle(image)[inside] - plane[inside], phase[inside] - plane[inside]
    assert np.std(error) < 0.5 * np.std(own)
    assert abs(error.mean()) < 3 * np.std(own) / np.sqrt(own.size)
    assert np.mean(np.abs(error) < 2 * std[inside]) > 0.95


def test_what_is_measured_well_stays() -> None:
    rng = np.random.default_rng(4)
    phase = rng.permutation(np.linspace(-3, 3, 17 * 24)).reshape(SHAPE)  # a surface each
    image, noise = np.exp(1j * phase), np.full(SHAPE, 1e-4)
    found, std = pooled(image, noise)
    np.testing.assert_allclose(np.exp(1j * found), image, atol=1e-5)
    np.testing.assert_allclose(std, 1e-4, rtol=0.02)


@pytest.mark.parametrize("ratio", [0.05, 0.2, 5.0])
def test_a_step_keeps_both_its_sides(ratio: float) -> None:
    """A dark surface before a bright wall is not drawn towards it, nor the wall to it."""
    left = np.broadcast_to(np.arange(SHAPE[1]) < 11, SHAPE)
    amplitude, phase = np.where(left, ratio, 1.0), np.where(left, 0.4, 1.0)
    noise = np.full(SHAPE, 0.01)
    off = []
    for seed in range(8):
        found, _ = pooled(drawn(seed, phase, amplitude, noise), noise)
        off.append(found - phase)
    mean = np.mean(off, axis=(0, 1))[[9, 10, 11, 12]]  # the columns beside the step
    spread = 0.01 / np.minimum(amplitude, 1)[0, [9, 10, 11, 12]]
    assert np.all(np.abs(mean) < 3 * spread / np.sqrt(8 * SHAPE[0]) + 0.02 * spread)


def test_an_unknown_pixel_asks_its_like() -> None:
    """Dark, beside a bright surface, and off by far more than its dark neighbours are."""
    left = np.broadcast_to(np.arange(SHAPE[1]) < 11, SHAPE)
    image = np.where(left, 0.03 * np.exp(1j), np.exp(0.2j))
    noise = np.full(SHAPE, 1e-3)
    image[::5, 10], noise[::5, 10] = 0.02 * np.exp(1.6j), 0.015
    found, std = pooled(image, noise)
    np.testing.assert_allclose(found[::5, 10], 1.0, atol=0.03)
    np.testing.assert_allclose(found[:, 11:], 0.2, atol=1e-3)
    assert np.all(std[::5, 10] < 0.2)


@pytest.mark.parametrize("shape", [(1, 1), (3, 16), (19, 4)])
def test_the_sums_as_they_are_written(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(7)
    a, t, s = rng.uniform(0.5, 1, shape), rng.uniform(0.1, 0.3, shape), rng.uniform(0.1, 0.5, shape)
    phi, m, each = rng.uniform(-np.pi, np.pi, shape), s * rng.uniform(0, 1, shape), 20.0
    found, std = pooled_phase(a * np.exp(1j * phi), t, s, m, each)
    for i, j in np.ndindex(shape):
        near = np.s_[max(i - 6, 0) : i + 7, max(j - 6, 0) : j + 7]
        off = np.angle(np.exp(1j * (phi[near] - phi[i, j])))
        both = s[near] ** 2 + s[i, j] ** 2
        x = off**2 / both + (a[near] - a[i, j]) ** 2 / (t[near] ** 2 + t[i, j] ** 2)
        w = np.maximum(1 - x / 128, 0) ** 64 / both  # the exponential, as it is computed
        moved = np.sum(w * off) / np.sum(w)
        variance = max(np.sum(w * s[near] ** 2), np.sum(w * (off - moved) ** 2)) / np.sum(w)
        n = 2 * s[i, j] ** 2 * np.sum(w)
        variance *= 1 - (m[i, j] / s[i, j]) ** 2 * n / (n + each)
        assert found[i, j] == pytest.approx(phi[i, j] + moved, abs=1e-4)
        assert std[i, j] == pytest.approx(np.sqrt(variance), rel=1e-3)


@pytest.mark.parametrize("cores", [2, 5])
def test_the_picture_does_not_depend_on_the_cores(
    monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    rng = np.random.default_rng(cores)
    noise = rng.uniform(0.05, 0.3, SHAPE)
    image = drawn(cores, rng.uniform(-1, 1, SHAPE), np.ones(SHAPE), noise)
    alone = pooled(image, noise)
    monkeypatch.setattr(pooling, "WORTH_THREADS", 1)
    monkeypatch.setattr(pooling, "core_count", lambda: cores)
    for one, other in zip(pooled(image, noise), alone, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@given(st.integers(0, 2**20), st.floats(-3, 3), st.floats(1e-3, 1e3))
def test_laws(seed: int, turn: float, unit: float) -> None:
    """Turned, scaled, mirrored and transposed phasors give so turned pictures."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(0.05, 0.3, SHAPE)
    image = drawn(seed, rng.uniform(-1, 1, SHAPE), np.ones(SHAPE), noise)
    phase, std = pooled(image, noise)
    for other, back in (
        (pooled(image * np.exp(1j * turn), noise), lambda z: z * np.exp(-1j * turn)),
        (pooled(image * unit, noise * unit), lambda z: z),
    ):
        np.testing.assert_allclose(back(np.exp(1j * other[0])), np.exp(1j * phase), atol=1e-3)
        np.testing.assert_allclose(other[1], std, rtol=1e-2)
    for same in (np.transpose, np.flipud, np.fliplr):
        other = pooled(same(image), same(noise))
        np.testing.assert_allclose(np.exp(1j * other[0]), same(np.exp(1j * phase)), atol=1e-4)
        np.testing.assert_allclose(other[1], same(std), rtol=1e-3)
