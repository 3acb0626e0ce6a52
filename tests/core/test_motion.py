"""Shifts over the sensor, planned shifts and the map of the stage: what they accept and refuse."""

from typing import Any

import numpy as np
import pytest

from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.motion import ShiftField, ShiftPlan, StageMap

OFFSET_PX = np.array([[0.0, 0.0], [0.5, -0.25], [0.1, 0.2], [-0.4, 0.3], [0.2, -0.1]])
FIELD_PX = np.zeros((3, 5, 7, 2))


def stretched_px(shape: tuple[int, int], about_px: float = 0.0) -> np.ndarray:
    """Return offsets of pictures, each larger than the last, about the middle of the sensor."""
    row, col = (np.arange(size) - (size - 1) / 2 - about_px for size in shape)
    from_middle_px = np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1)
    size = np.linspace(-0.5, 0.5, len(OFFSET_PX))[:, None, None, None]
    return np.asarray(OFFSET_PX[:, None, None] + size * from_middle_px)


@pytest.mark.parametrize("shape", [(6, 9), (5, 8), (1, 1), (1, 4)])
def test_a_field_has_the_offsets_of_the_burst_in_the_middle_of_the_sensor(
    shape: tuple[int, int],
) -> None:
    grid = Grid(shape, (0.15, 0.1))
    common = stretched_px(shape) + np.array([3.0, -20.0])  # which only moves the picture
    for pitch_mm in (None, (0.15, 0.1), (0.15, 0.10001)):
        ShiftField(common, pitch_mm).check_belongs(OFFSET_PX, grid)
    with pytest.raises(DataError, match=r"0\.25 px more in 4 of 5 frames, frame 0 first"):
        ShiftField(stretched_px(shape, 0.5)).check_belongs(OFFSET_PX, grid)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_field_of_another_burst(axis: int) -> None:
    grid, offset_px = Grid((6, 9), (0.15, 0.1)), OFFSET_PX.copy()
    field = ShiftField(stretched_px((6, 9)), (0.15, 0.1))
    offset_px[3, axis] -= 0.06  # as stages repeat
    field.check_belongs(offset_px, grid)
    offset_px[3, axis] -= 0.06
    with pytest.raises(DataError, match=r"0\.12 px more in 1 of 5 frames, frame 3 first") as caught:
        field.check_belongs(offset_px, grid)
    assert caught.value.field == "offset_px"
    with pytest.raises(DataError, match="offset_px: expected a shift field of"):
        field.check_belongs(OFFSET_PX[:4], grid)
    wider_mm = tuple(np.array(grid.pitch_mm) * (1.01, 1.0)[:: 1 - 2 * axis])
    with pytest.raises(DataError, match="pitch_mm: expected a shift field for pixels of"):
        field.check_belongs(OFFSET_PX, Grid((6, 9), wider_mm))


@pytest.mark.parametrize(
    ("values", "spot_px2", "said"),
    [
        (FIELD_PX[0], None, "frame row col 2"),
        (FIELD_PX[..., :1], None, "frame row col 2"),
        (FIELD_PX + np.array([np.nan, 0.0]), None, "finite offsets"),
        (FIELD_PX, FIELD_PX[:2], "finite spot_px2"),
        (FIELD_PX, FIELD_PX + np.array([0.0, np.inf]), "finite spot_px2"),
    ],
)
def test_a_field_is_a_number_for_each_axis_of_each_pixel(
    values: np.ndarray, spot_px2: Any, said: str
) -> None:
    assert ShiftField(FIELD_PX, spot_px2=FIELD_PX).spot_px2 is not None
    with pytest.raises(ValueError, match=said):
        ShiftField(values, spot_px2=spot_px2)


def test_some_frames_of_a_field_keep_their_spots_and_pitch() -> None:
    values = np.random.default_rng(1).random((2, *FIELD_PX.shape))
    some = ShiftField(values[0], (0.15, 0.1), values[1]).select([2, 0])
    np.testing.assert_array_equal([some.offset_px, some.spot_px2], values[:, [2, 0]])
    assert some.pitch_mm == (0.15, 0.1)
    assert ShiftField(values[0]).select([1]).spot_px2 is None


@pytest.mark.parametrize("reference", [None, 0, 4])
def test_a_plan_is_compared_with_one_of_its_frames(reference: int | None) -> None:
    assert ShiftPlan(OFFSET_PX, reference).reference == reference
    for other in (-1, 5):
        with pytest.raises(ValueError, match="reference from 0 to 4"):
            ShiftPlan(OFFSET_PX, other)
    for target_px in (OFFSET_PX[0], OFFSET_PX[:, :1], OFFSET_PX * np.nan):
        with pytest.raises(ValueError, match="finite target_px"):
            ShiftPlan(target_px, reference)


def test_a_stage_map_has_two_axes_in_every_pixel() -> None:
    over_the_sensor = np.tile(np.eye(2), (5, 7, 1, 1))
    kept = StageMap(np.eye(2), over_the_sensor)
    assert kept.sigma_px == 0.0
    assert kept.field_px_per_mm is not None
    assert not kept.field_px_per_mm.flags.writeable
    for px_per_mm in (np.zeros((2, 3)), np.full((2, 2), np.nan)):
        with pytest.raises(ValueError, match="2 x 2 finite numbers"):
            StageMap(px_per_mm)
    with pytest.raises(ValueError, match="field_px_per_mm"):
        StageMap(np.eye(2), over_the_sensor[..., 0])
