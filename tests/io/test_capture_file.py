"""A journal keeps every whole frame, whatever happens to its writer."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensshift import load_burst, save_burst
from lensshift.core.errors import DataError
from lensshift.io.capture_file import CaptureWriter, FrameRecord, is_capture, read_capture

HEADER = {"pitch_mm": [0.15, 0.155], "modulation_hz": 15e6, "meta": {"camera": "none"}}
SHAPE = (3, 5)


def frame(number: int, **others: Any) -> FrameRecord:
    fields: dict[str, Any] = {
        "step": number,
        "amplitude": np.full(SHAPE, 1.0 + number),
        "distance_m": np.full(SHAPE, 2.0),
        "valid": np.ones(SHAPE, dtype=bool),
        "offset_px": np.array([0.0, 0.25 * number]),
        "stage_mm": np.array([3.0, 3.0]),
        "stage_commanded_mm": np.array([3.0, 3.0]),
        "time_s": 0.04 * number,
        "raw": {"confidence": np.full(SHAPE, number, dtype=np.uint16), "factor": np.arange(4.0)},
    }
    return FrameRecord(**{**fields, **others})


def written(path: Path, count: int) -> Path:
    with CaptureWriter.create(path, HEADER) as file:
        for number in range(count):
            file.append(frame(number))
    return path


def test_an_unfinished_capture_is_a_burst(tmp_path: Path) -> None:
    burst = load_burst(written(tmp_path / "a.nc", 3))
    assert burst.frame_count == 3
    assert burst.grid.pitch_mm == (0.15, 0.155)
    assert burst.modulation_hz == 15e6
    np.testing.assert_array_equal(burst.amplitude[2], 3.0)
    np.testing.assert_array_equal(burst.raw["confidence"][1], 1)
    assert burst.meta["step"] == [0, 1, 2]


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"distance_m": None}, "distance_m: only some of the frames have it"),
        ({"amplitude": np.ones((3, 4))}, r"amplitude: expected a shape of \(3, 5\)"),
        ({"raw": {"factor": np.arange(3.0)}}, r"raw_factor: expected a shape of \(4,\)"),
        ({"raw": {"note": np.array("warm")}}, "raw_note: cannot store dtype <U4"),
        ({"raw": {"gain": np.array({"iso": 100})}}, "raw_gain: cannot store dtype object"),
    ],
)
def test_a_frame_that_makes_no_burst_with_the_others_is_refused_at_once(
    tmp_path: Path, others: dict[str, Any], said: str
) -> None:
    path = written(tmp_path / "a.nc", 2)
    with CaptureWriter.resume(path) as file:
        with pytest.raises(DataError, match=f"a.nc: {said}"):
            file.append(frame(2, **others))
        file.append(frame(2))
    assert load_burst(path).distance_m is not None
    assert load_burst(path).frame_count == 3


def test_what_the_camera_sent_stays_in_the_burst_file(tmp_path: Path) -> None:
    burst = load_burst(written(tmp_path / "a.nc", 2))
    save_burst(burst, tmp_path / "b.nc")
    again = load_burst(tmp_path / "b.nc")
    assert set(again.raw) == {"confidence", "factor"}
    np.testing.assert_array_equal(again.raw["confidence"], burst.raw["confidence"])
    assert again.raw["confidence"].dtype == np.uint16
    np.testing.assert_array_equal(again.select([1]).raw["factor"], [np.arange(4.0)])


@settings(deadline=None)
@given(cut=st.integers(0, 10**6))
def test_every_whole_frame_survives_a_cut_anywhere(
    cut: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = written(tmp_path_factory.mktemp("cut") / "a.nc", 3)
    data = path.read_bytes()
    ends = [len(written(path.with_name(f"{n}.nc"), n).read_bytes()) for n in range(4)]
    cut = min(cut, len(data)) if cut < ends[-1] else cut % (len(data) + 1)
    path.write_bytes(data[:cut])
    whole = sum(end <= cut for end in ends) - 1
    if whole < 0:
        with pytest.raises(DataError, match=r"a\.nc"):
            read_capture(path)
        return
    assert len(read_capture(path)[1]) == whole
    with CaptureWriter.resume(path) as file:
        for number in range(whole, 3):
            file.append(frame(number))
    assert path.read_bytes() == data


@settings(deadline=None)
@given(place=st.integers(0, 10**6), value=st.integers(0, 255))
def test_damage_never_becomes_numbers(
    place: int, value: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = written(tmp_path_factory.mktemp("hit") / "a.nc", 2)
    data = bytearray(path.read_bytes())
    data[place % len(data)] = value
    path.write_bytes(data)
    try:
        _, frames = read_capture(path)
    except DataError:
        return
    for number, one in enumerate(frames):
        np.testing.assert_array_equal(one.amplitude, 1.0 + number)


def test_a_killed_writer_loses_nothing_that_append_had_taken(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    program = """
        import os, sys, numpy as np
        from lensshift.io.capture_file import CaptureWriter, FrameRecord
        with CaptureWriter.create(sys.argv[1], {"pitch_mm": [0.1, 0.1]}) as file:
            for number in range(5):
                file.append(FrameRecord(
                    step=number, amplitude=np.ones((3, 5)), valid=np.ones((3, 5), bool),
                    offset_px=np.zeros(2), time_s=0.0,
                ))
            os.kill(os.getpid(), 9)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program), str(path)], check=False)
    assert done.returncode != 0
    assert load_burst(path).frame_count == 5
    with CaptureWriter.resume(path) as file:  # the lock died with its process
        assert len(file.frames) == 5


def test_a_second_writer_is_refused_and_a_reader_is_not(tmp_path: Path) -> None:
    with CaptureWriter.create(tmp_path / "a.nc", HEADER) as file:
        file.append(frame(0))
        with pytest.raises(DataError, match="another process is writing"):
            CaptureWriter.resume(tmp_path / "a.nc")
        assert load_burst(tmp_path / "a.nc").frame_count == 1


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on file sizes there")
def test_a_full_disk_keeps_the_frames_before(tmp_path: Path) -> None:
    import resource
    import signal

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    path = tmp_path / "a.nc"
    try:
        with CaptureWriter.create(path, HEADER) as file:
            file.append(frame(0))
            resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 500, hard))
            with pytest.raises(DataError, match="the 1 frames before are kept"):
                file.append(frame(1))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    with CaptureWriter.resume(path) as file:
        file.append(frame(1))
    assert load_burst(path).frame_count == 2


def test_names_that_are_taken_or_wrong(tmp_path: Path) -> None:
    path = written(tmp_path / "a.nc", 0)
    with pytest.raises(DataError, match="there is a file of this name"):
        CaptureWriter.create(path, HEADER)
    with pytest.raises(DataError, match="no whole frame"):
        load_burst(path)
    (tmp_path / "text").write_text("no journal")
    assert not is_capture(tmp_path / "text")
    assert not is_capture(tmp_path / "missing")
    with pytest.raises(DataError, match="expected an unfinished capture"):
        CaptureWriter.resume(tmp_path / "text")
    with pytest.raises(DataError, match="expected the journal"):
        read_capture(tmp_path / "text")
    with pytest.raises(DataError, match="no folder"):
        CaptureWriter.create(tmp_path / "no" / "a.nc", HEADER)


def test_neither_a_pipe_nor_a_frame_that_unpacks_stops_a_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")  # whoever opens it to read waits for ever
    with pytest.raises(DataError, match="device or pipe"):
        read_capture(tmp_path / "pipe")
    monkeypatch.setattr(np, "savez", np.savez_compressed)
    with CaptureWriter.create(tmp_path / "a.nc", HEADER) as file:
        file.append(frame(0, amplitude=np.zeros((500, 500))))
    with pytest.raises(DataError, match="more than is stored"):
        read_capture(tmp_path / "a.nc")


def test_frames_that_do_not_fit_together(tmp_path: Path) -> None:
    path, other = written(tmp_path / "a.nc", 1), written(tmp_path / "b.nc", 0)
    begun = other.stat().st_size
    with CaptureWriter.resume(other) as file:
        file.append(frame(1, amplitude=np.ones((2, 2))))
    path.write_bytes(path.read_bytes() + other.read_bytes()[begun:])
    with pytest.raises(DataError, match="contradicts itself"):
        load_burst(path)
    arrays = frame(0).arrays()
    with pytest.raises(DataError, match="valid: a frame lacks this field"):
        FrameRecord.of_arrays({name: one for name, one in arrays.items() if name != "valid"})
    with pytest.raises(DataError, match="time_s: expected a number"):
        FrameRecord.of_arrays(arrays | {"time_s": np.ones(2)})
