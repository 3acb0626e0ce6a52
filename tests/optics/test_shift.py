"""Shift maps, their inverse, and the choice of the element."""

import numpy as np
import pytest

from lensshift.core.grid import Grid
from lensshift.core.motion import ShiftField
from lensshift.optics.lens import Lens, Stop, cover_glass
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import pixel_centres_mm
from lensshift.optics.otf import exact_otf
from lensshift.optics.shift import (
    decenter_for_shift,
    moving,
    px_per_um,
    shift_map,
    shift_uniformity,
)
from lensshift.optics.spots import fields_for_image, image_per_field_mm, spots
from lensshift.optics.which import (
    AZIMUTHS_RAD,
    DIAGONALS,
    edge_fields,
    format_movers,
    least_mtf,
    which_element,
)

SENSOR = Grid((16, 64), (0.155, 0.155))
SMALL = Grid((3, 5), (0.7, 1.9))


@pytest.mark.parametrize(
    ("name", "strokes_um"),
    [("petzval_a", (44.4, 126.7, -232.0)), ("petzval_b", (44.1, 127.3, -230.0))],
)
def test_strokes_per_quarter_pixel(name: str, strokes_um: tuple[float, ...]) -> None:
    lens = load_lens(name)
    for element, stroke_um in enumerate(strokes_um):
        move_mm = decenter_for_shift(lens, element, [0.25, 0.25], SENSOR)
        assert 1e3 * move_mm == pytest.approx([stroke_um] * 2, rel=5e-3)
        centre = shift_map(lens, element, move_mm, Grid((1, 1), SENSOR.pitch_mm))
        assert centre.offset_px[0, 0, 0] == pytest.approx([0.25, 0.25], abs=1e-8)


@pytest.mark.parametrize(
    ("name", "errors_px"),
    [("petzval_a", (0.0157, 0.0026, 0.080)), ("petzval_b", (0.0275, 0.0022, 0.170))],
)
def test_studied_shift_errors(name: str, errors_px: tuple[float, ...]) -> None:
    # As in the study: object points whose paraxial images are the pixel centres.
    lens = load_lens(name)
    fields = pixel_centres_mm(SENSOR).reshape(-1, 2) / image_per_field_mm(lens)
    rest_mm = spots(lens, fields, rings=3).centroid_mm
    for element, studied_px in enumerate(errors_px):
        move_mm = decenter_for_shift(lens, element, [0.25, 0.25], SENSOR)
        moved_mm = spots(lens, fields, build=moving(lens, element, move_mm), rings=3).centroid_mm
        error_px = np.linalg.norm((moved_mm - rest_mm) / 0.155 - 0.25, axis=-1).max()
        assert error_px == pytest.approx(studied_px, rel=0.02, abs=5e-5)


def test_shift_map_of_the_first_element_grows_towards_the_edge() -> None:
    lens = load_lens("petzval_a")
    move_mm = decenter_for_shift(lens, 0, [0.0, 0.25], SENSOR)
    offset = shift_map(lens, 0, move_mm, SENSOR).offset_px
    assert offset.shape == (1, 16, 64, 2)
    assert offset[0, 7:9, 31:33, 1] == pytest.approx(0.25, abs=1e-4)
    assert offset[0, :, [0, -1], 1] == pytest.approx(0.2623, abs=1.5e-3)
    assert np.abs(offset[0, ..., 0]).max() == pytest.approx(0.0018, abs=2e-4)


def test_some_pixels_tell_as_much_as_all() -> None:
    lens, grid = load_lens("petzval_b"), Grid((7, 41), (0.31, 0.24))
    move_mm = [0.03, -0.05]
    every = shift_map(lens, 0, move_mm, grid).offset_px[0]
    some = shift_map(lens, 0, move_mm, grid, most=11).offset_px[0]
    assert some.shape == (7, 11, 2)
    assert some == pytest.approx(every[:, ::4], abs=1e-9)


def test_offsets_connect_the_two_images_of_a_point() -> None:
    lens = load_lens("petzval_b")
    move_mm = np.array([0.3, -0.2])
    offset = shift_map(lens, 2, move_mm, SMALL).offset_px[0]
    # Where the point seen by pixel (2, 4) was before the move, found by following it back.
    before_mm = pixel_centres_mm(SMALL)[2, 4] - offset[2, 4] * np.asarray(SMALL.pitch_mm)
    build = moving(lens, 2, move_mm)
    field = fields_for_image(lens, before_mm)
    after_mm = spots(lens, field, build=build, rings=2).centroid_mm
    assert after_mm == pytest.approx(pixel_centres_mm(SMALL)[2, 4], abs=1e-5)


def test_opposite_moves_and_mirrored_pixels() -> None:
    lens = load_lens("petzval_a")
    moves = np.array([[0.04, 0.02], [-0.04, -0.02]])
    plus, minus = shift_map(lens, 0, moves, SMALL).offset_px
    # Turning the camera by half a turn turns moves and pixels.
    assert plus == pytest.approx(-minus[::-1, ::-1], abs=1e-7)


def test_uniformity_of_a_made_up_field() -> None:
    offset = np.full((1, 3, 5, 2), 0.25)
    offset[0, 1, 2] += (0.03, 0.04)
    even = shift_uniformity(ShiftField(offset), [[0.25, 0.25]])[0]
    assert even.max_error_px == pytest.approx(0.05)
    assert even.rms_error_px == pytest.approx(0.05 / np.sqrt(15))
    assert even.mean_px == pytest.approx((0.252, 0.25 + 0.04 / 15))
    with pytest.raises(ValueError, match=r"wanted_px of \(1, 2\)"):
        shift_uniformity(ShiftField(offset), [0.25, 0.25])


@pytest.mark.slow
def test_which_element_of_the_studied_lens() -> None:
    lens = load_lens("petzval_a")
    movers = which_element(lens, SENSOR)
    first, second, third = movers
    assert [mover.element for mover in movers] == [0, 1, 2]
    # The trade: the first has the shortest stroke, the second the most even shift, and the
    # third is worst in evenness and sharpness.
    assert first.stroke_mm < second.stroke_mm < abs(third.stroke_mm)
    assert second.max_shift_error_px < 0.2 * first.max_shift_error_px
    assert third.max_shift_error_px > first.max_shift_error_px
    assert first.mtf_loss < second.mtf_loss < third.mtf_loss
    assert first.mtf_loss == pytest.approx(0.024, abs=3e-3)
    assert second.mtf_loss == pytest.approx(0.032, abs=3e-3)
    assert first.sensitivity_px_per_um == pytest.approx(0.0056, abs=1e-4)
    assert second.sensitivity_px_per_um == pytest.approx(0.0020, abs=1e-4)
    assert len(format_movers(movers).splitlines()) == 4
    assert len({len(line) for line in format_movers(movers).splitlines()[1:]}) == 1


def test_elements_without_power_do_not_move_the_image() -> None:
    lens = load_lens("al2550")
    glazed = Lens(
        (*lens.elements, cover_glass("N-BK7", 1.0)), (40.0, 5.3), Stop(10.0), wavelength_nm=780.0
    )
    movers = which_element(glazed, SMALL, shift_px=0.1, frequency_lpmm=5.0)
    assert [mover.element for mover in movers] == [0]
    with pytest.raises(ValueError, match=r"element 2 .cover glass. moves it by"):
        decenter_for_shift(glazed, 1, [0.1, 0.1], SMALL)
    assert shift_map(glazed, 1, [0.1, 0.1], SMALL).offset_px == pytest.approx(0.0, abs=1e-9)


def test_wrong_requests() -> None:
    lens = load_lens("petzval_a")
    with pytest.raises(ValueError, match="element from 0 to 2, got 5"):
        shift_map(lens, 5, [0.0, 0.1], SMALL)
    with pytest.raises(ValueError, match=r"finite decenter_mm \[frame 2\]"):
        shift_map(lens, 0, [0.1], SMALL)
    with pytest.raises(ValueError, match="no ray of"):
        shift_map(lens, 0, [0.0, 40.0], SMALL)
    with pytest.raises(ValueError, match=r"finite offset_px \[... 2\]"):
        decenter_for_shift(lens, 0, [0.1], SMALL)
    with pytest.raises(ValueError, match="positive shift_px"):
        which_element(lens, SMALL, shift_px=0.0)
    assert edge_fields(lens, SMALL).shape == (9, 2)


@pytest.mark.slow
def test_the_least_mtf_is_that_of_all_fields_directions_and_moves() -> None:
    grid = Grid((5, 9), (0.5, 0.9))
    lens = load_lens("petzval_b")
    rest, moved = least_mtf(lens, grid, 0, shift_px=0.2, frequency_lpmm=4.0)
    fields = edge_fields(lens, grid)
    assert rest == pytest.approx(
        min(np.abs(exact_otf(lens, field, 4.0, AZIMUTHS_RAD)).min() for field in fields)
    )
    # All four moves, also those that symmetry lets the package leave out.
    moves_mm = decenter_for_shift(lens, 0, 0.2 * DIAGONALS, grid)
    all_moved = [
        np.abs(exact_otf(lens, field, 4.0, AZIMUTHS_RAD, build=moving(lens, 0, move))).min()
        for field in fields
        for move in moves_mm
    ]
    assert moved == pytest.approx(min(all_moved), abs=1e-6)
    assert least_mtf(lens, grid, frequency_lpmm=4.0) == pytest.approx((rest, rest))
    leaning = lens.with_tilt(1, (0.01, 0.0))  # no symmetry: the worst of the moves
    _, worst = least_mtf(leaning, grid, 0, shift_px=0.2, frequency_lpmm=4.0)
    moves_mm = decenter_for_shift(leaning, 0, 0.2 * DIAGONALS, grid)
    fields = edge_fields(leaning, grid)
    found = [
        np.abs(exact_otf(leaning, field, 4.0, AZIMUTHS_RAD, build=moving(leaning, 0, move))).min()
        for field in fields
        for move in moves_mm
    ]
    assert worst == pytest.approx(min(found))
    assert min(found[0::4]) != pytest.approx(worst, abs=1e-6)


def test_px_per_um_is_the_slope_in_the_middle() -> None:
    lens, grid = load_lens("petzval_a"), Grid((5, 9), (0.2, 0.1))
    move_mm = decenter_for_shift(lens, 1, [0.0, 0.25], grid)
    assert px_per_um(lens, 1, grid) == pytest.approx(0.25 / (1e3 * move_mm[1]), rel=1e-4)
