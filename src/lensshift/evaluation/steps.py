"""How many edges a line crosses."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Floats

_STEEP_SHARE = 0.2  # of the steepest place of the line
_APART_PX = 3  # places nearer than this belong to one edge, so does the spike of a flying pixel
_LEAST_SHARE = 0.25  # of the largest step: more than the overshoot of a restoration
_LEAST_SIGMAS = 6.0
OF_NORMAL = 1.4826  # deviation of a normal distribution over its median absolute one


def steps_of(line: Floats) -> list[int]:
    """Return the samples after which the line steps from one level to another, but for noise."""
    jump = np.diff(line)
    steep = np.flatnonzero(np.abs(jump) > _STEEP_SHARE * np.abs(jump).max())
    groups = np.split(steep, np.flatnonzero(np.diff(steep) > _APART_PX) + 1)
    heights = [abs(line[group[-1] + 1] - line[group[0]]) for group in groups if group.size]
    noise = OF_NORMAL / np.sqrt(2.0) * float(np.median(np.abs(jump)))  # of a difference
    least = max(_LEAST_SHARE * max(heights, default=0.0), _LEAST_SIGMAS * noise)
    return [
        int(np.median(group))
        for group, height in zip(groups, heights, strict=False)
        if height > least
    ]


def refuse_two_edges(lines: Floats) -> None:
    """Refuse lines [line n] most of which cross two edges or more; ValueError says where."""
    found = [steps_of(line) for line in lines]
    several = [steps for steps in found if len(steps) > 1]
    if 2 * len(several) > len(lines):
        places = " and ".join(str(place) for place in several[len(several) // 2])
        raise ValueError(
            f"expected one edge across the lines, got several in {len(several)} of {len(lines)} "
            f"lines, as after samples {places}; give a region around one of them"
        )
