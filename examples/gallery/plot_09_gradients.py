"""
Amplitude twice, distance three times?
======================================

A strip before a wall leans by one pixel over 64 lines, so that its edge is seen at 64 places
within a pixel; the gain of the gradient is the mean over them. Why the distance may gain three
times where the amplitude gains two.
"""

from lensshift.pipeline.paper.bench import calibrated_response
from lensshift.pipeline.paper.box_claims import BRANCHES
from lensshift.pipeline.paper.reproduce import study_row
from lensshift.report.claims import gains_figure

response, _ = calibrated_response()
rows = [
    study_row(contrast, width_px, snr, response)
    for contrast, width_px, snr in ((3.0, 12.0, 400.0), (0.15, 12.0, 400.0), (0.15, 1.0, 400.0))
]
figure = gains_figure(rows, BRANCHES, "Gain of the gradient by strip")
