"""The whole chain in one file: the only place that knows the order.

target -> camera -> burst -> reconstruction -> comparison with the truth -> files
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lensshift.camera import Sensor, Truth, simulate_burst
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.types import Burst, Reconstruction
from lensshift.evaluation import fidelity
from lensshift.io import export_image, save_burst, save_reconstruction
from lensshift.io.preview import write_preview
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.scene import demo_target

# A ToF sensor of 64 x 16 pixels, as (rows, cols).
DEMO_GRID = Grid((16, 64), (0.155, 0.155))
_YARDSTICKS = ("nearest", "bicubic")


@dataclass(frozen=True, slots=True, eq=False)
class RunSummary:
    """What a run of the whole chain gave.

    Parameters
    ----------
    files : what was written: burst, truth, result, preview
    fidelity : method -> psnr_db, ssim and rmse against the truth, 4 HR px of border left out
    reconstruction : by the method asked for
    seconds : for everything
    """

    files: tuple[Path, ...]
    fidelity: dict[str, dict[str, float]]
    reconstruction: Reconstruction
    seconds: float


def demo_burst(grid: Grid = DEMO_GRID, *, scale: int = 2, seed: int = 0) -> tuple[Burst, Truth]:
    """Return a simulated burst of the demo target, and what nobody knows on a bench."""
    rows_mm, cols_mm = (
        count * pitch for count, pitch in zip(grid.shape, grid.pitch_mm, strict=True)
    )
    return simulate_burst(demo_target((rows_mm, cols_mm)), Sensor(grid), scale=scale, seed=seed)


def run(
    out_dir: str | Path,
    *,
    scale: int = 2,
    method: str = "auto",
    seed: int = 0,
    on_iteration: Callable[[int, float], None] | None = None,
) -> RunSummary:
    """Simulate a burst, reconstruct it, compare it with the truth, and write all of it.

    Nothing is written before everything is computed.

    Parameters
    ----------
    out_dir : folder for burst.nc, truth.tif, result.nc and preview.png; made if it is missing
    on_iteration : called with the number of an iteration (from 1) and the objective

    Raises
    ------
    DataError
        If the folder or a file cannot be written.
    ValueError
        If there is no such method or scale.
    """
    start_s = time.perf_counter()
    folder = _writable_folder(out_dir)
    burst, truth = demo_burst(scale=scale, seed=seed)
    result = reconstruct(burst, scale, method, seed=seed, on_iteration=on_iteration)
    images: dict[str, Any] = {
        name: _image(reconstruct(burst, scale, name, std=False)) for name in _YARDSTICKS
    }
    images[method] = _image(result)
    compared = {name: asdict(fidelity(image, truth.image)) for name, image in images.items()}
    files = _write(folder, burst, truth, result, images)
    return RunSummary(files, compared, result, time.perf_counter() - start_s)


def _image(result: Reconstruction) -> Any:
    if result.amplitude is None:
        raise ValueError("expected a reconstruction with an amplitude image, got none")
    return result.amplitude.image


def _writable_folder(out_dir: str | Path) -> Path:
    """Complain before the work about a name that cannot become a folder."""
    folder = Path(out_dir)
    if folder.exists() and not folder.is_dir():
        raise DataError("expected a folder to write to, this is a file", source=folder)
    return folder


def _write(
    folder: Path, burst: Burst, truth: Truth, result: Reconstruction, images: dict[str, Any]
) -> tuple[Path, ...]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make the folder: {error.strerror}", source=folder) from error
    names = ("burst.nc", "truth.tif", "result.nc", "preview.png")
    burst_file, truth_file, result_file, preview = files = tuple(folder / name for name in names)
    save_burst(burst, burst_file)
    export_image(truth.image, truth_file)
    save_reconstruction(result, result_file)
    labels = {"nearest": "one frame, as it is", "bicubic": "one frame, bicubic"}
    panels = {labels.get(name, f"{name} x{result.scale}"): image for name, image in images.items()}
    write_preview(panels | {"truth": truth.image}, preview, f"{burst.frame_count} frames")
    return files
