"""Where to send the image, and in which order the lens goes there."""

from __future__ import annotations

from itertools import combinations, pairwise, permutations
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import DataError
from lensshift.core.motion import ShiftPlan
from lensshift.core.pattern import PATTERNS, named_pattern_px

PLANS = (*PATTERNS, "quincunx", "spiral")


def named_plan(name: str) -> ShiftPlan:
    """Return a plan by its name.

    square, 3x3, 4x4 : n x n places (i + 1/2) / n - 1/2 px, which sample every pixel evenly
    quincunx : two places on a diagonal, the least that gains resolution both ways
    spiral : 3x3 from the middle outwards, so that every first part of it is a useful burst
    still : one place

    Raises
    ------
    ValueError
        If there is no such plan.
    """
    if name in PATTERNS:
        return ShiftPlan(named_pattern_px(name), name=name)
    if name == "quincunx":
        return ShiftPlan(np.array([[-0.25, -0.25], [0.25, 0.25]]), name=name)
    if name == "spiral":
        turn = [(0, 0), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]
        return ShiftPlan(np.array(turn) / 3.0, reference=0, name=name)
    raise ValueError(f"expected a plan of {', '.join(PLANS)}, got {name!r}")


def load_plan(path: str | Path) -> ShiftPlan:
    """Read a plan of the user's own: a table of image offsets in px, as CSV or JSON.

    Raises
    ------
    DataError
        If the file cannot be read or holds no offsets.
    """
    from lensshift.io import load_offsets

    table = load_offsets(path)
    if not len(table.offset_px):
        raise DataError("expected at least one offset", source=path)
    return ShiftPlan(table.offset_px, name=Path(path).stem)


def shortest_order(
    position_mm: ArrayLike, approach_mm: ArrayLike, start_mm: ArrayLike
) -> list[int]:
    """Return the order [frame] in which the stage visits its positions with the least way.

        way a -> b = max over axes of |b - a|, + 2 approach where an axis goes back

    A move against the direction of approach goes beyond its target and returns. Up to eight
    positions: the best of all orders; more: nearest neighbours, then bettered by reversing
    parts (2-opt) until nothing gains.

    Parameters
    ----------
    position_mm : [frame 2]
    approach_mm : how far the stage overruns, one number or (row, col); negative where every move
        ends backward
    start_mm : [2] where it stands before
    """
    places = np.concatenate([np.atleast_2d(start_mm), np.atleast_2d(position_mm)]).astype(float)
    step = places[None] - places[:, None]
    run_up = np.asarray(approach_mm, dtype=np.float64)
    way = np.max(np.abs(step) + 2.0 * np.abs(run_up) * (step * run_up < 0), axis=-1)
    count = len(places) - 1
    if count <= 8:
        orders = np.fromiter(permutations(range(1, count + 1)), dtype=(np.intp, count))
        legs = np.insert(orders, 0, 0, axis=1)
        length = way[legs[:, :-1], legs[:, 1:]].sum(axis=1)
        best = np.argmax(length < length.min() + 1e-12)  # the first where several are as short
        return [int(place) - 1 for place in orders[best]]
    order, left = [], set(range(1, count + 1))
    here = 0
    while left:
        here = min(left, key=lambda place: (way[here, place], place))
        left.remove(here)
        order.append(here)
    return [place - 1 for place in _bettered(order, way)]


def _length(order: list[int], way: Floats) -> float:
    return float(sum(way[a, b] for a, b in pairwise([0, *order])))


def _bettered(order: list[int], way: Floats) -> list[int]:
    length = _length(order, way)
    gained = True
    while gained:
        gained = False
        for i, j in combinations(range(len(order) + 1), 2):
            tried = order[:i] + order[i:j][::-1] + order[j:]
            if (new := _length(tried, way)) < length - 1e-12:
                order, length, gained = tried, new, True
    return order
