"""`lensshift run` and `reproduce`: one simulated experiment, and every experiment of the paper."""

from __future__ import annotations

import math
import shlex
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lensshift.cli.capture import Show
from lensshift.cli.devices import YesOption, homing_asked
from lensshift.cli.methods import check_method
from lensshift.cli.reconstruct import say_channels
from lensshift.cli.session import Progress, Session, picked
from lensshift.cli.verbs import argument, option, verb
from lensshift.core.threads import core_count

if TYPE_CHECKING:
    from lensshift.pipeline.run import RunSummary


@dataclass(frozen=True, slots=True)
class _RunOptions:
    config: Path | None = argument(
        "Experiment in TOML; the built-in four boxes if not given.", default=None
    )
    out: Path = option(Path("lensshift-run"), "Folder for the files it writes.", "-o")
    scale: int | None = option(None, "Upscaling factor instead of CONFIG's.", min=1, max=8)
    method: str | None = option(None, "Method instead of CONFIG's; `lensshift methods` lists them.")
    seed: int | None = option(None, "Seed instead of CONFIG's.", min=0)
    rig: str = option("simulated", "simulated, emulated (real protocols), or a rig file (TOML).")
    print_config: bool = option(False, "Print the built-in experiment and stop.")
    yes: YesOption = False


@verb()
def run(current: Session, asked: _RunOptions) -> None:
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
    if asked.print_config:
        from lensshift.pipeline.experiment_file import default_text

        typer.echo(default_text(), nl=False)
        raise typer.Exit
    if asked.method is not None:
        check_method(asked.method)
    if asked.rig != "simulated":
        if asked.config is not None:
            raise typer.BadParameter("CONFIG is for the simulated rig; leave it or --rig out")
        _with_rig(current, asked)
        return
    from lensshift.pipeline import run as run_pipeline

    with Progress("reconstructing", preparing=True) as progress:
        told = picked(asked, "config scale method seed")
        summary = run_pipeline(asked.out, **told, on_iteration=progress)
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
        told = [
            f"{1e3 * numbers[key]:.1f} mm {where}"
            for key, where in (("edge_rmse_m", "at edges"), ("flat_rmse_m", "elsewhere"))
            if math.isfinite(numbers[key])  # a scene may have no edges
        ]
        current.say(f"{name:<14} distance RMSE {', '.join(told)}")
    current.wrote(*summary.files)
    current.tell(result, "method scale")
    current.tell(summary, "seconds fidelity depth")
    current.result |= {"shape": shape}


def _with_rig(current: Session, asked: _RunOptions) -> None:
    """Carry out the chain with an emulated rig or one of the user's own."""
    scale, method = asked.scale or 2, asked.method or "auto"
    if asked.rig == "emulated":
        _emulated(current, asked, scale, method)
        return
    if not Path(asked.rig).exists():
        raise typer.BadParameter(f"expected simulated, emulated or a rig file, got {asked.rig!r}")
    from lensshift.pipeline.rig import run_bench

    with Show(current) as show:
        result, files = run_bench(
            asked.rig, asked.out, scale=scale, method=method,
            on_step=lambda _, now: show(now), on_homing=homing_asked(yes=asked.yes),
        )  # fmt: skip
    say_channels(current, result)
    current.wrote(*files)
    current.result["method"] = result.method


def _emulated(current: Session, asked: _RunOptions, scale: int, method: str) -> None:
    from lensshift.capture.emulators.rig import RigSettings
    from lensshift.pipeline.rig import EMULATED_SPEED, run_emulated

    settings = RigSettings(speed=EMULATED_SPEED, seed=asked.seed or 0)
    with Show(current) as show:
        summary = run_emulated(asked.out, settings, scale=scale, method=method, on_step=show.named)
    current.say(f"emulated rig, {method} x{scale}: all in {summary.seconds:.1f} s")
    for name, error in summary.shift_rms_px.items():
        current.say(f"shift error  {error:.4f} px rms, {name}")
    for name, numbers in summary.fidelity.items():
        current.say(f"{name:<26} amplitude PSNR {numbers['psnr_db']:.2f} dB")
    current.say(f"calibrated shifts cost {summary.loss_db:.2f} dB against perfect ones")
    current.wrote(*summary.files)
    current.tell(summary, "shift_rms_px fidelity loss_db counts seconds")
    current.result |= {"px_per_mm": summary.calibration.stage_map.px_per_mm}
    current.result |= {"method": method, "scale": scale}


@dataclass(frozen=True, slots=True)
class _ReproduceOptions:
    out: Path = option(Path("lensshift-paper"), "Folder for results.json and report.html.", "-o")
    quick: bool = option(False, "Fewer draws, about a minute.")
    processes: int | None = option(None, "Side by side; default: all cores.", min=1)


@verb()
def reproduce(current: Session, asked: _ReproduceOptions) -> None:
    """Repeat the experiments of the paper: each claim confirmed, qualified or refuted.

    \b
    Example:
      lensshift reproduce --quick --out paper
    """
    from lensshift.pipeline.paper import reproduce as reproduce_paper

    with Progress("experiments of the paper", preparing=True) as progress:
        found = reproduce_paper(
            asked.out, quick=asked.quick, processes=asked.processes or core_count(),
            on_step=progress.count, command=shlex.join(["lensshift", *sys.argv[1:]]),
        )  # fmt: skip
    for claim in found.claims:
        current.say(f"{claim.verdict:<10} {claim.id:<32} paper: {claim.paper}; {claim.said}")
    if found.not_done:
        current.say("not done: " + "; ".join(found.not_done))
    current.say(f"{found.seconds:.0f} s, wrote " + ", ".join(map(str, found.files)))
    claims = [asdict(claim) | {"verdict": claim.verdict} for claim in found.claims]
    current.result["claims"] = claims
    current.tell(found, "not_done seconds files")
