"""What the tests of the command line share."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from stand_in import Call, FakeReconstruct, Refused
from typer.testing import CliRunner, Result

import lensshift
from lensshift.cli.app import app
from lensshift.core.types import Burst
from lensshift.io import save_burst


@pytest.fixture
def drawn() -> None:
    """Let previews be drawn by matplotlib."""


@pytest.fixture(autouse=True)
def previews_are_plain(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write previews as without matplotlib: drawn, they take most of the time of a call."""
    if "drawn" not in request.fixturenames:
        for name in ("result", "shots"):
            monkeypatch.setitem(sys.modules, f"lensshift.report.{name}", None)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeReconstruct:
    stand_in = FakeReconstruct()
    monkeypatch.setattr(lensshift, "reconstruct", stand_in)
    return stand_in


@pytest.fixture
def burst() -> Burst:
    rng = np.random.default_rng(0)
    return Burst.from_arrays(
        rng.random((4, 5, 7)),
        rng.random((4, 5, 7)) + 3,
        offset_px=[[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]],
        offset_sigma_px=np.full((4, 2), 0.01),
        pitch_mm=(0.15, 0.1),
        modulation_hz=20e6,
        meta={"camera": "simulated"},
    )


@pytest.fixture
def burst_file(burst: Burst, tmp_path: Path) -> Path:
    save_burst(burst, tmp_path / "burst.nc")
    return tmp_path / "burst.nc"


@pytest.fixture
def call() -> Call:
    """Return a function that runs `lensshift` with arguments."""

    def run(*arguments: object) -> Result:
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return run


@pytest.fixture
def refused(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Refused:
    """Return a function that checks that arguments are refused before anything is written."""

    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def check(arguments: Sequence[object], code: int, said: str) -> None:
        before = files()
        done = call(*arguments)
        assert done.exit_code == code, done.output
        assert said in " ".join(done.stderr.replace("│", " ").split())
        assert files() == before

    monkeypatch.chdir(tmp_path)
    return check
