"""`lensshift convert`, `info`, `evaluate fidelity` and `run`."""

import json
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy import ndimage
from stand_in import Call, FakeReconstruct, Refused, answer

from lensshift.core.types import Burst, Reconstruction
from lensshift.evaluation import psnr_db
from lensshift.io import load_burst, load_image_stack, save_burst


@pytest.fixture
def result_file(call: Call, fake: FakeReconstruct, burst_file: Path) -> Path:
    assert call("reconstruct", burst_file).exit_code == 0
    return burst_file.with_name("burst_x2.nc")


def test_stack_to_burst_and_back(call: Call, burst: Burst, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", other=np.moveaxis(burst.amplitude, 0, -1), mask=np.ones((4, 5, 7)))
    (tmp_path / "s.json").write_text(json.dumps({"offset_px": burst.offset_px.tolist()}))
    done = call(
        "convert", tmp_path / "a.npz", tmp_path / "a.nc", "--offsets", tmp_path / "s.json",
        "--pitch-mm", 0.1, "--key", "other", "--frame-axis", "last", "--modulation-hz", 2e7,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    converted = load_burst(tmp_path / "a.nc")
    np.testing.assert_array_equal(converted.amplitude, burst.amplitude)
    assert converted.modulation_hz == 2e7
    assert call("convert", tmp_path / "a.nc", tmp_path / "b.npz").exit_code == 0
    np.testing.assert_array_equal(load_image_stack(tmp_path / "b.npz").offset_px, burst.offset_px)
    assert call("convert", tmp_path / "a.nc", tmp_path / "b.tif").exit_code == 0
    assert tifffile.imread(tmp_path / "b.tif").shape == (4, 5, 7)


@pytest.mark.parametrize(("bits", "mode"), [("8", "L"), ("16", "I;16")])
def test_result_to_picture(call: Call, result_file: Path, bits: str, mode: str) -> None:
    target = result_file.with_name("sharp.png")
    found = answer(call, "convert", result_file, target, "--bits", bits)
    assert found["files"] == [str(target)]
    assert found["range"][0] < found["range"][1]
    with Image.open(target) as picture:
        assert (picture.mode, picture.size) == (mode, (14, 10))
        assert float(picture.info["white"]) == found["range"][1]
    assert "grey values from" in call("convert", result_file, target).stdout


@pytest.mark.parametrize(
    ("source", "target", "code", "said"),
    [
        ("burst.nc", "burst.nc", 2, "would overwrite the input"),
        ("burst.nc", "b.png", 2, "a burst becomes a burst file"),
        (
            "burst_x2.nc",
            "b.nc",
            2,
            "a reconstruction becomes .tif, .ome.tif, .fits, .png, .npz, .ply, .pcd, .mcap or .rrd",
        ),
        ("none.nc", "b.nc", 1, "there is no such file"),
        ("text.nc", "b.nc", 1, "not a netCDF-4/HDF5 file"),
        ("burst.nc", "none/b.nc", 1, "there is no folder"),
    ],
)
def test_convert_refuses(
    refused: Refused, result_file: Path, source: str, target: str, code: int, said: str
) -> None:
    folder = result_file.parent
    (folder / "text.nc").write_text("row,col\n")
    refused(["convert", folder / source, folder / target], code, said)


def test_info_of_a_burst(call: Call, burst_file: Path) -> None:
    done = call("info", burst_file)
    assert done.exit_code == 0, done.output
    for words in (
        "burst, schema lensshift-burst/1",
        "4 of 5 x 7 px, float64",
        "0.15 x 0.1 mm (row, col)",
        "100.00 % of the pixels",
        "2e+07 Hz",
        "   1    +0.0000   +0.5000  sigma 0.0100 0.0100",
        "camera: simulated",
    ):
        assert words in done.stdout
    found = json.loads(call("info", burst_file, "--json").stdout)
    assert found["schema"] == "lensshift-burst/1"
    assert found["shape"] == [5, 7]
    assert found["offset_px"][3] == [0.5, 0.5]
    assert found["distance_range_m"][0] >= 3
    assert found["warnings"] == []


def test_info_of_a_result_and_of_a_stack(call: Call, result_file: Path, tmp_path: Path) -> None:
    done = call("info", result_file)
    assert "10 x 14 px, x2 by irwsr" in done.stdout
    assert "prior weight 0.0125" in done.stdout
    found = json.loads(call("info", result_file, "--json").stdout)
    assert (found["kind"], found["scale"]) == ("reconstruction", 2)
    np.save(tmp_path / "one.npy", np.ones((5, 7), complex))
    done = call("info", tmp_path / "one.npy", "--pitch-mm", 1)
    assert "one.npy: image stack\n" in done.stdout
    assert "distance    none" in done.stdout
    assert "modulation  not known" in done.stdout


def test_info_of_a_stack_that_is_not_yet_a_burst(call: Call, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", frames=np.arange(70, dtype="u2").reshape(2, 5, 7))
    done = call("info", tmp_path / "a.npz")
    assert done.exit_code == 0, done.output
    assert "2 of 5 x 7 px, uint16" in done.stdout
    assert "amplitude   0 to 69" in done.stdout
    assert "shifts      not told: --offsets" in done.stdout
    assert "pitch       not told: --pitch-mm" in done.stdout
    found = json.loads(call("info", tmp_path / "a.npz", "--pitch-mm", 0.1, "--json").stdout)
    assert (found["shape"], found["missing"]) == ([5, 7], ["offsets"])
    np.savez(tmp_path / "b.npz", frames=np.ones((2, 5, 7)), pitch_mm=(0.1, 0.2))
    assert "pitch       0.1 x 0.2 mm (row, col)" in call("info", tmp_path / "b.npz").stdout
    (tmp_path / "s.csv").write_text("row,col\n0,0\n0,0.5\n")
    options = ("--pitch-mm", 1, "--offsets", tmp_path / "s.csv")
    assert "+0.5000" in call("info", tmp_path / "a.npz", *options).stdout
    done = call("info", tmp_path / "none.npz")
    assert (done.exit_code, done.stdout) == (1, "")


def test_a_burst_whose_shifts_nobody_told_is_described_and_converted(
    call: Call, tmp_path: Path
) -> None:
    np.save(tmp_path / "a.npy", np.arange(70.0).reshape(2, 5, 7))
    for source, target in (("a.npy", "a.nc"), ("a.nc", "b.npz"), ("a.nc", "b.tif")):
        done = call("convert", tmp_path / source, tmp_path / target)
        assert done.exit_code == 0, done.output
    for name in ("a.nc", "b.npz"):
        assert "shifts      not told" in call("info", tmp_path / name).stdout
        read = load_burst if name == "a.nc" else load_image_stack
        assert read(tmp_path / name).offset_source == "unknown"


def test_info_of_phasors_that_are_not_yet_a_burst(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((2, 4, 5, 7), complex))
    assert "frames      4 of 5 x 7 px" in call("info", tmp_path / "a.npy").stdout
    valid = np.arange(140).reshape(4, 5, 7) > 69
    np.savez(tmp_path / "a.npz", amplitude=np.ones((2, 4, 5, 7), complex), valid=valid)
    assert "valid       50.00 % of the pixels" in call("info", tmp_path / "a.npz").stdout


def test_lengths_are_asked_for_where_nobody_told_the_pitch(
    call: Call, refused: Refused, tmp_path: Path
) -> None:
    frames = np.ones((1, 5, 7))
    save_burst(Burst.from_arrays(frames, 2.0 * frames), tmp_path / "a.nc")
    assert "pitch       not told" in call("info", tmp_path / "a.nc").stdout
    wanted = "reconstruct", tmp_path / "a.nc", "--focal-length-mm", 4.5, "-o", tmp_path / "b.nc"
    refused(wanted, 2, "--focal-length-mm needs to know how large a pixel is")


def test_info_of_something_else(call: Call, tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("entry/data").attrs["schema"] = "other/1"
    done = call("info", tmp_path / "a.h5")
    assert done.exit_code == 1
    assert "expected a burst or a reconstruction, got 'other/1'" in done.stderr


TRUTH = np.random.default_rng(5).random((21, 33)).astype("f4")


def write_images(folder: Path) -> dict[str, Path]:
    image = TRUTH + np.float32(0.01)
    tifffile.imwrite(folder / "a.tif", image)
    np.save(folder / "a.npy", image)
    np.savez(folder / "a.npz", only=image)
    np.savez(folder / "many.npz", amplitude=image, amplitude_std=image)
    burst = Burst.from_arrays(np.stack([image, TRUTH]), offset_px=np.zeros((2, 2)), pitch_mm=1.0)
    from lensshift.io import save_burst

    save_burst(burst, folder / "burst.nc")
    np.save(folder / "truth.npy", TRUTH)
    np.save(folder / "line.npy", np.ones(3))
    np.save(folder / "wide.npy", np.ones((4, 5)))
    return {path.name: path for path in folder.iterdir()}


@pytest.mark.parametrize("name", ["a.tif", "a.npy", "a.npz", "many.npz", "burst.nc"])
def test_fidelity_of_every_kind_of_file(call: Call, tmp_path: Path, name: str) -> None:
    files = write_images(tmp_path)
    found = answer(call, "evaluate", "fidelity", files[name], files["truth.npy"])
    assert found["psnr_db"] == pytest.approx(40.0, abs=1e-3)
    assert found["rmse"] == pytest.approx(0.01, rel=1e-4)
    assert 0.9 < found["ssim"] < 1.0


def test_fidelity_in_words(call: Call, tmp_path: Path) -> None:
    files = write_images(tmp_path)
    done = call("evaluate", "fidelity", files["a.tif"], files["truth.npy"], "--peak", 10)
    assert done.stdout.startswith("PSNR  60.000 dB (peak 10)\n")
    done = call("evaluate", "fidelity", files["burst.nc"], files["truth.npy"], "--frame", 1)
    assert done.stdout == "PSNR  inf dB (peak 1)\nSSIM  1.0000\nRMSE  0\n"
    arguments = (files["burst.nc"], files["truth.npy"], "--frame", 1, "--json")
    assert json.loads(call("evaluate", "fidelity", *arguments).stdout)["psnr_db"] is None


def test_fidelity_of_a_result(call: Call, result_file: Path, burst: Burst, tmp_path: Path) -> None:
    truth = np.kron(burst.amplitude[0], np.ones((2, 2))) + 0.1
    np.savez(tmp_path / "truth.npz", gt=truth, more=truth)
    arguments = (result_file, tmp_path / "truth.npz", "--truth-key", "gt", "--border-px", 0)
    done = call("evaluate", "fidelity", *arguments)
    assert "SSIM  nan\n" in done.stdout  # of less than 11 x 11 pixels there is none
    done = call("evaluate", "fidelity", *arguments[:2])
    assert "choose a key among gt, more" in done.stderr
    done = call("evaluate", "fidelity", *arguments, "--key", "distance")
    assert "expected amplitude, got 'distance'" in done.stderr


def test_integers_with_peak_one_get_a_warning(call: Call, tmp_path: Path) -> None:
    image = (TRUTH * 200).astype("u1")
    Image.fromarray(image).save(tmp_path / "a.png")
    Image.fromarray(image + 2).save(tmp_path / "b.png")
    done = call("evaluate", "fidelity", tmp_path / "b.png", tmp_path / "a.png", "--json")
    assert done.exit_code == 0
    assert "set --peak" in json.loads(done.stdout)["warnings"][0]
    assert done.stderr.startswith("warning: ")
    done = call("evaluate", "fidelity", tmp_path / "b.png", tmp_path / "a.png", "--peak", 255)
    assert done.stderr == ""
    np.save(tmp_path / "a.npy", image.astype(np.float64))  # most of which is brighter than 1
    done = call("evaluate", "fidelity", tmp_path / "b.png", tmp_path / "a.npy")
    assert "white is 1; set --peak" in done.stderr
    done = call("evaluate", "fidelity", tmp_path / "b.png", tmp_path / "a.png", "--peak", 255)
    expected = psnr_db(image + 2, image, peak=255)
    assert f"PSNR  {expected:.3f} dB" in done.stdout


@pytest.mark.parametrize(("away_px", "said"), [((0.6, -0.4), True), ((0.0, 0.0), False)])
def test_an_image_beside_the_truth_is_told(
    call: Call, tmp_path: Path, away_px: tuple[float, float], said: bool
) -> None:
    rng = np.random.default_rng(6)
    scene = ndimage.gaussian_filter(rng.random((40, 48)), 2.0)
    scene = (scene - scene.min()) / np.ptp(scene)
    noise = 0.01 * rng.standard_normal(scene.shape)
    np.save(tmp_path / "truth.npy", scene)
    np.save(tmp_path / "image.npy", ndimage.shift(scene, away_px, mode="nearest") + noise)
    found = answer(call, "evaluate", "fidelity", tmp_path / "image.npy", tmp_path / "truth.npy")
    told = [text for text in found["warnings"] if "from the truth: brought back" in text]
    assert len(told) == len(found["warnings"]) == said
    if said:
        row, col = told[0].split("(")[1].split(")")[0].split(", ")
        np.testing.assert_allclose((float(row), float(col)), away_px, atol=0.1)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("a.tif", "burst.nc", "--frame", "1"), 1, "expected a frame from 0 to 0, got 1"),
        (("burst.nc", "truth.npy", "--frame", "2"), 1, "expected a frame from 0 to 1, got 2"),
        (("a.tif", "none.tif"), 1, "there is no such file"),
        (("a.tif",), 2, "Missing argument"),
        (("line.npy", "truth.npy"), 1, "expected [row col] and frame 0, got shape (3,)"),
        (("wide.npy", "truth.npy"), 1, "got 4 x 5 px and 21 x 33 px; compare the result of"),
        (("a.tif", "truth.npy", "--border-px", "-1"), 2, "Invalid value for '--border-px'"),
        (("a.tif", "truth.npy", "--border-px", "99"), 1, "expected a border from 0 to 10"),
        (("a.tif", "truth.npy", "--peak", "0"), 1, "expected a positive peak"),
    ],
)
def test_fidelity_refuses(
    refused: Refused, tmp_path: Path, arguments: tuple[str, ...], code: int, said: str
) -> None:
    files = write_images(tmp_path)
    refused(["evaluate", "fidelity", *(files.get(part, part) for part in arguments)], code, said)


@dataclass(frozen=True)
class FakeSummary:
    files: tuple[Path, ...]
    fidelity: dict[str, dict[str, float]]
    depth: dict[str, dict[str, float]]
    reconstruction: Reconstruction
    seconds: float


def test_run_hands_over_to_the_pipeline(
    call: Call, fake: FakeReconstruct, burst: Burst, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, Any] = {}

    def pipeline_run(out_dir: Path, **options: Any) -> FakeSummary:
        seen.update(out_dir=out_dir, **options)
        options["on_iteration"](1, 1.0)
        scale, method = options["scale"] or 2, options["method"] or "auto"
        result = fake(burst, scale=scale, channel="auto", method=method)
        numbers = {"auto": {"psnr_db": 45.5, "ssim": 0.99, "rmse": 0.005}}
        depth = {"auto": {"edge_rmse_m": 0.05, "flat_rmse_m": 0.012}}
        return FakeSummary((out_dir / "sharp.nc",), numbers, depth, result, 0.5)

    module = types.ModuleType("lensshift.pipeline")
    module.run = pipeline_run  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lensshift.pipeline", module)
    done = call("run", "--out", tmp_path / "o", "--scale", 3, "--method", "irwsr", "--seed", 4)
    assert done.exit_code == 0, done.output
    assert (seen["out_dir"], seen["scale"], seen["method"], seen["seed"], seen["config"]) == (
        tmp_path / "o", 3, "irwsr", 4, None,
    )  # fmt: skip
    assert "RMSE 50.0 mm at edges, 12.0 mm elsewhere" in done.stdout
    assert "PSNR 45.50 dB, SSIM 0.9900, RMSE 0.005" in done.stdout
    found = json.loads(call("run", "--out", tmp_path / "o", "--json").stdout)
    assert found["fidelity"]["auto"]["psnr_db"] == 45.5
    assert found["files"] == [str(tmp_path / "o" / "sharp.nc")]
    assert call("run", "--method", "magic").exit_code == 2
