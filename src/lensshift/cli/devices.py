"""What `lensshift info` says of devices."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.session import Session
from lensshift.core.errors import DeviceTimeout, printable

if TYPE_CHECKING:
    from lensshift.capture.rig import OnHoming

YesOption = Annotated[
    bool, typer.Option("--yes", help="Home the axes without asking, if the rig file says to ask.")
]
_FIRST_FRAME_S = 5.0  # patience: a camera that runs sends at once
_COUNTED = 10  # frames, for the rate


def on_terminal() -> bool:
    """Tell whether somebody sits there who can be asked."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def homing_asked(*, yes: bool) -> OnHoming:
    """Return what says how far homing takes each axis, and asks on a terminal if it must."""

    def answer(way: str, ask: bool) -> bool:
        typer.echo(printable(f"homing: {way}"), err=True)
        if yes or not ask:
            return True
        if on_terminal():
            with suppress(typer.Abort):
                return typer.confirm("Home both axes now?", err=True)
        return False

    return answer


def say_ports(current: Session) -> None:
    """List the serial ports with their USB serial numbers."""
    from serial.tools import list_ports

    ports = [
        {"port": one.device, "serial": one.serial_number, "description": one.description}
        for one in list_ports.comports()
    ]
    for one in ports:
        current.say(f"{one['port']}  serial {one['serial'] or 'none'}  {one['description']}")
    if not ports:
        current.say("no serial ports")
    current.result["ports"] = ports


def say_rig(current: Session, file: Path) -> None:
    """Open a rig without moving it, say what its devices answer, count the frames that come."""
    from lensshift.capture.opening import open_rig

    with open_rig(file, home="never") as rig:
        row, col = rig.stage.position_mm()
        current.say(f"stage       {rig.stage.name}, at {row:.4f}, {col:.4f} mm (row, col)")
        known = rig.stage.describe()
        if any(known.get(axis, {}).get("homed") is False for axis in ("row", "col")):
            current.say("zero        not known: positions count from where it was switched on")
        _say_mapping(current, known)
        rows, cols = rig.camera.grid.shape
        current.say(f"camera      {rig.camera.name}, {rows} x {cols} px")
        rate_hz = _rate_hz(rig.camera)
        current.say(f"frames      {rate_hz:.1f} per second")
        _say_mapping(current, rig.camera.describe())
        for name, count in rig.camera.counts().items():
            current.say(f"  {name:<22} {count}")
        per_mm = rig.calibration.stage_map.px_per_mm
        current.say(f"image       {rig.calibration.source} map, px per mm:")
        for line in per_mm:
            current.say(f"            {line[0]:+9.4f} {line[1]:+9.4f}")
        camera = {"name": rig.camera.name, "shape": rig.camera.grid.shape, "rate_hz": rate_hz}
        camera |= {"counts": dict(rig.camera.counts()), **rig.camera.describe()}
        current.result |= {
            "stage": {"name": rig.stage.name, "position_mm": [row, col], **known},
            "camera": camera,
            "calibration": {"source": rig.calibration.source, "px_per_mm": per_mm},
        }


def _rate_hz(camera: Any) -> float:
    """Return frames per second by the camera's own counter; 0 if a second one does not come."""
    first = camera.next_frame(_FIRST_FRAME_S)
    last, end_s = first, time.monotonic() + _FIRST_FRAME_S
    try:
        while last.cycle < first.cycle + _COUNTED and time.monotonic() < end_s:
            last = camera.next_frame(_FIRST_FRAME_S)
    except DeviceTimeout:
        return 0.0
    seconds = last.arrived_s - first.arrived_s
    return (last.cycle - first.cycle) / seconds if seconds > 0 else 0.0


def _say_mapping(current: Session, known: Mapping[str, Any]) -> None:
    for name, value in known.items():
        current.say(f"  {name:<22} {value!s:.80}")
