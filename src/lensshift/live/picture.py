"""A picture, how it was made, what can be read off it, and as bytes for the page.

    message = length of the head, u32 | head, JSON padded with blanks to 4 bytes | layers
    layer   = u16, little-endian, row by row: 0 is no value, n is low + (n - 1) step

The head says name, rows, cols, low, step and unit of each layer in the order in which they lie.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array
from lensshift.core.types import Burst, Reconstruction
from lensshift.live.sources import Shot

_LEVELS = 65534  # 0 is kept for what is not known


@dataclass(frozen=True, slots=True)
class Settings:
    """How pictures are made."""

    scale: int = 2  # HR pixels per LR pixel
    method: str = "auto"  # as in `reconstruct`
    # Width of the pixel response in LR px; None: what the source knows, else what the frames show.
    blur_px: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """The latest result."""

    number: int  # counts pictures from 1
    result: Reconstruction  # of `Stream.step`
    shot: Shot  # the latest frame in it
    window: Burst  # all frames in it
    settings: Settings  # how it was made


def residual_over_noise(result: Reconstruction) -> float | None:
    """Return the rms of what the frames and the picture differ by, over the noise; 1 is well.

    None where the method does not compare them.
    """
    misfits = (one.misfit for one in result.channels.values() if one.misfit is not None)
    return next((float(np.sqrt(np.nanmean(one))) for one in misfits), None)


def one_frame(picture: Picture) -> dict[str, Array]:
    """Return the latest frame by channel, each LR pixel as a block of HR pixels."""
    frame, scale = picture.shot.frame, picture.result.scale
    known = {"amplitude": np.abs(frame.amplitude), "distance": frame.distance_m}
    return {
        name: np.kron(np.where(frame.valid, values, np.nan), np.ones((scale, scale)))
        for name, values in known.items()
        if values is not None and name in picture.result.channels
    }


def layers_of(picture: Picture) -> Iterator[tuple[str, str, Array]]:
    """Yield name, unit and values of what the page can show; std of methods that it costs nothing.

    `one.` begins the names of the latest frame, [row col] on the LR grid.
    """
    frame, result = picture.shot.frame, picture.result
    for name, unit in (("amplitude", ""), ("distance", "m")):
        estimate = result.channels.get(name)
        if estimate is None:
            continue
        yield name, unit, np.abs(estimate.image)
        if isinstance(estimate.uncertainty, np.ndarray):
            yield f"std.{name}", unit, estimate.uncertainty
    misfit = [one.misfit for one in result.channels.values() if one.misfit is not None]
    if misfit:
        yield "misfit", "", np.sqrt(misfit[0])
    if result.flying is not None:
        yield "flying", "", result.flying.astype(np.float64)
    yield "one.amplitude", "", np.where(frame.valid, np.abs(frame.amplitude), np.nan)
    if frame.distance_m is not None:
        yield "one.distance", "m", np.where(frame.valid, frame.distance_m, np.nan)


def packed_layers(picture: Picture) -> tuple[list[dict[str, Any]], bytes]:
    """Return what the head says of the layers, and their bytes."""
    told, parts = [], []
    for name, unit, values in layers_of(picture):
        codes, low, step = coded(values)
        rows, cols = values.shape
        size = {"rows": rows, "cols": cols, "low": low, "step": step}
        told.append({"name": name, "unit": unit} | size)
        parts.append(codes.tobytes())
    return told, b"".join(parts)


def coded(values: Array) -> tuple[NDArray[np.uint16], float, float]:
    """Return codes, the value of code 1, and the step from one code to the next."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(values.shape, "<u2"), 0.0, 1.0
    low, high = float(values[known].min()), float(values[known].max())
    step = (high - low) / (_LEVELS - 1) if high > low else 1.0
    codes = np.rint((np.where(known, values, low) - low) / step) + 1.0
    return np.where(known, codes, 0.0).astype("<u2"), low, step


def message(head: Mapping[str, Any], layers: bytes = b"") -> bytes:
    """Return head and layers as one message."""
    text = json.dumps(head, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + layers
