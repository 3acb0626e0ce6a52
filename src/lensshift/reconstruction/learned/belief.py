"""How far frames are believed that no picture fits: as far as they predict each other.

Noise is read where frames are quiet. Frames of a camera that sharpens, compresses, shakes or turns
differ by more than that, and not only where something moved. Then no noise that was read says how
closely the picture should follow them, but half of the frames can say it of the others:

    (f, robust) = arg min  sum over halves of  mean |y_k - A_k x(the other half; f sigma, robust)|
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.forward.operator import single
from lensshift.reconstruction.learned.solver import Asked, Solution

# Variance over that of the noise as it was read, of half of the pixels in half of the frames; it
# was below 1.3 in all of 112 bursts of photographs, print and shapes, some of them with outliers,
# a bad frame, or shifts 0.05 px off.
REFUTED = 1.3
# The noise times these; what is between two of them makes hardly a difference.
FACTORS = (0.5, 1.0, 2.0, 4.0)
# Another belief has to predict this much better than the noise that was read: half of the frames is
# not all of them.
BETTER = 0.97
# Fewer frames than this in each half predict others by what the prior adds.
LEAST_HALF = 3


def refuted(asked: Asked, found: Solution) -> bool:
    """Tell whether most pixels of most frames are off by more than their noise."""
    if len(asked.y) < 2 * LEAST_HALF or asked.of_phasors:
        return False
    rest = (asked.y - asked.model.operator.forward(single(found.image))) / asked.sigma
    squares = [np.median(r[s < np.inf] ** 2) for r, s in zip(rest, asked.sigma, strict=True)]
    return bool(np.nanmedian(squares) > REFUTED * MEDIAN_SIZE**2)


def as_predicted(asked: Asked, solve: Callable[[Asked], Solution]) -> Asked:
    """Return what is asked with the noise, and the belief in outliers, that predict best."""
    used = np.isfinite(asked.sigma)
    even = np.full(asked.sigma.shape, np.sqrt(np.mean(asked.sigma[used] ** 2)))
    even[~used] = np.inf
    tried = [asked] + [
        replace(asked, sigma=factor * even, alike=alike)
        for factor in FACTORS for alike in (False, True)
    ]  # fmt: skip
    errors = [_error(one, solve) for one in tried]
    best = int(np.argmin(errors))
    return tried[best if errors[best] < BETTER * errors[0] else 0]


def _error(asked: Asked, solve: Callable[[Asked], Solution]) -> float:
    """Return the mean error of frames that are predicted from every other one."""
    frame, used, total = np.arange(len(asked.y)), np.isfinite(asked.sigma), 0.0
    for half in (0, 1):
        known = (frame % 2 == half)[:, None, None]
        found = solve(replace(asked, sigma=np.where(known, asked.sigma, np.inf), on_stage=None))
        rest = asked.y - asked.model.operator.forward(single(found.image))
        total += float(np.mean(np.abs(rest[used & ~known])))
    return total
