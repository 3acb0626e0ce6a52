"""Where a stage goes to be calibrated."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats

USUAL_STEPS = 4  # along each axis, from both sides: 35 positions


def calibration_scan_mm(
    centre_mm: ArrayLike, span_mm: float | tuple[float, float], *, steps: int = 5
) -> Floats:
    """Return the positions [n 2] of a calibration scan, in order; take a frame at each.

    A slanted raster of steps x steps positions, lines there and back, then backwards, so that
    every place is approached from both sides along both axes; the centre before, between and
    after, for the drift. What the axes did last follows from the order alone. No row and no
    column comes twice: what registration makes of a sharp edge depends on where it falls within
    a pixel, which would else be the same error again and again, and a bias of the map.

    Parameters
    ----------
    centre_mm : [2] (row, col) of the stage
    span_mm : whole range along (row, col); best 1 to 2 px of image shift
    steps : lines, and positions in each, 3 or more; 3 give 21 frames, 5 give 53. The least motion
        along an axis, span_mm / (steps^2 - 1/2), is to be larger than the play

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
    steps = int(steps)
    count = steps**2
    line, within = np.divmod(np.arange(count), steps)
    # Lines there and back; the columns of the lines interleave.
    there = steps * np.where(line % 2 == 0, within, steps - 1 - within) + line
    raster = 2 * np.stack([np.arange(count), there], axis=-1)
    places = np.concatenate([raster, raster[::-1] + 1]) / (2 * count - 1) - 0.5
    middle = np.zeros((1, 2))
    positions = np.concatenate([middle, places[:count], middle, places[count:], middle])
    return np.asarray(centre + positions * span)
