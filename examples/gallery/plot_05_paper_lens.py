"""
The paper's figure 2: the lens
==============================

A Petzval lens of three stock elements; the first one moves across the axis. Rays at 0 and 6.5
degrees, at rest and moved by what shifts the image a quarter of a pixel. The publication names
the parts, not the gaps: ``petzval_a`` is one of two reconstructions with the same data.
"""

import lensshift
from lensshift.core.grid import Grid
from lensshift.optics.shift import decenter_for_shift
from lensshift.report.lenses import layout_figure

lens = lensshift.load_lens("petzval_a")
grid = Grid((16, 64), (0.155, 0.155))
travel_mm = decenter_for_shift(lens, 0, [0.25, 0.25], grid)
figure = layout_figure(lens, 0, (float(travel_mm[0]), float(travel_mm[1])))
print(f"{1e3 * travel_mm[1]:.1f} um for a quarter of a pixel")
