"""`lensshift live` from the command line."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from serving import taken, until
from typer.testing import CliRunner, Result

from lensshift.cli.app import app
from lensshift.io import save_burst

pytestmark = pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")
pytest.importorskip("uvicorn", reason="the extra live is not installed")


def called(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["live", "--no-open", *(str(one) for one in arguments)])


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((), "expected one of --rig, --replay and --simulate"),
        (("--rig", "emulated", "--simulate", "four_boxes"), "expected one of"),
        (("--replay", "nowhere.nc"), "there is no nowhere.nc"),
        (("--simulate", "four_boxes", "--host", "0.0.0.0"), "--allow-remote"),
        (("--simulate", "four_boxes", "--pattern", "circle"), "expected a plan of"),
    ],
)
def test_usage_errors(arguments: tuple[str, ...], problem: str) -> None:
    result = called(*arguments)
    assert result.exit_code == 2
    # The message is framed and broken to lines where the terminal is narrow.
    assert problem.split()[0] in result.stderr


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--rig", "nowhere.toml"), "nowhere.toml"),
        (("--simulate", "nowhere.toml"), "nowhere.toml"),
        (("--simulate", "four_boxes", "--method", "magic"), "magic"),
    ],
)
def test_errors_are_one_line(arguments: tuple[str, ...], problem: str) -> None:
    result = called(*arguments)
    assert result.exit_code == 1
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert problem in line


def started(*arguments: object) -> subprocess.Popen[str]:
    code = "from lensshift.cli import main; main()"
    words = [sys.executable, "-c", code, "live", "--no-open", "--port", "0", *map(str, arguments)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def has_a_picture(address: str) -> None:
    def directions() -> bool:
        try:
            with urllib.request.urlopen(f"{address}directions", timeout=30):
                return True
        except urllib.error.HTTPError as error:  # 409: no picture yet
            error.close()
            return False

    until(directions)


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is sent as a signal")
def test_ctrl_c_ends_it_and_says_what_was_done(tmp_path: Path) -> None:
    save_burst(taken(), tmp_path / "burst.nc")
    process = started("--replay", tmp_path / "burst.nc", "--method", "bicubic", "--json")
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    assert ready["address"].startswith("http://127.0.0.1:")
    has_a_picture(ready["address"])
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    result = json.loads(out)
    assert result["frames"] >= result["pictures"] > 0


def test_it_ends_by_itself(tmp_path: Path) -> None:
    save_burst(taken(), tmp_path / "burst.nc")
    done = called("--replay", tmp_path / "burst.nc", "--method", "bicubic", "--port", 0,
                  "--seconds", 0.1)  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "pictures" in done.stdout


def test_a_recording_without_frames_is_a_failure(tmp_path: Path) -> None:
    (tmp_path / "none.pcap").write_bytes(b"\xd4\xc3\xb2\xa1" + bytes(20))
    done = called("--replay", tmp_path / "none.pcap", "--port", 0, "--seconds", 1)
    assert done.exit_code == 1
    assert "the recording has ended after 0 frames: it holds no UDP datagrams" in done.stderr


FORSAKEN = """
from multiprocessing import Pipe
from lensshift.live.emulated import _emulate

ours, theirs = Pipe()
ours.close()
_emulate(theirs)
"""


def test_emulated_devices_that_nobody_waits_for_any_more_end_without_a_word() -> None:
    """As after Ctrl-C while they start."""
    done = subprocess.run([sys.executable, "-c", FORSAKEN], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_the_emulated_lens_goes_back_to_rest() -> None:
    from lensshift.live.emulated import emulated_rig
    from lensshift.live.picture import Settings
    from lensshift.live.sources import RigSource
    from lensshift.live.worker import Live

    with emulated_rig() as rig:
        source = RigSource(rig)
        with pytest.raises(ValueError, match="expected a plan"):
            source.choose("circle")
        with Live(source, Settings(2, "bicubic")) as live:
            end_s = time.monotonic() + 60
            while (live.picture is None or live.picture.number < 8) and time.monotonic() < end_s:
                time.sleep(0.02)
            source.choose("quincunx")
            while live.picture is not None and live.picture.shot.plan.frame_count != 2:
                assert time.monotonic() < end_s
                time.sleep(0.02)
        assert not live.problem
        assert live.picture is not None
        assert live.picture.result.intrinsics is not None
        rest_mm = rig.calibration.rest_mm
        np.testing.assert_allclose(rig.stage.position_mm(), rest_mm, atol=0.006)
