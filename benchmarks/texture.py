"""What phasors show of texture: simulated scenes beside their amplitudes without a distance.

    python benchmarks/texture.py --seed 11
    python benchmarks/texture.py --seed 11 --pattern 3x3

Each scene of `lensshift simulate` before two cameras, shifts off by 0.02 px. Printed:
PSNR (dB) of the amplitude of the default, of the default without distances, of `tikhonov` and of
`shift-and-add`; of its distances the error (mm, rms), the median `std`, and the share within two;
and what the default warned of. Half a minute.
"""

import argparse
import warnings

import numpy as np

from lensshift import QualityWarning, fidelity, reconstruct
from lensshift.camera import camera_preset, named_pattern_px, simulate_tof
from lensshift.pipeline.experiment_file import named_scene

SCENES = ("four_boxes", "slanted_edge", "depth_step", "siemens_star", "zone_plate")
CAMERAS = ("o3m151", "pmd_176x132")
WAYS = (
    ("auto", {}),
    ("amplitude alone", {"channel": "amplitude"}),
    ("tikhonov", {"method": "tikhonov"}),
    ("shift-and-add", {"method": "shift-and-add"}),
)


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--pattern", default="square", help="of the lens: square, 3x3, 4x4 ...")
    given = parser.parse_args()
    seed, pattern_px = given.seed, named_pattern_px(given.pattern)
    print(f"{'':26}" + "".join(f"{name:>16}" for name, _ in WAYS) + "   mm rms    std  held")
    for scene in SCENES:
        for camera in CAMERAS:
            told = {"seed": seed, "shift_error_px": 0.02}
            taken = simulate_tof(named_scene(scene), camera_preset(camera), pattern_px, **told)
            row, said, default = f"{scene + ', ' + camera:26}", [], None
            for name, how in WAYS:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    found = reconstruct(taken.burst, **how)
                row += f"{fidelity(found.amplitude.image, taken.truth.amplitude).psnr_db:16.2f}"
                default = found if name == "auto" else default
                quality = (w for w in caught if issubclass(w.category, QualityWarning))
                said += [str(w.message)[:60] for w in quality if name == "auto"]
            off = np.abs(default.distance_m.image - taken.truth.distance_m)
            std, rms = default.distance_m.std, np.sqrt(np.mean(off**2))
            row += f"{1e3 * rms:9.2f} {1e3 * np.median(std):6.2f} {np.mean(off < 2 * std):5.2f}"
            print(f"{row}  {'; '.join(said)}", flush=True)


if __name__ == "__main__":
    main()
