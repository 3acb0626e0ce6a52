"""Find the slanted edges of an image: one that fills it, or several, each with its plateaus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lensshift.evaluation.slanted_edge.geometry import explained_share
from lensshift.evaluation.slanted_edge.result import Region

_WHOLE_SHARE = 0.8  # of the variance that one step explains: the image is one edge
_MOST_PIXELS = 20_000
_SMOOTHING_PX = 1.0
_STRONG_SHARE = 0.4  # of the strongest gradient
_LEAST_LENGTH_PX = 10
_CORNER_PX = 3  # left out at both ends of an edge
_HALF_WIDTH_PX = 16  # of a region across its edge
_LEAST_HALF_WIDTH_PX = 5
_STRAIGHT_PX = 1.5  # rms distance of the ridge from its line
_LEAST_SHARE = 0.6  # of the variance in a region that one step must explain
_LARGEST_SLOPE = 1.0


def find_regions(image: NDArray[np.float64]) -> list[Region]:
    """Return a region for every edge, the longest first.

    Parameters
    ----------
    image : [row col], NaN where invalid

    Raises
    ------
    ValueError
        If no edge is found.
    """
    rows, cols = image.shape
    whole = Region(0, rows, 0, cols)
    if not np.any(np.isfinite(image)):
        raise ValueError("expected an edge, got an image without a valid pixel")
    if _share(image, whole) > _WHOLE_SHARE:
        return [whole]
    filled = np.where(np.isfinite(image), image, np.nanmedian(image))
    gradient = [ndimage.gaussian_filter1d(filled, _SMOOTHING_PX, axis=k, order=1) for k in (0, 1)]
    for k in (0, 1):
        gradient[k] = ndimage.gaussian_filter1d(gradient[k], _SMOOTHING_PX, axis=1 - k)
    strength = np.hypot(*gradient)
    strong = strength > _STRONG_SHARE * np.quantile(strength, 0.999)
    found = []
    for axis in (0, 1):  # 1: the gradient runs along the columns, the edge is near-vertical
        steeper = np.abs(gradient[axis]) >= np.abs(gradient[1 - axis])
        for rising in (True, False):
            ridge = strong & steeper & ((gradient[axis] > 0) == rising)
            labels, count = ndimage.label(ridge, structure=np.ones((3, 3)))
            for label in range(1, count + 1):
                region = _around(labels == label, strength, strong, axis == 1)
                if region is not None and _share(image, region) > _LEAST_SHARE:
                    found.append(region)
    if not found:
        raise ValueError(
            "found no slanted edge in the image: expected one of at least "
            f"{_LEAST_LENGTH_PX} lines between two even areas; give its region"
        )
    return found


def _share(image: NDArray[np.float64], region: Region) -> float:
    row, col = np.nonzero(np.isfinite(image[region.slices]))
    values = image[region.slices][row, col]
    every = max(1, values.size // _MOST_PIXELS)
    x_px, y_px = col[::every].astype(np.float64), row[::every].astype(np.float64)
    return explained_share(x_px, y_px, values[::every]) if values.size > 16 else 0.0


def _around(
    ridge: NDArray[np.bool_],
    strength: NDArray[np.float64],
    strong: NDArray[np.bool_],
    vertical: bool,
) -> Region | None:
    """Return the region of one ridge of the gradient, None if it is short, bent or cramped."""
    if not vertical:
        ridge, strength, strong = ridge.T, strength.T, strong.T
    lines, places = np.nonzero(ridge)
    first, last = int(lines.min()) + _CORNER_PX, int(lines.max()) + 1 - _CORNER_PX
    if last - first < _LEAST_LENGTH_PX:
        return None
    weights = np.bincount(lines, weights=strength[lines, places])
    sums = np.bincount(lines, weights=strength[lines, places] * places)
    line = np.arange(first, last)
    if np.any(weights[first:last] == 0.0):
        return None
    centre = sums[first:last] / weights[first:last]
    slope, offset = np.polyfit(line, centre, 1)
    straight = np.std(centre - slope * line - offset) < _STRAIGHT_PX
    if not straight or abs(slope) > _LARGEST_SLOPE:
        return None
    left, right = int(np.floor(centre.min())), int(np.ceil(centre.max()))
    own = ndimage.binary_dilation(ridge, iterations=2)
    others = np.any((strong & ~own)[first:last], axis=0)
    start = _free(others, left, -1)
    stop = _free(others, right, +1) + 1
    if left - start < _LEAST_HALF_WIDTH_PX or stop - 1 - right < _LEAST_HALF_WIDTH_PX:
        return None
    region = Region(first, last, start, stop)
    return region if vertical else Region(start, stop, first, last)


def _free(others: NDArray[np.bool_], place: int, step: int) -> int:
    """Return how far a region may reach from `place` before it meets another edge."""
    for distance in range(1, _HALF_WIDTH_PX + 1):
        at = place + step * distance
        if not 0 <= at < others.size:
            return at - step
        if others[at]:
            return place + step * max(distance - 2, 0)
    return place + step * _HALF_WIDTH_PX
