"""The scene on fine cells, cast once for all frames.

Cells are even and do not move: every frame sees the same scene, moved by exactly its offset. A
ray goes through the middle of each cell; where neighbours differ, 16 rays take the mean of a
cell, so that an edge lies right to about 1/500 of a pixel with 16 cells across it.
"""

from __future__ import annotations

import numpy as np

from lensshift.camera.channels import Tones
from lensshift.camera.flat import GOLDEN
from lensshift.camera.multipath import IndirectLight
from lensshift.camera.view import View
from lensshift.core.arrays import Array, Mask
from lensshift.scene import Hits, Scene, cast

_CELLS_AT_ONCE = 1024  # of those that are cast again
_UNEVEN = 0.1  # of the light: what a weaker edge gets wrong is lost in noise
# Places (row, col) of rays in a cell, all in different rows and columns.
_RANKS = np.argsort(np.argsort(np.mod(np.arange(16) * GOLDEN, 1.0)))
_WITHIN = (np.stack([np.arange(16), _RANKS], axis=-1) + 0.5) / 16


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
        half = 0.5 / self._samples
        for first in range(0, len(row_px), self._samples):
            some = slice(first, first + self._samples)
            down, right = self._view.lattice(row_px[some] + half, col_px + half)
            hits = self._cast(down, right)
            cells[some] = self._tones.channels_of(hits, self._arriving(hits))
            cells[some] *= self._view.light(down, right)[..., None]
        places = np.argwhere(_uneven(cells[..., self._tones.telling]))
        for first in range(0, len(places), _CELLS_AT_ONCE):
            i, j = places[first : first + _CELLS_AT_ONCE].T
            cells[i, j] = self._means(row_px[i], col_px[j])

    def _means(self, row_px: Array, col_px: Array) -> Array:
        """Return the channels [cell channel] as means over many rays in each cell."""
        place_px = np.stack([row_px, col_px], axis=-1)[:, None] + _WITHIN / self._samples
        down, right = self._view.at(place_px[..., 0], place_px[..., 1])
        hits = self._cast(down, right)
        arriving = None
        if self._indirect is not None:
            arriving = self._indirect.at(hits.point_m[:, 0], hits.normal[:, 0])[:, None]
        values = self._tones.channels_of(hits, arriving) * self._view.light(down, right)[..., None]
        return np.asarray(values.mean(axis=1))

    def _cast(self, down: Array, right: Array) -> Hits:
        return cast(self._scene, np.stack([right, down, np.ones_like(down)], axis=-1))

    def _arriving(self, hits: Hits) -> Array | None:
        """Return indirect light on rows of cells, found once per LR pixel: it changes slowly."""
        if self._indirect is None:
            return None
        rows, cols = hits.hit.shape
        pixel = np.arange(cols) // self._samples
        middle = np.minimum((np.arange(pixel[-1] + 1) + 0.5) * self._samples, cols - 1).astype(int)
        places = (rows // 2, middle)
        return self._indirect.at(hits.point_m[places], hits.normal[places])[None, pixel]


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
