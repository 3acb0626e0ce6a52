"""The doctor names what was planted, and finds the truth of rigs that are well."""

import errno
import json
import os
import shutil
import socket
import threading
import tomllib
from collections import namedtuple
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import serial
from typer.testing import CliRunner

import lensshift.capture.emulators.o3m as o3m_emulator
import lensshift.capture.emulators.rig as rig_emulator
from lensshift.camera import camera_preset
from lensshift.capture.emulators.listener import free_udp_port
from lensshift.capture.emulators.rig import EmulatedRig, RigSettings
from lensshift.capture.rig import CameraFrame
from lensshift.cli.app import app
from lensshift.core.errors import DataError
from lensshift.core.types import Burst, Frame
from lensshift.io.calibration_file import load_calibration
from lensshift.pipeline.calibrate import RigCalibration
from lensshift.pipeline.doctor import Diagnosis, Level, examine, examine_rig, network
from lensshift.pipeline.doctor.axes import NUDGE_MM, Axes, nudge_findings
from lensshift.pipeline.doctor.budget import error_budget
from lensshift.pipeline.doctor.start import rig_text
from lensshift.pipeline.doctor.view import look, settings_share, view_findings
from lensshift.registration import calibration_scan_mm
from lensshift.registration.calibrate import fit_scan
from lensshift.scene import Plane, Scene, slanted_edge_card

NOMINAL = 0.25 / 0.0444
QUICK = RigSettings(speed=20.0, rate_hz=40.0, px_per_mm=NOMINAL * np.eye(2))


@pytest.fixture(autouse=True, scope="module")
def scenes_are_cast_once() -> Iterator[None]:
    """Most rigs stand before the same boxes, and a camera that runs does not change."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_emulator, "RunningCamera", cache(rig_emulator.RunningCamera))
        yield


@contextmanager
def bench(settings: RigSettings = QUICK, **told: Any) -> Iterator[tuple[EmulatedRig, dict]]:
    """Yield a running rig and its rig file; `told` changes tables of it."""
    with EmulatedRig(settings, camera_port=free_udp_port()) as rig:
        table = tomllib.loads(rig.rig_file())
        table["acquisition"] |= {"frame_timeout_s": 10.0}
        for name, changes in told.items():
            table[name] = table.get(name, {}) | changes
        yield rig, table


def verdict(done: Diagnosis) -> str:
    """Return level and name of the first line."""
    return done.verdict.partition(":")[0]


def examined(
    out: Path,
    settings: RigSettings = QUICK,
    change: Callable[[EmulatedRig, dict], None] | None = None,
    **told: Any,
) -> Diagnosis:
    with bench(settings, **told) as (rig, table):
        if change is not None:
            change(rig, table)
        done = examine_rig(table, out)
        if "row" in done.devices.get("stage", {}) and done.axes is not None:
            rest = settings.rest_mm
            np.testing.assert_allclose(rig.stages.lens_mm(), rest, atol=0.012)  # brought back
    assert (out / "doctor.html").exists()
    json.dumps(done.as_dict(), default=lambda one: getattr(one, "tolist", lambda: str(one))())
    return done


def error_px(rig: EmulatedRig, file: Path) -> float:
    """Return the rms error of a calibration over sensor and scan, the common offset left out."""
    found = load_calibration(file)
    places = calibration_scan_mm(rig.settings.rest_mm, 0.25, steps=5)
    true = np.array([rig.world.offset_px(place) for place in places])
    told = (
        found.offset_px(places)[:, None, None]
        if found.stage_map.field_px_per_mm is None
        else found.shift_field(places).offset_px
    )
    error = told - true
    return float(np.sqrt(np.mean((error - error.mean(axis=(0, 1, 2))) ** 2)))


def turned(*, swapped: bool, mirrored: bool, turn_deg: float, scale: float) -> np.ndarray:
    turn = np.deg2rad(turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    per_mm = scale * NOMINAL * rotation @ np.diag([1.0, -1.0 if mirrored else 1.0])
    return per_mm[:, ::-1] if swapped else per_mm


@pytest.mark.slow
@pytest.mark.parametrize(
    ("swapped", "mirrored", "turn_deg", "scale", "play_mm"),
    list(product([False, True], [False, True], [0.0, 3.0], [0.8, 1.2], [0.0, 0.010])),
)
def test_all_rigs_end_within_a_hundredth_of_a_pixel(
    tmp_path: Path, swapped: bool, mirrored: bool, turn_deg: float, scale: float, play_mm: float
) -> None:
    per_mm = turned(swapped=swapped, mirrored=mirrored, turn_deg=turn_deg, scale=scale)
    seed = hash((swapped, mirrored, turn_deg, scale, play_mm)) % 1000
    settings = replace(QUICK, px_per_mm=per_mm, play_mm=play_mm, seed=seed)
    with bench(settings) as (rig, table):
        done = examine_rig(table, tmp_path)
        assert done.level is Level.NOTE
        assert error_px(rig, tmp_path / "calibration.json") <= 0.01
    names = {one.name for one in done.findings}
    assert ("axes swapped" in names) == swapped
    assert ("axis mirrored" in names) == mirrored


# ---- planted faults --------------------------------------------------------------------------


@pytest.fixture
def glance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at as few frames as the doctor may: enough for what is far from well."""
    monkeypatch.setattr("lensshift.pipeline.doctor.view.LOOKED_S", 0.0)


def test_a_camera_that_is_silent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The cameras of other tests, which run beside this one, may send to where nobody listens.
    monkeypatch.setattr(network, "datagrams_unheard", lambda seconds: 0)
    done = examined(
        tmp_path,
        change=lambda rig, _: rig.camera.pause(),
        acquisition={"frame_timeout_s": 0.5},
    )
    assert verdict(done) == "FAULT camera silent"
    assert done.devices["stage"]["row"]["model"] == "KDC101"  # asked, not moved


@pytest.mark.skipif(not Path("/proc/net/snmp").exists(), reason="counts of Linux")
def test_a_camera_that_sends_to_another_port(tmp_path: Path) -> None:
    with bench(acquisition={"frame_timeout_s": 0.5}) as (_, table):
        true = table["camera"]["port"]
        table["camera"]["port"] = true - 7
        done = examine_rig(table, tmp_path)
    assert verdict(done) == "FAULT wrong port"
    assert f"port = {true}" in done.verdict


def test_a_layout_that_nobody_knows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = o3m_emulator.pixel_message

    def newer(*given: Any, **named: Any) -> bytes:
        message = bytearray(real(*given, **named))
        message[9] = 9  # DIA1 1.9
        return bytes(message)

    monkeypatch.setattr(o3m_emulator, "pixel_message", newer)
    done = examined(tmp_path, acquisition={"frame_timeout_s": 1.0})
    assert verdict(done) == "FAULT other layout"


def stranger(port: int, ended: threading.Event) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        while not ended.wait(0.02):
            udp.sendto(b"nobody asked for this", ("127.0.0.1", port))


@pytest.mark.parametrize("alone", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_somebody_else_sends_to_the_port(tmp_path: Path, alone: bool) -> None:
    ended = threading.Event()
    with bench(acquisition={"frame_timeout_s": 0.5 if alone else 10.0}) as (rig, table):
        if alone:
            rig.camera.pause()
        port = table["camera"]["port"]
        thread = threading.Thread(target=stranger, args=(port, ended))
        thread.start()
        try:
            done = examine_rig(table, tmp_path)
        finally:
            ended.set()
            thread.join()
    assert verdict(done) == ("FAULT foreign sender" if alone else "DOUBT foreign sender")
    assert (done.calibration is None) == alone


@pytest.mark.usefixtures("glance")
def test_too_little_light(tmp_path: Path) -> None:
    camera = camera_preset("o3m151")
    dim = replace(camera.illumination, intensity_w_per_sr=0.05)
    done = examined(tmp_path, replace(QUICK, camera=replace(camera, illumination=dim)))
    assert verdict(done) == "FAULT too dark"
    assert done.axes is None  # nothing was moved


@pytest.mark.usefixtures("glance")
def test_a_scene_without_edges(tmp_path: Path) -> None:
    wall = Scene((Plane(centre_m=(0.0, 0.0, 3.0), reflectance=0.5),))
    done = examined(tmp_path, replace(QUICK, scene=wall))
    assert verdict(done) == "FAULT no texture"


@pytest.mark.slow
@pytest.mark.parametrize("slant_deg", [5.0, 33.0])
def test_a_scene_of_a_single_edge(tmp_path: Path, slant_deg: float) -> None:
    """It tells no shift along the edge, and the aliases of its steps look like texture."""
    scene = slanted_edge_card(np.deg2rad(slant_deg))
    done = examined(tmp_path, replace(QUICK, scene=scene, seed=int(slant_deg)))
    assert verdict(done) == "FAULT no texture"
    assert not (tmp_path / "calibration.json").exists()


def test_a_map_that_a_scan_does_not_tell_is_a_fault() -> None:
    rng = np.random.default_rng(5)
    asked = calibration_scan_mm((3.0, 3.0), 0.3, steps=3)
    offset_px = (asked - 3.0) * NOMINAL + rng.normal(0.0, 0.004, asked.shape)
    burst = Burst.from_arrays(
        rng.random((len(asked), 8, 8)), pitch_mm=0.155, offset_px=offset_px, stage_mm=asked
    )
    fit = fit_scan(burst, registered=True, over_sensor=False)
    for sigma, level in ((0.05, None), (0.8, Level.FAULT)):  # px per mm, along the rows
        known = replace(fit.calibration, px_per_mm_sigma=np.array([[sigma] * 2, [0.05] * 2]))
        done = RigCalibration(replace(fit, calibration=known), 0.0, 0.0)
        budget = error_budget(done, np.zeros(2))
        assert budget.map == pytest.approx(np.sqrt(2.0) * sigma * 0.0444, rel=0.05)
        told = next(examine._budget_findings(done, budget), None)
        assert (told.level if told else None) is level


def test_an_image_that_drifts(tmp_path: Path) -> None:
    done = examined(tmp_path, replace(QUICK, drift_px_per_s=(0.0, 0.02)))
    assert verdict(done) == "DOUBT drift"


@pytest.mark.slow
def test_brightness_that_jumps(tmp_path: Path) -> None:
    done = examined(tmp_path, replace(QUICK, brightness_jump=0.05))
    assert verdict(done) == "DOUBT exposure switching"


@pytest.mark.slow
def test_exposures_whose_factors_are_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pixel of 2.5 % more in one setting than in another, near the level of the switch."""
    real = o3m_emulator.pixel_message
    chance = np.random.default_rng(3)

    def switching(frame: Any, **named: Any) -> bytes:
        message = bytearray(real(frame, **named))
        if chance.random() < 0.5:
            return bytes(message)
        weaker = bytearray(real(replace(frame, amplitude=1.025 * frame.amplitude), **named))
        at = 12 + 4 + 2 * 1024 + 12 * 1024  # of the confidence
        bits = np.frombuffer(weaker, "<u2", 1024, at) ^ (1 << 1)  # as if with another exposure
        weaker[at : at + 2048] = bits.astype("<u2").tobytes()
        factors = np.frombuffer(weaker, "<f4", 4, at + 4096)[[1, 0, 3, 2]]
        weaker[at + 4096 : at + 4112] = factors.astype("<f4").tobytes()
        return bytes(weaker)

    monkeypatch.setattr(o3m_emulator, "pixel_message", switching)
    done = examined(tmp_path)
    assert verdict(done) == "DOUBT exposure switching"


@pytest.mark.slow
def test_frames_that_get_lost(tmp_path: Path) -> None:
    done = examined(tmp_path, replace(QUICK, packet_loss=0.05))
    assert verdict(done) == "DOUBT losses"


@pytest.mark.usefixtures("glance")
def test_a_stage_that_is_blocked(tmp_path: Path) -> None:
    """Its motor reports a motion error at the first move."""

    def stuck(rig: EmulatedRig, _: dict) -> None:
        col = rig.stages.controllers[1]
        go = col._go
        col._go = lambda *given: (go(*given), col.fail_motion())[0]  # type: ignore[method-assign]

    done = examined(tmp_path, change=stuck)
    assert verdict(done) == "FAULT stage blocked"


@pytest.mark.usefixtures("glance")
def test_a_lens_that_does_not_follow_its_screw(tmp_path: Path) -> None:
    per_mm = np.diag([NOMINAL, 0.01])
    done = examined(tmp_path, replace(QUICK, px_per_mm=per_mm))
    assert verdict(done) == "FAULT stage blocked"
    assert "axis col" in done.verdict


@pytest.mark.parametrize("gain", [1.0, 1.03])
def test_few_frames_of_an_exposure_do_not_make_it_another(gain: float) -> None:
    """A thousand pixels, of each of which 3 frames of 16 have another exposure, at an SNR of 50."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        other = np.argsort(rng.random((16, 16, 64)), axis=0) < 3
        amplitude = 0.5 * np.where(other, gain, 1.0) * rng.normal(1.0, 0.005, other.shape)
        raw = [{"confidence": one.astype("u2") << 1, "normalization": np.ones(4)} for one in other]
        share = settings_share(raw, amplitude, np.ones((16, 64), bool))
        assert share == 0.0 if gain == 1.0 else share > 0.2


@pytest.mark.parametrize("gain", [1.0, 0.97, 1.03])
def test_a_pixel_that_chooses_its_exposure_by_what_it_reads_does_not_switch(gain: float) -> None:
    """Noise makes it choose, at an SNR of 100; not so a factor that is 3 % wrong."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        level = rng.uniform(0.99, 1.01, (16, 64))
        amplitude = level * rng.normal(1.0, 0.01, (32, 16, 64))
        weak = amplitude > 1.0
        factors = np.array([10.0, 1.0, 1.0, 1.0])
        raw = [{"confidence": (~one).astype("u2") << 1, "normalization": factors} for one in weak]
        read = np.where(weak, gain, 1.0) * amplitude
        share = settings_share(raw, read, np.ones((16, 64), bool))
        assert share < 0.01 if gain == 1.0 else share > 0.1, seed


def test_only_noise_makes_an_image_that_stands_seem_to_move() -> None:
    """Whatever a shift is known to: what a model errs by is in all frames before a still lens."""
    poorly = np.full((2, 2), 2.0)  # 0.1 px in 50 um
    for went_px, noise_px, stuck in (
        (0.18, 0.005, []),
        (0.02, 0.001, ["col"]),
        (0.18, 0.06, ["col"]),
    ):
        axes = Axes(np.diag([NOMINAL, went_px / NUDGE_MM]), poorly, np.zeros(2))
        found = [*nudge_findings(axes, np.array([noise_px, 0.0]))]
        assert [one.said.split()[1] for one in found if one.name == "stage blocked"] == stuck


@pytest.mark.usefixtures("glance")
@pytest.mark.parametrize(("every", "level"), [(1, "FAULT"), (2, "DOUBT"), (0, "")])
def test_pictures_that_are_handed_out_again(every: int, level: str) -> None:
    """One and the same picture for ever, each one twice, and each one anew."""
    rng, frames = np.random.default_rng(3), []
    texture = rng.random((12, 16))
    for number in range(16):
        anew = not frames or every == 0 or (every == 2 and number % 2 == 0)
        one = texture + 0.01 * rng.standard_normal((12, 16)) if anew else frames[-1].frame.amplitude
        frames.append(CameraFrame(Frame(one, None, np.ones((12, 16), bool), 0.0), number, number))
    left = iter(frames)
    view = look(SimpleNamespace(next_frame=lambda timeout_s: next(left)), 1.0)
    found = [one for one in view_findings(view, {}, {}) if one.name == "same picture"]
    assert [one.level.name for one in found] == ([level] if level else [])


def looked_at(amplitude: np.ndarray, valid: np.ndarray | None = None) -> list[tuple[str, str]]:
    """Return level and name of what the doctor finds in frames [frame row col] of a still lens."""
    seen = np.ones(amplitude.shape, bool) if valid is None else valid
    both = zip(amplitude, seen, strict=True)
    frames = [CameraFrame(Frame(y, None, v, 0.0), k, k) for k, (y, v) in enumerate(both)]
    left = iter(frames)
    view = look(SimpleNamespace(next_frame=lambda timeout_s: next(left)), 1.0)
    return [(one.level.name, one.name) for one in view_findings(view, {}, {})]


def still_frames(seed: int = 3) -> np.ndarray:
    """Return 16 frames [frame row col] of bright cards, with noise at an SNR of some 50."""
    rng = np.random.default_rng(seed)
    cards = np.kron(rng.uniform(0.3, 1.0, (4, 8)), np.ones((4, 8)))
    return np.asarray(cards + 0.01 * rng.standard_normal((16, 16, 64)))


@pytest.mark.usefixtures("glance")
def test_what_single_pixels_and_frames_do_does_not_hide_the_others() -> None:
    """A pixel that reads nothing has no gain, a frame without pixels no shift."""
    y = still_frames()
    assert looked_at(y) == []
    y[:, 3, 20], y[:, 9, 40] = 0.0, np.nan
    assert looked_at(y) == []
    valid = np.ones(y.shape, bool)
    y[2], valid[7] = np.nan, False
    assert looked_at(y, valid) == [("DOUBT", "empty frames")]
    y[11], y[13, :, :40] = 0.0, 0.0  # a shutter, and one on its way
    told = looked_at(y, valid)
    assert told[0] == ("DOUBT", "empty frames")
    assert ("FAULT", "too dark") in looked_at(0.01 * still_frames() - 0.5)
    assert looked_at(still_frames(), 0 * valid > 0) == [("FAULT", "too dark")]


@pytest.mark.usefixtures("glance")
def test_invalid_pixels_beside_bright_ones_are_not_dark() -> None:
    y = still_frames()
    valid = np.broadcast_to(np.arange(64) < 30, y.shape)
    assert looked_at(y, valid) == [("FAULT", "invalid pixels")]


@pytest.mark.usefixtures("glance")
def test_areas_that_are_saturated() -> None:
    assert looked_at(np.minimum(still_frames(), 0.8)) == [("DOUBT", "saturated")]
    assert looked_at(np.rint(100.0 * still_frames())) == []  # levels of a converter


@pytest.mark.usefixtures("glance")
def test_who_walks_by_is_no_drift_and_no_axis() -> None:
    """He covers other pixels in each frame; a drift changes all in proportion to time."""
    y, col = still_frames(), np.arange(64)
    for rows, name in ((3, ("DOUBT", "moving scene")), (16, ("FAULT", "moving scene"))):
        by = np.abs(col - 10.0 - np.arange(16)[:, None, None]) < 4.0
        part = by & (np.arange(16) < rows)[:, None]
        assert looked_at(np.where(part, 0.1, y))[0] == name
    ramp = np.linspace(0.0, 0.1, 16)[:, None, None]
    drifted = y + ramp * np.gradient(y.mean(axis=0), axis=1)
    assert looked_at(drifted) == []
    for seed in range(8):
        assert looked_at(still_frames(seed)) == []


def test_an_image_that_does_not_move_at_all_has_numbers() -> None:
    assert Axes(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2)).numbers["turn_deg"] == 0.0


@pytest.mark.usefixtures("glance")
def test_a_lens_that_somebody_touches(tmp_path: Path) -> None:
    """Its place is read back to 4 um, and 1 um is allowed for: as if a hand lay on it."""
    settings = replace(QUICK, encoder_noise_mm=0.004)
    done = examined(tmp_path, settings, acquisition={"frame_timeout_s": 10.0, "hold_mm": 0.001})
    assert verdict(done) == "FAULT stage strays", done.verdict


@pytest.mark.usefixtures("glance")
def test_one_stage_for_both_axes(tmp_path: Path) -> None:
    per_mm = NOMINAL * np.array([[1, 0.9], [0.1, 0.2]])
    done = examined(tmp_path, replace(QUICK, px_per_mm=per_mm))
    assert verdict(done) == "FAULT axes parallel", done.verdict


@pytest.mark.usefixtures("glance")
@pytest.mark.parametrize("rest_mm", [[3.0, 5.98], [0.03, 3.0]])
def test_rest_at_the_end_of_the_way(tmp_path: Path, rest_mm: list[float]) -> None:
    """Far from where the lens stood the scene may be out of view, and pass for a blocked stage."""
    done = examined(tmp_path, calibration={"rest_mm": rest_mm})
    assert verdict(done) == "FAULT limit"


def test_a_short_travel_is_scanned_as_far_as_it_goes(tmp_path: Path) -> None:
    """A piezo has 0.3 mm or less, where 1.7 px of the usual lens are 0.302 mm."""
    low, high = 2.88, 3.1
    done = examined(tmp_path, stage={"travel_mm": [low, high]})
    assert done.level is Level.NOTE, done.verdict
    assert done.calibration is not None
    found = done.calibration.calibration
    places = np.asarray(done.calibration.fit.burst.stage_commanded_mm)
    assert places.max() == pytest.approx(high)
    assert places.min() >= low
    error = found.stage_map.px_per_mm - NOMINAL * np.eye(2)
    assert np.all(np.abs(error) < 4.0 * np.asarray(found.px_per_mm_sigma))


@pytest.mark.usefixtures("glance")
def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(2**30, 2**30, 2**20))
    done = examined(tmp_path)
    assert verdict(done) == "FAULT full disk"


@pytest.mark.usefixtures("glance")
def test_a_disk_that_takes_no_larger_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path) -> None:
        raise OSError(errno.EFBIG, "File too large")

    monkeypatch.setattr(shutil, "disk_usage", full)
    done = examined(tmp_path)
    assert verdict(done) == "FAULT full disk"
    assert done.files[-1].name == "doctor.html"


def test_another_program_has_the_port_of_the_camera(tmp_path: Path) -> None:
    with (
        bench() as (_, table),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
    ):
        udp.bind(("127.0.0.1", table["camera"]["port"]))
        done = examine_rig(table, tmp_path)
    assert verdict(done) == "FAULT second process"


@pytest.mark.skipif(os.name != "posix", reason="needs a pty")
@pytest.mark.usefixtures("glance")
@pytest.mark.parametrize("fault", ["second process", "no permission", "wrong baud"])
def test_a_port_of_the_stage_that_is_not_to_be_had(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    real = serial.serial_for_url
    ours, theirs = os.openpty()
    url, ended = os.ttyname(theirs), threading.Event()

    def babble() -> None:
        chance = np.random.default_rng(1)
        while not ended.wait(0.01):
            os.write(ours, chance.bytes(8))

    def denied(port: str, **named: Any) -> Any:
        if port == url:
            raise serial.SerialException(errno.EACCES, f"could not open port {port}")
        return real(port, **named)

    with bench() as (_, table), ExitStack() as undo:
        undo.callback(os.close, ours)
        undo.callback(os.close, theirs)
        table["stage"]["row"] = url
        if fault == "second process":
            undo.callback(real(url, exclusive=True).close)
        elif fault == "no permission":
            monkeypatch.setattr(serial, "serial_for_url", denied)
        else:
            thread = threading.Thread(target=babble)
            thread.start()
            undo.callback(thread.join)
            undo.callback(ended.set)
        done = examine_rig(table, tmp_path)
    assert verdict(done) == f"FAULT {fault}"
    assert done.view is not None  # the camera is looked at all the same


@pytest.mark.usefixtures("glance")
def test_no_leave_to_home(tmp_path: Path) -> None:
    done = examined(tmp_path, stage={"home": "ask"})
    assert verdict(done) == "FAULT homing"
    assert "goes back until its switch" in done.verdict


# ---- the verb --------------------------------------------------------------------------------


def test_an_earlier_examination_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "scan.nc").write_bytes(b"mine")
    with pytest.raises(DataError, match=r"scan\.nc"):
        examine_rig({"stage": {"row": "1", "col": "2"}}, tmp_path)
    assert (tmp_path / "scan.nc").read_bytes() == b"mine"


def test_from_no_rig_file_to_a_filed_calibration_of_an_askew_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Fewer positions than usual: those are for all the rigs above.
    monkeypatch.setattr(examine, "USUAL_STEPS", 3)
    calibrate = examine.calibrate_rig
    per_mm = turned(swapped=True, mirrored=True, turn_deg=3.0, scale=1.2)
    file, out = tmp_path / "rig.toml", tmp_path / "out"
    with bench(replace(QUICK, px_per_mm=per_mm, play_mm=0.010)) as (rig, table):
        row, col = rig.stages.urls

        def calibrate_alone(*given: Any, **named: Any) -> Any:
            rig.camera.pause()  # nobody looks any more, and what it sees takes time to compute
            return calibrate(*given, **named)

        monkeypatch.setattr(examine, "calibrate_rig", calibrate_alone)
        ran = CliRunner().invoke(
            app,
            ["doctor", "--file", str(file), "--row", row, "--col", col, "--out", str(out),
             "--port", str(table["camera"]["port"]), "--yes", "--json"],
        )  # fmt: skip
        assert ran.exit_code == 0, ran.output + ran.stderr
        assert error_px(rig, out / "calibration.json") <= 0.01
    told = json.loads(ran.stdout)
    named = {one["name"] for one in told["findings"]}
    # A machine that is too busy to fetch its datagrams loses them, and hears of it.
    assert told["verdict"].startswith("DOUBT losses" if "losses" in named else "HEALTHY")
    assert named - {"losses"} == {"axes swapped", "axis mirrored", "stage turned", "other scale"}
    assert abs(told["axes"]["turn_deg"]) == pytest.approx(3.0, abs=0.6)
    np.testing.assert_allclose(told["axes"]["play_mm"], 0.010, atol=0.002)
    assert told["error_budget_px"]["shift"] < 0.02
    assert told["devices"]["stage"]["col"]["serial_number"] == 83000001
    written = tomllib.loads(file.read_text(encoding="utf-8"))
    assert written["calibration"] == {"file": "out/calibration.json"}
    again = CliRunner().invoke(app, ["doctor", "--file", str(file)])
    assert again.exit_code == 1
    assert "give it as argument" in again.stderr


def test_what_is_not_known_is_asked_for(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["doctor", "--file", str(tmp_path / "rig.toml")])
    assert ran.exit_code == 1
    assert "--row SERIAL" in ran.stderr
    assert not (tmp_path / "rig.toml").exists()


def test_the_rig_file_that_is_written_says_what_was_given() -> None:
    told = tomllib.loads(rig_text("83000009", "socket://127.0.0.1:9", 42007))
    assert told["stage"]["row"] == "83000009"
    assert told["stage"]["col"] == "socket://127.0.0.1:9"
    assert told["camera"]["port"] == 42007
