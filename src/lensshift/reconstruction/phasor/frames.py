"""Phasor frames: from the four phases of a time-of-flight pixel, or from amplitude and distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.core.order import median
from lensshift.core.phasors import from_polar
from lensshift.core.types import Burst
from lensshift.core.units import (
    SPEED_OF_LIGHT_MPS,
    PhaseScale,
    distance_to_phase,
    phase_to_distance,
    unambiguous_range_m,
)


@dataclass(frozen=True, slots=True, eq=False)
class PhasorFrames:
    """What the four phases of each frame say.

    Parameters
    ----------
    phasor : [frame row col] complex
    variance : [frame row col] of its real and of its imaginary part
    """

    phasor: NDArray[np.complex128]
    variance: Floats


def phasor_from_phases(difference: ArrayLike, variance: ArrayLike = 1.0) -> PhasorFrames:
    """Return the phasors of raw four-phase frames.

        P = ((D_0 - D_2) + i (D_1 - D_3)) / 2,   D_k = tap A - tap B at k pi / 2
        var(Re P), var(Im P) ~ sum_k var(D_k) / 8

    They make a burst that keeps the noise where it arose:

        frames = phasor_from_phases(difference, variance)
        burst = Burst.from_arrays(frames.phasor, offset_px=..., pitch_mm=..., modulation_hz=f)
        reconstruct(burst, channel="phasor", pixel_variance=frames.variance)

    Parameters
    ----------
    difference : [frame 4 row col] D_k in any unit
    variance : of D_k in the square of that unit, one number or anything that broadcasts to
        [frame 4 row col]; 1 if only its share matters

    Raises
    ------
    ValueError
        If the frames are not real [frame 4 row col], or a variance is not positive.
    """
    phases = np.asarray(difference)
    if phases.dtype.kind not in "uif" or phases.ndim != 4 or phases.shape[1] != 4:
        raise ValueError(
            f"expected real phases [frame 4 row col], got {phases.dtype} of shape {phases.shape}"
        )
    spread = np.asarray(variance, np.float64)
    if not (np.all(np.isfinite(spread)) and np.all(spread > 0)):
        raise ValueError("expected positive, finite variances of the phases")
    try:
        spread = np.broadcast_to(spread, phases.shape)
    except ValueError as error:
        raise ValueError(
            f"expected variances that broadcast to {phases.shape}, got {spread.shape}"
        ) from error
    d0, d1, d2, d3 = np.moveaxis(phases.astype(np.float64), 1, 0)
    return PhasorFrames(0.5 * ((d0 - d2) + 1j * (d1 - d3)), spread.sum(axis=1) / 8.0)


@dataclass(frozen=True, slots=True, eq=False)
class PolarFrames:
    """The frames of a burst as amplitude and phase; zero where a pixel is not valid.

    Parameters
    ----------
    amplitude, phase_rad : [frame row col], the phase relative to `scale.reference_m`
    scale : how the phases stand for distances
    """

    amplitude: Floats
    phase_rad: Floats
    scale: PhaseScale

    @property
    def phasor(self) -> NDArray[np.complex128]:
        """A exp(i phi), [frame row col]."""
        return from_polar(self.amplitude, self.phase_rad)

    @property
    def parts(self) -> Floats:
        """[2 frame row col] real and imaginary part of the phasors as the camera has them."""
        z = from_polar(
            self.amplitude, self.phase_rad + self.scale.rad_per_m * self.scale.reference_m
        )
        return np.stack([z.real, z.imag])


def phasors_of(burst: Burst) -> tuple[Array, tuple[float, ...]]:
    """Return phasors [frequency frame row col] and their frequencies in Hz, see `polar_frames`."""
    if burst.phasors is not None:
        return burst.phasors, burst.frequencies_hz
    polar = polar_frames(burst)
    return polar.phasor[None], (polar.scale.modulation_hz,)


def polar_frames(burst: Burst) -> PolarFrames:
    """Return amplitude and phase of a burst of complex frames, or of amplitude and distance.

    Phases that come back after c / 2f are cut opposite to the mean phasor. Where a burst does not
    say its modulation, f = c / (4 range of its distances) puts them over half a turn.

    Raises
    ------
    ValueError
        If there is no distance or it is of several frequencies, a valid amplitude is negative, or
        complex frames come without their modulation frequency.
    """
    if len(burst.frequencies_hz) > 1:
        raise ValueError(
            "the distances are of several modulation frequencies, and a pixel that sees two "
            "surfaces has mixed each by itself; give the phasors of each, or take channel distance"
        )
    modulation_hz = burst.frequencies_hz[0] if burst.frequencies_hz else None
    valid = burst.valid
    if burst.amplitude.dtype.kind == "c":
        return _from_complex(np.where(valid, burst.amplitude, 0), modulation_hz)
    if burst.distance_m is None:
        raise ValueError("the burst has no distance_m; the phasor channel needs it, or phasors")
    amplitude = np.where(valid, burst.amplitude, 0).astype(np.float64)
    if amplitude.min() < 0:
        k, row, col = np.unravel_index(np.argmin(amplitude), amplitude.shape)
        raise ValueError(
            f"expected amplitudes of at least 0, got {amplitude.min():g} in frame {k} at row {row},"
            f" column {col} and {np.sum(amplitude < 0) - 1} more; leave them out in valid"
        )
    distance_m = np.where(valid, burst.distance_m, 0).astype(np.float64)
    seen_m = distance_m[valid]
    if modulation_hz is not None:
        range_m = unambiguous_range_m(modulation_hz)
        if seen_m.min() >= 0 and seen_m.max() <= range_m:
            phasor = from_polar(amplitude, distance_to_phase(distance_m, modulation_hz))
            return _from_complex(phasor, modulation_hz)
        scale = PhaseScale(modulation_hz, median(seen_m), False, "burst")
    else:
        reference_m = median(seen_m)
        span_m = float(np.ptp(seen_m)) or abs(reference_m) or 1.0  # half a turn
        half_turn_hz = SPEED_OF_LIGHT_MPS / (4.0 * span_m)
        scale = PhaseScale(half_turn_hz, reference_m, False, "range of the distances")
    phase_rad = np.where(valid, (distance_m - scale.reference_m) * scale.rad_per_m, 0.0)
    return PolarFrames(amplitude, phase_rad, scale)


def _from_complex(phasor: Array, modulation_hz: float | None) -> PolarFrames:
    if modulation_hz is None:
        raise ValueError("complex frames need the modulation_hz of the burst to become distances")
    middle = np.sum(phasor)
    reference_m = float(phase_to_distance(np.angle(middle), modulation_hz))
    turned = phasor * np.exp(-1j * np.angle(middle))
    scale = PhaseScale(modulation_hz, reference_m, True, "burst")
    return PolarFrames(np.abs(turned), np.angle(turned), scale)
