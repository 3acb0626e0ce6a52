"""How long a chart of 100 edges and finding edges in 4 Mpx take, and times sfrmat5.

    python benchmarks/edge_speed.py

CPU time of this process on one core; asked: 100 edges under 10 s, 4 Mpx under 2 s.
"""

import argparse
import time
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensshift.evaluation.slanted_edge import Region, find_regions, measure_edge

Image = NDArray[np.float64]


def board(tiles: tuple[int, int], tile_px: int, noise: float, seed: int) -> Image:
    """Return dark slanted squares on white, averaged over 4 x 4 points a pixel."""
    rng = np.random.default_rng(seed)
    fine = 4
    place = (np.arange(tile_px * fine) + 0.5) / fine - 0.5 * tile_px
    image = np.empty((tiles[0] * tile_px, tiles[1] * tile_px))
    for i, j in np.ndindex(*tiles):
        turn = np.deg2rad(rng.choice([-1, 1]) * rng.uniform(4.0, 9.0))
        along = place * np.cos(turn) + place[:, None] * np.sin(turn)
        across = place[:, None] * np.cos(turn) - place * np.sin(turn)
        dark = np.maximum(np.abs(along), np.abs(across)) < 0.29 * tile_px
        tile = np.where(dark, 0.2, 0.8).reshape(tile_px, fine, tile_px, fine).mean(axis=(1, 3))
        rows, cols = (slice(k * tile_px, (k + 1) * tile_px) for k in (i, j))
        image[rows, cols] = tile
    image = gaussian_filter(image, 0.6)
    return image + noise * rng.standard_normal(image.shape)


def spent_s(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def measured(image: Image, places: list[Region], method: str) -> None:
    for place in places:
        measure_edge(image, region=place, method=method)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    chart = board((5, 5), 140, 0.005, 1)
    places = find_regions(chart)
    large = board((14, 14), 146, 0.005, 2)
    measured(chart, places[:2], "ml")  # compiles
    rows = []
    for _ in range(arguments.repeats):
        published_s = spent_s(lambda: measured(chart, places, "sfrmat5"))
        edges_s = spent_s(lambda: measured(chart, places, "ml"))
        finding_s = spent_s(lambda: find_regions(large))
        rows.append((edges_s, edges_s / published_s, finding_s, finding_s / published_s))
    edges_s, ratio, finding_s, finding_ratio = np.median(rows, axis=0)
    sides = [place.row_stop - place.row_start for place in places]
    print(
        f"chart of {len(places)} edges of {min(sides)} to {max(sides)} lines: {edges_s:.1f} s, "
        f"{ratio:.0f} times sfrmat5 on the same edges"
    )
    print(
        f"edges of {large.size / 1e6:.1f} Mpx ({len(find_regions(large))} found of 784): "
        f"{finding_s:.2f} s, {finding_ratio:.1f} times sfrmat5 on the chart's {len(places)}"
    )


if __name__ == "__main__":
    main()
