"""How far the OTF of what the simulator sees through a lens is from that of the lens.

    python benchmarks/spots.py

prints the largest differences of MTF and complex OTF, in six directions at 0.1 to 1 cycles per
pixel, with the first element moved, in the middle, half way out and near the corner: the table of
docs/decisions/0036-spots-from-waves.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lensshift.camera import LensOptics, TofCamera
from lensshift.camera.view import motions
from lensshift.core.grid import Grid
from lensshift.optics.lens_file import load_lens
from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.shift import decenter_for_shift, moving
from lensshift.optics.spots import fields_for_image

CASES = (
    ("petzval_a", None, 0.155, (16, 64)),
    ("petzval_b", None, 0.155, (16, 64)),
    ("petzval_a", 12.5, 0.011, (16, 64)),
    ("petzval_b", 12.5, 0.011, (16, 64)),
    ("al2550", 12.5, 0.011, (16, 64)),
    ("al2550", None, 0.155, (16, 64)),
    ("al2550", None, 0.007, (480, 640)),
)
SHIFT_PX = np.array([0.35, 0.7])
PLACES = ((0.0, 0.0), (-0.28, 0.3), (-0.42, 0.46))  # over the size of the sensor, from the middle
AZIMUTHS_RAD = np.linspace(0.0, np.pi, 6, endpoint=False)
CPP = np.array([0.1, 0.25, 0.5, 0.75, 1.0])


def main() -> None:
    axes = np.stack([np.sin(AZIMUTHS_RAD), np.cos(AZIMUTHS_RAD)], axis=-1)
    print(f"{'lens':12s} pitch_um  up to 1 cycle: MTF    OTF   up to 0.5: MTF    OTF")
    for name, f_number, pitch_mm, shape in CASES:
        lens = load_lens(name)
        if f_number is not None:
            smaller = paraxial(lens).working_f_number / f_number
            stop = replace(lens.stop, diameter_mm=smaller * lens.stop.diameter_mm)
            lens = replace(lens, stop=stop)
        grid = Grid(shape, (pitch_mm, pitch_mm))
        ((_, blur),) = motions(TofCamera(grid, LensOptics(lens)), SHIFT_PX[None], 1.0)
        assert not isinstance(blur, float)
        build = moving(lens, 0, decenter_for_shift(lens, 0, SHIFT_PX, grid))
        worst = np.zeros((2, len(CPP)))
        for place in PLACES:
            away_px = np.array(place) * shape
            field = fields_for_image(lens, away_px * pitch_mm, build=build)
            exact = exact_otf(lens, field, CPP / pitch_mm, AZIMUTHS_RAD, build=build)
            at_px = away_px + 0.5 * (np.array(shape) - 1.0)
            seen = blur.otf(at_px, CPP[None, :, None] * axes[:, None])
            off = np.stack([np.abs(np.abs(seen) - np.abs(exact)), np.abs(seen - exact)])
            worst = np.maximum(worst, off.max(axis=1))
        (mtf, otf), (near, nearby) = worst.max(axis=1), worst[:, CPP <= 0.5].max(axis=1)
        print(f"{name:12s} {1e3 * pitch_mm:8.0f} {mtf:19.3f} {otf:6.3f} {near:15.3f} {nearby:6.3f}")


if __name__ == "__main__":
    main()
