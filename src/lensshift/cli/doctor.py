"""`lensshift doctor`: from the box to a filed calibration, or to what is wrong."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lensshift.cli.capture import Show
from lensshift.cli.devices import YesOption, homing_asked, on_terminal
from lensshift.cli.session import Session
from lensshift.cli.verbs import argument, option, verb

if TYPE_CHECKING:
    from lensshift.pipeline.doctor import Diagnosis


@dataclass(frozen=True, slots=True)
class _DoctorOptions:
    rig: Path | None = argument("Rig file (TOML); without one, one is written.", default=None)
    out: Path | None = option(None, "Folder of page, scan, calibration; default: by date.", "-o")
    file: Path = option(Path("rig.toml"), "Without a rig file: the one that is written.")
    row: str | None = option(None, "For it: port of the axis that moves up and down.")
    col: str | None = option(None, "For it: port of the axis that moves sideways.")
    port: int = option(42000, "For it: UDP port of the camera (O3M).", min=1, max=65535)
    yes: YesOption = False


@verb()
def doctor(current: Session, asked: _DoctorOptions) -> None:
    """Examine a rig, name what is wrong, calibrate it, and write a page about it.

    The first line is the verdict. Axes are homed only with leave, nothing moves while there is a
    fault, and the lens is brought back to rest. Exits with 1 if there is a fault.

    \b
    Examples:
      lensshift doctor rig.toml
      lensshift doctor rig.toml --yes --json > health.json
      lensshift doctor --row 83000001 --col 83000002
    """
    from lensshift.pipeline.doctor import Level, examine_rig
    from lensshift.pipeline.doctor.start import begin, with_calibration

    if asked.rig is None:
        begin(asked.file, asked.row, asked.col, asked.port, _ask if on_terminal() else None)
        current.say(f"wrote {asked.file}: look whether it is right, rest_mm above all")
    folder = asked.out or Path(time.strftime("doctor-%Y-%m-%d-%H%M%S"))
    with Show(current) as show:
        homing = homing_asked(yes=asked.yes)
        rig = asked.rig or asked.file
        done = examine_rig(rig, folder, on_homing=homing, on_step=show.named)
    filed = folder / "calibration.json"
    if asked.rig is None and filed in done.files:
        with_calibration(asked.file, filed)
    _say(current, done)
    current.failed = done.level is Level.FAULT


def _ask(question: str, likely: str) -> str:
    return str(typer.prompt(question, default=likely or None, err=True)).strip()


def _say(current: Session, done: Diagnosis) -> None:
    current.say(done.verdict)
    for finding in sorted(done.findings, key=lambda one: -one.level):
        if finding.line != done.verdict:
            current.say(f"  {finding.line}")
    if done.budget is not None:
        for name, size_px in done.budget.parts.items():
            current.say(f"  {name:<12} {size_px:.4f} px rms")
        current.say(f"  to be better: {done.budget.cure}")
    current.wrote(*done.files)
    current.result |= done.as_dict()
