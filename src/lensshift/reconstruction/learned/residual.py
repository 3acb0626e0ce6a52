"""Noise that texture hides from all filters, read from what a picture leaves over.

Where texture is in every block, the noise that was read is an upper bound. A picture follows
texture better than any filter of the frames, and what it leaves of them tells the noise, as long
as its prior holds:

    sigma^2 = |y - A x(y)|^2 / (N - tr dAx/dy),   tr dAx/dy = E n^T (A x(y + e n) - A x(y)) / e

for random signs n. The picture depends on the noise that is believed, so it is found again until
that falls no more. Sources: MacKay, Bayesian interpolation (1992), for what well determined
pixels leave; Hutchinson, A stochastic estimator of the trace (1990).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.forward.operator import single
from lensshift.reconstruction.learned.belief import middle_of
from lensshift.reconstruction.learned.solver import Asked, Solution

# Of the noise: less is lost in single precision, and more is another picture.
PROBE = 0.3
# Where a picture follows the frames wherever they lead, what it leaves is the error of its model.
LEAST_LEFT = 0.05
# Most of what texture adds is gone after three; a fall that goes on is one of many small steps.
MOST_READINGS = 8
# A change by less changes no picture.
SAME = 0.95


def less_noise(asked: Asked, solve: Callable[[Asked], Solution]) -> float:
    """Return how many times the noise there is that was believed of the frames, 1 at most."""
    asked = replace(middle_of(asked), on_stage=None)
    used = np.isfinite(asked.sigma)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], asked.y.shape)
    A, factor = asked.model.operator, 1.0
    for _ in range(MOST_READINGS):
        believed = replace(asked, sigma=asked.sigma * factor)
        step = PROBE * np.where(used, believed.sigma, 0.0)
        moved = replace(believed, y=(asked.y + step * signs).astype(asked.y.dtype))
        seen, other = (A.forward(single(solve(one).image)) for one in (believed, moved))
        followed = signs[used] * (other - seen)[used] / step[used]
        left = 1.0 - float(np.mean(followed.real))
        if left < LEAST_LEFT:
            break
        size = np.median(np.abs(asked.y - seen)[used] / believed.sigma[used]) / MEDIAN_SIZE
        change = float(size) / np.sqrt(left)
        factor *= min(change, 1.0)
        if change > SAME or factor == 0.0:  # or nothing is left
            break
    return factor
