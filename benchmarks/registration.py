"""How well shifts are found: registration, calibration.

    python benchmarks/registration.py --seeds 3

Prints rms errors in pixels and, behind, the actual error over the standard error that was told;
then how often 95 % intervals hold the shifts of 4, 9 and 16 frames, and of pixels that differ in
gain. The EIA chart needs the reference data (LENSSHIFT_REFERENCE, or shared/reference beside the
repository). Takes some minutes.
"""

import argparse
import os
import sys
import warnings
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst
from lensshift.registration import METHODS, fit_scan, register

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "registration"))

from rig import Rig
from scenes import SNR_50, random_boxes, scene, taken

SCENES = ("demo", "four boxes", "checker", "random")
FULL_GRID = 0.25 * np.stack(np.meshgrid(range(4), range(4), indexing="ij"), -1).reshape(-1, 2)


def rms(values: object) -> float:
    """Return the root mean square of everything."""
    return float(np.sqrt(np.mean(np.square(values))))


def eia() -> None:
    """Print how far the frames of the EIA chart lie from their grid of quarter pixels."""
    folder = Path(os.environ.get("LENSSHIFT_REFERENCE", ROOT.parent / "shared" / "reference"))
    file = folder / "real_sequences" / "mdsp_eia.npz"
    if not file.is_file():
        print("EIA chart: no reference data")
        return
    frames = np.load(file)["frames"]
    for numbers in ([0, 2, 8, 10], list(range(16))):
        burst = Burst.from_arrays(
            frames[numbers], offset_px=np.zeros((len(numbers), 2)), pitch_mm=1.0
        )
        for method in METHODS:
            wrong = register(burst, method=method).offset_px + FULL_GRID[numbers]
            print(f"EIA {len(numbers):2d} frames {method:9} largest {np.abs(wrong).max():.4f} px")


def simulated(seeds: int) -> None:
    """Print errors on aliased, quantised frames of 64 x 16 pixels at SNR 50."""
    for name in SCENES:
        for method in METHODS:
            wrong, told = [], []
            for seed in range(seeds):
                burst, true_px = taken(scene(name), seed=seed)
                found = register(burst, method=method)
                wrong.append((found.offset_px - true_px)[1:])
                told.append(found.offset_sigma_px[1:])
            print(f"{name:11} {method:9} {rms(wrong):.4f} px, {rms(wrong) / rms(told):.2f}")


def held(bursts: int) -> None:
    """Print how often 95 % intervals hold the shifts of 4, 9 and 16 frames of drawn boxes."""
    for side in (2, 3, 4):
        planned_px = tuple(product((np.arange(side) - (side - 1) / 2) / side, repeat=2))
        for snr, full_well in ((50, 5e3), (200, 8e4)):
            sensor = replace(SNR_50, full_well_electrons=full_well, bits=16)
            over = []
            for seed in range(500, 500 + bursts):
                burst, true_px = taken(random_boxes(seed), 0.06, seed, planned_px, sensor)
                found = register(burst)
                over.append((found.offset_px - true_px)[1:] / found.offset_sigma_px[1:])
            share = np.mean(np.abs(over) < 1.96)
            print(f"{side**2:2d} frames SNR {snr:3d}  held {share:.3f}, {rms(over):.2f}")


def patterned(bursts: int) -> None:
    """Print errors of the shifts of four frames whose pixels differ in gain, at SNR 200."""
    sensor = replace(SNR_50, full_well_electrons=8e4, bits=16)
    for share in (0.0, 0.01, 0.03):
        wrong, over = [], []
        for seed in range(500, 500 + bursts):
            burst, true_px = taken(random_boxes(seed), 0.06, seed, sensor=sensor)
            own = np.random.default_rng(seed).standard_normal(burst.grid.shape)
            found = register(replace(burst, amplitude=burst.amplitude * (1.0 + share * own)))
            wrong.append((found.offset_px - true_px)[1:])
            over.append(wrong[-1] / found.offset_sigma_px[1:])
        held_share = np.mean(np.abs(over) < 1.96)
        print(f"gains apart by {share:.0%}  {rms(wrong):.4f} px, held {held_share:.3f}")


def calibrated() -> None:
    """Print how well a rig with known faults is calibrated."""
    rig = Rig(bending=1.0)
    found = fit_scan(rig.scan(), rest_mm=np.array([3.0, 5.0])).calibration
    per_mm = found.stage_map.field_px_per_mm
    wrong_px = (per_mm - rig.field_px_per_mm()) * (0.25 / 5.5)
    print(f"map over the sensor, for 0.25 px: {rms(wrong_px):.4f} px rms")
    print(f"map    {np.abs(found.stage_map.px_per_mm - rig.px_per_mm).max():.3f} px per mm")
    print(f"play   {1e3 * np.abs(found.play_mm - rig.play_mm).max():.2f} um")
    print(
        f"drift  {60 * np.abs(found.drift_px_per_s - rig.drift_px_per_s).max():.4f} px per minute"
    )


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="bursts of each scene")
    seeds = parser.parse_args().seeds
    warnings.simplefilter("ignore", QualityWarning)
    simulated(seeds)
    held(10 * seeds)
    patterned(10 * seeds)
    calibrated()
    eia()


if __name__ == "__main__":
    main()
