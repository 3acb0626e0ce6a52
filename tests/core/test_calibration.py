"""A calibration leads from the stage to the image and back, and tells a burst where it lies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.calibration import Calibration, turn_rad
from lensshift.core.motion import StageMap
from lensshift.core.types import Burst

SHAPE = (3, 5)
REST_MM = np.array([3.0, 2.0])
FIELD = np.broadcast_to(np.diag([5.0, -6.0]), (*SHAPE, 2, 2)) * np.linspace(
    0.9, 1.1, SHAPE[1]
).reshape(1, -1, 1, 1)


def turned(angle_rad: float, row: float = 5.0, col: float = 6.0) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]]) @ np.diag([row, col])


def burst(stage_mm: np.ndarray | None) -> Burst:
    frames = np.ones((2, *SHAPE))
    return Burst.from_arrays(frames, offset_px=np.zeros((2, 2)), pitch_mm=0.1, stage_mm=stage_mm)


@given(
    st.floats(-0.7, 0.7),
    st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), min_size=1, max_size=5),
)
def test_there_and_back(angle_rad: float, offset: list[tuple[float, float]]) -> None:
    calibration = Calibration(StageMap(turned(angle_rad)), REST_MM)
    stage_mm = calibration.stage_mm(offset)
    np.testing.assert_allclose(calibration.offset_px(stage_mm), offset, atol=1e-12)
    np.testing.assert_allclose(calibration.offset_px(REST_MM), 0.0, atol=1e-15)


@given(st.floats(-0.7, 0.7))
def test_rotation_and_cross_talk_of_equal_axes(angle_rad: float) -> None:
    calibration = Calibration(StageMap(turned(angle_rad, 5.0, 5.0)), REST_MM)
    assert calibration.rotation_rad == pytest.approx(angle_rad, abs=1e-12)
    np.testing.assert_allclose(
        calibration.cross_talk, [np.tan(angle_rad), -np.tan(angle_rad)], atol=1e-12
    )


@given(st.floats(-0.7, 0.7), st.sampled_from([(1, -1), (-1, 1)]))
def test_the_turn_of_a_map_that_mirrors_is_that_without_the_mirror(
    angle_rad: float, mirror: tuple[int, int]
) -> None:
    calibration = Calibration(StageMap(turned(angle_rad) * mirror), REST_MM)
    expected = Calibration(StageMap(turned(angle_rad)), REST_MM).rotation_rad
    assert calibration.rotation_rad == pytest.approx(expected, abs=1e-12)


def test_the_turn_is_that_of_the_nearest_rotation() -> None:
    """That of the polar decomposition, by singular values; no map turns by nothing."""
    for matrix in np.random.default_rng(7).standard_normal((50, 2, 2)):
        u, _, v = np.linalg.svd(matrix)
        if np.linalg.det(matrix) > 0:
            assert turn_rad(matrix) == pytest.approx(np.arctan2(*(u @ v)[::-1, 0]), abs=1e-9)
    assert turn_rad(np.zeros((2, 2))) == 0.0


@pytest.mark.parametrize(("turn", "mirror"), [(np.pi - 1e-3, 1), (np.pi / 2 - 1e-3, -1)])
def test_errors_of_rotation_and_cross_talk_are_those_of_many_maps(turn: float, mirror: int) -> None:
    """A turn by nearly half a circle, a quarter of one that mirrors, where its angle jumps."""
    rng = np.random.default_rng(4)
    per_mm = 5.0 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    per_mm[:, 1] *= mirror
    sigma = np.array([[0.02, 0.05], [0.01, 0.03]])
    told = Calibration(StageMap(per_mm), np.zeros(2), px_per_mm_sigma=sigma)
    many = [
        Calibration(StageMap(per_mm + sigma * rng.standard_normal((2, 2))), np.zeros(2))
        for _ in range(2000)
    ]
    turns = np.angle(np.exp(2j * (np.array([one.rotation_rad for one in many]) - turn))) / 2
    assert told.rotation_sigma_rad == pytest.approx(float(turns.std()), rel=0.06)
    if mirror > 0:  # along a map by a quarter turn goes nothing
        across = np.array([one.cross_talk for one in many])
        np.testing.assert_allclose(told.cross_talk_sigma, across.std(axis=0), rtol=0.06)
    assert Calibration(StageMap(per_mm), np.zeros(2)).rotation_sigma_rad is None


def test_a_burst_is_told_where_it_lies() -> None:
    stage_mm = np.add(REST_MM, [[0.1, 0.0], [0.0, 0.2]])
    calibration = Calibration(
        StageMap(np.diag([5.0, -6.0]), FIELD, sigma_px=0.01), REST_MM, source="measured"
    )
    told, field = calibration.applied_to(burst(stage_mm))
    np.testing.assert_allclose(told.offset_px, [[0.5, 0.0], [0.0, -1.2]])
    assert told.offset_source == "calibrated"
    np.testing.assert_array_equal(told.offset_sigma_px, 0.01)
    assert field is not None
    np.testing.assert_allclose(field.offset_px[0, 1, 0], [0.45, 0.0])
    np.testing.assert_allclose(field.offset_px[1, 2, 4], [0.0, -1.32])
    plain = Calibration(StageMap(np.diag([5.0, -6.0])), REST_MM)
    told, field = plain.applied_to(burst(stage_mm))
    assert field is None
    assert told.offset_source == "planned"


def test_a_burst_that_does_not_fit() -> None:
    calibration = Calibration(StageMap(np.diag([5.0, 5.0]), FIELD[:2]), REST_MM)
    with pytest.raises(ValueError, match="expected a burst with stage positions"):
        calibration.applied_to(burst(None))
    with pytest.raises(ValueError, match=r"expected a calibration of \(3, 5\) pixels"):
        calibration.applied_to(burst(np.zeros((2, 2))))
    with pytest.raises(ValueError, match="single map"):
        Calibration(StageMap(np.eye(2)), REST_MM).shift_field([[0.0, 0.0]])


@pytest.mark.parametrize(
    ("matrix", "rest", "message"),
    [
        (np.ones((2, 2)), REST_MM, "axes are not parallel"),
        (np.eye(2), np.array([1.0, np.nan]), "two finite numbers rest_mm"),
        (np.eye(2), np.ones(3), "two finite numbers rest_mm"),
    ],
)
def test_no_calibration(matrix: np.ndarray, rest: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Calibration(StageMap(matrix), rest)


def test_widths_and_errors_are_not_negative() -> None:
    for name in ("psf_sigma_px", "psf_sigma_sigma_px"):
        with pytest.raises(ValueError, match=f"{name} of at least 0, got -0.1"):
            Calibration(StageMap(np.eye(2)), REST_MM, **{name: -0.1})
    with pytest.raises(ValueError, match="sigma_px of at least 0, got nan"):
        StageMap(np.eye(2), sigma_px=np.nan)
