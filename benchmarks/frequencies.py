"""Errors of distances of several modulation frequencies, and of the lowest of them alone.

python benchmarks/frequencies.py --seed 900 --bursts 8

Boxes and poles in front of a slanted wall, 1 to 6 m away and up to 20 times as dark as each other.
Each LR pixel is the mean of 12 x 12 points of the scene, taken up to 0.02 px rms from where the
solver is told. Root mean squares in mm of HR pixels that see two surfaces, of those up to two
pixels from such a one, and of the rest; how many of these two are off by half a turn of the highest
frequency or more; and how much of the rest is within two standard deviations.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from lensshift import Burst, reconstruct
from lensshift.core.units import SPEED_OF_LIGHT_MPS, distance_to_phase

SHAPE, FINE, SCALE, SHIFT_ERROR_PX = (18, 26), 12, 2, 0.02
OFFSETS_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)])
SETS_MHZ = ((100, 20), (80, 20), (60, 15), (80, 60), (80.3, 60.2), (100, 80, 60))
Array = NDArray[np.float64]


def scene(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return distance and reflectance at fine points of the frames and one pixel around them."""
    rows, cols = ((n + 2) * FINE for n in SHAPE)
    row, col = np.mgrid[:rows, :cols]
    distance_m = rng.uniform(4.5, 5.5) + col / cols * rng.uniform(-1, 1)
    light = np.full((rows, cols), rng.uniform(0.3, 0.8))
    for number in range(7):
        at = rng.uniform(0, rows), rng.uniform(0, cols)
        half = rng.uniform(1, 8, 2) * FINE / 2
        if number % 3 == 0:
            half = np.array([rows, FINE * rng.uniform(0.5, 1)])  # a pole
        inside = (np.abs(row - at[0]) < half[0]) & (np.abs(col - at[1]) < half[1])
        distance_m[inside], light[inside] = rng.uniform(1.0, 4.5), rng.uniform(0.05, 1.0)
    return distance_m, light


def burst_of(
    rng: np.random.Generator, distance_m: Array, light: Array, hz: tuple[float, ...], snr: float
) -> Burst:
    """Return phasors with noise of SNR = median amplitude / noise of a component."""
    rows, cols = (n * FINE for n in SHAPE)
    phasors = []
    for one in hz:
        fine = light * np.exp(1j * distance_to_phase(distance_m, one))
        at = OFFSETS_PX + SHIFT_ERROR_PX * rng.standard_normal(OFFSETS_PX.shape)
        places = FINE - np.rint(at * FINE).astype(int)
        parts = np.stack([fine[r : r + rows, c : c + cols] for r, c in places])
        y = parts.reshape(len(at), SHAPE[0], FINE, SHAPE[1], FINE).mean(axis=(2, 4))
        noise = rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)
        phasors.append(y + np.median(np.abs(y)) / snr * noise)
    if len(hz) == 1:
        return Burst.from_arrays(
            phasors[0], modulation_hz=hz[0], offset_px=OFFSETS_PX, pitch_mm=0.1
        )
    return Burst.from_arrays(
        np.stack(phasors), modulation_hz=hz, offset_px=OFFSETS_PX, pitch_mm=0.1
    )


def measured(hz: tuple[float, ...], snr: float, seed: int, turn_m: float) -> list[float]:
    """Return mean squares of mixed, near and other pixels, those in wrong turns, and coverage."""
    rng = np.random.default_rng(seed)
    distance_m, light = scene(rng)
    found = reconstruct(burst_of(rng, distance_m, light, hz, snr), SCALE).distance_m
    side = FINE // SCALE
    inner = distance_m[FINE:-FINE, FINE:-FINE]
    seen = inner.reshape(SHAPE[0] * SCALE, side, SHAPE[1] * SCALE, side)
    nearest, farthest = seen.min(axis=(1, 3)), seen.max(axis=(1, 3))
    mixed = farthest - nearest > 0.05 * nearest
    near = maximum_filter(mixed, 5) & ~mixed
    rest = ~(near | mixed)
    error = found.image - seen.mean(axis=(1, 3))
    covered = np.mean(np.abs(error[rest]) < 2 * found.std[rest])
    squares = [np.mean(error[part] ** 2) for part in (mixed, near, rest)]
    return [*squares, np.sum(np.abs(error[~mixed]) > turn_m / 2), covered]


def main() -> None:
    """Print a line for each set of frequencies and signal-to-noise ratio."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--bursts", type=int, default=8, help="of each condition")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    print("MHz             SNR  frequencies  mixed   near   rest   wrong turn  in 2 std")
    for mhz in SETS_MHZ:
        hz = tuple(1e6 * f for f in mhz)
        alone = ((min(hz),),) if max(hz) / min(hz) > 2 else ()
        for snr in (60.0, 20.0):
            for used in (hz, *alone):
                turn_m = SPEED_OF_LIGHT_MPS / 2 / max(used)
                rows = [
                    measured(used, snr, args.seed + number, turn_m) for number in range(args.bursts)
                ]
                *squares, wrong, covered = np.mean(rows, axis=0)
                errors = " ".join(f"{1e3 * np.sqrt(square):6.0f}" for square in squares)
                name, kind = "+".join(map(str, mhz)), "all" if len(used) > 1 else "lowest"
                print(
                    f"{name:14s} {snr:4.0f}  {kind:11s} {errors} {wrong * args.bursts:10.0f}"
                    f" {covered:10.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
