"""Arrays by name as other programs write them: nothing is lost without a word."""

import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from lensshift import reconstruct
from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.types import Burst
from lensshift.io import (
    export_reconstruction,
    load_burst,
    load_image_stack,
    load_reconstruction,
    save_burst,
)
from lensshift.io.container_reader import is_ours
from lensshift.io.foreign_arrays import load_named_arrays
from lensshift.io.reading import memory_limit
from lensshift.pipeline import demo_burst

FRAMES = np.random.default_rng(3).random((4, 6, 7))
HZ = (20e6, 60e6)


def phasors() -> np.ndarray[Any, np.dtype[np.complex128]]:
    rng = np.random.default_rng(4)
    return rng.random((2, 4, 6, 7)) + 1j * rng.random((2, 4, 6, 7))


def test_phasors_beside_amplitudes_are_read(tmp_path: Path) -> None:
    told = phasors()
    np.savez(tmp_path / "a.npz", amplitude=np.abs(told[1]), phasors=told, modulation_hz=HZ)
    burst = load_image_stack(tmp_path / "a.npz")
    assert burst.phasors is not None
    np.testing.assert_array_equal(burst.phasors, told)
    assert burst.frequencies_hz == HZ


def test_phasors_of_one_frequency_need_no_axis_of_it(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", phasors=phasors()[0], modulation_hz=HZ[0])
    np.testing.assert_array_equal(load_image_stack(tmp_path / "a.npz").amplitude, phasors()[0])


def test_four_phases_are_no_choice_of_frames(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **{f"dcs{k}": FRAMES for k in range(4)})
    with pytest.raises(DataError, match="got dcs0, dcs1, dcs2, dcs3; of four phases"):
        load_image_stack(tmp_path / "a.npz")


def test_numbers_of_matlab_have_two_axes(tmp_path: Path) -> None:
    offset_px = np.array([[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]])
    told = {"amplitude": np.moveaxis(FRAMES, 0, 2), "offset_px": offset_px}
    told |= {"modulation_hz": np.array([HZ]), "pitch_mm": np.array([[0.045]])}
    path = hdf5(tmp_path / "a.mat", **{name: values.T for name, values in told.items()})
    with h5py.File(path, "a") as file:
        for name in told:
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with pytest.raises(DataError, match="--frame-axis last"):
        load_image_stack(path)
    burst = load_image_stack(path, frame_axis=-1)
    np.testing.assert_array_equal(burst.amplitude, FRAMES)
    np.testing.assert_array_equal(burst.offset_px, offset_px)
    assert burst.frequencies_hz == HZ
    assert burst.grid.pitch_mm == (0.045, 0.045)


@pytest.mark.parametrize("of", ["burst", "result"])
def test_what_xarray_saves_is_read_as_ours(tmp_path: Path, of: str) -> None:
    pytest.importorskip("xarray")
    burst, _ = demo_burst()
    path = tmp_path / "a.nc"
    if of == "burst":
        burst.to_xarray().to_netcdf(path, engine="h5netcdf")
        again = load_burst(path)
        assert (again.modulation_hz, again.grid) == (burst.modulation_hz, burst.grid)
        np.testing.assert_array_equal(again.amplitude, burst.amplitude)
        np.testing.assert_array_equal(again.offset_px, burst.offset_px)
        return
    result = reconstruct(burst, method="shift-and-add")
    result.to_xarray().to_netcdf(path, engine="h5netcdf")
    image = load_reconstruction(path)["amplitude"].image
    np.testing.assert_array_equal(image, result["amplitude"].image)


@pytest.mark.parametrize("extra", ["offset_um", "K_px", "modulation_mhz"])
def test_what_has_another_name_is_named_whatever_its_shape(tmp_path: Path, extra: str) -> None:
    values = {"offset_um": np.zeros((4, 2)), "K_px": np.eye(3), "modulation_mhz": np.float64(20)}
    np.savez(tmp_path / "a.npz", amplitude=FRAMES, **{extra: values[extra]})
    with pytest.warns(QualityWarning, match=f"nothing is done with {extra};"):
        load_image_stack(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["arr_{}", "frame{}"])
def test_frames_in_arrays_of_their_own_are_one_stack(tmp_path: Path, name: str) -> None:
    many = np.random.default_rng(5).random((11, 6, 7))
    np.savez(tmp_path / "a.npz", **{name.format(k): one for k, one in enumerate(many)})
    np.testing.assert_array_equal(load_image_stack(tmp_path / "a.npz").amplitude, many)
    with pytest.warns(QualityWarning, match="nothing is done with"):
        one = load_image_stack(tmp_path / "a.npz", key=name.format(10))
    np.testing.assert_array_equal(one.amplitude, many[10:])


def test_images_of_two_kinds_are_no_stack(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", amplitude_0=FRAMES[0], depth_0=FRAMES[1])
    with pytest.raises(DataError, match="choose a key among amplitude_0, depth_0"):
        load_image_stack(tmp_path / "a.npz")


def hdf5(path: Path, **arrays: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return path


def test_hdf5_of_another_program_is_a_burst(tmp_path: Path) -> None:
    distance_m = 3.0 + FRAMES
    path = hdf5(tmp_path / "a.h5", amplitude=FRAMES, distance_m=distance_m, valid=FRAMES > 0.1)
    with h5py.File(path, "a") as file:
        file.attrs["modulation_hz"] = 20e6
        file.attrs["operator"] = "somebody"
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/amplitude")
    burst = load_image_stack(path, pitch_mm=0.01)
    np.testing.assert_array_equal(burst.amplitude, FRAMES)
    np.testing.assert_array_equal(burst.distance_m, distance_m)
    np.testing.assert_array_equal(burst.valid, FRAMES > 0.1)
    assert burst.modulation_hz == 20e6
    assert burst.offset_source == "unknown"


def test_arrays_in_groups_have_short_names_where_there_is_one_of_each(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "a.h5", **{"scan/amplitude": FRAMES, "a/x": FRAMES, "b/x": 2 * FRAMES})
    assert set(load_named_arrays(path)) == {"amplitude", "a/x", "b/x"}
    with pytest.warns(QualityWarning, match="nothing is done with a/x, amplitude"):
        chosen = load_image_stack(path, key="b/x", frame_axis=0)
    np.testing.assert_array_equal(chosen.amplitude, 2 * FRAMES)


def test_complex_frames_of_hdf5_keep_their_phase(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "a.h5", phasor=phasors()[0])
    np.testing.assert_array_equal(load_image_stack(path).amplitude, phasors()[0])


def test_numbers_of_netcdf_are_unpacked(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    kelvin = 290.0 + np.round(FRAMES, 2)
    kelvin[0, 2, 3] = np.nan
    data = xarray.Dataset({"amplitude": (("time", "y", "x"), kelvin)}, {"time": np.arange(4.0)})
    packed = {"dtype": "int16", "scale_factor": 0.01, "add_offset": 290.0, "_FillValue": -9999}
    data.to_netcdf(tmp_path / "a.nc", encoding={"amplitude": packed}, engine="h5netcdf")
    with warnings.catch_warnings(action="error"):
        burst = load_image_stack(tmp_path / "a.nc")
    assert not burst.valid[0, 2, 3]
    assert burst.valid.sum() == burst.valid.size - 1
    np.testing.assert_allclose(burst.amplitude[burst.valid], kelvin[burst.valid], atol=1e-9)


def test_axes_of_matlab_are_turned_back(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "a.mat", frames=FRAMES.T)  # as [frame row col] lies in such a file
    with h5py.File(path, "a") as file:
        file["frames"].attrs["MATLAB_class"] = np.bytes_("double")
    np.testing.assert_array_equal(load_image_stack(path).amplitude, FRAMES)


@pytest.mark.parametrize("version", ["7", "7.3"])
def test_files_that_matlab_writes_are_read(tmp_path: Path, version: str) -> None:
    """Version 7 is MATLAB's default; 7.3 is HDF5 behind 512 bytes that say so."""
    offset_px = np.array([[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]])
    waves = (FRAMES * np.exp(1j * FRAMES)).astype(np.complex128)
    told: dict[str, Any] = {"amplitude": np.moveaxis(waves, 0, 2), "offset_px": offset_px}
    told |= {"time_s": np.arange(4.0)[None], "modulation_hz": np.array([[20e6]])}
    path = tmp_path / "a.mat"
    if version == "7":
        scipy.io.savemat(path, told | {"camera": "mine"}, do_compression=True)
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in told.items():
                plain = values.T
                if values.dtype.kind == "c":
                    plain = np.empty(plain.shape, [("real", "f8"), ("imag", "f8")])
                    plain["real"], plain["imag"] = values.T.real, values.T.imag
                file[name] = plain
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
            file["camera"] = np.frombuffer(b"mine", "u1").astype("u2")[:, None]
            file["camera"].attrs["MATLAB_class"] = np.bytes_("char")
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + bytes([0, 2]) + b"IM")
    with warnings.catch_warnings(action="error"):
        burst = load_image_stack(path, frame_axis=-1)
    np.testing.assert_array_equal(burst.amplitude, waves)
    np.testing.assert_array_equal(burst.offset_px, offset_px)
    np.testing.assert_array_equal(burst.time_s, np.arange(4.0))
    assert burst.modulation_hz == 20e6


def test_files_of_matlab_without_arrays_or_damaged_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"s": {"frames": FRAMES}})
    with pytest.raises(DataError, match="-struct"):
        load_image_stack(path)
    scipy.io.savemat(path, {"frames": FRAMES}, do_compression=True)
    whole = path.read_bytes()
    for kept in (1, 100, 140, len(whole) // 2):
        path.write_bytes(whole[:kept])
        with pytest.raises(DataError, match=r"a\.mat: "):
            load_image_stack(path)
    path.write_bytes(whole)
    with memory_limit(1000), pytest.raises(DataError, match="expected at most 1000 bytes"):
        load_image_stack(path)


def test_hdf5_without_numbers_and_files_of_ours_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="there is no array of numbers in it"):
        load_image_stack(hdf5(tmp_path / "a.h5", text="nothing"))
    save_burst(Burst.from_arrays(FRAMES), tmp_path / "b.nc")
    assert is_ours(tmp_path / "b.nc")
    assert not is_ours(tmp_path / "a.h5")
    with pytest.raises(DataError, match="load_burst reads bursts"):
        load_image_stack(tmp_path / "b.nc")
    with pytest.raises(DataError, match=r"load_image_stack reads .* NPZ and HDF5"):
        load_burst(tmp_path / "a.h5")


def test_signs_in_names_are_no_other_kind_of_image(tmp_path: Path) -> None:
    for place in ("-1.5", "-0.5", "0.5", "1.5"):
        np.save(tmp_path / f"at{place}.npy", FRAMES[0])
    with warnings.catch_warnings(action="error"):
        assert load_image_stack(tmp_path).frame_count == 4


def test_a_result_is_read_without_complaints_of_its_own_fields(tmp_path: Path) -> None:
    result = reconstruct(demo_burst()[0], method="shift-and-add")
    export_reconstruction(result, tmp_path / "a.npz")
    with warnings.catch_warnings(action="error"):
        again = load_image_stack(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.amplitude[0], result["amplitude"].image)
