"""`lensshift register`: the shifts of a burst from its own frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lensshift.cli import inputs, methods
from lensshift.cli.session import Session, Waiting, picked
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from lensshift.core.types import Burst


@dataclass(frozen=True, slots=True)
class _RegisterOptions:
    burst: inputs.BurstArgument
    out: Path | None = option(None, "Burst file; default: BURST_registered.nc beside it.", "-o")
    method: Literal["auto", "gradient", "phase"] = option("auto", "How the shifts are found.")
    motion: Literal["auto", "shift", "affine"] = option(
        "auto", "affine: frames also turn, grow and shear; auto: if they show it; shift: never."
    )
    channel: Literal["auto", "amplitude", "distance", "phasor"] = option(
        "auto", "What the shifts are found from; auto: phasors where the burst tells them."
    )
    reference: int = option(0, "Frame whose offset is kept.", min=0)
    photometric: bool | None = option(
        None, "Allow frames to differ by a factor and a constant, or not; else if they show it.",
        "--photometric/--no-photometric",
    )  # fmt: skip
    use_given: bool = option(False, "Weigh the burst's own offsets by their errors.")
    frames: methods.FramesOption = None
    stack: inputs.StackOptions = field(default_factory=inputs.StackOptions)


@verb("finding the shifts")
def register(current: Session, asked: _RegisterOptions) -> None:
    """Find the shifts of a burst from its own frames.

    \b
    Examples:
      lensshift register burst.nc -o registered.nc
      lensshift register frames.tif --pitch-mm 0.015
      lensshift register *.png
      lensshift register frames/ --offsets planned.csv --pitch-mm 0.015 --photometric
      lensshift register handheld.tif --pitch-mm 0.015 --motion affine
    """
    from lensshift.io import save_burst
    from lensshift.registration import register as find_shifts

    source = inputs.source_of(asked.burst)
    target = asked.out or inputs.beside(source, "_registered.nc")
    inputs.check_netcdf(target, "a burst")
    inputs.check_files((*asked.burst, asked.stack.offsets), (target,))
    burst = inputs.load_input_burst(asked.burst, asked.stack)
    told = picked(asked, "method motion channel reference photometric use_given")
    told |= {"frames": methods.parse_frames(asked.frames)}
    found = find_shifts(burst, **told)
    save_burst(found, target)
    current.result["input"] = source
    _say(current, found)
    current.wrote(target)


def with_shifts(current: Session, burst: Burst, **told: Any) -> Burst:
    """Return a burst with the shifts that its frames tell, `told` as `register`, and say them."""
    from lensshift.registration import register as find_shifts

    with Waiting("finding the shifts"):
        found = find_shifts(burst, **told)
    current.say("no shifts are given; the frames say:")
    _say(current, found)
    return found


def _say(current: Session, burst: Burst) -> None:
    """Print and hand back the shifts of a burst, with their standard errors."""
    current.result["frames"] = burst.frame_count
    current.tell(burst, "offset_px offset_sigma_px")
    current.say("frame      row px      col px   +- row   +- col")
    rows = [f"{k:5d}{row:12.4f}{col:12.4f}" for k, (row, col) in enumerate(burst.offset_px)]
    if burst.offset_sigma_px is not None:
        errors = (f"{row:9.4f}{col:9.4f}" for row, col in burst.offset_sigma_px)
        rows = [row + error for row, error in zip(rows, errors, strict=True)]
    current.say_rows(rows)
    say_turns(current, burst)


def say_turns(current: Session, burst: Burst) -> None:
    """Print and hand back how much each frame turns and grows, if it does more than shift."""
    if burst.affine is None:
        return
    from lensshift.registration.affine import turns_of

    current.tell(burst, "affine")
    current.say("frame  turn deg   size %")
    turn_deg, size = turns_of(burst.affine)
    both = zip(turn_deg, 100 * size, strict=True)
    current.say_rows([f"{k:5d}{one:10.3f}{grown:9.3f}" for k, (one, grown) in enumerate(both)])
