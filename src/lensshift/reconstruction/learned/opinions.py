"""The mean of two pictures of one scene: how much each of them counts, and what it may be off by.

Weights for phasors and weights for brightness err at other places, and say too little or too much
of their errors there. What is left of the mean follows powers of what both say, and of what the
frames say of both: their exponents were fitted to scenes drawn as for the training.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.core.units import within_half_a_turn

# Rounded from what training/opinions.py prints: c, what a likelihood counts over a window, in which
# errors are alike, and e and d of `phase_of_both`. 300 to 1200 bursts of three seeds gave 0.09 to
# 0.11 and 0.25 to 0.34.
TRUST, OF_BIAS = 0.1, 0.3
PHASE_VARIANCE = (0.38, 0.25, 0.03, 0.3, 0.11)
# So that two std hold 95.45 % of the phases of mosaics (training/validate.py --phasor --calibrate).
PHASE_STD_SCALE = 1.34
MOST = 6.0  # exponents beyond tell nothing more: that far, it is sure
LEAST_RAD2 = 1e-7  # below it the square of a phase tells nothing


def phase_of_both(
    first: Array,
    second: Array,
    first_rad: Array,
    second_rad: Array,
    bias_rad: Array,
    evidence: Array,
) -> tuple[Floats, Floats]:
    """Return the mean of two phases, and its std, in radians.

        w / (1 - w) = exp(c L) s^2 / t^2 (t^2 / b^2)^e
        std^2 = t^2 d_0 (s^2 / t^2)^d_1 (b^2 / t^2)^d_2 exp(c L)^d_3 (z^2 / t^2)^d_4

    Each counts by its variance and its likelihood. The variance of the second is t^2 where it is
    right of all pixels, and b^2 where it takes the mean of phases for the phase of a mean: between
    them where it is not known which.

    Parameters
    ----------
    first, second : [row col] apart by z
    first_rad, second_rad : s and t, their std
    bias_rad : b, what the mean of phases lacks of the phase of a mean
    evidence : L, by how much the logarithm of the likelihood of the second is larger
    """
    facts, unit = facts_of_phases(first, second, first_rad, second_rad, bias_rad, evidence)
    own, bias, for_second, _ = facts
    odds = for_second * own / bias**OF_BIAS
    mean = first + within_half_a_turn(second - first) * (odds / (1.0 + odds))
    return mean, PHASE_STD_SCALE * np.sqrt(unit * product(PHASE_VARIANCE, facts))


def facts_of_phases(
    first: Array,
    second: Array,
    first_rad: Array,
    second_rad: Array,
    bias_rad: Array,
    evidence: Array,
) -> tuple[list[Array], Floats]:
    """Return what has exponents in the std of `phase_of_both`, and t^2."""
    unit, apart = second_rad**2 + LEAST_RAD2, within_half_a_turn(second - first)
    own, bias, far = ((rad**2 + LEAST_RAD2) / unit for rad in (first_rad, bias_rad, apart))
    return [own, bias, likely(evidence), far], unit


def amplitude_of_both(
    first: Array, second: Array, of_first: Array, of_second: Array, evidence: Array
) -> tuple[Floats, Floats]:
    """Return the mean of two amplitudes x and z, and its std from theirs, s and t.

        (1 - w) x + w z,   w / (1 - w) = exp(c L) s / t
        std^2 = (1 - w) s^2 + w t^2 + w (1 - w) (x - z)^2

    Parameters
    ----------
    evidence : L, as of phases
    """
    odds = likely(evidence) * of_first / np.maximum(of_second, 1e-30)
    w = odds / (1.0 + odds)
    variance = (1 - w) * of_first**2 + w * of_second**2 + w * (1 - w) * (first - second) ** 2
    return np.asarray((1 - w) * first + w * second), np.sqrt(variance)


def likely(evidence: Array) -> Floats:
    """Return the odds exp(c L) of the second of two pictures."""
    return np.asarray(np.exp(np.clip(TRUST * evidence, -MOST, MOST)))


def product(law: Sequence[float], facts: Sequence[Array]) -> Floats:
    """Return c_0 times the product of facts, each to the power of its exponent."""
    logarithm = sum(c * np.log(np.maximum(f, 1e-30)) for c, f in zip(law[1:], facts, strict=True))
    return np.asarray(law[0] * np.exp(logarithm))
