"""`lensshift reconstruct`: files, words, numbers and refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image
from stand_in import Call, FakeReconstruct, Refused

from lensshift.core.types import Burst
from lensshift.io import load_burst, load_reconstruction, save_burst


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.usefixtures("drawn")
def test_default_names_and_words(call: Call, fake: FakeReconstruct, burst_file: Path) -> None:
    done = call("reconstruct", burst_file)
    assert done.exit_code == 0, done.output
    assert names(burst_file.parent) == {"burst.nc", "burst_x2.nc", "burst_x2_preview.png"}
    for words in (
        "4 frames of 5 x 7 px, offsets planned",
        "irwsr x2: 10 x 14 px in ",
        "amplitude: converged, 2 iterations",
        "prior weight 0.0125",
        "noise sigma  1",
        "noise gain   1.25",
        "burst_x2_preview.png",
    ):
        assert words in done.stdout
    assert done.stderr == ""
    result = load_reconstruction(burst_file.with_name("burst_x2.nc"))
    assert result.amplitude is not None
    assert result.amplitude.image.shape == (10, 14)


def test_options_reach_the_reconstruction(
    call: Call, fake: FakeReconstruct, burst_file: Path, tmp_path: Path
) -> None:
    done = call(
        "reconstruct", burst_file, "-o", tmp_path / "o.nc", "--scale", 3, "--method", "irwsr",
        "--channel", "distance", "--psf-sigma-px", 0.4, "--prior-weight", "0.5", "--frames", "0,2",
        "--noise-sigma", 0.01, "--non-negative", "--photometric", "--fill-factor", 0.9, "--seed", 7,
        "--device", "cuda:1",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    used = dict(fake.calls[0])
    used.pop("on_iteration")
    assert used == {
        "scale": 3, "method": "irwsr", "channel": "distance", "psf_sigma_px": 0.4,
        "prior_weight": 0.5, "frames": (0, 2), "noise_sigma": 0.01, "non_negative": True,
        "photometric": True, "fill_factor": 0.9, "seed": 7, "device": "cuda:1",
    }  # fmt: skip
    bicubic = {"scale": 3, "method": "bicubic", "channel": "distance", "frames": (0, 2)}
    assert fake.calls[1] == bicubic | {"seed": 7, "std": False}


@pytest.mark.parametrize(
    ("text", "value"), [("auto", None), ("cross-validation", "cross-validation"), ("0", 0.0)]
)
def test_prior_weight(
    call: Call, fake: FakeReconstruct, burst_file: Path, text: str, value: object
) -> None:
    assert call("reconstruct", burst_file, "--prior-weight", text).exit_code == 0
    assert fake.calls[0]["prior_weight"] == value


def test_options_of_a_method_reach_it(call: Call, fake: FakeReconstruct, burst_file: Path) -> None:
    words = ("--method", "map", "--option", "prior=huber", "--option", "threshold=1")
    assert call("reconstruct", burst_file, *words).exit_code == 0
    assert {name: fake.calls[0][name] for name in ("prior", "threshold")} == {
        "prior": "huber", "threshold": 1.0
    }  # fmt: skip


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("iterations=0", "iterations: expected a whole number of at least 1, got 0"),
        ("iterations=2.5", "iterations: expected int, got 2.5"),
        ("window=2", "tv does not know window; its options: prior_weight, iterations"),
        ("iterations", "expected NAME=VALUE"),
        ("prior_weight=1", "use --prior-weight"),
    ],
)
def test_a_wrong_option_of_a_method_is_named(
    refused: Refused, fake: FakeReconstruct, burst_file: Path, told: str, said: str
) -> None:
    refused(["reconstruct", burst_file, "--method", "tv", "--option", told], 2, said)
    assert fake.calls == []


@pytest.mark.parametrize(
    ("second_px", "said"),
    [((0.0, 0.0), True), ((3.0, -0.96), True), ((0.0, 0.5), False), ((2.1, 1.0), False)],
)
def test_frames_at_one_place_of_a_pixel_are_said_to_add_little(
    call: Call, fake: FakeReconstruct, tmp_path: Path, second_px: tuple[float, float], said: bool
) -> None:
    np.save(tmp_path / "stack.npy", np.arange(70.0).reshape(2, 5, 7))
    (tmp_path / "shifts.csv").write_text(f"row,col\n0,0\n{second_px[0]},{second_px[1]}\n")
    done = call("reconstruct", tmp_path / "stack.npy", "--offsets", tmp_path / "shifts.csv")
    assert done.exit_code == 0, done.output
    assert ("tell no more than one of them" in done.stderr) is said


def test_json_is_all_there_is_on_stdout(
    call: Call, fake: FakeReconstruct, burst_file: Path
) -> None:
    fake.warning = "the shifts leave 3 %\nof the pixels empty"
    done = call("reconstruct", burst_file, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["method"] == "irwsr"
    assert found["shape"] == [10, 14]
    assert found["channels"]["amplitude"] == {
        "status": "converged",
        "iterations": 2,
        "prior_weight": 0.0125,
        "noise_sigma": 1.0,
        "noise_gain": 1.25,
    }
    assert found["settings"]["inf"] is None
    assert found["warnings"] == ["the shifts leave 3 % of the pixels empty"]
    assert all(Path(file).is_file() for file in found["files"])
    assert len(found["files"]) == 2
    assert done.stderr == "warning: the shifts leave 3 % of the pixels empty\n"


def test_exports(call: Call, fake: FakeReconstruct, burst_file: Path, burst: Burst) -> None:
    folder = burst_file.parent
    files = [folder / f"sharp{suffix}" for suffix in (".tif", ".png", ".npz")]
    options = [part for file in files for part in ("--export", file)]
    assert call("reconstruct", burst_file, *options).exit_code == 0
    expected = np.kron(burst.amplitude[0], np.ones((2, 2)))
    np.testing.assert_array_equal(tifffile.imread(files[0]), expected.astype("f4"))
    with Image.open(files[1]) as picture:
        assert (picture.mode, picture.size) == ("I;16", (14, 10))
    with np.load(files[2]) as arrays:
        np.testing.assert_array_equal(arrays["amplitude"], expected)


def test_image_stack_with_offsets(call: Call, fake: FakeReconstruct, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(2):
        Image.fromarray(np.full((5, 7), 9 + number, "u1")).save(folder / f"{number}.png")
    (tmp_path / "shifts.csv").write_text("row,col\n0,0\n0.5,0.5\n")
    options = ("--offsets", tmp_path / "shifts.csv", "--pitch-mm", "0.1,0.2")
    done = call("reconstruct", folder, *options)
    assert done.exit_code == 0, done.output
    assert {"frames_x2.nc", "frames_x2_preview.png"} <= names(tmp_path)
    assert load_reconstruction(tmp_path / "frames_x2.nc").grid.pitch_mm == (0.05, 0.1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--method", "magic"], "choose among auto, nearest, bicubic"),
        (["--scale", "0"], "Invalid value for '--scale'"),
        (["--scale", "9"], "Invalid value for '--scale'"),
        (["--channel", "phase"], "Invalid value for '--channel'"),
        (["--prior-weight", "heavy"], '"auto" or "cross-validation", got \'heavy\''),
        (["--prior-weight", "-1"], "got '-1'"),
        (["--prior-weight", "nan"], "got 'nan'"),
        (["--frames", "0;2"], "expected numbers as in 0,2,8,10, each once"),
        (["--psf-sigma-px", "-1"], "Invalid value for '--psf-sigma-px'"),
        (["--psf-sigma-px", "wide"], "expected auto or a number of LR px"),
        (["--fill-factor", "1.5"], "Invalid value for '--fill-factor'"),
        (["--export", "sharp.jpg"], "expected a name that ends in .tif"),
        (["-o", "sharp.png"], "the result is a netCDF file"),
        (["-o", "sharp.npy"], "the result is a netCDF file"),
        (["--pitch-mm", "0.1"], "says itself where its frames lie"),
        (["--pitch-mm", "wide"], "expected a pitch like 0.1 or 0.1,0.2, got 'wide'"),
        (["--pitch-mm", "1,2,3"], "expected a pitch like"),
        (["--nonsense"], "No such option"),
    ],
)
def test_wrong_usage(
    refused: Refused, fake: FakeReconstruct, burst_file: Path, options: list[str], said: str
) -> None:
    refused(["reconstruct", burst_file, *options], 2, said)
    assert fake.calls == []


def test_inputs_are_not_overwritten(
    call: Call, fake: FakeReconstruct, burst_file: Path, tmp_path: Path
) -> None:
    before = burst_file.read_bytes()
    folder = tmp_path / "frames"
    folder.mkdir()
    Image.fromarray(np.ones((5, 7), "u1")).save(folder / "0.png")
    for arguments in (
        (burst_file, "-o", burst_file),
        (burst_file, "-o", tmp_path / "frames" / ".." / "burst.nc"),
        (folder, "--pitch-mm", 1, "--export", folder / "0.png"),
        (burst_file, "--export", tmp_path / "a.tif", "--export", tmp_path / "a.tif"),
        (burst_file, "--export", tmp_path / "burst_x2_preview.png"),
    ):
        done = call("reconstruct", *arguments)
        assert done.exit_code == 2, arguments
        assert "would overwrite" in done.stderr or "is written twice" in done.stderr
    assert burst_file.read_bytes() == before
    assert fake.calls == []


@pytest.mark.parametrize("debug", [False, True])
def test_failure_is_one_line(
    call: Call, fake: FakeReconstruct, burst_file: Path, debug: bool
) -> None:
    fake.error = ValueError("expected at least 2 frames,\ngot 1")
    done = call("reconstruct", burst_file, *(["--debug"] if debug else []))
    assert done.exit_code == 1
    assert ("Traceback" in done.stderr) is debug
    assert done.stderr.endswith("error: expected at least 2 frames, got 1\n")
    assert names(burst_file.parent) == {"burst.nc"}


def test_failure_as_json(call: Call, fake: FakeReconstruct, tmp_path: Path) -> None:
    done = call("reconstruct", tmp_path / "none.nc", "--json")
    assert done.exit_code == 1
    expected = f"{tmp_path / 'none.nc'}: there is no such file"
    assert json.loads(done.stdout) == {"error": expected, "warnings": []}
    assert done.stderr == f"error: {expected}\n"


def test_unwritable_result_is_noticed_before_the_work(
    call: Call, fake: FakeReconstruct, burst_file: Path, tmp_path: Path
) -> None:
    done = call("reconstruct", burst_file, "-o", tmp_path / "none" / "sharp.nc")
    assert done.exit_code == 1
    assert "there is no folder" in done.stderr
    assert fake.calls == []


def test_interrupt_leaves_nothing(call: Call, fake: FakeReconstruct, burst_file: Path) -> None:
    fake.error = KeyboardInterrupt()
    done = call("reconstruct", burst_file)
    assert done.exit_code == 130
    assert done.stderr == "interrupted\n"
    assert names(burst_file.parent) == {"burst.nc"}


def test_complex_pictures_are_not_for_tiff(refused: Refused, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", amplitude=np.ones((1, 5, 7), complex), offset_px=np.zeros((1, 2)))
    refused(["reconstruct", tmp_path / "a.npz", "--window", 1], 2, "--window takes a burst file")
    said = "a.tif: the frames are complex; take .npz, .ome.tif or .fits"
    refused(["reconstruct", tmp_path / "a.npz", "--export", tmp_path / "a.tif"], 1, said)


def test_complex_frames_need_a_frequency_for_distances(call: Call, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    waves = 100 * np.exp(1j) + rng.standard_normal((4, 8, 9, 2)) @ [1, 1j]
    shifts = [[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]]
    np.savez(tmp_path / "a.npz", frames=waves, offset_px=shifts)
    silent = call("reconstruct", tmp_path / "a.npz")
    assert "without distances; --modulation-hz" in silent.stderr
    told = call("reconstruct", tmp_path / "a.npz", "--modulation-hz", "20e6")
    assert "distance: " in told.stdout
    assert told.stdout.rstrip().splitlines()[-2].endswith(" m")  # the noise of the distance
    distance_m = load_reconstruction(tmp_path / "a_x2.nc")["distance"].image
    np.testing.assert_allclose(distance_m, 299792458.0 / (4 * np.pi * 20e6), rtol=0.02)


def test_one_frame_is_called_one(call: Call, fake: FakeReconstruct, tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", np.arange(35.0).reshape(5, 7))
    said = call("reconstruct", tmp_path / "one.npy").stdout
    assert "one.npy: one frame of 5 x 7 px" in said
    assert "planned" not in said


def test_reconstruction_as_input_is_refused(
    call: Call, fake: FakeReconstruct, burst_file: Path
) -> None:
    assert call("reconstruct", burst_file).exit_code == 0
    done = call("reconstruct", burst_file.with_name("burst_x2.nc"))
    assert done.exit_code == 1
    assert "expected a burst, got a reconstruction" in done.stderr


@pytest.mark.usefixtures("drawn")
def test_complex_result_has_a_preview_but_no_picture(
    call: Call, fake: FakeReconstruct, tmp_path: Path
) -> None:
    phasors: Any = np.exp(1j * np.linspace(0, 3, 35)).reshape(1, 5, 7)
    save_burst(Burst.from_arrays(phasors, offset_px=[[0, 0]], pitch_mm=1.0), tmp_path / "b.nc")
    assert call("reconstruct", tmp_path / "b.nc").exit_code == 0
    assert (tmp_path / "b_x2_preview.png").is_file()
    done = call("reconstruct", tmp_path / "b.nc", "--export", tmp_path / "b.tif")
    assert done.exit_code == 1
    assert "complex" in done.stderr


def test_photometric_goes_for_unknown_shifts_as_well(call: Call, tmp_path: Path) -> None:
    """Frames of other exposures, which have no shifts in common as they are; they show it, too."""
    rows, cols = np.mgrid[:96, :128] / 2.0
    waves = np.random.default_rng(2).uniform(-0.6, 0.6, (12, 2))
    scene = 100 + sum(9 * np.cos(2 * np.pi * (a * rows + b * cols) / 2 + 5 * a) for a, b in waves)
    moved = [(0, 0), (0, 1), (1, 1), (1, 0)]  # of the finer grid, half pixels
    frames = np.stack(
        [
            np.roll(scene, one, (0, 1)).reshape(48, 2, 64, 2).mean(axis=(1, 3))[4:-4, 4:-4]
            for one in moved
        ]
    )
    frames += np.random.default_rng(3).normal(0, 0.05, frames.shape)
    np.save(tmp_path / "stack.npy", frames * np.array([1, 1, 0.4, 1])[:, None, None])
    for asked, said in (([], True), (["--photometric"], False)):
        done = call("reconstruct", tmp_path / "stack.npy", *asked, "--json")
        assert ("the light of the frames differs" in done.stderr) == said
        assert "brightness of the frames differs" not in done.stderr
        found = np.array(json.loads(done.stdout)["offset_px"])
        np.testing.assert_allclose(found - found[0], np.array(moved) / 2, atol=0.02)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--psf-sigma-px", "30"], "LR px from 0 to 10, got '30'"),
        (["--out", ""], "is a folder; expected the name of the result"),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(
    refused: Refused, burst_file: Path, options: list[str], said: str
) -> None:
    refused(["reconstruct", burst_file, *options], 2, said)


def test_several_images_are_one_burst_by_the_numbers_in_their_names(
    call: Call, fake: FakeReconstruct, refused: Refused, tmp_path: Path
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    rng = np.random.default_rng(5)
    images = [rng.integers(0, 255, (12, 14), dtype="u1") for _ in range(3)]
    paths = [frames / f"f_{number}.png" for number in (9, 10, 100)]
    for path, image in zip(paths, images, strict=True):
        Image.fromarray(image).save(path)
    (tmp_path / "shifts.csv").write_text("row,col\n0,0\n0,0.5\n0.5,0\n")
    told = ("--offsets", tmp_path / "shifts.csv")
    done = call("reconstruct", *sorted(paths), *told)  # as a shell lists them: 10, 100, 9
    assert done.exit_code == 0, done.output
    assert "warning" not in done.stderr
    assert names(frames) == {path.name for path in paths}  # the next call finds the same images
    assert (tmp_path / "frames_x2.nc").exists()
    # Whoever lists them otherwise may mean it, and hears in which order they count.
    both = tmp_path / "all.nc"
    done = call("convert", paths[2], paths[0], paths[1], both, *told)
    np.testing.assert_array_equal(load_burst(both).amplitude, images)
    assert "f_9.png, f_10.png, f_100.png" in done.stderr
    assert json.loads(call("info", *paths, "--json").stdout)["frame_count"] == 3
    refused(["reconstruct", *paths, both], 2, "given alone")
    refused(["register", *paths, tmp_path], 2, "given alone")
    Image.fromarray(images[0][:9]).save(frames / "f_4.png")
    refused(["reconstruct", *frames.iterdir()], 1, "expected (9, 14) pixels as in f_4.png")
    tifffile.imwrite(frames / "f_5.tif", images[0])
    refused(["reconstruct", *frames.iterdir()], 1, "one kind, got .png and .tif")
