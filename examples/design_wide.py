"""Design a wide, fast lens for 320 x 240 pixels of 15 um at 940 nm from a starting form.

    python examples/design_wide.py --out wide_940.toml

f/1.2, 60 degrees from corner to corner for an image without distortion, of which it may have 5 %;
a laser of 30 nm, a window of 0.5 mm, the stop between the elements. First six spheres at a small
aperture and field that grow, then aspheres on three elements, then the distortion, then the band.
Takes about three minutes.
"""

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from lensshift.core.grid import Grid
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import format_lens
from lensshift.optics.mtf import led_band
from lensshift.optics.paraxial import paraxial
from lensshift.optics.refine import ray_error_um, refine
from lensshift.optics.task import Limits, Task
from lensshift.optics.variables import Freedom
from lensshift.optics.which import edge_fields, least_mtf

GRID = Grid((240, 320), (0.015, 0.015))
FOCAL_MM = 0.5 * math.hypot(240, 320) * 0.015 / math.tan(math.radians(30.0))
BAND = led_band(940.0, 30.0, samples=3)
LIMITS = Limits(
    glass_mm=(0.8, 4.5), edge_mm=0.4, air_mm=0.1, back_focal_mm=0.25, track_mm=25.0, distortion=0.1
)
# A meniscus that spreads the field, two lenses, the stop, a triplet: radii, glass, length, air.
FORM = (
    ("meniscus", (12.0, 4.2), "N-LASF44", 1.0, 3.0),
    ("front", (20.0, -20.0), "N-LASF44", 3.5, 1.5),
    ("middle", (14.0, -14.0), "N-LASF44", 2.5, 0.6),
    ("negative", (-10.0, 20.0), "N-SF66", 0.8, 0.3),
    ("rear", (14.0, -12.0), "N-LASF44", 2.5, 0.1),
    ("last", (8.0, 40.0), "N-LASF44", 2.5, 1.2),
)
STOP_MM = 8.6
HEADER = """\
# Six lenses, three of them aspheric, for 320 x 240 pixels of 0.015 mm at 940 nm: f/1.2, focal
# length 5.2 mm, a window of 0.5 mm. Made by examples/design_wide.py.
"""


def starting_form() -> Lens:
    """Return a lens with about the right powers and nothing else."""
    elements = [
        Element(tuple(map(Surface, radii)), (glass,), (thick_mm,), name)
        for name, radii, glass, thick_mm, _ in FORM
    ]
    gaps_mm = [air_mm for *_, air_mm in FORM]
    return Lens(
        elements=(*elements, cover_glass("N-BK7", 0.5)),
        gaps_mm=(*gaps_mm, 0.3),
        stop=Stop(4.0, STOP_MM),
        wavelength_nm=940.0,
        name="Wide 940",
    )


def show(title: str, lens: Lens, task: Task) -> None:
    """Print what a lens does."""
    errors = " ".join(f"{value:6.2f}" for value in ray_error_um(lens, task))
    print(f"{title:<12} rays {errors} um rms", flush=True)


def main() -> None:
    """Print the stages and write the lens."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("wide_940.toml"))
    out = parser.parse_args().out
    task, free = Task(GRID, FOCAL_MM, 1.2, LIMITS), Freedom(thicknesses=True, stop=True)
    lens = starting_form()
    show("form", lens, task)
    lens = refine(lens, task, free, grow=(0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0), steps=80)
    show("spheres", lens, task)
    aspheric = replace(free, aspheres=3, aspheric=(0, 4, 5))
    lens = refine(lens, task, aspheric, steps=80)
    show("aspheres", lens, task)
    task = replace(task, limits=replace(LIMITS, distortion=0.05))
    lens = refine(lens, task, aspheric, steps=80)
    show("distortion", lens, task)
    task = replace(task, band=BAND)
    lens = refine(lens, task, replace(aspheric, aspheres=4), steps=80)
    show("band", lens, task)
    data, corner = paraxial(lens), float(np.linalg.norm(edge_fields(lens, GRID), axis=-1).max())
    print(
        f"focal length {data.focal_length_mm:.3f} mm, f/{data.f_number:.3f}, "
        f"{2.0 * math.degrees(math.atan(corner)):.1f} degrees from corner to corner, "
        f"{lens.positions_mm()[-1]:.1f} mm long"
    )
    for lpmm in (0.5 / 0.015, 1.0 / 0.015):
        mtf = least_mtf(lens, GRID, frequency_lpmm=lpmm, band=BAND)[0]
        print(f"least MTF over the sensor at {lpmm:.1f} LP/mm: {mtf:.3f}")
    out.write_text(HEADER + format_lens(lens), encoding="utf-8")
    sys.stderr.write(f"wrote {out}\n")


if __name__ == "__main__":
    main()
