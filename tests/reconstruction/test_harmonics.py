"""What the std of bars holds that no pixel sees."""

from __future__ import annotations

import numpy as np
import pytest
from mosaic import observe
from numpy.typing import NDArray

from lensshift import Burst, reconstruct
from lensshift.reconstruction.learned.harmonics import as_bars

SHAPE, SAMPLES, MARGIN_PX = (21, 26), 12, 2
SQUARE_PX = 12**-0.5
BLIND = 1 / 3  # cycles per LR pixel: the third harmonic of it is where the pixel sees nothing
Array = NDArray[np.float64]


def canvas(frequency: float, *, bars: bool, turn: float = 0.0, phase: float = 0.4) -> Array:
    """Return a wave on the fine grid of frames: a sine, or bars of the same first harmonic."""
    rows, cols = ((n + 2 * MARGIN_PX) * SAMPLES for n in SHAPE)
    row, col = np.arange(rows)[:, None] / SAMPLES, np.arange(cols) / SAMPLES
    angle = 2 * np.pi * frequency * (row * np.sin(turn) + col * np.cos(turn)) + phase
    wave = np.sin(angle)
    return 0.5 + 0.3 * (np.sign(wave) if bars else 4 / np.pi * wave)


def inner(image: Array) -> Array:
    return image[..., 6:-6, 6:-6]


@pytest.mark.parametrize(("turn", "seed"), [(0.0, 0), (0.0, 1), (0.35, 2), (1.2, 3)])
@pytest.mark.parametrize("bars", [False, True])
def test_bars_lie_within_the_std_of_a_sine_and_a_sine_within_that_of_bars(
    turn: float, seed: int, bars: bool
) -> None:
    """Frames of both are the same to the noise: one picture has to hold both."""
    rng = np.random.default_rng(seed)
    seen, other = (
        observe(canvas(BLIND, bars=b, turn=turn), SHAPE, scale=2, snr=50, rng=rng)
        for b in (bars, not bars)
    )
    burst = Burst.from_arrays(seen.y, offset_px=seen.offset_px, pitch_mm=0.1)
    found = reconstruct(burst, 2).amplitude
    for truth in (seen.truth, other.truth):
        assert np.mean(inner(np.abs(found.image - truth)) < 2 * inner(found.std)) > 0.8


def test_a_hidden_harmonic_is_a_third_of_what_is_seen() -> None:
    """Long bars along the grid: p(3 f) / p(f) of a third of the amplitude, and higher ones."""
    col = np.arange(240) / 4  # of an LR pixel
    image = np.broadcast_to(np.sin(2 * np.pi * BLIND * (col + 0.1)), (40, 240))
    std = as_bars(image, np.zeros(image.shape), SQUARE_PX, 4)
    harmonics = [np.sinc(n * BLIND / 4) / n / np.sinc(BLIND / 4) for n in (3, 5, 7)]
    expected = np.sqrt(np.sum(np.square(harmonics)) / 2)
    np.testing.assert_allclose(std[10:-10, 100:-100], expected, rtol=0.05)


@pytest.mark.parametrize("frequency", [0.05, 0.1, 0.15, 0.2])
def test_bars_whose_harmonics_are_seen_have_the_std_they_had(frequency: float) -> None:
    image = canvas(frequency, bars=True)[::6, ::6]
    told = np.full(image.shape, 0.01)
    np.testing.assert_allclose(inner(as_bars(image, told, SQUARE_PX, 2)), 0.01, rtol=0.1)


def test_noise_edges_and_narrow_pixels_hide_nothing() -> None:
    rng = np.random.default_rng(5)
    edge = np.zeros((31, 45))
    edge[:, 22:] = 1.0
    for image in (edge, rng.standard_normal((31, 45))):
        told = np.full(image.shape, 0.03)
        np.testing.assert_allclose(as_bars(image, told, SQUARE_PX, 2), told)
    bars = canvas(BLIND, bars=False)[::6, ::6]
    narrow = as_bars(bars, np.zeros(bars.shape), 0.3 * SQUARE_PX, 2)
    assert np.max(narrow) < 0.1 * np.max(as_bars(bars, np.zeros(bars.shape), SQUARE_PX, 2))


def test_levels_turns_and_mirrors_change_nothing() -> None:
    image = canvas(BLIND, bars=False, turn=0.35)[::6, ::6]
    none = np.zeros(image.shape)
    std = as_bars(image, none, SQUARE_PX, 2)
    np.testing.assert_allclose(as_bars(image + 290.0, none, SQUARE_PX, 2), std, atol=1e-4)
    np.testing.assert_allclose(as_bars(image.T, none.T, SQUARE_PX, 2).T, std, atol=1e-5)
    np.testing.assert_allclose(as_bars(image[::-1], none, SQUARE_PX, 2)[::-1], std, atol=1e-5)


def test_bars_of_light_are_along_a_phasor_and_bars_of_distance_across() -> None:
    bars, both = canvas(BLIND, bars=False)[::6, ::6], np.zeros((2, 50, 60))
    along, across = as_bars(bars * np.exp(0.7j), both, SQUARE_PX, 2)
    assert np.median(along) > 0.05 > 1e3 * np.median(across)
    along, across = as_bars(np.exp(0.1j * bars), both, SQUARE_PX, 2)
    assert np.median(across) > 5 * np.median(along)
