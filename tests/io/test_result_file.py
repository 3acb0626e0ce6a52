"""Reconstructions survive the way through a file, and bad files are refused."""

import copy
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray

from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.types import Burst, Estimate, Reconstruction, ShiftField, Status
from lensshift.io import load_burst, load_reconstruction, save_reconstruction
from lensshift.reconstruction.reconstruct import reconstruct


def make_estimate(seed: int = 0, **fields: Any) -> Estimate:
    rng = np.random.default_rng(seed)
    complete: dict[str, Any] = {
        "image": rng.random((10, 14)),
        "uncertainty": rng.random((10, 14)),
        "objective": (3.0, 2.0, 1.5),
        "status": Status.MAX_ITERATIONS,
        "confidence": rng.random((3, 5, 7)),
        "prior_weight": 0.01,
        "noise_sigma": 0.005,
    }
    return Estimate(**(complete | fields))


def make_reconstruction(**fields: Any) -> Reconstruction:
    complete: dict[str, Any] = {
        "amplitude": make_estimate(),
        "distance_m": make_estimate(1, objective=(1.0,), prior_weight=None, uncertainty=None),
        "grid": Grid((10, 14), (0.075, 0.05)),
        "scale": 2,
        "method": "irwsr",
        "settings": {"psf_sigma_px": 0.3, "frames": (0, 2)},
    }
    return Reconstruction(**(complete | fields))


def assert_same_estimate(one: Estimate | None, two: Estimate | None) -> None:
    if one is None or two is None:
        assert one is two
        return
    for name in ("image", "std", "confidence"):
        a, b = getattr(one, name), getattr(two, name)
        assert (a is None) == (b is None), name
        if a is not None:
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b, err_msg=name)
    for name in ("objective", "status", "prior_weight", "noise_sigma", "noise_gain", "notes"):
        assert getattr(one, name) == getattr(two, name), name


BARE = Estimate(image=np.ones((10, 14), np.float32))
COMPLEX = make_estimate(image=np.full((10, 14), 1 + 2j))
LOST = Estimate(image=np.full((10, 14), np.nan), status=Status.NOT_FINITE)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"distance_m": None},
        {"amplitude": None},
        {"amplitude": BARE},
        {"amplitude": COMPLEX},
        {"amplitude": LOST},
        {"flying": np.random.default_rng(3).random((10, 14)) < 0.3},
    ],
)
def test_every_field_comes_back_exactly(tmp_path: Path, fields: dict[str, Any]) -> None:
    saved = make_reconstruction(**fields)
    save_reconstruction(saved, tmp_path / "result.nc")
    loaded = load_reconstruction(tmp_path / "result.nc")
    assert_same_estimate(loaded.amplitude, saved.amplitude)
    assert_same_estimate(loaded.distance_m, saved.distance_m)
    assert (loaded.flying is None) == (saved.flying is None)
    if saved.flying is not None:
        np.testing.assert_array_equal(loaded.flying, saved.flying)
    assert loaded.grid == saved.grid
    assert (loaded.scale, loaded.method) == (2, "irwsr")
    assert loaded.settings == {"psf_sigma_px": 0.3, "frames": [0, 2]}


def test_loaded_estimate_says_that_it_cannot_predict(tmp_path: Path) -> None:
    save_reconstruction(make_reconstruction(), tmp_path / "result.nc")
    loaded = load_reconstruction(tmp_path / "result.nc").amplitude
    assert loaded is not None
    with pytest.raises(ValueError, match="carries no forward model"):
        loaded.predict(0)


BURST = Burst.from_arrays(
    0.5 + 0.4 * np.random.default_rng(5).random((5, 6, 9)),
    3.0 + np.random.default_rng(6).random((5, 6, 9)),
    offset_px=[[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5], [0.2, -0.3]],
    pitch_mm=0.1,
    modulation_hz=15e6,
)
STRETCH = np.broadcast_to(np.linspace(0.9, 1.1, 9), (6, 9))
FIELD = ShiftField(BURST.offset_px[:, None, None] * STRETCH[..., None])
SPOTS = replace(FIELD, spot_px2=0.1 * np.random.default_rng(7).random((5, 6, 9, 2)))
LEANING = replace(FIELD, spot_px2=0.1 * np.random.default_rng(9).random((5, 6, 9, 3)))
COMA = replace(SPOTS, skew_px3=0.02 * np.random.default_rng(8).normal(size=(5, 6, 9, 2)))


def reduced_and_back(result: Reconstruction, folder: Path) -> list[Reconstruction]:
    """Return what is left of a result in another process, in a copy, and in a file."""
    save_reconstruction(result, folder / "result.nc")
    loaded = load_reconstruction(folder / "result.nc")
    save_reconstruction(loaded, folder / "again.nc")
    again = load_reconstruction(folder / "again.nc")
    return [pickle.loads(pickle.dumps(result)), copy.deepcopy(result), loaded, again]


@pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")  # the frames are noise
@pytest.mark.parametrize(
    "options",
    [
        {"channel": "phasor"},
        {"channel": "phasor", "method": "tikhonov", "shift_field": FIELD},
        {"channel": "amplitude", "method": "tikhonov", "photometric": True},
        {"channel": "distance", "method": "irwsr", "fill_factor": 0.8, "iterations": 2},
        {"channel": "amplitude", "method": "bicubic", "shift_field": FIELD},
        {"channel": "amplitude", "method": "tikhonov", "shift_field": SPOTS},
        {"channel": "phasor", "method": "tikhonov", "shift_field": COMA},
        {"channel": "phasor", "method": "tikhonov", "shift_field": LEANING},
    ],
)
def test_a_result_travels_and_predicts_afterwards(tmp_path: Path, options: dict[str, Any]) -> None:
    result = reconstruct(BURST, frames=[0, 1, 2, 3], **options)
    for found in reduced_and_back(result, tmp_path):
        for name in ("amplitude", "distance_m"):
            one, two = getattr(result, name), getattr(found, name)
            assert_same_estimate(one, two)
            for frame in (0, 3, 4, (0.1, 0.4)) if one is not None else ():
                np.testing.assert_allclose(two.predict(frame), one.predict(frame), rtol=1e-9)


def test_settings_may_hold_numpy_values_and_records(tmp_path: Path) -> None:
    settings = {"weight": np.float64(0.5), "grid": Grid((1, 2), (1.0, 1.0)), "end": Status.DIRECT}
    save_reconstruction(make_reconstruction(settings=settings), tmp_path / "result.nc")
    assert load_reconstruction(tmp_path / "result.nc").settings == {
        "weight": 0.5,
        "grid": {"shape": [1, 2], "pitch_mm": [1.0, 1.0]},
        "end": "computed directly, without iterations",
    }


def test_other_programs_read_it(tmp_path: Path) -> None:
    from nexusformat.nexus import nxload

    saved = make_reconstruction()
    save_reconstruction(saved, tmp_path / "result.nc")
    with xarray.open_dataset(tmp_path / "result.nc") as data:
        assert data.amplitude.dims == ("row", "col")
        assert data.amplitude.attrs["status"] == "max_iterations"
        rms = np.sqrt(np.mean(data.amplitude_std.values**2))
        assert data.amplitude.attrs["noise_gain"] == pytest.approx(rms / 0.005)
        assert data.distance.attrs["units"] == "m"
        assert data.attrs["method"] == "irwsr"
        assert data.amplitude_confidence.dims == ("frame", "lr_row", "lr_col")
    assert nxload(str(tmp_path / "result.nc")).plottable_data.nxsignal.shape == (10, 14)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"amplitude": None, "distance_m": None}, "neither"),
        ({"settings": {"solver": object()}}, "settings: "),
        ({"grid": Grid((10, 15), (1.0, 1.0))}, "col: "),
        ({"amplitude": make_estimate(uncertainty=np.ones((10, 13)))}, "amplitude_std: "),
        ({"amplitude": make_estimate(image=np.ones(3))}, "amplitude: "),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(DataError) as caught:
        save_reconstruction(make_reconstruction(**fields), tmp_path / "result.nc")
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path))
    assert list(tmp_path.iterdir()) == []


def damage(path: Path, name: str, values: Any, attributes: dict[str, Any] | None = None) -> None:
    with h5py.File(path, "r+") as file:
        data = file["entry/data"]
        kept = dict(data[name].attrs) if name in data else {}
        if name in data:
            del data[name]
        if values is not None:
            data[name] = values
            keys = ("units", "status", "prior_weight", "noise_sigma", "noise_gain")
            data[name].attrs.update({k: kept[k] for k in keys if k in kept} | (attributes or {}))


@pytest.mark.parametrize(
    ("name", "values", "attributes", "said"),
    [
        ("amplitude", np.full((10, 14), np.nan), {}, "amplitude: every pixel is NaN"),
        ("amplitude", np.ones(140), {}, "amplitude: expected [row col]"),
        ("amplitude", np.ones((10, 13)), {}, "amplitude_std: expected shape (10, 13)"),
        ("amplitude", np.ones((10, 14)), {"status": "fine"}, "amplitude@status: "),
        ("amplitude", np.ones((10, 14)), {"status": 3}, "status: "),
        ("amplitude", np.ones((10, 14)), {"noise_sigma": "big"}, "noise_sigma: "),
        ("distance", np.ones((11, 14)), {}, "distance: expected shape (10, 14)"),
        ("amplitude_confidence", np.ones((5, 7)), {}, "amplitude_confidence: "),
        ("amplitude_std", np.ones((10, 14), int), {}, "amplitude_std: "),
        ("flags", np.zeros((10, 13), "u1"), {}, "flags: expected shape (10, 14)"),
    ],
)
def test_file_that_contradicts_itself(
    tmp_path: Path, name: str, values: Any, attributes: dict[str, Any], said: str
) -> None:
    path = tmp_path / "result.nc"
    save_reconstruction(make_reconstruction(), path)
    damage(path, name, values, attributes)
    with pytest.raises(DataError) as caught:
        load_reconstruction(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("attribute", "value"),
    [("scale", 0), ("scale", 1.5), ("scale", None), ("pitch_mm", [1.0, np.nan]), ("method", None)],
)
def test_bad_attribute_is_named(tmp_path: Path, attribute: str, value: Any) -> None:
    path = tmp_path / "result.nc"
    save_reconstruction(make_reconstruction(), path)
    with h5py.File(path, "r+") as file:
        del file["entry/data"].attrs[attribute]
        if value is not None:
            file["entry/data"].attrs[attribute] = value
    with pytest.raises(DataError, match=f": {attribute}: "):
        load_reconstruction(path)


def test_no_channel_left_and_wrong_kind(tmp_path: Path) -> None:
    path = tmp_path / "result.nc"
    save_reconstruction(make_reconstruction(), path)
    with pytest.raises(DataError, match=r"lensshift-burst/1, got .*load_reconstruction reads it"):
        load_burst(path)
    damage(path, "amplitude", None)
    damage(path, "distance", None)
    with pytest.raises(DataError, match="amplitude: the variable is missing"):
        load_reconstruction(path)
