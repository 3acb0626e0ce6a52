"""What does not belong to an edge: single pixels that stand out, further edges, mere noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge.edge_model import Vector
from lensshift.evaluation.slanted_edge.prepare import Pixels, UprightEdge, turn_upright

_STANDS_OUT = 6.0  # deviations; of 1e6 pixels of normal noise, none does
_MOST_OUT = 0.05  # of the pixels; what is more frequent is no exception
_LEAST_OUT = 0.01  # of the contrast, as a deviation: the blocks of a JPEG are no dust
_OF_GREY_LEVEL = 0.3  # as a deviation, that of rounding
_BIN_UNITS = 2.0
_FEWEST_IN_BIN = 16
_OF_NORMAL = 1.4826  # deviation of a normal distribution over its median absolute one
_WRONG_SIDE = 0.6  # of the contrast
_LEAST_EVIDENCE = 8.0  # deviations of the contrast; the best split of mere noise reaches 5


def screened(pixels: Pixels, aperture_px: float, most_bends: int) -> tuple[UprightEdge, int]:
    """Return the upright edge without the pixels that stand out, and their number.

    Hot pixels and dust are told by their distance from a free ESF, in units of the median distance
    of the pixels that lie as far from the edge.

    Parameters
    ----------
    pixels : the region
    aperture_px, most_bends : as in `turn_upright`

    Raises
    ------
    ValueError
        If there is no edge, or a second one.
    """
    edge = turn_upright(pixels, aperture_px, most_bends)
    out = np.zeros(edge.scaled.size, dtype=bool)
    for _ in range(2):  # the worst hide others
        more = _standing_out(edge, ~out)
        if np.array_equal(more, out) or np.mean(more) > _MOST_OUT:
            break
        out = more
    if out.any():
        kept = Pixels(
            pixels.places[~out], pixels.row_px[~out], pixels.col_px[~out], pixels.values[~out]
        )
        edge = turn_upright(kept, aperture_px, most_bends)
    _refuse_others(edge)
    return edge, int(out.sum())


def _standing_out(edge: UprightEdge, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    normal_px = edge.normal_px
    rest = edge.scaled - edge.free_response(used)
    out = np.zeros(rest.size, dtype=bool)
    levels = np.unique(edge.scaled)  # neighbouring grey levels are no exception
    least = max(_LEAST_OUT, _OF_GREY_LEVEL * float(np.min(np.diff(levels), initial=1.0)))
    for members in _bins(edge, normal_px):
        near = rest[members]
        middle = np.median(near)
        deviation = _OF_NORMAL * np.median(np.abs(near - middle))
        out[members] = np.abs(near - middle) > _STANDS_OUT * max(deviation, least)
    return out


def _bins(edge: UprightEdge, normal_px: Vector) -> list[NDArray[np.intp]]:
    """Return the pixels by their distance from the edge, groups that tell a median."""
    number = np.floor(normal_px / (_BIN_UNITS * edge.unit_px)).astype(np.intp)
    order = np.argsort(number, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    return [group for group in groups if group.size >= _FEWEST_IN_BIN]


def _refuse_others(edge: UprightEdge) -> None:
    """Refuse a region with a second edge, or none."""
    normal_px, deviations = edge.normal_px, []
    for members in _bins(edge, normal_px):
        values = edge.scaled[members]
        middle = float(np.median(values))
        deviation = _OF_NORMAL * float(np.median(np.abs(values - middle)))
        deviations.append(deviation)
        place_px = float(np.median(normal_px[members]))
        slack = _WRONG_SIDE + 4.0 * deviation / np.sqrt(members.size)
        side = float(place_px > 0.0)
        far = abs(place_px) > 3.0 * edge.unit_px
        if abs(middle - side) > (slack if far else 1.0 + slack):
            raise ValueError(
                f"expected one edge between two even areas, got a second one about "
                f"{abs(place_px):.0f} px from the first (a bar, or two edges); "
                "choose a region around one of them"
            )
    counts = [int(np.sum(normal_px > 0)), int(np.sum(normal_px < 0))]
    noise = float(np.median(deviations)) if deviations else 0.0
    if noise * np.sqrt(sum(1.0 / max(count, 1) for count in counts)) * _LEAST_EVIDENCE > 1.0:
        raise ValueError(
            f"expected an edge, got noise: the best step is {1.0 / noise:.2g} of a pixel's noise; "
            "choose a region with an edge, or average frames"
        )
