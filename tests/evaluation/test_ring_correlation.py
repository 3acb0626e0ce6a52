"""The correlation is what signal and noise of known power say."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.ring_correlation import RingCorrelation, fourier_ring_correlation

Floats = NDArray[np.float64]
SHAPE, PITCH_MM = (61, 127), (0.15, 0.1)


def white(shape: tuple[int, int], seed: int) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape)


def signal(shape: tuple[int, int], pitch_mm: tuple[float, float], seed: int) -> Floats:
    """Return noise of spectrum exp(-(f / 2 lp/mm)^2) in power; that of `white` is 1."""
    row_lpmm, col_lpmm = (np.fft.fftfreq(n, p) for n, p in zip(shape, pitch_mm, strict=True))
    power = 9 * np.exp(-(row_lpmm[:, None] ** 2 + col_lpmm**2) / 4)
    return np.real(np.fft.ifft2(np.sqrt(power) * np.fft.fft2(white(shape, seed))))


def test_images_of_little_noise_agree_everywhere() -> None:
    image = white(SHAPE, 0)
    other = image + 1e-3 * white(SHAPE, 1)
    ring = fourier_ring_correlation(image, 3 * other - 2, pitch_mm=PITCH_MM)
    assert ring.correlation == pytest.approx(np.ones_like(ring.correlation), abs=1e-4)
    assert ring.cutoff_lpmm is None
    assert ring.fixed_cutoff_lpmm is None
    opposite = fourier_ring_correlation(image, -other, pitch_mm=PITCH_MM)
    assert opposite.correlation == pytest.approx(-ring.correlation, abs=1e-9)
    assert opposite.cutoff_lpmm == 0.0
    assert opposite.fixed_cutoff_lpmm == 0.0


@pytest.mark.parametrize("moved", [(3, 5), (-1, 0), (0, -7)])
def test_images_that_lie_apart_are_told(moved: tuple[int, int]) -> None:
    scene = signal((96, 110), (0.1, 0.1), 3)
    first, second = (scene + 0.5 * white(scene.shape, seed) for seed in (1, 2))
    apart = np.roll(second, moved, (0, 1))
    told = f"{moved[0]} rows and {moved[1]} columns apart"
    with pytest.warns(QualityWarning, match=told):
        fourier_ring_correlation(first, apart, pitch_mm=0.1)
    noise = [white(scene.shape, seed) for seed in (8, 9)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fourier_ring_correlation(first, second, pitch_mm=0.1)
        fourier_ring_correlation(first, -second, pitch_mm=0.1)
        fourier_ring_correlation(*noise, pitch_mm=0.1)


@pytest.mark.parametrize("window", [False, True])
def test_an_image_with_itself_is_refused(window: bool) -> None:
    image = white(SHAPE, 0)
    for same in (image, 3 * image - 2, -image):
        with pytest.raises(ValueError, match="one image twice"):
            fourier_ring_correlation(image, same, pitch_mm=PITCH_MM, window=window)


def test_rings_end_at_the_smaller_nyquist_frequency() -> None:
    ring = fourier_ring_correlation(white(SHAPE, 0), white(SHAPE, 1), pitch_mm=PITCH_MM)
    width_lpmm = 1 / (61 * 0.15)  # 9.2 mm high, 12.7 mm wide
    assert len(ring.frequency_lpmm) == 30
    assert np.diff(ring.frequency_lpmm) == pytest.approx(np.full(29, width_lpmm), rel=0.1)
    assert ring.frequency_lpmm[-1] == pytest.approx(1 / 0.3, rel=0.02)
    # A ring of radius r has 2 pi r / (cells of Fourier space) samples.
    plain = fourier_ring_correlation(
        white(SHAPE, 0), white(SHAPE, 1), pitch_mm=PITCH_MM, window=False
    )
    cell_lpmm2 = 1 / (61 * 0.15 * 127 * 0.1)
    expected = 2 * np.pi * plain.frequency_lpmm * width_lpmm / cell_lpmm2
    assert plain.samples[5:] == pytest.approx(expected[5:], rel=0.15)
    assert plain.samples.sum() == pytest.approx(expected.sum(), rel=0.01)


@pytest.mark.parametrize("window", [True, False])
def test_independent_noise_scatters_by_the_number_of_samples(window: bool) -> None:
    rings = [
        fourier_ring_correlation(white(SHAPE, k), white(SHAPE, 1000 + k), pitch_mm=0.1,
                                 window=window)
        for k in range(40)
    ]  # fmt: skip
    scaled = np.array([ring.correlation for ring in rings]) * np.sqrt(rings[0].samples)
    assert scaled.std() == pytest.approx(1.0, abs=0.08)
    assert scaled.mean() == pytest.approx(0.0, abs=0.1)


def test_known_signal_to_noise_ratio() -> None:
    total = []
    for k in range(40):
        scene = signal(SHAPE, PITCH_MM, k)
        noisy = [scene + white(SHAPE, 100 * (1 + k) + frame) for frame in range(2)]
        total.append(fourier_ring_correlation(*noisy, pitch_mm=PITCH_MM).correlation)
    ring = fourier_ring_correlation(*noisy, pitch_mm=PITCH_MM)
    ratio = 9 * np.exp(-((ring.frequency_lpmm / 2) ** 2))
    error = np.mean(total, axis=0) - ratio / (ratio + 1)
    # Noise of 40 pairs; the window mixes neighbouring rings a little where the spectrum bends.
    assert np.max(np.abs(error[2:])) < 0.05


def test_cutoffs_are_where_the_power_says() -> None:
    scene = signal((181, 255), (0.1, 0.1), 3)
    noisy = [scene + white((181, 255), seed) for seed in (4, 5)]
    ring = fourier_ring_correlation(*noisy, pitch_mm=0.1)
    # 1/7 = S/(S+N) at S/N = 1/6.
    assert ring.fixed_cutoff_lpmm == pytest.approx(2 * np.sqrt(np.log(54)), rel=0.08)
    # The threshold of few samples is higher: half a bit where S/(S+N) = T.
    ratio = 9 * np.exp(-((ring.frequency_lpmm / 2) ** 2))
    above = ring.frequency_lpmm[ratio / (ratio + 1) > ring.half_bit]
    assert ring.cutoff_lpmm == pytest.approx(above[-1], rel=0.08)


def test_half_bit_threshold_of_many_and_of_one_sample() -> None:
    ring = fourier_ring_correlation(white((301, 401), 0), white((301, 401), 1), pitch_mm=1.0)
    # Limits of the formula: 0.2071 / 1.2071 for many samples, 1 for one.
    assert ring.half_bit[-1] == pytest.approx(0.1716, abs=0.06)
    assert np.all(ring.half_bit > 0.1716)
    root = np.sqrt(ring.samples[0])
    assert ring.half_bit[0] == pytest.approx((0.2071 * root + 1.9102) / (1.2071 * root + 0.9102))


def test_window_removes_the_jump_at_the_border() -> None:
    # A common ramp jumps at the border and would be seen as agreement at all frequencies.
    rows, cols = np.mgrid[:61, :127]
    ramp = 1.0 * rows + 0.5 * cols
    first, second = ramp + white(SHAPE, 0), ramp + white(SHAPE, 1)
    with_window = fourier_ring_correlation(first, second, pitch_mm=0.1)
    without = fourier_ring_correlation(first, second, pitch_mm=0.1, window=False)
    assert abs(with_window.correlation[15:].mean()) < 0.1
    assert without.correlation[15:].mean() > 0.2


@given(gain=st.floats(0.01, 100), offset=st.floats(-50, 50), seed=st.integers(0, 100))
def test_gain_offset_and_order_do_not_matter(gain: float, offset: float, seed: int) -> None:
    first = signal((21, 33), (0.1, 0.1), seed)
    second = first + white((21, 33), seed + 1000)
    rings = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        for pair in ((first, second), (gain * second + offset, first)):
            rings.append(fourier_ring_correlation(*pair, pitch_mm=0.1))
    assert rings[1].correlation == pytest.approx(rings[0].correlation, abs=1e-6)


def test_small_images_warn() -> None:
    def correlate(shape: tuple[int, int]) -> RingCorrelation:
        return fourier_ring_correlation(white(shape, 0), white(shape, 1), pitch_mm=0.15)

    with pytest.warns(QualityWarning, match=r"median of 8 rings has 47 .* scatters by 0\.15"):
        assert len(correlate((16, 64)).correlation) == 8
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        correlate((64, 256))


GOOD = white((9, 11), 0)


@pytest.mark.parametrize(
    ("first", "second", "pitch_mm", "message"),
    [
        (GOOD, GOOD.T, 0.1, r"one shape, got \(9, 11\) and \(11, 9\)"),
        (GOOD, GOOD[0], 0.1, r"second image as \[row col\]"),
        (GOOD[:7], GOOD[:7], 0.1, "at least 8 pixels a side"),
        (GOOD * 1j, GOOD, 0.1, "real first image, got dtype complex128"),
        (GOOD, np.where(GOOD > 0, np.inf, 0.0), 0.1, "infinite in the second image"),
        (GOOD, np.full((9, 11), 3.1), 0.1, "contrast, got a constant 3.1"),
        (GOOD, GOOD, 0.0, "positive pitch in mm, got 0"),
        (GOOD, GOOD, (0.1, -1.0), "positive pitch in mm"),
    ],
)
def test_bad_input(first: Floats, second: Floats, pitch_mm: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fourier_ring_correlation(first, second, pitch_mm=pitch_mm)


def test_a_scene_without_coarse_structure_is_told() -> None:
    rng = np.random.default_rng(4)
    wave = rng.normal(0.0, 1.0, (64, 64))
    fine = wave - gaussian_filter(wave, 2.0, mode="wrap")
    first, second = (fine + rng.normal(0.0, 0.2, fine.shape) for _ in range(2))
    with pytest.warns(QualityWarning, match="no coarse structure"):
        found = fourier_ring_correlation(first, second, pitch_mm=1.0)
    assert found.cutoff_lpmm == 0.0
