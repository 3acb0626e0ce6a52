"""MTF, wavefront and spots against diffraction theory and the studied lenses."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from lenses import WAVELENGTH_NM, perfect_lens, pupil_grid
from scipy.optimize import brentq

from lensshift.core.errors import QualityWarning
from lensshift.core.grid import Grid
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import (
    Band,
    diffraction_mtf,
    fast_mtf,
    led_band,
    pixel_centres_mm,
    sensor_mtf,
)
from lensshift.optics.otf import diffraction_limit, exact_mtf, exact_otf, pupils
from lensshift.optics.otf_kernel import overlap_sum
from lensshift.optics.paraxial import paraxial
from lensshift.optics.shift import moving
from lensshift.optics.spots import (
    axial_light,
    distortion,
    fields_for_image,
    image_per_field_mm,
    spots,
    wavefront,
)
from lensshift.optics.trace import trace

HORIZONTAL, VERTICAL = math.tan(math.radians(6.5)), math.tan(math.radians(1.6))
STUDIED_LPMM = np.array([3.226, 6.452, 12.9])


def test_exact_and_fast_mtf_of_a_perfect_lens_are_those_of_its_pupil() -> None:
    lens = perfect_lens(stop_mm=8.0)
    marginal = trace(lens, [0.0, 0.0], [[1.0, 0.0]]).direction[0, 0]
    cutoff_lpmm = 2.0 * abs(marginal) / (WAVELENGTH_NM * 1e-6)
    frequency = cutoff_lpmm * np.array([0.001, 0.1, 0.3, 0.5, 0.7, 0.95, 1.05])
    theory = diffraction_mtf(frequency, cutoff_lpmm)
    for azimuth_rad in (0.0, 0.7, math.pi / 2):
        exact = exact_mtf(lens, [0.0, 0.0], frequency, azimuth_rad)
        assert exact.modulation == pytest.approx(theory, abs=3e-3)  # the pupil is not quite even
        fast = fast_mtf(lens, [0.0, 0.0], frequency, azimuth_rad)[0]
        assert fast == pytest.approx(theory, abs=3e-3)


def test_diffraction_mtf_is_the_overlap_of_two_discs() -> None:
    along = np.linspace(-1.5, 1.5, 1501)
    row, col = np.meshgrid(along, along, indexing="ij")
    for v in (0.2, 0.6, 0.9):
        both = (row**2 + (col - v) ** 2 < 1) & (row**2 + (col + v) ** 2 < 1)
        share = both.sum() / (row**2 + col**2 < 1).sum()
        assert diffraction_mtf(v, 1.0) == pytest.approx(share, abs=1e-3)
    assert diffraction_mtf([0.0, 1.0, 2.0], 1.0) == pytest.approx([1.0, 0.0, 0.0])
    limit = diffraction_limit(load_lens("petzval_a"), STUDIED_LPMM)
    assert limit.modulation == pytest.approx([0.992, 0.985, 0.970], abs=1e-3)


def overlap_of(height_mm: Callable[[np.ndarray], np.ndarray], sine: float, shares: list[float],
               inner: float = 0.0) -> list[float]:  # fmt: skip
    """Return the MTF of a pupil with light h dh / (u du) up to a sine of u = 1, at shares of it."""
    along = (np.arange(-1.0, 1.0, 1e-3) + 5e-4) * sine
    square = along[:, None] ** 2 + along**2
    fine = np.linspace(0.0, sine**2, 20_001)
    light = np.interp(square, fine, np.gradient(height_mm(np.sqrt(fine)) ** 2, fine))
    pupil = np.sqrt(light) * (square <= sine**2) * (square >= (inner * sine) ** 2)
    both = [
        (pupil[k:] * pupil[: len(pupil) - k]).sum()
        for k in np.rint(2000 * np.array(shares)).astype(int)
    ]
    return [float(one) / (pupil**2).sum() for one in both]


@pytest.mark.parametrize(("stop_mm", "uneven"), [(2.0, 3e-4), (20.0, 0.0327)])
def test_a_lens_without_aberrations_reaches_the_diffraction_limit(
    stop_mm: float, uneven: float
) -> None:
    """Behind a hyperbolic surface h = f (n - 1) u / (n cos - 1): more light at the edge."""
    lens = perfect_lens(stop_mm)
    index = lens.indices()[0][0]

    def height_mm(sine: np.ndarray) -> np.ndarray:
        return 50.0 * (index - 1.0) * sine / (index * np.sqrt(1.0 - sine**2) - 1.0)

    sine = brentq(lambda u: height_mm(np.array(u)) - 0.5 * stop_mm, 0.0, 0.5)
    shares = [0.0, 0.1, 0.3, 0.5, 0.7, 0.9]
    lpmm = np.array(shares) * 2.0 * sine / (WAVELENGTH_NM * 1e-6)
    expected = overlap_of(height_mm, sine, shares)
    limit = diffraction_limit(lens, lpmm).modulation
    assert limit == pytest.approx(expected, abs=3e-4)
    assert exact_mtf(lens, [0.0, 0.0], lpmm).modulation == pytest.approx(limit, abs=1e-6)
    # An even pupil that ends where the paraxial f-number says has another.
    even = diffraction_mtf(lpmm, 1e6 / (WAVELENGTH_NM * paraxial(lens).working_f_number))
    assert np.abs(limit - even).max() == pytest.approx(uneven, abs=3e-4)


@pytest.mark.parametrize("name", ["al2550", "petzval_b", "wide_940"])
def test_no_lens_exceeds_its_diffraction_limit(name: str) -> None:
    lens = load_lens(name)
    lpmm = np.linspace(0.0, 2e6 / lens.wavelength_nm / paraxial(lens).working_f_number, 23)
    band = led_band(lens.wavelength_nm, 40.0, 3)
    for field in ((0.0, 0.0), (0.02, 0.1)):
        for azimuth_rad in (0.0, 0.7, 0.5 * math.pi):
            exact = exact_mtf(lens, field, lpmm, azimuth_rad, band=band).modulation
            limit = diffraction_limit(lens, lpmm, field, azimuth_rad, band=band).modulation
            assert (exact <= limit + 1e-12).all()
            assert limit[0] == exact[0] == pytest.approx(1.0, abs=1e-12)
            assert limit[-1] == 0.0


@pytest.mark.slow
def test_defocus_follows_the_integral_over_two_sheared_discs() -> None:
    # Hopkins, Proc. Roy. Soc. A 231 (1955) 91: OTF = 4/pi times the integral of
    # sqrt(1 - (x + v)^2) cos(2 pi f slope defocus x) over x from 0 to 1 - v.
    from scipy.integrate import quad

    lens = perfect_lens(stop_mm=5.0)
    marginal = trace(lens, [0.0, 0.0], [[1.0, 0.0]]).direction[0]
    slope = abs(marginal[0] / marginal[2])
    defocus_mm = 1.0
    got = fast_mtf(lens, [0.0, 0.0], 6.0, defocus_mm=[-defocus_mm, 0.0, defocus_mm])[..., 0]
    cutoff_lpmm = 2.0 * slope / (WAVELENGTH_NM * 1e-6)
    v, turn = 6.0 / cutoff_lpmm, 2.0 * math.pi * 6.0 * slope * defocus_mm
    area = quad(lambda x: math.sqrt(1.0 - (x + v) ** 2) * math.cos(turn * x), 0.0, 1.0 - v)[0]
    expected = 4.0 / math.pi * area
    assert got[0] == pytest.approx([expected] * 2, abs=2e-3)
    assert got[2] == pytest.approx([expected] * 2, abs=2e-3)
    assert got[1] == pytest.approx([float(diffraction_mtf(6.0, cutoff_lpmm))] * 2, abs=1e-3)
    moved = fast_mtf(lens.with_sensor(50.0 + defocus_mm), [0.0, 0.0], [6.0])[:, 0]
    assert got[2] == pytest.approx(moved, abs=1e-9)


def test_exact_otf_equals_the_transform_of_the_point_spread_function() -> None:
    # An independent way: the field at the sensor as a sum of plane waves, its square, its sum.
    lens = perfect_lens(stop_mm=4.0).with_sensor(49.7)
    field = [0.01, 0.02]
    rays = trace(lens, field, pupil_grid(80))
    centre = rays.position_mm.mean(axis=0)
    cosine = rays.direction[:, :2]
    path = rays.path_mm + ((centre - rays.position_mm) * cosine).sum(axis=1)
    wave = 2.0 * np.pi / (WAVELENGTH_NM * 1e-6)
    period_mm = WAVELENGTH_NM * 1e-6 / (0.08 / 80)  # that of the grid of directions
    x_mm = np.arange(-100, 100) * (period_mm / 200)
    phase = wave * (path - path.mean())
    columns = np.exp(1j * wave * np.outer(cosine[:, 1], x_mm))
    rows = np.exp(1j * wave * np.outer(cosine[:, 0], x_mm))
    amplitude = (rows * np.exp(1j * phase)[:, None]).T @ columns
    spread = (np.abs(amplitude) ** 2).sum(axis=0)  # line spread function over columns
    frequency = np.array([5.0, 15.0, 30.0, 50.0])
    direct = np.abs(spread @ np.exp(-2j * np.pi * np.outer(x_mm, frequency))) / spread.sum()
    exact = exact_mtf(lens, field, frequency, 0.0).modulation
    assert exact == pytest.approx(direct, abs=5e-3)


def test_the_sum_over_two_pupils_is_that_of_arrays() -> None:
    rng = np.random.default_rng(4)
    sides = rng.uniform(-0.9, 0.9, (2, 8, 7, 11))  # one vignetting surface
    sides[:, 7] += 0.5
    step, wave = 0.2, 3.0
    soft = [
        np.clip((1.0 - np.stack([s[5] ** 2 + s[6] ** 2, s[7]])) / (2 * step) + 0.5, 0, 1).min(
            axis=0
        )
        for s in sides
    ]
    area = [np.abs(np.linalg.det(np.moveaxis(s[1:5].reshape(2, 2, 7, 11), (0, 1), (2, 3))))
            for s in sides]  # fmt: skip
    light = np.minimum(*soft) * np.sqrt(area[0] * area[1])
    assert 0.1 < np.mean(light > 0) < 0.9
    expected = np.sum(light * np.exp(1j * wave * (sides[0, 0] - sides[1, 0])))
    assert overlap_sum(sides[0], sides[1], step, wave) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("samples", [100, 129])
def test_the_exact_otf_settles_with_the_samples(samples: int) -> None:
    lens = load_lens("petzval_a")
    field = [VERTICAL, HORIZONTAL]
    fine = exact_otf(lens, field, STUDIED_LPMM, samples=400)
    assert exact_otf(lens, field, STUDIED_LPMM, samples=samples) == pytest.approx(fine, abs=1e-3)


def test_uneven_brightness_of_the_pupil_counts_in_the_exact_otf() -> None:
    # Rays that are even over the stop are not even in direction: each carries the amplitude
    # sqrt(area of the stop x area in direction cosines), here by differences between neighbours.
    lens = load_lens("petzval_b")
    field = [VERTICAL, HORIZONTAL]
    along = np.linspace(-1.0, 1.0, 141)
    points = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
    rays = trace(lens, field, points.reshape(-1, 2))
    cosine = rays.direction[:, :2].reshape(points.shape)
    per_row, per_col = np.gradient(cosine, axis=(0, 1))
    area = np.abs(per_row[..., 0] * per_col[..., 1] - per_row[..., 1] * per_col[..., 0])
    inside = (np.linalg.norm(points, axis=-1) < 1.0).ravel()
    cosine, weight = cosine.reshape(-1, 2)[inside], np.sqrt(area.ravel()[inside])
    centre = rays.position_mm[inside].mean(axis=0)
    path = rays.path_mm[inside] + ((centre - rays.position_mm[inside]) * cosine).sum(axis=1)
    wave = 2.0 * np.pi / (WAVELENGTH_NM * 1e-6)
    x_mm = np.arange(-70, 71) * 1.75e-3
    columns = np.exp(1j * wave * np.outer(cosine[:, 1], x_mm))
    rows = np.exp(1j * wave * np.outer(cosine[:, 0], x_mm))
    amplitude = (rows * (weight * np.exp(1j * wave * (path - path.mean())))[:, None]).T @ columns
    spread = np.abs(amplitude) ** 2
    row, col = (spread.sum(axis=axis) / spread.sum() for axis in (1, 0))
    turn = np.exp(-2j * np.pi * np.outer(x_mm, STUDIED_LPMM))
    exact = np.abs(exact_otf(lens, field, STUDIED_LPMM))
    assert exact[0] == pytest.approx(np.abs(col @ turn), abs=3e-3)
    assert exact[1] == pytest.approx(np.abs(row @ turn), abs=3e-3)


# The study took the pupil as evenly bright in direction cosines, which only matters at the edge of
# lens B.
@pytest.mark.parametrize(
    ("name", "field", "expected"),
    [
        ("petzval_a", (0.0, 0.0), (0.986, 0.960, 0.874)),
        ("petzval_a", (0.0, HORIZONTAL), (0.984, 0.954, 0.869)),
        ("petzval_a", (VERTICAL, 0.0), (0.987, 0.963, 0.886)),
        ("petzval_a", (VERTICAL, HORIZONTAL), (0.983, 0.951, 0.860)),
        ("petzval_b", (0.0, 0.0), (0.977, 0.928, 0.780)),
        ("petzval_b", (VERTICAL, 0.0), (0.979, 0.934, 0.799)),
    ],
)
def test_the_studied_lenses_centred(
    name: str, field: tuple[float, float], expected: tuple[float, ...]
) -> None:
    curve = exact_mtf(load_lens(name), field, STUDIED_LPMM)
    assert curve.modulation == pytest.approx(expected, abs=3e-3)


@pytest.mark.parametrize(
    ("move_mm", "expected"),
    [
        (-0.0444, (0.979, 0.936, 0.812)),
        (0.0444, (0.987, 0.966, 0.907)),
    ],
)
def test_a_studied_lens_with_the_first_element_moved(
    move_mm: float, expected: tuple[float, ...]
) -> None:
    lens = load_lens("petzval_a")
    build = moving(lens, 0, np.array([0.0, move_mm]))
    curve = exact_mtf(lens, (0.0, HORIZONTAL), STUDIED_LPMM, build=build)
    assert curve.modulation == pytest.approx(expected, abs=3e-3)


@pytest.mark.parametrize("name", ["petzval_a", "petzval_b"])
def test_fast_mtf_is_near_the_exact_one(name: str) -> None:
    lens = load_lens(name)
    fields = np.array([[0.0, 0.0], [0.0, HORIZONTAL], [VERTICAL, HORIZONTAL]])
    fast = fast_mtf(lens, fields, STUDIED_LPMM)
    exact = np.stack([np.abs(exact_otf(lens, field, STUDIED_LPMM)) for field in fields])
    assert fast == pytest.approx(exact, abs=1.5e-3)
    far = fast_mtf(lens, fields[1], [50.0], rings=12)
    assert far == pytest.approx(np.abs(exact_otf(lens, fields[1], [50.0])), abs=0.02)


def test_wavefront_of_other_programs() -> None:
    assert wavefront(load_lens("petzval_a"), [0.0, 0.0]).rms_waves == pytest.approx(0.542, abs=2e-3)


@pytest.mark.parametrize(
    ("name", "away_mm", "field", "frequency_lpmm"),
    [
        ("petzval_a", 2.0, (0.0, 0.0), (6.45, 12.9, 25.0)),
        ("petzval_b", 2.0, (0.02, 0.1), (12.9, 50.0)),
        ("al2550", 0.5, (0.05, 0.1), (3.0, 12.0, 20.0)),
    ],
)
def test_fast_mtf_invents_no_contrast(
    name: str, away_mm: float, field: tuple[float, float], frequency_lpmm: tuple[float, ...]
) -> None:
    lens = load_lens(name)
    lens = lens.with_sensor(lens.gaps_mm[-1] + away_mm)
    exact = np.abs(exact_otf(lens, field, frequency_lpmm))
    assert fast_mtf(lens, field, frequency_lpmm) == pytest.approx(exact, abs=2e-3)
    with pytest.warns(QualityWarning, match="periods apart, more than the 0.5"):
        few = fast_mtf(lens, field, frequency_lpmm, rings=6)
    assert np.abs(few - exact).max() > 0.05  # what it warns of


def test_sensor_mtf_is_symmetric_and_contains_single_fields() -> None:
    lens, grid = load_lens("petzval_a"), Grid((5, 9), (0.5, 1.1))
    got = sensor_mtf(lens, grid, [3.0, 7.0])
    assert got.shape == (5, 9, 2, 2)
    assert got == pytest.approx(got[::-1, ::-1], abs=1e-6)
    field = fields_for_image(lens, pixel_centres_mm(grid)[1, 7])
    assert got[1, 7] == pytest.approx(fast_mtf(lens, field, [3.0, 7.0]), abs=1e-3)


def test_sensor_mtf_of_many_pixels_is_linear_between_places() -> None:
    lens, grid = load_lens("al2550"), Grid((2, 301), (0.1, 0.02))
    got = sensor_mtf(lens, grid, 12.0, rings=6)
    assert got.shape == (2, 301, 2, 1)
    columns = [0, 7, 150, 222, 300]
    fields = fields_for_image(lens, pixel_centres_mm(grid)[1, columns])
    assert got[1, columns] == pytest.approx(fast_mtf(lens, fields, 12.0, rings=6), abs=1e-3)
    assert np.ptp(got) > 0.1


def test_an_led_blurs_by_axial_and_lateral_colour() -> None:
    lens = load_lens("petzval_a")
    narrow = led_band(850.0, 0.0, 3)
    field = [0.0, HORIZONTAL]
    alone = exact_mtf(lens, field, STUDIED_LPMM).modulation
    assert exact_mtf(lens, field, STUDIED_LPMM, band=narrow).modulation == pytest.approx(alone)
    broad = led_band(850.0, 40.0)
    assert np.sqrt(broad.weight @ (broad.wavelength_nm - 850.0) ** 2) == pytest.approx(
        40.0 / 2.35482, rel=1e-5
    )
    exact = np.abs(exact_otf(lens, field, STUDIED_LPMM[:2], band=broad))
    fast = fast_mtf(lens, field, STUDIED_LPMM[:2], band=broad)
    assert fast == pytest.approx(exact, abs=1e-3)
    assert np.abs(exact[0] - alone[:2]).max() > 1e-5  # the band does something
    with pytest.raises(ValueError, match="weights >= 0"):
        Band(np.array([850.0]), np.array([-1.0]))
    with pytest.raises(ValueError, match="a weight for each"):
        Band(np.array([850.0, 860.0]), np.array([1.0]))
    with pytest.raises(ValueError, match="a width >= 0"):
        led_band(850.0, -1.0)


def vignetting(lens: Lens, share: float) -> Lens:
    """Return the lens with the last surface smaller than the beam."""
    last = lens.elements[-1]
    small = replace(last.surfaces[1], semi_diameter_mm=share)
    element = replace(last, surfaces=(last.surfaces[0], small))
    return replace(lens, elements=(*lens.elements[:-1], element))


def test_vignetting_narrows_the_pupil_of_the_exact_mtf() -> None:
    lens = vignetting(perfect_lens(stop_mm=8.0), 2.0)
    rays = trace(lens, [0.0, 0.0], pupil_grid(400))
    widest = np.abs(rays.direction[rays.passed, 0]).max()
    frequency = np.array([20.0, 50.0, 80.0])
    theory = diffraction_mtf(frequency, 2.0 * widest / (WAVELENGTH_NM * 1e-6))
    with pytest.warns(QualityWarning, match="loses 7. % of its light"):
        curve = exact_mtf(lens, [0.0, 0.0], frequency)
    assert curve.modulation == pytest.approx(theory, abs=6e-3)


@pytest.mark.parametrize("position_mm", [0.0, -2.0])
def test_fitted_pupils_of_wide_fields_pass_the_light_of_the_rays(position_mm: float) -> None:
    """Polynomials fitted in an ellipse may come back into the pupil outside of it."""
    glass = Element((Surface(12.0), Surface(-8.0)), ("N-LASF44",), (3.0,))
    lens = Lens((glass,), (5.0,), Stop(6.0, position_mm), wavelength_nm=940.0)
    samples = 128
    for field in (np.zeros(2), np.array([0.36, 0.6]), np.array([-0.5, 0.1])):
        ((_, _, pupil),) = pupils(lens, field)
        energy = pupil.waves(samples, 1.0)[2] * (2.0 / samples) ** 2
        assert energy == pytest.approx(np.pi * pupil.light, rel=5e-3)
        assert pupil.light == pytest.approx(spots(lens, field, rings=16).transmission, abs=5e-3)


def test_light_that_the_fitted_pupil_gets_wrong_is_told() -> None:
    glass = Element((Surface(-20.0), Surface(-6.0)), ("N-LASF44",), (3.0,))  # reflects totally
    lens = Lens((glass,), (8.0,), Stop(6.0, -5.0), wavelength_nm=940.0)
    with pytest.warns(QualityWarning, match="the pupil of the OTF passes 9.* rays 8"):
        exact_otf(lens, [0.24, 0.4], [10.0])


def test_distortion_and_field_inversion() -> None:
    lens = load_lens("petzval_b")
    # The studied 2 % is of a corner field, from the paraxial image on the sensor.
    assert distortion(lens, [0.0, HORIZONTAL]) == pytest.approx(0.0196, abs=5e-4)
    image_mm = np.array([[0.3, -4.9], [1.2, 4.8]])
    fields = fields_for_image(lens, image_mm)
    assert spots(lens, fields, rings=2).centroid_mm == pytest.approx(image_mm, abs=1e-7)
    # The sensor is near the paraxial image of the object, and the pupil at the first vertex.
    ideal_mm = -paraxial(lens).magnification * lens.object_mm
    assert image_per_field_mm(lens) == pytest.approx(ideal_mm, rel=1e-3)
    with pytest.raises(ValueError, match="away from the axis"):
        distortion(lens, [0.0, 0.0])
    with pytest.raises(ValueError, match=r"the one 40 / 0 mm .* comes to .* mm: edges"):
        fields_for_image(lens, [[0.3, -4.9], [40.0, 0.0]])
    found = fields_for_image(lens, [image_mm[0], [40.0, 0.0]], dark=True)
    assert found[0] == pytest.approx(fields[0], abs=1e-9)
    assert np.isnan(found[1]).all()


def test_points_at_which_a_ray_meets_an_edge_are_found() -> None:
    # On one side of such a point its light has one ray more, and its centroid jumps.
    front, back = (Surface(radius, semi_diameter_mm=12.0) for radius in (50.0, -100.0))
    lens = Lens((Element((front, back), ("N-BK7",), (4.0,)),), (60.0,), Stop(10.0, -15.0))
    image_mm = np.stack([np.zeros(400), np.linspace(0.0, 27.0, 400)], axis=-1)
    found = spots(lens, fields_for_image(lens, image_mm), rings=2)
    away_mm = np.linalg.norm(found.centroid_mm - image_mm, axis=-1)
    assert (away_mm > 1e-7).mean() < 0.02
    assert (away_mm < found.rms_radius_mm).all()


@pytest.mark.parametrize("stop", [Stop(10.0), Stop(8.0, -20.0), Stop(8.0, 20.0), Stop(3.0, 50.5)])
@pytest.mark.parametrize("relayed", [False, True])
def test_image_per_field_is_the_derivative_of_traced_chief_rays(stop: Stop, relayed: bool) -> None:
    lens = replace(load_lens("petzval_a"), stop=stop)
    if relayed:  # the last element images image and stop once more
        last = load_lens("al2550").elements[0]
        elements = (*lens.elements[:2], last)
        lens = replace(lens, elements=elements, gaps_mm=(29.071, 60.0, 20.0))
    tiny = 1e-6
    chief = trace(lens, [0.0, tiny], [[0.0, 0.0]]).position_mm[0, 1]
    assert image_per_field_mm(lens) == pytest.approx(chief / tiny, rel=1e-6)


def test_exact_functions_take_one_field() -> None:
    lens = load_lens("petzval_a")
    with pytest.raises(ValueError, match="one field and one build"):
        exact_otf(lens, [[0.0, 0.0], [0.0, 0.1]], [3.0])
    with pytest.raises(ValueError, match="one field and one build"):
        wavefront(lens, [[0.0, 0.0], [0.0, 0.1]])


@pytest.mark.parametrize("inner", [0.0, 0.21, 0.38, 0.5])
def test_an_obstructed_mirror_has_the_contrast_of_a_ring(inner: float) -> None:
    """A paraboloid, against the autocorrelation of its pupil and the light that is left."""
    surface = Surface(-200.0, -1.0, semi_diameter_mm=12.5, inner_mm=10 * inner, mirror=True)
    lens = Lens((Element((surface,), (), ()),), (100.0,), Stop(20.0), wavelength_nm=550.0)
    shares = [0.05, 0.1, 0.3, 0.5, 0.7, 0.9]
    sine = math.sin(2.0 * math.atan(10.0 / 200.0))  # behind a paraboloid h = 2 f tan(angle / 2)
    ring = overlap_of(lambda u: 200.0 * np.tan(0.5 * np.arcsin(u)), sine, shares, inner)
    lpmm = np.array(shares) * 2.0 * sine / (550.0 * 1e-6)
    assert exact_mtf(lens, [0.0, 0.0], lpmm).modulation == pytest.approx(ring, abs=1e-3)
    assert diffraction_limit(lens, lpmm).modulation == pytest.approx(ring, abs=1e-3)
    light, seen = axial_light(lens)
    assert (light, seen) == pytest.approx((1.0 - inner**2, inner), abs=2e-3)
    assert fast_mtf(lens, [0.0, 0.0], lpmm)[0] == pytest.approx(ring, abs=2e-3)
    assert spots(lens, [0.0, 0.0]).transmission == pytest.approx(1.0 - inner**2, abs=5e-4)


@pytest.mark.parametrize("inner", [0.0, 0.21, 0.5])
@pytest.mark.parametrize(("aside_deg", "away_mm"), [(0.0, 0.15), (1.0, 0.0), (0.5, -0.1)])
def test_fast_mtf_of_an_obstructed_mirror_with_aberrations(
    inner: float, aside_deg: float, away_mm: float
) -> None:
    """Blurred to a half and less; as near to the exact one as without an obstruction."""
    surface = Surface(-200.0, -1.0, semi_diameter_mm=12.5, inner_mm=10 * inner, mirror=True)
    lens = Lens((Element((surface,), (), ()),), (100.0,), Stop(20.0), wavelength_nm=550.0)
    lens, field = lens.with_sensor(100.0 + away_mm), [0.0, math.tan(math.radians(aside_deg))]
    lpmm = np.array([10.0, 20.0, 40.0, 80.0])
    exact = np.abs(exact_otf(lens, field, lpmm))
    assert exact[0, 2] < 0.95 * diffraction_limit(lens, lpmm).modulation[2]
    assert fast_mtf(lens, field, lpmm, rings=12) == pytest.approx(exact, abs=3e-3)
    dense = pupil_grid(500)
    rays = trace(lens, field, dense)
    landing_mm = rays.position_mm[rays.passed]
    rms_mm = np.sqrt(landing_mm.var(axis=0).sum())
    spot = spots(lens, field)
    assert spot.rms_radius_mm == pytest.approx(rms_mm, rel=4e-3)
    assert spot.transmission == pytest.approx(rays.passed.mean(), abs=1e-3)
