"""`lensshift doctor`: from the box to a filed calibration, or to what is wrong."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensshift.cli.capture import Show
from lensshift.cli.devices import YesOption, homing_asked, on_terminal
from lensshift.cli.session import DebugOption, JsonOption, Session, session
from lensshift.core.errors import printable

if TYPE_CHECKING:
    from lensshift.capture.acquire import Progress
    from lensshift.pipeline.doctor import Diagnosis

RigArgument = Annotated[
    Path | None, typer.Argument(help="Rig file (TOML); without one, one is written.")
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder of page, scan, calibration; default: by date."),
]
NewOption = Annotated[
    Path, typer.Option("--file", help="Without a rig file: the one that is written.")
]
RowOption = Annotated[
    str | None, typer.Option("--row", help="For it: port of the axis that moves up and down.")
]
ColOption = Annotated[
    str | None, typer.Option("--col", help="For it: port of the axis that moves sideways.")
]
PortOption = Annotated[
    int, typer.Option("--port", min=1, max=65535, help="For it: UDP port of the camera (O3M).")
]


def doctor(
    rig: RigArgument = None,
    out: OutOption = None,
    file: NewOption = Path("rig.toml"),
    row: RowOption = None,
    col: ColOption = None,
    port: PortOption = 42000,
    yes: YesOption = False,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Examine a rig, name what is wrong, calibrate it, and write a page about it.

    The first line is the verdict. Axes are homed only with leave, nothing moves while there is a
    fault, and the lens is brought back to rest. Exits with 1 if there is a fault.

    \b
    Examples:
      lensshift doctor rig.toml
      lensshift doctor rig.toml --yes --json > health.json
      lensshift doctor --row 83000001 --col 83000002
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.pipeline.doctor import Level, examine_rig
        from lensshift.pipeline.doctor.start import begin, with_calibration

        if rig is None:
            begin(file, row, col, port, _ask if on_terminal() else None)
            current.say(f"wrote {file}: look whether it is right, rest_mm above all")
        folder = out or Path(time.strftime("doctor-%Y-%m-%d-%H%M%S"))
        show = Show(current)
        try:
            done = examine_rig(
                rig or file,
                folder,
                on_homing=homing_asked(yes=yes),
                on_step=lambda what, now: _step(show, current, what, now),
            )
        finally:
            show.close()
        if rig is None and done.calibration is not None:
            with_calibration(file, folder / "calibration.json")
        _say(current, done)
    if done.level is Level.FAULT:
        raise typer.Exit(1)


def _ask(question: str, likely: str) -> str:
    return str(typer.prompt(question, default=likely or None, err=True)).strip()


def _step(show: Show, current: Session, what: str, now: Progress | None) -> None:
    if now is not None:
        show.named(what, now)
    elif not current.as_json:
        typer.echo(printable(f"{what} ..."), err=True)


def _say(current: Session, done: Diagnosis) -> None:
    current.say(done.verdict)
    for finding in sorted(done.findings, key=lambda one: -one.level):
        if finding.line != done.verdict:
            current.say(f"  {finding.line}")
    if done.budget is not None:
        for name, size_px in done.budget.parts.items():
            current.say(f"  {name:<12} {size_px:.4f} px rms")
        current.say(f"  to be better: {done.budget.cure}")
    current.say("wrote " + ", ".join(str(path) for path in done.files))
    current.result |= done.as_dict()
