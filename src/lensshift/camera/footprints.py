"""What pixels see: means over the cells that they cover, through the lens."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lensshift.camera.cells import World
from lensshift.camera.channels import Seen, Tones
from lensshift.camera.multipath import IndirectLight
from lensshift.camera.settings import TofCamera
from lensshift.camera.view import SpotBlur, View
from lensshift.core.arrays import Array
from lensshift.core.threads import core_count, in_order
from lensshift.scene import Scene

_CELLS_AT_ONCE = 250_000  # some 100 MB with what is made of them, on each core
_MOST_CORES = 4  # for the memory
_REACH_SIGMAS = 6.0  # of a Gaussian, which has 2e-9 beyond
_LEAST_WEIGHT = 1e-9  # of a cell in a pixel


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """Where the pixels of one image look, in LR pixels of the camera at rest."""

    per_px: int  # pixels along an LR pixel
    offset_px: Array  # [row col 2], or [1 1 2]; the content moved down / right
    side_px: float  # of the square over which a pixel averages
    blur: float | SpotBlur  # of the lens: sigma in LR pixels of a Gaussian, or spots

    @property
    def reach_px(self) -> float:
        """How far beyond its own LR pixel a pixel looks, at most."""
        blur = self.blur
        blurred_px = blur.reach_px if isinstance(blur, SpotBlur) else _REACH_SIGMAS * blur
        return float(np.abs(self.offset_px).max()) + blurred_px

    def centres_px(self, some: slice) -> Array:
        """Return the middles of some pixels."""
        return np.asarray((np.arange(some.start, some.stop) + 0.5) / self.per_px - 0.5)


@dataclass(frozen=True, slots=True)
class _Tile:
    """Cells from `first` to before `last`, (row, col), counted from the corner of the sensor."""

    first: tuple[int, int]
    last: tuple[int, int]
    samples: int  # cells across an LR pixel

    def borders_px(self, axis: int) -> Array:
        """Return the places on the sensor where cells begin, and where the last one ends."""
        return np.asarray(np.arange(self.first[axis], self.last[axis] + 1) / self.samples - 0.5)

    def pixels(self, one: Footprints, axis: int, count: int) -> slice:
        """Return the pixels, of `count` LR pixels along an axis, that may see one of the cells."""
        first, *_, last = self.borders_px(axis)
        begin = int(np.floor((first - one.reach_px) * one.per_px)) - 1
        end = int(np.ceil((last + one.reach_px + 1.0) * one.per_px)) + 1
        return slice(max(begin, 0), max(min(end, count * one.per_px), 0))


def see(
    scene: Scene,
    camera: TofCamera,
    tones: Tones,
    footprints: Sequence[Footprints],
    samples: int,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Seen]:
    """Return what the pixels of each image see: each cell is cast once, and adds to many pixels.

    Parameters
    ----------
    samples : cells across an LR pixel
    on_progress : is told how many tiles of how many are done
    """
    shape = camera.grid.shape
    margin = int(np.ceil(samples * max(one.reach_px for one in footprints))) + 1
    view = View(camera, (margin + 1) / samples + 0.5)
    indirect = None
    if camera.multipath is not None:
        indirect = IndirectLight(scene, camera.multipath, camera.grid, view, tones)
    world = World(scene, view, tones, indirect, samples)
    images = [
        np.zeros((shape[0] * one.per_px, shape[1] * one.per_px, tones.channels))
        for one in footprints
    ]
    sides = {one.side_px * samples for one in footprints if isinstance(one.blur, SpotBlur)}
    tiles = list(_tiles(shape, samples, margin))
    # In order: in another sums would round differently, and with them what a seed leads to.
    cores = min(core_count(), _MOST_CORES)
    cast = in_order(partial(_cast, world, tones.channels, sides), tiles, cores)
    for number, (tile, (cells, sums)) in enumerate(zip(tiles, cast, strict=True), start=1):
        for one, image in zip(footprints, images, strict=True):
            where = (tile.pixels(one, 0, shape[0]), tile.pixels(one, 1, shape[1]))
            if not image[where].size:  # a tile of the margin that other images need
                continue
            if isinstance(one.blur, SpotBlur):
                squares = sums[one.side_px * samples]
                _add_through_spots(squares, one, one.blur, tile, where, image[where])
            else:
                image[where] += _means(cells, one, one.blur, tile, where)
        if on_progress is not None:
            on_progress(number, len(tiles))
    return [Seen(image, tones) for image in images]


def _tiles(shape: tuple[int, int], samples: int, margin: int) -> Iterator[_Tile]:
    """Cut the sensor and a margin of cells into tiles of about equal size, with a cell around."""
    count = [size * samples + 2 * margin for size in shape]
    rows = _share(count[0], int(_CELLS_AT_ONCE**0.5))
    cols = _share(count[1], max(1, _CELLS_AT_ONCE // rows))
    for row in range(0, count[0], rows):
        for col in range(0, count[1], cols):
            last = (min(row + rows, count[0]), min(col + cols, count[1]))
            first = (row - margin - 1, col - margin - 1)
            yield _Tile(first, (last[0] - margin + 1, last[1] - margin + 1), samples)


def _share(count: int, most: int) -> int:
    """Return the size of equal parts of at most `most`, at least 1."""
    return -(-count // -(-count // most))


def _cast(
    world: World, channels: int, sides: set[float], tile: _Tile
) -> tuple[Array, dict[float, Array]]:
    """Return the cells [row col channel] of a tile, and their sums over squares of each side."""
    borders_px = [tile.borders_px(axis) for axis in (0, 1)]
    cells = np.empty((len(borders_px[0]) - 1, len(borders_px[1]) - 1, channels))
    world.fill(cells, borders_px[0][:-1], borders_px[1][:-1])
    cells[[0, -1]] = cells[:, [0, -1]] = 0.0  # of the neighbours, to find edges between tiles
    return cells, {side: _sums_over_squares(cells, side) for side in sides}


def _means(
    cells: Array, one: Footprints, sigma_px: float, tile: _Tile, where: tuple[slice, slice]
) -> Array:
    """Return what cells give to the means [row col channel] over some blurred pixels."""
    rows, cols = (_weights(one, sigma_px, tile, axis, where[axis]) for axis in (0, 1))
    channels = cells.shape[2]
    down = (rows @ cells.reshape(len(cells), -1)).reshape(-1, cells.shape[1], channels)
    across = np.ascontiguousarray(np.moveaxis(down, 1, 0))
    both = (cols @ across.reshape(len(across), -1)).reshape(-1, *across.shape[1:])
    return np.asarray(np.moveaxis(both, 0, 1))


def _weights(one: Footprints, sigma_px: float, tile: _Tile, axis: int, where: slice) -> Any:
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

    centre_px = one.centres_px(where) - one.offset_px[0, 0, axis]
    away_px = tile.borders_px(axis) - centre_px[:, None]
    inside = ramp(away_px + 0.5 * one.side_px) - ramp(away_px - 0.5 * one.side_px)
    weights = np.diff(inside, axis=1) / one.side_px
    weights[weights < _LEAST_WEIGHT] = 0.0
    return csr_array(weights)


def _sums_over_squares(cells: Array, side: float) -> Array:
    """Return the sums of `squares`, in single precision: they are read at every ray."""
    from lensshift.camera.footprint_kernel import squares

    step = _nodes_to_a_cell(side)
    nodes = [step * (count + int(side) + 2) for count in cells.shape[:2]]
    sums = np.empty((*nodes, cells.shape[2]), dtype=np.float32)
    squares(cells, side, step, sums)
    return sums


def _nodes_to_a_cell(side: float) -> int:
    return 1 if side == int(side) else 2


def _add_through_spots(
    sums: Array,
    one: Footprints,
    blur: SpotBlur,
    tile: _Tile,
    where: tuple[slice, slice],
    image: Array,
) -> None:
    """Add means over footprints that the image of a point spreads."""
    from lensshift.camera.footprint_kernel import add_images, lattice_means

    side, points = one.side_px * tile.samples, blur.per_px // one.per_px
    centre_px = [one.centres_px(part) for part in where]
    begin = np.array([  # in cells from the first node
        (centre_px[axis][0] - 0.5 * one.side_px + 0.5) * tile.samples
        - tile.first[axis]
        + int(side)
        + 1
        for axis in (0, 1)
    ])  # fmt: skip
    offset_px = one.offset_px
    if offset_px.shape[:2] != (1, 1):
        offset_px = offset_px[where]
    offset = np.ascontiguousarray(offset_px * tile.samples)
    # Points whose squares may hold cells; their first column is that of a pixel.
    apart = tile.samples / one.per_px
    farthest = np.abs(offset).max() + 1.0
    nodes = np.subtract(tile.last, tile.first) + int(side) + 2
    low = np.floor((-farthest - begin) / apart).astype(int)
    high = np.ceil((nodes + farthest - begin) / apart).astype(int)
    first = points * low
    shape = (points * (high[0] - low[0]) + 1, points, high[1] - low[1] + 1, sums.shape[2])
    means = np.empty(shape, dtype=np.float32)
    lattice_means(sums, side, _nodes_to_a_cell(side), begin, apart, offset, first, means)
    add_images(means, first, *blur.nodes_at(*centre_px), blur.start, blur.place, blur.weight, image)
