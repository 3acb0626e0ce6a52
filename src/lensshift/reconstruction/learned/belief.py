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

from lensshift.core.arrays import Floats, Mask
from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.forward.operator import single
from lensshift.reconstruction.displacement import slopes_of
from lensshift.reconstruction.learned.solver import Asked, Solution

# A square pixel and the Gaussian of its width differ at an edge as by this error of a shift: frames
# that are off by no more refute no noise (`displacement.ALLOWED_SHIFT_PX`).
ALIKE_PX = 0.06
# The noise times an eighth (of less a picture hardly changes), and powers of 2 up to as much as
# explains most pixels, 4 at least; what is between two of them makes hardly a difference.
LEAST_FACTOR, LARGEST_FACTOR = 0.125, 4.0
# Another belief has to predict this much better than the noise that was read: half of the frames is
# not all of them.
BETTER = 0.97
# Fewer frames than this in each half predict others by what the prior adds.
LEAST_HALF = 3
# Pixels that are far off, where noise puts 0.3 % of them beyond three sigma; a frame that is wrong
# makes some as well, so that halves have to hold more frames than are likely to be wrong.
FAR, FAR_SHARE, LEAST_HALF_OF_FAR = 3.0, 0.01, 4
# Of large frames the middle is asked, so many LR pixels along a side.
MOST_PX = 96


def refuted(asked: Asked, found: Solution) -> bool:
    """Tell whether frames are off by more than noise and usual shifts: most pixels, or some by far.

    Most pixels of most frames where all are compressed or turn, some by far where edges are
    sharpened.
    """
    used = np.isfinite(asked.sigma)
    some = np.array([one.any() for one in used])
    half = min(np.sum(some[0::2]), np.sum(some[1::2]))
    if half < LEAST_HALF or asked.of_phasors:
        return False
    squares = _squares(asked, found, ALIKE_PX)
    far = float(np.mean(squares[used] > FAR**2))
    return _usual(squares, used) > 1.0 or (half >= LEAST_HALF_OF_FAR and far > FAR_SHARE)


def _squares(asked: Asked, found: Solution, shift_px: float = 0.0) -> Floats:
    """Return [frame row col] squared residuals over the variance of the noise.

    Parameters
    ----------
    shift_px : error of shifts that is noise as well
    """
    A, image = asked.model.operator, single(found.image)
    variance = asked.sigma**2
    if shift_px:
        variance = variance + shift_px**2 * slopes_of(A, image, asked.model.scale)[1]
    return np.asarray((asked.y - A.forward(image)) ** 2 / variance)


def _usual(squares: Floats, used: Mask) -> float:
    """Return the variance over that of the noise, of half of the pixels in half of the frames."""
    seen = zip(squares, used, strict=True)
    return float(np.median([np.median(one[there]) for one, there in seen if there.any()])) / (
        MEDIAN_SIZE**2
    )


def as_predicted(asked: Asked, found: Solution, solve: Callable[[Asked], Solution]) -> Asked:
    """Return what is asked with the noise, and the belief in outliers, that predict best.

    Parameters
    ----------
    found : the picture that refuted the noise as it was read
    """
    used = np.isfinite(asked.sigma)
    largest = max(np.sqrt(_usual(_squares(asked, found), used)), LARGEST_FACTOR)
    factors = LEAST_FACTOR * 2.0 ** np.arange(np.ceil(np.log2(largest / LEAST_FACTOR)) + 1)
    even = np.where(used, np.sqrt(np.mean(asked.sigma[used] ** 2)), np.inf)
    tried = [asked] + [
        replace(asked, sigma=factor * even, alike=alike)
        for factor in factors for alike in (False, True)
    ]  # fmt: skip
    errors = [_error(middle_of(one), solve) for one in tried]
    best = int(np.argmin(errors))
    return tried[best if errors[best] < BETTER * errors[0] else 0]


def middle_of(asked: Asked) -> Asked:
    """Return what is asked of the middle of large frames: it says as much in less time."""
    rows, cols = (
        slice(start := max(0, (n - MOST_PX) // 2), start + min(n, MOST_PX))
        for n in asked.y.shape[1:]
    )
    part = (slice(None), rows, cols)
    model = asked.model.crop(rows, cols)
    sigma = np.where(model.inside, asked.sigma[part], np.inf)
    if not np.isfinite(sigma).any(axis=(1, 2)).all():
        return asked
    return replace(asked, model=model, y=np.ascontiguousarray(asked.y[part]), sigma=sigma)


def _error(asked: Asked, solve: Callable[[Asked], Solution]) -> float:
    """Return the mean error of frames that are predicted from every other one."""
    frame, used, total = np.arange(len(asked.y)), np.isfinite(asked.sigma), 0.0
    for half in (0, 1):
        known = (frame % 2 == half)[:, None, None]
        found = solve(replace(asked, sigma=np.where(known, asked.sigma, np.inf), on_stage=None))
        rest = asked.y - asked.model.operator.forward(single(found.image))
        total += float(np.mean(np.abs(rest[used & ~known])))
    return total
