"""A picture, how it was made, and what can be read off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.types import Burst, Reconstruction
from lensshift.live.sources import Shot


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
