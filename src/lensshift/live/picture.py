"""A picture, how it was made, and what can be read off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.types import Burst, Reconstruction
from lensshift.live.sources import Shot


@dataclass(frozen=True, slots=True)
class Settings:
    """How pictures are made.

    Parameters
    ----------
    scale : HR pixels per LR pixel
    method : as in `reconstruct`
    blur_px : width of the pixel response in LR pixels; None: what the source knows, else
        what the frames show
    """

    scale: int = 2
    method: str = "auto"
    blur_px: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """The latest result.

    Parameters
    ----------
    number : counts pictures from 1
    result : of `Stream.step`
    shot : the latest frame in it
    window : all frames in it
    settings : how it was made
    """

    number: int
    result: Reconstruction
    shot: Shot
    window: Burst
    settings: Settings


def residual_over_noise(result: Reconstruction) -> float | None:
    """Return the rms of what the frames and the picture differ by, over the noise; 1 is well.

    None where the method does not compare them.
    """
    for estimate in result.channels.values():
        if estimate.misfit is not None:
            return float(np.sqrt(np.nanmean(estimate.misfit)))
    return None


def one_frame(picture: Picture) -> dict[str, Array]:
    """Return the latest frame by channel, each LR pixel as a block of HR pixels."""
    frame, scale = picture.shot.frame, picture.result.scale
    known = {"amplitude": np.abs(frame.amplitude), "distance": frame.distance_m}
    return {
        name: np.kron(np.where(frame.valid, values, np.nan), np.ones((scale, scale)))
        for name, values in known.items()
        if values is not None and name in picture.result.channels
    }
