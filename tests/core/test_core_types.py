"""The nouns: what they accept, what they refuse, and the half-pixel rule."""

import dataclasses
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, shift

from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid, hr_to_lr, lr_to_hr
from lensshift.core.types import Burst, Frame, MtfCurve, ShiftField, ShiftPlan, StageMap
from lensshift.core.units import (
    distance_to_phase,
    doubt_about_units,
    phase_to_distance,
    unambiguous_range_m,
)

SHAPE = (5, 7)
OFFSET_PX = np.array([[0.0, 0.0], [0.5, -0.25], [0.1, 0.2]])


def make_burst(**fields: object) -> Burst:
    complete = {
        "amplitude": np.arange(105.0).reshape(3, *SHAPE),
        "offset_px": OFFSET_PX,
        "pitch_mm": (0.15, 0.1),
    }
    return Burst.from_arrays(**(complete | fields))  # type: ignore[arg-type]


@given(st.integers(1, 8), st.integers(0, 50))
def test_hr_pixels_tile_their_lr_pixel(scale: int, index: int) -> None:
    children = index * scale + np.arange(scale)
    assert hr_to_lr(children, scale).mean() == pytest.approx(index)
    np.testing.assert_allclose(lr_to_hr(hr_to_lr(children, scale), scale), children, atol=1e-9)


def test_a_finer_grid_covers_the_same_area() -> None:
    grid = Grid(SHAPE, (0.15, 0.1))
    fine = grid.refine(3)
    assert fine.shape == (15, 21)
    np.testing.assert_allclose(
        np.multiply(fine.shape, fine.pitch_mm), np.multiply(grid.shape, grid.pitch_mm)
    )
    with pytest.raises(ValueError, match="at least 1 x 1"):
        Grid((0, 4), (1.0, 1.0))
    with pytest.raises(ValueError, match="positive"):
        Grid(SHAPE, (0.1, -0.1))


@given(st.floats(0.01, 7.4))
def test_phase_and_distance_are_inverse(distance_m: float) -> None:
    phase = distance_to_phase(distance_m, 20e6)
    assert phase_to_distance(phase, 20e6) == pytest.approx(distance_m)
    assert distance_to_phase(unambiguous_range_m(20e6), 20e6) == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, np.nan])
def test_no_range_without_a_frequency(frequency_hz: float) -> None:
    with pytest.raises(ValueError, match="positive modulation frequency"):
        unambiguous_range_m(frequency_hz)


def test_selection_keeps_frames_and_offsets_together() -> None:
    burst = make_burst(time_s=[1.0, 2.0, 3.0])
    part = burst.select([2, 0])
    np.testing.assert_array_equal(part.amplitude, burst.amplitude[[2, 0]])
    np.testing.assert_array_equal(part.offset_px, OFFSET_PX[[2, 0]])
    assert part.time_s is not None
    np.testing.assert_array_equal(part.time_s, [3.0, 1.0])
    with pytest.raises(ValueError, match="frame numbers from 0 to 2"):
        burst.select([3])
    with pytest.raises(dataclasses.FrozenInstanceError):
        burst.grid = burst.grid.refine(2)  # type: ignore[misc]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"amplitude": np.zeros((3, 5))}, "amplitude: expected .frame row col."),
        ({"amplitude": np.zeros((3, 0, 7))}, "amplitude: expected at least one pixel"),
        ({"amplitude": np.full((3, *SHAPE), np.nan)}, "amplitude: every valid pixel is NaN"),
        ({"amplitude": np.full((3, *SHAPE), "a")}, "amplitude: expected numbers"),
        ({"offset_px": np.zeros((2, 2))}, "offset_px: expected shape .3, 2."),
        ({"offset_px": [[0, 0], [0, 1], [0, np.inf]]}, "offset_px: expected finite"),
        ({"offset_sigma_px": np.full((3, 2), -0.1)}, "offset_sigma_px: expected no negative"),
        ({"valid": np.zeros((3, *SHAPE), bool)}, "valid: every pixel is marked invalid"),
        ({"amplitude": np.full((3, *SHAPE), 1e160)}, "amplitude: expected values of 1e-100 to 1e"),
        ({"amplitude": np.full((3, *SHAPE), -1e-160)}, "got 1e-160; give them in another unit"),
        ({"valid": np.ones((3, 5, 6), bool)}, "valid: expected shape"),
        ({"distance_m": np.zeros((3, 5, 6))}, "distance_m: expected shape"),
        ({"pitch_mm": 0.0}, "pitch_mm: expected two positive pitch_mm"),
        ({"modulation_hz": -1.0}, "modulation_hz: expected a positive frequency"),
        ({"modulation_hz": []}, "modulation_hz: expected a positive frequency"),
        ({"modulation_hz": [[15e6, 20e6]]}, "modulation_hz: expected a positive frequency"),
        ({"modulation_hz": [15e6, np.nan]}, "modulation_hz: expected a positive frequency"),
        ({"modulation_hz": "fast"}, "modulation_hz: expected frequencies"),
        ({"modulation_hz": [15e6, 15e6]}, "modulation_hz: expected different frequencies"),
        ({"offset_source": "guessed"}, "offset_source: expected one of planned"),
        ({"time_s": [1.0]}, "time_s: expected shape"),
    ],
)
def test_a_burst_that_contradicts_itself(fields: dict[str, object], said: str) -> None:
    with pytest.raises(DataError, match=said) as caught:
        make_burst(**fields)
    assert "\n" not in str(caught.value)


def test_one_bad_pixel_must_be_marked() -> None:
    amplitude = np.ones((3, *SHAPE))
    amplitude[1, 2, 3] = np.nan
    with pytest.raises(DataError, match="1 of 105 pixels"):
        make_burst(amplitude=amplitude)
    assert make_burst(amplitude=amplitude, valid=np.isfinite(amplitude)).frame_count == 3


def test_other_nouns_refuse_the_wrong_shape() -> None:
    with pytest.raises(ValueError, match="rising"):
        MtfCurve(np.array([1.0, 1.0]), np.ones(2))
    with pytest.raises(ValueError, match="of shape"):
        MtfCurve(np.array([0.0, 1.0]), np.ones(3))
    with pytest.raises(DataError, match="valid: expected"):
        Frame(np.zeros(SHAPE), None, np.ones((7, 5), bool), 0.0)


def test_what_was_checked_cannot_change_afterwards() -> None:
    raw, offset_px = np.ones((2, 4, 6)), np.zeros((2, 2))
    sent, meta = np.zeros((2, 3)), {"camera": "a"}
    burst = Burst.from_arrays(
        raw, raw, offset_px=offset_px, pitch_mm=0.1, raw={"sent": sent}, meta=meta
    )
    # As a driver does that fills one buffer again and again.
    raw[:], offset_px[:], sent[:], meta["camera"] = np.nan, 7.0, 1.0, "b"
    assert np.all(burst.amplitude == 1.0)
    assert np.all(burst.distance_m == 1.0)
    assert np.all(burst.offset_px == 0.0)
    assert np.all(burst.raw["sent"] == 0.0)
    assert burst.meta == {"camera": "a"}
    again = burst.select([0, 1])
    for one in (burst, again, replace(burst, modulation_hz=1e6)):
        for values in (one.amplitude, one.distance_m, one.valid, one.offset_px, one.raw["sent"]):
            with pytest.raises(ValueError, match="read-only"):
                values[0] = 0
    assert replace(burst, modulation_hz=1e6).amplitude is burst.amplitude  # copied only once


def test_arrays_of_all_core_types_are_read_only() -> None:
    flat, line = np.ones((3, 3)), np.arange(3.0)
    arrays = [
        Frame(flat, flat, flat > 0, 0.0).amplitude,
        ShiftField(np.zeros((1, 2, 2, 2))).offset_px,
        ShiftPlan(np.zeros((2, 2))).target_px,
        StageMap(np.eye(2)).px_per_mm,
        MtfCurve(line, line).modulation,
        Calibration(StageMap(np.eye(2)), np.zeros(2)).rest_mm,
    ]
    assert not any(values.flags.writeable for values in arrays)
    line[:] = flat[:] = -1.0
    assert np.all(arrays[0] == 1.0)
    np.testing.assert_array_equal(arrays[4], np.arange(3.0))


@pytest.mark.parametrize(
    ("modulation_hz", "distance_m", "doubted"),
    [
        (15e6, 3.7, None),
        (15e6, 150.0, None),  # as far as several frequencies tell
        (100e6, 30.0, None),
        (15e6, 3700.0, "distance_m: expected metres, got a median of 3700 where light of"),
        (100e6, 140.0, "distance_m: expected metres"),
        (15e6, -1.2, "distance_m: expected distances from the camera, got a median of -1.2 m"),
        (150.0, 3.7, "modulation_hz: expected a frequency in Hz, got 150"),
        (15e3, 3.7, "modulation_hz: expected a frequency in Hz, got 15000"),
        (15.0, 3.7, "modulation_hz: expected a frequency in Hz, got 15; 15 MHz are 15e6"),
        (15.0, None, "modulation_hz: expected a frequency in Hz"),
    ],
)
def test_other_units_than_metres_and_hertz_are_questioned(
    modulation_hz: float, distance_m: float | None, doubted: str | None
) -> None:
    frames = np.ones((1, *SHAPE))
    given = None if distance_m is None else distance_m * frames
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Burst.from_arrays(
            frames, given, offset_px=[[0, 0]], pitch_mm=0.1, modulation_hz=modulation_hz
        )
    assert [w.category for w in caught] == ([QualityWarning] if doubted else [])
    assert str(caught[0].message).startswith(doubted) if doubted else True


@pytest.mark.parametrize(
    ("distance_m", "meant"), [(3700.0, "are they millimetres?"), (396.0, "are they centimetres or")]
)
def test_the_unit_of_a_distance_is_guessed_by_what_light_can_tell(
    distance_m: float, meant: str
) -> None:
    assert meant in doubt_about_units(15e6, distance_m)


def test_pixels_that_measured_nothing_are_questioned_unless_marked() -> None:
    light, far_m = np.ones((1, *SHAPE)), np.full((1, *SHAPE), 3.0)
    light[0, 2, 3] = far_m[0, 2, 3] = far_m[0, 1, 1] = light[0, 3, 3] = 0.0
    told = {"offset_px": [[0, 0]], "pitch_mm": 0.1, "modulation_hz": 15e6}
    with pytest.warns(QualityWarning, match="distance_m: 2 of 35 pixels are 0, as where nothing"):
        Burst.from_arrays(light, far_m, **told)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Burst.from_arrays(light, far_m, valid=(light > 0) | (far_m > 0), **told)


@pytest.mark.parametrize(
    ("mark_m", "questioned"),
    [(0.0, True), (-1.0, True), (65.535, True), (9.5, False), (-0.7, True), (np.nan, False)],
)
@pytest.mark.parametrize("modulation_hz", [15e6, None])
def test_numbers_that_stand_for_no_distance_are_left_out(
    mark_m: float, questioned: bool, modulation_hz: float | None
) -> None:
    rng = np.random.default_rng(5)
    light, far_m = rng.uniform(1, 2, (2, *SHAPE)), rng.uniform(2, 3, (2, *SHAPE))
    far_m[:, 2, 3:5] = mark_m
    valid, told = np.isfinite(far_m), {"pitch_mm": 0.1, "modulation_hz": modulation_hz}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        burst = Burst.from_arrays(light, far_m, offset_px=np.zeros((2, 2)), valid=valid, **told)
    np.testing.assert_array_equal(burst.valid, valid & ~((far_m == mark_m) & questioned))
    said = f"distance_m: 4 of 70 pixels are {mark_m:g}, as where"
    assert [said in str(one.message) for one in caught] == [True] * questioned


def test_distances_about_zero_of_a_camera_that_rounds_are_none_of_these() -> None:
    rng = np.random.default_rng(6)
    far_m = np.round(np.mod(rng.normal(0.0, 0.3, (40, *SHAPE)), 9.99), 2)
    assert np.count_nonzero(far_m == 0.0) > 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Burst.from_arrays(1 + far_m, far_m, offset_px=np.zeros((40, 2)), modulation_hz=15e6)


def test_whole_metres_are_questioned() -> None:
    far_m = np.arange(70).reshape(2, *SHAPE) % 5 + 1
    with pytest.warns(QualityWarning, match="distance_m: whole metres only"):
        Burst.from_arrays(1.0 + far_m, far_m, offset_px=np.zeros((2, 2)), modulation_hz=15e6)


def test_a_mask_of_the_sensor_holds_for_all_frames() -> None:
    mask = np.ones(SHAPE, bool)
    mask[2, 3] = False
    for valid in (mask, mask[None]):
        burst = Burst.from_arrays(np.ones((3, *SHAPE)), valid=valid)
        assert burst.valid is not None
        np.testing.assert_array_equal(burst.valid, np.broadcast_to(mask, (3, *SHAPE)))


@pytest.mark.parametrize(
    ("frames", "cure"),
    [
        ([np.ones(SHAPE), np.ones((2, 3))], "amplitude: expected images of one size"),
        (np.ones((3, 4, *SHAPE)), "make complex frames: .d0 - d2. .*d1 - d3"),
        (np.ones((3, 2, *SHAPE)), "make complex frames: re"),
        (np.ones((2, 3, *SHAPE), complex), "modulation_hz: expected as many frequencies"),
    ],
)
def test_arrays_of_four_axes_are_refused_with_their_cure(frames: object, cure: str) -> None:
    with pytest.raises(DataError, match=cure):
        Burst.from_arrays(frames)


def drawn(count: int, seed: int) -> np.ndarray:
    """Return frames [frame row col] of a textured scene that moves by parts of a pixel."""
    rng = np.random.default_rng(seed)
    rows, cols = rng.integers(10, 60, 2)
    scene = gaussian_filter(rng.normal(size=(rows + 4, cols + 4)), 1.5)
    moved = [shift(scene, one, order=1)[2:-2, 2:-2] for one in rng.uniform(-0.5, 0.5, (count, 2))]
    return np.array(moved) + 0.01 * rng.normal(size=(count, rows, cols))


@pytest.mark.parametrize("seed", range(12))
def test_frames_along_another_axis_are_questioned_or_refused(seed: int) -> None:
    frames = drawn(int(np.random.default_rng(seed).choice([2, 4, 9])), seed)
    Burst.from_arrays(frames)  # without a warning, which tests take for an error
    Burst.from_arrays(frames[::-1], offset_px=np.zeros((len(frames), 2)))
    for axis in (1, 2):
        turned = np.moveaxis(frames, 0, axis)
        cure = rf"np.moveaxis\(frames, {axis}, 0\)"
        with pytest.warns(QualityWarning, match=f"as alike as frames.*{cure}"):
            Burst.from_arrays(turned)
        with pytest.raises(DataError, match=f"{len(frames)} offsets.*{cure}"):
            Burst.from_arrays(turned, offset_px=np.zeros((len(frames), 2)))
    with pytest.warns(QualityWarning, match="along axis 2"):
        Burst.from_arrays(np.moveaxis(frames * np.exp(0.1j * frames), 0, 2))


@pytest.mark.parametrize("seed", range(4))
def test_long_recordings_in_which_something_passes_are_not_questioned(seed: int) -> None:
    rows, cols, count = 16, 64, 100
    scene = drawn(1, seed)[0]
    hand_col = np.linspace(-9, cols + 9, count)[:, None, None]
    hidden = np.abs(np.arange(cols) - hand_col) < 6  # [frame 1 col]
    frames = np.where(hidden, 9.0, np.resize(scene, (rows, cols)))
    Burst.from_arrays(frames)  # without a warning, which tests take for an error


def test_one_image_and_colours_are_refused_with_their_cure() -> None:
    with pytest.raises(DataError, match=r"image\[None\]"):
        Burst.from_arrays(np.ones((8, 9)))
    with pytest.raises(DataError, match=r"of colours.*frames.mean\(-1\)"):
        Burst.from_arrays(np.ones((4, 8, 9, 3)))


@pytest.mark.parametrize("pitch_mm", [155.0, (0.155, 155.0)])
def test_a_pitch_that_can_hardly_be_in_millimetres_is_questioned(pitch_mm: object) -> None:
    with pytest.warns(QualityWarning, match="pitch_mm: expected the pixel pitch in mm, got"):
        Burst.from_arrays(np.ones((1, *SHAPE)), offset_px=[[0, 0]], pitch_mm=pitch_mm)


@pytest.mark.parametrize("sent", [5.0, np.ones(3), np.ones((1, 2, 4, 6))])
def test_what_the_camera_sent_has_an_entry_a_frame(sent: object) -> None:
    with pytest.raises(DataError, match="raw_sent"):
        Burst.from_arrays(
            np.ones((2, 4, 6)), offset_px=np.zeros((2, 2)), pitch_mm=0.1, raw={"sent": sent}
        )


@pytest.mark.parametrize("phases", ["one by one", "at each position", "opposite ones together"])
def test_raw_phases_are_no_pictures(phases: str) -> None:
    """The warning says how to make phasors of them."""
    rng = np.random.default_rng(11)
    light, turn = rng.uniform(1, 2, (1, 4, 5)), rng.uniform(0, 6, (1, 4, 5))
    waves = np.kron(light * np.exp(1j * turn), np.ones((4, 12, 12))) + rng.normal(
        0, 0.01, (4, 1, 1)
    )
    d = np.stack([3.0 + (waves * 1j**-k).real for k in range(4)], 1)  # [position phase row col]
    if phases == "opposite ones together":
        d = d[:, [0, 2, 1, 3]]
    frames = d.reshape(-1, 48, 60)
    if phases == "one by one":
        frames = d.swapaxes(0, 1).reshape(-1, 48, 60)
    with pytest.warns(QualityWarning, match="look like the four phases of 4 positions") as found:
        Burst.from_arrays(frames)
    cure = str(found[0].message).partition("with d = ")[2]
    how, _, rest = cure.partition(" give phasors, ")
    told = {"frames": frames, "d": eval(how, {"frames": frames})}
    np.testing.assert_allclose(eval(rest.partition(", and")[0], told), 2 * waves, atol=1e-9)
    with warnings.catch_warnings(action="error"):  # pictures, at shifts and of light that differs
        pictures = [
            np.roll(light.repeat(12, 1).repeat(12, 2)[0], k % 2, k // 2 % 2) for k in range(8)
        ]
        Burst.from_arrays(np.array(pictures) * np.array([1, 2, 4, 8] * 2)[:, None, None])
