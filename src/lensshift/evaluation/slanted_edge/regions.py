"""Find the slanted edges of an image: one that fills it, or several, each with its plateaus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lensshift.core.arrays import Mask
from lensshift.evaluation.slanted_edge.geometry import explained_share
from lensshift.evaluation.slanted_edge.result import Region

Image = NDArray[np.float64]
Places = NDArray[np.intp]

_WHOLE_SHARE = 0.8  # of the variance that one step explains: the image is one edge
_MOST_PIXELS = 20_000
_SMOOTHING_PX = 1.0
# A ridge stands out of the gradient's noise by so many of its deviations, and of rounding.
_NOISE_SIGMAS, _LEAST_SHARE_OF_RANGE = 5.0, 2e-3
_IMPULSE_SIGMAS = 6.0  # of 1e6 pixels of normal noise, none does
_LEAST_LENGTH_PX = 10
_CORNER_PX = 3  # left out at both ends of an edge
_HALF_WIDTH_PX = 24  # of a region across its edge, at most
_LEAST_HALF_WIDTH_PX, _GOOD_HALF_WIDTH_PX = 5, 12
_PARTS = (1.0, 0.7, 0.5, 0.35, 0.25)
_STRAIGHT_PX = 0.7  # rms distance of the ridge from its line, smooth bends apart
_CORNER_AWAY_PX = 2.0  # a ridge so far from its chord has a corner there
# Beside an edge lie other things where their gradient is this share of its own, or above noise.
_OTHERS_SHARE = 0.2
_LOUD = 0.05  # of the lines
# Fainter things far beside an edge, along most lines as frames and borders are, are left out where
# enough room is left: a step of so much of the contrast changes the MTF by more. Ghosts lie along
# the edge. Medians of noise are not so far off.
_FAINT_SHARE, _FAINT_SIGMAS = 0.01, 5.0
_LEAST_SHARE = 0.8  # of the variance in a region, but for the noise, that one step must explain
# ISO 12233 takes edges of 5 degrees; below the first the lines of frames lie, and beyond the second
# rows and columns see an edge alike.
_LEAST_ANGLE, _LARGEST_ANGLE = np.deg2rad([2.0, 40.0])
# All phases of the pixel are seen by an edge that crosses one.
_LEAST_CROSSED_PX = 1.0


def find_regions(image: Image) -> list[Region]:
    """Return a region for every slanted edge, the longest first.

    An edge is taken by what is around it, not by what is strongest in the image: straight, slanted
    by 2 to 40 degrees so that it crosses a whole pixel, between two even areas. Lines, bars and
    the frame of a chart are none.

    Parameters
    ----------
    image : [row col], NaN where invalid

    Raises
    ------
    ValueError
        If no edge is found.
    """
    image = np.asarray(image, np.float64)  # integers have no differences below 0
    rows, cols = image.shape
    whole = Region(0, rows, 0, cols)
    valid = np.isfinite(image)
    if not valid.any():
        raise ValueError("expected an edge, got an image without a valid pixel")
    filled = image if valid.all() else np.where(valid, image, np.nanmedian(image))
    # Of white noise: from second differences, most of which see no edge.
    mixed = np.abs(np.diff(np.diff(filled, axis=0), axis=1))
    noise = float(np.median(mixed)) / 0.6745 / 2.0 if mixed.size else 0.0
    filled = _without_impulses(filled, noise)
    image = np.where(valid, filled, np.nan)
    if _share(image, whole, 0.0) > _WHOLE_SHARE:
        return [whole]
    gradient = [ndimage.gaussian_filter1d(filled, _SMOOTHING_PX, axis=k, order=1) for k in (0, 1)]
    for k in (0, 1):
        gradient[k] = ndimage.gaussian_filter1d(gradient[k], _SMOOTHING_PX, axis=1 - k)
    strength = np.hypot(*gradient)
    # The strength of noise is Rayleigh distributed, whose median is 1.18 deviations.
    least = max(
        _NOISE_SIGMAS * float(np.median(strength)) / 1.18,
        _LEAST_SHARE_OF_RANGE * float(np.ptp(filled)),
    )
    found: list[tuple[int, Region]] = []
    for axis in (0, 1):  # 1: the gradient runs along the columns, the edge is near-vertical
        turned = (gradient[axis], gradient[1 - axis], strength)
        across, along, steep = turned if axis == 1 else (one.T for one in turned)
        crest = (steep > least) & (np.abs(across) >= np.abs(along))
        crest[:, 1:-1] &= (steep[:, 1:-1] >= steep[:, :-2]) & (steep[:, 1:-1] > steep[:, 2:])
        for sign in (1, -1):
            for lines, places in _segments(crest & (sign * across > 0)):
                ends, slope_rad = _around(steep, lines, places, least)
                if ends is None:
                    continue
                normal_rad = -slope_rad if axis == 1 else 0.5 * np.pi + slope_rad
                region = Region(*(ends if axis == 1 else (*ends[2:], *ends[:2])))
                if _share(image, region, noise, normal_rad) > _LEAST_SHARE:
                    found.append((len(lines), region))
    if not found:
        raise ValueError(
            "found no slanted edge in the image: expected one of at least "
            f"{_LEAST_LENGTH_PX} lines, 2 to 40 degrees off rows or columns, between two even "
            "areas; give its region"
        )
    return [region for _, region in sorted(found, key=lambda one: -one[0])]


def _without_impulses(image: Image, noise: float) -> Image:
    """Return the image with hot and dead pixels cut to the range of their neighbours."""
    around = np.ones((3, 3), dtype=bool)
    around[1, 1] = False
    low = ndimage.minimum_filter(image, footprint=around)
    high = ndimage.maximum_filter(image, footprint=around)
    slack = high - low + _IMPULSE_SIGMAS * noise
    inside = (image <= high + slack) & (image >= low - slack)
    return np.where(inside, image, np.clip(image, low, high))


def _share(image: Image, region: Region, noise: float, normal_rad: float | None = None) -> float:
    """Return the share of the variance, but for that of the noise, that one step explains."""
    cut = image[region.slices]
    known = np.flatnonzero(np.isfinite(cut))
    if known.size <= 16:
        return 0.0
    known = known[:: max(1, known.size // _MOST_PIXELS)]
    row, col = np.divmod(known, cut.shape[1])
    values = cut[row, col]
    x_px, y_px = col.astype(np.float64), row.astype(np.float64)
    variance = float(np.var(values))
    rest = max(variance - noise**2, 0.0)
    if rest <= 0.1 * noise**2:
        return 0.0
    return explained_share(x_px, y_px, values, normal_rad) * variance / rest


def _segments(crest: Mask) -> list[tuple[Places, Places]]:
    """Return lines and places of the straight parts of all crests, one place a line."""
    labels, count = ndimage.label(crest, structure=np.ones((3, 3)))
    if not count:
        return []
    line, place = np.nonzero(crest)
    label = labels[line, place]
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(1, count + 2))
    parts = []
    for k in np.flatnonzero(np.diff(starts) >= _LEAST_LENGTH_PX + 2 * _CORNER_PX):
        own = order[starts[k] : starts[k + 1]]
        lines, number = np.unique(line[own], return_inverse=True)
        # Of branches the mean of a line is taken, and is no crest.
        means = np.bincount(number, weights=place[own]) / np.bincount(number)
        parts += _split(lines, np.rint(means).astype(np.intp))
    return parts


def _split(lines: Places, places: Places) -> list[tuple[Places, Places]]:
    """Return the parts of a crest between its corners (Ramer 1972, Douglas and Peucker 1973)."""
    if lines.size < _LEAST_LENGTH_PX + 2 * _CORNER_PX:
        return []
    chord = np.interp(lines, [lines[0], lines[-1]], [places[0], places[-1]])
    away_px = np.abs(places - chord)
    worst = int(np.argmax(away_px))
    if away_px[worst] <= _CORNER_AWAY_PX or _off_bend_px(lines, places) < _STRAIGHT_PX:
        return [(lines, places)]
    return _split(lines[: worst + 1], places[: worst + 1]) + _split(lines[worst:], places[worst:])


def _off_bend_px(lines: Places, places: Places) -> float:
    return float(np.std(places - np.polyval(np.polyfit(lines, places, 2), lines)))


def _around(
    strength: Image, lines: Places, places: Places, least: float
) -> tuple[tuple[int, int, int, int] | None, float]:
    """Return the region of one long straight crest above noise, and its angle to the lines."""
    first, last = int(lines[0]) + _CORNER_PX, int(lines[-1]) + 1 - _CORNER_PX
    if last - first < _LEAST_LENGTH_PX:
        return None, 0.0
    inside = (lines >= first) & (lines < last)
    line, place = lines[inside], places[inside]
    slope = float(np.polyfit(line, place, 1)[0])
    bend = np.polyfit(line, place, 2)
    slanted = _LEAST_ANGLE <= abs(np.arctan(slope)) <= _LARGEST_ANGLE
    slanted &= abs(slope) * (last - first) >= _LEAST_CROSSED_PX
    if not slanted or _off_bend_px(line, place) >= _STRAIGHT_PX:
        return None, 0.0
    own, quiet = float(np.median(strength[line, place])), 1.18 * least / _NOISE_SIGMAS
    others = max(_OTHERS_SHARE * own, least)
    best, best_px = None, _LEAST_HALF_WIDTH_PX - 1
    # A long slanted edge leaves its rectangle little room; a part has more, as a wedge's wide end.
    for part in _PARTS:
        length = round(part * (last - first))
        if length < _LEAST_LENGTH_PX or abs(slope) * length < _LEAST_CROSSED_PX:
            break
        spare = last - first - length
        for k in (2, 1, 3, 0, 4) if spare else (0,):
            low = first + k * spare // 4
            at: Image = np.polyval(bend, np.arange(low, low + length)).astype(np.float64)
            faint = quiet + max(_FAINT_SHARE * own, _FAINT_SIGMAS * quiet / np.sqrt(length))
            left, right = _room(strength[low : low + length], at, others, faint)
            if min(left, right) > best_px:
                best_px = min(left, right)
                start, stop = int(np.floor(at.min())) - left, int(np.ceil(at.max())) + right + 1
                best = (low, low + length, max(start, 0), min(stop, strength.shape[1]))
        if best_px >= _GOOD_HALF_WIDTH_PX:
            break
    return best, float(np.arctan(slope))


def _room(strength: Image, centre: Image, others: float, faint: float) -> tuple[int, int]:
    """Return how far even areas reach to both sides of an edge, from its outermost places."""
    count = strength.shape[1]
    low, high = int(np.floor(centre.min())), int(np.ceil(centre.max()))
    lines = np.arange(len(centre))
    away = np.arange(1, high - low + _HALF_WIDTH_PX + 1)
    found = []
    for side in (-1, 1):
        at = np.rint(centre[:, None] + side * away).astype(np.intp)
        valid = (at >= 0) & (at < count)
        seen = strength[lines[:, None], np.clip(at, 0, count - 1)]
        share = np.append(np.mean((seen > others) & valid, axis=0), 0.0)
        # The flank of the edge itself ends where its gradient has fallen on most lines; a tail of
        # it that is longer than itself is the other side of a wedge.
        flank = int(np.argmax(share <= 0.5))
        tail = int(np.argmax(share[flank:] <= _LOUD))
        flank += tail if tail <= flank + _CORNER_PX else 0
        beyond = share[flank:-1] > _LOUD
        free = flank + (int(np.argmax(beyond)) if beyond.any() else beyond.size)
        border = (low if side < 0 else count - 1 - high) + high - low
        # Of a rectangle the corner reaches as much farther as the edge slants.
        room = min(free - 2 if beyond.any() else free, border) - (high - low)
        room = min(room, _HALF_WIDTH_PX)
        beside = strength[:, low - room : low][:, ::-1] if side < 0 else strength[:, high + 1 :]
        upright = np.median(beside[:, : max(room, 0)], axis=0)
        stands_out = upright > faint
        # The flank of a blurred edge falls steadily; two pixels are those of the smoothing.
        first = max(_GOOD_HALF_WIDTH_PX + 2, int(np.argmax(np.append(~stands_out, True))))
        ghost = float(np.median(np.where(valid, seen, 0.0), axis=0)[first:].max(initial=0.0))
        if stands_out[first:].any() and upright[first:].max() > ghost:
            room = first + int(np.argmax(stands_out[first:])) - 2
        found.append(room)
    return found[0], found[1]
