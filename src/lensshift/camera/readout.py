"""From light to the numbers of the converter: four phases, two taps, noise, exposure and gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.camera.settings import Pixels, Readout
from lensshift.core.arrays import Array, Mask

PHASES = 4  # of the correlation, a quarter turn apart


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """Electrons per second that the light gives a pixel, in both taps together."""

    active: Array  # [row col] modulated light
    constant: Array  # [row col] sunlight and dark current
    phasor: NDArray[np.complex128]  # [frequency harmonic row col] modulated light x exp(i phase)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The raw data of one frame."""

    # [frequency phase row col] tap A - tap B in counts: whole numbers, or electrons if there is no
    # converter
    difference: Array
    electrons_per_count: Array  # [row col]
    # [row col] which of those of `Readout` the pixel used
    exposure: NDArray[np.uint8]
    gain: NDArray[np.uint8]
    # [row col] a tap was full, or the converter at its end, in the shortest exposure
    saturated: Mask


def expected_taps(rates: Rates, pixels: Pixels, exposure_s: float) -> tuple[Array, Array]:
    """Return the mean electrons of taps A and B, [frequency phase row col] each.

    A, B = exposure / 2 (active + constant +- contrast s_k),    k = 0 .. 3
    s_k = Re[ sum_h c_h phasor_h exp(-i h k pi/2) ],    c_1 = 1
    """
    share = harmonic_shares(pixels)
    k = np.arange(PHASES)
    turn = np.stack([c * np.exp(-0.5j * np.pi * h * k) for h, c in share.items()])
    swing = np.einsum("hk,fhrc->fkrc", turn, rates.phasor).real
    swing *= 0.5 * exposure_s * pixels.contrast
    common = 0.5 * exposure_s * (rates.active + rates.constant)
    return common + swing, common - swing


def harmonic_shares(pixels: Pixels) -> dict[int, float]:
    """Return the harmonics in the correlation and their size, the fundamental first."""
    shares = {1: 1.0, 3: pixels.harmonic_3, 5: pixels.harmonic_5}
    return {harmonic: share for harmonic, share in shares.items() if share}


def read(rates: Rates, pixels: Pixels, readout: Readout, rng: np.random.Generator) -> Reading:
    """Expose and convert one frame; each pixel uses its longest exposure that does not saturate."""
    frequencies, _, rows, cols = rates.phasor.shape
    difference = np.empty((frequencies, PHASES, rows, cols))
    exposure = np.zeros((rows, cols), dtype=np.uint8)
    open_yet = np.ones((rows, cols), dtype=np.bool_)
    full = np.zeros((rows, cols), dtype=np.bool_)
    for number in range(len(readout.exposure_s) - 1, -1, -1):
        taps = expected_taps(rates, pixels, readout.exposure_s[number])
        electrons, full = _expose(taps, readout, rng)
        difference[..., open_yet] = electrons[..., open_yet]
        exposure[open_yet] = number
        open_yet &= full
    return _convert(difference, exposure, open_yet, readout)


def _expose(
    taps: tuple[Array, Array], readout: Readout, rng: np.random.Generator
) -> tuple[Array, Mask]:
    """Return tap A - tap B in electrons, and which pixels were full in any phase."""
    a, b = (rng.poisson(tap).astype(np.float64) if readout.shot_noise else tap for tap in taps)
    removed = np.minimum(np.minimum(a, b), readout.background_electrons)
    a, b = a - removed, b - removed
    full = np.zeros(a.shape[2:], dtype=np.bool_)
    if readout.saturates:
        full = np.any(np.maximum(a, b) >= readout.full_well_electrons, axis=(0, 1))
        a, b = (np.minimum(tap, readout.full_well_electrons) for tap in (a, b))
    difference = a - b
    if readout.read_noise_electrons > 0:
        for _ in range(2):  # taps
            difference += rng.normal(0.0, readout.read_noise_electrons, difference.shape)
    return difference, full


def _convert(
    electrons: Array, exposure: NDArray[np.uint8], full: Mask, readout: Readout
) -> Reading:
    """Amplify and quantise: the largest gain at which all phases stay within the converter."""
    gain = np.zeros(exposure.shape, dtype=np.uint8)
    if readout.bits is None:
        return Reading(electrons, np.ones(exposure.shape), exposure, gain, full)
    end = 2 ** (readout.bits - 1)
    largest = np.abs(electrons).max(axis=(0, 1)) * end / readout.full_well_electrons
    for number, factor in enumerate(readout.gain):
        gain[largest * factor <= end - 1] = number
    per_count = readout.full_well_electrons / (end * np.asarray(readout.gain)[gain])
    counts = np.rint(electrons / per_count)
    over = np.any(np.abs(counts) > end, axis=(0, 1))
    difference = np.clip(counts, -end, end - 1).astype(np.int32)
    return Reading(difference, per_count, exposure, gain, full | over)
