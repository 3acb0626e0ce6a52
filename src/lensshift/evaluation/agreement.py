"""Whether an edge and a pattern of the same target tell the same resolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.optical import MtfCurve

# Where the edge promises between these, the curves are compared: a pattern has no more to show
# below, and above both are near 1 whatever the lens.
COMPARED = (0.1, 0.9)
# Means closer than this are alike: several times what fits of either kind are off by on rendered
# targets (tests/evaluation/test_siemens.py: 0.006; tests/evaluation/test_edge_*.py).
ALIKE = 0.03
_SURE = 3.0  # standard errors


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """What an edge promises and a pattern shows, at the frequencies of the pattern.

    Parameters
    ----------
    frequency_lpmm : [n] rising
    edge, pattern : [n] modulation
    difference : mean of edge minus pattern
    std : its standard error
    verdict : "agree", "edge flatters" or "pattern flatters"
    """

    frequency_lpmm: Array
    edge: Array
    pattern: Array
    difference: float
    std: float
    verdict: str


def edge_and_pattern(edge: MtfCurve, pattern: MtfCurve) -> Agreement:
    """Compare the MTF of an edge with the contrast of a star, zone plate or gratings.

        d = mean of (edge - pattern) where the edge is within 0.1 .. 0.9
        std^2 = mean(std of edge)^2 + mean(std of pattern)^2

    A solver that knows what edges look like may draw them sharper than it resolves; a pattern of
    alternating lines shows what is there. They disagree where d exceeds 3 std and 0.03.

    Parameters
    ----------
    edge, pattern : curves over one unit of frequency; most of their errors are shared by all
        frequencies (the contrast at 0, the width of the edge)

    Raises
    ------
    ValueError
        If no frequency of the pattern lies where the edge is within 0.1 .. 0.9.
    """
    promised = np.interp(pattern.frequency_lpmm, edge.frequency_lpmm, edge.modulation)
    seen = pattern.frequency_lpmm <= edge.frequency_lpmm[-1]
    seen &= (promised >= COMPARED[0]) & (promised <= COMPARED[1])
    if not np.any(seen):
        lines = pattern.frequency_lpmm
        raise ValueError(
            f"expected a pattern with lines where the edge promises {COMPARED[0]} to {COMPARED[1]} "
            f"of the contrast, got lines from {lines[0]:.3g} to {lines[-1]:.3g}, where it promises "
            f"{promised[0]:.3g} to {promised[-1]:.3g}"
        )
    frequency = pattern.frequency_lpmm[seen]
    difference = float(np.mean(promised[seen] - pattern.modulation[seen]))
    of_edge = 0.0 if edge.std is None else np.interp(frequency, edge.frequency_lpmm, edge.std)
    of_pattern = 0.0 if pattern.std is None else pattern.std[seen]
    std = float(np.hypot(np.mean(of_edge), np.mean(of_pattern)))
    verdict = "agree"
    if abs(difference) > max(_SURE * std, ALIKE):
        verdict = "edge flatters" if difference > 0 else "pattern flatters"
    return Agreement(frequency, promised[seen], pattern.modulation[seen], difference, std, verdict)
