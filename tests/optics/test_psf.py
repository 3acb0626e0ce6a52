"""The image of a point: Airy's, its energy, its transform, and rays where they rule."""

import math

import numpy as np
import pytest
from lenses import perfect_lens
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1

from lensshift.core.errors import QualityWarning
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import led_band
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.psf import ensquared_energy, point_spread
from lensshift.optics.spots import spots

CORNER = np.tan(np.radians([1.6, 6.5]))


def airy_in_square(side_mm: float, wave_mm: float, f_number: float) -> float:
    """Return the share of Airy's light in a square, by the midpoint rule over a quarter of it."""
    count = 1000
    along = (np.arange(count) + 0.5) / count * 0.5 * side_mm
    v = np.pi * np.hypot(along[:, None], along) / (wave_mm * f_number)
    per_mm2 = (2.0 * j1(v) / v) ** 2 * math.pi / (4.0 * (wave_mm * f_number) ** 2)
    return float(4.0 * per_mm2.sum() * (0.5 * side_mm / count) ** 2)


def test_a_perfect_lens_makes_airys_pattern() -> None:
    lens = perfect_lens(stop_mm=1.0)
    f_number, wave_mm = paraxial(lens).working_f_number, 850e-6
    first_mm = 1.22 * wave_mm * f_number
    sides_mm = first_mm * np.array([0.5, 1.0, 2.0, 5.0])
    wanted = [airy_in_square(side, wave_mm, f_number) for side in sides_mm]
    assert ensquared_energy(lens, [0.0, 0.0], sides_mm) == pytest.approx(wanted, abs=1e-3)
    coarse = point_spread(lens, [0.0, 0.0], float(sides_mm[-1])).ensquared(sides_mm)
    assert coarse == pytest.approx(wanted, abs=1e-3)
    # Rayleigh: a circle holds 1 - J0^2 - J1^2; the inscribed and the circumscribed square bracket.
    v = np.pi * 0.5 * sides_mm / (wave_mm * f_number)
    inscribed, around = (1.0 - j0(x) ** 2 - j1(x) ** 2 for x in (v, v * math.sqrt(2.0)))
    assert np.all((inscribed < wanted) & (wanted < around))
    psf = point_spread(lens, [0.0, 0.0], 3.0 * first_mm)
    middle = len(psf.at_mm) // 2
    assert psf.per_mm2[middle].argmax() == middle
    away_mm = first_mm * np.linspace(0.5, 1.5, 101)
    dark = int(np.argmin(CubicSpline(psf.at_mm, psf.per_mm2[middle])(away_mm)))
    assert away_mm[dark] == pytest.approx(first_mm, rel=0.02)


@pytest.mark.parametrize("field", [(0.0, 0.0), CORNER])
def test_its_transform_is_the_otf(field: tuple[float, float]) -> None:
    lens = load_lens("petzval_b")
    psf = point_spread(lens, field, 0.5)
    frequency = np.array([3.0, 6.45, 12.0])
    wave = np.exp(-2j * np.pi * np.outer(frequency, psf.at_mm))
    columns = wave @ psf.per_mm2.sum(axis=0) * psf.step_mm**2
    rows = wave @ psf.per_mm2.sum(axis=1) * psf.step_mm**2
    wanted = np.abs(exact_otf(lens, field, frequency))
    # What lies outside the square is missing.
    assert np.abs(np.stack([columns, rows])) == pytest.approx(wanted, abs=2e-3)
    assert 0.995 < psf.ensquared(0.5)[0] < 1.0
    light = psf.per_mm2 / psf.per_mm2.sum()
    assert light.sum(axis=0) @ psf.at_mm == pytest.approx(0.0, abs=5e-4)


def test_rays_rule_where_the_spot_is_wide() -> None:
    lens = load_lens("petzval_b")
    lens = lens.with_sensor(lens.gaps_mm[-1] + 1.0)
    sides_mm = np.array([0.1, 0.2, 0.3])
    found = ensquared_energy(lens, CORNER, sides_mm)
    spot = spots(lens, CORNER, rings=60)
    largest = np.abs(spot.ray_mm).max(axis=-1)
    rays = [float(spot.weight[largest < 0.5 * side].sum()) for side in sides_mm]
    assert found == pytest.approx(rays, abs=0.01)


def test_a_band_is_the_sum_of_its_colours_and_energy_grows() -> None:
    lens = load_lens("petzval_b")
    sides_mm = np.linspace(0.01, 0.3, 12)
    band = led_band(850.0, 60.0, samples=3)
    found = ensquared_energy(lens, CORNER, sides_mm, band=band)
    assert np.all(np.diff(found) > 0)
    alone = ensquared_energy(lens, CORNER, sides_mm)
    assert np.abs(found - alone).max() > 1e-3
    assert 0.995 < found[-1] < 1.0
    with pytest.raises(ValueError, match="positive side"):
        point_spread(lens, CORNER, 0.0)
    far = lens.with_sensor(lens.gaps_mm[-1] + 20.0)
    with pytest.warns(QualityWarning, match="samples across the pupil"):
        point_spread(far, [0.0, 0.0], 0.05)
