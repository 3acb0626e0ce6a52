"""Peak memory of a reconstruction of 640 x 480 x 4 frames x2, each method in a process of its own.

python benchmarks/memory.py
"""

import argparse
import resource
import subprocess
import sys

import numpy as np

SHAPE = (480, 640)
OFFSET_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])


def peak_mb() -> float:
    """Return the largest resident memory of this process so far."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def measure(method: str) -> None:
    """Reconstruct rings with noise and print the peak before and after."""
    from lensshift import Burst, reconstruct

    rng = np.random.default_rng(0)
    row, col = np.indices(SHAPE, dtype=float)
    frames = np.stack(
        [
            0.5 + 0.4 * np.sign(np.sin(np.hypot(row - down - 200, col - right - 300) ** 2 / 900))
            for down, right in OFFSET_PX
        ]
    )
    frames += 0.005 * rng.standard_normal(frames.shape)
    burst = Burst.from_arrays(frames, offset_px=OFFSET_PX, pitch_mm=0.01)
    weight = None if method == "auto" else 0.01
    del row, col, frames
    before_mb = peak_mb()
    reconstruct(burst, method=method, prior_weight=weight, std=False)
    print(f"{method:<8} peak {peak_mb():.0f} MB, of which before the call {before_mb:.0f} MB")


def main() -> None:
    """Measure each method in a fresh process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("methods", nargs="*", default=["auto", "irwsr"])
    parser.add_argument("--here", action="store_true", help="in this process")
    arguments = parser.parse_args()
    for method in arguments.methods:
        if arguments.here:
            measure(method)
        else:
            subprocess.run([sys.executable, __file__, method, "--here"], check=True)


if __name__ == "__main__":
    main()
