"""What phasors show of texture: amplitudes of simulated scenes beside those without a distance.

    python benchmarks/texture.py --seed 11
    python benchmarks/texture.py --seed 11 --pattern 3x3

Each scene of `lensshift simulate` before two cameras, shifts off by 0.02 px. Printed:
PSNR (dB) of the amplitude of the default, of the default without distances, of `tikhonov` and of
`shift-and-add`, and what the default warned of. Half a minute.
"""

import argparse
import warnings

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
    print(f"{'':26}" + "".join(f"{name:>16}" for name, _ in WAYS))
    for scene in SCENES:
        for camera in CAMERAS:
            told = {"seed": seed, "shift_error_px": 0.02}
            taken = simulate_tof(named_scene(scene), camera_preset(camera), pattern_px, **told)
            row, said = f"{scene + ', ' + camera:26}", []
            for name, how in WAYS:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    image = reconstruct(taken.burst, **how).amplitude.image
                row += f"{fidelity(image, taken.truth.amplitude).psnr_db:16.2f}"
                quality = (w for w in caught if issubclass(w.category, QualityWarning))
                said += [str(w.message)[:60] for w in quality if name == "auto"]
            print(f"{row}  {'; '.join(said)}", flush=True)


if __name__ == "__main__":
    main()
