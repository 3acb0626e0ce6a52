"""Carry out an experiment and write everything about it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from lensshift.camera import TofTruth
from lensshift.core.errors import DataError
from lensshift.core.types import Reconstruction
from lensshift.io import save_burst, save_reconstruction
from lensshift.io.point_cloud_file import write_npz
from lensshift.pipeline.experiment import Experiment, Outcome, carry_out
from lensshift.pipeline.experiment_file import default_experiment, load_experiment


@dataclass(frozen=True, slots=True, eq=False)
class RunSummary:
    """What a run of the whole chain gave.

    Parameters
    ----------
    files : what was written: burst, truth, result, preview
    fidelity : method -> psnr_db, ssim and rmse of the amplitude against the truth, 4 HR px of
        border left out
    depth : method -> errors of the distance against the truth, see `depth_error`
    reconstruction : by the method asked for
    seconds : for everything
    """

    files: tuple[Path, ...]
    fidelity: dict[str, dict[str, float]]
    depth: dict[str, dict[str, float]]
    reconstruction: Reconstruction
    seconds: float


def run(
    out_dir: str | Path,
    *,
    config: str | Path | Experiment | None = None,
    scale: int | None = None,
    method: str | None = None,
    seed: int | None = None,
    on_iteration: Callable[[int, float], None] | None = None,
) -> RunSummary:
    """Simulate a burst, reconstruct it, compare it with the truth, and write all of it.

    Nothing is written before everything is computed.

    Parameters
    ----------
    out_dir : folder for burst.nc, truth.npz, result.nc and preview.png; made if it is missing
    config : an experiment or its TOML file; the four boxes that come with the package if None
    scale, method, seed : instead of those of the experiment, if given
    on_iteration : called with the number of an iteration (from 1) and the objective

    Raises
    ------
    DataError
        If the experiment cannot be read, or the folder or a file cannot be written.
    ValueError
        If there is no such method or scale.
    """
    start_s = time.perf_counter()
    folder = writable_folder(out_dir)
    if config is None:
        experiment = default_experiment()
    elif isinstance(config, Experiment):
        experiment = config
    else:
        experiment = load_experiment(config)
    given = {"scale": scale, "method": method, "seed": seed}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if method not in (None, experiment.method):
        changes["options"] = {}  # those of the other method
    experiment = replace(experiment, **changes)
    outcome = carry_out(experiment, on_iteration=on_iteration)
    files = _write(folder, experiment, outcome)
    compared, seconds = (outcome.fidelity, outcome.depth), time.perf_counter() - start_s
    return RunSummary(files, *compared, outcome.reconstruction, seconds)


def writable_folder(out_dir: str | Path) -> Path:
    """Complain before the work about a name that cannot become a folder."""
    folder = Path(out_dir)
    if folder.exists() and not folder.is_dir():
        raise DataError("expected a folder to write to, this is a file", source=folder)
    if folder.suffix.lower() == ".toml":
        raise DataError(
            "expected a folder to write to, this is the name of an experiment: give it as config",
            source=folder,
        )
    there = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        kind = "no permission to write to" if there.is_dir() else "this is a file:"
        raise DataError(f"cannot make the folder: {kind} {there}", source=folder)
    return folder


def made_folder(folder: Path) -> Path:
    """Make a folder to write to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make the folder: {error.strerror}", source=folder) from error
    return folder


def save_truth(truth: TofTruth, path: str | Path) -> None:
    """Write what an experimenter never gets to know as NPZ, one array per field; or a DataError."""
    names = [one.name for one in fields(truth) if one.name != "offset_field"]
    arrays = {name: getattr(truth, name) for name in names}
    if truth.offset_field is not None:
        arrays["offset_field_px"] = truth.offset_field.offset_px
    write_npz(path, arrays)


def _write(folder: Path, experiment: Experiment, outcome: Outcome) -> tuple[Path, ...]:
    from lensshift.report.preview import save_shots

    made_folder(folder)
    names = ("burst.nc", "truth.npz", "result.nc", "preview.png")
    burst_file, truth_file, result_file, preview = files = tuple(folder / name for name in names)
    save_burst(outcome.capture.burst, burst_file)
    save_truth(outcome.capture.truth, truth_file)
    save_reconstruction(outcome.reconstruction, result_file)
    truth = outcome.capture.truth
    labels = {"nearest": "one frame, as it is", "bicubic": "one frame, bicubic"}
    labels.setdefault(experiment.method, f"{experiment.method} x{experiment.scale}")
    shown = {labels[name]: images for name, images in outcome.images.items()}
    shown["truth"] = {"amplitude": truth.amplitude, "distance": truth.distance_m}
    title = f"{experiment.name or 'experiment'}: {len(experiment.pattern_px)} frames"
    save_shots(shown, title, preview)
    return files
