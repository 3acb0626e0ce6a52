"""Image stacks become bursts with the numbers of the files."""

import io
import logging
import pickle
import struct
import warnings
import zipfile
import zlib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin

from lensshift import Burst, reconstruct, register
from lensshift.core.errors import DataError, QualityWarning
from lensshift.io import (
    OffsetTable,
    export_burst,
    export_reconstruction,
    load_burst,
    load_image_stack,
    save_burst,
)
from lensshift.io.foreign_arrays import load_named_arrays
from lensshift.io.image_file import load_frames
from lensshift.io.reading import memory_limit

SHAPE = (4, 5, 7)
OFFSETS = np.array([[0.0, 0.0], [0.0, 0.5], [0.5, 0.0], [0.5, 0.5]])


def frames_of(dtype: str, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    top = 60_000 if dtype == "u2" else 250
    return np.random.default_rng(1).integers(0, top, shape).astype(dtype)


def load(source: Any, **options: Any) -> np.ndarray:
    return load_image_stack(
        source, options.pop("offsets", OFFSETS), pitch_mm=0.1, **options
    ).amplitude


def message_of(source: Any, **options: Any) -> str:
    given: dict[str, Any] = {"offsets": OFFSETS, "pitch_mm": 0.1} | options
    with pytest.raises(DataError) as caught:
        load_image_stack(source, **given)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("dtype", ["u1", "u2", "i2", "f4", "f8"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_multi_page_tiff(tmp_path: Path, dtype: str, compression: str | None) -> None:
    frames = frames_of(dtype)
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack", compression=compression)
    amplitude = load(tmp_path / "a.tif")
    assert amplitude.dtype == frames.dtype
    np.testing.assert_array_equal(amplitude, frames)


@pytest.mark.parametrize("count", [2, 3, 4, 5])
@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
def test_frames_that_tifffile_was_told_nothing_about(
    tmp_path: Path, count: int, dtype: str
) -> None:
    frames = frames_of(dtype, (count, 5, 7))
    with warnings.catch_warnings():  # tifffile itself calls planes of 3 and 4 frames deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        tifffile.imwrite(tmp_path / "a.tif", frames)
    amplitude = load(tmp_path / "a.tif", offsets=np.zeros((count, 2)))
    np.testing.assert_array_equal(amplitude, frames)


def packed_hyperstack(path: Path, pages: np.ndarray, *, channels: int) -> None:
    """Write pages [page row col] packed by LZW, with the axes of ImageJ."""
    told = f"ImageJ=1.53t\nimages={len(pages)}\nchannels={channels}\n"
    told += f"frames={len(pages) // channels}\nhyperstack=true\nmode=grayscale\n"
    first, *rest = (Image.fromarray(page) for page in pages)
    options = {"compression": "tiff_lzw", "tiffinfo": {270: told}}
    first.save(path, save_all=True, append_images=rest, **options)


def test_channels_of_packed_pages_are_no_frames(tmp_path: Path) -> None:
    frames = frames_of("u2")
    packed_hyperstack(tmp_path / "one.tif", frames, channels=1)
    np.testing.assert_array_equal(load(tmp_path / "one.tif"), frames)
    packed_hyperstack(tmp_path / "two.tif", np.concatenate([frames, frames]), channels=2)
    assert "axes TCYX (4, 2, 5, 7); choose a channel" in message_of(tmp_path / "two.tif")
    pages = np.concatenate([frames, frames]).reshape(4, 2, 5, 7)
    np.testing.assert_array_equal(load(tmp_path / "two.tif", key="C=1"), pages[:, 1])


def test_ome_tiffs_of_a_set_hold_each_frame_once(tmp_path: Path) -> None:
    """Each file names all, and tifffile reads them all from any."""
    frames = frames_of("u2")
    count, rows, cols = frames.shape
    parts = "".join(
        f'<TiffData FirstT="{k}" IFD="0" PlaneCount="1"><UUID FileName="{k}.ome.tif">urn:uuid:'
        f"00000000-0000-4000-8000-00000000000{k}</UUID></TiffData>"
        for k in range(count)
    )
    for k, frame in enumerate(frames):
        told = (
            '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
            f'UUID="urn:uuid:00000000-0000-4000-8000-00000000000{k}"><Image ID="Image:0">'
            f'<Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="uint16" SizeX="{cols}" '
            f'SizeY="{rows}" SizeC="1" SizeZ="1" SizeT="{count}" PhysicalSizeX="0.065" '
            f'PhysicalSizeY="0.065"><Channel ID="Channel:0:0"/>{parts}</Pixels></Image></OME>'
        )
        path = tmp_path / f"{k}.ome.tif"
        tifffile.imwrite(path, frame, description=told.encode(), metadata=None)
    for source in (tmp_path, tmp_path / "2.ome.tif"):
        np.testing.assert_array_equal(load(source), frames)
    (tmp_path / "1.ome.tif").unlink()
    assert "1 of its 4 pages are in files that are not beside it" in message_of(
        tmp_path / "2.ome.tif"
    )


@pytest.mark.parametrize("last", [3, 4])
def test_tiff_of_a_narrow_sensor_is_not_colour(tmp_path: Path, last: int) -> None:
    frames = frames_of("f4", (4, 5, last))
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack")
    np.testing.assert_array_equal(load(tmp_path / "a.tif"), frames)


@pytest.mark.parametrize("count", [3, 4])
def test_frames_that_tifffile_takes_for_colours(tmp_path: Path, count: int) -> None:
    frames = frames_of("u2", (count, 5, 7))
    with warnings.catch_warnings():  # tifffile itself calls this deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(frames, 0, -1))
    with pytest.raises(DataError, match="say --frame-axis last if its channels are frames"):
        load_image_stack(tmp_path / "a.tif")
    burst = load_image_stack(tmp_path / "a.tif", frame_axis=-1)
    np.testing.assert_array_equal(burst.amplitude, frames)


def test_a_mask_of_the_sensor_holds_for_all_frames(tmp_path: Path) -> None:
    frames = frames_of("f4")
    frames[1, 0, 0] = np.nan
    mask = np.ones(frames.shape[1:], bool)
    mask[2, 3] = False
    np.savez(tmp_path / "a.npz", amplitude=frames, valid=mask)
    burst = load_image_stack(tmp_path / "a.npz", np.zeros((len(frames), 2)))
    np.testing.assert_array_equal(burst.valid, mask & np.isfinite(frames))


def test_packed_bits_say_what_unpacks_them(tmp_path: Path) -> None:
    """As an old camera writes 12 bits; NumPy alone does not unpack them."""
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 6), np.uint16), photometric="minisblack")
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as file:
        file.pages.first.tags["BitsPerSample"].overwrite(12)
    if find_spec("imagecodecs") is not None:
        assert load_image_stack(tmp_path / "a.tif").amplitude.shape == (1, 4, 6)
        return
    with pytest.raises(DataError, match=r"12-bit .* pip install imagecodecs, or save it with 8 or"):
        load_image_stack(tmp_path / "a.tif")


@pytest.mark.parametrize("channel", [1, -1])
def test_arrays_of_one_channel(tmp_path: Path, channel: int) -> None:
    frames = frames_of("u2")
    np.save(tmp_path / "a.npy", np.expand_dims(frames, channel))
    np.testing.assert_array_equal(load(tmp_path / "a.npy"), frames)


def test_tiff_that_tifffile_cannot_decompress(tmp_path: Path) -> None:
    frames = frames_of("u2")
    pages = [Image.fromarray(frame) for frame in frames]
    pages[0].save(
        tmp_path / "a.tif", save_all=True, append_images=pages[1:], compression="tiff_lzw"
    )
    amplitude = load(tmp_path / "a.tif")
    assert amplitude.dtype == np.uint16
    np.testing.assert_array_equal(amplitude, frames)


def test_npz_pixels_that_are_no_numbers_are_not_valid(tmp_path: Path) -> None:
    frames, distance_m = frames_of("u2").astype(np.float32), np.full(SHAPE, 3.5)
    given = np.ones(SHAPE, np.uint8)
    frames[0, 0, 0], distance_m[1, 0, 0], given[2, 0, 0] = np.nan, np.inf, 0
    np.savez(tmp_path / "a.npz", amplitude=frames, distance_m=distance_m)
    np.savez(tmp_path / "b.npz", amplitude=frames, distance_m=distance_m, valid=given)
    for name, bad in (("a.npz", [0, 1]), ("b.npz", [0, 1, 2])):
        valid = load_image_stack(tmp_path / name, OFFSETS).valid
        assert valid is not None
        assert np.argwhere(~valid).tolist() == [[k, 0, 0] for k in bad]


@pytest.mark.parametrize(("stored", "dtype", "tag"), [("i4", "u4", 1), ("u1", "i1", 2)])
def test_packed_tiff_of_types_that_pillow_lacks(
    tmp_path: Path, stored: str, dtype: str, tag: int
) -> None:
    values = np.array([[0, 1, 100, 127, 128, 255]]).astype(stored)
    values[0, -1] = -1 if stored == "i4" else 255
    path = tmp_path / "a.tif"
    Image.fromarray(values).save(path, compression="tiff_lzw", tiffinfo={339: tag})
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages.first.tags["SampleFormat"].overwrite(tag)
    amplitude = load_frames(path)
    assert amplitude.dtype == np.dtype(dtype)
    np.testing.assert_array_equal(amplitude[0], values.astype(dtype))


def test_tiff_that_nobody_unpacks_is_not_called_damaged(tmp_path: Path) -> None:
    frames = frames_of("u2").astype(np.float64)
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack")
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as file:
        for page in file.pages:
            page.tags["Compression"].overwrite(5)
    with pytest.raises(DataError, match="cannot unpack float64 of LZW"):
        load(tmp_path / "a.tif")


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_folder_of_png_in_natural_order(tmp_path: Path, dtype: str) -> None:
    frames = frames_of(dtype)
    for number, frame in zip((1, 2, 10, 11), frames, strict=True):
        Image.fromarray(frame).save(tmp_path / f"frame_{number}.png")
    (tmp_path / "notes.txt").write_text("not an image")
    (tmp_path / ".hidden.png").write_text("not an image")
    amplitude = load(tmp_path)
    assert amplitude.dtype == frames.dtype
    np.testing.assert_array_equal(amplitude, frames)


def test_files_in_the_order_given(tmp_path: Path) -> None:
    frames = frames_of("u1")
    for number, frame in enumerate(frames):
        np.save(tmp_path / f"{number}.npy", frame)
    order = [tmp_path / f"{number}.npy" for number in (2, 0, 3, 1)]
    np.testing.assert_array_equal(load(order), frames[[2, 0, 3, 1]])


def test_single_frame_needs_no_offset(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((5, 7)))
    burst = load_image_stack(tmp_path / "a.npy", pitch_mm=(0.1, 0.2))
    np.testing.assert_array_equal(burst.offset_px, [[0.0, 0.0]])
    assert burst.grid.pitch_mm == (0.1, 0.2)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA"])
def test_colour_with_equal_channels_is_grey(tmp_path: Path, mode: str) -> None:
    frame = frames_of("u1")[0]
    Image.fromarray(frame).convert(mode).save(tmp_path / "a.png")
    np.testing.assert_array_equal(load([tmp_path / "a.png"], offsets=None)[0], frame)


def test_tiff_colour_with_equal_channels_is_grey(tmp_path: Path) -> None:
    frame = frames_of("u1")[0]
    tifffile.imwrite(tmp_path / "a.tif", np.stack([frame] * 3, -1), photometric="rgb")
    np.testing.assert_array_equal(load(tmp_path / "a.tif", offsets=None)[0], frame)
    tifffile.imwrite(
        tmp_path / "b.tif", np.stack([frame] * 3), photometric="rgb", planarconfig="separate"
    )
    np.testing.assert_array_equal(load(tmp_path / "b.tif", offsets=None)[0], frame)


def save_png(path: Path, image: np.ndarray, mode: str | None = None) -> None:
    picture = Image.fromarray(image)
    (picture if mode is None else picture.convert(mode)).save(path)


def test_what_is_not_greyscale_is_refused_with_advice(tmp_path: Path) -> None:
    colours = frames_of("u1", (5, 7, 3))
    advice = "save it as greyscale of 8 or 16 bits first"
    save_png(tmp_path / "bilevel.png", colours, "1")
    clear = np.dstack([np.zeros((5, 7, 3), "u1"), frames_of("u1")[0]])
    save_png(tmp_path / "transparent.png", clear)
    tifffile.imwrite(tmp_path / "colour.tif", colours, photometric="rgb")
    tifffile.imwrite(tmp_path / "negative.tif", colours[..., 0], photometric="miniswhite")
    for name in ("bilevel.png", "transparent.png", "colour.tif", "negative.tif"):
        message = message_of(tmp_path / name)
        assert message.startswith(str(tmp_path / name))
        assert advice in message


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P"])
def test_photographs_in_colour_become_their_luminance(tmp_path: Path, mode: str) -> None:
    colours = frames_of("u1", (2, 5, 7, 3))
    for k, one in enumerate(colours):
        save_png(tmp_path / f"{k}.png", one, mode)
    save_png(tmp_path / "2.png", colours[0, ..., 0])  # as where a camera leaves colours out
    with pytest.warns(QualityWarning, match="0.2125 red") as told:
        found = load_image_stack(tmp_path).amplitude
    assert len({str(one.message) for one in told}) == 1
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found[2], colours[0, ..., 0])
    expected = colours @ [0.2125, 0.7154, 0.0721]
    palette = [Image.open(tmp_path / f"{k}.png").convert("RGB") for k in (0, 1)]
    if mode == "P":
        expected = np.stack([np.asarray(one) for one in palette]) @ [0.2125, 0.7154, 0.0721]
    assert np.abs(found[:2] - expected).max() <= 0.5


@pytest.mark.parametrize("packed", [None, "zlib"])
def test_pages_and_files_of_colours_in_tiff_are_photographs(
    tmp_path: Path, packed: str | None
) -> None:
    colours = frames_of("u2", (2, 5, 7, 3))
    kind: dict[str, Any] = {"photometric": "rgb", "compression": packed}
    tifffile.imwrite(tmp_path / "pages.tif", colours, **kind)
    for k, one in enumerate(colours):
        tifffile.imwrite(tmp_path / f"{k}.tif", one, **kind)
    for source in (tmp_path / "pages.tif", [tmp_path / "0.tif", tmp_path / "1.tif"]):
        with pytest.warns(QualityWarning, match="0.2125 red"):
            found = load_image_stack(source).amplitude
        assert np.abs(found - colours @ [0.2125, 0.7154, 0.0721]).max() <= 0.5


TURNED = {
    1: None, 2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM, 5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE, 8: Image.Transpose.ROTATE_270,
}  # fmt: skip  # what a camera so held does to a picture


def save_turned(path: Path, shown: np.ndarray, held: int, told: int) -> None:
    picture, exif = Image.fromarray(shown), Image.Exif()
    exif[0x0112] = told
    way = TURNED[held]
    (picture if way is None else picture.transpose(way)).save(path, exif=exif)


@pytest.mark.parametrize("told", TURNED)
def test_photographs_are_turned_as_a_viewer_shows_them(tmp_path: Path, told: int) -> None:
    rng = np.random.default_rng(told)
    scene = rng.integers(0, 200, (9, 12), dtype=np.uint8)
    shown = scene + rng.integers(0, 9, (3, 9, 12), dtype=np.uint8)
    for k, one in enumerate(shown):
        save_turned(tmp_path / f"{k}.png", one, told, told)
    np.testing.assert_array_equal(load_image_stack(tmp_path).amplitude, shown)
    single = load_image_stack(tmp_path / "1.png").amplitude
    np.testing.assert_array_equal(single, shown[1:2])
    save_turned(tmp_path / "1.png", shown[1], 1, 1)  # whoever turned it took the tag away
    np.testing.assert_array_equal(load_image_stack(tmp_path).amplitude, shown)


@pytest.mark.parametrize("guessed", [3, 6, 8])
def test_a_camera_that_guesses_how_it_is_held_does_not_turn_frames(
    tmp_path: Path, guessed: int
) -> None:
    rng = np.random.default_rng(guessed)
    shown = rng.integers(0, 200, (9, 9), np.uint8) + rng.integers(0, 9, (3, 9, 9), np.uint8)
    for k, one in enumerate(shown):
        save_turned(tmp_path / f"{k}.png", one, 1, guessed if k == 1 else 1)
    with pytest.warns(QualityWarning, match="EXIF orientation"):
        found = load_image_stack(tmp_path).amplitude
    np.testing.assert_array_equal(found, shown)


def test_a_damaged_orientation_turns_nothing(tmp_path: Path) -> None:
    frame = frames_of("u1")[0]
    Image.fromarray(frame).save(tmp_path / "a.png", exif=b"Exif\x00\x00XX\x00*damaged")
    np.testing.assert_array_equal(load_image_stack(tmp_path / "a.png").amplitude[0], frame)


def test_deep_colour_is_refused(tmp_path: Path) -> None:
    # 1 x 1 pixel, 16 bits a channel: Pillow would keep only the upper byte of each.
    raw = b"\x00" + b"\x12\x34" * 3

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    header = struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)
    content = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + content)
    assert "16 bits a channel" in message_of(tmp_path / "deep.png")


def test_npz_with_all_fields(tmp_path: Path) -> None:
    path = write_npz(
        tmp_path,
        amplitude=frames_of("u2"),
        distance_m=np.ones(SHAPE),
        valid=np.ones(SHAPE, bool),
        offset_px=OFFSETS,
        offset_sigma_px=OFFSETS,
        pitch_mm=0.25,
        modulation_hz=2e7,
        time_s=np.arange(4.0),
        stage_mm=OFFSETS,
        offset_source="calibrated",
        meta='{"a": 1}',
    )
    burst = load_image_stack(path)
    np.testing.assert_array_equal(burst.amplitude, frames_of("u2"))
    np.testing.assert_array_equal(burst.offset_px, OFFSETS)
    assert burst.grid.pitch_mm == (0.25, 0.25)
    assert (burst.modulation_hz, burst.offset_source, burst.meta) == (2e7, "calibrated", {"a": 1})
    export_burst(burst, tmp_path / "again.npz")
    again = load_image_stack(tmp_path / "again.npz")
    for name in ("amplitude", "distance_m", "valid", "offset_px", "offset_sigma_px", "time_s"):
        np.testing.assert_array_equal(getattr(again, name), getattr(burst, name))
    assert (again.modulation_hz, again.offset_source, again.meta) == (2e7, "calibrated", {"a": 1})
    assert again.grid == burst.grid


def write_npz(folder: Path, **arrays: Any) -> Path:
    np.savez(folder / "a.npz", **arrays)
    return folder / "a.npz"


@pytest.mark.parametrize("name", ["amplitude", "frames", "LR", "whatever"])
def test_npz_finds_the_frames(tmp_path: Path, name: str) -> None:
    path = write_npz(tmp_path, **{name: frames_of("u2"), "truth": np.ones((10, 14))})
    np.testing.assert_array_equal(load(path), frames_of("u2"))


def test_npz_key_and_frame_axis(tmp_path: Path) -> None:
    frames = frames_of("f8")
    path = write_npz(tmp_path, a=np.zeros(SHAPE), b=np.moveaxis(frames, 0, -1))
    np.testing.assert_array_equal(load(path, key="b", frame_axis=-1), frames)
    assert "choose a key among a, b" in message_of(path)
    assert "choose a key among a, b" in message_of(path, key="c")
    assert "set the frame axis to -1" in message_of(path, key="b")
    np.save(tmp_path / "a.npy", np.moveaxis(frames, 0, -1))
    np.testing.assert_array_equal(load(tmp_path / "a.npy", frame_axis=-1), frames)


def test_offsets_given_beside_an_npz_win(tmp_path: Path) -> None:
    path = write_npz(
        tmp_path, amplitude=frames_of("u2"), offset_px=OFFSETS, offset_sigma_px=OFFSETS
    )
    table = OffsetTable(OFFSETS + 1, offset_source="registered")
    burst = load_image_stack(path, table, pitch_mm=1.0)
    np.testing.assert_array_equal(burst.offset_px, OFFSETS + 1)
    assert burst.offset_sigma_px is None
    assert burst.offset_source == "registered"
    changed = load_image_stack(path, table, pitch_mm=1.0, offset_source="calibrated")
    assert changed.offset_source == "calibrated"


def test_offsets_from_a_file_beside(tmp_path: Path) -> None:
    path = write_npz(tmp_path, amplitude=frames_of("u2"))
    (tmp_path / "shifts.csv").write_text("row,col\n" + "".join(f"{r},{c}\n" for r, c in OFFSETS))
    burst = load_image_stack(path, tmp_path / "shifts.csv", pitch_mm=1.0)
    np.testing.assert_array_equal(burst.offset_px, OFFSETS)
    (tmp_path / "short.csv").write_text("row,col\n0,0\n")
    message = message_of(path, offsets=tmp_path / "short.csv")
    assert message.startswith(str(tmp_path / "short.csv"))
    assert "offset_px: expected shape (4, 2) for 4 frames, got (1, 2)" in message


@pytest.mark.parametrize(
    ("arrays", "options", "said"),
    [
        ({}, {"pitch_mm": -1.0}, "pitch_mm: "),
        ({}, {"offsets": [[0, 1]]}, "offset_px: expected shape (4, 2)"),
        ({}, {"offsets": OFFSETS * np.nan}, "offset_px: "),
        ({"distance_m": np.ones((4, 5, 8))}, {}, "distance_m: "),
        ({"distance_m": np.ones(3)}, {}, "distance_m: expected [frame row col]"),
        ({"valid": np.zeros(SHAPE, bool)}, {}, "valid: "),
        ({"amplitude": np.full(SHAPE, np.nan)}, {}, "amplitude: every valid pixel"),
        ({"amplitude": np.zeros((4, 0, 7))}, {}, "amplitude: "),
        ({"amplitude": np.full(SHAPE, "a")}, {}, "amplitude: expected numbers"),
        ({"amplitude": np.ones(3)}, {}, "amplitude: expected [frame row col]"),
        ({"pitch_mm": np.ones(3)}, {"pitch_mm": None}, "pitch_mm: "),
        ({"modulation_hz": "fast"}, {}, "modulation_hz: "),
        ({"meta": "{"}, {}, "meta: "),
        ({"offset_source": "guess"}, {"offsets": None, "offset_source": None}, ""),
        ({"time_s": np.ones(5)}, {}, "time_s: "),
    ],
)
def test_npz_that_contradicts_itself(
    tmp_path: Path, arrays: dict[str, Any], options: dict[str, Any], said: str
) -> None:
    path = write_npz(tmp_path, **({"amplitude": frames_of("u2")} | arrays))
    message = message_of(path, **options)
    assert message.startswith(str(path))
    assert said in message


def test_objects_beside_the_frames_are_left_out(tmp_path: Path) -> None:
    about = np.array({"camera": "mine"}, dtype=object)
    np.savez(tmp_path / "a.npz", frames=frames_of("u2"), meta=about)
    with pytest.warns(QualityWarning, match="a.npz: meta: Python objects are not read"):
        burst = load_image_stack(tmp_path / "a.npz")
    np.testing.assert_array_equal(burst.amplitude, frames_of("u2"))


def test_pickles_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert "Python objects" in message_of(tmp_path / "a.npy")
    np.savez(tmp_path / "b.npz", amplitude=np.array([{"a": 1}], dtype=object))
    message = message_of(tmp_path / "b.npz")
    assert "amplitude: " in message
    (tmp_path / "c.npy").write_bytes(pickle.dumps([1, 2]))
    assert "not an NPY file" in message_of(tmp_path / "c.npy")
    (tmp_path / "d.npz").write_bytes(pickle.dumps([1, 2]))
    assert "not an NPZ file" in message_of(tmp_path / "d.npz")


def test_a_small_npz_does_not_unpack_without_bound(tmp_path: Path) -> None:
    header = {"descr": "|u1", "fortran_order": False, "shape": (512, 1 << 20, 1)}
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("amplitude.npy", "w") as file,
    ):
        np.lib.format.write_array_header_1_0(file, header)
        for _ in range(512):
            file.write(bytes(1 << 20))
    assert "bytes of memory for a file of" in message_of(tmp_path / "bomb.npz")


def test_npz_with_something_else_inside(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    assert "readme.txt: expected an array" in message_of(tmp_path / "a.npz")


def test_files_that_do_not_fit_together(tmp_path: Path) -> None:
    np.save(tmp_path / "1.npy", np.ones((5, 7)))
    np.save(tmp_path / "2.npy", np.ones((5, 8)))
    np.save(tmp_path / "3.npy", np.ones((5, 7), "u1"))
    np.save(tmp_path / "4.npy", np.ones(7))
    first = tmp_path / "1.npy"
    assert "2.npy: expected (5, 7) pixels as in 1.npy" in message_of([first, tmp_path / "2.npy"])
    assert "3.npy: expected float64 as in 1.npy, got uint8" in message_of(
        [first, tmp_path / "3.npy"]
    )
    assert "4.npy: expected" in message_of([tmp_path / "4.npy"])
    assert "at least one image file" in message_of([])


def test_frames_along_the_last_axis_are_noticed(tmp_path: Path) -> None:
    """An edge across 12 x 30 pixels in four frames, each of its own noise."""
    row, col = np.indices((12, 30))
    edge = [np.clip(row - 0.6 * col + 3 + down - 0.6 * right, 0, 1) for down, right in OFFSETS]
    frames = np.array(edge) + 0.05 * np.random.default_rng(2).normal(size=(4, 12, 30))
    frames[1, 3, 4] = np.nan
    turned = np.moveaxis(frames, 0, -1)
    np.save(tmp_path / "right.npy", frames)
    np.save(tmp_path / "wrong.npy", turned)
    np.savez(tmp_path / "wrong.npz", amplitude=turned)
    np.savez(tmp_path / "said.npz", amplitude=turned, offset_px=np.zeros((12, 2)))
    tifffile.imwrite(tmp_path / "wrong.tif", turned, photometric="minisblack")
    for name in ("wrong.npy", "wrong.npz", "wrong.tif"):
        with pytest.raises(DataError, match=f"{name}.*--frame-axis last"):
            load_image_stack(tmp_path / name)
        assert load_image_stack(tmp_path / name, frame_axis=-1).amplitude.shape == frames.shape
        assert load_image_stack(tmp_path / name, frame_axis=0).amplitude.shape == turned.shape
        assert "expected shape (12, 2) for 12 frames" in message_of(tmp_path / name)
    assert load_image_stack(tmp_path / "said.npz").frame_count == 12
    assert load_image_stack(tmp_path / "right.npy").frame_count == 4
    # Noise says nothing of the axis.
    np.save(tmp_path / "noise.npy", np.random.default_rng(3).normal(size=(40, 30, 3)))
    assert load_image_stack(tmp_path / "noise.npy").frame_count == 40


def test_portable_grey_maps_of_16_bits_are_frames(tmp_path: Path) -> None:
    frames = frames_of("u2")
    for number, frame in enumerate(frames):
        header = b"P5\n%d %d\n65535\n" % frame.shape[::-1]
        (tmp_path / f"{number}.pgm").write_bytes(header + frame.astype(">u2").tobytes())
    np.testing.assert_array_equal(load(tmp_path), frames)


def test_folders_and_names(tmp_path: Path) -> None:
    assert "holds no image" in message_of(tmp_path)
    assert "no such file" in message_of(tmp_path / "none.tif")
    (tmp_path / "a.gif").write_bytes(b"x")
    assert "expected .tif, .tiff, .png, .jpg" in message_of(tmp_path / "a.gif")
    cures = {"mp4": "ffmpeg", "bin": "np.fromfile", "csv": "np.loadtxt", "czi": "OME-TIFF"}
    for ending, cure in cures.items():
        (tmp_path / f"b.{ending}").write_bytes(b"x")
        assert cure in message_of(tmp_path / f"b.{ending}")
    (tmp_path / "a.pcapng").write_bytes(b"x")
    assert "lensshift live --replay plays it" in message_of(tmp_path / "a.pcapng")
    np.save(tmp_path / "1.npy", np.ones((5, 7)))
    save_png(tmp_path / "1.png", np.ones((5, 7), "u1"))
    assert "images of one kind, got .npy and .png" in message_of(tmp_path)


def test_odd_tiffs_are_refused(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "sizes.tif") as writer:
        writer.write(np.ones((5, 7), "u1"))
        writer.write(np.ones((6, 7), "u1"))
    assert "pages of one size" in message_of(tmp_path / "sizes.tif")
    tifffile.imwrite(tmp_path / "four.tif", np.ones((2, 3, 5, 7), "u1"), photometric="minisblack")
    assert "one stack of frames" in message_of(tmp_path / "four.tif")
    tifffile.imwrite(tmp_path / "bits.tif", np.ones((5, 7), bool), photometric="minisblack")
    assert "expected numbers" in message_of(tmp_path / "bits.tif", offsets=None)


def test_decompression_bombs_are_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    Image.new("1", (20_000, 10_000)).save(buffer, "PNG")
    (tmp_path / "bomb.png").write_bytes(buffer.getvalue())
    assert "too large" in message_of(tmp_path / "bomb.png")
    info = PngImagePlugin.PngInfo()
    info.add_text("Comment", "x" * 50_000_000, zip=True)
    Image.fromarray(frames_of("u1")[0]).save(tmp_path / "text.png", pnginfo=info)
    message_of(tmp_path / "text.png")
    tifffile.imwrite(tmp_path / "bomb.tif", frames_of("u1"), photometric="minisblack")
    with tifffile.TiffFile(tmp_path / "bomb.tif", mode="r+") as file:
        file.pages.first.tags["ImageLength"].overwrite(3_000_000_000)
    message_of(tmp_path / "bomb.tif")


def make_files(folder: Path) -> list[Path]:
    frames = frames_of("u2")
    tifffile.imwrite(folder / "plain.tif", frames, photometric="minisblack")
    tifffile.imwrite(folder / "zlib.tif", frames, photometric="minisblack", compression="zlib")
    pages = [Image.fromarray(frame) for frame in frames]
    pages[0].save(
        folder / "lzw.tif", save_all=True, append_images=pages[1:], compression="tiff_lzw"
    )
    pages[0].save(folder / "a.png")
    np.save(folder / "a.npy", frames)
    np.savez_compressed(folder / "a.npz", amplitude=frames, offset_px=OFFSETS, meta="{}")
    return sorted(path for path in folder.iterdir() if path.is_file())


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return make_files(tmp_path_factory.mktemp("images"))


@given(
    number=st.integers(0, 5),
    keep=st.floats(0, 1),
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=3),
)
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_images_give_a_data_error_or_an_image(
    files: list[Path], tmp_path: Path, number: int, keep: float, flips: list[tuple[float, int]]
) -> None:
    content = bytearray(files[number].read_bytes())
    for position, mask in flips:
        content[int(position * len(content))] ^= mask
    path = tmp_path / f"damaged{files[number].suffix}"
    path.write_bytes(content[: int(keep * len(content))])
    offsets = [[0, 0]] if path.suffix == ".png" else OFFSETS
    try:
        burst = load_image_stack(path, offsets, pitch_mm=1.0)
    except DataError as error:
        message = str(error)
    else:
        message = str(path)
        assert burst.amplitude.shape[0] == len(offsets)
    assert message.startswith(str(path))
    assert "\n" not in message


@pytest.mark.parametrize("name", ["plain.tif", "zlib.tif", "lzw.tif", "a.npy", "a.npz", "a.png"])
def test_truncated_image_never_loses_a_pixel(files: list[Path], tmp_path: Path, name: str) -> None:
    whole = next(path for path in files if path.name == name)
    content = whole.read_bytes()
    path = tmp_path / name
    refused = 0
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        try:
            frames = amplitude_in(path)
        except DataError:
            refused += 1
        else:  # only bytes behind the pixels are missing
            np.testing.assert_array_equal(frames, amplitude_in(whole))
    assert refused > 0.9 * len(content) / 7


def amplitude_in(path: Path) -> Any:
    return load_named_arrays(path)["amplitude"] if path.suffix == ".npz" else load_frames(path)


def test_png_with_a_wrong_checksum_is_refused(tmp_path: Path) -> None:
    save_png(tmp_path / "a.png", frames_of("u1", (50, 70)))
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[content.index(b"IDAT") + 20] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    assert "damaged" in message_of(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("options", "expected_mm"),
    [
        ({"imagej": True, "resolution": (10, 5), "metadata": {"unit": "um"}}, (2e-4, 1e-4)),
        ({"imagej": True, "resolution": (4, 2), "metadata": {"unit": "\\u00B5m"}}, (5e-4, 2.5e-4)),
        ({"imagej": True, "resolution": (4, 2), "metadata": {"unit": "mm"}}, (0.5, 0.25)),
        ({"imagej": True, "resolution": (4, 2), "metadata": {"unit": "parsec"}}, (1.0, 1.0)),
        ({"resolution": (72, 72), "resolutionunit": "INCH"}, (1.0, 1.0)),  # of a screen
        ({}, (1.0, 1.0)),
        (
            {"ome": True, "metadata": {"axes": "TYX", "PhysicalSizeX": 0.65, "PhysicalSizeY": 0.7}},
            (7e-4, 6.5e-4),
        ),
    ],
)
def test_the_pixel_size_of_microscopes_is_read(
    tmp_path: Path, options: dict[str, Any], expected_mm: tuple[float, float]
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", frames_of("u2"), photometric="minisblack", **options)
    assert load_image_stack(tmp_path / "a.tif").grid.pitch_mm == pytest.approx(expected_mm)
    assert load_image_stack(tmp_path / "a.tif", pitch_mm=3.0).grid.pitch_mm == (3.0, 3.0)


@pytest.mark.parametrize(
    ("options", "good", "bad"),
    [
        ({"imagej": True, "resolution": (4, 2), "metadata": {"unit": "micron"}},
         b"unit=micron", b"unit=\\u00Bz"),
        ({"ome": True, "metadata": {"axes": "TYX", "PhysicalSizeX": 0.65, "PhysicalSizeY": 0.71}},
         b'SizeX="0.65"', b'SizeX="+e-."'),
    ],
)  # fmt: skip
def test_a_pixel_size_that_is_damaged_is_said(
    tmp_path: Path, options: dict[str, Any], good: bytes, bad: bytes
) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, frames_of("u2"), photometric="minisblack", **options)
    whole = path.read_bytes()
    assert whole.count(good) == 1
    path.write_bytes(whole.replace(good, bad.ljust(len(good), bad[-1:])))
    assert "damaged" in message_of(path, pitch_mm=None)


@pytest.mark.parametrize("silenced", ["all", "tifffile", "level"])
def test_a_program_that_silences_its_loggers_loses_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, silenced: str
) -> None:
    """Pages that are missing are only logged by tifffile, and the others were all there was."""
    logger = logging.getLogger("tifffile")
    if silenced == "all":
        monkeypatch.setattr(logger.manager, "disable", logging.CRITICAL)
    elif silenced == "tifffile":
        monkeypatch.setattr(logger, "disabled", True)
    else:
        monkeypatch.setattr(logger, "level", logging.CRITICAL + 1)
    logger._cache.clear()  # type: ignore[attr-defined]
    disabled = logger.disabled
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, frames_of("u2"), photometric="minisblack", compression="zlib")
    content = path.read_bytes()
    for length in range(8, len(content) - 20, 7):
        path.write_bytes(content[:length])
        assert "damaged" in message_of(path)
    assert logger.disabled is disabled
    assert not logger.isEnabledFor(logging.ERROR)
    logger._cache.clear()  # type: ignore[attr-defined]


def test_what_tifffile_logs_reaches_no_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without the handlers of pytest, which hide what has none of its own.
    monkeypatch.setattr(logging.getLogger("tifffile"), "propagate", False)
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, frames_of("u2"), photometric="minisblack", description="gr\x7f")
    path.write_bytes(path.read_bytes().replace(b"gr\x7f", b"gr\x9d"))
    load(path)
    assert capfd.readouterr().err == ""


def test_the_pixel_size_is_written(tmp_path: Path) -> None:
    burst = Burst.from_arrays(frames_of("f4"), pitch_mm=(0.0123, 0.0456))
    export_burst(burst, tmp_path / "a.tif")
    back = load_image_stack(tmp_path / "a.tif")
    assert back.grid.pitch_mm == pytest.approx(burst.grid.pitch_mm, rel=1e-6)
    np.testing.assert_array_equal(back.amplitude, burst.amplitude)


def test_a_pixel_size_that_nobody_told_is_not_written(tmp_path: Path) -> None:
    """1 mm stands for it; also of a result, whose pixels are a third of that."""
    frames = np.random.default_rng(0).random((2, 6, 7))
    for pitch_mm, told in ((1.0, None), (0.3, (0.1, 0.1))):
        burst = Burst.from_arrays(frames, pitch_mm=pitch_mm)
        result = reconstruct(burst.select([0]), 3, method="nearest", std=False)
        assert burst.grid.tells_pitch() is result.grid.tells_pitch(3) is (told is not None)
        for name in ("a.tif", "a.ome.tif"):
            export_reconstruction(result, tmp_path / name)
            found = load_image_stack(tmp_path / name).grid.pitch_mm
            assert found == pytest.approx(told or (1.0, 1.0))


def test_arrays_that_nothing_is_done_with_are_named(tmp_path: Path) -> None:
    stack = np.ones((2, 6, 7))
    np.savez(tmp_path / "a.npz", frames=stack, distance_mm=3000 * stack, note=np.ones(3))
    with pytest.warns(QualityWarning, match=r"done with distance_mm, note; .* distance_m"):
        load_image_stack(tmp_path / "a.npz")


def test_millimetres_are_questioned_without_a_frequency_too() -> None:
    stack = np.ones((2, 6, 7))
    with pytest.warns(QualityWarning, match="are they millimetres"):
        Burst.from_arrays(stack, 3000.0 * stack)


def test_frames_of_unknown_shifts_wait_for_registration(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", frames_of("u1"), photometric="minisblack")
    burst = load_image_stack(tmp_path / "a.tif")
    assert burst.offset_source == "unknown"
    save_burst(burst, tmp_path / "a.nc")
    assert load_burst(tmp_path / "a.nc").offset_source == "unknown"
    with pytest.raises(DataError, match="register"):
        reconstruct(burst)
    assert reconstruct(burst, frames=[2], method="bicubic").amplitude.image.shape == (10, 14)


def test_pixels_that_are_no_numbers_are_not_valid(tmp_path: Path) -> None:
    frames = frames_of("f4")
    frames[1, 2, 3] = np.nan
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack")
    valid = load_image_stack(tmp_path / "a.tif", OFFSETS).valid
    assert valid is not None
    np.testing.assert_array_equal(valid, np.isfinite(frames))


def test_pages_that_were_written_one_by_one(tmp_path: Path) -> None:
    frames = frames_of("u2")
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for frame in frames:
            file.write(frame, contiguous=False)
    np.testing.assert_array_equal(load(tmp_path / "a.tif"), frames)
    with tifffile.TiffWriter(tmp_path / "b.tif") as file:
        for rows in (5, 4):
            file.write(frames[0, :rows], contiguous=False)
    assert "expected pages of one size and type, got (4, 7) uint16, (5, 7) uint16" in message_of(
        tmp_path / "b.tif"
    )


@pytest.mark.parametrize("dtype", ["u1", "u2", "i2", "f4", "f8"])
def test_fits_as_cube_extensions_and_compressed(tmp_path: Path, dtype: str) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    frames = frames_of(dtype)
    images = [fits.ImageHDU(frame) for frame in frames]
    fits.PrimaryHDU(frames).writeto(tmp_path / "cube.fits")
    fits.HDUList([fits.PrimaryHDU(), *images]).writeto(tmp_path / "pages.fit")
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(frames, quantize_level=0)]).writeto(
        tmp_path / "packed.fits"
    )
    fits.PrimaryHDU(frames).writeto(tmp_path / "archived.fits.gz")
    (tmp_path / "tiles.FITS.fz").write_bytes((tmp_path / "packed.fits").read_bytes())
    names = ("cube.fits", "pages.fit", "packed.fits", "archived.fits.gz", "tiles.FITS.fz")
    for name in names:
        amplitude = load(tmp_path / name)
        assert amplitude.dtype == frames.dtype
        np.testing.assert_array_equal(amplitude, frames)


def test_jpegs_bitmaps_and_palettes_are_frames(tmp_path: Path) -> None:
    levels = (20 * np.arange(8 * 9).reshape(8, 9) % 200).astype("u1")
    for ending in ("jpg", "bmp"):
        folder = tmp_path / ending
        folder.mkdir()
        for number in range(2):
            Image.fromarray(levels).save(folder / f"{number}.{ending}")
    with pytest.warns(QualityWarning, match="JPEG are rounded in blocks"):
        assert load_image_stack(tmp_path / "jpg").amplitude.shape == (2, 8, 9)
    np.testing.assert_array_equal(load_image_stack(tmp_path / "bmp").amplitude[1], levels)
    Image.fromarray(levels).convert("P").save(tmp_path / "palette.png")
    np.testing.assert_array_equal(load_image_stack(tmp_path / "palette.png").amplitude[0], levels)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["amp_0", "amp_1", "depth_0", "depth_1"], True),
        (["0_depth", "0_amp", "1_depth", "1_amp"], True),
        (["frame_2", "frame_10", "frame_3", "frame_4"], False),
        (["left", "right", "up", "down"], False),
        (["a_1", "a_2", "b_3", "b_4"], False),
    ],
)
def test_a_folder_of_two_kinds_of_images_is_questioned(
    tmp_path: Path, names: list[str], said: bool
) -> None:
    for name, frame in zip(names, frames_of("u2"), strict=True):
        Image.fromarray(frame).save(tmp_path / f"{name}.png")
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        assert load(tmp_path).shape == SHAPE
    assert ["have the same numbers" in str(one.message) for one in found] == [True] * said


def test_gzipped_fits_is_bounded_named_and_sorted_as_others(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    frames, sky = frames_of("f4"), fits.Header({"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN"})
    for number in (10, 2):
        name = tmp_path / f"frame_{number}.fits.gz"
        fits.PrimaryHDU(frames[number % 3], sky).writeto(name)
    found = load_image_stack(tmp_path)
    np.testing.assert_array_equal(found.amplitude, frames[[2, 1]])
    assert found.meta["wcs"]["CTYPE1"] == "RA---TAN"
    whole = (tmp_path / "frame_2.fits.gz").read_bytes()
    (tmp_path / "cut.fits.gz").write_bytes(whole[: len(whole) // 2])
    assert "cut short" in message_of(tmp_path / "cut.fits.gz")
    with memory_limit(2_000), pytest.raises(DataError, match="at most 2000 bytes of memory"):
        load_image_stack(tmp_path / "frame_2.fits.gz")


def test_of_a_telescope_the_science_counts_not_its_error(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    frames = frames_of("f4")
    pages = [fits.ImageHDU(frames[None], name="SCI"), fits.ImageHDU(frames, name="ERR")]
    fits.HDUList([fits.PrimaryHDU(), *pages]).writeto(tmp_path / "sci.fts")
    np.testing.assert_array_equal(load_image_stack(tmp_path / "sci.fts").amplitude, frames)
    quality = np.zeros(frames[None].shape, "i2")
    pages.append(fits.ImageHDU(quality, name="DQ"))
    fits.HDUList([fits.PrimaryHDU(), *pages]).writeto(tmp_path / "good.fits")
    np.testing.assert_array_equal(load_image_stack(tmp_path / "good.fits").amplitude, frames)
    quality[0, 1, 2, 3] = 4  # of a pixel that the telescope calls bad
    fits.HDUList([fits.PrimaryHDU(), *pages]).writeto(tmp_path / "bad.fits")
    with pytest.warns(QualityWarning, match="nothing is done with the images DQ; write NaN"):
        load_image_stack(tmp_path / "bad.fits")


@pytest.mark.parametrize(
    ("frame_names", "other_names"),
    [
        (["PRIMARY"], ["MASK", "UNCERT"]),  # of CCDData
        (["PRIMARY"], ["WEIGHT"]),
        (["DATA"], ["STAT", "DQ"]),
        (["IMAGE"], ["MASK", "VARIANCE"]),
        ([f"EXP{n}" for n in range(4)], ["BPM1", "BPM2"]),
    ],
)
def test_masks_and_errors_beside_the_frames_of_a_fits_file_are_none(
    tmp_path: Path, frame_names: list[str], other_names: list[str]
) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    frames = frames_of("f4")
    parts = list(frames) if len(frame_names) > 1 else [frames]
    pages = [fits.ImageHDU(one, name=name) for one, name in zip(parts, frame_names, strict=True)]
    first = fits.PrimaryHDU()
    if frame_names == ["PRIMARY"]:
        first, pages = fits.PrimaryHDU(frames), []
    pages += [fits.ImageHDU(np.ones_like(parts[0]), name=name) for name in other_names]
    fits.HDUList([first, *pages]).writeto(tmp_path / "a.fits")
    with pytest.warns(QualityWarning, match=f"images {', '.join(other_names)}; write NaN"):
        amplitude = load(tmp_path / "a.fits")
    np.testing.assert_array_equal(amplitude, frames)


def test_fits_of_our_own_and_wrong_ones(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    burst = Burst.from_arrays(frames_of("f4"), 1 + frames_of("f4"), offset_px=OFFSETS, pitch_mm=0.1)
    for name in ("a.fits", "a.ome.tif"):
        export_burst(burst, tmp_path / name)
        np.testing.assert_array_equal(load(tmp_path / name), burst.amplitude)
    fits.PrimaryHDU(frames_of("f4")).writeto(tmp_path / "cube.fits")
    (tmp_path / "cut.fits").write_bytes((tmp_path / "cube.fits").read_bytes()[:-2700])
    (tmp_path / "junk.fits").write_bytes(b"SIMPLE  = nonsense" * 99)
    table = fits.BinTableHDU.from_columns([fits.Column("a", "D", array=np.ones(3))])
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(tmp_path / "table.fits")
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.ones((3, 4)))]).writeto(
        tmp_path / "pages.fits"
    )
    unlike = [fits.ImageHDU(np.ones((5, cols))) for cols in (3, 4)]
    fits.HDUList([fits.PrimaryHDU(), *unlike]).writeto(tmp_path / "unlike.fits")
    header = fits.PrimaryHDU(np.ones((2, 3, 4), "f4")).header
    header["NAXIS1"] = header["NAXIS2"] = 1_000_000
    (tmp_path / "claims.fits").write_text(header.tostring(padding=True) + " " * 2880)
    assert "one size, got none" in message_of(tmp_path / "table.fits")
    assert "one size, got (5, 3), (5, 4)" in message_of(tmp_path / "unlike.fits")
    whole = (tmp_path / "pages.fits").read_bytes()
    (tmp_path / "card.fits").write_bytes(whole.replace(b"XTENSION= 'IMAGE", b"XTENSION= IMAGE'"))
    for name in ("cut.fits", "junk.fits", "claims.fits", "card.fits"):
        message_of(tmp_path / name)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.zeros(SHAPE, [("a", "f4")]), "expected numbers"),
        (np.zeros(SHAPE, "M8[s]"), "expected numbers"),
        (np.zeros((0, 5, 7)), "holds no pixel"),
        (np.zeros((3, 4, 5, 7)), "(3, 4, 5, 7); of four phases, make complex frames: (d0 - d2)"),
        (np.zeros((3, 2, 5, 7)), "of real and imaginary parts, make complex frames"),
        (np.full(SHAPE, -3.4e38, "f4"), "expected values up to 1e+15, got 3.4e+38; write NaN"),
    ],
)
def test_arrays_that_are_no_pictures(tmp_path: Path, values: np.ndarray, said: str) -> None:
    np.save(tmp_path / "a.npy", values)
    np.savez(tmp_path / "a.npz", frames=values)
    assert said in message_of(tmp_path / "a.npy")
    message = message_of(tmp_path / "a.npz")
    assert said in message
    assert "frames" in message


def test_half_precision_becomes_single(tmp_path: Path) -> None:
    frames = frames_of("f2")
    np.save(tmp_path / "a.npy", frames)
    amplitude = load(tmp_path / "a.npy")
    assert amplitude.dtype == np.float32
    np.testing.assert_array_equal(amplitude, frames)


def test_what_a_masked_array_hides_is_not_valid() -> None:
    frames = frames_of("f8")
    hidden = np.where(frames > 200, np.nan, frames)
    masked = np.ma.masked_invalid(hidden)
    np.testing.assert_array_equal(Burst.from_arrays(masked).valid, frames <= 200)
    both = Burst.from_arrays(masked, np.ma.masked_less(1 + frames, 50.0))
    np.testing.assert_array_equal(both.valid, (frames <= 200) & (1 + frames >= 50))
    assert Burst.from_arrays(masked, valid=frames < 100).valid.sum() == (frames < 100).sum()
    told = Burst.from_arrays(np.ma.masked_greater(frames, 200), valid=frames > 50)
    np.testing.assert_array_equal(told.valid, (frames > 50) & (frames <= 200))
    sensor = np.arange(frames[0].size).reshape(frames[0].shape) > 3
    told = Burst.from_arrays(np.ma.masked_greater(frames, 200), valid=sensor)
    np.testing.assert_array_equal(told.valid, sensor & (frames <= 200))
    with pytest.raises(DataError, match="valid: expected shape"):
        Burst.from_arrays(np.ma.masked_greater(frames, 200), valid=sensor[:2])


def test_arrays_are_told_what_makes_a_burst_of_them(tmp_path: Path) -> None:
    for call in (reconstruct, register, lambda x: save_burst(x, tmp_path / "a.nc")):
        with pytest.raises(TypeError, match=r"got ndarray; Burst\.from_arrays"):
            call(frames_of("f8"))
    with pytest.raises(DataError, match="load_image_stack reads files"):
        Burst.from_arrays("frames.tif")
    with pytest.raises(DataError, match="pitch_mm: expected one or two numbers"):
        Burst.from_arrays(frames_of("f8"), pitch_mm=(1, 2, 3))
