"""Shift maps come back exactly, and anything else is named."""

from pathlib import Path

import numpy as np
import pytest

from lensshift.core.errors import DataError
from lensshift.core.motion import ShiftField, StageMap
from lensshift.core.types import Burst
from lensshift.io import load_shift_field, load_stage_map, save_shift_map

FIELD = ShiftField(np.random.default_rng(0).normal(size=(4, 3, 5, 2)))


def test_comes_back_exactly(tmp_path: Path) -> None:
    stage = StageMap(np.diag([5.5, 5.6]), np.full((3, 5, 2, 2), 0.5), 0.01)
    save_shift_map(tmp_path / "map.npz", FIELD, stage_map=stage, stage_mm=np.eye(4, 2))
    assert np.array_equal(load_shift_field(tmp_path / "map.npz").offset_px, FIELD.offset_px)
    found = load_stage_map(tmp_path / "map.npz")
    assert np.array_equal(found.px_per_mm, stage.px_per_mm)
    assert found.field_px_per_mm is not None
    assert found.field_px_per_mm.shape == (3, 5, 2, 2)
    assert found.sigma_px == 0.01
    with np.load(tmp_path / "map.npz") as archive:
        assert np.array_equal(archive["stage_mm"], np.eye(4, 2))


def test_a_map_of_other_pixels_is_refused_by_name(tmp_path: Path) -> None:
    offset_px = np.array([[-0.25, -0.25], [-0.25, 0.25], [0.25, 0.25], [0.25, -0.25]])
    field = ShiftField(np.tile(offset_px[:, None, None], (1, 3, 5, 1)), (0.1, 0.1))
    save_shift_map(tmp_path / "map.npz", field)
    frames = np.ones((4, 3, 5))
    own = Burst.from_arrays(frames, offset_px=offset_px + 3.0, pitch_mm=0.1)
    assert load_shift_field(tmp_path / "map.npz", own).pitch_mm == (0.1, 0.1)
    for other, message in (
        (Burst.from_arrays(frames, offset_px=offset_px, pitch_mm=0.155), "pitch_mm: expected"),
        (own.select([0, 1, 3, 2]), r"offset_px: expected .* 0\.50 px more in 2 of 4 frames"),
        (own.select([0, 1, 2]), r"offset_px: expected a shift field of \(3, 3, 5, 2\)"),
    ):
        with pytest.raises(DataError, match=r"map\.npz: " + message):
            load_shift_field(tmp_path / "map.npz", other)


def test_a_bare_field_has_no_stage_map(tmp_path: Path) -> None:
    save_shift_map(tmp_path / "map.npz", FIELD)
    with pytest.raises(DataError, match="px_per_mm: expected this array, got offset_px, schema"):
        load_stage_map(tmp_path / "map.npz")


def test_anything_else_is_a_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"missing\.npz"):
        load_shift_field(tmp_path / "missing.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(DataError, match=r"text\.npz"):
        load_shift_field(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", shift=np.zeros(3))
    with pytest.raises(DataError, match="offset_px: expected this array, got shift"):
        load_shift_field(tmp_path / "other.npz")
    np.savez(tmp_path / "flat.npz", offset_px=np.zeros(3))
    with pytest.raises(DataError, match=r"expected offset_px \[frame row col 2\]"):
        load_shift_field(tmp_path / "flat.npz")
    with pytest.raises(DataError, match="cannot write"):
        save_shift_map(tmp_path / "missing" / "field.npz", FIELD)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flat.npz", "other.npz", "text.npz"]
