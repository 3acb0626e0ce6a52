"""What holds for every verb: help, version, exit codes, start-up, progress."""

import os
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Callable
from multiprocessing import forkserver
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from stand_in import Call

from lensshift import Burst, DataError, load_image_stack, save_burst
from lensshift.cli import _one_line, main, session
from lensshift.cli.reconstruct import _WIDTH_SOURCES
from lensshift.cli.session import Progress, StatusLine
from lensshift.core.processes import ready_with
from lensshift.core.settings import to_json
from lensshift.io import memory_limit
from lensshift.reconstruction.pixel_response import WidthSource

VERBS = [["run"], ["reconstruct"], ["convert"], ["info"], ["evaluate", "fidelity"], ["live"]]
COMMAND = [sys.executable, "-c", "from lensshift.cli import main; main()"]


def process(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = COMMAND + [str(argument) for argument in arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


Ran = Callable[..., tuple[object, str, str]]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ran:
    """Return a function that calls `main` in this process: exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[object, str, str]:
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["lensshift", *map(str, arguments)])
            patch.setattr(sys, "excepthook", sys.excepthook)
            patch.setattr(sys, "stdout", sys.stdout)
            patch.setattr(sys, "stderr", sys.stderr)
            with pytest.raises(SystemExit) as ended:
                main()
        return ended.value.code, *capsys.readouterr()

    return run


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_help_has_an_example_and_the_common_options(call: Call, verb: list[str]) -> None:
    done = call(*verb, "--help")
    assert done.exit_code == 0
    assert f"  lensshift {' '.join(verb)} " in done.stdout
    for option in ("--json", "--debug"):
        assert option in done.stdout


def test_top_level_help_and_version(call: Call) -> None:
    assert "lensshift reconstruct burst.nc" in call("--help").stdout
    assert "lensshift evaluate fidelity" in call("evaluate", "--help").stdout
    assert call("--version").stdout.startswith("lensshift 0.")
    assert call().exit_code == 2
    assert call("nonsense").exit_code == 2


def test_processes_end_with_the_right_code(tmp_path: Path) -> None:
    wrong = process("info")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "Missing argument" in wrong.stderr
    failed = process("info", tmp_path / "none.nc")
    assert failed.returncode == 1
    assert failed.stderr == f"error: {tmp_path / 'none.nc'}: there is no such file\n"


def test_no_escape_of_anybody_reaches_a_terminal(ran: Ran, tmp_path: Path) -> None:
    """A name or a note may hold what sets titles, clears the screen, or hides text."""
    evil = "\x1b]0;title\x07\x9b2J\u202e"
    burst = Burst.from_arrays(np.ones((1, 3, 5)), pitch_mm=0.1, meta={evil: {"note": evil}})
    save_burst(burst, tmp_path / f"a{evil}.nc")
    _, told, _ = ran("info", tmp_path / f"a{evil}.nc")
    assert "\\x1b]0;title\\x07" in told
    for words in (
        ["info", tmp_path / f"none{evil}.nc"],
        ["info", tmp_path / f"a{evil}.nc", f"--no{evil}"],
        ["convert", tmp_path / f"a{evil}.nc", "-o", tmp_path / f"no{evil}" / "a.npz"],
    ):
        code, *failed = ran(*words)
        assert code
        for text in (told, *failed):
            assert not set(text) & set("\x1b\x07\x9b\u202e")


def test_memory_of_a_file_is_bounded_and_the_bound_can_be_set(
    ran: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with zipfile.ZipFile(tmp_path / "large.npz", "w") as container:
        with container.open("amplitude.npy", "w") as member:
            np.lib.format.write_array(member, np.zeros((1, 5, 7)))
        container.getinfo("amplitude.npy").file_size = 288_000_000  # is all that it says
    code, out, said = ran("info", tmp_path / "large.npz")
    assert (code, out) == (1, "")
    assert "got 288000000; if you trust it, allow more (lensshift --max-memory" in said
    np.save(tmp_path / "a.npy", np.zeros((4, 300, 300)))
    assert ran("info", tmp_path / "a.npy")[0] == 0
    *_, said = ran("--max-memory", "0.001", "info", tmp_path / "a.npy")
    assert "expected at most 1073742 bytes of memory" in said
    assert ran("info", tmp_path / "a.npy")[0] == 0  # the bound was of that call alone
    file = tmp_path / "a.npz"
    np.savez_compressed(file, amplitude=np.zeros((1, 600, 600)), offset_px=np.zeros((1, 2)))
    monkeypatch.setattr("lensshift.io.reading._ALWAYS_UNPACKED_BYTES", 2**21)
    with pytest.raises(DataError, match="got 2880"):
        load_image_stack(file)
    with memory_limit(2**30):
        assert load_image_stack(file).grid.shape == (600, 600)
    with pytest.raises(ValueError, match="positive number of bytes"), memory_limit(0):
        pass


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom typer.testing import CliRunner\nfrom lensshift.cli.app import app\n"
        "CliRunner().invoke(app, ['reconstruct', '--help'])\n"
        "heavy = ('scipy', 'numba', 'h5py', 'h5netcdf', 'skimage', 'PIL', 'tifffile', 'rich')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


INTERRUPTED = """
import signal, time
import lensshift
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under nohup
def slow(*arguments, **options):
    print("started", flush=True)
    time.sleep(600)
lensshift.reconstruct = slow
from lensshift.cli import main
main()
"""


def test_ctrl_c_leaves_nothing(burst_file: Path) -> None:
    command = [sys.executable, "-c", INTERRUPTED, "reconstruct", str(burst_file)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        lines = iter(running.stdout.readline, "")  # "" is the end: the process has stopped
        assert any("started" in line for line in lines)
        os.kill(running.pid, signal.SIGINT)
        _, errors = running.communicate(timeout=300)
    assert running.returncode == 130
    assert errors == "interrupted\n"
    assert [path.name for path in burst_file.parent.iterdir()] == ["burst.nc"]


HALF_DONE = """
import io, signal, zipfile
from lensshift.cli.session import session

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under nohup
with session(as_json=False, debug=False):
    with zipfile.ZipFile(io.BytesIO(), "w") as file:  # as NPZ files are written
        entry = file.open("frame", "w")
        signal.raise_signal(signal.%s)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_what_is_left_half_done_does_not_hide_the_interruption(name: str) -> None:
    """A ZIP file that is being written cannot be closed, and says so instead of the signal."""
    command = [sys.executable, "-c", HALF_DONE % name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "error:" not in done.stderr
    if name == "SIGINT":
        assert done.stderr.startswith("interrupted\n")
        assert "Exit: 130" in done.stderr  # which the command line turns into its status
    else:
        assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, "")


@pytest.mark.parametrize("options", [[], ["--json"]], ids=str)
def test_who_reads_the_first_lines_only_gets_the_files_all_the_same(
    burst_file: Path, options: list[str]
) -> None:
    target = burst_file.with_suffix(".npz")
    verb = ["convert", str(burst_file), str(target), *options]
    with subprocess.Popen(
        [sys.executable, "-m", "lensshift", *verb], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as running:
        assert running.stdout is not None
        running.stdout.close()
        assert running.stderr is not None
        errors = running.stderr.read()
    assert (running.returncode, errors) == (0, b"")
    assert target.stat().st_size > 0


def test_unexpected_error_is_one_line_too(capsys: pytest.CaptureFixture[str]) -> None:
    _one_line(KeyError, KeyError("a\nb"), None)
    written = capsys.readouterr().err
    assert written.startswith("error: this should not happen (KeyError: ")
    assert written.count("\n") == 1
    with pytest.raises(SystemExit) as caught:
        _one_line(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert caught.value.code == 130


INTERRUPTED_EARLY = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under nohup
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "lensshift.cli.app":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
from lensshift.cli import main
main()
"""


def test_ctrl_c_while_modules_are_loaded_shows_no_traceback() -> None:
    command = [sys.executable, "-c", INTERRUPTED_EARLY, "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_the_server_of_processes_leaves_ctrl_c_to_this_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    met: list[object] = []
    monkeypatch.setattr(
        forkserver, "ensure_running", lambda: met.append(signal.getsignal(signal.SIGINT))
    )
    before = signal.getsignal(signal.SIGINT)
    ready_with("lensshift.core.units")
    assert met == [signal.SIG_IGN]  # which the server inherits, and its processes from it
    assert signal.getsignal(signal.SIGINT) is before


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_what_takes_long_before_the_first_iteration_is_said(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "_QUIET_S", 0.05)
    quick = Progress("reconstructing", preparing=True)
    quick(1, 0.5)
    slow = Progress("reconstructing", preparing=True)
    for one in threading.enumerate():
        if isinstance(one, threading.Timer):
            one.join(10.0)
    slow.close()
    said = capsys.readouterr().err
    assert said.count("preparing (only the first call after an installation compiles)") == 1


def test_every_source_of_a_width_has_words() -> None:
    assert set(_WIDTH_SOURCES) == set(get_args(WidthSource))


@pytest.mark.parametrize(("terminal", "lines"), [(False, 3), (True, 12)])
def test_progress_speaks_after_a_second_and_not_too_often(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, terminal: bool, lines: int
) -> None:
    clock = Clock()
    monkeypatch.setattr(time, "monotonic", clock)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    progress = Progress("working")
    for step in range(100):
        clock.now_s = step * 0.01
        progress(step, 1.0)
    assert capsys.readouterr().err == ""
    for step in range(12):
        clock.now_s = 1.0 + step
        progress(step, 1.0 / (step + 1))
    progress.close()
    written = capsys.readouterr().err
    assert written.count("working: iteration") == lines
    assert written.endswith("\n")
    assert ("\r" in written) is terminal


def test_a_status_stays_on_a_line_of_a_narrow_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "40")
    line = StatusLine()
    line.show("reconstructing with auto: " + "preparing " * 9)
    line.show("done")
    first, second = capsys.readouterr().err.split("\r")[1:]
    assert len(first) == len(second) == 39  # the last column would begin a new line
    assert first.endswith("...")


def test_json_knows_no_nan_and_no_numpy() -> None:
    value = {
        "a": np.float64("nan"), "b": np.arange(2), "c": (Path("x"), True, None),
        "d": float("inf"), 3: {1}, "e": np.bool_(True),
    }  # fmt: skip
    text = " ".join(to_json(value).split())
    assert text == (
        '{ "a": null, "b": [ 0, 1 ], "c": [ "x", true, null ], "d": null, "3": "{1}", "e": true }'
    )


def test_session_lets_other_warnings_through(capsys: pytest.CaptureFixture[str]) -> None:
    current = session.Session()
    current.warn("a\n b", RuntimeWarning, "file", 1)
    current.warn("a b", RuntimeWarning, "file", 1)
    assert current.warnings == ["a b"]
    assert capsys.readouterr().err == "warning: a b\n"
