"""The live page without a browser: what arrives, what is shown, who may ask."""

import errno
import json
import multiprocessing
import re
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from serving import QUICK, measures_for_ever, served, source_of, unpacked, until

import lensshift
from lensshift import Burst
from lensshift.capture.rig import CameraFrame
from lensshift.core.errors import DataError, DeviceError, DeviceTimeout
from lensshift.core.grid import Grid
from lensshift.core.types import Frame
from lensshift.io import load_burst, load_reconstruction
from lensshift.io.capture_file import CaptureWriter
from lensshift.live.controls import box_of, checked, control
from lensshift.live.picture import Settings, coded, message
from lensshift.live.sources import BurstSource, CameraSource, Shot, SimulatedSource
from lensshift.live.worker import Live, Mailbox

pytestmark = pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")


# --- bytes ---------------------------------------------------------------------------------------


def test_values_survive_the_way_to_the_page() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(3.0, 1.0, (5, 7))
    values[2, 3] = np.nan
    codes, low, step = coded(values)
    layer = {"name": "distance", "unit": "m", "rows": 5, "cols": 7, "low": low, "step": step}
    data = message({"number": 3, "source": "größer", "layers": [layer]}, codes.tobytes())
    assert (len(data) - codes.nbytes) % 4 == 0
    head, layers = unpacked(data)
    assert head["source"] == "größer"
    np.testing.assert_allclose(layers["distance"], values, atol=0.51 * step)


@pytest.mark.parametrize("values", [np.full((2, 3), np.nan), np.full((2, 3), 1.5)])
def test_even_and_empty_layers_survive(values: Any) -> None:
    codes, low, step = coded(values)
    back = np.where(codes > 0, low + (codes.astype(float) - 1) * step, np.nan)
    np.testing.assert_array_equal(back, values)


# --- the latest wins -----------------------------------------------------------------------------


def shot_of(source: BurstSource, place: int, number: float) -> Shot:
    one = next(iter(source.shots()))
    return Shot(one.frame, place, number, source.plan, one.offset_px)


def test_a_frame_replaces_the_one_of_its_place(burst: Burst) -> None:
    source, box = source_of(burst, np.inf), Mailbox()
    for place, number in ((0, 1.0), (1, 2.0), (0, 3.0)):
        box.put(shot_of(source, place, number))
    assert [(one.place, one.taken_s) for one in box.take(0.0)] == [(1, 2.0), (0, 3.0)]
    assert box.take(0.0) == []


def test_frames_of_another_plan_go(burst: Burst) -> None:
    box = Mailbox()
    for number in (1.0, 2.0):
        box.put(shot_of(source_of(burst, np.inf), 0, number))
    assert [one.taken_s for one in box.take(0.0)] == [2.0]


def test_a_slow_solver_slows_no_frame(burst: Burst, monkeypatch: pytest.MonkeyPatch) -> None:
    step = Live._step
    monkeypatch.setattr(Live, "_step", lambda *given: (time.sleep(0.2), step(*given))[1])
    with Live(source_of(burst, 100.0), QUICK) as live:
        until(lambda: live.picture is not None and live.picture.number >= 4)
        count, number = live.frame_count, live.picture.number  # type: ignore[union-attr]
        assert count > 3 * number
        until(lambda: live.picture is not None and live.picture.window.frame_count == 4)


# --- sources -------------------------------------------------------------------------------------


def test_a_recording_gives_what_the_stream_gives(burst: Burst) -> None:
    source = BurstSource(burst, "frames", rate_hz=np.inf, again=False)
    camera = lensshift.stream(source.plan, 2)
    for number, shot in enumerate(source.shots()):
        assert shot.place == number
        found = camera.step(shot.frame, place=shot.place)
    whole = lensshift.reconstruct(burst, 2)
    assert found.amplitude is not None
    assert whole.amplitude is not None
    np.testing.assert_allclose(found.amplitude.image, whole.amplitude.image)
    assert found.intrinsics is not None


def test_a_long_recording_goes_round_its_plan(burst: Burst) -> None:
    film = burst.select([2, 3, 0, 1] * 5)
    source = BurstSource(film, "film", rate_hz=np.inf, again=False)
    np.testing.assert_array_equal(source.plan.offset_px, burst.offset_px[[2, 3, 0, 1]])
    assert [shot.place for shot in source.shots()] == [0, 1, 2, 3] * 5


def test_frames_held_back_are_in_the_next_picture(burst: Burst) -> None:
    one_by_one, held = (lensshift.stream(burst, 2, "tikhonov") for _ in range(2))
    for place in range(3):
        one_by_one.step(burst.amplitude[place], place=place)
        held.take(burst.amplitude[place], place=place)
    images = [camera.step(burst.amplitude[3], place=3) for camera in (one_by_one, held)]
    first, second = (one.amplitude.image for one in images if one.amplitude is not None)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(held.window.amplitude, burst.amplitude)


def test_a_recording_keeps_its_plan(burst: Burst) -> None:
    with pytest.raises(ValueError, match="has its own plan"):
        source_of(burst).choose("3x3")


def test_a_simulated_camera_changes_its_plan() -> None:
    from lensshift.camera import camera_preset
    from lensshift.scene import four_boxes

    source = SimulatedSource(four_boxes(), camera_preset("o3m151"), rate_hz=1000.0)
    shots: Iterator[Shot] = source.shots()
    first, second = next(shots), next(shots)
    assert first.plan is second.plan
    assert (first.place, second.place) == (0, 1)
    assert all(shot.plan is first.plan for shot in islice(shots, 7))  # the next rounds as well
    source.choose("3x3")
    third = next(shots)
    assert third.plan.frame_count == 9
    with pytest.raises(ValueError, match="expected a plan of"):
        source.choose("circle")
    assert source.pattern == "3x3"


class PlayedCamera:
    """Stands in for a recording whose third frame is lost."""

    name, grid, modulation_hz = "recording", Grid((4, 6), (0.155, 0.155)), None

    def __init__(self) -> None:
        self._left = [0, 1, None, 3]
        self.closed = False

    def open(self) -> None:
        """Begin to play."""

    def close(self) -> None:
        self.closed = True

    def next_frame(self, timeout_s: float) -> CameraFrame:
        if not self._left:
            raise DeviceError("the recording has ended after 3 frames")
        cycle = self._left.pop(0)
        if cycle is None:
            raise DeviceTimeout("the recording has a gap here")
        frame = Frame(np.ones((4, 6)), None, np.ones((4, 6), bool), float(cycle))
        return CameraFrame(frame, cycle, time.monotonic())


def test_a_lost_frame_of_a_recording_counts_as_a_place() -> None:
    camera: Any = PlayedCamera()
    places: list[Any] = []
    with pytest.raises(DeviceError, match="has ended"):
        places.extend(shot and shot.place for shot in CameraSource(camera).shots())
    found = CameraSource(PlayedCamera()).shots()  # type: ignore[arg-type]
    assert [one and one.place for one in islice(found, 4)] == [0, 1, None, 3]
    assert camera.closed


def test_the_end_of_a_recording_is_said() -> None:
    with Live(CameraSource(PlayedCamera()), QUICK) as live:  # type: ignore[arg-type]
        until(lambda: live.ended and live.picture is not None)
        assert "has ended after 3 frames" in live.problem
        assert live.recording is None


# --- controls ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wanted", "problem"),
    [
        ({"scale": 9}, "scale from 1 to 8"),
        ({"scale": "2"}, "scale"),
        ({"method": "magic"}, "magic"),
        ({"blur_px": -0.1}, "blur from 0"),
        ({"pattern": "circle"}, "own plan"),
        ({"speed": 1}, "speed"),
        ({"record": 1}, "record"),
        ({"record": True}, "none has come"),
        ({"record": True, "pattern": "recorded"}, "ends a recording"),
    ],
)
def test_controls_refuse(
    burst: Burst, wanted: dict[str, Any], problem: str, tmp_path: Path
) -> None:
    live = Live(source_of(burst), QUICK)
    with pytest.raises(ValueError, match=problem):
        control(live, wanted, tmp_path)
    assert live.settings == QUICK
    assert live.recording is None
    assert not list(tmp_path.iterdir())


def test_controls_take_effect(burst: Burst, tmp_path: Path) -> None:
    with Live(source_of(burst), QUICK) as live:
        control(live, {"scale": 3, "method": "nearest", "blur_px": None}, tmp_path)
        until(lambda: live.picture is not None and live.picture.result.scale == 3)
        assert live.picture is not None
        assert live.picture.result.method == "nearest"


def test_a_setting_that_fails_is_said_and_can_be_undone(
    burst: Burst, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise ValueError("too fine")

    with Live(source_of(burst), QUICK) as live:
        until(lambda: live.picture)
        with monkeypatch.context() as patch:
            patch.setattr("lensshift.live.worker.stream", fail)
            live.settings = Settings(3, "bicubic")
            until(lambda: live.problem == "too fine")
        until(lambda: live.picture is not None and live.picture.result.scale == 3)
        until(lambda: not live.problem)


def test_a_warning_stands_for_a_while(burst: Burst, monkeypatch: pytest.MonkeyPatch) -> None:
    live = Live(source_of(burst), QUICK)
    assert live.warning == ""
    live.warn("something\n moves")
    assert live.warning == "something moves"
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 6.0)
    assert live.warning == ""


@pytest.mark.parametrize("box", [None, [0, 1, 2], [0, 0, 0, 4], [0, 99, 0, 4], [0, 4, 0.5, 4]])
def test_boxes_outside_the_picture_are_refused(box: Any) -> None:
    with pytest.raises(ValueError, match="expected a box"):
        box_of(box, (10, 20))


def test_settings_of_the_command_line_are_checked_alike() -> None:
    with pytest.raises(ValueError, match="scale"):
        checked(Settings(scale=0))


# --- keeping -------------------------------------------------------------------------------------


def test_what_is_recorded_can_be_replayed(burst: Burst, tmp_path: Path) -> None:
    with Live(source_of(burst), QUICK) as live:
        until(lambda: live.picture is not None and live.picture.window.frame_count == 4)
        control(live, {"record": True}, tmp_path)
        until(lambda: live.recording is not None and live.recording.count >= 6)
        growing = load_burst(tmp_path / "recording-0001.nc")
        assert growing.frame_count >= 6
        control(live, {"record": False}, tmp_path)
    kept = load_burst(tmp_path / "recording-0001.nc")
    assert kept.intrinsics is not None
    again = BurstSource(kept, "recording", rate_hz=np.inf, again=False)
    np.testing.assert_array_equal(again.plan.offset_px, burst.offset_px)
    for shot in again.shots():
        np.testing.assert_array_equal(shot.frame.amplitude, burst.amplitude[shot.place])


def test_what_a_simulated_camera_shows_is_recorded_round_after_round(tmp_path: Path) -> None:
    """Also when its pattern has just changed, and the picture is of the one before."""
    from lensshift.camera import camera_preset
    from lensshift.scene import four_boxes

    source = SimulatedSource(four_boxes(), camera_preset("o3m151"), rate_hz=1000.0)
    with Live(source, QUICK) as live:
        until(lambda: live.picture is not None and live.picture.window.frame_count == 4)
        for number, (pattern, places) in enumerate((("square", 4), ("quincunx", 2)), 1):
            if pattern != source.pattern:
                control(live, {"pattern": pattern}, tmp_path)
            control(live, {"record": True}, tmp_path)
            until(lambda: live.recording is not None and live.recording.count >= 12)
            control(live, {"record": False}, tmp_path)
            kept = load_burst(tmp_path / f"recording-{number:04d}.nc")
            assert kept.frame_count >= 12
            assert kept.meta["plan"] == pattern
            assert len(np.unique(kept.offset_px, axis=0)) == places


def test_a_recording_is_read_in_parts_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where nothing is seen for longer than a part, at its beginning and its end."""
    from lensshift.live import recording

    rng, dark = np.random.default_rng(5), [*range(4), *range(9, 20), 31]
    plan = BurstSource(Burst.from_arrays(np.ones((4, 3, 5)), offset_px=np.eye(4, 2)), "b").plan
    made, sizes = recording.Recording(tmp_path, plan, "recorded"), []
    amplitude, offset_px = rng.random((32, 3, 5)), rng.random((32, 2))
    for number, image in enumerate(amplitude):
        seen = np.full((3, 5), number not in dark)
        frame = Frame(image, 2.0 * image, seen, 0.1 * number)
        made.append(Shot(frame, number % 4, 0.0, plan, offset_px[number]))
    whole = recording.burst_of_capture
    monkeypatch.setattr(recording, "_TOGETHER", 3)
    monkeypatch.setattr(
        recording, "burst_of_capture", lambda *told: (sizes.append(len(told[1])), whole(*told))[1]
    )
    made.close()
    kept = load_burst(made.path)
    np.testing.assert_array_equal(kept.amplitude, amplitude)
    np.testing.assert_array_equal(kept.distance_m, 2.0 * amplitude)
    np.testing.assert_array_equal(kept.offset_px, offset_px)
    np.testing.assert_array_equal(kept.time_s, 0.1 * np.arange(32))
    np.testing.assert_array_equal(np.flatnonzero(~kept.valid.any(axis=(1, 2))), dark)
    assert kept.meta["step"] == [n % 4 for n in range(32)]
    assert sum(sizes) == 32
    assert max(sizes) < 18
    assert [one.name for one in tmp_path.iterdir()] == [made.path.name]


def test_a_full_disk_ends_the_recording_and_no_frame(
    burst: Burst, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with Live(source_of(burst, 100.0), QUICK) as live:
        until(lambda: live.picture is not None)
        control(live, {"record": True}, tmp_path)
        until(lambda: live.recording is not None and live.recording.count >= 70)
        with monkeypatch.context() as patched:
            patched.setattr(CaptureWriter, "_put", full)
            until(lambda: live.problem)
        told = re.search(
            "recording has ended: .*No space left.* the (.*) frames before", live.problem
        )
        assert told is not None
        frames = live.frame_count
        until(lambda: live.frame_count > frames + 2)
        assert not live.ended
        kept = load_burst(tmp_path / "recording-0001.nc").frame_count
        assert kept == int(told[1]) >= 70
        control(live, {"record": True}, tmp_path)
        assert not live.problem


def test_whatever_ends_a_source_is_said(burst: Burst) -> None:
    class Leaving(BurstSource):
        def shots(self) -> Iterator[Shot]:
            yield next(super().shots())
            sys.exit("the SDK has left")

    with Live(Leaving(burst, "frames"), QUICK) as live:
        until(lambda: live.ended)
        assert live.problem == "the SDK has left"


def test_a_recording_without_a_frame_leaves_nothing(burst: Burst, tmp_path: Path) -> None:
    from lensshift.live.recording import Recording

    Recording(tmp_path, source_of(burst).plan, "square").close()
    assert list(tmp_path.iterdir()) == []


# --- the server ----------------------------------------------------------------------------------


def status(address: str, content: bytes | None = None, **headers: str) -> int:
    request = urllib.request.Request(address, content, headers)
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        error.close()
        return error.code


def posted(address: str, content: Any) -> dict[str, Any]:
    request = urllib.request.Request(address, json.dumps(content).encode())
    with urllib.request.urlopen(request, timeout=120) as answer:
        return dict(json.load(answer))


def test_only_the_whole_address_opens_the_page(burst: Burst, tmp_path: Path) -> None:
    with served(source_of(burst), tmp_path) as (address, live):
        host = address.split("/")[2]
        assert status(address) == 200
        assert status(f"http://{host}/") == 403
        assert status(f"http://{host}/guess/") == 403
        assert status(address, Host="evil.example") == 403
        assert status(f"{address}control", b'{"scale": 3}', Origin="http://evil.example") == 403
        assert live.settings.scale == 2
        assert status(f"{address}control", b'{"scale": 3}', Origin=f"http://{host}") == 200
        assert live.settings.scale == 3
        assert status(f"{address}control", b'{"scale": 9}') == 400
        assert status(f"{address}control", b"[]") == 400
        with urllib.request.urlopen(address, timeout=30) as answer:
            assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            assert answer.headers["Referrer-Policy"] == "no-referrer"


def test_a_socket_needs_token_and_origin(burst: Burst, tmp_path: Path) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    with served(source_of(burst), tmp_path) as (address, _):
        socket = address.replace("http", "ws") + "pictures"
        for wrong, origin in (
            (socket.replace("/pictures", "x/pictures"), None),
            (socket, "http://a.b"),
        ):
            with pytest.raises(InvalidStatus), connect(wrong, origin=origin):  # type: ignore[arg-type]
                pass


def test_a_socket_that_does_not_ask_slows_nobody(burst: Burst, tmp_path: Path) -> None:
    from websockets.sync.client import connect

    with served(source_of(burst), tmp_path) as (address, live):
        until(lambda: live.picture is not None)
        socket = address.replace("http", "ws") + "pictures"
        with connect(socket, max_size=None) as asking, connect(socket) as silent:
            silent.send("next")
            asking.send("next")
            head, layers = unpacked(asking.recv(timeout=60))  # type: ignore[arg-type]
            assert layers["amplitude"].shape == (24, 32)
            assert layers["one.amplitude"].shape == (12, 16)
            assert head["numbers"]["frames_hz"] >= 0
            assert 0 <= head["age_s"] < 30
            frames, pictures = live.frame_count, live.solved
            begin_s = time.monotonic()
            until(lambda: live.frame_count > frames + 20)
            assert time.monotonic() - begin_s < 10
            assert pictures.per_s() > 0
            number = head["number"] + 2
            until(lambda: live.picture is not None and live.picture.number >= number)
            asking.send("next")
            later, _ = unpacked(asking.recv(timeout=60))  # type: ignore[arg-type]
            assert later["number"] >= number  # the latest, not the next one


def test_the_server_measures_edges_and_saves(burst: Burst, tmp_path: Path) -> None:
    once = BurstSource(burst, "frames", again=False)  # nothing else is computed afterwards
    with served(once, tmp_path) as (address, live):
        until(lambda: live.picture is not None and live.picture.window.frame_count == 4)
        found = posted(f"{address}edge", {"box": [0, 24, 0, 32]})
        assert found["nyquist"]["fine_lpmm"] == pytest.approx(2 * found["nyquist"]["one_lpmm"])
        assert {"why", "modulation"} & set(found["fine"])
        assert status(f"{address}edge", b'{"box": [0, 99, 0, 1]}') == 400
        names = posted(f"{address}snapshot", {})["files"]
        assert names == ["snapshot-0001.nc", "snapshot-0001-frames.nc", "snapshot-0001.png"]
        assert load_reconstruction(tmp_path / names[0]).scale == 2
        assert load_burst(tmp_path / names[1]).frame_count == 4
        with urllib.request.urlopen(f"{address}directions", timeout=30) as answer:
            looks = np.frombuffer(answer.read(), "<f4").reshape(24, 32, 3)
        np.testing.assert_allclose(np.linalg.norm(looks, axis=-1), 1.0, rtol=1e-6)


def test_measured_numbers_are_right() -> None:
    from lensshift.camera import Sensor, simulate_burst
    from lensshift.core.grid import Grid
    from lensshift.live.measure import edge_curve, shift_error
    from lensshift.scene import demo_target

    grid = Grid((32, 48), (0.155, 0.155))
    told_px = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)])
    wrong_px = told_px + np.array([(0.1, 0.0), (-0.1, 0.0), (0.1, 0.0), (-0.1, 0.0)])
    taken, _ = simulate_burst(demo_target((4.96, 7.44)), Sensor(grid), wrong_px, seed=1)
    planned = Burst.from_arrays(taken.amplitude, offset_px=told_px, pitch_mm=0.155)
    assert shift_error(planned)["rms_px"] == pytest.approx(0.1 / np.sqrt(2), abs=0.02)
    assert "expected" in edge_curve(np.ones((20, 20)), 0.155, 1, (0, 20, 0, 20), 5.0)["why"]


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from lensshift.live.serve import require_web

    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(ImportError, match=r"pip install 'lensshift\[live\]'"):
        require_web()


def test_a_port_that_is_taken_is_said() -> None:
    from lensshift.live.serve import is_loopback, listening

    with listening("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(OSError, match="--port 0 takes a free one"):
            listening("127.0.0.1", port)
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("example.org")


def test_numbered_files_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lensshift.live.recording import unused

    monkeypatch.setattr(Path, "exists", lambda _: True)
    with pytest.raises(DataError, match="9999"):
        unused(tmp_path, "recording", ".nc")


def test_the_end_waits_for_no_measurement(
    burst: Burst, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = multiprocessing.active_children()
    monkeypatch.setattr("lensshift.live.server.edge_curve", measures_for_ever)
    with served(source_of(burst), tmp_path) as (address, live):
        until(lambda: live.picture is not None)
        asked = threading.Thread(
            target=status, args=(f"{address}edge", b'{"box": [0, 9, 0, 9]}'), daemon=True
        )
        asked.start()
        time.sleep(3.0)  # it is begun, or waits for the process to start
        assert asked.is_alive()
    until(lambda: set(multiprocessing.active_children()) <= set(before), 30.0)
