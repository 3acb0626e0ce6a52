"""What does not belong to an edge: single pixels that stand out, further edges, mere noise."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from lensshift.core.arrays import Mask
from lensshift.evaluation.edge_gradient import OF_NORMAL
from lensshift.evaluation.slanted_edge.edge_model import Vector
from lensshift.evaluation.slanted_edge.prepare import Pixels, UprightEdge, turn_upright

_LEAST_RISES = 3  # between the levels of a line that noise or an edge varies
_STANDS_OUT = 6.0  # deviations; of 1e6 pixels of normal noise, none does
_MOST_PASSES = 6
_MOST_OUT = 0.05  # of the pixels; what is more frequent is no exception
_LEAST_OUT = 0.01  # of the contrast, as a deviation: the blocks of a JPEG are no dust
_BIN_UNITS = 2.0
_FEWEST_IN_BIN = 16
_BLUR_UNITS = 3.0  # from an edge, where all but a thousandth of a Gaussian has passed
_WRONG_SIDE = 0.6  # of the contrast
_LEAST_EVIDENCE = 8.0  # deviations of the contrast; the best split of mere noise reaches 5


def screened(pixels: Pixels, aperture_px: float, most_bends: int) -> tuple[UprightEdge, int]:
    """Return the upright edge without the pixels that stand out, and their number.

    Hot pixels and dust are told by their distance from a free ESF, in units of the median distance
    of the pixels that lie as far from the edge. Raises `ValueError` if there is no edge, or a
    second one.
    """
    dead = _dead_lines(pixels)
    pixels = pixels.without(dead)
    none = np.zeros(pixels.values.size, dtype=bool)
    edge, out = _told_apart(pixels, aperture_px, most_bends, none)
    if out.any() and most_bends:
        # Dust on an edge looks like a bend of it, and pixels beside it stand out instead.
        straight = _told_apart(pixels, aperture_px, 0, none)[1]
        other = _told_apart(pixels, aperture_px, most_bends, straight)
        edge, out = min((edge, out), other, key=lambda one: _left_over(*one))
    edge = edge.without(out)
    _refuse_others(edge)
    return edge, int(dead.sum() + out.sum())


def _dead_lines(pixels: Pixels) -> Mask:
    """Return the pixels of rows and columns that hold one value, between others that do not.

    They may be more than pixels that stand out by chance ever are, and lie along the edge. Several
    at a border are a plateau without noise.
    """
    frame, row, col = pixels.places.T
    dead = np.zeros(frame.size, dtype=bool)
    for line in (row, col):
        number = frame * (line.max() + 2) + line + 1  # a free one on either side of a frame
        order = np.lexsort((pixels.values, number))
        own, levels = number[order], pixels.values[order]
        rises = (np.diff(own) == 0) & (np.diff(levels) > 0.0)
        count = np.bincount(own[1:][rises], minlength=number.max() + 2)
        known = np.bincount(own, minlength=count.size) > 0
        runs, _ = ndimage.label(known & (count == 0))
        for (run,) in ndimage.find_objects(runs):
            beside = np.array([run.start - 1, run.stop])
            if run.stop - run.start == 1:
                beside = beside[known[beside]]
            if np.all(count[beside] >= _LEAST_RISES) and beside.size:
                dead |= (number >= run.start) & (number < run.stop)
    return dead


def _told_apart(
    pixels: Pixels, aperture_px: float, most_bends: int, out: Mask
) -> tuple[UprightEdge, Mask]:
    """Return the edge as the pixels that do not stand out tell it, and which do, `out` at first.

    Each time the edge is found without them, all are asked again: the worst hide others.
    """
    edge = turn_upright(pixels, aperture_px, most_bends, out)
    for _ in range(_MOST_PASSES):
        more = _standing_out(edge, out)
        others = _other_things(edge, more)
        if np.mean(more & ~others) > _MOST_OUT or np.array_equal(more | others, out):
            break
        out = more | others
        edge = turn_upright(pixels, aperture_px, most_bends, out)
    return edge, out


def _other_things(edge: UprightEdge, out: Mask) -> Mask:
    """Return pixels of patches that stand out aside of the edge: no chance, but other things."""
    frame, row, col = edge.pixels.places.T
    image = np.zeros(edge.pixels.places.max(axis=0) + 1, dtype=bool)
    image[frame, row, col] = out
    plane = np.ones((1, 3, 3), dtype=bool)
    labels, count = ndimage.label(image, np.pad(plane, ((1, 1), (0, 0), (0, 0))))
    number, away_px = labels[frame, row, col], np.abs(edge.normal_px)
    sizes = np.bincount(number, minlength=count + 1)
    middle_px = np.asarray(ndimage.median(away_px, number, np.arange(count + 1)))
    aside = (sizes >= _FEWEST_IN_BIN) & (middle_px > _BLUR_UNITS * edge.unit_px)
    aside[0] = False
    blur = round(_BLUR_UNITS * edge.unit_px)
    patches = ndimage.binary_dilation(aside[labels], plane, iterations=blur)
    return np.asarray(patches[frame, row, col])


def _left_over(edge: UprightEdge, out: Mask) -> float:
    """Return what a free ESF leaves of the pixels that are not out, rms."""
    rest = edge.scaled - edge.response_without(out).of(edge.scaled)[0]
    return float(np.sqrt(np.mean(rest[~out] ** 2)))


def _standing_out(edge: UprightEdge, out: Mask) -> Mask:
    response = edge.response_without(out) if out.any() else edge.free_response
    rest = edge.scaled - response.of(edge.scaled)[0]
    bins = _Bins(edge)
    # Half of the pixels may hold one grey level: each is spread over its step before it is asked.
    levels, which = np.unique(edge.scaled, return_inverse=True)
    steps = np.minimum(np.diff(levels, prepend=-np.inf), np.diff(levels, append=np.inf))
    share = np.random.default_rng(0).uniform(-0.5, 0.5, rest.size)
    spread = (
        rest + share * bins.medians(np.where(np.isfinite(steps), steps, 1.0)[which])[bins.number]
    )
    middle, deviation = bins.levels(spread)
    limit = np.where(bins.large, _STANDS_OUT * np.maximum(deviation, _LEAST_OUT), np.inf)
    return np.asarray(np.abs(rest - middle[bins.number]) > limit[bins.number])


class _Bins:
    """Bins of pixels by distance from the edge: of each pixel [n]; size [b]; if large enough."""

    def __init__(self, edge: UprightEdge) -> None:
        number = np.floor(edge.normal_px / (_BIN_UNITS * edge.unit_px)).astype(np.intp)
        self.number = number - number.min()
        self.size = np.bincount(self.number)
        self.large: Mask = self.size >= _FEWEST_IN_BIN

    def medians(self, values: Vector) -> Vector:
        """Return the median of values [n] in every bin [b]."""
        return np.asarray(ndimage.median(values, self.number, np.arange(self.size.size)))

    def levels(self, values: Vector) -> tuple[Vector, Vector]:
        """Return median and deviation of values [n] in every bin [b]."""
        middle = self.medians(values)
        return middle, OF_NORMAL * self.medians(np.abs(values - middle[self.number]))


def _refuse_others(edge: UprightEdge) -> None:
    """Refuse a region with a second edge, or none."""
    normal_px, bins = edge.normal_px, _Bins(edge)
    middle, deviation = bins.levels(edge.scaled)
    place_px = bins.medians(normal_px)
    slack = _WRONG_SIDE + 4.0 * deviation / np.sqrt(np.maximum(bins.size, 1))
    slack[np.abs(place_px) <= _BLUR_UNITS * edge.unit_px] += 1.0
    wrong = bins.large & (np.abs(middle - (place_px > 0.0)) > slack)
    if wrong.any():
        raise ValueError(
            f"expected one edge between two even areas, got a second one about "
            f"{abs(place_px[np.argmax(wrong)]):.0f} px from the first (a bar, or two edges); "
            "choose a region around one of them"
        )
    counts = [int(np.sum(normal_px > 0)), int(np.sum(normal_px < 0))]
    noise = float(np.median(deviation[bins.large])) if bins.large.any() else 0.0
    if noise * np.sqrt(sum(1.0 / max(count, 1) for count in counts)) * _LEAST_EVIDENCE > 1.0:
        raise ValueError(
            f"expected an edge, got noise: the best step is {1.0 / noise:.2g} of a pixel's noise; "
            "choose a region with an edge, or average frames"
        )
