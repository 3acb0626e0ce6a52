"""
The paper's figure 3: MTF of the moved lens
===========================================

At the centre and in the corner of the field, at rest and moved, beside what the pixels let
through: the lens resolves beyond the sensor, and moving its first element hardly changes that.
"""

import lensshift
from lensshift.core.grid import Grid
from lensshift.optics.shift import decenter_for_shift
from lensshift.report.lenses import mtf_figure

lens = lensshift.load_lens("petzval_a")
grid = Grid((16, 64), (0.155, 0.155))
travel_mm = decenter_for_shift(lens, 0, [0.25, 0.25], grid)
fields_tan = [(0.0, 0.0), (0.0279, 0.1139)]  # 0 / 0 and 1.6 / 6.5 degrees
figure = mtf_figure(lens, 0, (float(travel_mm[0]), float(travel_mm[1])), grid, fields_tan)
