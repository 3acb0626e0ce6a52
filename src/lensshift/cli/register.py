"""`lensshift register`: the shifts of a burst from its own frames."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import (
    FrameAxis,
    FrameAxisOption,
    KeyOption,
    ModulationOption,
    OffsetsOption,
    PitchOption,
    StackOptions,
    load_input_burst,
    refuse_overwriting,
)
from lensshift.cli.session import DebugOption, JsonOption, Session, Waiting, session

if TYPE_CHECKING:
    from lensshift.core.types import Burst


class Method(StrEnum):
    """How the shifts are found."""

    AUTO = "auto"
    GRADIENT = "gradient"
    PHASE = "phase"


class Channel(StrEnum):
    """What the shifts are found from."""

    AMPLITUDE = "amplitude"
    DISTANCE = "distance"


BurstArgument = Annotated[
    Path, typer.Argument(help="A burst file, or an image stack (TIFF, NPY, NPZ, folder of images).")
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Burst file; default: BURST_registered.nc beside it."),
]
MethodOption = Annotated[Method, typer.Option(help="How the shifts are found.")]
ChannelOption = Annotated[Channel, typer.Option(help="What the shifts are found from.")]
ReferenceOption = Annotated[int, typer.Option(min=0, help="Frame whose offset is kept.")]
PhotometricOption = Annotated[
    bool, typer.Option("--photometric", help="Allow frames to differ by a factor and a constant.")
]
UseGivenOption = Annotated[
    bool, typer.Option("--use-given", help="Weigh the burst's own offsets by their errors.")
]
RefineOption = Annotated[
    bool, typer.Option("--refine", help="Refine through the forward model of a reconstruction.")
]


def register(
    burst: BurstArgument,
    out: OutOption = None,
    method: MethodOption = Method.AUTO,
    channel: ChannelOption = Channel.AMPLITUDE,
    reference: ReferenceOption = 0,
    photometric: PhotometricOption = False,
    use_given: UseGivenOption = False,
    refine: RefineOption = False,
    offsets: OffsetsOption = None,
    pitch_mm: PitchOption = None,
    key: KeyOption = None,
    frame_axis: FrameAxisOption = FrameAxis.FIRST,
    modulation_hz: ModulationOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Find the shifts of a burst from its own frames.

    \b
    Examples:
      lensshift register burst.nc -o registered.nc
      lensshift register frames.tif --pitch-mm 0.015
      lensshift register frames/ --offsets planned.csv --pitch-mm 0.015 --photometric
    """
    stack = StackOptions(offsets, pitch_mm, key, frame_axis, modulation_hz)
    with session(as_json=as_json, debug=debug, doing="finding the shifts") as current:
        target = _target(burst, out)
        refuse_overwriting((burst, offsets), (target,))
        from lensshift.io import save_burst
        from lensshift.io.atomic import writable_target
        from lensshift.registration import register as find_shifts

        writable_target(target)
        found = find_shifts(
            load_input_burst(burst, stack, to_register=True),
            method=method.value,
            channel=channel.value,
            reference=reference,
            photometric=photometric,
            use_given=use_given,
        )
        if refine:
            from lensshift.reconstruction.shift_refinement import refine_shifts

            found = refine_shifts(found)
        save_burst(found, target)
        current.result |= {"input": burst, "files": [target], **_described(found)}
        _say(current, found)
        current.say(f"wrote {target}")


def with_shifts(current: Session, burst: Burst) -> Burst:
    """Return a burst of unknown shifts with those that its frames tell, and say them."""
    from lensshift.registration import register as find_shifts

    waiting = Waiting("finding the shifts")
    try:
        found = find_shifts(burst)
    finally:
        waiting.close()
    current.say("no shifts are given; the frames say:")
    _say(current, found)
    current.result |= _described(found)
    return found


def _target(source: Path, out: Path | None) -> Path:
    if out is not None:
        return out
    whole = source.resolve()
    name = whole.name if whole.is_dir() else whole.stem
    return (source.parent if source.name else whole.parent) / f"{name}_registered.nc"


def _described(burst: Burst) -> dict[str, Any]:
    """Return the shifts of a burst for JSON."""
    return {
        "frames": burst.frame_count,
        "offset_px": burst.offset_px,
        "offset_sigma_px": burst.offset_sigma_px,
    }


def _say(current: Session, burst: Burst) -> None:
    """Print the shifts of a burst, with their standard errors."""
    current.say("frame      row px      col px   +- row   +- col")
    errors = burst.offset_sigma_px
    for k, (row, col) in enumerate(burst.offset_px):
        told = "" if errors is None else f"{errors[k, 0]:9.4f}{errors[k, 1]:9.4f}"
        current.say(f"{k:5d}{row:12.4f}{col:12.4f}{told}")
