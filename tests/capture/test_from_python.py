"""Devices of the user's own, named in a rig file; those of the documentation first."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lensshift import load_burst
from lensshift.capture.drivers import from_python
from lensshift.capture.opening import open_rig
from lensshift.cli.app import app
from lensshift.core.errors import DataError, DeviceError, DeviceTimeout

DOCS = Path(__file__).parents[2] / "docs" / "own-devices.md"


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Path]:
    """The rig file and the module of the documentation, in a folder of their own."""
    toml, python = re.findall(r"```(?:toml|python)\n(.*?)```", DOCS.read_text(), re.DOTALL)
    (tmp_path / "my_devices.py").write_text(python)
    (tmp_path / "rig.toml").write_text(toml)
    path = list(sys.path)
    yield tmp_path / "rig.toml"
    assert sys.path == path
    sys.modules.pop("my_devices", None)


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def module(rig: Path) -> Path:
    return rig.with_name("my_devices.py")


def test_the_devices_of_the_documentation_take_a_burst(rig: Path, tmp_path: Path) -> None:
    with open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")
        np.testing.assert_array_equal(opened.stage.position_mm(), [0.15, 0.15])
    burst = load_burst(tmp_path / "burst.nc")
    assert burst.meta["stage"]["name"] == "piezo at COM5"
    assert burst.meta["camera"]["settings"] == {"exposure_ms": 5.0}
    got = sorted(map(tuple, burst.offset_px.round(9).tolist()))
    assert got == [(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('port = "COM5"', "port = 5", r"rig\.toml: stage\.port: expected str, got 5"),
        ('port = "COM5"', "", r"rig\.toml: stage\.port: expected this entry, which is missing"),
        ("exposure_ms = 5.0", "exposure_ms = true", r"camera\.exposure_ms: expected float"),
        ("exposure_ms = 5.0", "gain = 2", r"camera\.gain: is not known, expected exposure_ms"),
        ('use = "my_devices:Piezo"', "", r"stage\.use: expected \"module:attribute\", got None"),
        ("my_devices:Piezo", "my_devices", r"stage\.use: expected \"module:attribute\""),
        ("my_devices:Piezo", "none_such:Piezo", r"stage\.use: ModuleNotFoundError: .*none_such"),
        ("my_devices:Piezo", "my_devices:Pizza", r"stage\.use: AttributeError: .*Pizza"),
        ("my_devices:Piezo", "my_devices:np", r"stage\.use: expected a class or function"),
        ("my_devices:camera", "my_devices:Piezo", r"camera\.exposure_ms: is not known"),
        ('"python"\nuse = "my_devices:P', '"pyton"\nuse = "my_devices:P', "expected apt or python"),
        ("rest_mm = [0.15, 0.15]", "rest_mm = [0.15]", r"calibration\.rest_mm: expected \[float"),
    ],
)
def test_a_wrong_rig_file_is_refused_in_a_line(rig: Path, old: str, new: str, said: str) -> None:
    change(rig, old, new)
    with pytest.raises(DataError, match=said) as caught:
        open_rig(rig)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return self._place_mm  #", "return [0.15, float('nan')]  #", "position_mm: expected"),
        ("return self._place_mm  #", "return 'there'  #", "position_mm: ValueError: could not"),
        ('return {"model": "piezo", ', "return 7, {", "piezo.*: describe: TypeError"),
        ("self._place_mm = position_mm", "np.load('/none')", "piezo.*: move_to: FileNotFoundError"),
        (
            "self._place_mm = position_mm",
            "from lensshift import Burst; Burst.from_arrays([[1.0]])",
            "piezo.*: move_to: DataError: ",
        ),
        ("self._place_mm = position_mm", "raise OSError('USB gone')", "piezo.*OSError: USB gone"),
        ("self._place_mm = position_mm", "raise SystemExit(3)", "piezo.*SystemExit: 3"),
        ("self._place_mm = position_mm", "import asyncio; raise asyncio.CancelledError", "Cancel"),
        ("self._place_mm = position_mm", "raise GeneratorExit", "move_to: GeneratorExit"),
        ("self._place_mm = position_mm", "float('x' * 5000)", "ValueError: .{200,300}$"),
        (
            "self._place_mm = position_mm",
            "raise type('Mute', (Exception,), {'__str__': lambda one: 1 / 0})",
            "move_to: Mute: <exception str",
        ),
        ("return self.position_mm()", "return None", "move_to: expected"),
        ("[[0.0, 0.3], [0.0, 0.3]]", "[[0.3, 0.0], [0.0, 0.3]]", "its travel_mm is empty"),
        ("[[0.0, 0.3], [0.0, 0.3]]", "[0.0, 0.3]", "travel_mm: expected"),
        ("np.array([0.15, 0.15])", "1 / 0", "my_devices:Piezo: ZeroDivisionError"),
        ("import numpy as np", "import none_such", "ModuleNotFoundError"),
        ('"""A stage', "(", "SyntaxError"),
        ("np.ones((48, 64))", "1 / 0", "ZeroDivisionError"),
    ],
)
def test_what_a_device_does_wrong_names_it(
    rig: Path, old: str, new: str, said: str, tmp_path: Path
) -> None:
    change(module(rig), old, new)
    with pytest.raises((DataError, DeviceError), match=said), open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")


HANG = "__import__('time').sleep(1e6)"


def test_a_move_that_never_ends_is_an_error_in_time(rig: Path, tmp_path: Path) -> None:
    change(
        module(rig),
        "self._place_mm = position_mm",
        f"position_mm[0] > 0.16 and {HANG}; self._place_mm = position_mm",
    )
    change(rig, 'port = "COM5"', 'port = "COM5"\nmove_timeout_s = 0.3')
    said = r"piezo at COM5: move_to: has not returned for 0\.3 s \(\[stage\] move_timeout_s\)"
    with pytest.raises(DeviceTimeout, match=said), open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")
    assert load_burst(tmp_path / "burst.nc").frame_count == 2


@pytest.mark.parametrize("what", ["def open(self", "def next_frame(self"])
def test_a_camera_that_hangs_is_an_error_in_time(
    rig: Path, what: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(from_python, "MOST_S", 0.3)
    hanging = f"class Hanging(CallableCamera):\n    {what}, *_): {HANG}\n\n\ndef camera("
    change(module(rig), "def camera(", hanging)
    change(module(rig), "    return CallableCamera(", "    return Hanging(")
    change(rig, "[calibration]", "[acquisition]\nframe_timeout_s = 0.1\n\n[calibration]")
    name = re.findall(r"\w+", what)[1]
    with (
        pytest.raises(DeviceTimeout, match=f"my camera: {name}: has not returned for 0"),
        open_rig(rig) as opened,
    ):
        opened.capture("square", tmp_path / "burst.nc")


@pytest.mark.parametrize(
    ("what", "old"),
    [
        ("stop", '"""Stand still at once'),
        ("close", '"""Let go of the device'),
        ("describe", '"""Return what to keep'),
        ("position_mm", '"""Return where the device'),
    ],
)
def test_whatever_hangs_is_an_error_in_time(
    rig: Path, what: str, old: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(from_python, "MOST_S", 0.3)
    change(module(rig), old, f"{HANG}\n        {old}")
    if what == "stop":  # is only called after something else; that is what is told
        change(module(rig), "self._place_mm = position_mm", "raise OSError('USB gone')")
    said = "OSError: USB gone" if what == "stop" else f"piezo at COM5: {what}: has not returned"
    with pytest.raises(DeviceError, match=said), open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")


def test_a_stage_is_stopped_while_its_move_hangs(rig: Path, tmp_path: Path) -> None:
    change(module(rig), "self._place_mm = position_mm", HANG)
    stopped = tmp_path / "stopped"
    old = '"""Stand still at once'
    change(module(rig), old, f"open({str(stopped)!r}, 'w').close()\n        {old}")
    change(rig, 'port = "COM5"', 'port = "COM5"\nmove_timeout_s = 0.3')
    with pytest.raises(DeviceTimeout, match="move_to"), open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")
    assert stopped.exists()


@pytest.mark.parametrize("told", ["0", "inf", "'long'"])
def test_a_time_for_moves_has_to_be_one(rig: Path, told: str) -> None:
    change(rig, 'port = "COM5"', f'port = "COM5"\nmove_timeout_s = {told}')
    with pytest.raises(DataError, match=r"rig\.toml: stage\.move_timeout_s: expected"):
        open_rig(rig)


def test_what_devices_print_is_no_json(rig: Path) -> None:
    change(module(rig), "    def grab():", "    def grab():\n        print('grabbing')")
    change(
        module(rig),
        "        self._settle_ms =",
        "        print('opened')\n        self._settle_ms =",
    )
    done = CliRunner().invoke(app, ["info", str(rig), "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout)["stage"]["name"] == "piezo at COM5"
    assert "grabbing" in done.stderr
    assert "opened" in done.stderr


def test_what_a_device_says_of_itself_is_kept_as_text(rig: Path, tmp_path: Path) -> None:
    telling = "from datetime import date; return {'since': date(2026, 5, 4), 'gain': np.float32(2)}"
    change(module(rig), "return {", f"{telling}\n        return {{")
    with open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")
    told = load_burst(tmp_path / "burst.nc").meta["stage"]
    assert (told["since"], told["gain"]) == ("2026-05-04", 2.0)


def test_what_is_no_device_says_what_it_lacks(rig: Path) -> None:
    change(module(rig), "def stop", "def halt")
    with pytest.raises(DataError, match=r"stage\.use: .*makes no stage: it lacks stop"):
        open_rig(rig)


def test_a_target_out_of_travel_is_refused_before_it_moves(rig: Path, tmp_path: Path) -> None:
    change(rig, "rest_mm = [0.15, 0.15]", "rest_mm = [0.02, 0.15]")
    with open_rig(rig) as opened, pytest.raises(ValueError, match="is out of travel"):
        opened.capture("square", tmp_path / "burst.nc")
    with open_rig(rig) as opened, pytest.raises(ValueError, match="expected a position"):
        opened.stage.move_to([0.1, 0.4])


def test_leave_to_home_is_asked_of_who_opens_the_rig(rig: Path) -> None:
    change(module(rig), "settle_ms: float = 20.0)", 'home: str = "ask", on_homing=None)')
    change(module(rig), "self._settle_ms = settle_ms", 'self._settle_ms = on_homing("3 mm", True)')
    asked = []

    def answer(way: str, ask: bool) -> bool:
        asked.append((way, ask))
        return True

    open_rig(rig, on_homing=answer).close()
    assert asked == [("3 mm", True)]


def test_frames_of_another_shape_or_cycle_are_refused(rig: Path) -> None:
    text = module(rig).read_text()
    repeating = """
class Repeating(CallableCamera):
    def next_frame(self, timeout_s):
        from dataclasses import replace
        return replace(super().next_frame(timeout_s), cycle=7)

"""
    text = text.replace("\ndef camera", repeating + "\ndef camera")
    module(rig).write_text(text.replace("return CallableCamera", "return Repeating"))
    with open_rig(rig) as opened:
        opened.camera.next_frame(5.0)
        with pytest.raises(DeviceError, match="expected a cycle after 7, got 7"):
            opened.camera.next_frame(5.0)


def test_a_counter_that_lags_behind_the_frames_is_refused(rig: Path, tmp_path: Path) -> None:
    """By it frames that were exposed before the lens moved would pass for later ones."""
    lagging = """
class Lagging(CallableCamera):
    def newest_cycle(self):
        return 0

"""
    text = module(rig).read_text().replace("\ndef camera", lagging + "\ndef camera")
    module(rig).write_text(text.replace("return CallableCamera", "return Lagging"))
    said = r"my camera: newest_cycle: expected \d+, of the last frame, or more, got 0"
    with pytest.raises(DeviceError, match=said), open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")


def test_a_name_that_cannot_be_had_is_told_by_the_rig_file(rig: Path) -> None:
    name = "@property\n    def name(self):\n        raise OSError('USB gone')\n\n    def stop"
    change(module(rig), "def stop", name)
    change(module(rig), "self.name = f", "self._named = f")
    with pytest.raises(DeviceError, match="my_devices:Piezo: name: OSError: USB gone"):
        open_rig(rig)


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        ("np.ones((48, 64), bool), None, None, 0.0", "expected an amplitude .* of numbers"),
        ("amplitude, None, None, float('nan')", "expected a finite time_s"),
        ("amplitude, amplitude, amplitude[0], 0.0", "valid: expected"),
    ],
)
def test_frames_of_a_camera_of_its_own_are_looked_at_as_they_come(
    rig: Path, frame: str, said: str, tmp_path: Path
) -> None:
    text = module(rig).read_text()
    own = f"""
class Own(CallableCamera):
    def next_frame(self, timeout_s):
        from dataclasses import replace
        from lensshift.core.types import Frame
        amplitude = np.ones((48, 64))
        return replace(super().next_frame(timeout_s), frame=Frame({frame}))

"""
    text = text.replace("\ndef camera", own + "\ndef camera")
    module(rig).write_text(text.replace("return CallableCamera", "return Own"))
    with open_rig(rig) as opened, pytest.raises((DataError, DeviceError), match=said):
        opened.capture("square", tmp_path / "burst.nc")


@pytest.mark.parametrize(
    ("name", "body", "said"),
    [
        ("grid", "raise OSError('USB gone')", "OSError: USB gone"),
        ("grid", "return (48, 64)", "grid: expected a Grid, got tuple"),
        ("modulation_hz", "return '100 MHz'", "ValueError: could not convert string"),
        ("intrinsics", "raise KeyError('lens')", "KeyError: 'lens'"),
    ],
)
def test_what_a_camera_says_of_itself_is_checked(
    rig: Path, name: str, body: str, said: str, tmp_path: Path
) -> None:
    text = module(rig).read_text()
    telling = f"""
class Telling(CallableCamera):
    @property
    def {name}(self):
        {body}

    @{name}.setter
    def {name}(self, value):
        pass

"""
    text = text.replace("\ndef camera", telling + "\ndef camera")
    module(rig).write_text(text.replace("return CallableCamera", "return Telling"))
    with pytest.raises(DeviceError, match=said), open_rig(rig) as opened:
        opened.capture("square", tmp_path / "burst.nc")
