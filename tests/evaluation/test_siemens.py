"""The star agrees with its closed form under a Gaussian blur and with a fine rendering."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ive, j1
from seen_patterns import gaussian_mtf, seen, seen_mtf

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.known_phase import HarmonicFit, contrast_at_zero
from lensshift.evaluation.siemens import siemens_star_mtf

LEVELS = (0.1, 0.9)  # mean 0.5, contrast 0.8
SIGMA = 0.5
SHAPE, CENTER, CYCLES = (121, 141), (61.7, 70.2), 25
Floats = NDArray[np.float64]


def blurred_amplitude(radius: Floats, cycles: int, sigma: float) -> Floats:
    """Return the amplitude of cos(n phi) after a Gaussian blur: its Hankel transform."""
    x = (radius / (2 * sigma)) ** 2
    bessel = ive((cycles - 1) / 2, x) + ive((cycles + 1) / 2, x)
    return np.asarray(np.sqrt(np.pi / 8) * radius / sigma * bessel)


def exact_star(
    shape: tuple[int, int] = SHAPE,
    center: tuple[float, float] = CENTER,
    cycles: int = CYCLES,
    sigma: float = 1.0,
    pitch: tuple[float, float] = (1.0, 1.0),
) -> Floats:
    """Return a blurred sine star sampled at points."""
    row, col = np.indices(shape, dtype=float)
    row, col = (row - center[0]) * pitch[0], (col - center[1]) * pitch[1]
    wave = np.cos(cycles * np.arctan2(row, col))
    return np.asarray(0.5 + 0.4 * blurred_amplitude(np.hypot(row, col), cycles, sigma) * wave)


@cache
def rendered_star(square: bool, sigma: float = SIGMA) -> Floats:
    def star(row: Floats, col: Floats) -> Floats:
        wave = np.cos(CYCLES * np.arctan2(row, col))
        return 0.5 + 0.4 * (np.sign(wave) if square else wave)

    return seen(star, SHAPE, CENTER, sigma)


@pytest.mark.parametrize("square", [False, True], ids=["sine", "square"])
@pytest.mark.parametrize("levels", [None, LEVELS], ids=["extrapolated", "levels"])
def test_rendered_star(square: bool, levels: tuple[float, float] | None) -> None:
    result = siemens_star_mtf(
        rendered_star(square),
        cycles=CYCLES,
        pitch_mm=1.0,
        profile="square" if square else "sine",
        levels=levels,
    )
    np.testing.assert_allclose(result.center_px, CENTER, atol=0.01)
    f = result.mtf.frequency_lpmm
    assert f[0] < 0.07
    assert f[-1] > 0.48
    np.testing.assert_allclose(result.mtf.modulation, seen_mtf(f, SIGMA), atol=0.006)
    assert result.contrast == pytest.approx(0.8 * (4 / np.pi if square else 1), rel=2e-3)


@pytest.mark.parametrize("around", [0.1, 0.5, 0.95])
@pytest.mark.parametrize(("center", "rim_px"), [((61.7, 70.2), 41.0), ((48.2, 61.4), 37.3)])
def test_the_rim_of_a_star_is_found(
    around: float, center: tuple[float, float], rim_px: float
) -> None:
    """A disc on a plain ground, of any grey, in the middle or beside it."""
    row, col = np.indices(SHAPE, dtype=float)
    away = np.hypot(row - center[0], col - center[1])
    inside = np.clip(rim_px + 0.5 - away, 0.0, 1.0)
    image = inside * exact_star(center=center, sigma=SIGMA) + (1.0 - inside) * around
    image += 0.01 * np.random.default_rng(4).standard_normal(SHAPE)
    found = siemens_star_mtf(image, cycles=CYCLES, pitch_mm=1.0)
    assert rim_px - 5.0 < found.radius_mm[0] < rim_px
    np.testing.assert_allclose(found.center_px, center, atol=0.05)
    exact = blurred_amplitude(found.radius_mm, CYCLES, SIGMA)
    np.testing.assert_allclose(found.mtf.modulation * found.contrast / 0.8, exact, atol=0.03)


@pytest.mark.parametrize("beyond_px", [0.0, 0.4, -0.4])
def test_a_rim_at_the_border_does_not_tell_the_contrast(beyond_px: float) -> None:
    # Blur of the white around it reaches the outermost ring, which kept more than half its wave.
    row, col = np.indices((101, 121), dtype=float) - np.array([50.0, 60.0])[:, None, None]
    radius, wave = np.hypot(row, col), np.cos(25 * np.arctan2(row, col))
    inside = 1 / (1 + np.exp((radius - 50.0 - beyond_px) / 0.4))
    image = 0.9 * (1 - inside) + inside * (0.5 + 0.4 * blurred_amplitude(radius, 25, 0.5) * wave)
    result = siemens_star_mtf(image, cycles=25, pitch_mm=1.0)
    assert abs(result.contrast - 0.8) < 2 * result.contrast_std
    expected = gaussian_mtf(result.mtf.frequency_lpmm, 0.5)
    np.testing.assert_allclose(result.mtf.modulation, expected, atol=0.03)


@pytest.mark.parametrize("grey", [0.1, 0.5])
def test_rings_on_a_disc_in_the_middle_are_left_out(grey: float) -> None:
    row, col = np.indices((121, 121), dtype=float) - 60.0
    radius, wave = np.hypot(row, col), np.cos(25 * np.arctan2(row, col))
    outside = 1 / (1 + np.exp((20.0 - radius) / 0.4))
    image = grey * (1 - outside) + outside * (0.5 + 0.4 * wave)
    image += np.random.default_rng(3).normal(0.0, 0.01, image.shape)
    with pytest.warns(QualityWarning, match="a disc in the middle"):
        result = siemens_star_mtf(image, cycles=25, pitch_mm=1.0)
    assert 20.0 < result.radius_mm[-1] < 23.0
    np.testing.assert_allclose(result.mtf.modulation, 1.0, atol=0.05)  # no blur was put in


@pytest.mark.parametrize("cycles", [25, 30])
def test_noise_and_other_stars_are_refused(cycles: int) -> None:
    noise = np.random.default_rng(5).normal(0.5, 0.1, SHAPE)
    with pytest.raises(ValueError, match="expected contrast at low frequencies"):
        siemens_star_mtf(noise, cycles=cycles, pitch_mm=1.0, center_px=CENTER)
    seen = exact_star(cycles=12) + 0.2 * noise
    with pytest.raises(ValueError, match="expected contrast at low frequencies"):
        siemens_star_mtf(seen, cycles=cycles, pitch_mm=1.0, center_px=CENTER)


def test_sectors_show_the_direction_across() -> None:
    # Blurred along the rows (axis 0) alone: only the frequencies that run along them suffer.
    image = gaussian_filter(exact_star(sigma=0.3), (1.0, 0.0), mode="nearest")
    result = siemens_star_mtf(image, cycles=CYCLES, pitch_mm=1.0, levels=LEVELS, sectors=8)
    at = 0.2
    found = [np.interp(at, s.frequency_lpmm, s.modulation) for s in result.sectors]
    tilt = np.pi * np.arange(8) / 4
    spread = np.linspace(-np.pi / 8, np.pi / 8, 41)
    blur = np.exp(-2 * (np.pi * at * np.cos(tilt[:, None] + spread)) ** 2).mean(axis=1)
    np.testing.assert_allclose(found, gaussian_mtf(at, 0.3) * blur, atol=0.02)
    assert found[0] < 0.55 < 0.85 < found[2]


def test_aliased_harmonics_of_a_sharp_star_are_told_apart() -> None:
    """The third of 0.25 cycles a pixel comes back as 0.25 itself, along rows and columns alone.

    Sectors were off by 0.14, most of it there.
    """
    sharp = rendered_star(True, sigma=0.15)
    found = siemens_star_mtf(
        sharp, cycles=CYCLES, pitch_mm=1.0, profile="square", levels=LEVELS, sectors=6
    )
    errors = []
    for k, curve in enumerate(found.sectors):
        across = np.pi * k / 3 + np.pi / 2
        expected = seen_mtf(curve.frequency_lpmm, 0.15, np.pi / 6, across)
        errors.append((curve.modulation - expected)[curve.frequency_lpmm < 0.45])
        assert np.median(curve.std) < 0.004
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.005


def test_short_arcs_have_as_many_rings_as_without_aliased_harmonics() -> None:
    stars = [rendered_star(square) for square in (True, False)]
    square, sine = (
        siemens_star_mtf(
            star, cycles=CYCLES, pitch_mm=1.0, profile=profile, levels=LEVELS, sectors=12,
            center_px=CENTER, radius_range_mm=(9.0, 50.0),
        )
        for star, profile in zip(stars, ("square", "sine"), strict=True)
    )  # fmt: skip
    assert [len(one.modulation) for one in square.sectors] == [
        len(one.modulation) for one in sine.sectors
    ]


@settings(max_examples=6)
@given(
    row=st.floats(50, 70), col=st.floats(60, 80), cycles=st.integers(12, 30),
    seed=st.integers(0, 99),
)  # fmt: skip
def test_centre_with_noise_and_uneven_light(row: float, col: float, cycles: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = exact_star(center=(row, col), cycles=cycles)
    light = 1 + 0.002 * (np.arange(121)[:, None] - 60) - 0.0015 * (np.arange(141) - 70)
    noisy = image * light + rng.normal(0, 0.01, image.shape)
    result = siemens_star_mtf(noisy, cycles=cycles, pitch_mm=1.0, levels=LEVELS)
    np.testing.assert_allclose(result.center_px, (row, col), atol=0.02)
    error = result.mtf.modulation - blurred_amplitude(result.radius_mm, cycles, 1.0)
    assert result.mtf.std is not None
    assert np.all(np.abs(error) < 0.006 + 5 * result.mtf.std)
    assert np.sqrt(np.mean((error / result.mtf.std) ** 2)) < 1.3
    sure = result.mtf.std < 0.01  # not the innermost ring or two, which few pixels see
    assert np.count_nonzero(sure) > 0.9 * len(error)
    assert np.sqrt(np.mean(error[sure] ** 2)) < 0.006


def test_exact_star_on_oblong_pixels() -> None:
    pitch = (0.12, 0.1)
    image = exact_star((101, 131), (48.4, 66.1), 20, sigma=0.12, pitch=pitch)
    result = siemens_star_mtf(image, cycles=20, pitch_mm=pitch, levels=LEVELS)
    truth = blurred_amplitude(result.radius_mm, 20, 0.12)
    np.testing.assert_allclose(result.mtf.modulation, truth, atol=3e-3)
    np.testing.assert_allclose(result.mtf.frequency_lpmm, 20 / (2 * np.pi * result.radius_mm))
    np.testing.assert_allclose(result.center_px, (48.4, 66.1), atol=1e-3)


@pytest.mark.parametrize("levels", [None, LEVELS], ids=["extrapolated", "levels"])
def test_std_is_that_of_repeated_measurements(levels: tuple[float, float] | None) -> None:
    rng = np.random.default_rng(3)
    clean = exact_star((61, 71), (30.3, 34.8), 12)
    runs = [
        siemens_star_mtf(
            clean + rng.normal(0, 0.02, clean.shape),
            cycles=12,
            pitch_mm=1.0,
            center_px=(30.3, 34.8),
            levels=levels,
        )
        for _ in range(40)
    ]
    scatter = np.std([run.mtf.modulation for run in runs], axis=0, ddof=1)
    told = np.mean([run.mtf.std for run in runs if run.mtf.std is not None], axis=0)
    # An extrapolated scale may be off by more than noise: how the contrast falls is not known.
    assert np.mean(told / scatter) > 0.9
    assert np.mean(told / scatter) < 1.1 or not levels
    assert np.mean([run.residual for run in runs]) == pytest.approx(0.02, rel=0.1)


def test_an_extrapolated_contrast_says_how_far_it_may_be_off() -> None:
    for sigma in (0.8, 1.2, 1.6):
        found = siemens_star_mtf(exact_star(sigma=sigma), cycles=CYCLES, pitch_mm=1.0)
        assert abs(found.contrast - 0.8) < 2.0 * found.contrast_std
    given = siemens_star_mtf(exact_star(), cycles=CYCLES, pitch_mm=1.0, levels=LEVELS)
    assert given.contrast_std == 0.0


@pytest.mark.parametrize("gaussian", [True, False])
def test_rings_tell_how_the_contrast_falls(gaussian: bool) -> None:
    f = np.linspace(0.07, 0.14, 40)
    fall = gaussian_mtf(f, 0.8) if gaussian else 1.0 - 4.0 / np.pi * f / 1.2 + 0.2 * (f / 1.2) ** 3
    noise = 0.002 * np.random.default_rng(6).standard_normal(f.size)
    fits = [HarmonicFit(one, 0.002, 0.0, 100, 0.01) for one in (0.8 * fall + noise).tolist()]
    contrast, std = contrast_at_zero(f, fits, None)
    assert abs(contrast - 0.8) < 2.0 * std
    assert std < (0.013 if gaussian else 0.06)  # were the fall unknown: 0.033 for a Gaussian


@pytest.mark.filterwarnings("ignore:the centre still moves")
@pytest.mark.parametrize("told", [CYCLES - 2, CYCLES - 1, CYCLES + 1, CYCLES + 3])
@pytest.mark.parametrize("center", [CENTER, None])
def test_a_wrong_number_of_cycles_is_refused(told: int, center: tuple[float, float] | None) -> None:
    image = rendered_star(True) + 0.02 * np.random.default_rng(7).standard_normal(SHAPE)
    with pytest.raises(ValueError, match=rf"of {told} cycles, got one of {CYCLES}|contrast at low"):
        siemens_star_mtf(image, cycles=told, pitch_mm=1.0, profile="square", center_px=center)


def test_contrast_reversal_shows_in_the_phase() -> None:
    image = exact_star(sigma=0.2)
    box = np.ones(7) / 7  # first zero at 1/7 cycle a pixel
    for axis in (0, 1):
        image = np.apply_along_axis(np.convolve, axis, np.pad(image, 3, mode="edge"), box, "same")
        image = image[3:-3, 3:-3]
    result = siemens_star_mtf(
        image, cycles=CYCLES, pitch_mm=1.0, center_px=CENTER, levels=LEVELS, sectors=8,
        radius_range_mm=(18.0, 57.0),
    )  # fmt: skip
    f = result.mtf.frequency_lpmm
    assert np.all(np.abs(result.phase_rad[f < 0.13]) < 0.2)
    assert np.all(np.abs(result.phase_rad[(f > 0.18) & (f < 0.21)]) > 2.9)


def test_invalid_pixels_are_left_out() -> None:
    image = exact_star()
    valid = np.random.default_rng(1).random(image.shape) > 0.3
    image[~valid] = np.nan
    result = siemens_star_mtf(image, cycles=CYCLES, pitch_mm=1.0, levels=LEVELS, valid=valid)
    np.testing.assert_allclose(result.center_px, CENTER, atol=5e-3)
    truth = blurred_amplitude(result.radius_mm, CYCLES, 1.0)
    np.testing.assert_allclose(result.mtf.modulation, truth, atol=5e-3)


@pytest.mark.parametrize("cycles", [24, 25])
@pytest.mark.parametrize("background", [0.1, 0.9])
def test_centre_of_a_disc_on_another_background(cycles: int, background: float) -> None:
    center, shape = (66.4, 90.2), (121, 191)
    image = exact_star(shape, center, cycles)
    row, col = np.indices(shape)
    image[np.hypot(row - center[0], col - center[1]) > 50] = background
    image *= 1 + 0.002 * (col - 95)
    image += np.random.default_rng(2).normal(0, 0.02, shape)
    result = siemens_star_mtf(image, cycles=cycles, pitch_mm=1.0, radius_range_mm=(9.0, 48.0))
    np.testing.assert_allclose(result.center_px, center, atol=0.02)


def test_rings_beyond_nyquist_are_told() -> None:
    # Point samples at known places: the fit works beyond the Nyquist frequency, with a warning.
    image = exact_star(sigma=0.3)
    with pytest.warns(QualityWarning, match="rings of the star have fewer than 2 pixels a cycle"):
        result = siemens_star_mtf(
            image, cycles=CYCLES, pitch_mm=1.0, radius_range_mm=(6.0, 58.0), levels=LEVELS
        )
    assert result.pixels_per_cycle[-1] < 2 < result.pixels_per_cycle[0]
    truth = blurred_amplitude(result.radius_mm, CYCLES, 0.3)
    np.testing.assert_allclose(result.mtf.modulation, truth, atol=0.03)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cycles": 3}, "expected a star of 5 cycles or more, got 3"),
        ({"profile": "round"}, "expected the profile 'sine' or 'square', got 'round'"),
        ({"sectors": 13}, "expected 0 to 12 sectors for 25 cycles, got 13"),
        ({"pitch_mm": 0.0}, "expected a positive pitch in mm"),
        ({"levels": (0.9, 0.1)}, r"expected levels \(low, high\)"),
        ({"radius_range_mm": (9.0, 3.0)}, "expected radii in mm that rise from above 0"),
        ({"radius_range_mm": (20.0, 21.5)}, "expected at least 3 rings"),
        ({"center_px": (-3.0, 5.0)}, "expected a centre inside the image"),
        ({"cycles": 400}, "expected an image that reaches 127"),
        ({"image": np.ones(SHAPE), "center_px": None}, "expected contrast, got 1 in all pixels"),
        ({"radius_range_mm": (5.0, 400.0)}, r"within the image, which ends 9\d\.\d+ mm from"),
        ({"image": np.ones((3, 4, 5))}, "expected a real image"),
        ({"image": np.full(SHAPE, np.nan)}, "expected finite valid pixels, got 0 of 17061"),
        ({"valid": np.ones((2, 2))}, r"expected valid of shape \(121, 141\)"),
        ({"image": exact_star() - 0.6}, "expected an image with a positive mean"),
    ],
)
def test_bad_input(change: dict[str, object], message: str) -> None:
    arguments = {"image": exact_star(), "cycles": CYCLES, "pitch_mm": 1.0, "center_px": CENTER}
    with pytest.raises(ValueError, match=message):
        siemens_star_mtf(**(arguments | change))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_contrast_behind_a_disc_out_of_focus(seed: int) -> None:
    """It falls faster than any Gaussian, which meets frequency 0 far above."""
    rng = np.random.default_rng(seed)
    f, std = np.linspace(0.5, 1.0, 30), 0.002
    z = 2.0 * np.pi * 0.45 * f
    seen = 0.8 * 2.0 * j1(z) / z * np.sinc(0.3 * f) + std * rng.standard_normal(f.size)
    fits = [HarmonicFit(one, std, 0.0, 100, 0.01) for one in seen]
    contrast, _ = contrast_at_zero(f, fits, None)
    gaussian = np.exp(np.polyfit(f**2, np.log(seen), 1)[1])
    assert gaussian > 0.86
    assert abs(contrast - 0.8) < 0.02


@pytest.mark.parametrize("last", [0.6, 0.7, 0.8])
def test_contrast_behind_diffraction(last: float) -> None:
    """Near its cut-off a perfect lens falls neither as a cusp nor as a disc: up to 24 % off."""
    u, std, errors, within = np.linspace(0.5 * last, last, 60), 0.0006, [], 0
    fall = 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u * u)) * np.sinc(0.4 * u)
    for seed in range(20):
        seen = 0.6 * fall + std * np.random.default_rng(seed).standard_normal(u.size)
        fits = [HarmonicFit(one, std, 0.0, 100, 0.01) for one in seen.tolist()]
        contrast, told = contrast_at_zero(u, fits, None)
        within += abs(contrast - 0.6) < 3.0 * told
        errors.append(contrast / 0.6 - 1.0)
    assert within >= 13
    assert abs(np.mean(errors)) < 0.06
