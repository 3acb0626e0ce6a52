"""Errors of the slanted-edge methods on stored edges with known MTF.

python benchmarks/edges.py ../shared/reference/slanted_edge/open/edges_64x16.npz --every 5

Results of MTF Mapper, stored beside the edges (edges_64x16_ref.npz), are printed too.
"""

import argparse
import json
import time
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np

from lensshift.evaluation.slanted_edge import METHODS, measure_edge

_HEADING = (
    "method             noise  angle  edges  failed  MTF50 rms  curve rms  covered  median time"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", help="images, truth_mtf, truth_mtf50 and meta in an NPZ file")
    parser.add_argument("--every", type=int, default=1, help="take every n-th image")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["ml"])
    arguments = parser.parse_args()
    stored, peers = np.load(arguments.file), stored_results(arguments.file)
    warnings.simplefilter("ignore")
    print(
        "method             noise  angle  edges  failed  MTF50 rms  curve rms  covered  median time"
    )
    for method in (*arguments.methods, *peers):
        cells: dict[tuple[float, float], list[tuple[float, ...]]] = defaultdict(list)
        for k in range(0, len(stored["images"]), arguments.every):
            meta = json.loads(str(stored["meta"][k]))
            row = peers[method][k] if method in peers else measured(stored, k, method)
            cells[meta["noise"], meta["theta"]].append(row)
            cells[meta["noise"], np.inf].append(row)
        for (noise, angle), rows in sorted(cells.items()):
            values = np.array(rows)
            whole = np.isfinite(values[:, 0])
            error, curve = values[whole, 0], values[whole, 1]
            name = "all" if np.isinf(angle) else f"{angle:.0f}"
            covered, spent_ms = 100 * np.mean(values[whole, 2]), 1e3 * np.median(values[:, 3])
            ending = "" if method in peers else f"  {covered:5.1f} %  {spent_ms:8.0f} ms"
            print(
                f"{method:18s} {noise:5.2f}  {name:>5s}"
                f"  {len(rows):5d}  {int(np.sum(~whole)):6d}"
                f"  {100 * np.sqrt(np.mean(error**2)):7.3f} %"
                f"  {np.sqrt(np.mean(curve)):9.4f}{ending}"
            )


def stored_results(file: str) -> dict[str, list[tuple[float, ...]]]:
    """Return the rows of the programs whose results are stored."""
    path = Path(file)
    beside = path.with_name(f"{path.stem}_ref.npz")
    if not beside.exists():
        return {}
    edges, reference = np.load(path), np.load(beside)
    rows = {}
    for name in ("MTFMapper_loess", "MTFMapper_kernel"):
        half = np.where(reference[f"{name}_failed"], np.nan, reference[f"{name}_mtf50"])
        error = half / edges["truth_mtf50"] - 1
        apart = reference[f"{name}_mtf"][:, :51] - edges["truth_mtf"][:, :51]
        curve = np.mean(np.square(apart, dtype=np.float64), axis=1)
        rows[name] = [(e, c, np.nan, np.nan) for e, c in zip(error, curve, strict=True)]
    return rows


def measured(stored: np.lib.npyio.NpzFile, k: int, method: str) -> tuple[float, ...]:
    """Return relative error of MTF50, mean square error of the curve, covered or not, seconds."""
    image, truth = stored["images"][k], float(stored["truth_mtf50"][k])
    below = np.arange(51) * 0.01
    start = time.perf_counter()
    try:
        found = measure_edge(
            image,
            region=(0, image.shape[0], 0, image.shape[1]),
            method=method,
            frequency_lpmm=below,
        )
    except ValueError:
        return np.nan, np.nan, np.nan, time.perf_counter() - start
    spent = time.perf_counter() - start
    half = found.mtf50_lpmm
    curve = float(np.mean((found.mtf.modulation - stored["truth_mtf"][k][:51]) ** 2))
    return half.value / truth - 1, curve, float(half.low <= truth <= half.high), spent


if __name__ == "__main__":
    main()
