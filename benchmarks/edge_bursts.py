"""Errors of the slanted-edge fit on four frames together, and on correlated noise; its time.

python benchmarks/edge_bursts.py --edges 40

The edges are integrated over square pixels on a fine raster; their MTF is known in closed form.
"""

import argparse
import time
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge import Interval, measure_edge

Image = NDArray[np.float64]

SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])
ANGLES_DEG, SIGMAS_PX = (2, 5, 10, 15), (0.15, 0.3, 0.5, 0.8)
FINER = 25


def edge(shape: tuple[int, int], angle_rad: float, place_px: float, sigma_px: float) -> Image:
    """Return an edge from 0 to 1, averaged over FINER x FINER points a pixel."""
    sub = (np.arange(FINER) + 0.5) / FINER - 0.5
    row, col = ((np.arange(n)[:, None] + sub).ravel() - (n - 1) / 2 for n in shape)
    normal = col * np.cos(angle_rad) + row[:, None] * np.sin(angle_rad) - place_px
    fine = ndtr(normal / sigma_px).reshape(shape[0], FINER, shape[1], FINER)
    return np.asarray(fine.mean(axis=(1, 3)))


def true_mtf50(angle_rad: float, sigma_px: float) -> float:
    frequency = np.linspace(0.0, 1.0, 100_001)
    pixel = np.sinc(frequency * np.cos(angle_rad)) * np.sinc(frequency * np.sin(angle_rad))
    mtf = np.abs(pixel) * np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)
    return float(frequency[np.argmax(mtf < 0.5)])


def joint(seed: int) -> tuple[Interval, float]:
    """Measure four frames of 64 x 16 pixels with 1 % noise."""
    rng, angle_rad, sigma_px, place_px = drawn(seed)
    normal = np.array([np.sin(angle_rad), np.cos(angle_rad)])
    frames = [edge((16, 64), angle_rad, place_px + shift @ normal, sigma_px) for shift in SQUARE_PX]
    noisy = np.stack(frames) + 0.01 * rng.standard_normal((4, 16, 64))
    return measure_edge(0.2 + noisy, offset_px=SQUARE_PX).mtf50_lpmm, true_mtf50(
        angle_rad, sigma_px
    )


def correlated(seed: int, reach_px: float) -> tuple[Interval, float]:
    """Measure 128 x 32 pixels with 2 % noise that neighbours share."""
    rng, angle_rad, sigma_px, place_px = drawn(seed)
    noise = gaussian_filter(rng.standard_normal((64, 160)), reach_px)[16:48, 16:144]
    image = edge((32, 128), angle_rad, place_px, sigma_px) + 0.02 * noise / noise.std()
    return measure_edge(0.2 + image).mtf50_lpmm, true_mtf50(angle_rad, sigma_px)


def photographed(seed: int) -> tuple[float, float]:
    """Return the CPU seconds of 300 x 125 pixels with 1 % correlated noise, and times sfrmat5."""
    rng, angle_rad, sigma_px, place_px = drawn(seed)
    noise = gaussian_filter(rng.standard_normal((300, 125)), 0.8)
    image = 0.2 + edge((300, 125), angle_rad, place_px, sigma_px + 0.5) + 0.01 * noise / noise.std()
    region, spent_s = (0, 300, 0, 125), []
    for method in ("ml", "sfrmat5"):
        begun = time.process_time()
        measure_edge(image, region=region, method=method)
        spent_s.append(time.process_time() - begun)
    return spent_s[0], spent_s[0] / spent_s[1]


def drawn(seed: int) -> tuple[np.random.Generator, float, float, float]:
    rng = np.random.default_rng(seed)
    angle_rad = float(np.deg2rad(ANGLES_DEG[seed % 4]))
    return rng, angle_rad, SIGMAS_PX[seed // 4 % 4], float(rng.uniform(-2, 2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edges", type=int, default=40, help="edges in each row")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    cases = {"four frames of 64 x 16, 1 %": joint}
    for reach_px in (0.5, 0.8, 1.0):
        name = f"128 x 32, 2 %, correlated over {reach_px} px"
        cases[name] = lambda seed, reach_px=reach_px: correlated(seed, reach_px)
    for name, case in cases.items():
        found = [case(1000 + k) for k in range(arguments.edges)]
        errors = np.array([half.value / truth - 1 for half, truth in found])
        covered = np.mean([half.low <= truth <= half.high for half, truth in found])
        print(
            f"{name:<40s} MTF50 rms {100 * np.sqrt(np.mean(errors**2)):.2f} %, "
            f"95 % intervals cover {100 * covered:.1f} %",
            flush=True,
        )
    spent_s, ratio = np.median([photographed(1000 + k) for k in range(5)], axis=0)
    print(f"300 x 125, 1 %, correlated over 0.8 px  {spent_s:.2f} s, {ratio:.0f} times sfrmat5")


if __name__ == "__main__":
    main()
