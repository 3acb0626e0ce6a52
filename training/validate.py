"""Print PSNR and coverage of the packaged solver on worlds of another generator.

python training/validate.py --bursts 20
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.solver import STD_SCALE, solve

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "reconstruction"))
from mosaic import mosaic_burst

BORDER = 4
FIRST_SEED, CALIBRATION_SEED = 5000, 9000  # the tests use others


def errors_of(seeds: range, scale: int, snr: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield error and std [row col] of bursts, the border left out."""
    for seed in seeds:
        burst = mosaic_burst(seed, scale=scale, snr=snr)
        model = forward_model(
            burst.y.shape[1:], scale, burst.offset_px, blur=GaussianBlur(12**-0.5)
        )
        noise = np.full(burst.y.shape, burst.sigma)
        found = solve(model, burst.y, noise, blur_px=12**-0.5)
        inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
        yield (found.image - burst.truth)[inner], found.std[inner]


def judged(scale: int, snr: float, bursts: int) -> tuple[float, float, float, float]:
    """Return mean PSNR, the shares of the truth within 1 and 2 std, and the least of the latter."""
    rows = []
    for error, std in errors_of(range(FIRST_SEED, FIRST_SEED + bursts), scale, snr):
        size = np.abs(error) / std
        rows.append((-10 * np.log10(np.mean(error**2)), np.mean(size < 1), np.mean(size < 2)))
    psnr, one, two = np.array(rows).T
    return float(psnr.mean()), float(one.mean()), float(two.mean()), float(two.min())


def calibration(bursts: int) -> float:
    """Return what STD_SCALE should be: two std hold what two of a Gaussian do, on other seeds."""
    seeds = range(CALIBRATION_SEED, CALIBRATION_SEED + bursts)
    factors = []
    for scale in (2, 3, 4):
        for snr in (5, 15, 50, 200, 1000):
            sizes = [(np.abs(e) / s).ravel() for e, s in errors_of(seeds, scale, snr)]
            factors.append(np.quantile(np.concatenate(sizes), 0.9545) / 2)
    return STD_SCALE * float(np.mean(factors))


def main() -> None:
    """Print a line for each scale and noise level."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--bursts", type=int, default=20)
    ask.add_argument("--calibrate", action="store_true", help="print STD_SCALE anew, nothing else")
    given = ask.parse_args()
    if given.calibrate:
        sys.stdout.write(f"STD_SCALE = {calibration(given.bursts):.2f}\n")
        return
    sys.stdout.write("scale  SNR   PSNR dB  within 1 std  2 std  least of a burst\n")
    for scale in (2, 3, 4):
        for snr in (5, 15, 50, 200, 1000):
            psnr, one, two, least = judged(scale, snr, given.bursts)
            sys.stdout.write(
                f"{scale:5d} {snr:4d} {psnr:9.2f} {one:13.3f} {two:6.3f} {least:17.3f}\n"
            )


if __name__ == "__main__":
    main()
