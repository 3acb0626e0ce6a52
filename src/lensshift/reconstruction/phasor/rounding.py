"""What rounded numbers do to frames with distances: what their surfaces share, and do not tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.order import median
from lensshift.core.phasors import phasor_frames
from lensshift.core.types import Burst
from lensshift.forward.operator import mean_seen, single
from lensshift.reconstruction.phasor.frames import PolarFrames, polar_frames
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.rounding import apart_rms, shared_rounding, step_of, within_rounding


@dataclass(frozen=True, slots=True)
class Steps:
    """Between the levels that numbers of frames are on, 0 if they are on none.

    Parameters
    ----------
    parts, light : of the real and imaginary part, and of the amplitude, in units of a problem
    phase_rad : of the distance, as a phase
    """

    parts: float
    light: float
    phase_rad: float

    @classmethod
    def of(cls, problem: Problem, part: Burst, frames: PolarFrames) -> Steps:
        """Return those of some frames, which the problem and the polar frames hold as well."""
        used, light, phase_rad = problem.weight > 0, 0.0, 0.0
        if part.distance_m is not None:
            light = step_of(part.amplitude, used) / problem.intensity
            phase_rad = step_of(part.distance_m, used) * frames.scale.rad_per_m
        parts = step_of(frames.parts, np.stack([used, used])) / problem.intensity
        return cls(parts, light, phase_rad)

    def least_noise(self, problem: Problem) -> Floats:
        """Return the noise [frame row col] of a component that rounding alone makes."""
        along, across = self.light**2, (self.phase_rad * np.abs(problem.y)) ** 2
        return np.sqrt((self.parts**2 + 0.5 * (along + across)) / 12)

    def shared(self, problem: Problem, sigma: Floats) -> tuple[Floats, Floats]:
        """Return the error of amplitude and phase [row col] that is left to all of a surface.

        Parameters
        ----------
        sigma : [frame row col] noise of a component; infinite where a pixel is not used
        """
        A, used = problem.model.operator, np.isfinite(sigma)
        if not (self.parts or self.light or self.phase_rad):
            return np.zeros(A.in_shape), np.zeros(A.in_shape)
        noise, light = np.where(used, sigma, 0.0), np.maximum(np.abs(problem.y), 1e-12)
        of_parts, of_light = (shared_rounding(step, noise) for step in (self.parts, self.light))
        of_phase = shared_rounding(self.phase_rad, noise / light)
        amplitude, phase = (
            np.sqrt(mean_seen(A, single(np.where(used, square, 0.0)), single(used)))
            for square in (of_parts**2 + of_light**2, (of_parts / light) ** 2 + of_phase**2)
        )
        return amplitude, phase


def differ_by_rounding(part: Burst) -> bool:
    """Return whether frames differ by no more than levels do, as `within_rounding` has it."""
    valid = part.valid
    if part.phasors is not None:
        z = phasor_frames(part)
        return within_rounding(np.stack([z.real, z.imag]), np.stack([valid, valid]))
    light_alone = part.amplitude.dtype.kind != "c" and (
        part.distance_m is None
        or len(part.frequencies_hz) > 1
        or np.min(part.amplitude, where=valid, initial=0) < 0  # less a dark frame, or a pattern
    )
    if light_alone:
        return within_rounding(part.amplitude, valid)
    frames = polar_frames(part)
    if within_rounding(frames.parts, np.stack([valid, valid])):
        return True
    if part.distance_m is None or not within_rounding(part.distance_m, valid):
        return False
    light = median(frames.amplitude[valid])
    of_distance = light * frames.scale.rad_per_m * apart_rms(part.distance_m, valid)
    return of_distance > apart_rms(frames.amplitude, valid)
