import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensshift.core.grid import hr_to_lr
from lensshift.forward.warp import field_positions, frame_positions


def test_content_that_moved_down_is_seen_further_up():
    row, col = frame_positions((5, 7), [[0.25, 0.0], [-0.25, 0.5]], 2)
    assert row.shape == (2, 5)
    assert col.shape == (2, 7)
    np.testing.assert_array_equal(row[:, 0], [0.0, 1.0])
    np.testing.assert_array_equal(col[:, 0], [0.5, -0.5])
    np.testing.assert_array_equal(np.diff(col, axis=1), 2.0)


@given(offset=st.tuples(*[st.floats(-5, 5)] * 2), scale=st.integers(1, 8))
@settings(deadline=None)
def test_positions_map_back_to_where_the_pixel_looks(offset, scale):
    row, col = frame_positions((6, 9), [offset], scale)
    np.testing.assert_allclose(hr_to_lr(row[0], scale), np.arange(6) - offset[0], atol=1e-6)
    np.testing.assert_allclose(hr_to_lr(col[0], scale), np.arange(9) - offset[1], atol=1e-6)
    # All pixels of a frame have the same phase to the last bit.
    assert np.unique(row - np.floor(row)).size == 1


def test_a_third_of_a_pixel_in_single_precision_lands_on_the_grid_of_x3():
    row, col = frame_positions((4, 4), np.array([[1 / 3, -1 / 3]], dtype=np.float32), 3)
    np.testing.assert_array_equal(row[0], [0, 3, 6, 9])
    np.testing.assert_array_equal(col[0], [2, 5, 8, 11])


def test_a_constant_field_is_a_constant_shift():
    offset = np.array([[0.3, -0.7], [1.1, 0.2]])
    field = np.broadcast_to(offset[:, None, None], (2, 4, 6, 2))
    row, col = field_positions(field, 3)
    expected_row, expected_col = frame_positions((4, 6), offset, 3)
    np.testing.assert_allclose(row, np.repeat(expected_row[:, :, None], 6, axis=2), atol=1e-6)
    np.testing.assert_allclose(col, np.repeat(expected_col[:, None, :], 4, axis=1), atol=1e-6)


def test_bad_shifts_are_refused():
    with pytest.raises(ValueError, match=r"expected offset_px \[frame 2\], got shape \(2,\)"):
        frame_positions((4, 4), [0.0, 0.0], 2)
    with pytest.raises(ValueError, match="finite offset_px"):
        frame_positions((4, 4), [[np.nan, 0.0]], 2)
