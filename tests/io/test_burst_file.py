"""Bursts survive the way through a file exactly, and other programs read the file."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lensshift.core.errors import DataError
from lensshift.core.types import FRAME_FIELDS, OFFSET_SOURCES, Burst
from lensshift.io import load_burst, save_burst

ARRAYS = ("amplitude", "offset_px", *FRAME_FIELDS)
DTYPES = ("u1", "u2", "i2", "f4", "f8", "c8", "c16", ">u2", ">f4")


def make_burst(seed: int = 0, shape: tuple[int, int, int] = (3, 5, 7), **fields: Any) -> Burst:
    rng = np.random.default_rng(seed)
    valid = rng.random(shape) > 0.2
    valid[0, 0, 0] = True
    complete: dict[str, Any] = {
        "amplitude": rng.integers(0, 4000, shape).astype("u2"),
        "distance_m": rng.normal(3.5, 0.01, shape).astype("f4"),
        "offset_px": rng.normal(size=(shape[0], 2)),
        "pitch_mm": (0.15, 0.1),
        "modulation_hz": 20e6,
        "valid": valid,
        "offset_sigma_px": rng.random((shape[0], 2)),
        "offset_source": "registered",
        "stage_mm": rng.normal(size=(shape[0], 2)),
        "stage_commanded_mm": rng.normal(size=(shape[0], 2)),
        "time_s": np.arange(shape[0]) * 0.4,
        "meta": {"camera": "Prüfstand 3", "gain": 1.5, "list": [1, 2], "none": None},
    }
    return Burst.from_arrays(**(complete | fields))


def assert_same(one: Burst, two: Burst) -> None:
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(two, name)
        assert (a is None) == (b is None), name
        if a is not None:
            assert a.dtype == b.dtype.newbyteorder("="), name
            np.testing.assert_array_equal(a, b, err_msg=name)
    assert one.grid == two.grid
    assert one.offset_source == two.offset_source
    assert one.modulation_hz == two.modulation_hz
    assert dict(one.meta) == dict(two.meta)


@st.composite
def bursts(draw: st.DrawFn) -> Burst:
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 9), st.integers(1, 9)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    dtype = np.dtype(draw(st.sampled_from(DTYPES)))
    numbers = rng.integers(1, 200, shape) if dtype.kind in "ui" else rng.normal(size=shape) * 1e-3
    amplitude = numbers.astype(dtype)
    valid = rng.random(shape) > 0.3
    valid.flat[0] = True
    if dtype.kind in "fc":
        amplitude[~valid] = np.nan
    optional: dict[str, Any] = {
        "distance_m": rng.random(shape).astype(draw(st.sampled_from(("f4", "f8", "u2")))),
        "valid": valid,
        "offset_sigma_px": rng.random((shape[0], 2)),
        "stage_mm": rng.normal(size=(shape[0], 2)),
        "stage_commanded_mm": rng.normal(size=(shape[0], 2)),
        "time_s": rng.random(shape[0]),
        "modulation_hz": float(rng.random() * 1e6 + 1e5),
    }
    chosen = draw(st.sets(st.sampled_from(sorted(optional))))
    if dtype.kind in "fc":
        chosen = chosen | {"valid"}
    scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
    return Burst.from_arrays(
        amplitude,
        offset_px=rng.normal(size=(shape[0], 2)),
        pitch_mm=(float(rng.random() + 0.01), float(rng.random() + 0.01)),
        offset_source=draw(st.sampled_from(OFFSET_SOURCES)),
        meta=draw(st.dictionaries(st.text(max_size=8), scalars, max_size=3)),
        **{name: optional[name] for name in chosen},
    )


@pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")  # whole metres, low frequencies
@given(burst=bursts())
@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_every_field_comes_back_exactly(burst: Burst, tmp_path: Path) -> None:
    save_burst(burst, tmp_path / "burst.nc")
    assert_same(load_burst(tmp_path / "burst.nc"), burst)


@pytest.mark.parametrize("group", [None, "entry/data"])
@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_reads_names_units_and_numbers(
    tmp_path: Path, engine: str, group: str | None
) -> None:
    burst = make_burst()
    save_burst(burst, tmp_path / "burst.nc")
    with xarray.open_dataset(tmp_path / "burst.nc", engine=engine, group=group) as data:
        assert data.amplitude.dims == ("frame", "row", "col")
        assert data.sizes == {"frame": 3, "row": 5, "col": 7}
        np.testing.assert_array_equal(data.amplitude, burst.amplitude)
        np.testing.assert_array_equal(data.distance, burst.distance_m)
        np.testing.assert_array_equal((data["flags"] & 1) == 0, burst.valid)
        np.testing.assert_array_equal(data.offset_col, burst.offset_px[:, 1])
        units = {name: data[name].attrs["units"] for name in ("distance", "offset_row", "time")}
        assert units == {"distance": "m", "offset_row": "pixel", "time": "s"}
        assert data["stage_row"].attrs["units"] == "mm"
        assert data["distance"].attrs["comment"] == "radial, camera frame"
        np.testing.assert_array_equal(data.row, np.arange(5))
        assert data.attrs["schema"] == "lensshift-burst/1"
        assert data.attrs["Conventions"] == "CF-1.11"
        np.testing.assert_array_equal(data.attrs["pitch_mm"], burst.grid.pitch_mm)
        assert data["flags"].attrs["flag_meanings"] == "invalid"


def test_xarray_opens_it_as_a_tree(tmp_path: Path) -> None:
    save_burst(make_burst(), tmp_path / "burst.nc")
    with xarray.open_datatree(tmp_path / "burst.nc", engine="h5netcdf") as tree:
        assert "amplitude" in tree.data_vars
        assert "amplitude" in tree["entry/data"].data_vars


def test_a_file_without_anything_at_its_root_still_loads(tmp_path: Path) -> None:
    save_burst(make_burst(), tmp_path / "burst.nc")
    with h5py.File(tmp_path / "burst.nc", "r+") as file:
        for name in set(file) - {"entry"}:
            del file[name]
    assert_same(load_burst(tmp_path / "burst.nc"), make_burst())


def test_netcdf_library_reads_complex_frames(tmp_path: Path) -> None:
    import netCDF4

    phasors = np.exp(1j * np.linspace(0, 3, 105)).reshape(3, 5, 7).astype("c8")
    save_burst(make_burst(amplitude=phasors), tmp_path / "burst.nc")
    with netCDF4.Dataset(tmp_path / "burst.nc", auto_complex=True) as file:
        np.testing.assert_array_equal(file["entry/data/amplitude"][:], phasors)


def test_nexus_finds_the_default_plot(tmp_path: Path) -> None:
    from nexusformat.nexus import nxload

    burst = make_burst()
    save_burst(burst, tmp_path / "burst.nc")
    plot = nxload(str(tmp_path / "burst.nc")).plottable_data
    assert plot.nxsignal.nxname == "amplitude"
    np.testing.assert_array_equal(plot.nxsignal.nxvalue, burst.amplitude)
    assert [axis.nxname for axis in plot.nxaxes] == ["frame", "row", "col"]


def test_plain_hdf5_shows_how_it_is_stored(tmp_path: Path) -> None:
    save_burst(make_burst(shape=(40, 120, 161)), tmp_path / "burst.nc")
    with h5py.File(tmp_path / "burst.nc") as file:
        amplitude = file["entry/data/amplitude"]
        assert (amplitude.compression, amplitude.compression_opts) == ("gzip", 1)
        assert amplitude.shuffle
        assert amplitude.fletcher32
        chunk_bytes = np.prod(amplitude.chunks) * amplitude.dtype.itemsize
        assert 0.5e6 < chunk_bytes <= 1e6
        assert amplitude.chunks[1:] == (120, 161)
        assert file.attrs["default"] == "entry"


def test_large_metadata_come_back(tmp_path: Path) -> None:
    burst = make_burst(meta={"log": "x" * 200_000, "array": np.arange(3), "path": Path("a")})
    save_burst(burst, tmp_path / "burst.nc")
    meta = load_burst(tmp_path / "burst.nc").meta
    assert meta == {"log": "x" * 200_000, "array": [0, 1, 2], "path": "a"}


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"meta": {"when": object()}}, "meta"),
        ({"raw": {"light": np.ones((3, 5, 7), np.float16)}}, "raw_light"),
        ({"raw": {"light": np.ones((3, 5, 7), np.longdouble)}}, "raw_light"),
    ],
)
def test_what_cannot_be_stored_is_refused(
    tmp_path: Path, fields: dict[str, Any], named: str
) -> None:
    with pytest.raises(DataError, match=rf"new\.nc: {named}: ") as caught:
        save_burst(make_burst(**fields), tmp_path / "new.nc")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["x.tif", "x.NPZ", "x.png", "x.fits"])
def test_a_name_of_another_format_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"\.nc, for a netCDF file"):
        save_burst(make_burst(), tmp_path / name)
    assert not list(tmp_path.iterdir())
