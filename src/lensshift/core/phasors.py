"""Phasors of a burst: what pixels average that see two distances.

Their amplitude is no mean: of surfaces half a turn apart it falls to nothing where they meet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.core.stray_light import StrayLight
from lensshift.core.types import Burst
from lensshift.core.units import distance_to_phase


def from_polar(amplitude: Array, phase_rad: Array) -> NDArray[np.complex128]:
    """Return A exp(i phi); of the two parts, it costs half as much."""
    phasor = np.empty(np.shape(phase_rad), np.complex128)
    np.multiply(amplitude, np.cos(phase_rad), out=phasor.real)
    np.multiply(amplitude, np.sin(phase_rad), out=phasor.imag)
    return phasor


def has_phasors(part: Burst) -> bool:
    """Tell whether the phasors of a burst are known, or follow from amplitudes and distances.

    An amplitude below 0, as of background taken off, is of no phasor; nor are distances that
    several frequencies tell together.
    """
    if part.phasors is not None or part.amplitude.dtype.kind == "c":
        return True
    if part.distance_m is None or len(part.frequencies_hz) != 1:
        return False
    return not np.any(part.amplitude[part.valid] < 0)


def phasor_frames(part: Burst) -> Array:
    """Return the phasors [frame row col] of a burst that has them, 0 where they are not valid.

    Of several frequencies those of the highest, which tell most of where edges are.
    """
    if part.phasors is not None:
        return np.where(part.valid, part.phasors[int(np.argmax(part.frequencies_hz))], 0)
    if part.distance_m is None or part.amplitude.dtype.kind == "c":
        return np.where(part.valid, part.amplitude, 0)
    phase_rad = distance_to_phase(np.where(part.valid, part.distance_m, 0), part.frequencies_hz[0])
    return from_polar(np.where(part.valid, part.amplitude, 0), phase_rad)


def distances_without(stray: StrayLight | None, part: Burst) -> Floats:
    """Return the distances [frame row col] of a burst without stray light.

    As they are where their phasors are not known: each of several frequencies has mixed alone.
    """
    told_m = np.asarray(part.distance_m)
    if stray is None or len(part.frequencies_hz) != 1 or not has_phasors(part):
        return told_m
    seen = phasor_frames(part)
    turned_rad = np.angle(stray.removed(seen) * seen.conj())
    return np.asarray(told_m + turned_rad / distance_to_phase(1.0, part.frequencies_hz[0]))
