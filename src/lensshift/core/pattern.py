"""Where the image is sent in each frame of a burst."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_PER_SIDE = {"square": 2, "3x3": 3, "4x4": 4, "still": 1}
PATTERNS = tuple(_PER_SIDE)


def grid_pattern_px(per_side: int) -> NDArray[np.float64]:
    """Return offsets [frame 2] that sample every pixel at n x n evenly spread places.

        offset = (i + 1/2) / n - 1/2,  i = 0 .. n - 1

    Rows go back and forth, so that each step is to a neighbour. For n = 2 they are a quarter of a
    pixel to all four sides.

    Raises
    ------
    ValueError
        If there is not at least one place.
    """
    if per_side != int(per_side) or per_side < 1:
        raise ValueError(f"expected at least one place per side, got {per_side}")
    count = int(per_side)
    places = (np.arange(count) + 0.5) / count - 0.5
    row, col = np.meshgrid(places, places, indexing="ij")
    col[1::2] = places[::-1]
    return np.stack([row, col], axis=-1).reshape(-1, 2)


def named_pattern_px(name: str) -> NDArray[np.float64]:
    """Return the offsets [frame 2] of a pattern by its name.

    square: four frames, a quarter of a pixel to all sides; 3x3, 4x4: `grid_pattern_px`; still:
    one frame.

    Raises
    ------
    ValueError
        If there is no such pattern.
    """
    if name not in _PER_SIDE:
        raise ValueError(f"expected a pattern of {', '.join(PATTERNS)}, got {name!r}")
    return grid_pattern_px(_PER_SIDE[name])
