"""How far a phase may lie from those of the frames around."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.units import within_half_a_turn

WINDOW = (1, 5, 5)  # frame row col, LR pixels
# What mixes in the frames lies farther apart than its mixtures: one range more on either side.
MOST_RANGES = 1.5


def within_reach(
    phase_rad: Array, std_rad: Array, y: Array, used: Mask, offset_px: Array, scale: int
) -> tuple[Floats, Floats]:
    """Return phases [row col] no farther than the frames around allow, and their std.

        |phi - (lo + hi) / 2| <= 3/2 (hi - lo),   lo and hi over 5 x 5 LR pixels of each frame

    A phasor that is nearly nothing, as that of a dark pixel beside a bright surface may be drawn,
    has any phase. Where surfaces mix the mean has a phase between theirs; what is moved to the
    border of that was off at least by as much, which goes to its std.

    Parameters
    ----------
    phase_rad, std_rad : [row col] of a picture
    y : [frame row col] phasors
    used : [frame row col] pixels that count
    offset_px : [frame 2]
    scale : HR pixels per LR pixel
    """
    low, high, first = np.full(phase_rad.shape, np.inf), np.full(phase_rad.shape, -np.inf), None
    for *ranges, moved_px in zip(*_range_around(np.angle(y), used), offset_px, strict=True):
        nearest = [
            np.rint((np.arange(scale * n) + 0.5) / scale - 0.5 + move).astype(int).clip(0, n - 1)
            for n, move in zip(y.shape[1:], moved_px, strict=True)
        ]
        middle, half = (one[np.ix_(*nearest)] for one in ranges)
        first = middle if first is None else first
        apart = within_half_a_turn(middle - first)
        low, high = np.minimum(low, apart - half), np.maximum(high, apart + half)
    told = high >= low
    low, high = np.where(told, low, 0.0), np.where(told, high, 2 * np.pi)
    off = within_half_a_turn(phase_rad - first - (low + high) / 2)
    beyond = np.sign(off) * np.maximum(np.abs(off) - MOST_RANGES * (high - low), 0.0)
    return phase_rad - beyond, np.hypot(std_rad, beyond)


def _range_around(phase_rad: Array, seen: Mask) -> tuple[Array, Array]:
    """Return middle and half width [frame row col] of the phases around each pixel of its frame.

    Of none -inf. Of the two ways to count, from -pi or from 0, that which does not part them.
    """
    ways = []
    for counted in (phase_rad, np.mod(phase_rad, 2 * np.pi)):
        least = minimum_filter(np.where(seen, counted, np.inf), WINDOW)
        most = maximum_filter(np.where(seen, counted, -np.inf), WINDOW)
        some = most >= least
        least, most = np.where(some, least, 0.0), np.where(some, most, 0.0)
        ways.append(((least + most) / 2, np.where(some, (most - least) / 2, -np.inf)))
    (middle, half), (other_middle, other_half) = ways
    other = other_half < half
    return np.where(other, other_middle, middle), np.where(other, other_half, half)
