"""The examples run as their readers will run them."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run_example(*arguments: object) -> str:
    command = [sys.executable, "-W", "error", *(str(argument) for argument in arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_quickstart_prints_methods_in_order_of_quality() -> None:
    lines = run_example(EXAMPLES / "quickstart.py").splitlines()
    psnr_db = {line.split()[0]: float(line.split()[2]) for line in lines[:3]}
    assert psnr_db["auto"] > psnr_db["bicubic"] + 3
    assert psnr_db["auto"] > psnr_db["nearest"] + 3


@pytest.mark.slow
def test_eia_chart_predicts_the_other_frames(reference_dir: Path, tmp_path: Path) -> None:
    frames, picture = reference_dir / "real_sequences" / "mdsp_eia.npz", tmp_path / "chart.png"
    lines = run_example(EXAMPLES / "eia_chart.py", frames, "--out", picture).splitlines()
    rms = {line.split()[0]: float(line.split()[1]) for line in lines[:3]}
    assert rms["auto"] <= 7.4
    assert rms["auto"] < rms["shift-and-add"] < rms["bicubic"]
    with Image.open(picture) as drawn:
        assert np.asarray(drawn).std() > 20


@pytest.mark.slow
def test_own_camera_captures_a_burst(tmp_path: Path) -> None:
    lines = run_example(EXAMPLES / "own_camera.py", tmp_path).splitlines()
    assert lines[0].startswith("4 frames")
    assert lines[-1] == "auto x2: 32 x 128 px"
    assert (tmp_path / "burst.nc").exists()


@pytest.mark.slow
def test_flat_wall_is_bent_only_where_distances_are_taken_for_depth(tmp_path: Path) -> None:
    lines = run_example(EXAMPLES / "flat_wall.py", "--out", tmp_path / "wall.ply").splitlines()
    rms_mm = [float(line.split("mm rms")[0].split()[-1]) for line in lines[:2]]
    assert rms_mm[0] > 5.0 > 1.0 > rms_mm[1]
    assert (tmp_path / "wall.ply").read_bytes().startswith(b"ply")


@pytest.mark.slow
def test_phasors_of_two_frequencies_are_better_than_their_distances() -> None:
    lines = run_example(EXAMPLES / "two_frequencies.py").splitlines()
    edge_mm = [float(line.split()[1]) for line in lines[1:3]]
    assert edge_mm[1] < 0.9 * edge_mm[0]
    assert edge_mm[1] < 140.0


@pytest.mark.slow
def test_a_stream_sharpens_and_starts_again_with_another_scene() -> None:
    lines = [line.split() for line in run_example(EXAMPLES / "live_stream.py").splitlines()]
    close_db = [float(words[2]) for words in lines]
    assert close_db[3] > close_db[0] + 5
    assert close_db[15] > close_db[10] + 3
    assert [words[7:] for words in lines if words[7:]] == [["scene", "changed"]]
    assert [words[4] for words in lines[3:8]] == ["refined", "live", "live", "live", "refined"]
