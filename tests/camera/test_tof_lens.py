"""A traced lens: where it images things, how far it moves them, how sharply."""

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from tof_worlds import EXACT, make_camera, quiet, still, wall, wave_of

from lensshift.camera import LensOptics, camera_preset, simulate_tof
from lensshift.camera.view import View, intrinsics_of, motions
from lensshift.core.grid import Grid
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import fast_mtf
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.shift import decenter_for_shift, moving, shift_map
from lensshift.optics.spots import fields_for_image, image_per_field_mm, spots
from lensshift.scene import Plane, Rectangle, Scene

SENSOR = Grid((5, 64), (0.155, 0.155))
DISTANCE_M = 3.5
PLANNED = np.array([(0.25, -0.25), (-0.1, 0.4)])


@cache
def petzval() -> Any:
    return load_lens("petzval_a")


def lens_camera(**options: Any) -> Any:
    return make_camera(SENSOR, optics=LensOptics(petzval(), **options))


def behind_a_hole(edge_mm: float, tilt_rad: float = 0.0) -> Lens:
    """Return a stop of 4 mm, 15 mm in front of a plane surface of another radius."""
    surfaces = Surface(np.inf, semi_diameter_mm=edge_mm), Surface(-26.0)
    element = Element(surfaces, ("N-BK7",), (6.0,), tilt_rad=(0.0, tilt_rad))
    return Lens((element,), (48.0,), Stop(4.0, -15.0))


def stripes(cycles: float, turns: float = 0.0) -> Any:
    """Return stripes with so many cycles per unit of the tangent of the direction."""

    def texture(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        return 0.6 + 0.3 * np.cos(2 * np.pi * (cycles / DISTANCE_M * x_m + turns))

    return texture


def per_px(cycles: float, col: float, build: Any = None, lens: Any = None) -> float:
    """Return how many cycles of the stripes are on a pixel, by tracing both of its sides back."""
    sides_mm = np.array([[0.0, (col - 31.5 + side) * 0.155] for side in (-0.5, 0.5)])
    tangent = fields_for_image(lens or petzval(), sides_mm, build=build)[:, 1]
    return float(cycles * (tangent[1] - tangent[0]))


@pytest.mark.parametrize("element", [0, 1])
def test_offsets_are_the_traced_ones(element: int) -> None:
    capture = simulate_tof(wall(), lens_camera(element=element), PLANNED, **EXACT)
    decenter_mm = decenter_for_shift(petzval(), element, PLANNED, SENSOR)
    traced = shift_map(petzval(), element, decenter_mm, SENSOR).offset_px
    field = capture.truth.offset_field
    assert field is not None
    np.testing.assert_allclose(field.offset_px, traced, atol=2e-5)
    np.testing.assert_array_equal(capture.burst.offset_px, PLANNED)


def test_content_moves_by_the_field_of_offsets() -> None:
    cycles = 53.0
    capture, blank = (
        simulate_tof(wall(DISTANCE_M, one), lens_camera(), [(0.0, 0.0), (0.0, 0.8)], **EXACT)
        for one in (stripes(cycles), 0.6)
    )
    rest, moved = capture.burst.amplitude[:, 2] / blank.burst.amplitude[:, 2]
    field = capture.truth.offset_field
    assert field is not None
    for first in (0, 21, 43):
        part = slice(first, first + 21)
        local = per_px(cycles, first + 10)
        turn = np.angle(wave_of(rest[part], local) / wave_of(moved[part], local))
        expected_px = field.offset_px[1, 2, part, 1].mean()
        assert turn / (2 * np.pi * local) == pytest.approx(expected_px, abs=3e-3)
    # The shift grows towards the edges by more than the test above allows.
    assert field.offset_px[1, 2, 0, 1] > 0.8 + 0.03


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.004, 0.098), (-0.003, -0.05)])
def test_things_are_seen_where_the_lens_images_them(tangent: tuple[float, float]) -> None:
    """A bright card in a known direction, and its centroid against traced rays."""
    # One pixel wide: then the centroid over pixels is that of the card.
    size_m = DISTANCE_M * 0.155 / image_per_field_mm(petzval())
    centre_m = (DISTANCE_M * tangent[1], DISTANCE_M * tangent[0], DISTANCE_M)
    card = Rectangle(centre_m=centre_m, size_m=(size_m, size_m), reflectance=1.0)
    back = Plane(centre_m=(0.0, 0.0, 4.0), reflectance=0.0)
    optics = LensOptics(petzval(), diffraction=False)
    truth = still(Scene((card,), back), make_camera(SENSOR, optics=optics), scale=3).truth
    light = truth.amplitude / truth.amplitude.sum()
    row, col = (np.arange(n) for n in light.shape)
    seen_px = (np.array([light.sum(1) @ row, light.sum(0) @ col]) + 0.5) / 3 - 0.5
    image_mm = spots(petzval(), tangent).centroid_mm
    expected_px = image_mm / 0.155 + (np.array(SENSOR.shape) - 1) / 2
    np.testing.assert_allclose(seen_px, expected_px, atol=4e-3)


@pytest.mark.parametrize(
    ("name", "col", "shift_px", "most"),
    [("petzval_a", 31, 0.0, 0.99), ("petzval_b", 60, 0.9, 0.93)],
)
@pytest.mark.slow
def test_contrast_is_aperture_times_lens(name: str, col: int, shift_px: float, most: float) -> None:
    cycles = 170.0  # 0.6 to a pixel
    lens, grid = load_lens(name), Grid((3, 64), (0.155, 0.155))
    build = moving(lens, 0, decenter_for_shift(lens, 0, [0.0, shift_px], grid))
    field = fields_for_image(lens, [0.0, (col - 31.5) * 0.155], build=build)
    local = per_px(cycles, col, build, lens)
    contrast = fast_mtf(lens, field, [local / 0.155], [0.0], build=build, rings=8)[0, 0]
    assert contrast < most
    camera = make_camera(grid, optics=LensOptics(lens))
    fine = EXACT | {"samples_per_px": 64}  # 16 cells of a pixel lose 0.002 of the contrast
    seen = [
        simulate_tof(
            wall(DISTANCE_M, stripes(cycles, turns)), camera, [(0.0, shift_px)], **fine
        ).burst.amplitude[0, 1, col]
        for turns in (0.0, 1 / 3, 2 / 3)
    ]
    swing = 2 * abs(np.dot(seen, np.exp(2j * np.pi * np.arange(3) / 3))) / np.sum(seen)
    assert swing == pytest.approx(0.5 * np.sinc(local) * contrast, abs=0.002)


@pytest.mark.slow
def test_the_sharp_truth_lacks_what_the_lens_takes_and_nothing_else() -> None:
    """Stripes: their contrast over the sharp one is the MTF, and they lie at the same place."""
    cycles, col, scale = 170.0, 60, 2
    lens, grid = load_lens("petzval_b"), Grid((3, 64), (0.155, 0.155))
    field = fields_for_image(lens, [0.0, (col - 31.5) * 0.155])
    local = per_px(cycles, col, lens=lens)
    contrast = fast_mtf(lens, field, [local / 0.155], [0.0], rings=8)[0, 0]
    assert contrast < 0.96
    camera = make_camera(grid, optics=LensOptics(lens))
    turns = (0.0, 1 / 3, 2 / 3)
    truths = [
        still(wall(DISTANCE_M, stripes(cycles, turn)), camera, scale=scale).truth for turn in turns
    ]
    back = np.exp(2j * np.pi * np.arange(3) / 3)
    seen, sharp = (
        sum(b * getattr(one, name)[1, scale * col] for b, one in zip(back, truths, strict=True))
        for name in ("amplitude", "sharp_amplitude")
    )
    assert abs(seen / sharp) == pytest.approx(contrast, abs=0.003)
    assert np.angle(seen / sharp) == pytest.approx(0.0, abs=0.02)
    mean, sharp_mean = (
        sum(getattr(one, name)[1, scale * col] for one in truths)
        for name in ("amplitude", "sharp_amplitude")
    )
    assert mean == pytest.approx(sharp_mean, rel=1e-3)
    np.testing.assert_allclose(truths[0].sharp_distance_m, truths[0].distance_m, atol=1e-4)


def stopped(lens: Lens, f_number: float) -> Lens:
    """Return the lens with a smaller stop."""
    smaller = paraxial(lens).working_f_number / f_number
    return replace(lens, stop=replace(lens.stop, diameter_mm=smaller * lens.stop.diameter_mm))


@pytest.mark.parametrize(
    ("name", "f_number", "pitch_mm", "near"),
    [
        ("petzval_a", None, 0.155, 0.02),
        ("petzval_b", None, 0.155, 0.02),
        ("petzval_a", 12.5, 0.011, 0.02),
        ("petzval_b", 12.5, 0.011, 0.02),
        ("al2550", None, 0.155, 0.04),  # spots grow faster than nodes follow
        ("al2550", 12.5, 0.011, 0.02),
    ],
)
@pytest.mark.parametrize("shift_px", [0.0, 0.7])
def test_what_is_seen_through_a_lens_has_its_wave_optical_otf(
    name: str, f_number: float | None, pitch_mm: float, near: float, shift_px: float
) -> None:
    """At nodes and between them, modulus and phase, to twice the highest frequency of the pixels.

    Rays with the Airy disc were up to 0.2 off at f/12.5.
    """
    lens = load_lens(name)
    if f_number is not None:
        lens = stopped(lens, f_number)
    grid = Grid((16, 64), (pitch_mm, pitch_mm))
    offset_px = np.array([[0.5 * shift_px, shift_px]])
    ((_, blur),) = motions(make_camera(grid, optics=LensOptics(lens)), offset_px, 1.0)
    build = moving(lens, 0, decenter_for_shift(lens, 0, offset_px[0], grid))
    azimuths = np.linspace(0.0, np.pi, 6, endpoint=False)
    axes = np.stack([np.sin(azimuths), np.cos(azimuths)], axis=-1)
    cpp = np.array([0.1, 0.25, 0.5, 0.75, 1.0])
    for place_px in ((7.5, 31.5), (3.0, 50.3), (1.0, 61.0)):
        image_mm = (np.array(place_px) - [7.5, 31.5]) * pitch_mm
        field = fields_for_image(lens, image_mm, build=build)
        exact = exact_otf(lens, field, cpp / pitch_mm, azimuths, build=build)
        seen = blur.otf(np.array(place_px), cpp[None, :, None] * axes[:, None])
        np.testing.assert_allclose(seen, exact, atol=near)


@pytest.mark.parametrize("cycles_per_px", [pytest.param(0.2, marks=pytest.mark.slow), 0.45])
def test_stripes_at_f_12_lose_what_waves_lose(cycles_per_px: float) -> None:
    """Through cells, tiles and pixels: rays with the Airy disc would show a tenth less."""
    lens, pitch_mm = stopped(load_lens("petzval_b"), 12.5), 0.011
    grid = Grid((3, 64), (pitch_mm, pitch_mm))
    cycles = cycles_per_px * image_per_field_mm(lens) / pitch_mm
    camera = make_camera(grid, optics=LensOptics(lens))
    seen = [
        still(wall(DISTANCE_M, stripes(cycles, turns)), camera).burst.amplitude[0, 1, 32]
        for turns in (0.0, 1 / 3, 2 / 3)
    ]
    swing = 2 * abs(np.dot(seen, np.exp(2j * np.pi * np.arange(3) / 3))) / np.sum(seen)
    exact = abs(exact_otf(lens, [0.0, 0.0], [cycles_per_px / pitch_mm], [0.0])[0, 0])
    assert swing == pytest.approx(0.5 * np.sinc(cycles_per_px) * exact, abs=0.005)


def test_preset_behind_a_lens_with_everything_on() -> None:
    preset = camera_preset("o3m151")
    camera = replace(preset, grid=SENSOR, optics=LensOptics(petzval(), element=1))
    capture = simulate_tof(wall(3.5), camera, PLANNED, seed=2)
    plain = simulate_tof(wall(3.5), replace(preset, grid=SENSOR), PLANNED, seed=2)
    assert capture.burst.valid.all()
    # f-numbers of 2.17 and 2.1.
    ratio = capture.burst.amplitude.mean() / plain.burst.amplitude.mean()
    assert ratio == pytest.approx((2.1 / 2.17) ** 2, rel=0.02)
    error_px = capture.truth.offset_px - PLANNED
    assert 0 < np.abs(error_px).max() < 0.1


@pytest.mark.parametrize(
    ("edge_mm", "tilt_rad", "near_bend"), [(30.0, 0.0, 1e-3), (5.4, 0.0, 8e-3), (5.4, 1e-9, 0.015)]
)
def test_a_traced_lens_darkens_by_its_stop_and_its_edge(
    edge_mm: float, tilt_rad: float, near_bend: float
) -> None:
    """A stop in front of a plane surface: cos^4 / distortion times the overlap of two circles."""
    landscape = partial(behind_a_hole, tilt_rad=tilt_rad)
    place_mm = 1.25 * (np.arange(25) - 12.0)
    camera = make_camera(Grid((3, 25), (1.25, 1.25)), optics=LensOptics(landscape(edge_mm), None))
    tangent = fields_for_image(landscape(edge_mm), np.stack([0.0 * place_mm, place_mm], -1))[:, 1]
    near = tangent[:, None] + 1e-4 * np.array([-1.0, 1.0])
    image_mm = spots(landscape(30.0), np.stack([0.0 * near, near], -1)).centroid_mm[..., 1]
    slope_mm = np.diff(image_mm)[:, 0] / 2e-4
    sagittal_mm = image_mm.mean(axis=1) / np.where(tangent == 0.0, np.inf, tangent)
    focal_mm = sagittal_mm[12] = slope_mm[12]
    away_mm = 15.0 * np.abs(tangent)
    row, col = np.mgrid[-2:2:801j, -2:2:801j]  # points of the stop
    inside = np.hypot(row, col) < 2.0
    passed = [(np.hypot(row, col + a) < edge_mm)[inside].mean() for a in away_mm]
    falloff = (1 + tangent**2) ** -2 * focal_mm**2 / (slope_mm * sagittal_mm) * passed
    seen = still(wall(), camera).burst.amplitude[0, 1]
    expected = falloff * (1 + tangent**2) ** -1.5  # of a wall lit from the camera
    assert falloff.min() < (0.93 if edge_mm > 20.0 else 0.75)
    np.testing.assert_allclose(seen / seen[12], expected, atol=near_bend)


@pytest.mark.filterwarnings("ignore:.*(of its light|of the sensor are dark|pixels see beyond)")
@pytest.mark.parametrize("tilt_rad", [0.0, 1e-9])
def test_beyond_its_image_circle_a_traced_lens_is_dark(tilt_rad: float) -> None:
    """Circles of 2 and 2.2 mm, 15 mm apart, share nothing from a tangent of 4.2 / 15 on."""
    lens, open_lens = behind_a_hole(2.2, tilt_rad), behind_a_hole(30.0)
    end_mm = float(spots(open_lens, [0.0, 4.2 / 15.0]).centroid_mm[1])
    place_mm = 1.25 * (np.arange(33) - 16.0)
    camera = make_camera(Grid((33, 33), (1.25, 1.25)), optics=LensOptics(lens, 0))
    with pytest.warns(UserWarning, match=r"about (69|7[0-2]) % of the sensor are dark, from 13"):
        look = intrinsics_of(camera).directions(camera.grid.shape)
    capture = still(wall(), camera)
    away_mm = np.hypot(place_mm, place_mm[:, None])
    seen, full = capture.burst.amplitude[0], capture.burst.amplitude[0, 16, 16]
    beyond, within = away_mm > end_mm + 0.7, away_mm < end_mm - 2.5
    assert beyond.sum() > 200
    assert seen[beyond].max() < 1e-3 * full  # tails of spots
    assert capture.truth.amplitude[within.repeat(2, 0).repeat(2, 1)].min() > 1e-3 * full
    tangent = fields_for_image(open_lens, np.stack([0.0 * place_mm, place_mm], -1))[:, 1]
    row, col = np.mgrid[-2:2:801j, -2:2:801j]  # points of the stop
    inside = np.hypot(row, col) < 2.0
    share = [(np.hypot(row, col + 15.0 * t) < 2.2)[inside].mean() for t in np.abs(tangent)]
    fields = np.stack([0.0 * tangent, tangent], -1)
    whole = View(make_camera(camera.grid, optics=LensOptics(open_lens)), 0.5).light(*fields.T)
    light = View(camera, 0.5).light(*fields.T)
    np.testing.assert_allclose(light, whole * share, atol=0.02)
    assert np.all(light[np.abs(place_mm) > end_mm + 1.7] == 0.0)  # a node apart from the end
    right = look[16, :, 0] / look[16, :, 2]
    np.testing.assert_allclose(right, tangent, atol=0.02)
    assert np.all(np.diff(right) > 0)


@pytest.mark.slow
def test_corners_next_to_the_end_of_the_image_are_lit() -> None:
    """No field is found for them from the middle, but the one that the others let expect is lit."""
    camera = make_camera(Grid((1, 3), (2.48, 3.3)), optics=LensOptics(load_lens("wide_940")))
    look = intrinsics_of(camera).directions(camera.grid.shape)  # a warning would be an error
    assert np.isfinite(look).all()


def test_an_image_that_turns_back_is_no_dark_corner() -> None:
    """An asphere bends light that meets it far out to the middle again."""
    bent = Surface(-26.0, asphere=(-6e-4,), semi_diameter_mm=8.0)
    element = Element((Surface(np.inf, semi_diameter_mm=8.0), bent), ("N-BK7",), (6.0,))
    lens = Lens((element,), (48.0,), Stop(1.0, -15.0))
    camera = make_camera(Grid((33, 33), (0.8, 0.8)), optics=LensOptics(lens))
    with pytest.raises(ValueError, match=r"ends in the dark, but about .* mm .* turns back"):
        View(camera, 0.5)


@pytest.mark.parametrize("tilt_rad", [0.0, 1e-9])
def test_the_light_of_a_traced_lens_is_even_about_its_axis_and_less_what_is_obstructed(
    tilt_rad: float,
) -> None:
    """Of a ring 1 - e^2 of the light of its f-number, whatever way the angle lies."""
    inner = 0.4
    surface = Surface(-200.0, -1.0, semi_diameter_mm=12.5, inner_mm=10 * inner, mirror=True)
    element = Element((surface,), (), (), tilt_rad=(0.0, tilt_rad))
    lens = Lens((element,), (100.0,), Stop(20.0), wavelength_nm=550.0)
    view = View(make_camera(Grid((9, 9), (2.0, 2.0)), optics=LensOptics(lens, None)), 0.0)
    assert view.light(np.zeros(1), np.zeros(1)) == pytest.approx(1.0 - inner**2, abs=2e-3)
    turn = np.linspace(0.0, 0.5 * np.pi, 7)
    around = view.light(0.08 * np.sin(turn), 0.08 * np.cos(turn))
    assert around.max() < 0.99 * (1.0 - inner**2)
    np.testing.assert_allclose(around, around[0], atol=2e-3)


def test_a_lens_that_cannot_move_the_image_is_refused() -> None:
    with pytest.raises(ValueError, match="element from 0 to 2, got 3"):
        LensOptics(petzval(), element=3)
    with pytest.raises(TypeError, match="expected a Lens, got str"):
        LensOptics("petzval_a")  # type: ignore[arg-type]
    long = replace(lens_camera(), grid=Grid((5, 301), SENSOR.pitch_mm))
    with pytest.raises(ValueError, match="no ray"):
        simulate_tof(wall(), long, [(0.0, 300.0)], **EXACT)


def test_quiet_camera_is_quiet() -> None:
    camera = make_camera(SENSOR, optics=LensOptics(petzval()), readout=quiet())
    first, again = (still(wall(), camera, seed=seed).burst.amplitude for seed in (1, 2))
    np.testing.assert_array_equal(first, again)


def test_a_lens_far_out_of_focus_is_refused_before_the_work() -> None:
    """A spot 20 pixels wide took more than ten minutes, and shows nothing."""
    lens = petzval()
    far = lens.with_sensor(lens.gaps_mm[-1] + 15.0)
    camera = make_camera(SENSOR, optics=LensOptics(far))
    with pytest.raises(ValueError, match=r"lens in focus, got a spot of .* px rms"):
        simulate_tof(wall(), camera, PLANNED, **EXACT)
