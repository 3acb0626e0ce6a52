"""`lensshift capture`: move the lens, grab the frames, keep them."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensshift.cli.devices import YesOption, homing_asked
from lensshift.cli.inputs import check_netcdf
from lensshift.cli.session import Session, StatusLine, picked
from lensshift.cli.verbs import argument, option, verb
from lensshift.core.ending import Closing
from lensshift.core.errors import DataError, printable

if TYPE_CHECKING:
    from lensshift.capture.acquire import Progress
    from lensshift.capture.opening import Rig
    from lensshift.core.motion import ShiftPlan
    from lensshift.core.types import Burst


@dataclass(frozen=True, slots=True)
class _CaptureOptions:
    rig: Path | None = argument(
        "Rig file (TOML); --print-rig shows one to begin with.", default=None
    )
    out: Path = option(Path("burst.nc"), "Burst file; readable from the first frame on.", "-o")
    plan: str = option("square", "square, 3x3, 4x4, quincunx, spiral, still, or a CSV/JSON.")
    frames: int | None = option(None, "Frames at each position, else the rig's.", min=1)
    average: bool | None = option(None, "Keep their mean, or each of them.", "--average/--keep")
    discard: int | None = option(
        None, "Frames that may have begun before the stage settled.", min=0
    )
    calibration: Path | None = option(None, "From `calibrate`; instead of the rig file's.")
    scan: bool = option(False, "Scan the stage range for `calibrate` instead of a plan.")
    span_um: float = option(300.0, "Width of the scan.", min=1.0)
    resume: bool = option(False, "Go on with an unfinished capture.")
    restart: bool = option(False, "Begin anew; an unfinished capture is set aside.")
    continuous: bool = option(False, "One burst after another, OUT-0001.nc and so on.")
    burst_count: int | None = option(
        None, "End --continuous after so many bursts.", "--bursts", min=1
    )
    print_rig: bool = option(False, "Print a rig file and stop.")
    yes: YesOption = False


@verb()
def capture(current: Session, asked: _CaptureOptions) -> None:
    """Take a burst with a rig: every frame is in the file as soon as it is taken.

    The lens returns to its rest position however this ends. After Ctrl-C, a pulled cable or a
    kill, the frames so far are in the file, and --resume takes the missing ones.

    \b
    Examples:
      lensshift capture --print-rig > rig.toml
      lensshift capture rig.toml --plan square --frames 8 --average -o burst.nc
      lensshift capture rig.toml --scan --frames 4 --average -o scan.nc
      lensshift capture rig.toml -o burst.nc --resume
    """
    if asked.print_rig:
        from lensshift.capture.opening import EXAMPLE

        typer.echo(EXAMPLE, nl=False)
        raise typer.Exit
    if asked.rig is None:
        raise typer.BadParameter("expected a rig file; --print-rig shows one")
    if asked.continuous and (asked.scan or asked.resume or asked.restart):
        raise typer.BadParameter("--continuous goes with neither --scan nor --resume nor --restart")
    if asked.resume and asked.restart:
        raise typer.BadParameter("expected --resume or --restart, not both")
    from lensshift.capture.journal import set_aside
    from lensshift.capture.opening import open_rig
    from lensshift.io.calibration_file import load_calibration

    if asked.restart and (aside := set_aside(asked.out)) is not None:
        current.say(f"the unfinished capture is now {aside}")

    wanted = None if asked.scan else _plan(asked.plan)
    if _nothing_to_do(current, asked, wanted):
        return
    calibration = None if asked.calibration is None else load_calibration(asked.calibration)
    with open_rig(asked.rig, on_homing=homing_asked(yes=asked.yes)) as opened:
        told = picked(asked, "frames average discard").items()
        changes = {name: value for name, value in told if value is not None}
        opened.acquisition = replace(opened.acquisition, **changes)
        opened.calibration = calibration or opened.calibration
        if asked.continuous and wanted is not None:
            _stream(current, opened, wanted, asked)
            return
        start_s = time.monotonic()
        with Show(current) as show:
            burst = _take(opened, wanted, asked, show)
        counts = dict(opened.camera.counts())
    seconds = time.monotonic() - start_s
    current.say(f"{burst.frame_count} frames in {seconds:.1f} s, {_losses(counts)}")
    current.wrote(asked.out)
    current.result |= _summary(burst, counts) | {"seconds": seconds}


def _nothing_to_do(current: Session, asked: _CaptureOptions, plan: ShiftPlan | None) -> bool:
    """Look at the files before anything moves; tell whether the capture is complete already."""
    from lensshift.capture.journal import finished
    from lensshift.io.capture_file import CaptureWriter, is_capture, refuse_taken

    out = asked.out
    check_netcdf(out, "a burst")
    if asked.continuous:
        _refuse_earlier(out)
        return False
    told = {name: one for name, one in picked(asked, "frames average").items() if one is not None}
    done = finished(out, "scan" if plan is None else plan.name, told) if asked.resume else None
    if done is None:
        if asked.resume and is_capture(out):  # whether it was begun in the same way is seen later
            CaptureWriter.resume(out).close()
        else:
            refuse_taken(out)
        return False
    current.say(f"nothing to do: {out} is complete, {done.frame_count} frames")
    current.result |= _summary(done, {}) | {"files": [out]}
    return True


def _refuse_earlier(out: Path) -> None:
    """Refuse the name of an earlier stream of bursts."""
    from lensshift.io.capture_file import refuse_taken

    refuse_taken(_numbered(out, 1))
    name = re.compile(rf"{re.escape(out.stem)}-\d{{4,}}{re.escape(out.suffix)}")
    if earlier := sorted(file for file in out.parent.iterdir() if name.fullmatch(file.name)):
        problem = "there is a burst of this name from before; choose another name"
        raise DataError(problem, source=earlier[0])


def _numbered(out: Path, number: int) -> Path:
    return out.with_stem(f"{out.stem}-{number:04d}")


def _plan(text: str) -> ShiftPlan:
    from lensshift.capture.plan import PLANS, load_plan, named_plan

    if text in PLANS:
        return named_plan(text)
    if not Path(text).exists():
        expected = ", ".join(PLANS)
        raise typer.BadParameter(f"expected a plan of {expected}, or a file, got {text!r}")
    return load_plan(text)


def _take(rig: Rig, plan: ShiftPlan | None, asked: _CaptureOptions, show: Show) -> Burst:
    if plan is not None:
        return rig.capture(plan, asked.out, resume=asked.resume, on_step=show)
    from lensshift.registration.scan import USUAL_STEPS, calibration_scan_mm

    span_mm = 1e-3 * asked.span_um
    places = calibration_scan_mm(rig.calibration.rest_mm, span_mm, steps=USUAL_STEPS)
    return rig.scan(places, asked.out, resume=asked.resume, on_step=show)


def _stream(current: Session, rig: Rig, plan: ShiftPlan, asked: _CaptureOptions) -> None:
    from lensshift.io import save_burst

    files: list[Path] = []
    stream = rig.bursts(plan)
    try:
        for number, burst in enumerate(stream, start=1):
            file = _numbered(asked.out, number)
            save_burst(burst, file)
            files.append(file)
            current.say(f"wrote {file}: {burst.frame_count} frames")
            if number == asked.burst_count:
                break
    finally:
        stream.close()  # type: ignore[attr-defined]  # it is a generator: the lens returns
    current.result |= {"files": files, "counts": dict(rig.camera.counts())}


class Show(Closing):
    """Say where an acquisition is, on stderr: one line on a terminal, else one a position."""

    def __init__(self, current: Session) -> None:
        self._quiet, self._line, self._name = current.as_json, StatusLine(), ""

    def __call__(self, now: Progress) -> None:
        """Take note of a position that is done."""
        if self._quiet:
            return
        row, col = now.position_mm
        rate = f"{now.rate_hz:.1f} Hz, " if now.rate_hz else ""
        self._line.show(
            f"{self._name}position {now.step} of {now.steps}: stage at {row:.4f}, {col:.4f} mm, "
            f"{rate}{_losses(now.counts)}"
        )

    def named(self, name: str, now: Progress | None) -> None:
        """Take note of a position of one of several acquisitions, or that something else begins."""
        self._name = f"{name}, "
        if now is not None:
            self(now)
        elif not self._quiet:
            typer.echo(printable(f"{name} ..."), err=True)

    def close(self) -> None:
        """End the line on a terminal."""
        self._line.close()


def _losses(counts: Any) -> str:
    lost = {name: n for name, n in counts.items() if n and name not in ("frames", "packets")}
    told = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in lost.items())
    return f"camera sent {counts.get('frames', 0)} frames" + (f" ({told})" if told else "")


def _summary(burst: Burst, counts: dict[str, int]) -> dict[str, Any]:
    told = picked(burst, "frame_count offset_px offset_source stage_mm")
    return {**told, "shape": burst.grid.shape, "counts": counts}
