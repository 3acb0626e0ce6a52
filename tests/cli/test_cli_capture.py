"""`capture`, `info` and `emulate`: what they write, what they say, what they refuse."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stand_in import answer
from typer.testing import CliRunner

from lensshift import (
    Burst,
    Calibration,
    lens_field,
    load_burst,
    load_lens,
    load_reconstruction,
    open_rig,
    save_burst,
    save_lens_field,
)
from lensshift.capture.emulators.apt import EmulatedStagePair
from lensshift.capture.emulators.listener import free_udp_port
from lensshift.capture.emulators.o3m import O3MSender
from lensshift.capture.journal import capture_header
from lensshift.capture.opening import EXAMPLE, nominal_calibration
from lensshift.cli.app import app
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.motion import StageMap
from lensshift.core.types import Frame
from lensshift.io.calibration_file import save_calibration
from lensshift.io.capture_file import CaptureWriter, FrameRecord
from lensshift.optics.shift import decenter_for_shift

Call = Callable[..., Any]
SHAPE = (16, 64)


def look(begin_s: float, end_s: float) -> Frame:
    return Frame(np.full(SHAPE, 0.5), np.full(SHAPE, 2.0), np.ones(SHAPE, dtype=bool), end_s)


@pytest.fixture
def rig_file(tmp_path: Path) -> Iterator[Path]:
    port = free_udp_port()
    with EmulatedStagePair(speed=20.0) as pair, O3MSender(look, port=port, rate_hz=40.0):
        file = tmp_path / "rig.toml"
        file.write_text(
            f'[stage]\nrow = "{pair.urls[0]}"\ncol = "{pair.urls[1]}"\nenable_wait_s = 0.05\n'
            'home = "if_needed"\n'
            "timeout_margin_s = 20.0\n"  # a busy computer may stand still for seconds
            f'[camera]\nkind = "o3m"\nport = {port}\nhost = "127.0.0.1"\n'
            "[acquisition]\nframe_timeout_s = 20.0\n"
        )
        yield file


@pytest.fixture
def asking_file(rig_file: Path) -> Path:
    """A rig file that says nothing of homing, as a lab person's first one."""
    file = rig_file.with_name("asking.toml")
    file.write_text(rig_file.read_text().replace('home = "if_needed"\n', ""))
    return file


def test_nothing_is_homed_unasked(call: Call, asking_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.nc"
    capture = ("capture", asking_file, "-o", out, "--plan", "still")
    refused = call(*capture)  # no terminal here
    assert refused.exit_code == 1
    assert "homing: row: KDC101" in refused.stderr
    assert "7.3 mm at most" in refused.stderr
    assert "--yes" in refused.stderr
    assert not out.exists()
    looked = json.loads(call("info", asking_file, "--json").stdout)
    assert looked["stage"]["row"]["homed"] is False
    assert looked["stage"]["position_mm"] == [0.0, 0.0]  # where it was switched on
    assert "zero        not known" in call("info", asking_file).stdout
    done = call(*capture, "--yes")
    assert done.exit_code == 0, done.output
    assert json.loads(call("info", asking_file, "--json").stdout)["stage"]["row"]["homed"]


@pytest.mark.parametrize(("typed", "code"), [("n", 1), ("", 1), ("y", 0)])
def test_a_terminal_is_asked(
    asking_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str, code: int
) -> None:
    monkeypatch.setattr("lensshift.cli.devices.on_terminal", lambda: True)
    arguments = ["capture", str(asking_file), "-o", str(tmp_path / "a.nc"), "--plan", "still"]
    done = CliRunner().invoke(app, arguments, input=f"{typed}\n" if typed else "")
    assert "Home both axes now?" in done.stderr
    assert done.exit_code == code, done.output


def test_a_burst_and_what_is_said_of_it(call: Call, rig_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "burst.nc"
    said = answer(call, "capture", rig_file, "-o", out, "--frames", 2, "--average")
    assert said["frame_count"] == 4
    assert said["counts"]["frames"] >= 8
    assert load_burst(out).frame_count == 4
    resumed = call("capture", rig_file, "-o", out, "--resume")
    assert resumed.exit_code == 0, resumed.output
    assert f"nothing to do: {out} is complete, 4 frames" in resumed.stdout
    other = call("capture", rig_file, "-o", out, "--frames", 3, "--resume")
    assert (other.exit_code, "complete, with frames 2, not 3" in other.stderr) == (1, True)


def test_verbs_read_what_a_killed_capture_left(call: Call, tmp_path: Path) -> None:
    cut, image = tmp_path / "cut.nc", np.random.default_rng(3).random((5, 7))
    with CaptureWriter.create(cut, {"plan": "square", "pitch_mm": [0.1, 0.2]}) as journal:
        for k in range(3):
            where_px = np.array([0.25 * k, -0.5])
            journal.append(
                FrameRecord(
                    step=k, amplitude=image + k, valid=image > 0, offset_px=where_px, time_s=k
                )
            )
    told = json.loads(call("info", cut, "--json").stdout)
    assert (told["kind"], told["frame_count"]) == ("burst", 3)
    assert told["offset_px"][2] == [0.5, -0.5]
    assert call("convert", cut, tmp_path / "a.npz").exit_code == 0
    np.testing.assert_array_equal(np.load(tmp_path / "a.npz")["amplitude"][1], image + 1)


def test_an_unfinished_capture_is_set_aside(call: Call, rig_file: Path, tmp_path: Path) -> None:
    out, aside = tmp_path / "burst.nc", tmp_path / "burst-unfinished-1.nc"
    CaptureWriter.create(out, {"plan": "square", "calibration": {"sha256": "other"}}).close()
    begun = out.read_bytes()
    refused = call("capture", rig_file, "-o", out, "--resume")
    assert refused.exit_code == 1
    done = call("capture", rig_file, "-o", out, "--restart", "--plan", "still")
    assert done.exit_code == 0, done.output
    assert aside.read_bytes() == begun
    again = call("capture", rig_file, "-o", out, "--restart")  # complete: that stays
    assert again.exit_code == 1
    assert "there is a file of this name" in again.stderr


@pytest.mark.parametrize(
    ("name", "status", "problem"),
    [
        ("burst.nc", 1, "there is a file of this name"),
        ("none/a.nc", 1, "there is no folder"),
        (".", 2, "is a folder; expected the name of"),
    ],
)
def test_the_file_is_looked_at_before_anything_is_opened(
    call: Call, burst_file: Path, tmp_path: Path, name: str, status: int, problem: str
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(EXAMPLE)  # no such devices: opening them is another error
    refused = call("capture", rig, "-o", tmp_path / name)
    assert refused.exit_code == status
    assert problem in refused.stderr
    assert sorted(file.name for file in tmp_path.iterdir()) == ["burst.nc", "rig.toml"]
    assert burst_file.stat().st_size > 0
    refused = call("run", "--rig", rig, "--out", tmp_path)
    assert "there is a file of this name" in refused.stderr


def test_progress_position_and_losses_are_shown(call: Call, rig_file: Path, tmp_path: Path) -> None:
    done = call("capture", rig_file, "-o", tmp_path / "a.nc", "--plan", "quincunx")
    assert done.exit_code == 0, done.output
    assert "position 2 of 2: stage at 3.0" in done.stderr
    assert "camera sent" in done.stdout


def test_one_burst_after_another(call: Call, rig_file: Path, tmp_path: Path) -> None:
    done = call(
        "capture", rig_file, "-o", tmp_path / "a.nc", "--plan", "quincunx", "--continuous",
        "--bursts", 2,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    for name in ("a-0001.nc", "a-0002.nc"):
        assert load_burst(tmp_path / name).frame_count == 2
    (tmp_path / "a-0001.nc").unlink()
    before = (tmp_path / "a-0002.nc").read_bytes()
    again = call("capture", rig_file, "-o", tmp_path / "a.nc", "--continuous", "--bursts", 2)
    assert again.exit_code == 1
    assert "a-0002.nc: there is a burst of this name from before" in again.stderr
    assert (tmp_path / "a-0002.nc").read_bytes() == before
    assert not (tmp_path / "a-0001.nc").exists()


@pytest.mark.usefixtures("drawn")
def test_capture_and_reconstruct_in_one_go(call: Call, rig_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = answer(call, "run", "--rig", rig_file, "--method", "shift-and-add", "--out", out)
    assert said["method"] == "shift-and-add"
    for name in ("burst.nc", "result.nc", "preview.png"):
        assert (out / name).stat().st_size > 0
    assert call("run", "--rig", tmp_path / "none.toml").exit_code == 2
    assert call("run", rig_file, "--rig", "emulated").exit_code == 2


def test_what_a_rig_answers(call: Call, rig_file: Path) -> None:
    said = answer(call, "info", rig_file)
    assert said["stage"]["row"]["counts_per_mm"] == 34554.96
    assert said["camera"]["shape"] == [16, 64]
    assert said["camera"]["rate_hz"] > 0
    shown = call("info", rig_file)
    assert "px per mm" in shown.stdout


def test_ports_are_listed(call: Call) -> None:
    assert isinstance(answer(call, "info", "--devices")["ports"], list)
    assert call("info").exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "expected a rig file"),
        (("RIG", "--plan", "round"), "expected a plan of square"),
        (("RIG", "--continuous", "--resume"), "goes with neither"),
        (("RIG", "--resume", "--restart"), "not both"),
        (("RIG", "-o", "burst.tif"), "a burst is a netCDF file"),
    ],
)
def test_wrong_use(call: Call, tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(EXAMPLE)
    done = call("capture", *(rig if one == "RIG" else one for one in arguments))
    assert done.exit_code == 2
    assert message in done.stderr


def test_the_example_is_a_rig_file(call: Call, tmp_path: Path) -> None:
    done = call("capture", "--print-rig")
    assert done.stdout == EXAMPLE
    file = tmp_path / "rig.toml"
    file.write_text(done.stdout.replace("port = 42000", f"port = {free_udp_port()}"))
    missing = call("capture", file, "-o", tmp_path / "a.nc")
    assert missing.exit_code == 1
    assert "83000001" in missing.stderr
    assert not (tmp_path / "a.nc").exists()
    wrong = call("capture", file, "--calibration", tmp_path / "gone.json", "-o", tmp_path / "a.nc")
    assert "gone.json" in wrong.stderr  # and the stage, which is not there, was not asked


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[stage", "is not TOML"),
        ("[lens]\n", r"lens: is not known, expected stage, camera"),
        ("[camera]\nkind = 'film'\n", r"camera\.kind: expected o3m, pcic"),
        ("[camera]\nkind = ['o3m']\n", r"camera\.kind: expected str, got \['o3m'\]"),
        ("[camera]\nport = 0\n[stage]\nkind = 1\n", r"stage\.kind: expected str, got 1"),
        ("[camera]\nexposure = 1\n", r"camera\.exposure: is not known, expected port"),
        ("[camera]\nport = -1\n", r"camera: .*port"),
        ("[camera]\nport = 'abc'\n", r"camera\.port: expected int, got 'abc'"),
        ("[camera]\npitch_mm = '0.155'\n", r"camera\.pitch_mm: expected float or \[float, float\]"),
        ("[camera]\nmodulation_hz = 15\n", r"modulation_hz: expected a frequency in Hz, got 15"),
        ("[camera]\nkind = 'pcic'\nhost = 'a'\n", r"camera\.pitch_mm: expected this entry"),
        ("[camera]\nkind = 'genicam'\nharvester = 1\n", r"camera\.harvester: is not known"),
        ("[acquisition]\naverage = 'false'\n", r"acquisition\.average: expected bool, got 'false'"),
        ("[acquisition]\nreorder = 1\n", r"acquisition\.reorder: expected bool, got 1"),
        ("[acquisition]\nframes = 1.5\n", r"acquisition\.frames: expected int, got 1\.5"),
        ("[acquisition]\nframes = true\n", r"acquisition\.frames: expected int, got True"),
        ("[acquisition]\nhold_mm = '1'\n", r"acquisition\.hold_mm: expected float, got '1'"),
        ("[calibration]\npx_per_mm = true\n", r"calibration\.px_per_mm: expected float or"),
        ("[calibration]\nfile = 3\n", r"calibration\.file: expected str, got 3"),
        ("[calibration]\nlens_field = 3\n", r"calibration\.lens_field: expected str, got 3"),
        (
            "[calibration]\nlens_field = 'a.nc'\npx_per_mm = 5.6\n",
            r"calibration\.lens_field: px_per_mm and lens_field both say",
        ),
        ("[camera]\nport = 0\n[stage]\nrow = 1.5\ncol = 'b'\n", r"stage\.row: expected str or int"),
        ("[acquisition]\napproach_mm = nan\n", "acquisition: expected a finite approach_mm"),
        (
            "[acquisition]\nframe_timeout_s = inf\n",
            "acquisition: expected a positive frame_timeout",
        ),
        ("[calibration]\nsigma_px = -1.0\n", "expected a sigma_px of at least 0"),
        ("[calibration]\nrest_mm = [nan, 3.0]\n", "rest_mm"),
        (
            "[acquisition]\nframes = 0\n",
            "acquisition: expected frames of 1 to 100000 at a position, got 0",
        ),
        (
            "[acquisition]\nframes = 1000000000\n",
            "expected frames of 1 to 100000 at a position, got 10",
        ),
        ("[calibration]\npx_per_mm = 1e308\n", "px_per_mm: expected pixels of image for a mm"),
        ("[calibration]\npx_per_mm = [[5.6, 0.0], [0.0, 5.6e6]]\n", "px_per_mm: expected pixels"),
        ("[calibration]\nrest_mm = [3000.0, 3.0]\n", "rest_mm: expected places in mm, up to 1000"),
        (
            "[camera]\nport = 0\npitch_mm = 155.0\n",
            r"pitch_mm: .* in mm, got 155; 155 um are 0.155",
        ),
        (
            "[calibration]\nrest_mm = [1, 2, 3]\n",
            r"calibration\.rest_mm: expected \[float, float\]",
        ),
        ("[calibration]\nfile = 'none.json'\n", r"none\.json"),
        ("[camera]\nport = 0\n[stage]\nrow = 'a'\n", r"stage\.col: expected a serial number"),
        (
            '[camera]\nport = 0\n[stage]\nrow = "\\u0000"\ncol = 1\n',
            r"stage\.row: expected a serial",
        ),
        ("stage = 3\n[camera]\nport = 0\n", "stage: expected a table"),
    ],
)
def test_rig_files_that_describe_none(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(text)
    with pytest.raises(DataError, match=message) as raised:
        open_rig(file)
    assert "rig.toml" in str(raised.value) or "none.json" in str(raised.value)


def test_a_rig_takes_its_travel_from_a_lens_field(tmp_path: Path) -> None:
    lens = load_lens("petzval_b")
    own = lens_field(lens, Grid((16, 64), (0.155, 0.155)))
    other = replace(own, grid=Grid((16, 64), (0.1, 0.155)))
    for name, field in (("own", own), ("other", other)):
        save_lens_field(field, tmp_path / f"{name}.nc")
    file = tmp_path / "rig.toml"
    camera = "[camera]\nport = 0\npitch_mm = 0.155\n"
    for name, message in (("own", r"stage\.row"), ("other", "with --pitch-mm 0.155,0.155")):
        file.write_text(f"{camera}[calibration]\nlens_field = '{name}.nc'\n")
        with pytest.raises(DataError, match=message):  # the first is right but for the stage
            open_rig(file)
    nominal = nominal_calibration(own.px_per_unit, optics=own.optics)
    mm = decenter_for_shift(lens, 0, [0.1, -0.2], own.grid)
    np.testing.assert_allclose(nominal.offset_px(nominal.rest_mm + mm), [0.1, -0.2], atol=1e-4)
    device: Any = SimpleNamespace(name="", describe=dict, grid=own.grid, modulation_hz=None)
    taken = {"frames": 1, "average": False}
    header = capture_header(device, device, np.zeros((1, 2)), nominal, taken, "square")
    assert header["meta"]["optics"] == own.optics


def test_a_rig_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        open_rig(tmp_path / "none.toml")


@pytest.mark.parametrize(
    "arguments", [("stage",), ("stage", "--link", "pty"), ("pcic", "--port", 0), ("o3m",), ("rig",)]
)
def test_devices_are_emulated_until_told(call: Call, arguments: tuple[object, ...]) -> None:
    port = ("--port", free_udp_port()) if arguments[0] in ("o3m", "rig") else ()
    done = call("emulate", *arguments, *port, "--seconds", 0.3, "--json")
    assert done.exit_code == 0, done.output
    ready, result = done.stdout.split("\n", 1)  # a script waits for the first line
    said = json.loads(ready)
    assert said.get("stage") or said["camera_port"]
    assert json.loads(result).items() >= said.items()


def test_emulated_links_that_do_not_exist(call: Call) -> None:
    assert call("emulate", "stage", "--link", "wire").exit_code == 2


def test_reconstruct_takes_shifts_and_blur_of_a_calibration(call: Call, tmp_path: Path) -> None:
    stage_mm = 3.0 + np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.1]])
    frames = np.random.default_rng(0).random((4, 7, 9))
    burst = Burst.from_arrays(frames, offset_px=np.zeros((4, 2)), pitch_mm=0.1, stage_mm=stage_mm)
    save_burst(burst, tmp_path / "burst.nc")
    calibration = Calibration(
        StageMap(5.0 * np.eye(2)), np.array([3.0, 3.0]), source="measured", psf_sigma_px=0.21
    )
    save_calibration(calibration, tmp_path / "rig.json")
    shifted = replace(burst, offset_px=5.0 * (stage_mm - 3.0), offset_source="calibrated")
    save_burst(shifted, tmp_path / "told.nc")
    options = ("--method", "tikhonov", "--prior-weight", 0.01, "-o")
    done = call(
        "reconstruct", tmp_path / "burst.nc", "--calibration", tmp_path / "rig.json",
        *options, tmp_path / "a.nc",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "offsets calibrated" in done.stdout
    for width_px, name in ((0.21, "b.nc"), (0.4, "c.nc")):
        done = call(
            "reconstruct", tmp_path / "told.nc", "--psf-sigma-px", width_px,
            *options, tmp_path / name,
        )  # fmt: skip
        assert done.exit_code == 0, done.output
    images = []
    for name in ("a.nc", "b.nc", "c.nc"):
        estimate = load_reconstruction(tmp_path / name).amplitude
        assert estimate is not None
        images.append(estimate.image)
    np.testing.assert_allclose(images[0], images[1])
    assert np.abs(images[0] - images[2]).max() > 0.01
