"""From amplitude and distance to what leaves the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.camera.demodulate import demodulate, unwrap
from lensshift.camera.readout import Reading
from lensshift.camera.settings import MOST_BITS, TofCamera
from lensshift.core.arrays import Array, Floats, Mask

# Bits of the confidence of an O3M pixel.
_INVALID, _LOW_SIGNAL = 1, 4096  # between them: exposure (2) and gain (4)
_INVALID_CM, _FARTHEST_CM = 1, 15_000  # as an O3M sends them


@dataclass(frozen=True, slots=True, eq=False)
class O3mImages:
    """What an O3M sends, [frame row col].

    Parameters
    ----------
    distance_cm : radial, 0 to 15000; 1 where invalid, as what is farther than 150 m
    amplitude_counts : of the exposure and gain that the pixel used
    confidence : bits: 1 invalid, 2 long exposure, 4 high gain, 4096 too little signal
    amplitude_normalization : [4] factor on `amplitude_counts` for (confidence >> 1) & 3
    """

    distance_cm: NDArray[np.uint16]
    amplitude_counts: NDArray[np.uint16]
    confidence: NDArray[np.uint16]
    amplitude_normalization: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One frame as it leaves the camera."""

    amplitude: Array  # [row col] 1: as many electrons as a tap holds, in the longest exposure
    distance_m: Array  # [row col] radial
    valid: Mask  # [row col]
    o3m: O3mImages | None = None  # the same as an O3M sends it, without frame axis, or None
    # [frequency row col] in the unit of the amplitude; None if the camera keeps them
    phasors: NDArray[np.complex128] | None = None


def image_of(reading: Reading, camera: TofCamera) -> Image:
    """Compute amplitude and distance of one frame in the style of the camera."""
    phase_rad, counts = demodulate(reading.difference)
    distance_m = unwrap(phase_rad, counts, camera.illumination.modulation_hz)
    each, counts = counts * np.exp(1j * phase_rad), counts.mean(axis=0)
    electrons = counts * reading.electrons_per_count
    weak = (electrons < camera.validity.min_amplitude_electrons) | (electrons <= 0)
    valid = ~(reading.saturated | weak)
    readout = camera.readout
    if camera.output != "o3m":
        exposure_s = np.asarray(readout.exposure_s)
        longer = exposure_s[-1] / exposure_s[reading.exposure]
        unit = longer * reading.electrons_per_count / readout.full_well_electrons
        return Image(counts * unit, distance_m, valid, phasors=each * unit)
    fraction = 2 ** (MOST_BITS - (readout.bits or MOST_BITS))
    words = np.minimum(np.rint(counts * fraction), 2**MOST_BITS - 1).astype(np.uint16)
    rounded_cm = np.rint(100.0 * distance_m)
    valid &= rounded_cm <= _FARTHEST_CM
    distance_cm = np.where(valid, np.maximum(rounded_cm, 0), _INVALID_CM).astype(np.uint16)
    state = reading.exposure + 2 * reading.gain
    confidence = 2 * state.astype(np.uint16)
    confidence[~valid] |= _INVALID
    confidence[weak] |= _LOW_SIGNAL
    # The amplitude of one count for (short, long) exposure at low, then at high gain.
    exposure = np.resize(readout.exposure_s[-1] / np.asarray(readout.exposure_s), 2)
    factors = np.ravel(exposure / np.resize(np.asarray(readout.gain), 2)[:, None])
    factors /= 2 ** ((readout.bits or MOST_BITS) - 1) * fraction
    o3m = O3mImages(distance_cm, words, confidence, factors)
    return Image(words * factors[state], distance_cm / 100.0, valid, o3m)
