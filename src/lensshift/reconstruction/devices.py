"""Where the method "auto" finds its pictures, if not in the kernels of this processor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from lensshift.reconstruction.learned.solver import Solve, SolveTogether, solve_together


@dataclass(frozen=True, slots=True)
class Device:
    """A device by its name, and what finds the picture of one burst on it."""

    name: str
    solve: Solve


def solver_on(name: str) -> SolveTogether:
    """Return what finds the pictures of several bursts on a device, see `device_kernels`."""
    from lensshift.reconstruction.learned.device import device_kernels

    return partial(solve_together, on=device_kernels(name))


def on_device(device: str | Device | None, method: str) -> Device | None:
    """Return a device by its name, None for the kernels of this processor.

    Raises
    ------
    ValueError
        If there is no such device, or the method has nothing to do on it.
    ImportError
        If it needs PyTorch, which is not installed.
    """
    if device is None:
        return None
    if method != "auto":
        raise ValueError(
            f"device: only the method 'auto' has one, {method!r} is computed on this processor"
        )
    if isinstance(device, Device):
        return device
    solve = solver_on(device)
    return Device(device, lambda asked: solve([asked])[0])
