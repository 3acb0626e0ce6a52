"""OME-TIFF, FITS, napari and Open3D get every image with names, units and places."""

import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import tifffile

import lensshift
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Reconstruction
from lensshift.io import (
    export_burst,
    export_reconstruction,
    load_image_stack,
    load_reconstruction,
    napari_layers,
    picture_layers,
    save_burst,
    save_reconstruction,
)
from lensshift.io.picture_layers import napari_reader

NAMES = [
    "amplitude", "amplitude_std", "amplitude_misfit", "distance", "distance_std",
    "distance_misfit", "flying",
]  # fmt: skip


def a_burst(seed: int = 0) -> Burst:
    rng = np.random.default_rng(seed)
    amplitude = 1.0 + 0.2 * rng.random((4, 9, 13))
    burst = Burst.from_arrays(
        amplitude,
        3.0 + 0.1 * rng.random((4, 9, 13)),
        offset_px=[[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]],
        pitch_mm=(0.15, 0.1),
        modulation_hz=15e6,
    )
    return replace(burst, intrinsics=lensshift.Pinhole(40.0, 60.0, 6.5, 3.0))


@pytest.fixture(scope="module")
def result() -> Reconstruction:
    return lensshift.reconstruct(a_burst(), scale=2)


def test_layers_are_all_images(result: Reconstruction) -> None:
    layers = picture_layers(result)
    assert [one.name for one in layers] == NAMES
    assert {one.name: one.unit for one in layers}["distance_std"] == "m"
    assert layers[0].values is result["amplitude"].image
    assert [one.values.shape for one in picture_layers(a_burst())] == [(4, 9, 13)] * 2


def test_ome_tiff_names_channels_and_pixels(result: Reconstruction, tmp_path: Path) -> None:
    export_reconstruction(result, tmp_path / "a.ome.tif")
    with tifffile.TiffFile(tmp_path / "a.ome.tif") as file:
        assert file.is_ome
        assert file.series[0].axes == "CYX"
        values, told = file.asarray(), file.ome_metadata
    assert values.shape == (7, 18, 26)
    np.testing.assert_array_equal(values[3], result["distance"].image.astype(np.float32))
    assert told is not None
    assert 'Name="distance_std (m)"' in told
    export_burst(a_burst(), tmp_path / "b.ome.tif")
    with tifffile.TiffFile(tmp_path / "b.ome.tif") as file:
        assert file.series[0].axes == "TCYX"
    export_burst(replace(a_burst(), distance_m=None), tmp_path / "c.ome.tif")
    again = load_image_stack(tmp_path / "a.ome.tif")
    assert again.grid.pitch_mm == pytest.approx((0.075, 0.05))


def test_fits_says_where_pixels_look(result: Reconstruction, tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    wcs = pytest.importorskip("astropy.wcs")
    export_reconstruction(result, tmp_path / "a.fits")
    assert result.intrinsics is not None
    directions = result.intrinsics.directions(result.grid.shape)
    with fits.open(tmp_path / "a.fits") as pages:
        pages.verify("exception")
        assert [page.name.lower() for page in pages[1:]] == NAMES
        page = pages["DISTANCE"]
        np.testing.assert_array_equal(page.data, result["distance"].image)
        assert page.header["BUNIT"] == "m"
        row, col = 4, 17
        right_deg, up_deg = wcs.WCS(page.header).pixel_to_world_values(col, row)
        x_mm, y_mm = wcs.WCS(page.header, key="A").pixel_to_world_values(col, row)
    x, y, z = directions[row, col]
    # The gnomonic projection: tangents of the plane z = 1.
    right, up = np.deg2rad([right_deg, up_deg])
    assert np.tan(right) == pytest.approx(x / z, rel=1e-9)
    assert np.tan(up) / np.cos(right) == pytest.approx(-y / z, rel=1e-9)
    factor = 1e3 if x_mm < 0.1 else 1.0  # astropy turns mm into m
    assert (x_mm * factor, y_mm * factor) == pytest.approx((17 * 0.05, 4 * 0.075))
    export_burst(replace(a_burst(), intrinsics=None), tmp_path / "b.fits")
    with fits.open(tmp_path / "b.fits") as pages:
        assert pages["AMPLITUDE"].data.shape == (4, 9, 13)


@pytest.mark.parametrize("bent", ["", "SIP", "TPV"])
def test_the_sky_of_a_fits_file_is_that_of_its_result(tmp_path: Path, bent: str) -> None:
    fits, wcs = pytest.importorskip("astropy.io.fits"), pytest.importorskip("astropy.wcs")
    sky = wcs.WCS(naxis=2)
    sky.wcs.ctype = ["RA---TAN-SIP", "DEC--TAN-SIP"] if bent == "SIP" else ["RA---TAN", "DEC--TAN"]
    sky.wcs.crpix, sky.wcs.crval = (5.5, 4.25), (83.8, -5.4)
    sky.wcs.cd = [[-1e-3, 2e-4], [2e-4, 1e-3]]
    if bent == "SIP":
        a, b = np.zeros((3, 3)), np.zeros((3, 3))
        a[2, 0], b[1, 1] = 1e-3, -2e-3
        sky.sip = wcs.Sip(a, b, None, None, sky.wcs.crpix)
    header = sky.to_header(relax=True)
    if bent == "TPV":
        cards = {"CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV", "PV1_1": 1.0, "PV2_1": 1.0}
        header.update(cards | {"PV1_4": 3.0, "PV2_5": -2.0})
        sky = wcs.WCS(header)
    page = fits.PrimaryHDU(a_burst().amplitude, header)
    page.writeto(tmp_path / "sky.fits")
    offset_px = a_burst().offset_px + np.array([0.25, -0.25])
    burst = load_image_stack(tmp_path / "sky.fits", offset_px)
    save_reconstruction(lensshift.reconstruct(burst, method="bicubic"), tmp_path / "result.nc")
    export_reconstruction(load_reconstruction(tmp_path / "result.nc"), tmp_path / "fine.fits")
    export_burst(burst, tmp_path / "frames.fits")
    found = {}
    for name in ("fine", "frames"):
        header = fits.getheader(tmp_path / f"{name}.fits", "AMPLITUDE")
        found[name] = wcs.WCS(header, naxis=2)
    # The first frame shows at (row, col) what the result has at (row, col) less its offset.
    x, y = 7.0, 2.0
    fine = [2.0 * (one + 0.5) - 0.5 for one in (x - offset_px[0, 1], y - offset_px[0, 0])]
    expected = sky.all_pix2world(x, y, 0)
    np.testing.assert_allclose(found["frames"].all_pix2world(x, y, 0), expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found["fine"].all_pix2world(*fine, 0), expected, rtol=0, atol=1e-11)


def test_strange_cards_of_a_sky_are_left_out_in_silence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    cards = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRPIX1": 3.0, "CRPIX2": 2.0}
    cards |= {"A_ORDER": 2, "A_2_0": 1e-3, "B_ORDER": 2, "B_1_1": -2e-3}  # without -SIP
    header = fits.Header(cards)
    fits.PrimaryHDU(a_burst().amplitude, header).writeto(tmp_path / "sip.fits")
    assert load_image_stack(tmp_path / "sip.fits").meta["wcs"]["A_2_0"] == 1e-3
    whole = (tmp_path / "sip.fits").read_bytes()
    (tmp_path / "card.fits").write_bytes(whole.replace(b"'RA---TAN'", b"'RA---TAN "))
    with pytest.warns(QualityWarning, match=r"card\.fits: its world coordinates are left out"):
        assert not load_image_stack(tmp_path / "card.fits").meta
    assert capfd.readouterr().out == ""


def test_napari_gets_layers_and_reads_files(result: Reconstruction, tmp_path: Path) -> None:
    layers = napari_layers(result)
    assert [options["name"] for _, options, _ in layers] == NAMES
    assert {kind for _, _, kind in layers} == {"image", "labels"}
    assert [one[1]["name"] for one in layers if one[1]["visible"]] == ["amplitude", "distance"]
    assert layers[0][1]["scale"] == (0.075, 0.05)
    assert napari_layers(a_burst())[0][1]["scale"] == (1.0, 0.15, 0.1)
    save_burst(a_burst(), tmp_path / "burst.nc")
    save_reconstruction(result, tmp_path / "result.nc")
    for name, count in (("burst.nc", 2), ("result.nc", 7)):
        read = napari_reader(str(tmp_path / name))
        assert read is not None
        assert len(read(str(tmp_path / name))) == count
    (tmp_path / "other.nc").write_bytes(b"CDF")
    assert napari_reader(str(tmp_path / "other.nc")) is None
    assert napari_reader([str(tmp_path / "burst.nc")]) is None


def test_the_manifest_names_what_there_is() -> None:
    text = (Path(lensshift.__file__).parent / "napari.yaml").read_text(encoding="utf-8")
    commands = re.findall(r"id: (\S+)\n\s+title: .*\n\s+python_name: (\S+):(\S+)", text)
    assert commands
    for name, module, function in commands:
        assert callable(getattr(import_module(module), function))
        assert f"- command: {name}" in text
    assert text.startswith("name: lensshift\n")


def test_open3d_gets_float32(result: Reconstruction) -> None:
    cloud = result.point_cloud(normals=True)
    arrays = cloud.to_open3d()
    assert set(arrays) == {"positions", "normals", "amplitude", "std"}
    assert all(one.dtype == np.float32 and len(one) == len(cloud) for one in arrays.values())
    assert arrays["std"].shape == (len(cloud), 1)
    np.testing.assert_allclose(arrays["positions"], cloud.point_m, rtol=1e-6)


@pytest.mark.parametrize("dtype", ["u2", "f4"])
@pytest.mark.parametrize("with_distance", [False, True])
@pytest.mark.parametrize("name", ["a.ome.tif", "a.fits", "a.npz"])
def test_pixels_that_do_not_count_come_back_as_such(
    tmp_path: Path, name: str, with_distance: bool, dtype: str
) -> None:
    if name.endswith("fits"):
        pytest.importorskip("astropy.io.fits")
    rng = np.random.default_rng(6)
    frames = rng.integers(0, 4000, (4, 9, 13)).astype(dtype)
    valid = rng.random(frames.shape) > 0.1
    distance_m = 1.0 + rng.random(frames.shape) if with_distance else None
    export_burst(Burst.from_arrays(frames, distance_m, valid=valid), tmp_path / name)
    found = load_image_stack(tmp_path / name)
    np.testing.assert_array_equal(found.valid, valid)
    np.testing.assert_array_equal(found.amplitude[valid], frames[valid])


@pytest.mark.parametrize("packed", [None, "zlib"])
def test_a_key_takes_a_channel_and_a_depth(tmp_path: Path, packed: str | None) -> None:
    stack = np.random.default_rng(3).integers(0, 999, (4, 3, 2, 9, 13)).astype("u2")  # TZCYX
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, stack, metadata={"axes": "TZCYX"}, compression=packed)
    found = load_image_stack(path, key="C=1,Z=2").amplitude
    np.testing.assert_array_equal(found, stack[:, 2, 1])
    found = load_image_stack(path, key="z=0, t=3").amplitude
    np.testing.assert_array_equal(found, stack[3, 0])
    wrong = {None: "Z=0 to Z=2, C=0 to C=1", "C=1": "got axes TZYX", "C=2": "got 'C=2'"}
    for key, message in wrong.items():
        with pytest.raises(lensshift.DataError, match=message):
            load_image_stack(path, key=key)


def test_a_key_of_our_own_export_takes_another_image(
    result: Reconstruction, tmp_path: Path
) -> None:
    export_reconstruction(result, tmp_path / "a.ome.tif")
    found = load_image_stack(tmp_path / "a.ome.tif", key="C=3").amplitude[0]
    np.testing.assert_array_equal(found, result["distance"].image.astype(np.float32))


def test_our_export_of_amplitudes_alone_is_read(tmp_path: Path) -> None:
    burst = replace(a_burst(), distance_m=None)
    export_burst(burst, tmp_path / "a.ome.tif")
    found = load_image_stack(tmp_path / "a.ome.tif").amplitude
    np.testing.assert_array_equal(found, burst.amplitude.astype(np.float32))


def test_a_key_where_nothing_has_a_name_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((2, 9, 13)))
    with pytest.raises(lensshift.DataError, match="key: arrays have names in NPZ and HDF5"):
        load_image_stack(tmp_path / "a.npy", key="amplitude")
