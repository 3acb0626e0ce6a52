"""A camera of square pixels that owes nothing to lensshift: box means of a finely sampled scene."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.types import Burst

Array = NDArray[Any]
# (row, col) in LR pixels, 0 at the centre of the first pixel -> brightness
Scene = Callable[[Array, Array], Array]

FINE = 8
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])


def smooth_scene(row: Array, col: Array) -> Array:
    """Slow waves about 0.5."""
    return 0.5 + 0.2 * np.sin(row / 7.0) + 0.15 * np.cos(col / 9.0 + row / 21.0)


def edge_scene(row: Array, col: Array) -> Array:
    """Dark left, bright right, parted by a straight slanted edge."""
    return np.where(col - 0.18 * row > 8.0, 0.8, 0.2) * np.ones(np.broadcast(row, col).shape)


def photograph(
    scene: Scene, shape: tuple[int, int], offset_px: ArrayLike, scale: int = 1, fine: int = FINE
) -> NDArray[np.float64]:
    """Return the frames [frame row col]; with one offset 0 and a scale, the HR truth.

    `fine` x `fine` points in a pixel: edges along the pixels move by whole steps of these.
    """
    offsets = np.atleast_2d(np.asarray(offset_px, np.float64))
    return np.stack(
        [_frame(scene, shape, (row, col), scale, fine) for row, col in offsets.tolist()]
    )


@lru_cache(maxsize=200)  # many tests look at the same scene from the same places
def _frame(
    scene: Scene, shape: tuple[int, int], offset_px: tuple[float, float], scale: int, fine: int
) -> NDArray[np.float64]:
    step = 1.0 / (fine * scale)
    rows, cols = (-0.5 + step * (np.arange(n * scale * fine) + 0.5) for n in shape)
    seen = scene(rows[:, None] - offset_px[0], cols[None, :] - offset_px[1])
    return seen.reshape(shape[0] * scale, fine, shape[1] * scale, fine).mean(axis=(1, 3))


def truth(scene: Scene, shape: tuple[int, int], scale: int) -> NDArray[np.float64]:
    """Return the image that pixels smaller by `scale` would see."""
    return photograph(scene, shape, (0.0, 0.0), scale)[0]


def make_burst(frames: Array, offset_px: ArrayLike = SQUARE_PX, **fields: Any) -> Burst:
    """Wrap frames into a burst."""
    return Burst.from_arrays(frames, offset_px=offset_px, pitch_mm=0.01, **fields)


def interior_psnr(image: Array, reference: Array, border: int = 4) -> float:
    """Peak 1, without the border."""
    inside = (slice(border, -border), slice(border, -border))
    return float(-10.0 * np.log10(np.mean((image[inside] - reference[inside]) ** 2)))
