"""`lensshift reconstruct --window`: a recording of any length to a sequence of pictures."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from lensshift.cli.inputs import StackOptions, refuse_overwriting
from lensshift.cli.points import PointOptions
from lensshift.cli.session import Progress, Session


class PaceName(StrEnum):
    """How much of the solver runs for each picture, see `lensshift.stream`."""

    AUTO = "auto"
    LIVE = "live"
    REFINED = "refined"


WindowOption = Annotated[
    int | None,
    typer.Option(min=1, help="A picture of each window of this many frames."),
]  # fmt: skip
EveryOption = Annotated[
    int | None,
    typer.Option(min=1, help="Frames from one picture to the next; default: the window."),
]  # fmt: skip
PaceOption = Annotated[
    PaceName,
    typer.Option(help="live: the last stage of the solver while the scene rests; refined: all; "
                 "auto: all at each fourth picture or so."),
]  # fmt: skip
WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, help="Processes to work with (pip install 'lensshift[cluster]')."),
]  # fmt: skip
SchedulerOption = Annotated[
    str | None,
    typer.Option(help="Address of a dask scheduler whose workers can read the recording."),
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Split:
    """How a recording is split, and who works on it."""

    window: int | None
    every: int | None
    pace: PaceName
    workers: int | None
    scheduler: str | None

    def asked(self, stack: StackOptions, points: PointOptions, *others: object) -> bool:
        """Tell whether a recording is meant.

        A usage error if only half of it is said, or what a recording does not take.

        Parameters
        ----------
        others : --frames, --lens-field, --calibration and --export
        """
        if self.window is None:
            said = (self.every, self.workers, self.scheduler)
            if any(one is not None for one in said) or self.pace is not PaceName.AUTO:
                raise typer.BadParameter(
                    "--every, --pace, --workers and --scheduler are for recordings; give --window, "
                    "the frames of a picture, as well"
                )
            return False
        names = ("--frames", "--lens-field", "--calibration", "--export")
        told = [name for name, value in zip(names, others, strict=True) if value]
        told += ["options of image stacks (convert it first)"] * (stack != StackOptions())
        told += ["options of points (convert the sequence)"] * (points != PointOptions())
        if told:
            raise typer.BadParameter(f"{', '.join(told)}: not together with --window")
        if self.workers is not None and self.scheduler is not None:
            raise typer.BadParameter("give --workers or --scheduler, not both")
        return True


def reconstruct_windows(
    current: Session,
    source: Path,
    out: Path | None,
    split: Split,
    settings: dict[str, Any],
    psf_sigma_px: float | None,
) -> None:
    """Make the sequence of a recording and say what became of it."""
    from lensshift.core.errors import QualityWarning
    from lensshift.pipeline.recording import reconstruct_recording

    scale = settings["scale"]
    target = out if out is not None else source.with_name(f"{source.stem}_x{scale}_windows.nc")
    if target.suffix.lower() != ".nc":
        raise typer.BadParameter(f"{target}: a sequence is a netCDF file (.nc)")
    refuse_overwriting((source,), (target,))
    if target.exists():
        raise typer.BadParameter(f"{target} exists; choose another name or remove it")
    progress = Progress("reconstructing windows", preparing=True)
    kept = {name: value for name, value in settings.items() if name != "frames"}
    kept |= {} if psf_sigma_px is None else {"psf_sigma_px": psf_sigma_px}
    try:
        found = reconstruct_recording(
            source, target, window=split.window or 1, every=split.every, pace=split.pace.value,
            workers=split.workers, scheduler=split.scheduler, on_progress=progress.count, **kept,
        )  # fmt: skip
    finally:
        progress.close()
    made = found.windows - found.resumed
    current.say(
        f"{source}: {found.windows} pictures of {split.window} frames, {made} made in "
        f"{found.seconds:.1f} s" + (f", {found.resumed} were there" if found.resumed else "")
    )
    if found.contradicted or found.said:
        told = "; ".join(found.said)
        text = f"{found.contradicted} of {made} pictures are contradicted by their frames: {told}"
        current.warn(text, QualityWarning, __file__, 0)
    current.say(f"wrote {found.path}")
    current.result |= {
        "input": source,
        "windows": found.windows,
        "resumed": found.resumed,
        "contradicted": found.contradicted,
        "seconds": found.seconds,
        "files": (found.path,),
    }
