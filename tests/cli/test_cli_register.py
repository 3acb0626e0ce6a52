"""`lensshift register` and `lensshift calibrate`."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
import typer
from scipy import ndimage
from stand_in import answer
from typer.testing import CliRunner, Result

from lensshift.cli.calibrate import calibrate
from lensshift.cli.info import info
from lensshift.cli.reconstruct import reconstruct
from lensshift.cli.register import register
from lensshift.core.grid import Grid
from lensshift.core.lens_field import LensField
from lensshift.core.types import Burst
from lensshift.io import (
    load_burst,
    load_lens_field,
    load_reconstruction,
    save_burst,
    save_lens_field,
)
from lensshift.io.calibration_file import load_calibration

OFFSETS = np.array([[0.0, 0.0], [0.3, -0.4], [-0.2, 0.6]])


def call(*arguments: object) -> Result:
    app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)
    app.command()(register)
    app.command()(calibrate)
    app.command()(reconstruct)
    app.command()(info)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def waves(offset_px: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng(2)
    row, col = np.meshgrid(*map(np.arange, shape), indexing="ij")
    frames = np.zeros((len(offset_px), *shape))
    for _ in range(30):
        f, phase = rng.uniform(-0.3, 0.3, 2), rng.uniform(0, 6.28)
        for k, (down, right) in enumerate(offset_px):
            turn = 2 * np.pi * (f[0] * (row - down) + f[1] * (col - right)) + phase
            frames[k] += np.cos(turn) / (0.1 + np.hypot(*f))
    return 0.5 + 0.1 * frames / frames.std() + 0.002 * rng.standard_normal(frames.shape)


@pytest.fixture
def burst_file(tmp_path: Path) -> Path:
    burst = Burst.from_arrays(waves(OFFSETS, (15, 26)), offset_px=np.zeros((3, 2)), pitch_mm=0.1)
    save_burst(burst, tmp_path / "burst.nc")
    return tmp_path / "burst.nc"


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    place = np.linspace(-0.5, 0.5, 3)
    stage = np.array([(row, col) for row in place for col in place])
    burst = Burst.from_arrays(
        waves(stage, (15, 26)), offset_px=np.zeros((9, 2)), pitch_mm=0.1, stage_mm=stage / 5.0
    )
    save_burst(burst, tmp_path / "scan.nc")
    return tmp_path / "scan.nc"


@pytest.mark.parametrize("method", ["auto", "gradient"])
def test_register_writes_a_burst(burst_file: Path, method: str) -> None:
    done = call("register", burst_file, "--method", method)
    assert done.exit_code == 0, done.output
    assert "frame      row px      col px" in done.stdout
    found = load_burst(burst_file.with_name("burst_registered.nc"))
    np.testing.assert_allclose(found.offset_px, OFFSETS, atol=0.03)
    assert found.offset_source == "registered"


def test_register_needs_no_offsets(tmp_path: Path) -> None:
    frames = np.round(250 * waves(OFFSETS, (15, 26)))
    stack = tmp_path / "b.tif"
    tifffile.imwrite(stack, frames.astype(np.uint8), photometric="minisblack")
    done = call("register", stack)
    assert done.exit_code == 0, done.output
    found = load_burst(tmp_path / "b_registered.nc")
    np.testing.assert_allclose(found.offset_px, OFFSETS - OFFSETS.mean(axis=0), atol=0.04)


def test_frames_that_are_left_out_do_not_spoil_the_shifts_of_the_others(tmp_path: Path) -> None:
    frames = waves(OFFSETS, (20, 26))
    alien = np.random.default_rng(3).random((1, 20, 26))
    np.save(tmp_path / "a.npy", np.concatenate([alien, frames]))
    found = answer(call, "reconstruct", tmp_path / "a.npy", "--frames", "1,2,3")
    assert found["warnings"] == []
    wrong = np.array(found["offset_px"])[1:] - OFFSETS
    np.testing.assert_allclose(wrong, np.broadcast_to(wrong[0], (3, 2)), atol=0.02)
    assert call("register", tmp_path / "a.npy", "--frames", "1,2,3").exit_code == 0
    both = load_burst(tmp_path / "a_registered.nc").offset_px
    np.testing.assert_array_equal(both, found["offset_px"])
    assert call("reconstruct", tmp_path / "a.npy", "--frames", "2").exit_code == 0
    twice = call("reconstruct", tmp_path / "a.npy", "--frames", "1,1")
    assert "each once" in " ".join(twice.stderr.split())


@pytest.mark.usefixtures("drawn")
def test_a_bare_stack_is_reconstructed(reference_dir: Path, tmp_path: Path) -> None:
    with np.load(reference_dir / "real_sequences" / "mdsp_eia.npz") as data:
        frames = data["frames"]
    used, rest = [0, 2, 8, 10], [1, 3, 4, 5, 6, 7, 9, 11, 12, 13, 14, 15]
    stack = tmp_path / "chart.tif"
    with pytest.warns(DeprecationWarning, match="RGB"):  # what tifffile makes of four frames
        tifffile.imwrite(stack, frames[used])
    done = call("reconstruct", stack)
    assert done.exit_code == 0, done.output
    assert "no shifts are given; the frames say:" in done.stdout
    result = load_reconstruction(tmp_path / "chart_x2.nc")
    steps_px = -0.25 * np.stack(np.divmod(np.arange(16), 4), axis=1)
    steps_px -= steps_px[used].mean(axis=0)  # as where no shift is told
    predicted = np.stack([result.channels["amplitude"].predict(steps_px[k]) for k in rest])
    error = (predicted - frames[rest])[:, 4:-4, 4:-4]
    assert np.sqrt(np.mean(error**2)) <= 7.6


def test_register_as_json(burst_file: Path) -> None:
    target = burst_file.with_name("r.nc")
    said = answer(call, "register", burst_file, "-o", target)
    moved = np.array(said["offset_px"])
    np.testing.assert_allclose(moved - moved[0], OFFSETS, atol=0.03)
    assert np.shape(said["offset_sigma_px"]) == (3, 2)
    assert said["files"] == [str(target)]


def test_a_burst_is_not_written_under_the_name_of_a_stack(burst_file: Path) -> None:
    target = burst_file.with_name("r.npy")
    done = call("register", burst_file, "-o", target)
    assert done.exit_code == 2
    assert "a burst is a netCDF file" in done.output
    assert not target.exists()


def test_nothing_is_overwritten(burst_file: Path) -> None:
    for verb in ("register", "calibrate"):
        done = call(verb, burst_file, "-o", burst_file)
        assert done.exit_code == 2
        assert "would overwrite the input" in done.output


def test_errors_are_one_line(burst_file: Path, tmp_path: Path) -> None:
    done = call("register", burst_file, "--reference", 3)
    assert (done.exit_code, done.stderr) == (1, "error: expected a reference from 0 to 2, got 3\n")
    done = call("calibrate", burst_file)
    assert done.exit_code == 1
    assert done.stderr.startswith("error: the burst has no stage_mm")
    assert call("calibrate", tmp_path / "missing.nc").exit_code == 1


def test_calibrate_writes_calibration_and_page(scan_file: Path) -> None:
    target, page = scan_file.with_name("c.json"), scan_file.with_name("c.html")
    said = answer(call, "calibrate", scan_file, "-o", target, "--report", page, "--no-psf")
    np.testing.assert_allclose(said["px_per_mm"], [[5, 0], [0, 5]], atol=0.15)
    np.testing.assert_allclose(load_calibration(target).stage_map.px_per_mm, said["px_per_mm"])
    text = page.read_text()
    assert text.count("<img") >= 2
    assert "Good enough" in text
    assert "image row per stage row" in text


def test_calibrate_and_reconstruct_speak_of_lens_fields(scan_file: Path, tmp_path: Path) -> None:
    field, given = even_field((15, 26)), tmp_path / "field.nc"
    save_lens_field(field, given)
    done = call("calibrate", scan_file, "--no-psf", "--lens-field", given)
    assert done.exit_code == 0, done.output
    assert "over the sensor: as the lens field says" in done.stdout
    refined = tmp_path / "scan_lens_field.nc"
    np.testing.assert_allclose(load_lens_field(refined).shift_px, field.shift_px, atol=1e-9)
    told = "reconstruct", scan_file, "--method", "bicubic", "--lens-field", refined
    assert call(*told).exit_code == 0  # finds the shifts from the frames
    known = *told, "--calibration", tmp_path / "scan_calibration.json", "--json"
    done = call(*known)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["settings"]["shift_field"] is True
    save_lens_field(even_field((15, 25)), refined)
    done = call(*known)
    assert done.exit_code == 1
    assert "scan_lens_field.nc: shape: " in done.stderr
    assert "make it with --sensor 26x15" in done.stderr
    again = call("calibrate", scan_file, "--lens-field", refined)
    assert again.exit_code == 2
    assert "would overwrite" in again.output


def even_field(shape: tuple[int, int]) -> LensField:
    """Return a field of a lens that moves the image evenly, by up to 2 px."""
    shift = np.zeros((1, 1, 2, 2, 2))
    shift[0, 0, 1, 0, 0] = shift[0, 0, 0, 1, 1] = 2.0
    spot = np.full((1, 1, 1, 1, 2), 0.01)
    return LensField(Grid(shape, (0.1, 0.1)), shift, spot, (0.4, 0.4))


def test_calibrate_says_when_no_edge_tells_the_blur(scan_file: Path) -> None:
    done = call("calibrate", scan_file)
    assert done.exit_code == 0, done.output
    assert "not measured: no straight edge" in done.stdout


@pytest.mark.parametrize("verb", ["register", "calibrate"])
def test_help_has_examples(verb: str) -> None:
    done = call(verb, "--help")
    assert done.exit_code == 0
    assert f"lensshift {verb}" in done.stdout


def test_frames_that_turn_are_told_by_register_and_info(tmp_path: Path) -> None:
    """Turned about the middle in steps of a degree, by an image library."""
    rng = np.random.default_rng(2)
    scene = ndimage.gaussian_filter(rng.normal(size=(45, 52)), 1.5)
    turned = [ndimage.rotate(scene, angle, reshape=False, order=3) for angle in (0, 1, -1, 2)]
    np.save(tmp_path / "hand.npy", np.array(turned)[:, 6:-6, 6:-6] + 5.0)
    stack, target = tmp_path / "hand.npy", tmp_path / "turned.nc"
    said = answer(call, "register", stack, "--motion", "affine", "-o", target)
    affine = np.array(said["affine"])
    turn_deg = np.rad2deg(affine[:, 1, 0] - affine[:, 0, 1]) / 2
    np.testing.assert_allclose(turn_deg, [0, 1, -1, 2], atol=0.03)
    told = call("info", target).output
    assert "turn deg" in told
    assert said["affine"] == answer(call, "info", target)["affine"]
    sharp = answer(call, "reconstruct", stack, "--motion", "affine", "-o", tmp_path / "sharp.nc")
    assert sharp["channels"]["amplitude"]["status"] != "the frames contradict the picture"
    refused = call("reconstruct", target, "--motion", "affine", "-o", tmp_path / "again.nc")
    assert (refused.exit_code, "unknown shifts" in refused.stderr) == (1, True)
    windows = call("reconstruct", target, "--window", "2", "--motion", "affine")
    assert windows.exit_code == 2
