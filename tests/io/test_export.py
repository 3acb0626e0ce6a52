"""Other programs get the numbers that were promised."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image
from test_burst_file import make_burst
from test_result_file import make_estimate, make_reconstruction

from lensshift.core.errors import DataError
from lensshift.core.types import Status
from lensshift.io import export_burst, export_image, export_reconstruction
from lensshift.io.export import finite_range, to_grey


@pytest.mark.parametrize(
    ("dtype", "kept"), [("f8", "f4"), ("u1", "u1"), ("u2", "u2"), ("i4", "f4")]
)
@pytest.mark.parametrize("shape", [(5, 7), (3, 5, 7), (4, 5, 3)])
def test_tiff_keeps_the_numbers(
    tmp_path: Path, dtype: str, kept: str, shape: tuple[int, ...]
) -> None:
    values = np.random.default_rng(0).integers(0, 200, shape).astype(dtype)
    assert export_image(values, tmp_path / "a.tif") == (values.min(), values.max())
    read = tifffile.imread(tmp_path / "a.tif")
    assert read.dtype == kept
    np.testing.assert_array_equal(read, values)


def test_tiff_keeps_nan(tmp_path: Path) -> None:
    values = np.array([[np.nan, 1.0, 2.0]])
    assert export_image(values, tmp_path / "a.tiff") == (1.0, 2.0)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tiff"), values.astype("f4"))


@pytest.mark.parametrize(("bits", "top", "mode"), [(8, 255, "L"), (16, 65535, "I;16")])
def test_png_is_scaled_linearly(tmp_path: Path, bits: Any, top: int, mode: str) -> None:
    values = np.array([[-1.0, 0.0, 1.0, 3.0, np.nan]])
    assert export_image(values, tmp_path / "a.png", bits=bits) == (-1.0, 3.0)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.mode == mode
        np.testing.assert_array_equal(np.asarray(picture), np.rint([[0, top / 4, top / 2, top, 0]]))
        assert (picture.info["black"], picture.info["white"]) == ("-1.0", "3.0")
    assert export_image(values, tmp_path / "a.png", bits=bits, black=0, white=1) == (0.0, 1.0)
    with Image.open(tmp_path / "a.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), [[0, 0, top, top, 0]])


@given(arrays(np.float64, (3, 5), elements=st.floats(-1e300, 1e300) | st.just(np.nan)))
def test_grey_is_monotonic_and_uses_the_whole_range(values: np.ndarray) -> None:
    black, white = finite_range(values)
    grey = to_grey(values, black, white, bits=16).astype(int)
    order = np.argsort(values[np.isfinite(values)])
    assert np.all(np.diff(grey[np.isfinite(values)][order]) >= 0)
    assert np.all(grey[np.isnan(values)] == 0)
    if white > black:
        assert (grey.min(), grey.max()) == (0, 65535)


@pytest.mark.parametrize(
    "values", [np.full((3, 5), np.nan), np.full((3, 5), 7.0), np.ones((3, 5), bool)]
)
def test_flat_and_empty_images_become_black(tmp_path: Path, values: np.ndarray) -> None:
    export_image(values, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert np.asarray(picture).max() == 0


@pytest.mark.parametrize(
    ("values", "name", "options", "said"),
    [
        (np.ones((3, 5), complex), "a.png", {}, "complex"),
        (np.ones((3, 5), complex), "a.tif", {}, "complex"),
        (np.full((3, 5), "x"), "a.tif", {}, "dtype"),
        (np.ones(5), "a.tif", {}, "shape"),
        (np.ones((0, 5)), "a.tif", {}, "shape"),
        (np.ones((2, 3, 5)), "a.png", {}, "shape"),
        (np.full((3, 5), 1e300), "a.tif", {}, "float32"),
        (np.ones((3, 5)), "a.jpg", {}, "ends in .tif or .png"),
        (np.ones((3, 5)), "a.png", {"bits": 12}, "8 or 16 bits"),
        (np.ones((3, 5)), "a.png", {"black": 2.0, "white": 1.0}, "black <= white"),
        (np.ones((3, 5)), "a.png", {"black": np.nan}, "black <= white"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    tmp_path: Path, values: np.ndarray, name: str, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        export_image(values, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.npz"])
def test_nothing_is_left_where_it_cannot_be_written(tmp_path: Path, name: str) -> None:
    target = tmp_path / "none" / name
    with pytest.raises(DataError, match="cannot write"):
        export_reconstruction(make_reconstruction(), target)
    with pytest.raises(DataError, match="cannot write"):
        export_image(np.ones((3, 5)), target.with_suffix(".png"))


def test_reconstruction_as_npz_has_every_field(tmp_path: Path) -> None:
    reconstruction = make_reconstruction(flying=np.arange(140).reshape(10, 14) % 3 == 0)
    assert export_reconstruction(reconstruction, tmp_path / "a.npz") is None
    assert reconstruction.amplitude is not None
    with np.load(tmp_path / "a.npz", allow_pickle=False) as read:
        np.testing.assert_array_equal(read["amplitude"], reconstruction.amplitude.image)
        np.testing.assert_array_equal(read["amplitude_std"], reconstruction.amplitude.std)
        np.testing.assert_array_equal(read["distance_m_objective"], [1.0])
        np.testing.assert_array_equal(read["flying"], reconstruction.flying)
        assert "distance_m_std" not in read
        assert str(read["amplitude_status"]) == Status.MAX_ITERATIONS.name.lower()
        assert (int(read["scale"]), str(read["method"])) == (2, "irwsr")
        assert '"psf_sigma_px": 0.3' in str(read["settings"])
        np.testing.assert_array_equal(read["pitch_mm"], reconstruction.grid.pitch_mm)


def test_reconstruction_as_picture_shows_the_first_channel(tmp_path: Path) -> None:
    reconstruction = make_reconstruction(amplitude=None)
    assert reconstruction.distance_m is not None
    export_reconstruction(reconstruction, tmp_path / "a.tif")
    np.testing.assert_array_equal(
        tifffile.imread(tmp_path / "a.tif"), reconstruction.distance_m.image.astype("f4")
    )
    assert export_reconstruction(reconstruction, tmp_path / "a.png", bits=16) is not None
    nothing = make_reconstruction(amplitude=None, distance_m=None)
    with pytest.raises(ValueError, match="at least one channel"):
        export_reconstruction(nothing, tmp_path / "b.png")
    phasor = make_reconstruction(amplitude=make_estimate(image=np.ones((10, 14), complex)))
    with pytest.raises(ValueError, match="complex"):
        export_reconstruction(phasor, tmp_path / "b.png")


def test_burst_as_pages(tmp_path: Path) -> None:
    burst = make_burst()
    export_burst(burst, tmp_path / "a.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), burst.amplitude)
    with pytest.raises(ValueError, match=r"ends in \.npz, \.tif"):
        export_burst(burst, tmp_path / "a.png")
