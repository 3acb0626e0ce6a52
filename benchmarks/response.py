"""How well the width of the pixel response is read from frames, and what pictures lose by it.

    python benchmarks/response.py --seed 50

Mosaics, which no training saw, before pixels a third of the pitch to all of it wide, 4 and 9
frames, SNR 20 to 300: the width (LR pixels), how many were read, the rms error of these and the
part inside two standard deviations; and what PSNR (dB) loses against the true width, with the width
that is read and with the usual one, mean and 90 %. Then scenes of `lensshift simulate`, with the
PSNR of all three. Last, in how many bursts the frames object to a width that is told, by how wrong
it is. Two minutes.
"""

import argparse
import math
import sys
import warnings
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from lensshift import Burst, fidelity, reconstruct
from lensshift.camera import camera_preset, named_pattern_px, simulate_tof
from lensshift.pipeline.experiment_file import named_scene

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "reconstruction"))
from mosaic import SAMPLES, canvas, observe, square

SIDES = (4, 6, 8, 10, 12)
SCENES = ("four_boxes", "slanted_edge", "depth_step", "siemens_star", "zone_plate")
PATTERNS = ("square", "3x3")
USUAL_PX = 0.3
WRONG_BY = (0.5, 0.7, 1.0, 1.4, 2.0)


def seen(burst: Burst, truth: np.ndarray, true_px: float) -> tuple[dict, list[float]]:
    """Return the settings where nothing is told, and PSNR with the true, read and usual width."""
    bare = Burst.from_arrays(burst.amplitude, offset_px=burst.offset_px, pitch_mm=1.0)
    found = [reconstruct(bare, psf_sigma_px=px) for px in (true_px, "auto", USUAL_PX)]
    return found[1].settings, [fidelity(one.amplitude.image, truth).psnr_db for one in found]


def mosaics(seed: int, count: int) -> None:
    """Print a line for each width of the pixels."""
    for side in SIDES:
        true_px = math.sqrt(side**2 - 1) / SAMPLES / math.sqrt(12)
        errors, z, lost = [], [], []
        for number in range(count):
            rng = np.random.default_rng((seed, side, number))
            offset = np.round(square(int(rng.choice([2, 2, 3]))) * SAMPLES) / SAMPLES
            snr = float(rng.choice([20, 50, 100, 300]))
            shape = (24, 30)
            of = observe(canvas(rng, shape), shape, offset_px=offset, snr=snr, side=side, rng=rng)
            burst = Burst.from_arrays(of.y, offset_px=of.offset_px, pitch_mm=1.0)
            settings, (told, read, usual) = seen(burst, of.truth, true_px)
            lost.append((told - read, told - usual))
            if settings["psf_source"] == "frames":
                errors.append(settings["psf_sigma_px"] - true_px)
                z.append(abs(errors[-1]) / settings["psf_std_px"])
        mean, most = np.mean(lost, 0), np.quantile(lost, 0.9, axis=0)
        rms = np.sqrt(np.mean(np.square(errors)))
        print(
            f"{true_px:.3f}  read {len(z):3d} of {count}  rms {rms:.3f}"
            f"  inside {100 * np.mean(np.less(z, 2)):3.0f} %  lost {mean[0]:5.2f} ({most[0]:5.2f})"
            f"  usual {mean[1]:5.2f} ({most[1]:5.2f})",
            flush=True,
        )


def scenes(seed: int) -> None:
    """Print a line for each scene and pattern."""
    for scene in SCENES:
        for pattern in PATTERNS:
            taken = simulate_tof(
                named_scene(scene), camera_preset("o3m151"), named_pattern_px(pattern), seed=seed,
                shift_error_px=0.02,
            )  # fmt: skip
            true_px = taken.burst.meta["psf_sigma_px"]
            settings, db = seen(taken.burst, taken.truth.amplitude, true_px)
            said = settings["psf_source"], settings["psf_sigma_px"]
            print(
                f"{scene + ', ' + pattern:22} {true_px:.3f} px, {said[0]:8} {said[1]:.3f}  "
                f"told {db[0]:6.2f}  read {db[1]:6.2f}  usual {db[2]:6.2f}",
                flush=True,
            )


def objected(seed: int, count: int) -> None:
    """Print for each width, and for scenes out of focus, how often a told one is objected to."""
    for side, soft in [(side, 0.0) for side in SIDES] + [(12, 0.4), (12, 0.8)]:
        true_px = math.hypot(math.sqrt(side**2 - 1) / SAMPLES / math.sqrt(12), soft)
        said = dict.fromkeys(WRONG_BY, 0)
        for number in range(count):
            rng = np.random.default_rng((seed, side, number, 7))
            offset = np.round(square(int(rng.choice([2, 2, 3]))) * SAMPLES) / SAMPLES
            fine = gaussian_filter(canvas(rng, (24, 30)), soft * SAMPLES)
            snr = float(rng.choice([20, 100, 1000]))
            of = observe(fine, (24, 30), offset_px=offset, snr=snr, side=side, rng=rng)
            burst = Burst.from_arrays(of.y, offset_px=of.offset_px, pitch_mm=1.0)
            for by in WRONG_BY:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    reconstruct(burst, psf_sigma_px=by * true_px, std=False)
                said[by] += any("lets them be" in str(w.message) for w in caught)
        told = "  ".join(f"x{by:g}: {number:3d}" for by, number in said.items())
        print(f"{true_px:.3f} px, {soft:g} of it the lens, of {count}: told {told}", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=50)
    parser.add_argument("--count", type=int, default=30, help="mosaics for each width")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    mosaics(given.seed, given.count)
    scenes(given.seed)
    objected(given.seed, given.count)


if __name__ == "__main__":
    main()
