"""How much light arrives, and from where else."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tof_worlds import FOCAL_MM, HZ, ODD, make_camera, near_edge, phasors, quiet, still, wall

from lensshift.camera import (
    Ambient,
    Illumination,
    Multipath,
    Pixels,
    PlainOptics,
    Readout,
    Scatter,
)
from lensshift.camera.radiometry import relative_illumination
from lensshift.core.arrays import Array
from lensshift.core.grid import Grid
from lensshift.scene import Cuboid, Rectangle, Scene, Sphere

LIGHT_MPS, PLANCK_J_S = 299_792_458.0, 6.626_070_15e-34
ONE = Grid((1, 1), (0.15, 0.15))


def test_amplitude_falls_with_the_square_of_the_distance() -> None:
    near, far = (still(wall(d), make_camera()).burst.amplitude for d in (1.3, 3.9))
    np.testing.assert_allclose(near / far, 9.0, rtol=1e-9)


@pytest.mark.parametrize("natural", [True, False])
def test_light_of_a_ball_falls_with_the_fourth_power_of_the_cosine(natural: bool) -> None:
    """A ball around the camera lights all pixels alike but for the falloff of the lens."""
    grid = Grid((9, 13), (0.02, 0.03))
    optics = PlainOptics(0.2, 2.0, natural_falloff=natural)
    ball = Scene((Sphere(centre_m=(0.0, 0.0, 0.0), radius_m=2.0, reflectance=0.6),))
    capture = still(ball, make_camera(grid, optics=optics, illumination=Illumination((1e7,))))
    row, col = np.indices(grid.shape)
    tangent = np.hypot((row - 4) * 0.02, (col - 6) * 0.03) / 0.2
    expected = np.cos(np.arctan(tangent)) ** 4 if natural else np.ones(grid.shape)
    amplitude = capture.burst.amplitude[0]
    # The mean over a pixel is not that of its middle: a hundredth where the light bends most.
    np.testing.assert_allclose(amplitude / amplitude[4, 6], expected, rtol=0.01)
    assert capture.burst.distance_m == pytest.approx(2.0, abs=1e-6)


@cache
def counted_shares() -> tuple[Array, Array]:
    """Return how far apart two unit circles are, and the share of points of one in the other."""
    x, y = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 2_000_000))
    x, y = (values[x * x + y * y < 1.0] for values in (x, y))
    apart = np.linspace(0.0, 2.0, 201)
    return apart, np.array([np.mean((x - s) ** 2 + y * y < 1.0) for s in apart])


@pytest.mark.parametrize("lost", [0.1, 0.5, 1.0])
def test_vignetting_is_the_common_share_of_two_circles(lost: float) -> None:
    grid = Grid((9, 13), (0.02, 0.03))
    optics = PlainOptics(0.2, 2.0, natural_falloff=False, vignetting=lost)
    corner = np.array([4.5 * 0.02, 6.5 * 0.03]) / 0.2
    light = relative_illumination(optics, grid, *np.multiply.outer(corner, [0.0, 0.37, 1.0]))
    assert light[[0, 2]] == pytest.approx([1.0, 1.0 - lost], abs=1e-9)
    apart, share = counted_shares()
    corner_apart = np.interp(lost, 1.0 - share, apart)
    expected = np.interp(0.37 * corner_apart, apart, share)
    assert light[1] == pytest.approx(expected, abs=2e-3)
    with pytest.raises(ValueError, match="vignetting from 0 to 1"):
        PlainOptics(0.2, 2.0, vignetting=1.1)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, -70.0])
def test_amplitude_falls_with_the_cosine(angle_deg: float) -> None:
    turned = wall(3.0, turn_rad=(0.0, np.deg2rad(angle_deg), 0.0))
    camera = make_camera(ONE)
    ratio = still(turned, camera).burst.amplitude / still(wall(3.0), camera).burst.amplitude
    assert ratio == pytest.approx(np.cos(np.deg2rad(angle_deg)), rel=1e-6)


def test_electrons_follow_from_watts() -> None:
    camera = make_camera(
        ONE,
        optics=PlainOptics(FOCAL_MM, 2.1, transmission=0.7),
        illumination=Illumination((HZ,), intensity_w_per_sr=12.0, wavelength_nm=850.0),
        pixels=Pixels(fill_factor=0.5, quantum_efficiency=0.4, contrast=0.6),
        readout=quiet(exposure_s=(2e-4,)),
    )
    raw = still(wall(2.5, 0.3), camera).raw
    radiance = 0.3 * (12.0 / 2.5**2) / np.pi
    watts = np.pi * radiance * 0.7 / (4 * 2.1**2) * (0.15e-3) ** 2 * 0.5
    electrons = 0.4 * 2e-4 * watts / (PLANCK_J_S * LIGHT_MPS / 850e-9)
    phase = 4 * np.pi * HZ * 2.5 / LIGHT_MPS
    expected = 0.6 * electrons * np.cos(phase - np.arange(4) * np.pi / 2)
    np.testing.assert_allclose(raw.difference[0, 0, :, 0, 0], expected, rtol=1e-6)


def test_sunlight_has_the_studied_order_of_magnitude() -> None:
    # 110 klx, 50 nm, rho 0.5, tau 0.8, F 2.1, fill 0.5, QE 0.6: about 3e7 electrons per ms.
    camera = make_camera(
        Grid((20, 30), (0.15, 0.15)),
        optics=PlainOptics(FOCAL_MM, 2.1, transmission=0.8),
        pixels=Pixels(fill_factor=0.5, quantum_efficiency=0.6),
        ambient=Ambient(110.0, filter_width_nm=50.0),
        readout=quiet(exposure_s=(1e-3,), shot_noise=True),
        illumination=Illumination((HZ,), intensity_w_per_sr=1e-6),
    )
    raw = still(wall(3.5, 0.5), camera, samples_per_px=2).raw
    # Tap A - tap B has the variance of all electrons together.
    assert raw.difference.var() == pytest.approx(2.9e7, rel=0.1)


def test_scatter_keeps_the_sum_and_spreads_phasors() -> None:
    scene = near_edge(-2.0, 3.0, 4.2, 0.8, 0.05)
    plain = still(scene, make_camera()).burst
    true = phasors(plain.amplitude[0], plain.distance_m[0])
    for scatter in (Scatter(0.05, 2.0), Scatter(0.3, 60.0)):
        burst = still(scene, make_camera(scatter=scatter)).burst
        seen = phasors(burst.amplitude[0], burst.distance_m[0])
        assert seen.sum() == pytest.approx(true.sum(), rel=1e-9)
    # So wide that the light is even: a part of the mean phasor everywhere.
    np.testing.assert_allclose(seen, 0.7 * true + 0.3 * true.mean(), atol=1e-3 * abs(true).max())
    # The dark wall behind is pulled towards the bright card.
    far = burst.distance_m[0, :, -3:]
    assert 3.0 < far.min() < far.max() < 4.0
    assert plain.distance_m[0, :, -3:] == pytest.approx(4.2, abs=1e-4)


def test_scatter_does_not_change_an_even_image_or_the_truth() -> None:
    even = [still(wall(), make_camera(scatter=s)).burst.amplitude for s in (None, Scatter(0.2))]
    np.testing.assert_allclose(even[0], even[1], rtol=1e-6)
    scene = near_edge(0.0, 3.0, 4.0, 0.8, 0.05)
    true = [still(scene, make_camera(scatter=s)).truth.amplitude for s in (None, Scatter(0.2))]
    np.testing.assert_array_equal(true[0], true[1])


def field_sr(grid: Grid, focal_mm: float) -> float:
    """Return the solid angle of a rectangular field."""
    a, b = (0.5 * n * p / focal_mm for n, p in zip(grid.shape, grid.pitch_mm, strict=True))
    return 4 * np.arcsin(a * b / np.sqrt((1 + a * a) * (1 + b * b)))


def test_a_ball_lights_itself_evenly() -> None:
    """In the middle of a ball every point gets rho * lit share of the directions besides."""
    grid = Grid((5, 7), (0.5, 0.5))
    camera = make_camera(grid, optics=PlainOptics(1.5, 2.0), illumination=Illumination((2e5,)))
    ball = Scene((Sphere(centre_m=(0.0, 0.0, 0.0), radius_m=2.0, reflectance=0.6),))
    direct = still(ball, camera).burst.amplitude
    multipath = Multipath((24, 30), shadows=False)
    both = still(ball, replace(camera, multipath=multipath)).burst.amplitude
    expected = 1 + 0.6 * field_sr(grid, 1.5) / (4 * np.pi)
    np.testing.assert_allclose(both / direct, expected, rtol=3e-3)


def test_light_over_two_surfaces_comes_later_and_not_through_things() -> None:
    grid = Grid((5, 9), (0.5, 0.5))
    camera = make_camera(grid, optics=PlainOptics(2.0, 2.0))
    room = Cuboid(centre_m=(0.0, 0.0, 1.0), size_m=(2.0, 1.5, 3.0), reflectance=0.8)
    card = Rectangle(
        centre_m=(0.0, 0.0, 1.6), size_m=(1.4, 1.6), turn_rad=(0.0, np.pi / 2, 0.0), reflectance=0.0
    )
    direct = still(Scene((room,)), camera).burst
    longer, shaded = (
        still(Scene(shapes), replace(camera, multipath=Multipath((6, 10), shadows))).burst
        for shapes, shadows in (((room,), False), ((room, card), True))
    )
    assert np.all(longer.distance_m > direct.distance_m)
    through = still(Scene((room, card)), replace(camera, multipath=Multipath((6, 10), False))).burst
    assert np.all(shaded.distance_m <= through.distance_m + 1e-9)
    assert np.sum(shaded.amplitude) < 0.995 * np.sum(through.amplitude)


def test_the_truth_holds_direct_light_only() -> None:
    camera = make_camera(ODD, optics=PlainOptics(2.0, 2.0))
    ball = Scene((Sphere(centre_m=(0.0, 0.0, 0.0), radius_m=2.0, reflectance=0.9),))
    with_it = still(ball, replace(camera, multipath=Multipath((4, 6), False)))
    np.testing.assert_allclose(with_it.truth.distance_m, 2.0, rtol=1e-6)
    assert with_it.burst.distance_m.min() > 2.001


def test_dark_current_adds_noise_only() -> None:
    dark = Pixels(dark_electrons_per_s=1e9)
    readout = Readout(saturates=False, read_noise_electrons=0.0, bits=None)
    grid = Grid((30, 40), (0.1, 0.1))
    still_light = Illumination((HZ,), intensity_w_per_sr=1e-9)
    camera = make_camera(grid, pixels=dark, readout=readout, illumination=still_light)
    difference = still(wall(), camera, samples_per_px=2).raw.difference
    assert difference.var() == pytest.approx(1e6, rel=0.06)
    assert abs(difference.mean()) < 60.0
