"""From four phases to amplitude and distance, as the firmware of a camera does it."""

from __future__ import annotations

import math

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.units import SPEED_OF_LIGHT_MPS, phase_to_distance, unambiguous_range_m

_LONGEST_M = 200.0  # nobody looks for farther distances among several frequencies


def demodulate(difference: Array) -> tuple[Array, Array]:
    """Return phase in rad and amplitude, [frequency row col], of [frequency phase row col].

    phase = atan2(D1 - D3, D0 - D2),    amplitude = 1/2 hypot(D0 - D2, D1 - D3)
    """
    real = difference[:, 0] - difference[:, 2]
    imaginary = difference[:, 1] - difference[:, 3]
    return np.arctan2(imaginary, real), 0.5 * np.hypot(real, imaginary)


def unambiguous_distance_m(modulation_hz: tuple[float, ...]) -> float:
    """Return the distance at which the phases of all frequencies repeat, c / (2 gcd), or 200 m."""
    if len(modulation_hz) == 1:
        return unambiguous_range_m(modulation_hz[0])
    common_hz = math.gcd(*(int(hz) for hz in modulation_hz))
    return min(unambiguous_range_m(common_hz), _LONGEST_M)


def unwrap(phase_rad: Array, amplitude: Array, modulation_hz: tuple[float, ...]) -> Array:
    """Return the distance in metres [row col] that fits the phases of all frequencies best.

        minimise over the turns n of the highest frequency
            sum_f a_f^2 [1 - cos(phase_f - 4 pi f d_n / c)]
        then d = sum_f w_f d_f / sum_f w_f,    w_f = (a_f f)^2

    Parameters
    ----------
    phase_rad, amplitude : [frequency row col]
    """
    if len(modulation_hz) == 1:
        return phase_to_distance(phase_rad[0], modulation_hz[0])
    fastest = int(np.argmax(modulation_hz))
    step_m = unambiguous_range_m(modulation_hz[fastest])
    longest_m = unambiguous_distance_m(modulation_hz)
    first_m = phase_to_distance(phase_rad[fastest], modulation_hz[fastest])
    per_m = 4.0 * np.pi * np.asarray(modulation_hz)[:, None, None] / SPEED_OF_LIGHT_MPS
    best_m, least = first_m, np.full(first_m.shape, np.inf)
    for turns in range(math.ceil(longest_m / step_m - 1e-6)):  # mostly a whole number of steps
        tried_m = first_m + turns * step_m
        misfit = np.sum(amplitude**2 * (1.0 - np.cos(phase_rad - per_m * tried_m)), axis=0)
        better = misfit < least
        best_m, least = np.where(better, tried_m, best_m), np.where(better, misfit, least)
    away_rad = np.angle(np.exp(1j * (phase_rad - per_m * best_m)))
    weight = (amplitude * per_m) ** 2
    total = weight.sum(axis=0)
    correction_m = np.sum(weight * away_rad / per_m, axis=0) / np.where(total > 0, total, 1.0)
    return np.asarray(np.mod(best_m + correction_m, longest_m))
