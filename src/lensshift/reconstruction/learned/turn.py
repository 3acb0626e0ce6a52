"""One way to look at a picture, so that mirrored bursts give mirrored pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lensshift.core.arrays import Array, Floats

Picture = Array


@dataclass(frozen=True, slots=True)
class Turn:
    """Which ends are exchanged, and whether rows and columns are, before a network looks.

    A network treats left and right only about alike. Of the eight mirrored and transposed pictures
    of a burst it is always shown the one in which the first frame that is shifted at all is
    shifted up, likewise to the left, and rows before columns; what it says is turned back. This
    goes by the shifts alone, so what one region holds still cannot touch another.
    """

    rows: bool
    cols: bool
    transposed: bool

    def there(self, xp: Any, picture: Picture) -> Picture:
        """Return the picture [... row col] as the network sees it."""
        turned = self._mirrored(xp, picture)
        return turned.mT if self.transposed else turned

    def back(self, xp: Any, picture: Picture) -> Picture:
        """Undo `there`."""
        return self._mirrored(xp, picture.mT if self.transposed else picture)

    def _mirrored(self, xp: Any, picture: Picture) -> Picture:
        ends = tuple(axis for axis, turned in ((-2, self.rows), (-1, self.cols)) if turned)
        mirrored: Picture = xp.flip(picture, ends) if ends else picture
        return mirrored


def turn_of(offset_px: Floats) -> Turn:
    """Return how to look at frames with these shifts [frame 2]."""
    offset_px = np.round(offset_px, 6)  # far below what a shift can be known to
    signs = []
    for axis in (0, 1):
        shifted = np.flatnonzero(offset_px[:, axis])
        signs.append(1.0 if shifted.size == 0 else -np.sign(offset_px[shifted[0], axis]))
    rows, cols = (offset_px * signs).T
    return Turn(signs[0] < 0, signs[1] < 0, tuple(rows) > tuple(cols))
