"""The scene on fine cells, cast once for all frames.

Cells are even and do not move: every frame sees the same scene, moved by exactly its offset. A
ray goes through the middle of each cell; where neighbours differ, 16 rays take the mean of a
cell, so that an edge lies right to about 1/500 of a pixel with 16 cells across it. One cell in 61
is probed with as many, and cells beside one whose rays show an edge get them: a wire which the
middles of all cells miss is found, and followed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lensshift.camera.channels import Tones
from lensshift.camera.flat import GOLDEN
from lensshift.camera.multipath import IndirectLight
from lensshift.camera.view import View
from lensshift.core.arrays import Array, Mask
from lensshift.scene import Scene, cast

_CELLS_AT_ONCE = 1024  # of those that are cast again
# Cells (row, col) along rows and columns from one that is probed to the next: not four LR pixels.
_PROBED, _ASIDE = 61, 23
_UNEVEN = 0.1  # of the light: what a weaker edge gets wrong is lost in noise
# Places (row, col) of rays in a cell, all in different rows and columns.
_RANKS = np.argsort(np.argsort(np.mod(np.arange(16) * GOLDEN, 1.0)))
_WITHIN = (np.stack([np.arange(16), _RANKS], axis=-1) + 0.5) / 16
_SLOPES = np.column_stack([np.ones(16), _WITHIN])
_BEND = np.eye(16) - _SLOPES @ np.linalg.pinv(_SLOPES)  # what slopes do not explain


class World:
    """A scene as cells see it.

    Parameters
    ----------
    view : from places on the sensor at rest to directions
    indirect : light from other surfaces, or None
    samples : cells across an LR pixel
    """

    def __init__(
        self, scene: Scene, view: View, tones: Tones, indirect: IndirectLight | None, samples: int
    ) -> None:
        self._scene, self._view, self._tones = scene, view, tones
        self._indirect, self._samples = indirect, samples

    def fill(self, cells: Array, row_px: Array, col_px: Array) -> None:
        """Write the channels of cells whose upper left corners lie at [row], [col].

        Parameters
        ----------
        cells : [row col channel], changed in place
        row_px, col_px : evenly spaced
        """
        from scipy.ndimage import binary_dilation

        half, within_px = 0.5 / self._samples, _WITHIN.T[:, None] / self._samples
        pixel = np.arange(len(col_px)) // self._samples  # indirect light changes slowly
        middle = np.minimum((np.arange(pixel[-1] + 1) + 0.5) * self._samples, len(col_px) - 1)
        for first in range(0, len(row_px), self._samples):
            some = slice(first, first + self._samples)
            look = self._view.lattice(row_px[some] + half, col_px + half)
            seen_at = (len(look[0]) // 2, middle.astype(int))
            cells[some] = self._channels(*look, seen_at, (None, pixel))
        uneven = _uneven(cells[..., self._tones.telling])
        wanted = uneven | self._probed(row_px, col_px)
        probe, done = wanted & ~uneven, np.zeros_like(wanted)
        while wanted.any():
            split = np.zeros_like(wanted)
            places = np.argwhere(wanted)
            for first in range(0, len(places), _CELLS_AT_ONCE):
                i, j = places[first : first + _CELLS_AT_ONCE].T
                at_px = np.stack([row_px[i], col_px[j]])[..., None] + within_px
                rays = self._channels(*self._view.at(*at_px), (slice(None), 0), np.s_[:, None])
                telling = rays[..., self._tones.telling]
                size = np.abs(telling).max(axis=(1, 2))
                bend = np.abs(np.einsum("mn,cnt->cmt", _BEND, telling)).max(axis=(1, 2))
                split[i, j] = bend > _UNEVEN * size
                known = split[i, j] | ~probe[i, j]  # a probe that finds nothing changes nothing
                cells[i[known], j[known]] = rays[known].mean(axis=1)
            done |= wanted
            probe[:] = False
            wanted = binary_dilation(split, np.ones((3, 3), np.bool_)) & ~done

    def _probed(self, row_px: Array, col_px: Array) -> Mask:
        """Tell which cells [row col] are probed, the same ones in all tiles."""
        row, col = (np.rint((one + 0.5) * self._samples) for one in (row_px, col_px))
        return np.asarray(np.mod(_ASIDE * row[:, None] + col, _PROBED) == 0)

    def _channels(self, down: Array, right: Array, seen_at: Any, back: Any) -> Array:
        """Return the channels [... channel] in directions [...].

        Parameters
        ----------
        seen_at, back : indices of the directions where indirect light is found, and of what is
            found there, which broadcasts
        """
        hits = cast(self._scene, np.stack([right, down, np.ones_like(down)], axis=-1))
        indirect = None
        if self._indirect is not None:
            indirect = self._indirect.at(hits.point_m[seen_at], hits.normal[seen_at])[back]
        return self._tones.channels_of(hits, indirect) * self._view.light(down, right)[..., None]


def _uneven(values: Array) -> Mask:
    """Tell which cells [row col] may hold an edge: any of their values [row col n] bends sharply.

    A step shows in the second difference on both of its sides, a smooth wave hardly.
    """
    from scipy.ndimage import maximum_filter1d

    size = np.abs(values).max(axis=-1)
    uneven = np.zeros(size.shape, dtype=np.bool_)
    for axis in (0, 1):
        inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
        bend = np.abs(np.diff(values, 2, axis=axis)).max(axis=-1)
        uneven[inner] |= bend > _UNEVEN * maximum_filter1d(size, 3, axis=axis)[inner]
    return uneven
