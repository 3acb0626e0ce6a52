"""Conversions between the units of the house, each written once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

SPEED_OF_LIGHT_MPS = 299_792_458.0  # by definition
MILLIMETRE_M = 1e-3
# Shares of red, green and blue in the luminance that ISO 12233 measures (ITU-R BT.709).
LUMINANCE = (0.2125, 0.7154, 0.0721)
# No sensor of light has pixels that are wider; seen through a microscope they may be of any size.
MOST_PITCH_MM = 10.0
# The widest lenses without distortion see 135 degrees, the narrowest of cameras (1.2 m of focal
# length) 0.05 degrees with a sensor of 1 mm. Parts of sensors of fewer pixels are no camera's.
LEAST_FIELD_DEG, MOST_FIELD_DEG, FEWEST_PX = 0.05, 150.0, 16
# What no camera lights. A frequency whose c / 2f is beyond it is meant in kHz or MHz.
MOST_DISTANCE_M = 1e3
LEAST_MODULATION_HZ = SPEED_OF_LIGHT_MPS / (2.0 * MOST_DISTANCE_M)
# Several frequencies reach some ten times farther than c / 2f of the first one. Millimetres are a
# thousand times too large: even a scene at a twentieth of the range shows.
_MOST_RANGES = 25.0


def unambiguous_range_m(modulation_hz: float) -> float:
    """Return the distance at which the phase has gone once round, c / (2 f)."""
    if not np.isfinite(modulation_hz) or modulation_hz <= 0:
        raise ValueError(f"expected a positive modulation frequency in Hz, got {modulation_hz}")
    return SPEED_OF_LIGHT_MPS / (2.0 * modulation_hz)


def distance_to_phase(distance_m: ArrayLike, modulation_hz: float) -> NDArray[np.float64]:
    """Return the phase of the returned light in rad, 4 pi f d / c."""
    return np.asarray(distance_m, dtype=np.float64) * (
        2.0 * np.pi / unambiguous_range_m(modulation_hz)
    )


def phase_to_distance(phase_rad: ArrayLike, modulation_hz: float) -> NDArray[np.float64]:
    """Return the distance in [0, c / 2f) m that belongs to a phase."""
    turns = np.mod(np.asarray(phase_rad, dtype=np.float64) / (2.0 * np.pi), 1.0)
    return turns * unambiguous_range_m(modulation_hz)


def within_half_a_turn(phase_rad: ArrayLike) -> NDArray[np.float64]:
    """Return phases within -pi .. pi."""
    phase = np.asarray(phase_rad, np.float64)
    return phase - 2.0 * np.pi * np.rint(phase / (2.0 * np.pi))


def doubt_about_units(modulation_hz: float, typical_m: float | None) -> str:
    """Say why a frequency, or a distance typical for a scene, can hardly be in Hz and m; or ""."""
    if not modulation_hz >= LEAST_MODULATION_HZ:
        return f"modulation_hz: expected a frequency in Hz, got {modulation_hz:g}; 15 MHz are 15e6"
    range_m = unambiguous_range_m(modulation_hz)
    if typical_m is None or 0 <= typical_m <= _MOST_RANGES * range_m:
        return ""
    if typical_m < 0:
        return f"distance_m: expected distances from the camera, got a median of {typical_m:g} m"
    meant = "millimetres" if typical_m > 100 * range_m else "centimetres or millimetres"
    return (
        f"distance_m: expected metres, got a median of {typical_m:g} where light of "
        f"{modulation_hz:g} Hz is unambiguous up to {range_m:.4g} m; are they {meant}?"
    )


def doubt_about_distance(typical_m: float | None) -> str:
    """Say why a distance typical for a scene can hardly be in m, whatever lights it; or ""."""
    if typical_m is None or typical_m <= MOST_DISTANCE_M:
        return ""
    return f"distance_m: expected metres, got a median of {typical_m:g}; are they millimetres?"


def doubt_about_pitch(pitch_mm: float) -> str:
    """Say why a pitch can hardly be in mm; or ""."""
    if pitch_mm <= MOST_PITCH_MM:
        return ""
    return f"pitch_mm: expected the pixel pitch in mm, got {pitch_mm:g}; 155 um are 0.155"


def doubt_about_focal_length(focal_length_px: float, width_px: int) -> str:
    """Say why a focal length can hardly be in the unit it was meant in; or ""."""
    field_deg = float(np.rad2deg(2.0 * np.arctan2(0.5 * width_px, focal_length_px)))
    if field_deg <= MOST_FIELD_DEG and (field_deg >= LEAST_FIELD_DEG or width_px < FEWEST_PX):
        return ""
    return (
        f"focal length: {focal_length_px:.3g} pixels let {width_px} of them see {field_deg:.3g} "
        "degrees, which no lens without distortion does; is it in the right unit, mm or pixels?"
    )


@dataclass(frozen=True, slots=True)
class PhaseScale:
    """How phases stand for distances in one burst.

    phi = 4 pi f (d - d_ref) / c
    """

    modulation_hz: float  # f
    reference_m: float  # d_ref, amid the scene: phases are small there, and the cut lies opposite
    circular: bool  # whether distances come back after c / 2f, and lie within 0 .. c / 2f
    source: str  # where the frequency comes from

    @property
    def rad_per_m(self) -> float:
        """4 pi f / c."""
        return float(distance_to_phase(1.0, self.modulation_hz))

    def distance_m(self, phase_rad: ArrayLike) -> NDArray[np.float64]:
        """Return the distances that belong to phases relative to the reference."""
        distance_m = np.asarray(phase_rad) / self.rad_per_m + self.reference_m
        if not self.circular:
            return np.asarray(distance_m)
        return np.asarray(np.mod(distance_m, unambiguous_range_m(self.modulation_hz)))
