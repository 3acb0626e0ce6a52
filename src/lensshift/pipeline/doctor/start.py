"""A rig file for who has none: what is plugged in, and what is not known is asked."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from lensshift.capture.opening import EXAMPLE
from lensshift.core.atomic import write_text
from lensshift.core.errors import DataError

# USB of the APT controllers (Thorlabs in FTDI's range), and how their serial numbers begin.
_VENDOR, _PRODUCT = 0x0403, 0xFAF0
_SERIALS = ("27", "83")  # KDC101, TDC001
Ask = Callable[[str, str], str]


def cubes() -> list[str]:
    """Return the serial numbers, or ports, of what looks like KDC101 or TDC001 controllers."""
    from serial.tools import list_ports

    found = []
    for one in list_ports.comports():
        serial = one.serial_number or ""
        if (one.vid, one.pid) == (_VENDOR, _PRODUCT) or serial.startswith(_SERIALS):
            found.append(serial or one.device)
    return sorted(found)


def rig_text(row: str, col: str, port: int) -> str:
    """Return the example of a rig file with these devices (see there) and UDP port of an O3M."""
    changed = {'row = "83000001"': f'row = "{row}"', 'col = "83000002"': f'col = "{col}"'}
    changed["port = 42000"] = f"port = {port}"
    text = EXAMPLE
    for line, told in changed.items():
        text = text.replace(f"\n{line}", f"\n{told}")
    return text


def begin(path: Path, row: str | None, col: str | None, port: int, ask: Ask | None) -> None:
    """Write a rig file from what is given, plugged in, and answered to `ask`; or a DataError."""
    if path.exists():
        raise DataError("there is a rig file already: give it as argument", source=path)
    found = [cube for cube in cubes() if cube not in (row, col)]
    answers = {"row": row, "col": col}
    meant = {"row": "moves the image up and down", "col": "moves it sideways"}
    for axis, given in answers.items():
        if given is not None:
            continue
        likely = found.pop(0) if found else ""
        if ask is not None:
            answers[axis] = ask(f"Port or serial number of the axis that {meant[axis]}", likely)
        elif likely:
            answers[axis] = likely
        if not answers[axis]:
            problem = f"no APT controller is plugged in; give --{axis} SERIAL or PORT"
            raise DataError(problem, field=f"stage.{axis}")
    write_text(path, rig_text(str(answers["row"]), str(answers["col"]), port))


def with_calibration(path: Path, calibration: Path) -> None:
    """Let a rig file that `begin` wrote name a calibration file instead of the nominal map."""
    name = Path(os.path.relpath(calibration, path.parent)).as_posix()
    lines = path.read_text(encoding="utf-8").splitlines()
    other = ("px_per_mm", "rest_mm", "# file", "# lens_field")
    kept = [line for line in lines if not line.startswith(other)]
    kept.insert(kept.index("[calibration]") + 1, f'file = "{name}"')
    write_text(path, "\n".join(kept) + "\n")
