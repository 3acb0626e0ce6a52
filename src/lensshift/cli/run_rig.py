"""`lensshift run --rig`: the chain with an emulated rig or one of the user's own."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lensshift.cli.capture import Show
from lensshift.cli.devices import homing_asked
from lensshift.cli.reconstruct import say_channels
from lensshift.cli.session import Session

if TYPE_CHECKING:
    from lensshift.cli.run import RunOptions


def run_rig(current: Session, asked: RunOptions) -> None:
    """Carry out the verb and say what it gave."""
    scale, method = asked.scale or 2, asked.method or "auto"
    if asked.rig == "emulated":
        _emulated(current, asked, scale, method)
        return
    if not Path(asked.rig).exists():
        raise typer.BadParameter(f"expected simulated, emulated or a rig file, got {asked.rig!r}")
    from lensshift.pipeline.rig import run_bench

    with closing(Show(current)) as show:
        result, files = run_bench(
            asked.rig,
            asked.out,
            scale=scale,
            method=method,
            on_step=lambda _, now: show(now),
            on_homing=homing_asked(yes=asked.yes),
        )
    say_channels(current, result)
    current.wrote(*files)
    current.result["method"] = result.method


def _emulated(current: Session, asked: RunOptions, scale: int, method: str) -> None:
    from lensshift.capture.emulators.rig import RigSettings
    from lensshift.pipeline.rig import EMULATED_SPEED, run_emulated

    settings = RigSettings(speed=EMULATED_SPEED, seed=asked.seed or 0)
    with closing(Show(current)) as show:
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
