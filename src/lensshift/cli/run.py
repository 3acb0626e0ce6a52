"""`lensshift run`: one simulated experiment, from the scene to the comparison with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensshift.cli.devices import YesOption
from lensshift.cli.method_options import check_method
from lensshift.cli.reconstruct import describe, say_channels
from lensshift.cli.session import DebugOption, JsonOption, Progress, Session, session

if TYPE_CHECKING:
    from lensshift.pipeline.run import RunSummary

ConfigArgument = Annotated[
    Path | None, typer.Argument(help="Experiment in TOML; the built-in four boxes if not given.")
]
FolderOption = Annotated[Path, typer.Option("--out", "-o", help="Folder for the files it writes.")]
ScaleOption = Annotated[
    int | None, typer.Option(min=1, max=8, help="Upscaling factor instead of CONFIG's.")
]
MethodOption = Annotated[
    str | None, typer.Option(help="Method instead of CONFIG's; `lensshift methods` lists them.")
]
SeedOption = Annotated[int | None, typer.Option(min=0, help="Seed instead of CONFIG's.")]
RigOption = Annotated[
    str,
    typer.Option("--rig", help="simulated, emulated (real protocols), or a rig file (TOML)."),
]
PrintOption = Annotated[
    bool, typer.Option("--print-config", help="Print the built-in experiment and stop.")
]


def run(
    config: ConfigArgument = None,
    out: FolderOption = Path("lensshift-run"),
    scale: ScaleOption = None,
    method: MethodOption = None,
    seed: SeedOption = None,
    rig: RigOption = "simulated",
    print_config: PrintOption = False,
    yes: YesOption = False,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Simulate one experiment, reconstruct its burst, and compare with the truth.

    With --rig emulated: start emulated stages and an emulated camera, calibrate them, capture over
    their real protocols, reconstruct and compare. With --rig FILE: capture with your own rig.

    \b
    Examples:
      lensshift run --out first-run
      lensshift run --print-config > mine.toml
      lensshift run mine.toml --out second-run
      lensshift run --rig emulated --out rig-run
    """
    with session(as_json=as_json, debug=debug) as current:
        if print_config:
            from lensshift.pipeline.experiment_file import default_text

            typer.echo(default_text(), nl=False)
            raise typer.Exit
        if method is not None:
            check_method(method)
        if rig != "simulated":
            if config is not None:
                raise typer.BadParameter("CONFIG is for the simulated rig; leave it or --rig out")
            from lensshift.cli.run_rig import run_rig

            run_rig(
                current, rig, out,
                scale=scale or 2, method=method or "auto", seed=seed or 0, yes=yes,
            )  # fmt: skip
            return
        from lensshift.pipeline import run as run_pipeline

        progress = Progress("reconstructing", preparing=True)
        try:
            summary = run_pipeline(
                out, config=config, scale=scale, method=method, seed=seed, on_iteration=progress
            )
        finally:
            progress.close()
        _say(current, summary)


def _say(current: Session, summary: RunSummary) -> None:
    result = summary.reconstruction
    shape = result.grid.shape
    current.say(
        f"{result.method} x{result.scale}: {shape[0]} x {shape[1]} px, "
        f"all in {summary.seconds:.2f} s"
    )
    say_channels(current, result)
    for name, numbers in summary.fidelity.items():
        current.say(
            f"{name:<14} amplitude PSNR {numbers['psnr_db']:.2f} dB, "
            f"SSIM {numbers['ssim']:.4f}, RMSE {numbers['rmse']:.4g}"
        )
    for name, numbers in summary.depth.items():
        current.say(
            f"{name:<14} distance RMSE {1e3 * numbers['edge_rmse_m']:.1f} mm at edges, "
            f"{1e3 * numbers['flat_rmse_m']:.1f} mm elsewhere"
        )
    current.say("wrote " + ", ".join(str(path) for path in summary.files))
    current.result |= {
        "method": result.method,
        "scale": result.scale,
        "shape": shape,
        "seconds": summary.seconds,
        "fidelity": summary.fidelity,
        "depth": summary.depth,
        "channels": {name: describe(part) for name, part in result.channels.items()},
        "files": summary.files,
    }
