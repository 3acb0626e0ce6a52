"""What errors of the shifts cost a reconstruction: the table in `lensshift.optics.actuator`.

    python benchmarks/shift_budget.py --draws 6

Bursts of four frames at quarter pixels around the centre, simulated with normal errors of every
shift and reconstructed as if the shifts were as planned, with scale 2 and method "auto". The burst
says how far off the shifts may be, but no less than 0.02 px, so that the choice of the prior does
not mix with what the errors do. The error that all frames of a burst share only moves the picture
and is taken out. The shifts count as registered, so that the frames do not mend them: in the dark
and of scenes with little to see they cannot. What is lost is against the burst of the same noise
without errors: PSNR of the demo target on 64 x 16 pixels against pixels of half the size, MTF50 of
a Siemens star of 12 cycles on 40 x 40 pixels. Means over the draws, and their standard errors.
Takes some minutes.
"""

import argparse
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lensshift import Burst, QualityWarning, fidelity, reconstruct, siemens_star_mtf
from lensshift.camera import Sensor, Truth, simulate_burst
from lensshift.core.grid import Grid
from lensshift.scene import Target, demo_target, siemens_star

PITCH_MM = 0.155
WIDE, SQUARE = (Grid(shape, (PITCH_MM, PITCH_MM)) for shape in ((16, 64), (40, 40)))
CYCLES = 12
ERRORS_PX = (0.0, 0.01, 0.02, 0.05, 0.1)
LEAST_TOLD_PX = 0.02
PLANNED_PX = ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25))
# Noise of a pixel at half of full scale, as a share of full scale: full well and read noise.
NOISES = {0.005: (20_000.0, 20.0), 0.02: (1_250.0, 5.0)}
Measure = Callable[[float, float, int], float]


def taken(
    target: Target, grid: Grid, noise: float, error_px: float, seed: int
) -> tuple[Burst, Truth]:
    """Return a burst as its rig describes it, and what nobody knows."""
    sensor = Sensor(grid, *NOISES[noise])
    burst, truth = simulate_burst(target, sensor, PLANNED_PX, shift_error_px=error_px, seed=seed)
    common_px = (truth.offset_px - burst.offset_px).mean(axis=0)
    told_px = np.full((4, 2), max(error_px, LEAST_TOLD_PX))
    offset_px = burst.offset_px + common_px
    told = {"offset_px": offset_px, "offset_sigma_px": told_px, "offset_source": "registered"}
    return replace(burst, **told), truth


def psnr_db(noise: float, error_px: float, seed: int) -> float:
    """Return the PSNR of the reconstructed demo target."""
    target = demo_target((16 * PITCH_MM, 64 * PITCH_MM))
    burst, truth = taken(target, WIDE, noise, error_px, seed)
    return fidelity(reconstruct(burst, 2, std=False).amplitude.image, truth.image).psnr_db


def mtf50_lpmm(noise: float, error_px: float, seed: int) -> float:
    """Return where the MTF of a reconstructed star falls to a half."""
    burst, _ = taken(siemens_star(18 * PITCH_MM, CYCLES), SQUARE, noise, error_px, seed)
    star = siemens_star_mtf(
        reconstruct(burst, 2, std=False).amplitude.image,
        cycles=CYCLES,
        pitch_mm=0.5 * PITCH_MM,
        center_px=(39.5, 39.5),
        profile="square",
        radius_range_mm=(1.5 * PITCH_MM, 17 * PITCH_MM),
    ).mtf
    below = int(np.flatnonzero(star.modulation < 0.5)[0])
    here = slice(below, below - 2, -1)
    return float(np.interp(0.5, star.modulation[here], star.frequency_lpmm[here]))


def measured(measure: Measure, noise: float, draws: int) -> np.ndarray:
    """Return [error draw], the same draws for each error."""
    got = np.zeros((len(ERRORS_PX), draws))
    for row, error_px in zip(got, ERRORS_PX, strict=True):
        for seed in range(draws):
            row[seed] = measure(noise, error_px, seed)
            sys.stderr.write(f"\r{measure.__name__} {noise} {error_px} {seed + 1}/{draws} ")
    return got


def main() -> None:
    """Print the table as it stands in the module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=6, help="of the star; the target has 3 times")
    draws = parser.parse_args().draws
    warnings.simplefilter("ignore", QualityWarning)
    print("# (noise, error in px): (PSNR lost in dB, share of MTF50 lost),  # standard errors")
    for noise in NOISES:
        psnr, mtf50 = measured(psnr_db, noise, 3 * draws), measured(mtf50_lpmm, noise, draws)
        shares = (mtf50[0] - mtf50) / mtf50[0].mean()
        for error_px, db, share in zip(ERRORS_PX, psnr[0] - psnr, shares, strict=True):
            errors = [values.std(ddof=1) / np.sqrt(values.size) for values in (db, share)]
            print(
                f"({noise}, {error_px}): ({db.mean():.2f}, {share.mean():.3f}),"
                f"  # {errors[0]:.2f}, {errors[1]:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
