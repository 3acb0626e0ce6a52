"""
The paper's figures 4 and 5: the slanted edge
=============================================

A card at 3.5 m with an edge 10 degrees off the vertical, seen through the moving lens: one frame,
bicubic, the reconstruction from a moved sensor and from a moved lens, and their MTF along the
normal of the edge.
"""

from lensshift.pipeline.paper.edge_claims import FREQUENCY_LPMM, KINDS, limit, take_edge
from lensshift.report.claims import curves_figure
from lensshift.report.shots import shots_figure

run = take_edge(0)
shown = {kind: {"amplitude": run.images[kind]} for kind in KINDS}
picture = shots_figure(shown, "Edge card at 3.5 m, SNR 50", wide_in=8.0)

# %%
# One burst; ``lensshift reproduce`` takes many and gives intervals.

curves = {kind: run.edges[kind].mtf.modulation for kind in KINDS}
limits = {"|sinc| of a pixel": limit(1.0), "|sinc| of half a pixel": limit(0.5)}
mtf = curves_figure(FREQUENCY_LPMM, curves, limits, "MTF along the normal of the edge")
for kind in KINDS:
    print(f"{kind:14s} MTF50 {run.edges[kind].mtf50_lpmm} LP/mm")
