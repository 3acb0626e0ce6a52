"""The lens field against the trace of every pixel, closed forms, bursts of its own and others."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.lens_field import LensField
from lensshift.core.types import Burst
from lensshift.optics.field import equivalent_px2, equivalent_spot, lens_field
from lensshift.optics.glass import refractive_index
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import fast_mtf, fast_otf
from lensshift.optics.shift import decenter_for_shift, moving, shift_map
from lensshift.optics.spots import centroids_mm, fields_for_image

SENSOR = Grid((7, 23), (0.31, 0.42))
PLAN = np.array([[0.0, 0.0], [0.5, 0.1], [-0.2, 0.4], [0.3, -0.45], [-0.4, -0.3]])


@cache
def field_of(name: str, element: int) -> LensField:
    return lens_field(load_lens(name), SENSOR, element)


def burst_of(field: LensField, offset_px: np.ndarray = PLAN, **fields: object) -> Burst:
    frames = np.ones((len(offset_px), *field.grid.shape))
    given = {"pitch_mm": field.grid.pitch_mm, "offset_px": offset_px} | fields
    return Burst.from_arrays(frames, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "element"), [("petzval_b", 0), ("petzval_a", 1), ("al2550", 0)])
def test_shifts_are_those_of_the_trace_of_every_pixel(name: str, element: int) -> None:
    field, lens = field_of(name, element), load_lens(name)
    decenter_mm = decenter_for_shift(lens, element, PLAN, SENSOR)
    np.testing.assert_allclose(field.states(PLAN), decenter_mm, atol=1e-7)
    traced_px = shift_map(lens, element, decenter_mm, SENSOR).offset_px
    found = field.of(burst_of(field)).offset_px
    assert np.abs(found - traced_px).max() < 1e-6
    assert field.shift_error_px < 1e-6
    # As the claim has to hold where nobody looked, so has what is said of the fit.
    assert np.abs(found - traced_px).max() < 10 * field.shift_error_px + 2e-7


@pytest.mark.filterwarnings("ignore:.*of its light", "ignore:the (shifts|widths)")
def test_beside_dark_corners_shifts_are_as_far_off_as_is_told() -> None:
    """A stop 15 mm in front of a lens that its beam leaves beyond a radius of 13 mm."""
    surfaces = Surface(np.inf, semi_diameter_mm=2.2), Surface(-26.0)
    lens = Lens((Element(surfaces, ("N-BK7",), (6.0,)),), (48.0,), Stop(4.0, -15.0))
    grid = Grid((21, 21), (1.0, 1.0))
    field = lens_field(lens, grid)
    decenter_mm = decenter_for_shift(lens, 0, PLAN, grid)
    row_mm, col_mm = np.mgrid[-10:11, -10:11].astype(float)
    places_mm = np.stack([row_mm, col_mm], axis=-1)
    build = moving(lens, 0, decenter_mm[:, None, None, :])
    fields = fields_for_image(lens, places_mm, build=build, dark=True)
    moved_mm = centroids_mm(lens, fields, build, dark=True)
    traced_px = moved_mm - centroids_mm(lens, fields, None, dark=True)
    off_px = field.of(burst_of(field)).offset_px - traced_px
    lit = np.isfinite(off_px)
    assert 0.7 < lit.mean() < 0.95
    assert 1e-4 < np.abs(off_px[lit]).max() < 2.0 * field.shift_error_px < 0.1


@pytest.mark.parametrize("place", [(0, 0), (3, 11), (6, 2)])
def test_the_spot_passes_what_the_trace_says(place: tuple[int, int]) -> None:
    field, lens = field_of("petzval_b", 0), load_lens("petzval_b")
    state = field.states(PLAN)
    spot_px2 = field.at(state).spot_px2
    assert spot_px2 is not None
    at_mm = (np.array(place) - (np.array(SENSOR.shape) - 1) / 2) * SENSOR.pitch_mm
    build = moving(lens, 0, state)
    tangent = fields_for_image(lens, np.tile(at_mm, (len(PLAN), 1)), build=build)
    for axis, azimuth_rad in enumerate((0.5 * np.pi, 0.0)):
        nyquist_lpmm = 0.5 / SENSOR.pitch_mm[axis]
        contrast = fast_mtf(lens, tangent, [nyquist_lpmm], azimuth_rad, build=build)[:, 0, 0]
        gaussian = np.exp(-2 * np.pi**2 * spot_px2[:, *place, axis] * 0.5**2)
        np.testing.assert_allclose(gaussian, contrast, atol=2 * field.contrast_error + 1e-3)
    assert field.contrast_error < 0.02


def test_coma_turns_the_phase_as_the_trace_says() -> None:
    """Of a singlet in its best focus, where a variance alone would turn it by nothing."""
    lens, grid = load_lens("al2550"), Grid((16, 64), (0.155, 0.155))
    field = lens_field(lens, grid, 0)
    shown = field.at([[0.0, 0.0]])
    assert shown.skew_px3 is not None
    assert shown.spot_px2 is not None
    cpp = np.array([0.15, 0.3, 0.45])
    for col in (0, 10, 60):
        tangent = fields_for_image(lens, np.array([[0.5 * 0.155, (col - 31.5) * 0.155]]))[0]
        traced = fast_otf(lens, tangent, cpp / 0.155, [0.0])[0]
        w = 2.0 * np.pi * cpp
        spot, skew = shown.spot_px2[0, 8, col, 1], shown.skew_px3[0, 8, col, 1]
        fitted = np.exp(-0.5 * spot * w**2 + 1j / 6.0 * skew * w**3)
        even = np.exp(-0.5 * spot * w**2)
        assert np.abs(fitted - traced).max() < max(0.01, 0.3 * np.abs(even - traced).max())


@pytest.mark.parametrize(
    ("name", "half", "pitch_mm"), [("al2550", 12, 0.3), ("petzval_b", 30, 0.1)]
)
def test_a_spot_that_leans_in_a_corner_is_that_of_an_edge_turned(
    name: str, half: int, pitch_mm: float
) -> None:
    """A lens is round: blur towards the middle and across it depend on how far away that is."""
    lens, grid = load_lens(name), Grid((2 * half + 1, 2 * half + 1), (pitch_mm, pitch_mm))
    spot_px2 = lens_field(lens, grid, None).at([[0.0, 0.0]]).spot_px2
    assert spot_px2 is not None
    towards_px2, across_px2 = spot_px2[0, half, half:, 1], spot_px2[0, half, half:, 0]
    leans = []
    for row, col in ((half // 2, half // 2), (half // 2, -half // 2), (0.7 * half, 0.7 * half)):
        at = np.rint([row, col]).astype(int)
        away = np.hypot(*at)
        towards, across = (
            np.interp(away, np.arange(half + 1), one) for one in (towards_px2, across_px2)
        )
        leans.append(at.prod() / away**2 * (towards - across))
        found = spot_px2[0, half + at[0], half + at[1], 2]
        np.testing.assert_allclose(found, leans[-1], atol=0.1 * abs(towards - across) + 1e-4)
    assert np.abs(leans).max() > 1e-3
    np.testing.assert_allclose(spot_px2[0, half, :, 2], 0.0, atol=1e-4)
    np.testing.assert_allclose(spot_px2[0, ::-1, :, 2], -spot_px2[0, ..., 2], atol=1e-4)


def test_what_the_moments_of_a_corner_leave_out_is_told() -> None:
    lens, grid = load_lens("al2550"), Grid((24, 24), (0.4, 0.4))
    field = lens_field(lens, grid, None)
    spot_px2 = field.at([[0.0, 0.0]]).spot_px2
    assert spot_px2 is not None
    corner = fields_for_image(lens, np.full((1, 2), 11.5 * 0.4))[0]
    cpp, aslant_rad = np.arange(1, 8) / 8, np.array([0.25, 0.75]) * np.pi
    traced = np.abs(fast_otf(lens, corner, cpp / 0.4, aslant_rad))
    v_row, v_col, lean = spot_px2[0, 23, 23]
    model = [
        np.exp(-2.0 * (np.pi * cpp) ** 2 * (0.5 * (v_row + v_col) + sign * lean))
        for sign in (1, -1)
    ]
    off = np.sinc(cpp / 2**0.5) ** 2 * np.abs(traced - model)
    assert 0.03 < off.max() < 1.2 * field.contrast_error


@pytest.mark.parametrize("skew_px3", [-0.1, 0.0, 0.02, 0.2])
def test_a_third_moment_is_read_from_its_own_phase(skew_px3: float) -> None:
    w = 2.0 * np.pi * np.arange(1, 8) / 8
    otf = np.exp(-0.5 * 0.3**2 * w**2 + 1j / 6.0 * skew_px3 * w**3)
    assert equivalent_spot(otf) == pytest.approx((0.09, skew_px3), abs=1e-5)


def test_a_gaussian_stands_for_itself() -> None:
    sigma_px = np.array([0.02, 0.2, 0.6])
    cycles = np.arange(1, 8) / 8
    contrast = np.exp(-2 * (np.pi * sigma_px[:, None] * cycles) ** 2)
    np.testing.assert_allclose(np.sqrt(equivalent_px2(contrast)), sigma_px, rtol=2e-2)


def test_a_tilted_plate_moves_the_image_as_the_closed_form_says() -> None:
    singlet = load_lens("al2550")
    thick_mm = 3.0
    behind_mm = thick_mm * (1 - 1 / refractive_index("N-BK7", 780.0))  # the plate moves the focus
    lens = Lens(
        (*singlet.elements, cover_glass("N-BK7", thick_mm)), (35.0, 11.0 - thick_mm + behind_mm),
        Stop(0.5), wavelength_nm=780.0,
    )  # fmt: skip
    field = lens_field(lens, Grid((3, 5), (0.05, 0.05)), 1, motion="tilt", reach_px=1.0)
    assert field.unit == "rad"
    angle = 0.9 * field.reach[0]
    found_mm = 0.05 * np.abs(field.at([[angle, 0.0]]).offset_px[0, 1, 2]).max()
    n = refractive_index("N-BK7", 780.0)
    sine = math.sin(angle)
    expected_mm = thick_mm * sine * (1 - math.cos(angle) / math.sqrt(n * n - sine * sine))
    assert found_mm == pytest.approx(expected_mm, rel=2e-3)


@pytest.mark.slow
def test_a_tilt_that_blurs_far_from_rest_is_told_near_it() -> None:
    """Beyond one pixel of shift the contrast is gone and its widths are no polynomial."""
    lens, grid = load_lens("petzval_a"), Grid((16, 64), (0.155, 0.155))
    field = lens_field(lens, grid, 0, motion="tilt")
    state = field.states([[0.25, 0.25]])
    build = moving(lens, 0, state, tilt=True)
    contrast = fast_otf(lens, np.zeros(2), [1.0, 2.0, 3.226], build=build).real[0, 0]
    width_px = np.sqrt(field.at(state).spot_px2[0, 7:9, 31:33].mean())
    gaussian = np.exp(-2.0 * (np.pi * width_px * 0.155 * np.array([1.0, 2.0, 3.226])) ** 2)
    assert gaussian == pytest.approx(contrast, abs=0.02)
    with pytest.warns(QualityWarning, match="widths of the spot are fitted to 0.3.* px only"):
        lens_field(lens, grid, 0, motion="tilt", reach_px=1.5)


def test_a_lens_without_power_is_refused_before_the_work() -> None:
    plate = cover_glass("N-BK7", 3.0)
    with pytest.raises(ValueError, match="expected a lens with power"):
        lens_field(Lens((plate,), (10.0,), Stop(5.0)), SENSOR, 0)


def test_a_moving_sensor_moves_the_whole_image_the_other_way() -> None:
    field = lens_field(load_lens("petzval_a"), SENSOR, None)
    offset_px = field.at([[0.1, -0.2]]).offset_px
    moved = np.broadcast_to([-0.1 / 0.31, 0.2 / 0.42], offset_px.shape)
    np.testing.assert_allclose(offset_px, moved, atol=1e-12)
    np.testing.assert_allclose(
        field.of(burst_of(field)).offset_px, np.broadcast_to(PLAN[:, None, None], (5, 7, 23, 2)),
        atol=1e-9,
    )  # fmt: skip


def test_frames_may_come_in_any_order() -> None:
    field = field_of("petzval_b", 0)
    order = [3, 0, 4, 1, 2]
    one, other = field.of(burst_of(field)), field.of(burst_of(field, PLAN[order]))
    np.testing.assert_allclose(other.offset_px, one.offset_px[order], atol=1e-12)
    np.testing.assert_array_equal(one.select(order).offset_px, one.offset_px[order])


def test_a_burst_of_something_else_is_refused_with_the_cure() -> None:
    field = field_of("petzval_b", 0)
    stage_mm = PLAN @ np.array([[0.18, 0.01], [-0.01, 0.17]])
    optics = {"lens": "Petzval A", "element": 0}
    other = Burst.from_arrays(np.ones((5, 23, 7)), offset_px=PLAN, pitch_mm=SENSOR.pitch_mm)
    cases = [
        (other, "shape", "make it with --sensor 7x23"),
        (burst_of(field, pitch_mm=0.155), "pitch_mm", "make it with --pitch-mm 0.155,0.155"),
        (burst_of(field, 3.0 * PLAN), "offset_px", "make it with --reach-px 1.5"),
        (burst_of(field, offset_source="unknown"), "offset_px", "`lensshift register`"),
        (burst_of(field, meta={"optics": optics}), "meta.optics.lens", "taken with 'Petzval A'"),
        (
            burst_of(field, meta={"optics": {"lens": field.lens, "element": 1}}),
            "meta.optics.element",
            "make it with --element 2",
        ),
        (burst_of(field, meta={"optics": {"focal_length_mm": 42.7}}), "meta.optics", "plain lens"),
        (
            burst_of(field, meta={"optics": field.optics | {"motion": "tilt"}}),
            "meta.optics.motion",
            "make it with --tilt",
        ),
        (
            burst_of(field, meta={"optics": field.optics | {"wavelength_nm": 940.0}}),
            "meta.optics.wavelength_nm",
            "make it with --wavelength-nm 940",
        ),
        (
            burst_of(field, meta={"optics": field.optics | {"from_focus_mm": 0.2}}),
            "meta.optics.from_focus_mm",
            r"one with a sensor \+0.2 mm from its image; make it from the lens file",
        ),
        (
            burst_of(field, meta={"optics": field.optics | {"image_per_field_mm": 42.0}}),
            "meta.optics.image_per_field_mm",
            "one with 42 mm of image per tangent",
        ),
        (
            burst_of(field, stage_mm=stage_mm[[0, 1, 2, 4, 3]]),
            "offset_px",
            "do not follow the stage positions",
        ),
    ]
    for burst, name, cure in cases:
        with pytest.raises(DataError, match=cure) as caught:
            field.of(burst)
        assert caught.value.field == name
    assert (
        field.of(burst_of(field, stage_mm=stage_mm, meta={"optics": "unknown"})).spot_px2
        is not None
    )


@pytest.mark.slow
def test_half_the_reach_where_the_lens_cuts_off_light() -> None:
    lens = load_lens("petzval_b")
    sensor = Grid((16, 64), (0.155, 0.155))
    whole = lens_field(lens, Grid((5, 9), sensor.pitch_mm), 2)
    with pytest.warns(QualityWarning, match="cut off light"):
        half = lens_field(lens, sensor, 2)
    assert np.divide(half.reach, whole.reach) == pytest.approx(0.5, rel=0.01)


def test_wrong_requests() -> None:
    lens = load_lens("petzval_a")
    with pytest.raises(ValueError, match="element from 0 to 2, got 5"):
        lens_field(lens, SENSOR, 5)
    with pytest.raises(ValueError, match="positive reach_px"):
        lens_field(lens, SENSOR, 0, reach_px=0.0)
    with pytest.raises(ValueError, match="decentre or tilt of an element, got 'tilt' of None"):
        lens_field(lens, SENSOR, None, motion="tilt")
    glazed = Lens(
        (*load_lens("al2550").elements, cover_glass("N-BK7", 1.0)), (40.0, 5.3), Stop(10.0),
        wavelength_nm=780.0,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"decentre moves the image, but element 2 .cover glass."):
        lens_field(glazed, SENSOR, 1)
    field = field_of("petzval_b", 0)
    with pytest.raises(DataError, match="expected states up to"):
        field.at([[9.0, 0.0]])
    with pytest.raises(DataError, match="expected finite states"):
        field.at([[np.nan, 0.0]])
    with pytest.raises(DataError, match=r"shift_px: expected \[i j a b 2\]"):
        replace(field, shift_px=np.zeros((2, 2)))


def test_a_lens_out_of_focus_is_refused_before_the_work() -> None:
    lens = load_lens("petzval_a")
    blurred = lens.with_sensor(lens.gaps_mm[-1] + 60.0)
    told: list[int] = []
    with pytest.raises(ValueError, match=r"in focus, got a spot of .* lies -59\.\d+ mm from it"):
        lens_field(blurred, SENSOR, on_progress=lambda done, of: told.append(done))
    assert not told


@pytest.mark.parametrize("reach_px", [None, 0.6])
def test_the_traces_of_a_field_are_counted(reach_px: float | None) -> None:
    told: list[tuple[int, int]] = []
    lens_field(
        load_lens("al2550"), Grid((3, 5), (0.5, 0.5)), 0, reach_px=reach_px,
        on_progress=lambda done, of: told.append((done, of)),
    )  # fmt: skip
    assert [done for done, _ in told] == list(range(1, len(told) + 1))
    assert 5 <= len(told) <= told[0][1]  # the least: one degree each of shifts and spots
