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
from lensshift.forward.operator import single

# Rounded from what training/opinions.py prints: c, what a likelihood counts over a window, in which
# errors are alike, and e, of which 300 to 1200 bursts of three seeds gave 0.09 to 0.11 and 0.25 to
# 0.34; d of both variances.
TRUST, OF_BIAS = 0.1, 0.3
PHASE_VARIANCE = (0.38, 0.25, 0.03, 0.3, 0.11)
AMPLITUDE_VARIANCE = (0.78, 0.16, 0.14, 0.06)
# So that two std hold 95.45 % of mosaics (training/validate.py --phasor --calibrate).
AMPLITUDE_STD_SCALE = 0.90
PHASE_STD_SCALE = 1.35
MOST = 6.0  # exponents beyond tell nothing more: that far, it is sure
# Squares below which numbers tell nothing: amplitudes, their distance in units of std, phases.
TINY, LEAST_APART = 1e-20, 1e-4
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
        std^2 = t^2 d_0 (s^2 / t^2)^d_1 exp(c L)^d_2 ((x - z)^2 / t^2)^d_3

    Parameters
    ----------
    evidence : L, as of phases
    """
    facts, unit = facts_of_amplitudes(first, second, of_first, of_second, evidence)
    own, for_second, _ = facts
    odds = for_second * np.sqrt(own)
    mean = first + (second - first) * (odds / (1.0 + odds))
    return mean, AMPLITUDE_STD_SCALE * np.sqrt(unit * product(AMPLITUDE_VARIANCE, facts))


def facts_of_amplitudes(
    first: Array, second: Array, of_first: Array, of_second: Array, evidence: Array
) -> tuple[list[Array], Floats]:
    """Return what has exponents in the std of `amplitude_of_both`, and t^2."""
    unit = np.maximum(of_second**2, TINY)
    own, far = (np.maximum(square, TINY) / unit for square in (of_first**2, (second - first) ** 2))
    return [own, likely(evidence), np.maximum(far, LEAST_APART)], unit


def likely(evidence: Array) -> Floats:
    """Return the odds exp(c L) of the second of two pictures."""
    return np.asarray(np.exp(np.clip(TRUST * evidence, -MOST, MOST)))


def product(law: Sequence[float], facts: Sequence[Array]) -> Floats:
    """Return c_0 times the product of facts, each to the power of its exponent."""
    powers = zip(law[1:], facts, strict=True)
    logarithm = sum(c * np.log(single(np.maximum(f, 1e-30))) for c, f in powers)
    return np.asarray(law[0] * np.exp(logarithm))
