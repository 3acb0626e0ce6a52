"""Recordings larger than memory: parts, breaks, workers, and that none of them changes a number."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import lensshift
from lensshift import Burst, DataError
from lensshift.cli.app import app
from lensshift.core.types import Status
from lensshift.io import sequence_file
from lensshift.io.burst_file import open_recording, write_recording
from lensshift.io.sequence_file import load_window, sequence_numbers
from lensshift.pipeline import recording
from lensshift.pipeline.recording import reconstruct_recording

SHAPE, F_HZ = (9, 14), 15e6
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)])


def part(first: int, count: int, *, step_px: float = 0.0) -> Burst:
    """Return frames of a card before a wall; every frame has its own noise."""
    numbers = np.arange(first, first + count)
    offset_px = SQUARE_PX[numbers % 4] + step_px * numbers[:, None]
    rows, cols = np.indices(SHAPE)
    noise = np.stack([np.random.default_rng(k).standard_normal((2, *SHAPE)) for k in numbers])
    edge = cols[None] - 6.3 - 0.2 * rows[None] - offset_px[:, 1, None, None]
    on = np.clip(edge + 0.5, 0.0, 1.0)
    light = 0.3 + 0.4 * on + 0.004 * noise[:, 0]
    distance_m = 3.5 + 0.5 * on + 0.01 * noise[:, 1]
    return Burst.from_arrays(
        light.astype(np.float32), distance_m.astype(np.float32), offset_px=offset_px,
        pitch_mm=(0.2, 0.1), modulation_hz=F_HZ, time_s=numbers / 50.0, meta={"lens": "none"},
        intrinsics=lensshift.Pinhole(40.0, 40.0, 6.5, 4.0),
    )  # fmt: skip


def parts(count: int, each: int = 10, **said: float) -> Iterator[Burst]:
    for first in range(0, count, each):
        yield part(first, min(each, count - first), **said)


@pytest.fixture
def film(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "film.nc", 46, parts(46))


@pytest.fixture(autouse=True)
def small_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "MOST_WINDOWS", 3)


def pictures(path: Path) -> dict[str, np.ndarray]:
    with xr.open_dataset(path) as data:
        return {name: data[name].values for name in data.data_vars}


def test_a_recording_in_parts_is_the_burst(film: Path):
    whole, expected = lensshift.load_burst(film), part(0, 46)
    for name in ("amplitude", "distance_m", "offset_px", "time_s", "valid"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(expected, name))
    assert (whole.meta, whole.modulation_hz, whole.grid) == ({"lens": "none"}, F_HZ, expected.grid)
    with open_recording(film) as source:
        assert source.frame_count == 46
        some = source.burst(17, 9)
        np.testing.assert_array_equal(some.amplitude, expected.amplitude[17:26])
        np.testing.assert_array_equal(some.offset_px, expected.offset_px[17:26])
        for first, count in ((40, 7), (-1, 3), (3, 0)):
            with pytest.raises(DataError, match="expected frames from 0 to 45"):
                source.burst(first, count)


def test_parts_that_do_not_fit_leave_no_recording(tmp_path: Path):
    target = tmp_path / "film.nc"
    with pytest.raises(DataError, match="expected 50 frames, got 46"):
        write_recording(target, 50, parts(46))
    with pytest.raises(DataError, match="expected 46 frames, got more"):
        write_recording(tmp_path / "other.nc", 46, parts(50))
    with pytest.raises(DataError, match="expected 1 frames, got 0"):
        write_recording(target, 1, [])
    assert not list(tmp_path.iterdir())


def test_a_recording_is_packed_as_a_burst_file_is(tmp_path: Path):
    light = np.full((400, *SHAPE), 0.25)
    light[:, 2:5, 3:9] = 0.5
    burst = Burst.from_arrays(light, offset_px=np.tile(SQUARE_PX, (100, 1)), pitch_mm=0.1)
    lensshift.save_burst(burst, tmp_path / "burst.nc")
    each = (burst.select(range(k, k + 40)) for k in range(0, 400, 40))
    film = write_recording(tmp_path / "film.nc", 400, each)
    np.testing.assert_array_equal(lensshift.load_burst(film).amplitude, light)
    assert film.stat().st_size < 1.2 * (tmp_path / "burst.nc").stat().st_size < light.nbytes / 4


FULL_DISK = """
import resource, sys
sys.dont_write_bytecode = True  # else what is left of it is cut off
import numpy as np
import lensshift
from lensshift.io.sequence_file import begin_sequence
kind, path, limit = sys.argv[1], sys.argv[2], int(sys.argv[3])
light = np.random.default_rng(0).random((40, 48, 64))
part = lensshift.Burst.from_arrays(light, offset_px=np.zeros((40, 2)), pitch_mm=1.0)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    if kind == "recording":
        lensshift.write_recording(path, 120, [part] * 3)
    else:
        begin_sequence(path, 500, part.grid, ("amplitude",), scale=2, method="auto", settings={},
                       flying=False, intrinsics=None)
except lensshift.DataError as error:
    sys.exit(0 if "cannot write: File too large" in str(error) else 3)
sys.exit(4)
"""


@pytest.mark.skipif(os.name == "nt", reason="has no limit of the size of a file")
@pytest.mark.parametrize("limit_bytes", [3_000, 70_000, 900_000])
@pytest.mark.parametrize("kind", ["recording", "sequence"])
def test_a_full_disk_is_an_error_that_leaves_nothing(kind: str, limit_bytes: int, tmp_path: Path):
    command = [sys.executable, "-c", FULL_DISK, kind, str(tmp_path / "x.nc"), str(limit_bytes)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert not list(tmp_path.iterdir())


def test_parts_of_another_kind_are_refused(tmp_path: Path):
    target = tmp_path / "film.nc"

    def of(light: float, pitch_mm: float = 0.1, hz: float = F_HZ) -> Burst:
        frames = np.full((4, *SHAPE), light)
        return Burst.from_arrays(frames, offset_px=SQUARE_PX, pitch_mm=pitch_mm, modulation_hz=hz)

    farther = replace(of(0.2), distance_m=np.ones((4, *SHAPE)))
    for other in (of(0.2, pitch_mm=0.2), of(0.2, hz=2 * F_HZ), farther):
        with pytest.raises(DataError, match="frame 4: expected pitch, modulation and fields"):
            write_recording(target, 12, [of(0.2), other])
    write_recording(target, 12, [of(0.2)] * 3)
    assert np.all(lensshift.load_burst(target).amplitude == 0.2)


def test_another_recording_of_the_same_name_is_not_gone_on_with(film: Path, tmp_path: Path):
    def cut(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4, on_progress=cut)
    film.unlink()
    write_recording(film, 46, (part(k, 1) for k in range(100, 146)))
    with pytest.raises(DataError, match="of another recording"):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4)


def test_pictures_of_two_versions_are_not_put_together(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def cut(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4, on_progress=cut)
    with pytest.raises(DataError, match=r"begun with other settings .*\(every 4, not 1, count 11"):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4, every=1)
    monkeypatch.setattr(recording, "software", lambda: "lensshift 99.0")
    with pytest.raises(DataError, match=r"\(software lensshift .*, not lensshift 99\.0\)"):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4)


def test_a_recording_that_is_replaced_meanwhile_ends_the_run(film: Path, tmp_path: Path):
    """The pictures of the other one were put behind those of the first, without a word."""

    def other(done: int, total: int) -> None:
        if done == 3:
            write_recording(film, 46, (part(k, 1) for k in range(100, 146)))

    with pytest.raises(DataError, match=r"film\.nc: another recording or program"):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4, on_progress=other)
    assert not (tmp_path / "sr.nc").exists()


def test_each_window_is_what_a_stream_makes_of_its_frames(film: Path, tmp_path: Path):
    found = reconstruct_recording(film, tmp_path / "sr.nc", window=4, every=2)
    assert (found.windows, found.resumed) == (22, 0)
    with open_recording(film) as source:
        template = source.burst(0, 4)
    for first in (0, 9):  # tasks of three windows begin anew
        camera = lensshift.stream(template)
        for number in range(first, first + 3):
            for k in range(2 * number if number == first else 2 * number + 2, 2 * number + 4):
                one = part(k, 1)
                camera.take(
                    lensshift.Frame(one.amplitude[0], one.distance_m[0], one.valid[0], k / 50.0),
                    place=k % 4,
                )
            expected, window = camera.picture(), load_window(found.path, number)
            for name, estimate in expected.channels.items():
                got = window.channels[name]
                np.testing.assert_array_equal(got.image, estimate.image.astype(np.float32))
                np.testing.assert_array_equal(got.std, estimate.std.astype(np.float32))
            np.testing.assert_array_equal(window.flying, expected.flying)
    said = sequence_numbers(found.path)
    np.testing.assert_array_equal(said["first_frame"], np.arange(0, 44, 2))
    np.testing.assert_allclose(said["time"], (np.arange(0, 44, 2) + 1.5) / 50)
    assert 0 < said["refined"].sum() < 22
    assert len(load_window(found.path, 3).point_cloud()) > 100


def test_shifts_that_do_not_return_are_taken_as_they_are(tmp_path: Path):
    film = write_recording(tmp_path / "drift.nc", 13, parts(13, step_px=0.01))
    found = reconstruct_recording(film, tmp_path / "sr.nc", window=5, every=4, channel="amplitude")
    assert found.windows == 3
    assert sequence_numbers(found.path)["refined"].all()
    for number in range(3):
        alone = lensshift.reconstruct(part(4 * number, 5, step_px=0.01), channel="amplitude")
        got = load_window(found.path, number).amplitude.image
        np.testing.assert_array_equal(got, alone.amplitude.image.astype(np.float32))


def test_shifts_of_some_other_frames_are_taken_as_they_are(tmp_path: Path):
    other = part(8, 2, step_px=0.04)
    film = write_recording(tmp_path / "film.nc", 10, [part(0, 8), other])
    found = reconstruct_recording(film, tmp_path / "sr.nc", window=4, every=1)
    assert not sequence_numbers(found.path)["refined"][:3].all()  # they follow
    whole, response = lensshift.load_burst(film), load_window(found.path, 0).settings["response"]
    for number in range(3, 7):
        burst = whole.select(range(number, number + 4))
        alone = lensshift.reconstruct(replace(burst, meta={**burst.meta, **response}))
        got = load_window(found.path, number).amplitude.image
        np.testing.assert_array_equal(got, alone.amplitude.image.astype(np.float32))


def test_frames_that_turn_are_no_stream(tmp_path: Path):
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    each = [replace(part(4 * n, 4), affine=np.full((4, 2, 2), 0.01 * n * turn)) for n in range(2)]
    film = write_recording(tmp_path / "film.nc", 8, each)
    found = reconstruct_recording(film, tmp_path / "sr.nc", window=4, pace="live")
    assert sequence_numbers(found.path)["refined"].all()


def test_frames_between_windows_are_not_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(recording, "TASK_BYTES", 60_000)  # some 26 frames, or pictures
    film = write_recording(tmp_path / "film.nc", 200, parts(200))
    held, read = [], recording.Recording.burst

    def burst(self: recording.Recording, first: int, count: int) -> Burst:
        held.append(count)
        return read(self, first, count)

    monkeypatch.setattr(recording.Recording, "burst", burst)
    assert reconstruct_recording(film, tmp_path / "sr.nc", window=4, every=98).windows == 3
    assert max(held) == 4


def test_a_break_changes_nothing(film: Path, tmp_path: Path):
    whole = reconstruct_recording(film, tmp_path / "whole.nc", window=4, every=2)
    target, seen = tmp_path / "broken.nc", []

    def cut(done: int, total: int) -> None:
        seen.append((done, total))
        if len(seen) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct_recording(film, target, window=4, every=2, on_progress=cut)
    assert seen == [(3, 22), (6, 22), (9, 22)]
    assert not target.exists()
    with pytest.raises(DataError, match="begun with other settings"):
        reconstruct_recording(film, target, window=4, every=4)
    found = reconstruct_recording(film, target, window=4, every=2)
    assert (found.windows, found.resumed) == (22, 9)
    assert target.read_bytes() == whole.path.read_bytes()
    assert not list(tmp_path.glob("*.part"))


def test_what_was_half_written_is_made_anew(film: Path, tmp_path: Path):
    whole = reconstruct_recording(film, tmp_path / "whole.nc", window=4)
    with whole.path.open("r+b") as file:
        with sequence_file.open_container(whole.path, "lensshift-sequence/1") as container:
            starts = {name: container.start_of(name) for name in ("written", "distance")}
        file.seek(starts["written"] + 3)
        file.write(bytes(3))
        file.seek(starts["distance"] + 4 * 3 * 18 * 28)
        file.write(bytes(1000))
    before = pictures(whole.path)["distance"][3]
    with pytest.raises(DataError, match="there is no window 3 yet: 8 of 11 windows were written"):
        load_window(whole.path, 3)
    whole.path.rename(tmp_path / "again.nc.part")
    found = reconstruct_recording(film, tmp_path / "again.nc", window=4)
    assert found.resumed == 8
    again = load_window(found.path, 3).distance_m.image
    assert before[0, 0] == 0
    assert again.min() > 3


def test_frames_that_were_not_written_are_no_dark_ones(tmp_path: Path):
    begun = write_recording(tmp_path / "film.nc", 50, parts(50))
    with h5py.File(begun, "r+") as file:  # as before 0.2 where it was broken off
        file["entry/data/written"] = (np.arange(50) < 46).astype(np.uint8)
    with pytest.raises(DataError, match="46 of 50 frames were written before it was broken off"):
        lensshift.load_burst(begun)
    with pytest.raises(DataError, match="46 of 50 frames"):
        reconstruct_recording(begun, tmp_path / "sr.nc")


def test_a_sequence_that_was_broken_off_says_so(film: Path, tmp_path: Path):
    def cut(done: int, total: int) -> None:
        if done >= 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4, on_progress=cut)
    begun = (tmp_path / "sr.nc.part").rename(tmp_path / "copied.nc")
    with pytest.raises(DataError, match="there is no window 6 yet"):
        load_window(begun, 6)
    assert load_window(begun, 5).distance_m.image.min() > 3
    told = CliRunner().invoke(app, ["info", str(begun)]).output
    assert "unfinished  6 of 11 windows" in told
    assert "windows     6, of frames 0 to 20 on" in told
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap is not installed")
    stream = CliRunner().invoke(app, ["convert", str(begun), str(tmp_path / "w.mcap")])
    assert "6 of 11 pictures are there" in stream.output
    sent = reader.read_ros2_messages(tmp_path / "w.mcap", ["/lensshift/distance"])
    assert len(list(sent)) == 6


def test_phasors_are_not_halved(tmp_path: Path):
    """Of complex pictures the real part was kept, as their amplitude."""
    light = part(0, 8)
    phasors = light.amplitude * np.exp(4j * np.pi * F_HZ / 299792458 * light.distance_m)
    known = replace(light, amplitude=phasors, distance_m=None)
    film = write_recording(tmp_path / "film.nc", 8, [known])
    with pytest.raises(ValueError, match=r"complex.*take channel phasor of method auto"):
        reconstruct_recording(film, tmp_path / "sr.nc", method="bicubic")
    write_recording(tmp_path / "untold.nc", 8, [replace(known, modulation_hz=None)])
    with pytest.raises(ValueError, match="tell the modulation: lensshift convert IN OUT"):
        reconstruct_recording(tmp_path / "untold.nc", tmp_path / "sr.nc")
    asked = [str(tmp_path / name) for name in ("untold.nc", "told.nc")]
    told = CliRunner().invoke(app, ["convert", *asked, "--modulation-hz", str(F_HZ)])
    assert told.exit_code == 0, told.output
    again = CliRunner().invoke(app, ["convert", str(film), asked[1], "--modulation-hz", "2e7"])
    assert "modulated at 1.5e+07 Hz; leave out --modulation-hz" in " ".join(again.output.split())
    found = [reconstruct_recording(one, f"{one}.nc") for one in (film, tmp_path / "told.nc")]
    first, second = (load_window(one.path, 1) for one in found)
    np.testing.assert_array_equal(first.distance_m.image, second.distance_m.image)
    assert abs(np.median(first.distance_m.image) - 3.5) < 0.02


def test_two_processes_do_not_write_one_file(film: Path, tmp_path: Path):
    def second(done: int, total: int) -> None:
        with pytest.raises(DataError, match=r"sr.nc.part: another program is writing"):
            reconstruct_recording(film, tmp_path / "sr.nc", window=4)

    reconstruct_recording(film, tmp_path / "sr.nc", window=4, on_progress=second)


def test_too_little_room_is_said_before_the_work(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    class Room:
        free = 10_000

    monkeypatch.setattr(sequence_file.shutil, "disk_usage", lambda _: Room)
    with pytest.raises(DataError, match="MB are free"):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4)
    assert [path.name for path in tmp_path.iterdir()] == ["film.nc"]


def test_what_frames_contradict_is_counted_and_named(tmp_path: Path):
    def moved() -> Iterator[Burst]:
        for one in parts(24, 4):
            light = one.amplitude.copy()
            light[2, 2:7, 2:6] += 0.5 if one.time_s[0] in (0.24, 0.4) else 0.0
            yield Burst.from_arrays(light, offset_px=one.offset_px, pitch_mm=0.1)

    film = write_recording(tmp_path / "moves.nc", 24, moved())
    found = reconstruct_recording(film, tmp_path / "sr.nc", window=4)
    assert found.contradicted == 1  # the first of a task knows of no round before
    assert np.flatnonzero(sequence_numbers(found.path)["contradicted"]).tolist() == [3]
    assert found.said[0].startswith("window 3: ")
    assert found.said[1].startswith("window 5: something moved")
    assert load_window(found.path, 3).amplitude.status is Status.CONTRADICTED
    later, rests = (load_window(found.path, k).amplitude for k in (5, 4))
    assert later.status is Status.COMPLETE
    np.testing.assert_allclose(later.image, rests.image, atol=0.04)


@pytest.mark.parametrize("step_px", [0.0, 0.01])
def test_frames_that_end_a_run_are_named(tmp_path: Path, step_px: float):
    burst = part(0, 24, step_px=step_px)
    light = burst.amplitude.copy()
    light[14, 3, 5] = -0.2  # the third frame of its window
    film = write_recording(tmp_path / "film.nc", 24, [replace(burst, amplitude=light)])
    wrong = r"frames 12 to 15: .* got -0\.2 in frame 2 at row 3, column 5 .* in valid"
    with pytest.raises(DataError, match=wrong):
        reconstruct_recording(film, tmp_path / "sr.nc")
    light[14, 3, 5] = np.nan
    film = write_recording(tmp_path / "mended.nc", 24, [replace(
        burst, amplitude=np.nan_to_num(light), valid=np.isfinite(light)
    )])  # fmt: skip
    reconstruct_recording(film, tmp_path / "mended_sr.nc")


@pytest.mark.parametrize(
    ("step_px", "every", "said"),  # the default run takes each once
    [
        (0.0, 4, True),
        (0.01, 3, True),
        (0.0, 3, False),
        pytest.param(0.0, 3, True, marks=pytest.mark.slow),
        pytest.param(0.01, 4, True, marks=pytest.mark.slow),
        pytest.param(0.01, 3, False, marks=pytest.mark.slow),
    ],
)
def test_windows_that_show_nothing_stop_no_other(
    tmp_path: Path, step_px: float, every: int, said: bool
):
    """The first frames and all of a task are dark; and one frame between.

    said : their pixels are invalid; else all are alike, as where a camera is covered
    """
    dark = np.isin(np.arange(60), [*range(7), 13, *range(20, 48)])
    shut = part(0, 60, step_px=step_px)
    valid = np.broadcast_to(~dark[:, None, None], shut.amplitude.shape)
    kept = replace(shut, valid=valid) if said else replace(
        shut, amplitude=shut.amplitude * valid, distance_m=np.where(valid, shut.distance_m, 1)
    )  # fmt: skip
    film = write_recording(tmp_path / "film.nc", 60, [kept])
    found = reconstruct_recording(film, tmp_path / "sr.nc", every=every, psf_sigma_px=0.29)
    numbers = sequence_numbers(found.path)
    empty = [bool(dark[first : first + 4].all()) for first in numbers["first_frame"]]
    assert any(empty)
    for number, nothing in enumerate(empty):
        window = load_window(found.path, number)
        for one in window.channels.values():
            assert np.isnan(one.image).all() == nothing
            assert (one.status is Status.CONTRADICTED) or not nothing
    assert recording.NOTHING in " ".join(found.said)
    # Those of a whole task had no time, and in an MCAP file were decades before the others.
    np.testing.assert_allclose(numbers["time"], (numbers["first_frame"] + 1.5) / 50.0)
    # Its frames are those of the window alone, no dark place has one of a window before.
    number = int(np.flatnonzero(numbers["first_frame"] <= 13)[-1])
    first = int(numbers["first_frame"][number])
    window = range(first, first + 4)
    alone = lensshift.reconstruct(replace(shut, valid=valid).select(window), psf_sigma_px=0.29)
    got = load_window(found.path, number).amplitude
    assert np.sqrt(np.mean((got.image - alone.amplitude.image) ** 2)) < 0.005


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ({"window": 0}, "from 1"),
        ({"window": 4, "every": 0}, "from 1"),
        ({"window": 99}, "expected at least 99 frames, got 46"),
        ({"window": 4, "method": "none"}, "none"),
        ({"window": 4, "bananas": 3}, "bananas"),
        ({"window": 4, "pace": "fast"}, "pace"),
    ],
)
def test_wrong_settings_begin_nothing(film: Path, tmp_path: Path, said: dict, wrong: str):
    with pytest.raises(ValueError, match=wrong):
        reconstruct_recording(film, tmp_path / "sr.nc", **said)
    assert [path.name for path in tmp_path.iterdir()] == ["film.nc"]


@pytest.mark.filterwarnings("ignore")  # those of dask when it ends
def test_a_cluster_gives_the_same_file(film: Path, tmp_path: Path):
    distributed = pytest.importorskip("distributed")
    whole = reconstruct_recording(film, tmp_path / "whole.nc", window=4, every=1)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        found = reconstruct_recording(
            film, tmp_path / "sr.nc", window=4, every=1, scheduler=cluster.scheduler_address
        )
    expected, got = pictures(whole.path), pictures(found.path)
    for name, values in expected.items():
        np.testing.assert_array_equal(got[name], values, err_msg=name)


def test_workers_keep_the_memory_that_they_free():
    """To hand each back took them a sixth of their time; all else stays as dask has it."""
    pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    place = "distributed.nanny.pre-spawn-environ"
    usual = dask.config.get(place)
    with dask.config.set(recording._of_workers()):
        told = dask.config.get(place)
    assert set(usual) - set(told) == {"MALLOC_TRIM_THRESHOLD_"}
    assert told.items() <= usual.items()


@pytest.mark.parametrize("wrong", ["here", "ftp://here:1", "tcp://127.0.0.1"])
def test_what_is_no_address_of_a_scheduler_is_refused_at_once(
    film: Path, tmp_path: Path, wrong: str
):
    pytest.importorskip("distributed")
    with pytest.raises(ValueError, match=r"as in tcp://10\.0\.0\.5:8786: (missing|unknown)"):
        reconstruct_recording(film, tmp_path / "sr.nc", window=4, scheduler=wrong)


@pytest.mark.slow  # workers are processes that import everything
@pytest.mark.filterwarnings("ignore")  # those of dask while a worker dies
def test_workers_that_die_at_every_try_are_told_and_what_was_done_is_kept(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(recording, "RETRIES", 0)
    dask = pytest.importorskip("dask")
    out = tmp_path / "sr.nc"
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:  # fmt: skip

        def kill(done: int, total: int) -> None:
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        with pytest.raises(RuntimeError, match=r"died 1 times at the same task.*kept"):
            reconstruct_recording(
                film, out, window=4, every=1, scheduler=cluster.scheduler_address, on_progress=kill
            )
    assert reconstruct_recording(film, out, window=4, every=1).resumed > 0


@pytest.mark.slow  # its two workers are processes that import everything
@pytest.mark.filterwarnings("ignore")  # those of dask while a worker dies
def test_workers_give_the_same_file_though_one_is_killed(film: Path, tmp_path: Path):
    distributed = pytest.importorskip("distributed")
    whole = reconstruct_recording(film, tmp_path / "whole.nc", window=4, every=1)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        victim = next(iter(cluster.workers.values())).pid
        killed = threading.Event()

        def kill(done: int, total: int) -> None:
            if not killed.is_set():
                os.kill(victim, signal.SIGKILL)
                killed.set()
                time.sleep(0.2)

        found = reconstruct_recording(
            film, tmp_path / "sr.nc", window=4, every=1,
            scheduler=cluster.scheduler_address, on_progress=kill,
        )  # fmt: skip
        assert killed.is_set()
    expected, got = pictures(whole.path), pictures(found.path)
    for name, values in expected.items():
        np.testing.assert_array_equal(got[name], values, err_msg=name)


def test_the_command(film: Path, tmp_path: Path):
    out = tmp_path / "sr.nc"
    asked = ["reconstruct", str(film), "--window", "4", "--channel", "amplitude", "-o", str(out)]
    found = CliRunner().invoke(app, asked)
    assert found.exit_code == 0, found.output
    assert "11 pictures of 4 frames, 11 made" in found.output
    assert CliRunner().invoke(app, ["info", str(out)]).output.count("windows     11") == 1
    for name in ("w.png", "w.mcap"):
        wanted = ["convert", str(out), str(tmp_path / name), "--window", "11"]
        assert CliRunner().invoke(app, wanted).output.startswith("error: ")
    cut = CliRunner().invoke(app, ["convert", str(out), str(tmp_path / "w.png"), "--window", "10"])
    assert cut.exit_code == 0, cut.output
    pytest.importorskip("mcap_ros2.writer", reason="mcap is not installed")
    stream = CliRunner().invoke(app, ["convert", str(out), str(tmp_path / "w.mcap")])
    assert stream.exit_code == 0, stream.output
    assert (tmp_path / "w.mcap").stat().st_size > 11 * 18 * 28
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 2
    assert "exists" in again.output


@pytest.mark.parametrize(
    ("told", "wrong"),
    [
        (["--every", "2"], "give --window"),
        (["--workers", "2"], "give --window"),
        (["--window", "4", "--frames", "0,1"], "--frames: not together with --window"),
        (["--window", "4", "--export", "a.png"], "--export: not together"),
        (["--window", "4", "-o", "a.png"], "netCDF file"),
        (["--window", "4", "--workers", "1", "--scheduler", "tcp://a:1"], "not both"),
        (["--window", "0"], "greater than or equal to 1"),
    ],
)
def test_the_command_refuses(film: Path, told: list[str], wrong: str):
    found = CliRunner().invoke(app, ["reconstruct", str(film), *told])
    assert found.exit_code == 2
    assert wrong in " ".join(found.output.split())


def test_a_sequence_is_no_burst(film: Path, tmp_path: Path):
    found = reconstruct_recording(film, tmp_path / "sr.nc", window=4)
    refused = CliRunner().invoke(app, ["reconstruct", str(found.path)])
    assert refused.exit_code == 1
    assert "expected a burst, got a sequence" in refused.output
    with pytest.raises(DataError, match="expected a window from 0 to 10"):
        load_window(found.path, 11)
