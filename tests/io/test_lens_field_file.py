"""Lens fields come back exactly, and anything else is named."""

from pathlib import Path

import numpy as np
import pytest

from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.lens_field import LensField
from lensshift.core.types import Burst
from lensshift.io import load_lens_field, save_burst, save_lens_field


def made_up(seed: int = 0) -> LensField:
    rng = np.random.default_rng(seed)
    return LensField(
        Grid((5, 9), (0.1, 0.2)), rng.normal(size=(4, 5, 2, 3, 2)), rng.random((3, 3, 2, 2, 2)),
        (0.1, 0.3), "tilt", 2, "a lens", 1e-8, 2e-4, 0.01, {"wavelength_nm": 850.0},
        rng.normal(size=(2, 3, 1, 2, 2)),
    )  # fmt: skip


def test_comes_back_exactly(tmp_path: Path) -> None:
    field = made_up()
    save_lens_field(field, tmp_path / "field.nc")
    found = load_lens_field(tmp_path / "field.nc")
    for name in LensField.__dataclass_fields__:
        np.testing.assert_equal(getattr(found, name), getattr(field, name))
    leaning = np.concatenate([field.spot_px2, 0.1 * field.spot_px2[..., :1]], axis=-1)
    sensor = LensField(field.grid, field.shift_px, leaning, (1.0, 1.0), "sensor", None)
    save_lens_field(sensor, tmp_path / "sensor.nc")
    loaded = load_lens_field(tmp_path / "sensor.nc")
    assert loaded.element is None
    np.testing.assert_array_equal(loaded.spot_px2, leaning)
    assert loaded.skew_px3 is None  # as in files of before


def test_anything_else_is_a_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"missing\.nc"):
        load_lens_field(tmp_path / "missing.nc")
    (tmp_path / "text.nc").write_text("no netCDF")
    with pytest.raises(DataError, match=r"text\.nc: not a netCDF"):
        load_lens_field(tmp_path / "text.nc")
    burst = Burst.from_arrays(np.ones((2, 3, 4)), offset_px=np.zeros((2, 2)))
    save_burst(burst, tmp_path / "burst.nc")
    with pytest.raises(DataError, match=r"burst\.nc: schema: expected a file of"):
        load_lens_field(tmp_path / "burst.nc")
    with pytest.raises(DataError, match="cannot write"):
        save_lens_field(made_up(), tmp_path / "missing" / "field.nc")


def test_damage_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "field.nc"
    save_lens_field(made_up(), path)
    whole, refused = path.read_bytes(), 0
    for at in range(7, len(whole), 211):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        try:
            found = load_lens_field(path)
        except DataError as error:
            assert "field.nc" in str(error)  # noqa: PT017
            refused += 1
        else:
            np.testing.assert_array_equal(found.shift_px, made_up().shift_px)
            np.testing.assert_array_equal(found.spot_px2, made_up().spot_px2)
    assert refused > 3
