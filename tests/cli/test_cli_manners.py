"""What people expect of a command line: completion, full help, a list of methods, patience."""

import json
import subprocess
import sys
import threading
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from stand_in import Call
from typer.testing import CliRunner

from lensshift.cli import session
from lensshift.cli.app import app
from lensshift.core.types import Burst
from lensshift.io import save_burst
from lensshift.reconstruction.methods import METHODS
from lensshift.reconstruction.reconstruct import reconstruct


def test_the_package_is_a_command(call: Call) -> None:
    module = [sys.executable, "-m", "lensshift", "--version"]
    done = subprocess.run(module, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("lensshift 0.")
    assert "--install-completion" in call("--help").stdout


@pytest.mark.parametrize(
    ("words", "offered"),
    [("lensshift rec", {"reconstruct"}), ("lensshift reconstruct --method ti", {"tikhonov"})],
)
def test_the_shell_is_told_how_a_word_goes_on(words: str, offered: set[str]) -> None:
    asked = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    asked["_LENSSHIFT_COMPLETE"] = "complete_bash"
    told = CliRunner().invoke(app, [], prog_name="lensshift", env=asked)
    assert set(told.stdout.split()) == offered


@pytest.mark.parametrize("group", [[], ["evaluate"], ["lens"], ["emulate"]], ids=str)
def test_no_description_is_cut(call: Call, group: list[str]) -> None:
    text = call(*group, "--help").stdout
    verbs = text.split("Commands:")[1]
    assert "..." not in verbs
    assert len(verbs.split()) > 20


def test_long_tables_are_shortened(call: Call, tmp_path: Path) -> None:
    offset_px = np.arange(400.0).reshape(200, 2) / 800
    burst = Burst.from_arrays(np.ones((200, 4, 5)), offset_px=offset_px, pitch_mm=0.1)
    save_burst(burst, tmp_path / "long.nc")
    said = call("info", tmp_path / "long.nc").stdout
    assert f"... and {200 - session.MOST_ROWS} more: --json has all of them" in said
    assert len(said.splitlines()) < session.MOST_ROWS + 20
    told = json.loads(call("info", tmp_path / "long.nc", "--json").stdout)
    assert len(told["offset_px"]) == 200


def test_methods_are_listed_with_their_options(call: Call) -> None:
    text = call("methods").stdout
    for name, method in METHODS.items():
        assert f"{name} " in text
        assert method.summary in text
    told = json.loads(call("methods", "--json").stdout)
    told.pop("warnings")
    assert list(told) == list(METHODS)
    for name, method in METHODS.items():
        options = told[name]["options"]
        assert [one["name"] for one in options] == [one.name for one in fields(method)]
        assert all(one["expected"] for one in options)
    one = call("methods", "tv").stdout
    assert "iterations=16" in one
    assert "tikhonov" not in one
    assert call("methods", "no-such").exit_code == 2


def test_every_option_of_a_method_is_in_its_docstring() -> None:
    for method in METHODS.values():
        for one in fields(method):
            if one.name != "prior_weight":
                assert one.name in (method.__doc__ or ""), (method.name, one.name)
    assert "prior_weight" in (reconstruct.__doc__ or "")


def test_waiting_says_so_and_stops(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "_QUIET_S", 0.02)
    monkeypatch.setattr(session, "_FILE_EVERY_S", 0.05)
    before = threading.active_count()
    with session.session(as_json=False, debug=False, doing="measuring") as current:
        time.sleep(0.4)
        current.say("done")
        said = capsys.readouterr()
        assert "measuring: 0 s" in said.err
        time.sleep(0.2)
    assert said.out == "done\n"
    assert capsys.readouterr().err == ""
    assert threading.active_count() == before
