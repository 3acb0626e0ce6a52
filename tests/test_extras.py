"""Without any extra the main commands work, and what does not says which extra brings it."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lensshift import Burst
from lensshift.cli.session import _EXTRAS
from lensshift.report.preview import _coloured, _save_plain

ROOT = Path(__file__).resolve().parents[1]

# Each part is a process of its own: what is imported once stays.
WITHOUT = """
import json, sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {extras}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
from typer.testing import CliRunner
from lensshift.cli.app import app
for arguments in {calls}:
    done = CliRunner().invoke(app, arguments)
    print(json.dumps([done.exit_code, done.stderr]))
"""


def without_extras(folder: Path, *calls: list[str]) -> list[tuple[int, str]]:
    code = WITHOUT.format(extras=set(_EXTRAS), calls=list(calls))
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True
    )
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]


def test_the_main_commands_need_no_extra(tmp_path: Path) -> None:
    config = str(ROOT / "examples" / "four_boxes.toml")
    ran, again, star, measured, blurred, late = without_extras(
        tmp_path,
        ["run", config, "--out", "out", "--method", "tikhonov"],
        ["reconstruct", "out/burst.nc", "-o", "sharp.nc", "--method", "bicubic"],
        ["simulate", "siemens_star", "-o", "star.nc"],
        ["evaluate", "star", "star.nc", "--cycles", "12", "--plot", "star.png"],
        ["reconstruct", "out/burst.nc", "--method", "deconvolution", "-o", "blurred.nc"],
        ["reconstruct", "out/burst.nc", "-o", "late.nc", "--export", "sky.fits"],
    )
    assert ran[0] == again[0] == star[0] == 0, (ran, again, star)
    for name in ("out/preview.png", "sharp_preview.png"):
        with Image.open(tmp_path / name) as drawn:
            assert np.asarray(drawn).std() > 20
    assert measured[0] == blurred[0] == 1
    assert "pip install 'lensshift[plot]'" in measured[1]
    assert "pip install 'lensshift[deconvolution]'" in blurred[1]
    assert "pip install 'lensshift[fits]'" in late[1]
    assert not (tmp_path / "late.nc").exists()  # said before the work


def test_a_plot_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'lensshift\[plot\]'"):
        Burst.from_arrays(np.ones((2, 5, 7))).plot()


def test_every_cure_names_an_extra_with_that_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(_EXTRAS.values()) <= set(project["optional-dependencies"])
    core = " ".join(project["dependencies"])
    assert not [name for name in ("matplotlib", "scikit-image", "xarray") if name in core]


def test_plain_preview_shows_what_is_there(tmp_path: Path) -> None:
    rising = np.tile(np.linspace(2.0, 4.0, 41), (23, 1))
    shown = {"a": {"amplitude": rising - 2}, "b": {"amplitude": rising, "distance": rising}}
    _save_plain(shown, "title", tmp_path / "plain.png")
    with Image.open(tmp_path / "plain.png") as page:
        pixels = np.asarray(page)
    assert pixels.shape[1] > pixels.shape[0]
    blue_to_yellow = _coloured(rising, 2.0, 4.0, "distance")
    assert tuple(blue_to_yellow[0, 0]) == (68, 1, 84)
    assert tuple(blue_to_yellow[0, -1]) == (253, 231, 37)
    matplotlib = pytest.importorskip("matplotlib")
    theirs = matplotlib.colormaps["viridis"](np.linspace(0, 1, 41))[:, :3]
    assert np.abs(blue_to_yellow[0] / 255 - theirs).max() < 0.04
