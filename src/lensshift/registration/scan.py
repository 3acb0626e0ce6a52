"""Where a stage goes to be calibrated."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def calibration_scan_mm(
    centre_mm: ArrayLike, span_mm: float | tuple[float, float], *, steps: int = 5
) -> Array:
    """Return the positions [n 2] of a calibration scan, in order; take a frame at each.

    A raster of steps x steps positions, lines there and back, then the same way backwards, so
    that every position is reached from both sides along both axes; the centre before, between
    and after, for the drift. What the axes did last follows from the order alone. A step is to
    be larger than the play.

    Parameters
    ----------
    centre_mm : [2] (row, col) of the stage
    span_mm : whole range along (row, col); best 1 to 2 px of image shift
    steps : positions along an axis, 3 or more; 3 give 21 frames, 5 give 53

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    centre = np.asarray(centre_mm, dtype=np.float64)
    span = np.broadcast_to(np.asarray(span_mm, dtype=np.float64), (2,))
    if centre.shape != (2,) or not np.all(np.isfinite(centre)):
        raise ValueError(f"expected a centre_mm of two finite numbers, got {centre_mm!r}")
    if steps < 3 or steps != int(steps):
        raise ValueError(f"expected 3 steps or more, got {steps}")
    if not np.all(np.isfinite(span)) or not np.all(span > 0):
        raise ValueError(f"expected a positive span_mm, got {span_mm}")
    place = np.linspace(-0.5, 0.5, int(steps))
    raster = [
        (row, col)
        for line, row in enumerate(place)
        for col in (place if line % 2 == 0 else place[::-1])
    ]
    middle = (0.0, 0.0)
    positions = np.array([middle, *raster, middle, *raster[::-1], middle])
    return np.asarray(centre + positions * span)
