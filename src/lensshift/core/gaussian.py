"""Robust scales of Gaussian values in standard deviations, from the quantiles of their sizes."""

from __future__ import annotations

import math
from statistics import NormalDist

# sigma = MAD_TO_SIGMA median |x - median x|
MEDIAN_SIZE = NormalDist().inv_cdf((1 + 1 / 2) / 2)
MAD_TO_SIGMA = 1 / MEDIAN_SIZE
# Standard error of a median over that of a mean, of many values.
MEDIAN_ERROR = math.sqrt(math.pi / 2)
UPPER_QUARTILE_SIZE = NormalDist().inv_cdf((1 + 3 / 4) / 2)
