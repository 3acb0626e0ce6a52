"""The zone plate agrees with blur times pixel aperture, and finds what an LR grid folds."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from seen_patterns import seen, seen_mtf

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.zone_plate import zone_plate_response

SHAPE, CENTER, CHIRP = (202, 174), (100.3, 86.6), 0.005
LEVELS = (0.1, 0.9)  # mean 0.5, contrast 0.8
Floats = NDArray[np.float64]


@cache
def rendered_plate(
    sigma: float, shape: tuple[int, int] = SHAPE, center: tuple[float, float] = CENTER
) -> Floats:
    def plate(row: Floats, col: Floats) -> Floats:
        return 0.5 + 0.4 * np.cos(np.pi * CHIRP * (row**2 + col**2) + 0.7)

    return seen(plate, shape, center, sigma)


@pytest.mark.parametrize("levels", [None, LEVELS], ids=["extrapolated", "levels"])
@pytest.mark.parametrize(
    ("shape", "center"), [((201, 181), (100.3, 88.8)), ((121, 221), (55.2, 112.7))]
)
def test_blur_times_pixel(
    shape: tuple[int, int], center: tuple[float, float], levels: tuple[float, float] | None
) -> None:
    image = rendered_plate(0.5, shape, center)
    result = zone_plate_response(image, pitch_mm=1.0, chirp_lpmm_per_mm=CHIRP, levels=levels)
    np.testing.assert_allclose(result.center_px, center, atol=2e-3)
    for curve, half_rad in ((result.radial, np.pi), (result.row, 0.2618), (result.col, 0.2618)):
        f = curve.frequency_lpmm
        expected = seen_mtf(f, 0.5, half_rad)
        np.testing.assert_allclose(curve.modulation, expected, atol=2e-3)
    reach = [min(0.5, CHIRP * min(c, n - 1 - c)) for c, n in zip(center, shape, strict=True)]
    for curve, end in zip(
        (result.radial, result.row, result.col), (min(reach), *reach), strict=True
    ):
        # A ring is 2 k wide in f^2; the last whole one ends less than one ring before the end.
        rings_left = (end**2 - curve.frequency_lpmm[-1] ** 2) / (2 * CHIRP)
        assert 0.45 < rings_left < 1.55
    assert result.folded is None


def test_axes_are_told_apart() -> None:
    image = gaussian_filter(rendered_plate(0.2), (0.0, 1.0), mode="nearest")
    result = zone_plate_response(image, pitch_mm=1.0, chirp_lpmm_per_mm=CHIRP, levels=LEVELS)
    at = np.array([0.3])
    row, col = (np.interp(at, c.frequency_lpmm, c.modulation) for c in (result.row, result.col))
    both = seen_mtf(at, 0.2, 0.2618)[0]
    cos = np.cos(np.linspace(-0.2618, 0.2618, 201))
    sin = np.sin(np.linspace(-0.2618, 0.2618, 201))
    assert col == pytest.approx(both * np.mean(np.exp(-2 * (np.pi * at * cos) ** 2)), abs=0.01)
    assert row == pytest.approx(both * np.mean(np.exp(-2 * (np.pi * at * sin) ** 2)), abs=0.01)


def test_repeated_pixels_fold_as_the_closed_form_says() -> None:
    # LR pixels of side 2, each shown twice: the box passes sinc(2 f), repeating passes cos(pi f)
    # of the true wave and cos(pi (f - 1/2)) of the folded one.
    lr = rendered_plate(0.0).reshape(101, 2, 87, 2).mean(axis=(1, 3))
    result = zone_plate_response(
        np.kron(lr, np.ones((2, 2))),
        pitch_mm=1.0,
        chirp_lpmm_per_mm=CHIRP,
        center_px=CENTER,
        lr_pitch_mm=2.0,
        levels=LEVELS,
    )
    assert result.folded is not None
    for true, folded in zip((result.row, result.col), result.folded, strict=True):
        f = true.frequency_lpmm
        assert f[-1] > 0.4
        passed = np.sinc(2 * f)
        np.testing.assert_allclose(true.modulation, passed * np.cos(np.pi * f), atol=0.025)
        expected = passed * np.cos(np.pi * (f - 0.5))
        high = f > 0.1  # the first ring is too wide for one frequency
        np.testing.assert_allclose(folded.modulation[high], expected[high], atol=0.025)
    beyond = result.row.frequency_lpmm > 0.35
    assert np.all(result.folded[0].modulation[beyond] > result.row.modulation[beyond])


def test_a_true_image_has_nothing_folded() -> None:
    result = zone_plate_response(
        rendered_plate(0.3),
        pitch_mm=1.0,
        chirp_lpmm_per_mm=CHIRP,
        lr_pitch_mm=(2.0, 3.0),
        levels=LEVELS,
    )
    assert result.folded is not None
    for true, folded in zip((result.row, result.col), result.folded, strict=True):
        assert np.max(folded.modulation) < 8e-3
        f = true.frequency_lpmm
        expected = seen_mtf(f, 0.3, 0.2618)
        np.testing.assert_allclose(true.modulation, expected, atol=5e-3)


def test_noise_uneven_light_and_holes() -> None:
    rng = np.random.default_rng(5)
    image = rendered_plate(0.5) * (1 + 0.001 * (np.arange(202)[:, None] - 100))
    image += rng.normal(0, 0.02, image.shape)
    valid = rng.random(image.shape) > 0.2
    image[~valid] = np.nan
    result = zone_plate_response(
        image, pitch_mm=1.0, chirp_lpmm_per_mm=CHIRP, levels=LEVELS, valid=valid
    )
    np.testing.assert_allclose(result.center_px, CENTER, atol=0.02)
    for curve, half_rad in ((result.radial, np.pi), (result.row, 0.2618), (result.col, 0.2618)):
        f, std = curve.frequency_lpmm, curve.std
        error = curve.modulation - seen_mtf(f, 0.5, half_rad)
        assert std is not None
        assert 0.6 < np.sqrt(np.mean((error / std) ** 2)) < 1.5


@pytest.mark.parametrize("around", [0.5, 0.9])
def test_rings_beyond_the_rim_are_left_out(around: float) -> None:
    row, col = np.indices((161, 161), dtype=float) - 80.0
    radius = np.hypot(row, col)
    inside = 1 / (1 + np.exp((radius - 60.0) / 0.4))
    image = around + inside * (0.5 + 0.4 * np.cos(np.pi * CHIRP * radius**2) - around)
    image += np.random.default_rng(3).normal(0.0, 0.01, image.shape)
    with pytest.warns(QualityWarning, match="taken for the rim of the plate"):
        result = zone_plate_response(image, pitch_mm=1.0, chirp_lpmm_per_mm=CHIRP)
    for curve in (result.radial, result.row, result.col):
        assert 0.23 < curve.frequency_lpmm[-1] < 0.3  # of the rim
        np.testing.assert_allclose(curve.modulation, 1.0, atol=0.05)  # no blur was put in


@pytest.mark.parametrize("factor", [0.95, 1.05, 2.0])
def test_a_wrong_chirp_is_told(factor: float) -> None:
    image, chirp = rendered_plate(0.5), factor * CHIRP
    with pytest.warns(QualityWarning, match="from ring to ring"):
        zone_plate_response(image, pitch_mm=1.0, chirp_lpmm_per_mm=chirp, center_px=CENTER)


def test_pitch_in_mm_only_rescales_the_frequency() -> None:
    image = rendered_plate(0.5)
    one = zone_plate_response(image, pitch_mm=1.0, chirp_lpmm_per_mm=CHIRP)
    small = zone_plate_response(image, pitch_mm=0.1, chirp_lpmm_per_mm=CHIRP * 100)
    np.testing.assert_allclose(small.row.frequency_lpmm, one.row.frequency_lpmm * 10)
    np.testing.assert_allclose(small.row.modulation, one.row.modulation, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chirp_lpmm_per_mm": 0.0}, "expected a positive chirp in lp/mm per mm, got 0"),
        ({"chirp_lpmm_per_mm": 0.0005}, "expected 3 or more valid rings of one cycle, got 1"),
        ({"chirp_lpmm_per_mm": 5.0}, "expected 3 or more valid rings of one cycle, got 0"),
        ({"lr_pitch_mm": -2.0}, "expected a positive pitch in mm, got -2"),
        ({"levels": (0.5, 0.5)}, r"expected levels \(low, high\)"),
        ({"center_px": (50.0, 174.0)}, "expected a centre inside the image"),
        ({"image": np.ones(SHAPE, dtype=complex)}, "expected a real image"),
        ({"image": np.ones(SHAPE)}, "expected contrast at low frequencies"),
    ],
)
def test_bad_input(change: dict[str, object], message: str) -> None:
    image = 0.5 + 0.4 * np.cos(np.pi * CHIRP * np.sum((np.indices(SHAPE).T - CENTER) ** 2, -1).T)
    arguments = {
        "image": image, "pitch_mm": 1.0, "chirp_lpmm_per_mm": CHIRP, "center_px": CENTER,
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        zone_plate_response(**(arguments | change))  # type: ignore[arg-type]
