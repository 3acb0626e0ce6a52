"""What happens at the bench: each fault stops the stage, says what happened, loses no frame.

Real drivers over real sockets; only the devices are emulated.
"""

import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensshift import load_burst
from lensshift.capture.acquire import Acquisition, Progress
from lensshift.capture.emulators.apt import EmulatedStagePair
from lensshift.capture.emulators.listener import free_udp_port
from lensshift.capture.emulators.o3m import O3MSender
from lensshift.capture.emulators.rig import EmulatedRig
from lensshift.capture.opening import Rig, open_rig
from lensshift.core.errors import DataError, DeviceError, DeviceTimeout
from lensshift.core.types import Frame

SHAPE = (16, 64)
PLAN = "3x3"


def look(begin_s: float, end_s: float) -> Frame:
    return Frame(np.full(SHAPE, 0.5), np.full(SHAPE, 2.0), np.ones(SHAPE, dtype=bool), end_s)


class Bench:
    """Emulated devices and the rig file that opens them."""

    def __init__(self, folder: Path) -> None:
        self.port = free_udp_port()
        self.stages = EmulatedStagePair(play_mm=0.006, speed=20.0)
        self.camera = O3MSender(look, port=self.port, rate_hz=40.0)
        self.file = folder / "rig.toml"
        self.out = folder / "burst.nc"

    def start(self) -> None:
        row, col = self.stages.urls
        self.file.write_text(
            f'[stage]\nrow = "{row}"\ncol = "{col}"\nenable_wait_s = 0.05\nreply_timeout_s = 0.5\n'
            'home = "if_needed"\n'
            "timeout_margin_s = 20.0\n"  # a busy computer may stand still for seconds
            f'[camera]\nport = {self.port}\nhost = "127.0.0.1"\n'
            "[acquisition]\nframe_timeout_s = 20.0\n"
        )

    def open(self) -> Rig:
        return open_rig(self.file)

    def still(self) -> bool:
        before = self.stages.lens_mm()
        time.sleep(0.1)
        return bool(np.array_equal(before, self.stages.lens_mm()))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    with made.stages, made.camera:
        made.start()
        yield made


def after(step: int, fault: Callable[[], None]) -> Callable[[Progress], None]:
    def note(now: Progress) -> None:
        if now.step == step:
            fault()

    return note


def test_the_burst_of_an_undisturbed_bench(bench: Bench) -> None:
    with bench.open() as rig:
        burst = rig.capture("square", bench.out)
        assert burst.frame_count == 4
    np.testing.assert_allclose(burst.amplitude, 0.5, rtol=1e-3)
    np.testing.assert_allclose(burst.stage_mm, burst.stage_commanded_mm, atol=2e-3)
    assert bench.still()
    np.testing.assert_allclose(bench.stages.lens_mm(), 3.0, atol=0.007)  # at rest, but for the play
    assert "distance_cm" in burst.raw
    assert burst.meta["stage"]["row"]["counts_per_mm"] == 34554.96


def test_the_emulated_rig_opens_at_the_speed_of_real_stages() -> None:
    """As `lensshift emulate rig` has it: its controllers hang if they are sent home too soon.

    How fast they go home is another matter.
    """
    with EmulatedRig(camera_port=free_udp_port()) as emulated:
        table = tomllib.loads(emulated.rig_file())
        table["stage"] |= {"home_velocity_mmps": 20.0, "acceleration_mmps2": 400.0}
        with open_rig(table) as rig:
            np.testing.assert_allclose(rig.stage.position_mm(), 0.0, atol=0.01)


def resumed(bench: Bench) -> None:
    with bench.open() as rig:
        assert rig.capture(PLAN, bench.out, resume=True).frame_count == 9
    assert load_burst(bench.out).frame_count == 9


def test_a_silent_camera(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    with bench.open() as rig:
        next_frame = rig.camera.next_frame

        def pause() -> None:  # before, a busy computer may stand still for seconds
            bench.camera.pause()
            monkeypatch.setattr(rig.camera, "next_frame", lambda _: next_frame(0.5))

        with pytest.raises(DeviceTimeout, match="nothing arrives any more"):
            rig.capture(PLAN, bench.out, on_step=after(4, pause))
    assert bench.still()
    assert load_burst(bench.out).frame_count >= 4
    bench.camera.resume()
    resumed(bench)


def test_a_camera_that_starts_anew(bench: Bench) -> None:
    with bench.open() as rig, pytest.raises(DeviceError, match="started anew"):
        rig.capture(PLAN, bench.out, on_step=after(4, bench.camera.reboot))
    assert bench.still()
    resumed(bench)


def test_a_stage_with_a_motion_error(bench: Bench) -> None:
    controller = bench.stages.controllers[1]
    with bench.open() as rig, pytest.raises(DeviceError, match="motion error") as raised:
        rig.capture(PLAN, bench.out, on_step=after(3, controller.fail_motion))
    assert raised.value.position_mm is not None
    assert bench.still()
    assert load_burst(bench.out).frame_count == 3


def test_a_pulled_cable(bench: Bench) -> None:
    with bench.open() as rig, pytest.raises(DeviceError, match="connection lost"):
        rig.capture(PLAN, bench.out, on_step=after(5, bench.stages.controllers[0].unplug))
    assert bench.still()
    assert load_burst(bench.out).frame_count == 5
    with EmulatedStagePair(speed=20.0) as bench.stages:  # plugged in again, power was lost
        bench.start()
        resumed(bench)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on file sizes there")
def test_a_full_disk(bench: Bench) -> None:
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def fill() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (bench.out.stat().st_size + 100, hard))

    try:
        with bench.open() as rig, pytest.raises(DataError, match="frames before are kept"):
            rig.capture(PLAN, bench.out, on_step=after(4, fill))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert bench.still()
    assert load_burst(bench.out).frame_count == 4
    np.testing.assert_allclose(bench.stages.lens_mm(), 3.0, atol=0.007)
    resumed(bench)


def test_a_second_process_at_the_same_file(bench: Bench) -> None:
    refused: list[str] = []

    def intrude() -> None:
        program = (
            "import sys\n"
            "from lensshift import load_burst\n"
            "from lensshift.io.capture_file import CaptureWriter\n"
            "print(load_burst(sys.argv[1]).frame_count)\n"
            "CaptureWriter.resume(sys.argv[1])\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", program, str(bench.out)],
            capture_output=True,
            text=True,
            check=False,
        )
        refused.append(done.stdout + done.stderr)

    with bench.open() as rig:
        rig.capture("square", bench.out, on_step=after(2, intrude))
    assert refused[0].startswith("2")
    assert "another process is writing this file" in refused[0]


def capturing(bench: Bench, **options: Any) -> subprocess.Popen[bytes]:
    """Start a capture in another process; return it when it has taken three positions."""
    command = [sys.executable, "-c", "from lensshift.cli import main; main()", "capture"]
    process = subprocess.Popen(
        [*command, str(bench.file), "--plan", PLAN, "-o", str(bench.out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        **options,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(b"position 3 "):
            break
    return process


def ended(process: subprocess.Popen[bytes]) -> int:
    code = process.wait(60.0)
    assert process.stderr is not None
    process.stderr.close()
    return code


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
def test_a_kill_at_any_moment(bench: Bench) -> None:
    """The program dies in mid-scan; a new one takes the missing frames."""
    process = capturing(bench)
    process.kill()
    ended(process)
    done = load_burst(bench.out).frame_count
    assert 3 <= done < 9
    resumed(bench)


@pytest.mark.skipif(os.name == "nt", reason="no such signals there")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_whoever_ends_it_the_lens_comes_back(bench: Bench, name: str) -> None:
    process = capturing(bench)
    for _ in range(2):  # a shell and the system may both tell that the terminal is closed
        process.send_signal(getattr(signal, name))
    assert ended(process) == 128 + getattr(signal, name)
    assert bench.still()
    np.testing.assert_allclose(bench.stages.lens_mm(), 3.0, atol=0.007)  # at rest, but for the play
    assert 3 <= load_burst(bench.out).frame_count < 9


@pytest.mark.skipif(os.name == "nt", reason="no such terminals there")
def test_a_closed_terminal(bench: Bench) -> None:
    """The system sends SIGHUP to whatever runs in it."""
    import fcntl
    import pty
    import termios

    ours, theirs = pty.openpty()
    process = capturing(
        bench,
        stdin=theirs,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(theirs, termios.TIOCSCTTY, 0),
    )
    os.close(theirs)
    os.close(ours)
    ended(process)
    assert bench.still()
    np.testing.assert_allclose(bench.stages.lens_mm(), 3.0, atol=0.007)


def test_a_position_beyond_the_travel(bench: Bench) -> None:
    bench.file.write_text(bench.file.read_text() + "[calibration]\nrest_mm = [3.0, 5.99]\n")
    with bench.open() as rig, pytest.raises(ValueError, match="out of travel"):
        rig.capture(PLAN, bench.out)
    assert not bench.out.exists()


def test_an_endless_stream(bench: Bench) -> None:
    with bench.open() as rig:
        rig.acquisition = Acquisition(frames=1)
        stream = rig.bursts("square")
        first, second = next(stream), next(stream)
        stream.close()  # type: ignore[attr-defined]
    assert first.time_s is not None
    assert second.time_s is not None
    assert first.time_s.max() < second.time_s.min()
