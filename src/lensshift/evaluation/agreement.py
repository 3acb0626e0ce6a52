"""Whether an edge and a pattern of the same target tell the same resolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.gaussian import MEDIAN_ERROR
from lensshift.core.optical import MtfCurve

# Where the edge promises between these, the curves are compared: a pattern has no more to show
# below, and above both are near 1 whatever the lens.
COMPARED = (0.1, 0.9)
# Means closer than this are alike: several times what fits of either kind are off by on rendered
# targets (tests/evaluation/test_siemens.py: 0.006; tests/evaluation/test_edge_*.py).
ALIKE = 0.03
_SURE = 3.0  # standard errors
_COARSE = 0.15  # of the range of frequencies, from the coarsest lines on, where both are the same


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """What an edge promises and a pattern shows, at the frequencies of the pattern.

    Parameters
    ----------
    frequency_lpmm : [n] rising
    edge, pattern : [n] modulation; of an unsure contrast, that of the edge at coarse lines
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


def edge_and_pattern(edge: MtfCurve, pattern: MtfCurve, *, unsure: float = 0.0) -> Agreement:
    """Compare the MTF of an edge with the contrast of a star, zone plate or gratings.

        d = mean of (edge - pattern) where the edge is within 0.1 .. 0.9
        std^2 = mean(std of edge)^2 + mean(std of pattern)^2

    A solver that knows what edges look like may draw them sharper than it resolves; a pattern of
    alternating lines shows what is there. They disagree where d exceeds 3 std and 0.03.

    A contrast that was extrapolated holds nothing of what changes before the coarsest lines, as
    behind sharpening or a halo. Then those lines tell the contrast, which the edge shows as well:
    the pattern is scaled to the edge there, and finer lines are compared.

    Parameters
    ----------
    edge, pattern : curves over one unit of frequency; most of their errors are shared by all
        frequencies (the contrast at 0, the width of the edge)
    unsure : contrast_std / contrast of the pattern's result; 0 where levels tell the contrast

    Raises
    ------
    ValueError
        If no frequency of the pattern lies where the edge is within 0.1 .. 0.9, or only coarse ones
        and their contrast is not sure.
    """
    frequency, modulation = pattern.frequency_lpmm, pattern.modulation
    promised = np.interp(frequency, edge.frequency_lpmm, edge.modulation)
    within = (frequency <= edge.frequency_lpmm[-1]) & (promised >= COMPARED[0])
    seen = within & (promised <= COMPARED[1])
    coarse = np.zeros_like(seen)
    if unsure > 0.0 and np.any(seen):
        first = frequency[within][0]
        coarse = within & (frequency <= first + _COARSE * (frequency[seen][-1] - first))
        seen &= ~coarse
    if not np.any(seen):
        told = (
            ", besides the coarsest ones, which tell the contrast without levels," if unsure else ""
        )
        raise ValueError(
            f"expected a pattern with lines{told} where the edge promises {COMPARED[0]} to "
            f"{COMPARED[1]} of the contrast, got lines from {frequency[0]:.3g} to "
            f"{frequency[-1]:.3g}, where it promises {promised[0]:.3g} to {promised[-1]:.3g}"
        )
    of_pattern = np.zeros_like(modulation) if pattern.std is None else pattern.std
    of_scale = 0.0
    if unsure > 0.0:
        scale = float(np.median(modulation[coarse] / promised[coarse]))
        alone = np.sqrt(np.maximum(of_pattern**2 - (unsure * modulation) ** 2, 0.0))
        each = float(np.mean(alone[coarse] / promised[coarse])) / scale
        of_scale = MEDIAN_ERROR * each / np.sqrt(np.count_nonzero(coarse))
        modulation, of_pattern = modulation / scale, alone / scale
    frequency, promised, shown = frequency[seen], promised[seen], modulation[seen]
    difference = float(np.mean(promised - shown))
    of_edge = 0.0 if edge.std is None else np.interp(frequency, edge.frequency_lpmm, edge.std)
    errors = np.mean(of_edge), np.mean(of_pattern[seen]), of_scale * np.mean(shown)
    std = float(np.linalg.norm(errors))
    verdict = "agree"
    if abs(difference) > max(_SURE * std, ALIKE):
        verdict = "edge flatters" if difference > 0 else "pattern flatters"
    return Agreement(frequency, promised, shown, difference, std, verdict)
