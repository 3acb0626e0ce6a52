"""Slanted edges under many optics, whose MTF is exact: errors, coverage, beside sfrmat5.

    python benchmarks/edge_families.py --images 20 --noise 0.2 1 5

The kinds called unseen took no part in making the method.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from lensshift.evaluation.slanted_edge import measure_edge

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "evaluation"))

from line_spreads import SEEN, UNSEEN, Edge, Transfer

LOW_CPP = np.array([0.1, 0.3])


def cell(transfer: Transfer, noise: float, images: int, shape: tuple[int, int]) -> str:
    """Return a line: rms errors of MTF50 of both methods, coverage at MTF50, 0.1 and 0.3 c/px."""
    wrong: dict[str, list[float]] = {"ml": [], "sfrmat5": []}
    covered, spent = [], dict.fromkeys(wrong, 0.0)
    for seed in range(images):
        rng = np.random.default_rng(seed)
        edge = Edge(transfer, rng.uniform(3.0, 15.0))
        image = edge.image(shape, rng.uniform(-0.5, 0.5)) + noise * rng.standard_normal(shape)
        true_cpp, curve = edge.mtf50_cpp(), np.abs(edge.transfer(LOW_CPP))
        for method, errors in wrong.items():
            start = time.process_time()
            found = measure_edge(1000.0 + 2e4 * image, 1.0, method=method)
            spent[method] += time.process_time() - start
            errors.append(found.mtf50_lpmm.value / true_cpp - 1.0)
            if method == "ml":
                half, at = found.mtf50_lpmm, found.mtf.frequency_lpmm
                low, high = (np.interp(LOW_CPP, at, band) for band in (found.low, found.high))
                covered.append(
                    [half.low <= true_cpp <= half.high, *((low <= curve) & (curve <= high))]
                )
    rms = {method: 100 * np.sqrt(np.mean(np.square(e))) for method, e in wrong.items()}
    at_half, at_tenth, at_three = np.mean(covered, axis=0)
    return (
        f"{rms['ml']:6.2f} % {100 * np.mean(wrong['ml']):+6.2f} %   {at_half:.2f}  {at_tenth:.2f}  "
        f"{at_three:.2f}   {rms['sfrmat5']:6.2f} %   {spent['ml'] / spent['sfrmat5']:6.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=20, help="of each kind and noise")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.2, 1.0, 5.0], help="percent")
    parser.add_argument("--shape", type=int, nargs=2, default=[64, 64])
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        "optics                noise  ml rms    bias      MTF50 0.1   0.3    sfrmat5    time ratio"
    )
    for title, kinds in (("seen", SEEN), ("unseen", UNSEEN)):
        for name, transfer in kinds.items():
            for noise in arguments.noise:
                line = cell(transfer, noise / 100, arguments.images, tuple(arguments.shape))
                print(f"{name:20} {noise:4.1f} % {line}   {title}", flush=True)


if __name__ == "__main__":
    main()
