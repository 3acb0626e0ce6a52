"""Photographs of all kinds come with the levels of their files."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from lensshift.core.errors import DataError
from lensshift.io.photograph import load_jpeg_steps, load_oecf, load_photograph

SHAPE = (13, 21)


def colours(dtype: str = "u1") -> np.ndarray:
    top = np.iinfo(dtype).max
    return np.random.default_rng(4).integers(0, top, (*SHAPE, 3)).astype(dtype)


@pytest.mark.parametrize("dtype", ["u1", "u2"])
@pytest.mark.parametrize("planes", ["contig", "separate"])
def test_a_tiff_of_colours(tmp_path: Path, dtype: str, planes: str) -> None:
    rgb = colours(dtype)
    stored = rgb if planes == "contig" else np.moveaxis(rgb, -1, 0)
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", planarconfig=planes)
    np.testing.assert_array_equal(load_photograph(tmp_path / "a.tif"), rgb)


@pytest.mark.parametrize("packed", [None, "zlib"])
def test_each_page_of_colours_is_a_frame(tmp_path: Path, packed: str | None) -> None:
    pages = np.stack([colours(), 255 - colours()])
    tifffile.imwrite(tmp_path / "a.tif", pages, photometric="rgb", compression=packed)
    for frame in (0, 1):
        found = load_photograph(tmp_path / "a.tif", frame=frame)
        np.testing.assert_array_equal(found, pages[frame])
    with pytest.raises(DataError, match="a frame from 0 to 1, got 2"):
        load_photograph(tmp_path / "a.tif", frame=2)
    Image.fromarray(pages[0]).save(tmp_path / "a.png")
    with pytest.raises(DataError, match="expected frame 0, the only one, got 1"):
        load_photograph(tmp_path / "a.png", frame=1)


@pytest.mark.parametrize("count", [3, 4])
def test_frames_that_tifffile_stored_as_colours_are_frames(tmp_path: Path, count: int) -> None:
    frames = np.random.default_rng(6).integers(0, 255, (count, *SHAPE)).astype("u1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # which says what happens
        tifffile.imwrite(tmp_path / "a.tif", frames)
    for frame in range(1 if count == 3 else 0, count):
        found = load_photograph(tmp_path / "a.tif", frame=frame)
        np.testing.assert_array_equal(found, frames[frame])
    with pytest.raises(DataError, match=f"a frame from 0 to {count - 1}, got {count}"):
        load_photograph(tmp_path / "a.tif", frame=count)


def test_png_and_jpeg(tmp_path: Path) -> None:
    rgb = colours()
    Image.fromarray(rgb).save(tmp_path / "a.png")
    np.testing.assert_array_equal(load_photograph(tmp_path / "a.png"), rgb)
    smooth = np.broadcast_to(np.linspace(20, 200, 64).astype("u1")[:, None], (64, 48))
    Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=98)
    found = load_photograph(tmp_path / "a.jpg")
    assert found.shape == (64, 48)  # equal colours are one channel
    assert np.abs(found.astype(int) - smooth).max() <= 2


def test_a_png_of_colours_may_have_a_palette_or_be_opaque_in_part(tmp_path: Path) -> None:
    rgb = colours()
    opaque = np.full((*rgb.shape[:2], 1), 200, "u1")
    Image.fromarray(np.concatenate([rgb, opaque], axis=-1)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(load_photograph(tmp_path / "a.png"), rgb)
    few = Image.fromarray(rgb).quantize(16)
    few.save(tmp_path / "b.png")
    expected = np.asarray(few.convert("RGB"))
    np.testing.assert_array_equal(load_photograph(tmp_path / "b.png"), expected)
    with pytest.raises(DataError, match="expected frame 0, the only one, got 1"):
        load_photograph(tmp_path / "b.png", frame=1)


@pytest.mark.parametrize("name", ["grey.png", "grey.tif"])
def test_sixteen_bits_of_grey_stay(tmp_path: Path, name: str) -> None:
    grey = np.random.default_rng(0).integers(0, 60000, SHAPE).astype("u2")
    if name.endswith("png"):
        Image.fromarray(grey).save(tmp_path / name)
    else:
        tifffile.imwrite(tmp_path / name, np.stack([grey, grey + 1]), photometric="minisblack")
    found = load_photograph(tmp_path / name, frame=0)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, grey)


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"no picture at all")
    with pytest.raises(DataError, match=r"a\.jpg"):
        load_photograph(tmp_path / "a.jpg")
    with pytest.raises(DataError, match=r"b\.png"):
        load_photograph(tmp_path / "b.png")
    tifffile.imwrite(tmp_path / "c.tif", np.zeros((2, *SHAPE), "u1"), photometric="minisblack")
    with pytest.raises(DataError, match="a frame from 0 to 1, got 5"):
        load_photograph(tmp_path / "c.tif", frame=5)


def test_a_measured_curve(tmp_path: Path) -> None:
    file = tmp_path / "oecf.csv"
    file.write_text("level,light\n0,0\n\n128,0.2\n255,1\n")
    np.testing.assert_array_equal(load_oecf(file), [[0, 0], [128, 0.2], [255, 1]])
    for text, message in (("0,0\n1,x\n", "line 2"), ("0,0\n", "two lines")):
        file.write_text(text)
        with pytest.raises(DataError, match=message):
            load_oecf(file)


def test_the_steps_of_a_jpeg_count_frequencies_by_rows_and_columns(tmp_path: Path) -> None:
    """Steps that only stripes along the rows feel: these vanish, those along the columns stay."""
    steps = np.ones((8, 8), dtype=int)
    steps[0, 1:] = 250
    row, col = np.indices((64, 64))
    for name, place in (("kept", row), ("lost", col)):
        stripes = np.rint(128 + 20 * np.cos(2 * np.pi * 3 * place / 16)).astype(np.uint8)
        path = tmp_path / f"{name}.jpg"
        Image.fromarray(stripes).save(path, qtables=[steps.ravel().tolist()])
        np.testing.assert_array_equal(load_jpeg_steps(path), steps)
        assert (np.ptp(load_photograph(path)) > 30) == (name == "kept")
    Image.fromarray(stripes).save(tmp_path / "none.png")
    assert load_jpeg_steps(tmp_path / "none.png") is None


def test_a_photograph_and_its_blocks_are_turned_as_a_viewer_shows_them(tmp_path: Path) -> None:
    rgb = colours()
    exif = Image.Exif()
    exif[0x0112] = 6
    stored = Image.fromarray(rgb).transpose(Image.Transpose.ROTATE_90)
    stored.save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(load_photograph(tmp_path / "a.png"), rgb)
    stored.convert("L").save(tmp_path / "grey.png", exif=exif)
    assert load_photograph(tmp_path / "grey.png").shape == SHAPE
    stored.save(tmp_path / "turned.jpg", exif=exif, quality=50)
    stored.save(tmp_path / "plain.jpg", quality=50)
    plain = load_jpeg_steps(tmp_path / "plain.jpg")
    turned = load_jpeg_steps(tmp_path / "turned.jpg")
    assert plain is not None
    assert turned is not None
    assert not np.array_equal(plain, plain.T)
    np.testing.assert_array_equal(turned, plain.T)
