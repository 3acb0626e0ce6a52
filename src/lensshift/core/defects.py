"""Pixels that show the same whatever lies before them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# A pixel is stuck if it stands out of its neighbours, in all frames, by this many times what they
# and it change by: a point of light that moves by a quarter pixel behind a lens of 0.2 px lends a
# neighbour a tenth of itself.
STANDS_OUT = 10.0
# And by this part of the standard deviation of the frames: less does little harm, and a flat hill
# whose top is one level of a converter higher does so, too.
LEAST_CONTRAST = 0.5
# Fewer frames show no change that noise would not.
LEAST_FRAMES = 3


def stuck_pixels(
    frames: NDArray[Any], valid: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_] | None:
    """Return the pixels [row col] that do not follow a scene that moves, None if there are none.

        min_k y - max_k of 8 neighbours > 10 max over the 9 of (max_k y - min_k y),   or below them

    Hot and dead pixels lie at one place in all frames: they hold shifts that are looked for at 0,
    and the picture shows them as squares. The frames have to lie apart by a good part of a pixel.

    Parameters
    ----------
    frames : [frame row col] real
    valid : [frame row col], None: all pixels are; neighbours that are not count as alike
    """
    if len(frames) < LEAST_FRAMES or min(frames.shape[1:]) < 3:
        return None
    used = np.ones(frames.shape, np.bool_) if valid is None else valid
    highest = np.where(used, frames, -np.inf).max(axis=0)
    lowest = np.where(used, frames, np.inf).min(axis=0)
    most, least = _of_neighbours(highest, np.maximum), _of_neighbours(lowest, np.minimum)
    stands_out = np.maximum(lowest - most, least - highest)
    change = np.maximum(highest - lowest, 0.0)  # -inf where a pixel is never valid
    change = np.maximum(change, _of_neighbours(change, np.maximum))
    limit = np.maximum(STANDS_OUT * change, LEAST_CONTRAST * float(np.std(frames[used])))
    stuck = used.all(axis=0) & np.isfinite(stands_out) & (stands_out > limit)
    return stuck if stuck.any() else None


def _of_neighbours(values: NDArray[Any], least_or_most: np.ufunc) -> NDArray[Any]:
    """Return the least or the most [row col] of the eight neighbours that there are."""
    beyond = np.inf if least_or_most is np.minimum else -np.inf
    rows, cols = values.shape
    padded = np.pad(values, 1, constant_values=beyond)
    found = np.full(values.shape, beyond)
    for i, j in np.ndindex(3, 3):
        if (i, j) != (1, 1):
            least_or_most(found, padded[i : i + rows, j : j + cols], out=found)
    return found
