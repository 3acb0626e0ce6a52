"""Every bad file is a one-line DataError that names file and field."""

import os
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_burst_file import assert_same, make_burst

from lensshift.core.atomic import written_whole
from lensshift.core.errors import DataError, printable
from lensshift.io import load_burst, save_burst

Edit = Callable[[h5py.Group], None]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("burst") / "good.nc"
    save_burst(make_burst(), path)
    return path


@contextmanager
def edited(good: Path, path: Path) -> Iterator[h5py.Group]:
    """Let the block change the data of a copy of the good file."""
    path.write_bytes(good.read_bytes())
    with h5py.File(path, "r+") as file:
        yield file["entry/data"]


def message_of_loading(path: Path) -> str:
    with pytest.raises(DataError) as caught:
        load_burst(path)
    message = str(caught.value)
    assert message.startswith(printable(str(path)))
    assert "\n" not in message
    assert len(message) < len(str(path)) + 300
    return message


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "empty"),
        (b"frame,row,col\n", "not a netCDF-4/HDF5 file"),
        (b"\x89HDF\r\n\x1a\n", "damaged or cut short"),
        (b"\x89HDF\r\n\x1a\n" + bytes(4000), "damaged or cut short"),
    ],
)
def test_other_content(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "bad.nc"
    path.write_bytes(content)
    assert said in message_of_loading(path)


def test_no_file_folder_pipe_or_impossible_name(tmp_path: Path) -> None:
    assert "no such file" in message_of_loading(tmp_path / "none.nc")
    assert "folder" in message_of_loading(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    assert "device or pipe" in message_of_loading(tmp_path / "pipe")
    assert "cannot read" in message_of_loading(tmp_path / ("x" * 400))
    assert "cannot read" in message_of_loading(Path("nul\0byte"))


def replace(name: str, values: object) -> Edit:
    def edit(data: h5py.Group) -> None:
        attributes = dict(data[name].attrs) if name in data else {}
        if name in data:
            del data[name]
        data[name] = values
        attributes.pop("DIMENSION_LIST", None)
        data[name].attrs.update({k: v for k, v in attributes.items() if k == "units"})

    return edit


def remove(name: str) -> Edit:
    return lambda data: data.__delitem__(name)


def attribute(name: str, value: object) -> Edit:
    return lambda data: data.attrs.__setitem__(name, value)


def attach(name: str, link: object) -> Edit:
    return lambda data: data.__setitem__(name, link)


def without(name: str) -> Edit:
    return lambda data: data.attrs.__delitem__(name)


CASES: dict[str, tuple[Edit, str]] = {
    "no schema": (without("schema"), "schema: "),
    "schema of others": (attribute("schema", "other/1"), "schema: expected a file of schema"),
    "another kind": (attribute("schema", "lensshift-reconstruction/1"), "lensshift-burst/1"),
    "schema number": (attribute("schema", 7), "schema: "),
    "odd version": (attribute("schema", "lensshift-burst/one"), "schema: "),
    "huge version": (attribute("schema", "lensshift-burst/" + "9" * 5000), "schema: "),
    "newer": (attribute("schema", "lensshift-burst/2"), "update lensshift"),
    "no amplitude": (remove("amplitude"), "amplitude: the variable is missing"),
    "no flags": (remove("flags"), "flags: the variable is missing"),
    "no offset": (remove("offset_row"), "offset_row: the variable is missing"),
    "half a stage": (remove("stage_col"), "stage_col: the variable is missing"),
    "no pitch": (without("pitch_mm"), "pitch_mm: "),
    "three pitches": (attribute("pitch_mm", np.ones(3)), "pitch_mm: "),
    "negative pitch": (attribute("pitch_mm", np.array([1.0, -1.0])), "pitch_mm: "),
    "no source": (without("offset_source"), "offset_source: "),
    "odd source": (attribute("offset_source", "guessed"), "offset_source: "),
    "text frequency": (attribute("modulation_hz", "fast"), "modulation_hz: "),
    "zero frequency": (attribute("modulation_hz", 0.0), "modulation_hz: "),
    "meta not JSON": (attribute("meta", "{"), "meta: not JSON"),
    "meta a list": (attribute("meta", "[1]"), "meta: "),
    "meta too deep": (attribute("meta", "[" * 60_000), "meta: "),
    "meta not text": (attribute("meta", 3.0), "meta: "),
    "all NaN": (replace("amplitude", np.full((3, 5, 7), np.nan)), "amplitude: every valid pixel"),
    "all invalid": (replace("flags", np.ones((3, 5, 7), "u1")), "valid: "),
    "zero size": (replace("amplitude", np.zeros((3, 0, 7))), "amplitude: expected values"),
    "empty dataset": (replace("amplitude", h5py.Empty("f4")), "amplitude: expected values"),
    "two dimensions": (replace("amplitude", np.zeros((5, 7))), "amplitude: expected [frame"),
    "text": (replace("amplitude", b"text"), "amplitude: expected numbers"),
    "other size": (replace("distance", np.zeros((3, 5, 8))), "distance_m: "),
    "infinite distance": (replace("distance", np.full((3, 5, 7), np.inf)), "distance_m: "),
    "flags of other size": (replace("flags", np.zeros((3, 5, 8), "u1")), "valid: "),
    "float flags": (replace("flags", np.zeros((3, 5, 7))), "flags: "),
    "too few offsets": (replace("offset_row", np.zeros(2)), "offset_col: "),
    "offset pairs": (replace("offset_row", np.zeros((3, 2))), "offset_col: "),
    "NaN offset": (replace("offset_row", np.full(3, np.nan)), "offset_px: expected finite"),
    "complex offset": (replace("offset_row", np.zeros(3, "c8")), "offset_row: "),
    "time of other size": (replace("time", np.zeros(4)), "time_s: "),
}


@pytest.mark.parametrize("case", CASES)
def test_file_that_contradicts_itself(good: Path, tmp_path: Path, case: str) -> None:
    edit, said = CASES[case]
    path = tmp_path / "bad.nc"
    with edited(good, path) as data:
        edit(data)
    assert said in message_of_loading(path)


def test_offsets_of_another_burst(good: Path, tmp_path: Path) -> None:
    path = tmp_path / "bad.nc"
    with edited(good, path) as data:
        for axis in ("row", "col"):
            replace(f"offset_{axis}", np.zeros(4))(data)
    assert "offset_px: expected shape (3, 2), got (4, 2)" in message_of_loading(path)


def test_hdf5_file_of_somebody_else(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.zeros(3)
    assert "entry/data: the group is missing" in message_of_loading(tmp_path / "other.h5")


def test_shape_that_the_stored_bytes_cannot_hold(good: Path, tmp_path: Path) -> None:
    path = tmp_path / "bomb.nc"
    with edited(good, path) as data:
        del data["amplitude"]
        data.create_dataset("amplitude", (10**6, 10**3, 10**3), "f8", chunks=(1, 100, 100))
    assert "cannot hold" in message_of_loading(path)


def test_frames_of_other_files_are_refused(good: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(b"TOP SECRET KEY" * 1000)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)  # whoever opens it to read waits for ever
    shape = (3, 5, 7)
    virtual = h5py.VirtualLayout(shape, "u2")
    virtual[:] = h5py.VirtualSource(str(good), "entry/data/amplitude", shape)
    edits: dict[str, Callable[[h5py.Group], object]] = {
        "external storage": lambda data: data.create_dataset(
            "amplitude", shape, "u2", external=[(str(secret), 0, 210)]
        ),
        "pipe": lambda data: data.create_dataset(
            "amplitude", shape, "u2", external=[(str(pipe), 0, 210)]
        ),
        "external link": attach("amplitude", h5py.ExternalLink(str(good), "entry/data/amplitude")),
        "link to a pipe": attach("amplitude", h5py.ExternalLink(str(pipe), "x")),
        "soft link": attach("amplitude", h5py.SoftLink("/entry/data/distance")),
        "virtual": lambda data: data.create_virtual_dataset("amplitude", virtual),
        "references": lambda data: data.create_dataset(
            "amplitude", data=np.full(shape, data.ref), dtype=h5py.ref_dtype
        ),
    }
    for name, edit in edits.items():
        path = tmp_path / f"{name}.nc"
        with edited(good, path) as data:
            del data["amplitude"]
            edit(data)
        assert "amplitude: expected" in message_of_loading(path), name


@pytest.mark.parametrize("group", ["entry", "entry/data"])
def test_groups_of_other_files_are_refused(good: Path, tmp_path: Path, group: str) -> None:
    path = tmp_path / "link.nc"
    with h5py.File(path, "w") as file:
        file[group] = h5py.ExternalLink(str(good), group)
    assert "got a link" in message_of_loading(path)


def test_a_small_file_does_not_unpack_without_bound(good: Path, tmp_path: Path) -> None:
    path = tmp_path / "bomb.nc"
    with edited(good, path) as data:
        del data["amplitude"]
        # Half a gigabyte of zeros in half a megabyte, as much as zlib can.
        chunk = zlib.compress(bytes(1 << 20), 9)
        flat = data.create_dataset(
            "amplitude", (512, 1 << 20), "u1", chunks=(1, 1 << 20), compression="gzip"
        )
        for k in range(512):
            flat.id.write_direct_chunk((k, 0), chunk)
    assert "bytes of memory for a file of" in message_of_loading(path)


def test_link_that_leads_nowhere(good: Path, tmp_path: Path) -> None:
    path = tmp_path / "link.nc"
    with edited(good, path) as data:
        del data["amplitude"]
        data["amplitude"] = h5py.SoftLink("/nowhere")
    assert "amplitude: " in message_of_loading(path)


def test_file_that_another_program_writes(good: Path, tmp_path: Path) -> None:
    path = tmp_path / "busy.nc"
    path.write_bytes(good.read_bytes())
    code = f"import sys, h5py; f = h5py.File({str(path)!r}, 'r+'); print('open'); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code.replace("print('open')", "print('open', flush=True)")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        try:
            assert "another program" in message_of_loading(path)
        finally:
            writer.communicate("\n")


@given(keep=st.floats(0, 1, exclude_max=True))
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_truncated_anywhere(good: Path, tmp_path: Path, keep: float) -> None:
    whole = good.read_bytes()
    path = tmp_path / "cut.nc"
    path.write_bytes(whole[: int(keep * len(whole))])
    message_of_loading(path)


@given(position=st.floats(0, 1, exclude_max=True), mask=st.integers(1, 255))
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_byte_is_noticed_or_harmless(
    good: Path, tmp_path: Path, position: float, mask: int
) -> None:
    content = bytearray(good.read_bytes())
    content[int(position * len(content))] ^= mask
    path = tmp_path / "flipped.nc"
    path.write_bytes(content)
    try:
        burst = load_burst(path)
    except DataError:
        message_of_loading(path)
    else:
        assert_same(burst, make_burst())


def test_damage_in_the_pixels_is_noticed(good: Path, tmp_path: Path) -> None:
    content = bytearray(good.read_bytes())
    with h5py.File(good) as file:
        dataset = file["entry/data/amplitude"]
        chunk = dataset.id.get_chunk_info(0)
    content[chunk.byte_offset + chunk.size // 2] ^= 1
    path = tmp_path / "flipped.nc"
    path.write_bytes(content)
    assert "amplitude: damaged" in message_of_loading(path)


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "burst.nc"
    save_burst(make_burst(), path)
    with pytest.raises(DataError):
        save_burst(make_burst(1, meta={"when": object()}), path)
    assert_same(load_burst(path), make_burst())
    assert list(tmp_path.iterdir()) == [path]


def write_half(path: Path, error: type[BaseException]) -> None:
    with written_whole(path) as temporary:
        temporary.write_text("half")
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_interrupted_write_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "burst.nc"
    path.write_text("old")
    with pytest.raises(error):
        write_half(path, error)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_targets_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for target in (tmp_path, tmp_path / "none" / "b.nc", tmp_path / "file" / "b.nc"):
        with pytest.raises(DataError, match="cannot write"):
            save_burst(make_burst(), target)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="device or pipe"):
        save_burst(make_burst(), tmp_path / "pipe")
    with pytest.raises(DataError, match="cannot write"):
        save_burst(make_burst(), tmp_path / ("x" * 400))
    with pytest.raises(DataError, match="cannot write"):
        save_burst(make_burst(), "nul\0byte.nc")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "pipe"]


def test_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "real.nc").write_text("old")
    (tmp_path / "link.nc").symlink_to(tmp_path / "real.nc")
    save_burst(make_burst(), tmp_path / "link.nc")
    assert (tmp_path / "link.nc").is_symlink()
    assert_same(load_burst(tmp_path / "real.nc"), make_burst())


FULL_DISK = """
import resource, sys
sys.dont_write_bytecode = True  # else what is left of it is cut off
import numpy as np
from lensshift.core.errors import DataError, printable
from lensshift.core.types import Burst
from lensshift.io import save_burst
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
frames = np.random.default_rng(0).random((4, 55, 77))
try:
    save_burst(Burst.from_arrays(frames, offset_px=np.zeros((4, 2)), pitch_mm=1.0), sys.argv[1])
except DataError as error:
    sys.exit(0 if "cannot write" in str(error) and "\\n" not in str(error) else 3)
sys.exit(4)
"""


def test_full_disk_leaves_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path / "burst.nc")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []
