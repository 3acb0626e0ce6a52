"""An emulated rig in a process of its own: what it computes slows no picture."""

from __future__ import annotations

import multiprocessing
import signal
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from lensshift.capture.opening import Rig, open_rig
from lensshift.core.errors import DeviceError

# Stages take some thirty milliseconds to settle, whatever their speed, because their protocol
# wants to be asked thrice; so with three frames at each place there are about 28 a second. A
# faster camera would give more, and take from the pictures the time that it is emulated in.
RATE_HZ, SPEED, FRAMES = 70.0, 100.0, 3
_READY_S = 120.0  # the first start after an installation compiles
_PATIENCE_S = 20.0  # for the end of the process


@contextmanager
def emulated_rig() -> Iterator[Rig]:
    """Start the emulated devices and open them as a rig; DeviceError if they do not start."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_emulate, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    try:
        table = tomllib.loads(_said(ours))
        table["acquisition"] = {"frames": FRAMES, "frame_timeout_s": _PATIENCE_S}
        with open_rig(table) as rig:
            yield rig
    finally:
        ours.close()  # which tells it to end
        process.join(_PATIENCE_S)


def _said(ours: Connection) -> str:
    with suppress(EOFError, OSError):
        if ours.poll(_READY_S):
            return str(ours.recv())
    raise DeviceError("did not start", device="emulated rig")


def _emulate(theirs: Any) -> None:
    """Emulate until the other end of the pipe is closed, also by the death of its process."""
    # Ctrl-C reaches all processes of a terminal; the stages must still take the lens to rest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from lensshift.capture.emulators.listener import free_udp_port
    from lensshift.capture.emulators.rig import EmulatedRig, RigSettings

    settings = RigSettings(speed=SPEED, rate_hz=RATE_HZ)
    with EmulatedRig(settings, camera_port=free_udp_port()) as rig, suppress(EOFError, OSError):
        theirs.send(rig.rig_file())
        theirs.recv()
