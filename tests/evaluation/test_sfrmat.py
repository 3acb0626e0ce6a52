"""sfrmat3 and sfrmat5: the numbers of the originals, closed forms, and failures that speak."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal.windows import hamming as symmetric_hamming
from scipy.signal.windows import hann as symmetric_hann
from scipy.special import ndtr

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.slanted_edge.sfrmat import SfrmatResult, sfrmat3, sfrmat5
from lensshift.evaluation.slanted_edge.sfrmat_steps import (
    hamming,
    hann,
    modulation_of,
    project,
    rounded,
    shifted,
)

Method = Callable[[Any], SfrmatResult]

# The stored images take a minute; test_binned.py holds a sample of them in the default run.
pytestmark = pytest.mark.slow


def sfrmat5_straight(image: Any) -> SfrmatResult:
    return sfrmat5(image, order=1)


def sfrmat5_straight_hamming(image: Any) -> SfrmatResult:
    return sfrmat5(image, order=1, window="hamming")


METHODS: dict[str, Method] = {
    "sfrmat3": sfrmat3,
    "sfrmat5_p5": sfrmat5,
    "sfrmat5_p1": sfrmat5_straight,
    "sfrmat5_p1_hamming": sfrmat5_straight_hamming,
}
every_method = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)


def edge(
    shape: tuple[int, int] = (41, 67),
    angle_deg: float = 10.0,
    sigma_px: float = 0.6,
    noise: float = 0.0,
    dark: float = 0.2,
    bright: float = 1.0,
    centre_px: float = 0.13,
) -> NDArray[np.float64]:
    """Draw a Gaussian edge, brighter to the right, sampled at points."""
    rows, cols = shape
    angle_rad = math.radians(angle_deg)
    row, col = np.mgrid[:rows, :cols] - np.array([(rows - 1) / 2, (cols - 1) / 2])[:, None, None]
    normal_px = (col - centre_px) * math.cos(angle_rad) + row * math.sin(angle_rad)
    clean = ndtr(normal_px / sigma_px)
    noisy = clean + noise * np.random.default_rng(5).standard_normal(shape)
    return np.asarray(dark + (bright - dark) * noisy, dtype=np.float64)


# The originals, run on exactly these pixels


def check_against(
    reference: Any, key: str, i: int, found: SfrmatResult, last_esf: NDArray[np.float32] | None
) -> None:
    assert found.frequency_cpp[1] == pytest.approx(reference[f"{key}_df"][i], rel=1e-12)
    # The stored curve has single precision; empty bins drive it far above 1 in sfrmat3.
    np.testing.assert_allclose(found.modulation, reference[f"{key}_sfr"][i], rtol=1e-6, atol=1e-6)
    fit = reference[f"{key}_fit"][i].copy()
    if key == "sfrmat3":  # counts columns from 1, and appends a zero
        fit = fit[:2] - np.array([0.0, 1.0])
    np.testing.assert_allclose(found.edge_px, fit, rtol=1e-9, atol=1e-12 * np.abs(fit).max())
    for name in ("mtf50", "mtf10"):
        # The stored number is the last frequency where the curve never falls so far.
        ours = getattr(found, f"{name}_cpp")
        ours = found.frequency_cpp[-1] if math.isnan(ours) else ours
        assert ours == pytest.approx(reference[f"{key}_{name}"][i], abs=1e-9)
    assert rounded(100 * found.sampling_efficiency) == reference[f"{key}_samp_eff"][i]
    if last_esf is not None:
        np.testing.assert_allclose(found.esf, last_esf, rtol=1e-6, equal_nan=True)


@pytest.mark.parametrize("key", METHODS)
@pytest.mark.parametrize(
    ("size", "share"), [("64x16", 1), ("128x32", 1), ("200x200", 9), ("500x500", 6)]
)
@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_the_numbers_are_those_of_the_original(
    reference_dir: Path, key: str, size: str, share: int
) -> None:
    folder = reference_dir / "slanted_edge" / "open"
    images = np.load(folder / f"edges_{size}.npz")["images"]
    with np.load(folder / f"edges_{size}_ref.npz") as stored:
        reference = {name: stored[name] for name in stored.files if name.startswith(key)}
    esf = reference.get(f"{key}_esf")
    defaults = key in ("sfrmat3", "sfrmat5_p5")
    for i in range(0, len(images), share if defaults else max(share, 3)):
        if reference[f"{key}_finite"][i]:
            found = METHODS[key](images[i])
            check_against(reference, key, i, found, None if esf is None else esf[i])
        else:  # NaN or nothing in the original
            with pytest.raises(ValueError, match="method='ml'"):
                METHODS[key](images[i])


# Physics


@every_method
@pytest.mark.parametrize("sigma_px", [0.5, 1.0])
@pytest.mark.parametrize("angle_deg", [-12.0, 10.0])
def test_a_gaussian_edge_has_the_gaussian_mtf(
    method: Method, sigma_px: float, angle_deg: float
) -> None:
    found = method(edge((61, 75), angle_deg, sigma_px))
    inside = found.frequency_cpp <= 0.5
    frequency_cpp = found.frequency_cpp[inside]
    # The mean over bins of a quarter pixel across the lines is theirs, not the edge's.
    binning = np.sinc(frequency_cpp * found.bin_px)
    truth = np.exp(-2 * (np.pi * sigma_px * frequency_cpp) ** 2)
    np.testing.assert_allclose(found.modulation[inside], truth * binning, atol=0.02)
    half_cpp = math.sqrt(math.log(2) / 2) / (math.pi * sigma_px)
    assert found.mtf50_cpp == pytest.approx(half_cpp, rel=0.02)
    assert found.sampling_efficiency == pytest.approx(
        min(1.0, math.sqrt(math.log(10) / 2) / (math.pi * sigma_px) / 0.5), rel=0.04
    )


@every_method
@pytest.mark.parametrize("angle_deg", [-12.0, 7.0])
def test_the_edge_is_where_it_was_drawn(method: Method, angle_deg: float) -> None:
    found = method(edge((41, 67), angle_deg, centre_px=0.4))
    assert found.slope == pytest.approx(-math.tan(math.radians(angle_deg)), abs=2e-3)
    assert found.angle_rad == pytest.approx(math.atan(found.slope))
    assert found.bin_px == pytest.approx(0.25 * math.cos(found.angle_rad))
    assert np.polyval(found.edge_px, 20.0) == pytest.approx(33.4, abs=0.03)
    assert found.lines_used == rounded(math.floor(41 * abs(found.slope)) / abs(found.slope))
    assert found.empty_bins == 0
    assert found.esf.shape == found.lsf.shape == (4 * 67,)
    assert np.argmax(found.lsf) == pytest.approx(4 * 33.4, abs=8)
    assert not found.rotated


@every_method
def test_a_curve_that_stays_high_has_no_crossing(method: Method) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        found = method(edge(sigma_px=0.05))
    assert math.isnan(found.mtf10_cpp)
    assert found.sampling_efficiency == 1.0


# Symmetries


def same_curve(one: SfrmatResult, other: SfrmatResult) -> None:
    np.testing.assert_allclose(one.frequency_cpp, other.frequency_cpp, rtol=1e-6)
    np.testing.assert_allclose(one.modulation, other.modulation, rtol=1e-5, atol=1e-8)


# At 18.4 degrees, a slope of 1/3, the lines fill three of four bins.
angles_deg = st.floats(7.0, 16.0) | st.floats(-16.0, -7.0)
methods = st.sampled_from(list(METHODS.values()))


@given(angle_deg=angles_deg, method=methods, centre_px=st.floats(-0.5, 0.5))
def test_a_turned_image_is_turned_back(angle_deg: float, method: Method, centre_px: float) -> None:
    image = edge((41, 47), angle_deg, noise=0.01, centre_px=centre_px)
    upright = method(image)
    turned = method(np.rot90(image, -1))
    assert turned.rotated
    np.testing.assert_array_equal(turned.modulation, upright.modulation)
    # Turned counterclockwise, a transposed image has its lines in reverse.
    np.testing.assert_array_equal(method(image.T).modulation, method(image[::-1]).modulation)


@given(
    angle_deg=angles_deg,
    method=methods,
    gain=st.floats(0.02, 1e4),
    offset=st.floats(0.0, 0.5),
    bright_side=st.sampled_from([1.0, -1.0]),
)
def test_gain_offset_and_sign_do_not_matter(
    angle_deg: float, method: Method, gain: float, offset: float, bright_side: float
) -> None:
    image = edge((41, 47), angle_deg, noise=0.01)
    changed = gain * (image if bright_side > 0 else 1.2 - image) + gain * offset
    same_curve(method(changed), method(image))


# The steps


@given(count=st.integers(8, 90))
def test_windows_about_the_middle_are_the_symmetric_ones(count: int) -> None:
    middle = (count - 1) / 2
    np.testing.assert_allclose(hamming(count, middle)[0], symmetric_hamming(count), atol=1e-12)
    # The originals' window peaks half a sample to the right of where it is asked to.
    np.testing.assert_allclose(hann(count, middle - 0.5)[0], symmetric_hann(count), atol=1e-12)


@given(count=st.integers(9, 60), share=st.floats(0.0, 1.0))
def test_windows_peak_where_they_are_asked_to(count: int, share: float) -> None:
    centre = share * (count - 1)
    for window in (hamming(count, centre)[0], hann(count, centre)[0]):
        assert abs(int(np.argmax(window)) - centre) <= 1.5
        assert window.min() >= 0.0
        assert window.max() <= 1.0
    many = hann(count, np.array([centre, 0.0]))
    assert many.shape == (2, count)
    np.testing.assert_array_equal(many[1], hann(count, 0.0)[0])


def test_bins_hold_the_mean_of_their_pixels() -> None:
    pixels = np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
    # Line 0 falls into bins 0, 4, 8, 12 and line 1 into 2, 6, 10, 14; the ESF starts at bin 1.
    displacement_px = np.array([0.0, -0.5])
    esf, empty = project(pixels, displacement_px, -0.5, interpolate_sums=True)
    assert empty == 9
    means = [5.0, 2.0, 6.0, 3.0, 7.0, 4.0, 8.0]
    np.testing.assert_allclose(esf[1:15:2], means)
    np.testing.assert_allclose(esf[0:14:2], (np.array([1.0, *means[:-1]]) + means) / 2)
    np.testing.assert_allclose(esf[14:], 8.0)  # nothing to the right: the last mean goes on
    with_zeros, empty = project(pixels, displacement_px, -0.5, interpolate_sums=False)
    assert empty == 9
    np.testing.assert_allclose(with_zeros[1:15:2], means)
    assert np.count_nonzero(with_zeros) == 7


def test_bins_without_counted_neighbours_are_undefined() -> None:
    esf, empty = project(np.ones((1, 8)), np.zeros(1), 4.0, interpolate_sums=True)
    # The run of 4 px moves the pixels to bin 16, and the ESF starts at bin 8.
    assert empty == 8 + 3 * 6
    assert np.all(np.isnan(esf[:7]))
    np.testing.assert_allclose(esf[7:], 1.0)


@given(steps=st.integers(-9, 9), count=st.integers(1, 6))
def test_a_shift_moves_samples_and_fills_zeros(steps: int, count: int) -> None:
    values = np.arange(1.0, count + 1)
    expected = [values[i + steps] if 0 <= i + steps < count else 0.0 for i in range(count)]
    np.testing.assert_array_equal(shifted(values, steps), expected)


def test_halves_are_rounded_away_from_zero() -> None:
    assert [rounded(x) for x in (0.5, 1.5, 2.4, -0.5, -1.5, -2.4, 0.0)] == [1, 2, 2, -1, -2, -2, 0]


def test_the_spectrum_of_a_finite_difference_is_put_right() -> None:
    # D undoes half of f(k+1) - f(k-1) to the originals' one index too far.
    impulse = np.zeros(256)
    impulse[[127, 129]] = 0.5  # a difference spread over two bins: cos(2 pi i / 256)
    i = np.arange(1, 65)
    x = np.pi * (i + 1) / 130
    expected = np.cos(2 * np.pi * i / 256) * x / np.sin(x)
    np.testing.assert_allclose(modulation_of(impulse)[1:], expected, atol=1e-12)


# What fails in the originals without a word


@every_method
def test_too_few_lines_for_a_phase_say_how_many_are_needed(method: Method) -> None:
    with pytest.raises(ValueError, match=r"1/\|slope\| = 28\.\d+ lines .* 2\.0\d deg.*got 16; use"):
        method(edge((16, 64), 2.0))


@every_method
def test_a_vertical_edge_has_no_phases(method: Method) -> None:
    image = np.repeat(edge((1, 21), 0.0), 17, axis=0)
    with pytest.raises(ValueError, match="lines for one whole pixel phase"):
        method(image)


@every_method
def test_weak_contrast_with_the_left_side_bright_is_refused(method: Method) -> None:
    with pytest.raises(ValueError, match="brighter side"):
        method(edge(dark=0.9, bright=1.0)[:, ::-1])
    assert method(edge(dark=0.9, bright=1.0)).mtf50_cpp == pytest.approx(
        method(edge()).mtf50_cpp, rel=1e-6
    )


def test_an_empty_bin_can_leave_sfrmat3_without_a_curve() -> None:
    # The zero in the last bin pulls the centroid so far that the LSF leaves its bins.
    image = np.round(edge((16, 64), 5.0, sigma_px=0.1, dark=1e4, bright=5e4))
    with pytest.raises(ValueError, match=r"got bin -?\d+ with 1 bins empty"):
        sfrmat3(image)


def test_empty_bins_are_counted() -> None:
    image = edge((16, 64), -5.0, noise=0.01)
    with pytest.warns(QualityWarning, match=r"\d of 256 bins are empty at [45]\.\d\d degrees"):
        three = sfrmat3(image)
    assert three.empty_bins > 0
    assert np.count_nonzero(three.esf == 0) == three.empty_bins
    with pytest.warns(QualityWarning, match="sfrmat5 interpolates"):
        five = sfrmat5(image, order=1)
    assert five.empty_bins > 0
    assert five.esf.min() > 0.1


def test_an_mtf50_above_the_clip_is_told() -> None:
    with pytest.warns(QualityWarning, match="reports its clip of 0.495"):
        found = sfrmat5(edge(sigma_px=0.25), order=1)
    assert found.mtf50_cpp == pytest.approx(0.75, rel=0.05)


def test_lines_without_an_edge() -> None:
    image = edge((41, 67), 10.0)
    image[-1] = 0.6
    with pytest.warns(QualityWarning, match="no edge in 1 of 41 lines"):
        sfrmat3(image)
    with pytest.raises(ValueError, match="41 lines, got 1 without"):
        sfrmat5(image)


def test_sfrmat3_needs_more_than_a_ten_thousandth_of_contrast() -> None:
    with (
        pytest.warns(QualityWarning, match="no edge in 41 of 41 lines"),
        pytest.raises(ValueError, match="lines for one whole pixel phase"),
    ):
        sfrmat3(1e-5 * edge())
    same_curve(sfrmat5(1e-5 * edge()), sfrmat5(edge()))


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")  # it is also doubted
@every_method
def test_noise_without_an_edge_is_refused(method: Method) -> None:
    with pytest.raises(
        ValueError, match=r"stays within 41 pixels, got one that runs over \d+; cut"
    ):
        method(edge((41, 17), noise=1.0))


# Bad input


@every_method
@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.ones((20, 20, 3)), r"\[row col\], got shape \(20, 20, 3\)"),
        (edge() + 1j, "real image, got dtype complex128"),
        (np.full((20, 21), 0.5), "constant image of 0.5"),
        (np.where(np.eye(41, 67) > 0, np.nan, edge()), "got 41 NaN or infinite"),
        (edge((3, 67)), "at least 5 rows and columns"),
        (edge((41, 7), 2.0), "lines of 8 pixels across the edge, got 41 of 7"),
        (np.array([["a"]]), "real image"),
    ],
)
def test_images_that_do_not_fit(method: Method, image: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        method(image)


def test_options_that_do_not_fit() -> None:
    for order in (0, 6, 2.5, True):
        with pytest.raises(ValueError, match="order from 1 to 5"):
            sfrmat5(edge(), order=order)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="'tukey' or 'hamming', got 'hann'"):
        sfrmat5(edge(), window="hann")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 6 lines"):
        sfrmat5(edge((5, 67)))
