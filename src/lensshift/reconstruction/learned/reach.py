"""How far a phase may lie from those of the frames around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.units import within_half_a_turn

WINDOW = (1, 5, 5)  # frame row col, LR pixels
# What mixes in the frames lies farther apart than its mixtures: one range more on either side.
MOST_RANGES = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Phases that a picture may have where the frames around show those from lo to hi.

    Parameters
    ----------
    middle_rad, most_rad : [row col] (lo + hi) / 2 and 3/2 (hi - lo), the farthest from there, of
        5 x 5 LR pixels of each frame
    """

    middle_rad: Floats
    most_rad: Floats

    @classmethod
    def of(cls, y: Array, used: Mask, offset_px: Array, scale: int) -> Reach:
        """Return what the frames y [frame row col] allow, of those pixels that count.

        Parameters
        ----------
        offset_px : [frame 2]
        scale : HR pixels per LR pixel
        """
        around = [
            [one[np.ix_(*nearest(y.shape[1:], moved_px, scale))] for one in ranges]
            for *ranges, moved_px in zip(*_range_around(np.angle(y), used), offset_px, strict=True)
        ]
        first = around[0][0]
        low, high = np.full(first.shape, np.inf), np.full(first.shape, -np.inf)
        for middle, half in around:
            apart = within_half_a_turn(middle - first)
            low, high = np.minimum(low, apart - half), np.maximum(high, apart + half)
        told = high >= low
        low, high = np.where(told, low, 0.0), np.where(told, high, 2 * np.pi)
        return cls(first + (low + high) / 2, MOST_RANGES * (high - low))

    def hold(self, phase_rad: Array, std_rad: Array) -> tuple[Floats, Floats]:
        """Return phases no farther than the frames around allow, and their std.

        A phasor that is nearly nothing, as that of a dark pixel beside a bright surface may be
        drawn, has any phase. Where surfaces mix the mean has a phase between theirs; what is moved
        to the border of that was off at least by as much, which goes to its std.
        """
        off = within_half_a_turn(phase_rad - self.middle_rad)
        beyond = np.sign(off) * np.maximum(np.abs(off) - self.most_rad, 0.0)
        return phase_rad - beyond, np.hypot(std_rad, beyond)


def nearest(
    shape: tuple[int, ...], moved_px: Array, scale: int, beside: tuple[int, int] = (0, 0)
) -> list[Array]:
    """Return the rows and columns of a frame that are nearest to those of the HR grid, or next."""
    starts = [(np.arange(scale * n) + 0.5) / scale - 0.5 for n in shape]
    at = zip(starts, moved_px, beside, shape, strict=True)
    return [np.clip(np.rint(u + by).astype(int) + step, 0, n - 1) for u, by, step, n in at]


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
