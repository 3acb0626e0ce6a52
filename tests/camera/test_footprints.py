"""What pixels see through spots, against sums over the cells that squares cover."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tof_worlds import EXACT, make_camera

from lensshift.camera import LensOptics, simulate_tof
from lensshift.camera.footprint_kernel import add_images, lattice_means, squares
from lensshift.core.grid import Grid
from lensshift.optics.lens_file import load_lens
from lensshift.scene import four_boxes


def covered(begin: float, side: float, count: int) -> np.ndarray:
    """Return how much of each of `count` cells lies between `begin` and `begin` + `side`."""
    cell = np.arange(count)
    return np.clip(np.minimum(cell + 1, begin + side) - np.maximum(cell, begin), 0.0, 1.0)


@pytest.mark.parametrize("side", [0.7, 1.0, 3.0, 5.657])
def test_images_gather_the_cells_that_their_squares_cover(side: float) -> None:
    rng = np.random.default_rng(5)
    cells = rng.random((11, 17, 3))
    place = rng.integers(-9, 10, (42, 2))
    weight = rng.uniform(0.1, 1.0, 42)
    ends = np.array([0, 7, 12, 20, 24, 33, 42])  # of the points of two by three nodes
    offset = rng.uniform(-0.5, 0.5, (4, 5, 2))
    corner, apart, phases = np.array([-4.3, -5.1]), 4.6, 4
    at_row, at_col = np.linspace(0.0, 1.0, 4), np.linspace(0.0, 2.0, 5)
    step = 1 if side == int(side) else 2
    nodes = [step * (count + int(side) + 2) for count in cells.shape[:2]]
    sums = np.empty((*nodes, 3), dtype=np.float32)
    squares(cells, side, step, sums)
    first = np.array([-12, -12])
    means = np.empty((36, phases, 10, 3), dtype=np.float32)
    lattice_means(sums, side, step, corner + int(side) + 1, apart, offset, first, means)
    before = rng.random((4, 5, 3))
    added = before.copy()
    start = np.stack([ends[:-1], ends[1:]]).reshape(2, 2, 3)
    add_images(means, first, at_row, at_col, start, place, weight, added)
    expected = np.zeros_like(before)
    node = np.repeat(np.arange(6), np.diff(ends))
    for i, j in np.ndindex(4, 5):
        near = np.maximum(1 - abs(at_row[i] - np.arange(2)), 0)[:, None]
        near = near * np.maximum(1 - abs(at_col[j] - np.arange(3)), 0)
        for (row, col), share in zip(place, weight * near.ravel()[node], strict=True):
            at = np.array([i - row / phases, j - col / phases])
            moved = [
                map_coordinates(one, at[:, None], order=1, mode="nearest")[0]
                for one in offset.T.swapaxes(1, 2)
            ]
            begin = corner + apart * at - moved
            rows, cols = (covered(begin[k], side, cells.shape[k]) for k in (0, 1))
            expected[i, j] += share * np.einsum("r,c,rcn->n", rows, cols, cells) / side**2
    np.testing.assert_allclose(added - before, expected, atol=2e-6 * weight.sum())
    assert expected.min() < 0.1 * expected.max()  # some squares lie beyond all cells
    assert expected.max() > 0.5


@pytest.mark.slow
def test_what_a_lens_blurs_far_does_not_depend_on_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lens 0.4 mm out of focus throws light over several tiles."""
    lens = load_lens("al2550")
    lens = lens.with_sensor(lens.gaps_mm[-1] + 0.4)
    camera = make_camera(Grid((9, 13), (0.05, 0.07)), optics=LensOptics(lens))
    told: list[tuple[int, int]] = []
    whole = simulate_tof(
        four_boxes(), camera, seed=4, on_progress=lambda *step: told.append(step), **EXACT
    )
    assert told == [(1, 1)]
    told.clear()
    monkeypatch.setattr("lensshift.camera.footprints._CELLS_AT_ONCE", 9_000)
    tiled = simulate_tof(
        four_boxes(), camera, seed=4, on_progress=lambda *step: told.append(step), **EXACT
    )
    assert told == [(number, len(told)) for number in range(1, len(told) + 1)]
    assert len(told) > 8
    for name in ("amplitude", "sharp_amplitude", "distance_m"):
        got, expected = (getattr(one.truth, name) for one in (tiled, whole))
        np.testing.assert_allclose(got, expected, rtol=3e-7)
    np.testing.assert_allclose(tiled.burst.amplitude, whole.burst.amplitude, rtol=3e-7)
