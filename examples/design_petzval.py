"""Search the stock lenses that come with the package for a movable lens of 42.7 mm.

    python examples/design_petzval.py --out petzval_search.toml

Two positive lenses and a negative one in every combination and orientation, each element as the
one that moves: least MTF of 0.90 at the corner of 64 x 16 pixels of 0.155 mm, centred and moved,
shift errors up to 0.01 px, at least 2 mm in front of the sensor. Takes about two minutes.
"""

import argparse
import sys
from pathlib import Path

from lensshift.core.grid import Grid
from lensshift.optics.goal import Goal
from lensshift.optics.lens_file import format_lens, load_lens
from lensshift.optics.stock import format_designs, search_stock

POSITIVE = ("al2550", "eo33944", "eo33950", "eo33093")
NEGATIVE = ("lc1054", "lc4210", "eo45030")
GOAL = Goal(Grid((16, 64), (0.155, 0.155)), focal_length_mm=42.7, object_mm=3500.0)
HEADER = """\
# A Petzval lens of three stock lenses for a sensor of 64 x 16 pixels of 0.155 mm: focal length
# 42.7 mm, stop of 20 mm at the first vertex, the sharpest one that also shifts evenly: element {}
# moves. Made by examples/design_petzval.py.
"""


def show(done: int, total: int) -> None:
    """Count the steps in one line of the terminal."""
    sys.stderr.write(f"\r{done} of {total}" + ("\n" if done == total else ""))


def main() -> None:
    """Print the best trains and write the best of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("petzval_search.toml"))
    parser.add_argument("--keep", type=int, default=8, help="trains that are optimised")
    options = parser.parse_args()
    positive, negative = ([load_lens(name) for name in names] for names in (POSITIVE, NEGATIVE))
    designs = search_stock(
        [positive, positive, negative], GOAL, keep=options.keep, on_progress=show
    )
    print(format_designs(designs))
    best = designs[0]
    mover = 0 if best.element is None else best.element + 1
    text = format_lens(best.lens)
    name = f'name = "{best.lens.name}"'
    text = HEADER.format(mover) + text.replace(name, 'name = "Petzval search"', 1)
    options.out.write_text(text, encoding="utf-8")
    print(f"{options.out}: {sum(one.meets(GOAL) for one in designs)} designs meet the goal")


if __name__ == "__main__":
    main()
