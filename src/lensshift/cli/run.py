"""`lensshift run`: the whole chain on a small burst that comes with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lensshift.cli.reconstruct import (
    MethodOption,
    ScaleOption,
    SeedOption,
    channels_of,
    check_method,
    describe,
    say_channels,
)
from lensshift.cli.session import DebugOption, JsonOption, Progress, session

FolderOption = Annotated[Path, typer.Option("--out", "-o", help="Folder for the files it writes.")]


def run(
    out: FolderOption = Path("lensshift-run"),
    scale: ScaleOption = 2,
    method: MethodOption = "auto",
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Run the whole chain on a small built-in burst, and compare with the truth.

    \b
    Example:
      lensshift run --out first-run
    """
    with session(as_json=as_json, debug=debug) as current:
        check_method(method)
        from lensshift.pipeline import run as run_pipeline

        progress = Progress(f"running with {method}")
        try:
            summary = run_pipeline(
                out, scale=scale, method=method, seed=seed, on_iteration=progress
            )
        finally:
            progress.close()
        result = summary.reconstruction
        shape = result.grid.shape
        current.say(
            f"{result.method} x{result.scale}: {shape[0]} x {shape[1]} px, "
            f"all in {summary.seconds:.2f} s"
        )
        say_channels(current, result)
        for name, numbers in summary.fidelity.items():
            current.say(
                f"{name:<14} PSNR {numbers['psnr_db']:.2f} dB, SSIM {numbers['ssim']:.4f}, "
                f"RMSE {numbers['rmse']:.4g}"
            )
        current.say("wrote " + ", ".join(str(path) for path in summary.files))
        current.result |= {
            "method": result.method,
            "scale": result.scale,
            "shape": shape,
            "seconds": summary.seconds,
            "fidelity": summary.fidelity,
            "channels": {name: describe(part) for name, part in channels_of(result).items()},
            "files": summary.files,
        }
