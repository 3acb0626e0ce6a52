"""What a scan says of a rig whose faults are known."""

import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rig import Rig

from lensshift.capture.emulators.rig import EmulatedWorld, RigSettings
from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.lens_field import LensField
from lensshift.core.motion import StageMap
from lensshift.core.types import Burst
from lensshift.io.calibration_file import load_calibration, save_calibration
from lensshift.registration import calibration_scan_mm, fit_scan
from lensshift.registration.calibrate import ScanFit
from lensshift.scene import Plane, Rectangle, Scene

RIG = Rig(bending=1.0)
HALF_SPAN_MM = 0.1


@pytest.fixture(autouse=True, scope="module")
def scans_are_registered_once() -> Iterator[None]:
    """Whatever is fitted to a scan, its shifts are the same."""
    with pytest.MonkeyPatch.context() as patch:
        module = import_module("lensshift.registration.calibrate")  # its package has it as function
        patch.setattr(module, "_registered", cache(module._registered))
        yield


@pytest.fixture(scope="module")
def scan() -> Burst:
    return RIG.scan()


@pytest.fixture(scope="module")
def fit(scan: Burst) -> ScanFit:
    return fit_scan(scan, rest_mm=np.array([3.0, 5.0]))


def by_hand(rig: Rig, seed: int, *, noise_px: float = 0.004, outlier_px: float = 0.0) -> Burst:
    """Return a scan whose offsets are registered already, with normal errors."""
    rng = np.random.default_rng(seed)
    burst = replace(rig, shape=(4, 5)).scan(seed=seed)
    asked = burst.stage_commanded_mm
    assert asked is not None
    assert burst.time_s is not None
    load = [asked[0] - 0.5 * rig.play_mm]
    for place in asked[1:]:
        load.append(np.clip(load[-1], place - 0.5 * rig.play_mm, place + 0.5 * rig.play_mm))
    offset = (np.array(load) - (3.0, 5.0)) @ rig.px_per_mm.T
    offset += rig.drift_px_per_s * burst.time_s[:, None]
    offset += noise_px * rng.standard_normal(offset.shape)
    offset[7] += outlier_px
    return replace(burst, offset_px=offset)


def test_map_play_and_drift_are_found(fit: ScanFit) -> None:
    found = fit.calibration
    np.testing.assert_allclose(found.stage_map.px_per_mm, RIG.px_per_mm, atol=0.06)
    np.testing.assert_allclose(found.play_mm, RIG.play_mm, atol=0.0015)
    np.testing.assert_allclose(found.drift_px_per_s, RIG.drift_px_per_s, atol=2e-4)
    assert found.stage_map.sigma_px < 0.02
    assert found.source == "measured"


def test_the_map_over_the_sensor_is_found_to_a_two_hundredth_of_a_pixel(fit: ScanFit) -> None:
    per_mm = fit.calibration.stage_map.field_px_per_mm
    assert per_mm is not None
    assert fit.field_order == 2
    true = RIG.field_px_per_mm()
    # A quarter of a pixel is a move of about 45 um.
    wrong_px = (per_mm - true) * (0.25 / 5.5)
    assert np.sqrt(np.mean(wrong_px**2, axis=(0, 1))).max() < 0.005
    uniform_px = (true.mean(axis=(0, 1)) - true) * (0.25 / 5.5)
    assert np.sqrt(np.mean(wrong_px**2)) < 0.6 * np.sqrt(np.mean(uniform_px**2))


def test_standard_errors_are_as_large_as_errors() -> None:
    rig = Rig()
    wrong = []
    for seed in range(40):
        found = fit_scan(by_hand(rig, seed), registered=True, over_sensor=False).calibration
        assert found.px_per_mm_sigma is not None
        parts = [
            (found.stage_map.px_per_mm - rig.px_per_mm) / found.px_per_mm_sigma,
            (found.play_mm - rig.play_mm)[None] / found.play_sigma_mm,
            (found.drift_px_per_s - rig.drift_px_per_s)[None] / found.drift_sigma_px_per_s,
        ]
        wrong.append(np.concatenate(parts))
    ratio = np.sqrt(np.mean(np.square(wrong), axis=0))
    assert np.all((ratio > 0.7) & (ratio < 1.4)), ratio


@pytest.mark.parametrize(
    "told",
    [
        pytest.param([[6.17, 0.54], [0.54, -6.17]], marks=pytest.mark.slow),
        [[-5.6, 0.0], [0.0, 5.4]],  # the wrong way round
    ],
)
def test_the_map_that_planned_the_scan_may_be_wrong(told: list[list[float]]) -> None:
    rig = Rig()
    burst = rig.scan()
    assert burst.stage_commanded_mm is not None
    planned = (burst.stage_commanded_mm - (3.0, 5.0)) @ np.array(told).T
    found = fit_scan(replace(burst, offset_px=planned), over_sensor=False).calibration
    np.testing.assert_allclose(found.stage_map.px_per_mm, rig.px_per_mm, atol=0.06)


def test_offsets_are_known_no_better_than_the_map() -> None:
    """A scene that hardly tells one direction leaves a map whose offsets were called exact."""
    sigma = np.array([[3.0, 4.0], [0.0, 0.0]])
    stage_map = StageMap(5.6 * np.eye(2), sigma_px=0.01)
    found = Calibration(stage_map, np.array([3.0, 5.0]), "measured", px_per_mm_sigma=sigma)
    places = [[3.0, 5.0], [3.1, 5.0], [3.1, 4.9]]
    told = found.offset_sigma_px(places)
    np.testing.assert_allclose(told[0], 0.01)
    np.testing.assert_allclose(told[1:, 0], [np.hypot(0.3, 0.01), np.hypot(0.5, 0.01)])
    np.testing.assert_allclose(told[:, 1], 0.01)
    burst = Burst.from_arrays(np.ones((3, 4, 4)), pitch_mm=0.1, stage_mm=places)
    assert np.array_equal(found.applied_to(burst)[0].offset_sigma_px, told)


def test_one_spoiled_frame_is_left_out() -> None:
    burst = by_hand(Rig(), 0, outlier_px=1.0)
    with pytest.warns(QualityWarning, match="px rms unexplained"):
        found = fit_scan(burst, registered=True, over_sensor=False).calibration
    np.testing.assert_allclose(found.stage_map.px_per_mm, Rig().px_per_mm, atol=0.15)


def test_a_first_frame_of_another_scene_does_not_spoil_the_scan() -> None:
    """The first one is what the others are held against: a shutter that was still closed."""
    rig = Rig()
    scan = rig.scan(seed=8)
    frames = np.array(scan.amplitude)
    frames[0] = 0.01 * np.random.default_rng(8).random(frames[0].shape)
    with pytest.warns(QualityWarning, match="^frame 0: shows nothing of the scene of most others"):
        found = fit_scan(replace(scan, amplitude=frames), rest_mm=(3.0, 5.0)).calibration
    error = found.stage_map.px_per_mm - rig.px_per_mm
    assert np.abs(error).max() < 0.05
    np.testing.assert_allclose(found.play_mm, rig.play_mm, atol=0.001)


@pytest.mark.parametrize("defect", ["hot", "dead"])
def test_pixels_that_do_not_follow_the_scene_do_not_hold_the_map(defect: str) -> None:
    rig = Rig()
    scan = rig.scan(seed=4)
    frames = np.array(scan.amplitude)
    frames[:, 6, 20] = frames[:, 10, 45] = 0.0 if defect == "dead" else 3.0 * frames.max()
    found = fit_scan(replace(scan, amplitude=frames), rest_mm=(3.0, 5.0)).calibration
    np.testing.assert_allclose(found.stage_map.px_per_mm, rig.px_per_mm, atol=0.06)
    np.testing.assert_allclose(found.play_mm, rig.play_mm, atol=0.0015)


@pytest.mark.parametrize("drift", [0.0, 1.0])
def test_a_jump_is_told_from_a_drift(drift: float) -> None:
    """A stage that loses steps once, at whatever frame; a drift of the same size is none."""
    rig = replace(Rig(), drift_px_per_s=drift * np.array([2e-3, -1e-3]))
    for seed in range(12):
        burst = by_hand(rig, seed)
        moved = np.array(burst.offset_px)
        at = 7 + seed % 7
        moved[at:] += (0.05, -0.05)
        for offset, jumped in ((burst.offset_px, False), (moved, True)):
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                fit_scan(replace(burst, offset_px=offset), registered=True, over_sensor=False)
            told = [str(one.message) for one in said if "the image jumped" in str(one.message)]
            assert bool(told) == jumped, (seed, told)


def test_noise_is_not_taken_for_a_stage_that_does_not_repeat() -> None:
    """Of a scan whose frames tell little: what is left is what they do not tell."""
    rig = replace(Rig(), noise=0.25)
    with pytest.warns(QualityWarning) as said:
        fit_scan(rig.scan(seed=2), over_sensor=False)
    words = [str(one.message) for one in said]
    assert any("texture" in one for one in words), words
    assert not any("does the stage repeat" in one for one in words), words


@given(st.integers(3, 8), st.floats(0.01, 2.0), st.floats(0.01, 2.0))
def test_a_scan_comes_from_both_sides_and_to_no_row_or_column_twice(
    steps: int, row: float, col: float
) -> None:
    scan = calibration_scan_mm((1.0, -2.0), (row, col), steps=steps)
    assert len(scan) == 2 * steps**2 + 3
    np.testing.assert_allclose(scan[[0, len(scan) // 2, -1]], [[1.0, -2.0]] * 3)
    np.testing.assert_allclose(np.ptp(scan, axis=0), (row, col))
    middle = len(scan) // 2
    there, back = scan[1:middle], scan[middle + 1 : -1]
    share = 1.0 / (2 * steps**2 - 1)
    for axis, span in enumerate((row, col)):
        places = np.sort(np.concatenate([there, back])[:, axis])
        np.testing.assert_allclose(np.diff(places), share * span)
        np.testing.assert_allclose(back[::-1, axis] - there[:, axis], share * span)
        # The way back turns every motion round.
        steps_there, steps_back = np.diff(there[:, axis]), np.diff(back[::-1, axis])
        np.testing.assert_allclose(steps_there, steps_back, atol=1e-9)
        assert np.abs(steps_there).min() > 1.9 * share * span


def test_mistakes_are_named() -> None:
    burst = by_hand(Rig(), 0)
    with pytest.raises(ValueError, match="stage_mm"):
        fit_scan(replace(burst, stage_mm=None))
    with pytest.raises(ValueError, match="9 frames"):
        fit_scan(burst.select(range(4)))
    line = np.outer(np.arange(burst.frame_count), (1.0, 0.5))
    with pytest.raises(ValueError, match="both axes"):
        fit_scan(replace(burst, stage_mm=line))
    for bad in ({"span_mm": 0.0}, {"span_mm": 1.0, "steps": 2}):
        with pytest.raises(ValueError, match="expected"):
            calibration_scan_mm((0, 0), **bad)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="centre_mm"):
        calibration_scan_mm((0, np.nan), 1.0)


def test_calibration_file_there_and_back(tmp_path: Path) -> None:
    field = np.random.default_rng(0).random((3, 5, 2, 2))
    said = Calibration(
        StageMap(np.array([[5.5, 0.1], [0.0, -5.0]]), field, 0.01),
        np.array([3.0, 5.0]),
        source="measured",
        px_per_mm_sigma=np.full((2, 2), 0.02),
        play_mm=np.array([0.01, 0.0]),
        psf_sigma_px=0.31,
        notes={"frames": 21},
    )
    save_calibration(said, tmp_path / "c.json")
    read = load_calibration(tmp_path / "c.json")
    np.testing.assert_array_equal(read.stage_map.px_per_mm, said.stage_map.px_per_mm)
    np.testing.assert_array_equal(read.stage_map.field_px_per_mm, field)
    np.testing.assert_array_equal(read.play_mm, said.play_mm)
    assert (read.source, read.psf_sigma_px, read.psf_sigma_sigma_px) == ("measured", 0.31, None)
    assert read.notes == {"frames": 21}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("schema", "other/1", "schema"),
        ("px_per_mm", [[1.0, 2.0]], "px_per_mm"),
        ("px_per_mm", [[1.0, 0.0], [1.0, 0.0]], "parallel"),
        ("rest_mm", "here", r"rest_mm: expected \[float, \.\.\.\], got 'here'"),
        ("rest_mm", ["3", "3"], r"rest_mm\[0\]: expected float, got '3'"),
        ("sigma_px", True, "sigma_px: expected float, got True"),
        ("psf_sigma_px", [0.3], "psf_sigma_px: expected float"),
        ("play_mm", None, "play_mm"),
        ("source", "guess", "source"),
        ("notes", 3, "notes"),
    ],
)
def test_wrong_fields_are_named(tmp_path: Path, name: str, value: object, said: str) -> None:
    path = tmp_path / "c.json"
    save_calibration(Calibration(StageMap(np.eye(2)), np.zeros(2)), path)
    content = json.loads(path.read_text())
    content[name] = value
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match=said) as caught:
        load_calibration(path)
    assert str(path) in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text("{")
    with pytest.raises(DataError, match="not JSON"):
        load_calibration(tmp_path / "c.json")
    with pytest.raises(DataError, match="cannot be read"):
        load_calibration(tmp_path / "missing.json")


def lens_of(rig: Rig) -> LensField:
    """Return the lens field that a designer would tell of a rig."""
    even = np.zeros((1, 1, 2, 2, 2))
    even[0, 0, 1, 0, 0] = even[0, 0, 0, 1, 1] = 2.0  # the stage may be mounted any way round
    still = LensField(
        Grid(rig.shape, (0.155, 0.155)), even, np.zeros((1, 1, 1, 1, 2)), (0.4, 0.4), lens="known"
    )
    share = (rig.field_px_per_mm() - rig.px_per_mm) @ np.linalg.inv(rig.px_per_mm)
    rows, cols = (slice((n - 1) // 2, n // 2 + 1) for n in rig.shape)
    return still.corrected(share - share[rows, cols].mean(axis=(0, 1)))


def rms_px(field: LensField, rig: Rig) -> float:
    """Return how wrong a field is over the sensor, for shifts of a quarter of a pixel."""
    away_mm = np.array([[0.0, 0.045], [0.045, 0.0], [0.03, -0.03]])
    true_px = np.moveaxis(rig.field_px_per_mm() @ away_mm.T, -1, 0)
    rows, cols = (slice((n - 1) // 2, n // 2 + 1) for n in rig.shape)
    middle_px = true_px[:, rows, cols].mean(axis=(1, 2))
    return float(np.sqrt(np.mean((field.at(field.states(middle_px)).offset_px - true_px) ** 2)))


def test_a_lens_field_is_made_right_by_a_scan(scan: Burst) -> None:
    designed = lens_of(Rig(bending=0.4))
    assert rms_px(designed, Rig(bending=0.4)) < 2e-4
    found = fit_scan(scan, rest_mm=np.array([3.0, 5.0]), lens_field=designed)
    assert found.lens_field is not None
    assert found.calibration.stage_map.field_px_per_mm is None  # one of them says it
    assert found.calibration.notes["optics"] == designed.optics
    assert rms_px(found.lens_field, RIG) < 0.4 * rms_px(designed, RIG)
    middle = RIG.field_px_per_mm()[7:9, 31:33].mean(axis=(0, 1))
    np.testing.assert_allclose(found.calibration.stage_map.px_per_mm, middle, atol=0.06)


def test_a_scan_leaves_a_lens_field_as_it_is_that_is_right(scan: Burst) -> None:
    designed = lens_of(RIG)
    found = fit_scan(scan, rest_mm=np.array([3.0, 5.0]), lens_field=designed)
    assert found.lens_field is not None
    assert rms_px(found.lens_field, RIG) < 0.002
    other = replace(designed, grid=Grid((16, 32), (0.155, 0.155)))
    with pytest.raises(DataError, match="make it with --sensor 64x16"):
        fit_scan(scan, lens_field=other)
    near = replace(designed, shift_px=0.2 * designed.shift_px)
    with pytest.raises(DataError, match="make it with --reach-px"):
        fit_scan(found.burst, registered=True, lens_field=near)


@pytest.mark.slow
def test_a_bright_card_across_the_sensor_does_not_make_the_map_its_own() -> None:
    """Shifts too small by two thirds fit it as well, where frames are tapered as they move."""
    wall = Plane(centre_m=(0.0, 0.0, 5.0), reflectance=0.3)
    tall = Rectangle(
        centre_m=(0.04, 0.0, 3.0), size_m=(0.3, 0.3), turn_rad=(0.0, 0.0, 0.02), reflectance=0.9
    )
    small = Rectangle(
        centre_m=(-0.25, 0.01, 3.0), size_m=(0.12, 0.09), turn_rad=(0.0, 0.0, 0.4), reflectance=0.6
    )
    settings = RigSettings(scene=Scene((wall, tall, small)), px_per_mm=5.6 * np.eye(2))
    world = EmulatedWorld(settings, None)
    asked = calibration_scan_mm(settings.rest_mm, 0.3, steps=3)
    offset_px = [world.offset_px(place)[None] for place in asked]
    frames = [world.running.frame(one, world._rng).amplitude for one in offset_px]
    planned_px = 5.6 * (asked - settings.rest_mm)
    burst = Burst.from_arrays(
        np.stack(frames), offset_px=planned_px, pitch_mm=0.155, stage_mm=asked
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)  # rows tell little, which may be said
        found = fit_scan(burst).calibration
    wrong = found.stage_map.px_per_mm - settings.px_per_mm
    assert found.px_per_mm_sigma is not None
    assert np.all(np.abs(wrong) < 0.1)
    assert np.all(np.abs(wrong) < 3 * found.px_per_mm_sigma)


@pytest.mark.parametrize("play_mm", [(0.031, 0.052), (0.007, 0.044)])
@pytest.mark.parametrize("seed", [5, 6])
def test_play_larger_than_the_steps_of_the_scan(play_mm: tuple[float, float], seed: int) -> None:
    """An axis that turns by less than its play goes through a part of it (friction)."""
    rng = np.random.default_rng(seed)
    rig = Rig(play_mm=np.array(play_mm))
    asked = calibration_scan_mm((3.0, 5.0), 0.3, steps=4)
    load = [asked[0] - 0.5 * rig.play_mm]
    for place in asked[1:]:
        load.append(np.clip(load[-1], place - 0.5 * rig.play_mm, place + 0.5 * rig.play_mm))
    offset_px = (np.array(load) - (3.0, 5.0)) @ rig.px_per_mm.T
    burst = Burst.from_arrays(
        rng.random((len(asked), 8, 8)),
        offset_px=offset_px + 0.003 * rng.standard_normal(offset_px.shape),
        pitch_mm=0.1,
        stage_mm=asked,
        stage_commanded_mm=asked,
    )
    found = fit_scan(burst, registered=True, over_sensor=False).calibration
    np.testing.assert_allclose(found.play_mm, play_mm, atol=0.001)
    np.testing.assert_allclose(found.stage_map.px_per_mm, rig.px_per_mm, atol=0.03)
    assert found.stage_map.sigma_px < 0.005
