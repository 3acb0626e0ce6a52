"""What pixels see: means over the cells that they cover, through the lens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensshift.camera.cells import World
from lensshift.camera.channels import Seen, Tones
from lensshift.camera.multipath import IndirectLight
from lensshift.camera.settings import TofCamera
from lensshift.camera.view import SpotBlur, View
from lensshift.core.arrays import Array
from lensshift.scene import Scene

_CELLS_AT_ONCE = 1_000_000  # some 100 MB
_REACH_SIGMAS = 5.0  # of a Gaussian


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """Where the pixels of one image look, in LR pixels of the camera at rest.

    Parameters
    ----------
    per_px : pixels along an LR pixel
    offset_px : [row col 2], or [1 1 2]; the content moved down / right
    side_px : of the square over which a pixel averages
    blur : of the lens: sigma in LR pixels of a Gaussian, or spots
    """

    per_px: int
    offset_px: Array
    side_px: float
    blur: float | SpotBlur

    @property
    def reach_px(self) -> float:
        """How far beyond its own LR pixel a pixel looks, at most."""
        if isinstance(self.blur, SpotBlur):
            blurred_px = float(np.abs(self.blur.landing_px).max())
        else:
            blurred_px = _REACH_SIGMAS * self.blur
        return float(np.abs(self.offset_px).max()) + blurred_px

    def centres(self, first_px: int, last_px: int) -> Array:
        """Return the middles of the pixels between two borders of LR pixels."""
        index = np.arange(first_px * self.per_px, last_px * self.per_px)
        return np.asarray((index + 0.5) / self.per_px - 0.5)


@dataclass(frozen=True, slots=True)
class _Tile:
    """LR pixels from `first` to before `last`, (row, col), and cells with a margin around them."""

    first: tuple[int, int]
    last: tuple[int, int]
    samples: int
    margin: int

    @property
    def cells(self) -> tuple[int, int]:
        rows, cols = (
            (last - first) * self.samples + 2 * self.margin
            for first, last in zip(self.first, self.last, strict=True)
        )
        return rows, cols

    def corners_px(self, axis: int) -> Array:
        """Return where cells begin, on the sensor."""
        index = self.first[axis] * self.samples - self.margin + np.arange(self.cells[axis])
        return np.asarray(index / self.samples - 0.5)


def see(
    scene: Scene, camera: TofCamera, tones: Tones, footprints: Sequence[Footprints], samples: int
) -> list[Seen]:
    """Return what the pixels of each image see.

    Parameters
    ----------
    samples : cells across an LR pixel
    """
    shape = camera.grid.shape
    margin = int(np.ceil(samples * max(one.reach_px for one in footprints))) + 1
    view = View(camera, margin / samples + 0.5)
    indirect = None
    if camera.multipath is not None:
        indirect = IndirectLight(scene, camera.multipath, camera.grid, view, tones)
    world = World(scene, view, tones, indirect, samples)
    images = [
        np.empty((shape[0] * one.per_px, shape[1] * one.per_px, tones.channels))
        for one in footprints
    ]
    buffer = np.empty(0)  # kept: fresh memory costs as much as the work in it
    for tile in _tiles(shape, samples, margin):
        size = tile.cells[0] * tile.cells[1] * tones.channels
        buffer = buffer if buffer.size >= size else np.empty(size)
        cells = buffer[:size].reshape(*tile.cells, tones.channels)
        world.fill(cells, tile.corners_px(0), tile.corners_px(1))
        for one, image in zip(footprints, images, strict=True):
            rows, cols = (
                slice(first * one.per_px, last * one.per_px)
                for first, last in zip(tile.first, tile.last, strict=True)
            )
            image[rows, cols] = _means(cells, one, tile)
    return [Seen(image, tones) for image in images]


def _tiles(shape: tuple[int, int], samples: int, margin: int) -> Iterator[_Tile]:
    """Cut the sensor into tiles of about equal size that fit into memory."""
    side = int(_CELLS_AT_ONCE**0.5)
    rows = _share(shape[0], (side - 2 * margin) // samples)
    wide = _CELLS_AT_ONCE // (rows * samples + 2 * margin)
    cols = _share(shape[1], (wide - 2 * margin) // samples)
    for row in range(0, shape[0], rows):
        for col in range(0, shape[1], cols):
            last = (min(row + rows, shape[0]), min(col + cols, shape[1]))
            yield _Tile((row, col), last, samples, margin)


def _share(count: int, most: int) -> int:
    """Return the size of equal parts of at most `most`, at least 1."""
    parts = -(-count // max(1, most))
    return -(-count // parts)


def _means(cells: Array, one: Footprints, tile: _Tile) -> Array:
    """Return the means [row col channel] over the footprints of the pixels in a tile."""
    if isinstance(one.blur, SpotBlur):
        return _means_through_spots(cells, one, one.blur, tile)
    rows, cols = (_weights(one, one.blur, tile, axis) for axis in (0, 1))
    channels = cells.shape[2]
    down = (rows @ cells.reshape(len(cells), -1)).reshape(-1, cells.shape[1], channels)
    across = np.ascontiguousarray(np.moveaxis(down, 1, 0))
    both = (cols @ across.reshape(len(across), -1)).reshape(-1, *across.shape[1:])
    return np.asarray(np.moveaxis(both, 0, 1))


def _weights(one: Footprints, sigma_px: float, tile: _Tile, axis: int) -> Any:
    """Return the sparse weights [pixel cell] of a blurred aperture along one axis.

        weight = integral over the cell of (box of the pixel * Gaussian) / side

    which is the second difference of the ramp, or of the Gaussian integrated three times.
    """
    from scipy.sparse import csr_array
    from scipy.special import ndtr

    def ramp(place_px: Array) -> Array:
        if sigma_px == 0:
            return np.maximum(place_px, 0.0)
        z = place_px / sigma_px
        return np.asarray(sigma_px * (z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)))

    centre_px = one.centres(tile.first[axis], tile.last[axis]) - one.offset_px[0, 0, axis]
    corner_px = tile.corners_px(axis)
    border_px = np.append(corner_px, corner_px[-1] + 1.0 / tile.samples)
    away_px = border_px - centre_px[:, None]
    inside = ramp(away_px + 0.5 * one.side_px) - ramp(away_px - 0.5 * one.side_px)
    weights = np.diff(inside, axis=1) / one.side_px
    weights[weights < 1e-9] = 0.0
    return csr_array(weights / weights.sum(axis=1, keepdims=True))


def _means_through_spots(cells: Array, one: Footprints, blur: SpotBlur, tile: _Tile) -> Array:
    """Return the means over footprints that each ray of the spots moves elsewhere."""
    from lensshift.camera.footprint_kernel import footprint_means

    row_px, col_px = (one.centres(tile.first[axis], tile.last[axis]) for axis in (0, 1))
    landing_px, weight = blur.at(row_px, col_px)
    offset_px = one.offset_px
    if offset_px.shape[:2] != (1, 1):
        offset_px = offset_px[tile.first[0] : tile.last[0], tile.first[1] : tile.last[1]]
    centre_px = np.stack(np.meshgrid(row_px, col_px, indexing="ij"), axis=-1) - offset_px
    # In cells from the first corner.
    centre = (centre_px + 0.5) * tile.samples - (np.array(tile.first) * tile.samples - tile.margin)
    sums = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1, cells.shape[2]))
    np.cumsum(cells, axis=0, out=sums[1:, 1:])
    np.cumsum(sums, axis=1, out=sums)
    means = np.empty((len(row_px), len(col_px), cells.shape[2]))
    half = 0.5 * one.side_px * tile.samples
    footprint_means(sums, centre, half, landing_px * tile.samples, weight, means)
    return means
