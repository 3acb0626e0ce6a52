"""`lensshift simulate` and `lensshift run CONFIG`: what they write and what they refuse."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stand_in import Call, Refused

from lensshift.io import load_burst, load_reconstruction

SMALL = """
[scene]
name = "slanted_edge"
[camera]
output = "float"
[camera.grid]
shape = [11, 13]
[reconstruction]
method = "bicubic"
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SMALL, encoding="utf-8")
    return file


def test_burst_with_truth_and_phases_beside_it(call: Call, small: Path, tmp_path: Path) -> None:
    out, phases = tmp_path / "edge.nc", tmp_path / "raw.npz"
    done = call(
        "simulate", "slanted_edge", "--camera", small, "-o", out, "--pattern", "3x3", "--scale", 3,
        "--phases", phases, "--seed", 5, "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["files"] == [str(out), str(tmp_path / "edge.truth.npz"), str(phases)]
    burst = load_burst(out)
    assert burst.amplitude.shape == (9, 11, 13)
    with np.load(tmp_path / "edge.truth.npz") as truth:
        assert truth["amplitude"].shape == truth["distance_m"].shape == (33, 39)
        assert truth["sharp_amplitude"].shape == truth["sharp_distance_m"].shape == (33, 39)
        error_px = truth["offset_px"] - burst.offset_px
    assert 0 < np.abs(error_px).max() < 0.1
    with np.load(phases) as raw:
        d = raw["difference"][:, 0]
        counts = 0.5 * np.hypot(d[:, 0] - d[:, 2], d[:, 1] - d[:, 3])
        electrons = counts * raw["electrons_per_count"]
        # The unit of the amplitude: a full tap in the long one of two exposures, 1 to 8.
        full = np.where(raw["exposure"] == 1, 5e5, 5e5 / 8)
    np.testing.assert_allclose(burst.amplitude, electrons / full, rtol=1e-6)


def test_reconstruct_says_that_the_burst_knows_its_blur(
    call: Call, small: Path, tmp_path: Path
) -> None:
    burst = tmp_path / "b.nc"
    assert ". is a folder; expected the name of" in call("simulate", "-o", ".").stderr
    assert call("simulate", "slanted_edge", "--camera", small, "-o", burst).exit_code == 0
    bicubic = "reconstruct", burst, "--method", "bicubic"
    assert "blur 0.224 px, as the burst says" in call(*bicubic).stdout
    assert "blur 0.4 px, as told" in call(*bicubic, "--psf-sigma-px", 0.4).stdout


def test_options_change_the_camera(call: Call, small: Path, tmp_path: Path) -> None:
    def taken(*options: object) -> Any:
        out = tmp_path / "b.nc"
        done = call("simulate", "slanted_edge", "--camera", small, "-o", out, *options)
        assert done.exit_code == 0, done.output
        return load_burst(out)

    still = "--pattern", "still"
    assert taken().frame_count == 4
    assert taken(*still).frame_count == 1
    again = taken("--ideal", *still, "--seed", 9, "--shift-error-px", 0)
    exact = taken("--ideal", *still, "--shift-error-px", 0)
    np.testing.assert_array_equal(again.amplitude, exact.amplitude)
    assert taken("--ambient-klx", 80, *still).meta["ambient"]["illuminance_klx"] == 80
    for element, told in ((2, 1), (0, None)):
        lens = "--lens", "petzval_a", "--element", element
        assert taken(*lens, *still).meta["optics"]["element"] == told


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["moon"], 1, "expected a scene file or one of four_boxes"),
        (["four_boxes", "--camera", "phone"], 1, "expected a camera of o3m151"),
        (["four_boxes", "-o", "burst.tif"], 2, "netCDF file"),
        (["four_boxes", "--phases", "raw.nc"], 2, "end in .npz"),
        (["four_boxes", "--lens", "petzval_a", "--element", "9"], 2, "from 1 to 3, got 9"),
        (["four_boxes", "--element", "2"], 2, "expected --lens with it"),
        (["four_boxes", "--ideal", "--ambient-klx", "50"], 2, "would do nothing"),
        (["four_boxes", "--pattern", "star"], 2, "square"),
        (["four_boxes", "-o", "none/burst.nc"], 1, "no folder"),
    ],
)
def test_nonsense_is_refused(refused: Refused, arguments: list[str], code: int, said: str) -> None:
    refused(["simulate", *arguments], code, said)


def test_run_carries_out_a_file(call: Call, small: Path, tmp_path: Path) -> None:
    done = call("run", small, "--out", tmp_path / "o", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert set(found["fidelity"]) == set(found["depth"]) == {"nearest", "bicubic"}
    result = load_reconstruction(tmp_path / "o" / "result.nc")
    assert result.grid.shape == (22, 26)
    assert call("run", tmp_path / "none.toml").exit_code == 1


def test_the_built_in_experiment_can_be_printed_and_run(call: Call, tmp_path: Path) -> None:
    done = call("run", "--print-config")
    assert done.exit_code == 0
    (tmp_path / "mine.toml").write_text(done.stdout, encoding="utf-8")
    from lensshift.pipeline import default_experiment, load_experiment

    assert load_experiment(tmp_path / "mine.toml").camera == default_experiment().camera


def test_info_says_what_simulate_reads_and_writes(call: Call, small: Path, tmp_path: Path) -> None:
    out, phases, scene = (tmp_path / name for name in ("b.nc", "raw.npz", "scene.toml"))
    done = call("simulate", "slanted_edge", "--camera", small, "-o", out, "--phases", phases)
    assert done.exit_code == 0, done.output
    truth = tmp_path / "b.truth.npz"
    told = json.loads(call("info", truth, "--json").stdout)
    assert told["arrays"]["sharp_distance_m"] == [22, 26]
    said = call("info", truth)
    assert said.exit_code == 0
    assert "holds the truth of a simulation" in said.stdout
    assert re.search(r"flying_in_frames +bool +4 x 11 x 13 +0 to ", said.stdout)
    assert "electrons_per_count" in call("info", phases).stdout
    assert call("info", phases, "--key", "nothing").exit_code == 1
    scene.write_text('[background]\nshape = "plane"\ncentre_m = [0, 0, 3]\n', encoding="utf-8")
    assert "scene, 1 shapes, for `lensshift simulate`" in call("info", scene).stdout
    assert "experiment, " in call("info", small).stdout
    scene.write_text('[background]\nshape = "plain"\n', encoding="utf-8")
    assert "expected shape of plane" in call("info", scene).stderr


def test_a_truth_is_no_burst(call: Call, small: Path, tmp_path: Path) -> None:
    call("simulate", "slanted_edge", "--camera", small, "-o", tmp_path / "b.nc")
    for more in ((), ("--key", "amplitude")):
        told = call("reconstruct", tmp_path / "b.truth.npz", *more, "-o", tmp_path / "r.nc")
        assert told.exit_code == 1
        assert "the truth of a simulation, no frames; expected the burst" in told.stderr
