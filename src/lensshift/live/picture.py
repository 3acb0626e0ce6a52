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
from lensshift.core.types import Burst, Frame, Reconstruction
from lensshift.io.picture_layers import UNITS
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


def frame_images(frame: Frame) -> dict[str, Array]:
    """Return the images [row col] of a frame by channel, NaN where it is not valid."""
    known = {"amplitude": np.abs(frame.amplitude), "distance": frame.distance_m}
    return {name: np.where(frame.valid, y, np.nan) for name, y in known.items() if y is not None}


def one_frame(picture: Picture) -> dict[str, Array]:
    """Return the latest frame by channel, each LR pixel as a block of HR pixels."""
    block = np.ones((picture.result.scale, picture.result.scale))
    seen, wanted = frame_images(picture.shot.frame), picture.result.channels
    return {name: np.kron(values, block) for name, values in seen.items() if name in wanted}


def layers_of(picture: Picture) -> Iterator[tuple[str, str, Array]]:
    """Yield name, unit and values of what the page can show; std of methods that it costs nothing.

    `one.` begins the names of the latest frame, [row col] on the LR grid.
    """
    result = picture.result
    for name, estimate in result.channels.items():
        yield name, UNITS[name], np.abs(estimate.image)
        if isinstance(estimate.uncertainty, np.ndarray):
            yield f"std.{name}", UNITS[name], estimate.uncertainty
    misfit = [one.misfit for one in result.channels.values() if one.misfit is not None]
    if misfit:
        yield "misfit", "", np.sqrt(misfit[0])
    if result.flying is not None:
        yield "flying", "", result.flying.astype(np.float64)
    for name, values in frame_images(picture.shot.frame).items():
        yield f"one.{name}", UNITS[name], values


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
