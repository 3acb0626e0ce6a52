"""`lensshift reconstruct --window`: a recording of any length to a sequence of pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import typer

from lensshift.cli import inputs
from lensshift.cli.points import PointOptions
from lensshift.cli.session import Progress, Session
from lensshift.cli.verbs import option

if TYPE_CHECKING:
    from lensshift.cli.reconstruct import ReconstructOptions


@dataclass(frozen=True, slots=True)
class Split:
    """How a recording is split, and who works on it."""

    window: int | None = option(None, "A picture of each window of this many frames.", min=1)
    every: int | None = option(
        None, "Frames from one picture to the next; default: the window.", min=1
    )
    pace: Literal["auto", "live", "refined"] = option(
        "auto",
        "refined: each picture is computed; live: while the scene rests, one follows the light and "
        "the distance of its frames; auto: live, but each fourth picture or so is computed.",
    )
    workers: int | None = option(
        None, "Processes to work with (pip install 'lensshift[cluster]').", min=1
    )
    scheduler: str | None = option(
        None, "Address of a dask scheduler whose workers can read the recording."
    )


def is_recording(asked: ReconstructOptions) -> bool:
    """Tell whether a recording is meant; a usage error if half of it is, or what none takes."""
    if asked.split.window is None:
        if asked.split != Split():
            raise typer.BadParameter(
                "--every, --pace, --workers and --scheduler are for recordings; give --window, "
                "the frames of a picture, as well"
            )
        return False
    names = ("frames", "lens_field", "calibration", "export")
    told = [f"--{name.replace('_', '-')}" for name in names if getattr(asked, name)]
    told += ["--motion"] * (asked.motion != "auto")
    told += ["options of image stacks (convert it first)"] * (asked.stack != inputs.StackOptions())
    told += ["options of points (convert the sequence)"] * (asked.points != PointOptions())
    if told:
        raise typer.BadParameter(f"{', '.join(told)}: not together with --window")
    if asked.split.workers is not None and asked.split.scheduler is not None:
        raise typer.BadParameter("give --workers or --scheduler, not both")
    return True


def reconstruct_windows(
    current: Session, asked: ReconstructOptions, settings: dict[str, Any]
) -> None:
    """Make the sequence of a recording and say what became of it."""
    from lensshift.pipeline.recording import reconstruct_recording

    source, split = inputs.source_of(asked.burst), asked.split
    target = asked.out or source.with_name(f"{source.stem}_x{asked.scale}_windows.nc")
    if len(asked.burst) > 1 or inputs.kind_of(source) is inputs.Kind.STACK:
        raise typer.BadParameter(
            f"{source}: --window takes a burst file; lensshift convert makes one of images"
        )
    inputs.check_netcdf(target, "a sequence")
    inputs.refuse_overwriting((source,), (target,))
    if target.exists():
        raise typer.BadParameter(f"{target} exists; choose another name or remove it")
    kept = {name: value for name, value in settings.items() if name != "frames"}
    kept |= {} if asked.psf_sigma_px is None else {"psf_sigma_px": asked.psf_sigma_px}
    with Progress("reconstructing windows", preparing=True) as progress:
        found = reconstruct_recording(
            source, target, window=split.window or 1, every=split.every, pace=split.pace,
            workers=split.workers, scheduler=split.scheduler, on_progress=progress.count, **kept,
        )  # fmt: skip
    made = found.windows - found.resumed
    current.say(
        f"{source}: {found.windows} pictures of {split.window} frames, {made} made in "
        f"{found.seconds:.1f} s" + (f", {found.resumed} were there" if found.resumed else "")
    )
    if found.contradicted or found.said:
        bad = f"{found.contradicted} of {made} pictures are contradicted by their frames"
        bad = bad if found.contradicted else "no picture is contradicted by its frames, but"
        current.warn(f"{bad}: {'; '.join(found.said)}")
    current.wrote(found.path)
    current.result["input"] = source
    current.tell(found, "windows resumed contradicted seconds")
