"""The whole chain: what it writes, what it says, and what it leaves behind when it fails."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lensshift import fidelity, reconstruct
from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid
from lensshift.io import load_burst, load_reconstruction
from lensshift.pipeline import demo_burst, run
from lensshift.pipeline.experiment import carry_out, simulate
from lensshift.pipeline.experiment_file import default_experiment
from lensshift.scene import Cuboid, Plane, Scene


def test_run_writes_what_it_says_and_beats_the_yardsticks(tmp_path: Path) -> None:
    seen: list[int] = []
    summary = run(tmp_path / "a" / "b", on_iteration=lambda number, _: seen.append(number))
    names = ["burst.nc", "truth.npz", "result.nc", "preview.png"]
    assert [path.name for path in summary.files] == names
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == sorted(names)
    assert load_burst(summary.files[0]).amplitude.shape == (4, 16, 64)
    with np.load(summary.files[1]) as stored:
        truth, truth_m, offset_px = stored["amplitude"], stored["distance_m"], stored["offset_px"]
    result = load_reconstruction(summary.files[2])
    image = result.amplitude
    assert image is not None
    assert result.distance_m is not None
    assert image.image.shape == truth.shape == truth_m.shape == (32, 128)
    assert 0 < np.abs(offset_px - load_burst(summary.files[0]).offset_px).max() < 0.1
    inside = np.s_[4:-4, 4:-4]
    rmse = float(np.sqrt(np.mean((image.image[inside] - truth[inside]) ** 2)))
    assert rmse == pytest.approx(summary.fidelity["auto"]["rmse"], rel=1e-4)
    with Image.open(summary.files[3]) as picture:
        assert picture.width > 500
    psnr_db = {name: numbers["psnr_db"] for name, numbers in summary.fidelity.items()}
    assert set(psnr_db) == {"nearest", "bicubic", "auto"}
    assert psnr_db["auto"] > max(psnr_db["nearest"], psnr_db["bicubic"]) + 3
    edge_m = {name: numbers["edge_rmse_m"] for name, numbers in summary.depth.items()}
    assert edge_m["auto"] < 0.8 * edge_m["bicubic"] < edge_m["nearest"]
    assert seen
    assert summary.seconds > 0


def test_a_simulated_burst_is_reconstructed_as_well_as_by_run() -> None:
    experiment = default_experiment()
    capture = simulate(experiment)
    image = reconstruct(capture.burst, std=False).amplitude
    assert image is not None
    alone_db = fidelity(image.image, capture.truth.amplitude).psnr_db
    assert alone_db > carry_out(experiment).fidelity["auto"]["psnr_db"] - 0.5


@pytest.mark.parametrize("seed", [3, 4])
def test_distances_that_come_back_are_compared_in_the_turn_of_the_truth(seed: int) -> None:
    box = Cuboid(centre_m=(0.0, 0.1, 11.5), size_m=(0.8, 0.4, 0.3))
    scene = Scene((box,), Plane(centre_m=(0.0, 0.0, 12.4)))
    far = replace(default_experiment(), seed=seed, scene=scene, shift_error_px=0.0)
    with pytest.warns(QualityWarning, match=r"100 % of the valid pixels see beyond 9.993 m"):
        outcome = carry_out(far)
    assert outcome.depth["auto"]["flat_rmse_m"] < 0.03
    truth_m = outcome.capture.truth.distance_m
    assert np.median(np.abs(outcome.images["auto"]["distance"] - truth_m)) < 0.03
    told = outcome.reconstruction.distance_m
    assert told is not None
    assert told.image.max() < 9.993  # as the camera tells them


def test_same_seed_same_numbers() -> None:
    experiment = replace(default_experiment(), method="shift-and-add", options={})
    first, again, other = (carry_out(replace(experiment, seed=seed)).fidelity for seed in (1, 1, 2))
    assert first == again
    assert first["shift-and-add"] != other["shift-and-add"]


def test_a_yardstick_can_be_asked_for(tmp_path: Path) -> None:
    assert set(run(tmp_path, method="nearest").fidelity) == {"nearest", "bicubic"}


def test_nothing_is_left_behind_by_a_failure(tmp_path: Path) -> None:
    class StopError(Exception):
        pass

    def stop(iteration: int, objective: float) -> None:
        raise StopError

    with pytest.raises(StopError):
        run(tmp_path / "out", on_iteration=stop)
    with pytest.raises(ValueError, match="method"):
        run(tmp_path / "out", method="magic")
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(DataError, match=r"out.*file"):
        run(tmp_path / "out")
    with pytest.raises(DataError, match="cannot make the folder"):
        run(tmp_path / "out" / "deeper", method="nearest")
    assert (tmp_path / "out").read_text() == "mine"
    with pytest.raises(DataError, match="give it as config"):
        run(tmp_path / "mine.toml")


def test_demo_burst_takes_any_sensor() -> None:
    burst, truth = demo_burst(Grid((13, 9), (0.1, 0.2)), scale=3)
    assert burst.amplitude.shape == (4, 13, 9)
    assert truth.image.shape == (39, 27)
